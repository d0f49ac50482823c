/* kc_chi2.c: known values; the whole range is compared with scipy in tests/oracle/test_estimate.py. */
#include <math.h>

#include "kc_chi2.h"
#include "kc_estimate.h"
#include "unity.h"

void test_two_degrees_of_freedom_are_an_exponential(void)
{
    for (int i = 1; i < 60; i++) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-13 * exp(-0.5 * i) + 1e-15, exp(-0.5 * i), kc_chi2_sf((double)i, 2u));
    }
}

void test_textbook_5_percent_points(void)
{
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.05, kc_chi2_sf(3.841458820694124, 1u));
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.05, kc_chi2_sf(12.591587243743977, 6u));
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.05, kc_chi2_sf(113.14527014255, 90u));
}

void test_nothing_observed_is_certain(void)
{
    TEST_ASSERT_TRUE(kc_chi2_sf(0.0, 6u) >= 1.0);
    TEST_ASSERT_TRUE(kc_chi2_sf(-1.0, 6u) >= 1.0);
}

void test_far_tail_is_small_but_never_negative(void)
{
    TEST_ASSERT_TRUE(kc_chi2_sf(1000.0, 6u) > 0.0);
    TEST_ASSERT_TRUE(kc_chi2_sf(1e6, 6u) >= 0.0);
    TEST_ASSERT_TRUE(kc_chi2_sf(1e-300, 384u) <= 1.0);
}

void test_it_falls_with_chi2_and_rises_with_degrees_of_freedom(void)
{
    for (uint32_t dof = 1u; dof <= 384u; dof += 7u) {
        for (double x = 0.5; x < 500.0; x *= 1.3) {
            TEST_ASSERT_TRUE(kc_chi2_sf(x * 1.1, dof) <= kc_chi2_sf(x, dof));
            TEST_ASSERT_TRUE(kc_chi2_sf(x, dof + 1u) >= kc_chi2_sf(x, dof));
        }
    }
}

void test_nan_stays_nan(void) { TEST_ASSERT_TRUE(isnan(kc_chi2_sf(NAN, 3u))); }

/* Far beyond the degrees of freedom of a calibration the sums are cut off, but the answer stays a probability. */
void test_more_degrees_of_freedom_than_it_is_made_for_give_a_probability(void)
{
    const uint32_t dof[] = {2000000u, 1000000000u};
    for (uint32_t i = 0u; i < 2u; i++) {
        for (double part = 0.99; part < 1.01; part += 0.001) {
            double p = kc_chi2_sf(part * (double)dof[i], dof[i]);
            TEST_ASSERT_TRUE(p >= 0.0 && p <= 1.0);
        }
        double just = kc_chi2_sf((double)dof[i] + 2.001, dof[i]);
        TEST_ASSERT_TRUE(just >= 0.0 && just <= 1.0);
    }
}

/* scipy: chi2.isf */
void test_quantiles_of_the_upper_tail(void)
{
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 6.2513886311703235, kc_chi2_quantile(0.1, 3u));
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 16.26623619623813, kc_chi2_quantile(1e-3, 3u));
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 34.805305734705065, kc_chi2_quantile(0.01, 18u));
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 15.136705226623397, kc_chi2_quantile(1e-4, 1u));
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, 383.3335394860787, kc_chi2_quantile(0.5, 384u));
}

/* (z + sqrt(ncp))^2 and a central one of the other degrees of freedom: integrated over z by Simpson. */
static double noncentral(double chi2, uint32_t dof, double ncp)
{
    const int32_t n = 6000;
    const double h = 18.0 / (double)n;
    double sum = 0.0;
    for (int32_t i = 0; i <= n; i++) {
        const double z = -9.0 + h * (double)i, first = z + sqrt(ncp);
        const double weight = i == 0 || i == n ? 1.0 : i % 2 != 0 ? 4.0 : 2.0;
        sum += weight * exp(-0.5 * z * z) * kc_chi2_sf(chi2 - first * first, dof - 1u);
    }
    return sum * h / 3.0 / sqrt(2.0 * 3.14159265358979323846);
}

void test_the_noncentral_tail_is_that_of_a_shifted_normal_and_a_central_one(void)
{
    static const double ncp[] = {0.0, 0.3, 4.0, 25.0, 90.0, 200.0};
    for (uint32_t k = 0u; k < sizeof ncp / sizeof ncp[0]; k++) {
        for (uint32_t dof = 4u; dof <= 40u; dof += 12u) {
            for (double part = 0.4; part < 2.0; part += 0.5) {
                const double chi2 = part * ((double)dof + ncp[k]);
                TEST_ASSERT_DOUBLE_WITHIN(1e-5, noncentral(chi2, dof, ncp[k]),
                                          kc_chi2_noncentral_sf(chi2, dof, ncp[k]));
            }
        }
    }
    TEST_ASSERT_EQUAL_DOUBLE(kc_chi2_sf(9.0, 5u), kc_chi2_noncentral_sf(9.0, 5u, 0.0));
    TEST_ASSERT_EQUAL_DOUBLE(kc_chi2_noncentral_sf(150.0, 9u, 200.0),
                             kc_chi2_noncentral_sf(150.0, 9u, 999.0));
}

/* Where the tail is p, for degrees of freedom that are no whole number as well. */
void test_a_quantile_is_where_the_tail_has_its_probability(void)
{
    static const double p[] = {1e-4, 1e-3, 0.05, 0.5, 0.95};
    for (uint32_t k = 0u; k < sizeof p / sizeof p[0]; k++) {
        for (uint32_t dof = 1u; dof < 80u; dof += 7u) {
            const double at = kc_chi2_quantile(p[k], dof);
            TEST_ASSERT_DOUBLE_WITHIN(1e-8 + 1e-7 * p[k], p[k], kc_chi2_sf(at, dof));
            TEST_ASSERT_EQUAL_DOUBLE(at, kc_chi2_quantile_real(p[k], (double)dof));
            const double between = kc_chi2_quantile_real(p[k], (double)dof + 0.5);
            TEST_ASSERT_TRUE(between > at && between < kc_chi2_quantile(p[k], dof + 1u));
        }
    }
}
