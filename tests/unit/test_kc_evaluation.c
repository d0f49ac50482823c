/* kc_evaluation.c: the power of the test of the active table, by hand in two coefficients. Sums over poses
 * and candidates: test_propose.c. */
#include <string.h>

#include "kc_chi2.h"
#include "kc_evaluation.h"
#include "unity.h"

#define LEVEL 0.01

static kc_evaluation_t s_evaluation;
static kc_evaluated_t s_evaluated;
static kc_active_t s_tables;
static kc_est_t s_est;
static kc_eval_t s_eval;
static double s_chain[6][KC_CHAIN_COUNT];

/* Coefficient 0 moves the tool by 2 m and turns it by 0.5 rad for each unit, coefficient 1 only turns it, by
 * 1 rad. For errors of 20 mm and 20 mrad they are 0.01 and 0.02 in size; their chi-square is 10 and 20. */
void setUp(void)
{
    memset(&s_evaluated, 0, sizeof s_evaluated);
    memset(&s_est, 0, sizeof s_est);
    s_tables.terms.n_coef = 2u;
    s_tables.config.stop_pos_m = s_tables.config.stop_rot_rad = 0.02;
    s_est.terms = &s_tables.terms;
    s_est.rank = 2u;
    s_est.status[0] = s_est.status[1] = (uint8_t)KC_COEF_ESTIMATED;
    s_eval.J[0][0] = 2.0;
    s_eval.J[0][5] = 0.5;
    s_eval.J[1][5] = 1.0;
    kc_consider_begin(&s_evaluation.chain);
    s_evaluation.chain.JJ[0] = 1e5;
    s_evaluation.chain.JJ[1] = 5e4;
    kc_accuracy_begin(&s_evaluation.error, &s_est);
    kc_accuracy_add(&s_evaluation.error, &s_eval, s_chain);
}

static double power(bool with_chain)
{
    const kc_view_t view = {.tables = &s_tables, .est = &s_est};
    return kc_evaluation_power(&s_evaluated, &s_evaluation, &view, LEVEL, with_chain);
}

static double power_of(double chi2)
{
    return kc_chi2_noncentral_sf(kc_chi2_quantile(LEVEL, s_est.rank), s_est.rank, chi2);
}

void test_power_is_that_of_the_error_that_shows_least(void)
{
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, power_of(10.0), power(false));
    s_evaluation.chain.JJ[1] = 1e4;
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, power_of(4.0), power(false));
}

void test_a_coefficient_that_is_not_estimated_has_no_part_in_the_power(void)
{
    s_evaluation.chain.JJ[1] = 1e4;
    s_est.status[1] = (uint8_t)KC_COEF_MASKED;
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, power_of(10.0), power(false));
}

/* Coefficient 0 turns the tool by 20 mrad if it is off by 0.04. */
void test_without_a_required_position_the_rotation_alone_counts(void)
{
    s_tables.config.stop_pos_m = 0.0;
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, power_of(20.0), power(false));
    s_evaluation.chain.JJ[1] = 1e6;
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, power_of(160.0), power(false));
}

void test_without_a_required_rotation_a_coefficient_that_only_turns_the_tool_may_be_hidden(void)
{
    s_tables.config.stop_rot_rad = 0.0;
    s_evaluation.chain.JJ[1] = 1.0;
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, power_of(10.0), power(false));
}

/* By half a metre for each unit, so that 20 mm are 0.04. */
void test_a_coefficient_that_moves_the_tool_little_counts_too(void)
{
    s_eval.J[0][0] = 0.5;
    kc_accuracy_begin(&s_evaluation.error, &s_est);
    kc_accuracy_add(&s_evaluation.error, &s_eval, s_chain);
    s_eval.J[0][0] = 2.0;
    s_tables.config.stop_rot_rad = 0.0;
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, power_of(160.0), power(false));
}

void test_power_with_the_chain_is_by_what_it_leaves_visible(void)
{
    s_evaluation.chain.visible[0] = 5e4;
    s_evaluation.chain.visible[1] = 5e4;
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, power_of(5.0), power(true));
}

/* Noise beyond what is stated hides more, noise below it shows no more. */
void test_noise_larger_than_stated_takes_power(void)
{
    s_evaluated.fit.noise_scale = 2.0;
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, power_of(2.5), power(false));
    s_evaluated.fit.noise_scale = 0.5;
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, power_of(10.0), power(false));
}
