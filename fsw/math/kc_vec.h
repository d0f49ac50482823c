/* Three-vectors and 3x3 matrices (row-major), inline. out may not alias an input unless said. */
#ifndef KC_VEC_H
#define KC_VEC_H

#include <stdbool.h>
#include <stdint.h>

#include "kc_libm.h"

static inline double kc_v3_dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static inline double kc_v3_norm(const double a[3]) { return kc_sqrt(kc_v3_dot(a, a)); }

static inline void kc_v3_cross(const double a[3], const double b[3], double out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* out = a - b; out may alias. */
static inline void kc_v3_sub(const double a[3], const double b[3], double out[3])
{
    for (int i = 0; i < 3; i++) { out[i] = a[i] - b[i]; }
}

/* out = a + s b; out may alias. */
static inline void kc_v3_add_scaled(const double a[3], double s, const double b[3], double out[3])
{
    for (int i = 0; i < 3; i++) { out[i] = a[i] + s * b[i]; }
}

static inline void kc_v3_copy(const double a[3], double out[3])
{
    for (int i = 0; i < 3; i++) { out[i] = a[i]; }
}

/* out = R v */
static inline void kc_m3_mul_v3(const double R[9], const double v[3], double out[3])
{
    for (int i = 0; i < 3; i++) { out[i] = R[3 * i] * v[0] + R[3 * i + 1] * v[1] + R[3 * i + 2] * v[2]; }
}

/* out = R^T v */
static inline void kc_m3t_mul_v3(const double R[9], const double v[3], double out[3])
{
    for (int i = 0; i < 3; i++) { out[i] = R[i] * v[0] + R[3 + i] * v[1] + R[6 + i] * v[2]; }
}

/* Column c of R: axis c of the frame. */
static inline void kc_m3_col(const double R[9], uint32_t c, double out[3])
{
    for (uint32_t i = 0; i < 3u; i++) { out[i] = R[3u * i + c]; }
}

/* out = A B */
static inline void kc_m3_mul(const double A[9], const double B[9], double out[9])
{
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            out[3 * i + j] = A[3 * i] * B[j] + A[3 * i + 1] * B[3 + j] + A[3 * i + 2] * B[6 + j];
        }
    }
}

static inline bool kc_v_finite(const double *v, uint32_t n)
{
    bool ok = true;
    for (uint32_t i = 0; i < n; i++) { ok = ok && kc_finite(v[i]); }
    return ok;
}

#endif
