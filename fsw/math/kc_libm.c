#include "kc_libm.h"

#include <stdint.h>

double kc_musl_lgamma_r(double x, int *sign); /* musl's; *sign: that of gamma(x) */

int kc_musl_rem_pio2(double x, double *y);  /* musl's: quadrant, and y[0] + y[1] in it */
double kc_musl_sin_kernel(double x, double y, int has_y); /* of x + y, up to pi/4 */
double kc_musl_cos_kernel(double x, double y);

/* Where musl's sine and cosine begin to reduce their argument: pi/4 in single precision. */
#define REDUCED_FROM 0.7853984832763671875

void kc_sincos(double x, double *sine, double *cosine)
{
    double y[2] = {kc_angle(x), 0.0};
    const bool reduce = !(kc_fabs(y[0]) < REDUCED_FROM); /* NaN too */
    const uint32_t quadrant = reduce ? (uint32_t)kc_musl_rem_pio2(y[0], y) & 3u : 0u;
    const double s = kc_musl_sin_kernel(y[0], y[1], reduce ? 1 : 0), c = kc_musl_cos_kernel(y[0], y[1]);
    const bool odd = (quadrant & 1u) != 0u;
    const double along = odd ? c : s, across = odd ? s : c;
    *sine = (quadrant & 2u) != 0u ? -along : along;
    *cosine = quadrant == 1u || quadrant == 2u ? -across : across;
}

double kc_lgamma(double x)
{
    int sign;
    return kc_musl_lgamma_r(x, &sign);
}
