/* kc_verdict.c: verdict and policy, each rule by itself. */
#include <math.h>
#include <string.h>

#include "given_tables.h"
#include "kc_verdict.h"
#include "unity.h"

static kc_config_t s_config;
static kc_est_t s_est;
static kc_verdict_case_t s_case;

void setUp(void)
{
    given_config(&s_config);
    s_config.no_change_p = 0.01;
    s_config.accept_on_board = 1u;
    s_config.accept_p_fit_min = 0.001;
    s_config.accept_sigma_max_pos_m = 0.002;
    s_config.accept_change_max_pos_m = 0.005;
    memset(&s_est, 0, sizeof s_est);
    s_est.n_obs = 20u;
    s_est.dof = 20u;
    s_est.noise_scale = 1.0;
    s_est.opt.outlier_max = 4u;
    s_case = (kc_verdict_case_t){true, false, false, 0.001, 0.002, 0.005}; /* just so */
}

static kc_verdict_t verdict(double p_fit, double p_no_change)
{
    const kc_verdict_fit_t fit = {s_est.noise_scale, p_fit, p_no_change};
    return kc_verdict(&s_config, &s_est, KC_OK, &fit, false);
}

void test_a_good_fit_says_change_or_no_change_by_the_probability_in_config(void)
{
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_CHANGE, verdict(0.5, 0.01));
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_NO_CHANGE, verdict(0.5, 0.0101));
}

void test_an_estimate_that_did_not_converge_is_poor(void)
{
    const kc_verdict_fit_t fit = {1.0, 0.5, 0.5};
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_POOR, kc_verdict(&s_config, &s_est, KC_ERR_ITER, &fit, false));
}

void test_without_degrees_of_freedom_nothing_can_be_said(void)
{
    s_est.dof = 0u;
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_POOR, verdict(1.0, 0.0));
}

void test_three_times_the_stated_noise_is_poor_whatever_the_probability(void)
{
    s_est.noise_scale = 3.0;
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_CHANGE, verdict(0.5, 0.0));
    s_est.noise_scale = 3.001;
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_POOR, verdict(0.5, 0.0));
}

void test_an_unlikely_fit_is_poor_only_with_twice_the_noise_or_all_outliers_rejected(void)
{
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_CHANGE, verdict(1e-10, 0.0));
    s_est.noise_scale = 2.001;
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_POOR, verdict(1e-10, 0.0));
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_CHANGE, verdict(1e-8, 0.0));
    s_est.noise_scale = 1.0;
    s_est.n_outliers = 4u;
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_POOR, verdict(1e-10, 0.0));
    s_est.opt.outlier_max = 0u; /* none may be rejected: then none is no sign */
    s_est.n_outliers = 0u;
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_CHANGE, verdict(1e-10, 0.0));
}

/* With outlier_max and outlier_p at their limits, half of the poses of an arm that slips are rejected and the others fit
 * well, with p near 1. */
void test_a_fit_of_what_is_left_when_a_quarter_is_rejected_is_poor(void)
{
    s_est.opt.outlier_max = KC_MEAS_MAX;
    s_est.n_outliers = 5u;
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_CHANGE, verdict(0.9, 0.0));
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_NO_CHANGE, verdict(0.9, 0.9));
    s_est.n_outliers = 6u;
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_POOR, verdict(0.9, 0.0));
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_POOR, verdict(0.9, 0.9)); /* nor is such an arm healthy */
    s_est.n_obs = 24u;
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_CHANGE, verdict(0.9, 0.0));
}

/* An encoder that slips before the last pose leaves all the others in agreement, and p near 1. */
void test_a_fit_that_rejects_the_newest_observation_is_poor(void)
{
    s_est.n_outliers = 1u;
    s_est.outlier[18] = 1u;
    TEST_ASSERT_FALSE(kc_verdict_newest_rejected(&s_est));
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_CHANGE, verdict(0.9, 0.0));
    s_est.outlier[18] = 0u;
    s_est.outlier[19] = 1u;
    TEST_ASSERT_TRUE(kc_verdict_newest_rejected(&s_est));
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_POOR, verdict(0.9, 0.0));
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_POOR, verdict(0.9, 0.9));
    s_est.n_obs = 0u;
    TEST_ASSERT_FALSE(kc_verdict_newest_rejected(&s_est));
}

void test_the_improvement_counts_in_units_of_the_noise_and_against_the_rank(void)
{
    /* two degrees of freedom: the upper tail is exp(-x / 2) */
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, exp(-3.0), kc_verdict_p_no_change(6.0, 1.0, 2u));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, exp(-3.0), kc_verdict_p_no_change(24.0, 2.0, 2u));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, exp(-3.0), kc_verdict_p_no_change(6.0, 0.5, 2u)); /* never below 1 */
    TEST_ASSERT_EQUAL_DOUBLE(1.0, kc_verdict_p_no_change(-1.0, 1.0, 2u));
    TEST_ASSERT_EQUAL_DOUBLE(1.0, kc_verdict_p_no_change(6.0, 1.0, 0u));
}

static void expect_left_to_the_ground(void)
{
    TEST_ASSERT_FALSE(kc_verdict_acceptable(&s_config, &s_case));
    setUp();
    TEST_ASSERT_TRUE(kc_verdict_acceptable(&s_config, &s_case));
}

void test_each_rule_of_the_policy_leaves_the_correction_to_the_ground(void)
{
    s_config.accept_on_board = 0u;
    expect_left_to_the_ground();
    s_case.determined = false;
    expect_left_to_the_ground();
    s_case.bounds_active = true;
    expect_left_to_the_ground();
    s_case.all_rejected = true;
    expect_left_to_the_ground();
    s_case.p_fit = 0.00099;
    expect_left_to_the_ground();
    s_case.sigma_pos_m = 0.0021;
    expect_left_to_the_ground();
    s_case.change_pos_m = 0.0051;
    expect_left_to_the_ground();
}

/* ---- found missing by mutants ---- */

void test_an_unlikely_fit_is_poor_beyond_its_thresholds_not_at_them(void)
{
    double noise = s_config.poor_noise_scale_unlikely, p = s_config.poor_p_fit;
    s_est.noise_scale = noise;
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_CHANGE, verdict(0.5 * p, 0.0));
    s_est.noise_scale = nextafter(noise, 9.0);
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_POOR, verdict(0.5 * p, 0.0));
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_POOR, verdict(nextafter(p, 0.0), 0.0));
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_CHANGE, verdict(p, 0.0));
}

/* Two tests of half the level each: together they reject a right table no more often. */
void test_after_an_early_test_half_the_level_is_left(void)
{
    s_config.no_change_p = 0.02;
    TEST_ASSERT_EQUAL_DOUBLE(0.02, kc_verdict_level(&s_config, false));
    TEST_ASSERT_EQUAL_DOUBLE(0.01, kc_verdict_level(&s_config, true));
    const kc_verdict_fit_t fit = {1.0, 0.5, 0.015};
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_CHANGE, kc_verdict(&s_config, &s_est, KC_OK, &fit, false));
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_NO_CHANGE, kc_verdict(&s_config, &s_est, KC_OK, &fit, true));
}
