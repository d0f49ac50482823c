#include "given_dense.h"

#include <string.h>

#include "kc_rng.h"
#include "unity.h"

#define LD_MAX 128u

double drawn(uint64_t *rng) { return 2.0 * kc_rng_uniform(rng) - 1.0; }

double dense_dot(const double *a, const double *b, uint32_t n)
{
    double s = 0.0;
    for (uint32_t i = 0u; i < n; i++) { s += a[i] * b[i]; }
    return s;
}

void dense_invert(uint32_t n, uint32_t ld, const double *in, double *out)
{
    static double a[LD_MAX * LD_MAX];
    TEST_ASSERT_TRUE(n <= ld && ld <= LD_MAX);
    memcpy(a, in, sizeof *a * ld * ld);
    memset(out, 0, sizeof *a * ld * ld);
    for (uint32_t i = 0u; i < n; i++) { out[i * (ld + 1u)] = 1.0; }
    for (uint32_t k = 0u; k < n; k++) {
        const double pivot = a[k * (ld + 1u)];
        for (uint32_t j = 0u; j < n; j++) {
            a[k * ld + j] /= pivot;
            out[k * ld + j] /= pivot;
        }
        for (uint32_t i = 0u; i < n; i++) {
            const double f = i == k ? 0.0 : a[i * ld + k];
            for (uint32_t j = 0u; j < n; j++) {
                a[i * ld + j] -= f * a[k * ld + j];
                out[i * ld + j] -= f * out[k * ld + j];
            }
        }
    }
}

void dense_solve6(const double *A, const double *b, double *x)
{
    double inverse[36];
    dense_invert(6u, 6u, A, inverse);
    for (uint32_t i = 0u; i < 6u; i++) { x[i] = dense_dot(&inverse[6u * i], b, 6u); }
}

void expect_doubles(const double *want, const double *got, uint32_t n, double tol)
{
    for (uint32_t i = 0u; i < n; i++) { TEST_ASSERT_DOUBLE_WITHIN(tol, want[i], got[i]); }
}
