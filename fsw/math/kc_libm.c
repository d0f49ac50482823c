#include "kc_libm.h"

double kc_musl_lgamma_r(double x, int *sign); /* musl's; *sign: that of gamma(x) */

double kc_lgamma(double x)
{
    int sign;
    return kc_musl_lgamma_r(x, &sign);
}
