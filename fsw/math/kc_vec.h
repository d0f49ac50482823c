/* Three-vectors, 3x3 matrices (row-major), and the product of vectors of n numbers, inline. out may not alias an input
 * unless said. */
#ifndef KC_VEC_H
#define KC_VEC_H

#include <stdbool.h>
#include <stdint.h>

#include "kc_libm.h"

static inline double kc_v3_dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static inline double kc_v_dot(const double *a, const double *b, uint32_t n)
{
    double s = 0.0;
    for (uint32_t i = 0u; i < n; i++) { s += a[i] * b[i]; }
    return s;
}

static inline double kc_v3_norm(const double a[3]) { return kc_sqrt(kc_v3_dot(a, a)); }

static inline void kc_v3_cross(const double a[3], const double b[3], double out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* What follows is written out: compiled for flight, a loop of three stays a loop, and keeps what it fills in memory. */

/* out = a - b; out may alias. */
static inline void kc_v3_sub(const double a[3], const double b[3], double out[3])
{
    out[0] = a[0] - b[0];
    out[1] = a[1] - b[1];
    out[2] = a[2] - b[2];
}

/* out = a + s b; out may alias. */
static inline void kc_v3_add_scaled(const double a[3], double s, const double b[3], double out[3])
{
    out[0] = a[0] + s * b[0];
    out[1] = a[1] + s * b[1];
    out[2] = a[2] + s * b[2];
}

static inline void kc_v3_copy(const double a[3], double out[3])
{
    out[0] = a[0];
    out[1] = a[1];
    out[2] = a[2];
}

/* out = R v */
static inline void kc_m3_mul_v3(const double R[9], const double v[3], double out[3])
{
    out[0] = R[0] * v[0] + R[1] * v[1] + R[2] * v[2];
    out[1] = R[3] * v[0] + R[4] * v[1] + R[5] * v[2];
    out[2] = R[6] * v[0] + R[7] * v[1] + R[8] * v[2];
}

/* out = R^T v */
static inline void kc_m3t_mul_v3(const double R[9], const double v[3], double out[3])
{
    out[0] = R[0] * v[0] + R[3] * v[1] + R[6] * v[2];
    out[1] = R[1] * v[0] + R[4] * v[1] + R[7] * v[2];
    out[2] = R[2] * v[0] + R[5] * v[1] + R[8] * v[2];
}

/* Column c of R: axis c of the frame. */
static inline void kc_m3_col(const double R[9], uint32_t c, double out[3])
{
    out[0] = R[c];
    out[1] = R[3u + c];
    out[2] = R[6u + c];
}

/* Columns u and v of R turn about the third. */
static inline void kc_m3_turn(double R[9], uint32_t u, uint32_t v, double sine, double cosine)
{
    const double a[3] = {R[u], R[3u + u], R[6u + u]}, b[3] = {R[v], R[3u + v], R[6u + v]};
    R[u] = cosine * a[0] + sine * b[0];
    R[3u + u] = cosine * a[1] + sine * b[1];
    R[6u + u] = cosine * a[2] + sine * b[2];
    R[v] = cosine * b[0] - sine * a[0];
    R[3u + v] = cosine * b[1] - sine * a[1];
    R[6u + v] = cosine * b[2] - sine * a[2];
}

/* out = A B */
static inline void kc_m3_mul(const double A[9], const double B[9], double out[9])
{
    for (uint32_t i = 0u; i < 9u; i += 3u) {
        const double a = A[i], b = A[i + 1u], c = A[i + 2u];
        out[i] = a * B[0] + b * B[3] + c * B[6];
        out[i + 1u] = a * B[1] + b * B[4] + c * B[7];
        out[i + 2u] = a * B[2] + b * B[5] + c * B[8];
    }
}

static inline bool kc_v_finite(const double *v, uint32_t n)
{
    double zero[4] = {0.0, 0.0, 0.0,
                      0.0}; /* 0 times what is not finite is NaN; four sums wait for no other */
    uint32_t i = 0u;
    for (; i + 4u <= n; i += 4u) {
        zero[0] += 0.0 * v[i];
        zero[1] += 0.0 * v[i + 1u];
        zero[2] += 0.0 * v[i + 2u];
        zero[3] += 0.0 * v[i + 3u];
    }
    for (; i < n; i++) { zero[0] += 0.0 * v[i]; }
    return kc_is_zero((zero[0] + zero[1]) + (zero[2] + zero[3]));
}

#endif
