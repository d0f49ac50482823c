/* The mathematics of the core: double precision, the same bits on every CPU.
 *
 * These functions are musl's, compiled under these names (fsw/musl); their error is below 1 ulp but for log-gamma and
 * tanh (a few). No function of the process's own mathematics library is called, since those differ in their last
 * bits. Square root, absolute value and the like are exact everywhere, the CPU has them. */
#ifndef KC_LIBM_H
#define KC_LIBM_H

#include <math.h>
#include <stdbool.h>

#define KC_PI 3.14159265358979323846
#define KC_INF HUGE_VAL

double kc_acos(double x);
double kc_atan2(double y, double x);
double kc_exp(double x);
double kc_log(double x);
double kc_log1p(double x);
double kc_tanh(double x);
double kc_floor(double x);
double kc_lgamma(double x); /* ln |gamma(x)| */

static inline double kc_sqrt(double x) { return sqrt(x); }
static inline double kc_fabs(double x) { return fabs(x); }

/* These give the second argument for a NaN in the first, unlike fmin and fmax. */
static inline double kc_min(double a, double b) { return a < b ? a : b; }
static inline double kc_max(double a, double b) { return a > b ? a : b; }
static inline double kc_clamp(double x, double lo, double hi) { return kc_min(kc_max(x, lo), hi); }

static inline bool kc_finite(double x) { return isfinite(x); }
static inline bool kc_is_zero(double x) { return kc_fabs(x) <= 0.0; } /* NaN is not */

/* Angles farther from 0 count as this one, with their sign: an arm has none, neighbouring numbers there are 1e-10
 * rad apart and more, and to reduce them exactly takes many times the instructions of smaller ones. */
#define KC_ANGLE_MAX 1e6
static inline double kc_angle(double x)
{
    if (x > KC_ANGLE_MAX) { return KC_ANGLE_MAX; }
    return x < -KC_ANGLE_MAX ? -KC_ANGLE_MAX : x; /* NaN stays NaN */
}

double kc_musl_sin(double x);
double kc_musl_cos(double x);
double kc_musl_tan(double x);
static inline double kc_sin(double x) { return kc_musl_sin(kc_angle(x)); }
static inline double kc_cos(double x) { return kc_musl_cos(kc_angle(x)); }
/* Both at once, the same bits, but that the sine of -0 is 0; the argument is reduced once. */
void kc_sincos(double x, double *sine, double *cosine);
static inline double kc_tan(double x) { return kc_musl_tan(kc_angle(x)); }

#endif
