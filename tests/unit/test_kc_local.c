/* kc_local.c: doubt about the arm, and the power of that test, each rule by itself. Reference values: scipy 1.11,
 * chi2.sf and chi2.isf. */
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "given_tables.h"
#include "kc_local.h"
#include "unity.h"

static kc_config_t s_config;
static kc_est_t s_est;

void setUp(void)
{
    given_config(&s_config);
    memset(&s_est, 0, sizeof s_est);
    s_est.n_obs = 3u;
    s_est.cost = 30.0;
}

void test_a_cost_that_an_arm_inside_its_bounds_hardly_has_casts_doubt(void)
{
    double p = 0.0;
    TEST_ASSERT_FALSE(kc_local_doubt(&s_config, &s_est, KC_OK, &p));
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.037446493479672875, p); /* 18 rows */
    s_est.cost = 34.7;
    TEST_ASSERT_FALSE(kc_local_doubt(&s_config, &s_est, KC_OK, NULL));
    s_est.cost = 34.9;
    TEST_ASSERT_TRUE(kc_local_doubt(&s_config, &s_est, KC_OK, NULL));
    s_est.cost = 30.0;
    s_config.doubt_p = p;
    TEST_ASSERT_FALSE(kc_local_doubt(&s_config, &s_est, KC_OK, NULL));
    s_config.doubt_p = 0.0;
    s_est.cost = 34.9;
    TEST_ASSERT_FALSE(kc_local_doubt(&s_config, &s_est, KC_OK, NULL));
}

void test_what_failed_or_left_something_out_casts_doubt(void)
{
    double p = 1.0;
    TEST_ASSERT_FALSE(kc_local_doubt(&s_config, &s_est, KC_ERR_ITER, NULL));
    TEST_ASSERT_TRUE(kc_local_doubt(&s_config, &s_est, KC_ERR_NUM, &p));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, p);
    s_est.n_outliers = 1u;
    s_est.cost = 0.0;
    TEST_ASSERT_TRUE(kc_local_doubt(&s_config, &s_est, KC_OK, NULL));
    s_est.n_outliers = s_est.n_obs = 0u;
    TEST_ASSERT_TRUE(kc_local_doubt(&s_config, &s_est, KC_OK, NULL));
}

void test_rows_are_those_of_the_observations_used(void)
{
    TEST_ASSERT_EQUAL_UINT32(18u, kc_local_rows(&s_est));
    s_est.n_outliers = 2u;
    TEST_ASSERT_EQUAL_UINT32(6u, kc_local_rows(&s_est));
}

/* 4 chi^2(m) + (rows - m) above the quantile of chi^2(rows). */
void test_power_is_that_of_errors_twice_as_large_in_what_is_determined(void)
{
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, 0.6492299249859680, kc_local_power(&s_config, 6u, 6.0));
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, 0.8523127267469868, kc_local_power(&s_config, 12u, 11.9));
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, 0.9257192422993672, kc_local_power(&s_config, 18u, 15.0));
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, 0.6492299249859680,
                              kc_local_power(&s_config, 6u, 9.0)); /* no more than rows */
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, 0.0857197081792959, kc_local_power(&s_config, 6u, 1.0));
    s_config.outside_factor = 4.0;
    TEST_ASSERT_TRUE(kc_local_power(&s_config, 18u, 15.0) > 0.999);
}

void test_what_determines_nothing_has_no_power(void)
{
    TEST_ASSERT_EQUAL_DOUBLE(0.0, kc_local_power(&s_config, 18u, 0.0));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, kc_local_power(&s_config, 18u, -1e-9));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, kc_local_power(&s_config, 18u, 0.99));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, kc_local_power(&s_config, 18u, (double)NAN));
}
