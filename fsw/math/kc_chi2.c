#include "kc_chi2.h"

#include "kc_libm.h"

/* Enough for dof up to 6 KC_MEAS_MAX at any argument: the series takes about 10 sqrt(a) terms near
 * x = a, the continued fraction fewer. */
#define TERMS_MAX 1000u
#define EPS 1e-16
#define HALVINGS 40u     /* of the interval that holds a quantile */
#define QUANTILE_MAX 8.0 /* times dof and a few: beyond the quantiles of 1e-4 and more */
#define TINY 1e-300
#define NCP_MAX 200.0  /* noncentrality: beyond it the upper tail is 1 for all that is asked here */
#define NCP_TERMS 200u /* of the Poisson sum: ten of its deviations beyond NCP_MAX / 2 */

/* x^a e^-x / Gamma(a) */
static double front(double a, double x) { return kc_exp(a * kc_log(x) - x - kc_lgamma(a)); }

/* Lower P(a, x), series (Abramowitz and Stegun 6.5.29), for x < a + 1. */
static double lower_series(double a, double x)
{
    double term = 1.0 / a;
    double sum = term;
    for (uint32_t n = 1u; n <= TERMS_MAX && term > sum * EPS; n++) {
        term *= x / (a + (double)n);
        sum += term;
    }
    return sum * front(a, x);
}

/* Upper Q(a, x), continued fraction (6.5.31) by Lentz's method, for x >= a + 1. Every b there is
 * positive and grows, so no denominator can vanish. */
static double upper_fraction(double a, double x)
{
    double b = x + 1.0 - a;
    double c = 1.0 / TINY;
    double d = 1.0 / b;
    double h = d;
    double step = 0.0;
    for (uint32_t n = 1u; n <= TERMS_MAX && kc_fabs(step - 1.0) > EPS; n++) {
        const double an = -(double)n * ((double)n - a);
        b += 2.0;
        d = 1.0 / (an * d + b);
        c = b + an / c;
        step = c * d;
        h *= step;
    }
    return h * front(a, x);
}

static double upper(double chi2, double dof)
{
    const double a = 0.5 * dof;
    const double x = 0.5 * chi2;
    if (x <= 0.0) { return 1.0; }
    return (x < a + 1.0) ? 1.0 - lower_series(a, x) : upper_fraction(a, x);
}

double kc_chi2_sf(double chi2, uint32_t dof) { return upper(chi2, (double)dof); }

double kc_chi2_quantile(double p, uint32_t dof) { return kc_chi2_quantile_real(p, (double)dof); }

double kc_chi2_noncentral_sf(double chi2, uint32_t dof, double ncp)
{
    const double half = 0.5 * kc_min(ncp, NCP_MAX);
    double weight = kc_exp(-half), sum = 0.0, total = 0.0;
    for (uint32_t k = 0u; k < NCP_TERMS; k++) {
        sum += weight * kc_chi2_sf(chi2, dof + 2u * k);
        total += weight;
        weight *= half / ((double)k + 1.0);
    }
    return sum / total;
}

double kc_chi2_quantile_real(double p, double dof)
{
    double lo = 0.0, hi = QUANTILE_MAX * (dof + 6.0);
    for (uint32_t k = 0u; k < HALVINGS; k++) {
        const double mid = 0.5 * (lo + hi);
        if (upper(mid, dof) > p) {
            lo = mid;
        } else {
            hi = mid;
        }
    }
    return hi;
}
