#include "kc_libm.h"

#include <stdint.h>

double kc_musl_lgamma_r(double x, int *sign); /* musl's; *sign: that of gamma(x) */

/* What follows are the numbers and steps of musl's __rem_pio2.c, __sin.c and __cos.c, which come from FreeBSD:
 * Copyright (C) 1993 by Sun Microsystems, Inc. All rights reserved. Developed at SunSoft, a Sun Microsystems, Inc.
 * business. Permission to use, copy, modify, and distribute this software is freely granted, provided that this notice
 * is preserved. */
#define QUARTERS_PER_RAD 6.36619772367581382433e-01
#define WHOLE 6755399441055744.0 /* 1.5 x 2^52: a smaller number plus and minus it is whole */
#define QUARTER 1.57079632673412561417e+00 /* first 33 bits of pi/2, and the rest */
#define QUARTER_REST 6.07710050650619224932e-11

/* Within these an angle is inside of its quadrant, and one step reduces it: then musl's choice of the quadrant is
 * the nearest one, and its result that of this step. */
#define INSIDE_RAD 0.78538
#define INSIDE_PART 0x1p-15

/* Every angle takes the same way through here, whatever quadrant it is in: a processor that foretells branches cannot
 * know the quadrant of the next joint, and each wrong guess takes longer than the polynomials. */
void kc_sincos(double x, double *sine, double *cosine)
{
    const double angle = kc_angle(x);
    const double quarters = angle * QUARTERS_PER_RAD + WHOLE - WHOLE;
    const double r = angle - quarters * QUARTER, rest = quarters * QUARTER_REST;
    const double a = r - rest, b = r - a - rest; /* a + b: the angle in its quadrant */
    const double size = kc_fabs(a);
    if (!(size < INSIDE_RAD && size > INSIDE_PART * kc_fabs(angle))) { /* at a border, 0, or NaN */
        *cosine = kc_musl_cos(angle);
        *sine = kc_musl_sin(angle + 0.0); /* no -0 */
        return;
    }
    const double z = a * a, w = z * z, v = z * a;
    const double sp = 8.33333333332248946124e-03 +
                      z * (-1.98412698298579493134e-04 + z * 2.75573137070700676789e-06) +
                      z * w * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10);
    const double cp = z * (4.16666666666666019037e-02 +
                           z * (-1.38888888888741095749e-03 + z * 2.48015872894767294178e-05)) +
                      w * w *
                          (-2.75573143513906633035e-07 +
                           z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11));
    const double s1 = -1.66666666666666324348e-01, half = 0.5 * z, most = 1.0 - half;
    /* An angle that is its own remainder has b = 0, and musl a shorter formula for its sine. */
    const double change[2] = {v * s1 - (z * (0.5 * b - v * sp) - b), v * (s1 + z * sp)};
    const int32_t quadrant = (int32_t)quarters; /* within +-636620 */
    const double s = a + change[quadrant == 0 ? 1u : 0u];
    const double c = most + (1.0 - most - half + (z * cp - a * b));
    const double turned[4] = {s, c, -s, -c}; /* sines of quadrants; a cosine is the sine of the next one */
    *sine = turned[(uint32_t)quadrant & 3u];
    *cosine = turned[((uint32_t)quadrant + 1u) & 3u];
}

double kc_lgamma(double x)
{
    int sign;
    return kc_musl_lgamma_r(x, &sign);
}
