/* kc_fit.c: second start, trust, certainty, model mismatch, each rule by itself. */
#include <math.h>
#include <string.h>

#include "given_tables.h"
#include "kc_fit.h"
#include "unity.h"

static kc_config_t s_config;
static kc_terms_t s_terms;
static kc_est_t s_est;
static kc_residual_t s_residual[KC_MEAS_MAX];
static uint32_t s_worst;

static bool mismatch(uint32_t n_meas, uint32_t n_local);

void setUp(void)
{
    given_config(&s_config);
    given_terms(&s_terms);
    s_config.mismatch_pos_m = 0.02;
    s_config.mismatch_rot_rad = 0.06;
    s_config.stop_pos_m = 0.001;
    s_config.stop_rot_rad = 0.01;
    s_config.a1 = 0.5;
    s_config.vopt_len_m = 0.5;
    memset(&s_est, 0, sizeof s_est);
    memset(s_residual, 0, sizeof s_residual);
    s_est.terms = &s_terms;
    s_est.opt.free_mask = UINT64_MAX;
    s_est.rank = s_est.n_free = 28u;
    s_est.dof = 30u;
    s_est.noise_scale = 1.0;
    s_est.cost = 10.0;
}

void test_a_solution_is_there_when_it_converged_or_stopped_at_its_best(void)
{
    TEST_ASSERT_TRUE(kc_fit_solved(KC_OK) && kc_fit_solved(KC_ERR_ITER));
    TEST_ASSERT_FALSE(kc_fit_solved(KC_ERR_RANK) || kc_fit_solved(KC_ERR_NUM) || kc_fit_solved(KC_ERR_ARG));
}

void test_a_second_start_is_for_fits_that_failed_are_noisy_or_rejected_a_pose(void)
{
    kc_fit_quality_t q = kc_fit_quality(&s_est, KC_OK);
    TEST_ASSERT_FALSE(kc_fit_needs_second_start(&s_config, &q));
    q = kc_fit_quality(&s_est, KC_ERR_ITER);
    TEST_ASSERT_TRUE(kc_fit_needs_second_start(&s_config, &q));
    s_est.noise_scale = 2.0; /* up to there */
    q = kc_fit_quality(&s_est, KC_OK);
    TEST_ASSERT_FALSE(kc_fit_needs_second_start(&s_config, &q));
    s_est.noise_scale = 2.001;
    q = kc_fit_quality(&s_est, KC_OK);
    TEST_ASSERT_TRUE(kc_fit_needs_second_start(&s_config, &q));
    s_est.noise_scale = 1.0;
    s_est.n_outliers = 1u;
    q = kc_fit_quality(&s_est, KC_OK);
    TEST_ASSERT_TRUE(kc_fit_needs_second_start(&s_config, &q));
}

void test_fewer_outliers_win_then_the_lower_cost(void)
{
    kc_fit_quality_t first = {KC_OK, 1.0, 10.0, 1u, true}, second = first;
    TEST_ASSERT_FALSE(kc_fit_second_is_better(&first, &second)); /* as good is not better */
    second.cost = 9.0;
    TEST_ASSERT_TRUE(kc_fit_second_is_better(&first, &second));
    second.n_outliers = 2u;
    TEST_ASSERT_FALSE(kc_fit_second_is_better(&first, &second));
    second.n_outliers = 0u;
    second.cost = 99.0;
    TEST_ASSERT_TRUE(kc_fit_second_is_better(&first, &second));
}

void test_a_second_start_that_holds_a_coefficient_or_fails_never_wins(void)
{
    kc_fit_quality_t first = {KC_ERR_NUM, 1.0, 0.0, 1u, true}, second = {KC_OK, 1.0, 1.0, 0u, false};
    TEST_ASSERT_FALSE(kc_fit_second_is_better(&first, &second));
    second.nothing_held = true;
    second.status = KC_ERR_NUM;
    TEST_ASSERT_FALSE(kc_fit_second_is_better(&first, &second));
}

void test_an_unsolved_first_fit_loses_to_any_solution_with_as_many_outliers(void)
{
    kc_fit_quality_t first = kc_fit_quality(&s_est, KC_ERR_NUM), second = kc_fit_quality(&s_est, KC_OK);
    TEST_ASSERT_TRUE(kc_fit_second_is_better(&first, &second));
    s_est.rank = 20u;
    TEST_ASSERT_FALSE(kc_fit_quality(&s_est, KC_OK).nothing_held);
    s_est.hold_none = 1u;
    TEST_ASSERT_TRUE(kc_fit_quality(&s_est, KC_OK).nothing_held);
}

void test_an_estimate_is_trusted_when_it_predicts_twice_as_well(void)
{
    kc_residual_t used = {0.1, 0.2}; /* 0.5 x 0.1 / 0.5 + 0.5 x 0.2 = 0.2 */
    TEST_ASSERT_TRUE(kc_fit_predicts_better(&s_config, (kc_residual_t){0.05, 0.09}, used));
    TEST_ASSERT_FALSE(kc_fit_predicts_better(&s_config, (kc_residual_t){0.05, 0.11}, used));
}

void test_an_estimate_is_determined_by_twice_as_many_rows_as_coefficients(void)
{
    TEST_ASSERT_TRUE(kc_fit_determined(&s_est, KC_OK));
    TEST_ASSERT_FALSE(kc_fit_determined(&s_est, KC_ERR_ITER));
    s_est.dof = 28u; /* as many as coefficients */
    TEST_ASSERT_TRUE(kc_fit_determined(&s_est, KC_OK));
    s_est.dof = 27u;
    TEST_ASSERT_FALSE(kc_fit_determined(&s_est, KC_OK));
    s_est.dof = 30u;
    s_est.rank = 27u;
    TEST_ASSERT_FALSE(kc_fit_determined(&s_est, KC_OK));
}

void test_both_requirements_have_to_be_met(void)
{
    TEST_ASSERT_TRUE(kc_fit_meets(&s_config, (kc_residual_t){0.001, 0.01}));
    TEST_ASSERT_FALSE(kc_fit_meets(&s_config, (kc_residual_t){0.0011, 0.01}));
    TEST_ASSERT_FALSE(kc_fit_meets(&s_config, (kc_residual_t){0.001, 0.011}));
}

/* Required and bound, of position and of rotation; 0: not required. */
void test_each_requirement_counts_by_itself_however_small(void)
{
    static const double limit[] = {0.0, 1e-6, 0.02, 1.5};
    for (uint32_t k = 0u; k < 16u; k++) {
        const double pos = limit[k / 4u], rot = limit[k % 4u];
        s_config.stop_pos_m = pos;
        s_config.stop_rot_rad = rot;
        TEST_ASSERT_EQUAL_INT(k > 0u, kc_fit_required(&s_config));
        TEST_ASSERT_EQUAL_INT(k > 0u, kc_fit_meets(&s_config, (kc_residual_t){pos, rot}));
        TEST_ASSERT_EQUAL_INT(k > 0u && k / 4u == 0u,
                              kc_fit_meets(&s_config, (kc_residual_t){pos + 1e-9, rot}));
        TEST_ASSERT_EQUAL_INT(k > 0u && k % 4u == 0u,
                              kc_fit_meets(&s_config, (kc_residual_t){pos, rot + 1e-9}));
    }
}

/* Each limit by itself, at it and beyond it. */
void test_a_residual_at_a_limit_of_the_mismatch_is_none(void)
{
    for (uint32_t i = 0u; i < 4u; i++) {
        s_residual[i] = (kc_residual_t){0.02, 0.06};
        TEST_ASSERT_FALSE(mismatch(4u, 4u));
        s_residual[i] = i % 2u == 0u ? (kc_residual_t){0.0201, 0.0} : (kc_residual_t){0.0, 0.0601};
        TEST_ASSERT_TRUE(mismatch(4u, 4u));
        TEST_ASSERT_EQUAL_UINT32(i, s_worst);
        s_residual[i] = (kc_residual_t){0.0, 0.0};
    }
}

void test_a_requirement_of_zero_is_none(void)
{
    s_config.stop_rot_rad = 0.0;
    TEST_ASSERT_TRUE(kc_fit_meets(&s_config, (kc_residual_t){0.001, 9.0}));
    TEST_ASSERT_TRUE(kc_fit_required(&s_config));
    s_config.stop_pos_m = 0.0;
    TEST_ASSERT_FALSE(kc_fit_meets(&s_config, (kc_residual_t){0.0, 0.0}));
    TEST_ASSERT_FALSE(kc_fit_required(&s_config));
}

/* So many poses, an observation each. */
static bool mismatch(uint32_t n_meas, uint32_t n_local)
{
    static kc_plan_t plan;
    plan.n_meas = plan.n_obs = n_meas;
    plan.n_local = n_local;
    for (uint32_t i = 0u; i < n_meas; i++) { plan.pose_of[i] = (uint8_t)(i + 1u); }
    return kc_fit_mismatch(&s_config, &s_est, s_residual, &plan, &s_worst);
}

void test_two_observations_of_one_pose_are_one_that_does_not_fit(void)
{
    /* a local initial pose; a pose with two observations on the way; the next one with one */
    kc_plan_t plan = {.n_meas = 3u, .n_obs = 6u, .n_local = 1u, .pose_of = {1u, 2u, 2u, 2u, 3u, 3u}};
    s_residual[1].pos_m = s_residual[2].pos_m = s_residual[3].pos_m = 0.021;
    TEST_ASSERT_FALSE(kc_fit_mismatch(&s_config, &s_est, s_residual, &plan, &s_worst));
    s_residual[4].pos_m = 0.021;
    TEST_ASSERT_TRUE(kc_fit_mismatch(&s_config, &s_est, s_residual, &plan, &s_worst));
    TEST_ASSERT_EQUAL_UINT32(4u, s_worst);
}

void test_one_observation_beyond_the_limits_is_enough_at_local_poses_two_later(void)
{
    TEST_ASSERT_FALSE(mismatch(5u, 5u));
    s_residual[2].pos_m = 0.021;
    TEST_ASSERT_TRUE(mismatch(5u, 5u));
    TEST_ASSERT_EQUAL_UINT32(2u, s_worst);
    TEST_ASSERT_FALSE(mismatch(6u, 5u));
    s_residual[4].rot_rad = 0.061;
    TEST_ASSERT_TRUE(mismatch(6u, 5u));
    TEST_ASSERT_EQUAL_UINT32(4u, s_worst); /* the newest */
}

void test_a_held_coefficient_excuses_everything_unless_none_may_be_held(void)
{
    s_residual[0].pos_m = 1.0;
    s_est.rank = 27u;
    TEST_ASSERT_FALSE(mismatch(1u, 1u));
    s_est.hold_none = 1u;
    TEST_ASSERT_TRUE(mismatch(1u, 1u));
}

void test_a_limit_of_zero_is_not_checked(void)
{
    s_residual[0] = (kc_residual_t){1.0, 1.0};
    s_config.mismatch_pos_m = 0.0;
    TEST_ASSERT_TRUE(mismatch(1u, 1u));
    s_config.mismatch_rot_rad = 0.0;
    TEST_ASSERT_FALSE(mismatch(1u, 1u));
    s_est.hold_none = 1u;
    s_est.n_outliers = 3u;
    TEST_ASSERT_FALSE(mismatch(1u, 1u));
}

void test_local_poses_that_are_all_a_little_off_are_another_arm(void)
{
    s_est.hold_none = 1u;
    s_est.dof = 12u;
    s_est.noise_scale = 3.501;
    TEST_ASSERT_TRUE(mismatch(5u, 5u));
    TEST_ASSERT_EQUAL_UINT32(4u, s_worst);
    s_est.noise_scale = 3.5;
    TEST_ASSERT_FALSE(mismatch(5u, 5u));
    s_est.noise_scale = 3.501;
    s_est.dof = 11u;
    TEST_ASSERT_FALSE(mismatch(5u, 5u));
    s_est.n_outliers = 3u;
    TEST_ASSERT_TRUE(mismatch(5u, 5u));
}

void test_noise_and_outliers_of_other_poses_are_no_other_arm(void)
{
    s_est.hold_none = 1u;
    s_est.dof = 12u;
    s_est.noise_scale = 3.501;
    s_est.n_outliers = 3u;
    TEST_ASSERT_TRUE(mismatch(5u, 5u));
    TEST_ASSERT_FALSE(mismatch(6u, 5u));
}

void test_one_limit_is_enough_for_local_poses_to_be_checked(void)
{
    s_est.hold_none = 1u;
    s_est.n_outliers = 3u;
    s_config.mismatch_rot_rad = 0.0;
    TEST_ASSERT_TRUE(mismatch(5u, 5u));
    s_config.mismatch_rot_rad = 0.06;
    s_config.mismatch_pos_m = 0.0;
    TEST_ASSERT_TRUE(mismatch(5u, 5u));
}

void test_an_observation_that_is_left_out_is_no_mismatch_and_no_outlier(void)
{
    s_residual[2].pos_m = 0.021;
    s_est.without = 3u;
    TEST_ASSERT_FALSE(mismatch(5u, 5u));
    s_residual[4].pos_m = 0.021;
    TEST_ASSERT_TRUE(mismatch(5u, 5u));
    TEST_ASSERT_FALSE(mismatch(6u, 5u)); /* one of two */
    s_residual[4].pos_m = 0.0;
    s_est.hold_none = 1u;
    s_est.n_outliers = 3u; /* the third is the one left out */
    TEST_ASSERT_FALSE(mismatch(5u, 5u));
    s_est.n_outliers = 4u;
    TEST_ASSERT_TRUE(mismatch(5u, 5u));
}

void test_residuals_that_come_from_the_operators_choice_are_no_mismatch(void)
{
    s_est.hold_none = 1u;
    s_est.n_outliers = 3u;
    s_est.opt.free_mask = 0x1u; /* one coefficient of 28 */
    TEST_ASSERT_FALSE(mismatch(5u, 5u));
    s_est.opt.free_mask = ~(uint64_t)0x8u;
    TEST_ASSERT_FALSE(mismatch(5u, 5u));
    s_terms.coef[3].enabled = 0u; /* by the table: nobody could request it */
    TEST_ASSERT_TRUE(mismatch(5u, 5u));
}

/* ---- required error ---- */

/* Noise of 1 mm and 4 mrad along each axis: the square of the error may be 16.3 times one variance
 * larger than that of the requirement: once in 1000. */
void test_a_pose_is_checked_against_the_requirement_and_its_noise(void)
{
    double cov[36] = {0.0};
    for (uint32_t k = 0u; k < 6u; k++) { cov[7u * k] = k < 3u ? 1e-6 : 16e-6; }
    double pos_m = sqrt(1e-6 + 16.26623619623813 * 1e-6), rot_rad = sqrt(1e-4 + 16.26623619623813 * 16e-6);
    TEST_ASSERT_TRUE(kc_fit_checked(&s_config, (kc_residual_t){0.999 * pos_m, 0.999 * rot_rad}, cov));
    TEST_ASSERT_FALSE(kc_fit_checked(&s_config, (kc_residual_t){1.001 * pos_m, 0.0}, cov));
    TEST_ASSERT_FALSE(kc_fit_checked(&s_config, (kc_residual_t){0.0, 1.001 * rot_rad}, cov));
    s_config.stop_pos_m = 0.0;
    TEST_ASSERT_TRUE(kc_fit_checked(&s_config, (kc_residual_t){9.0, 0.0}, cov));
    s_config.stop_rot_rad = 0.0;
    TEST_ASSERT_TRUE(kc_fit_checked(&s_config, (kc_residual_t){9.0, 9.0}, cov));
}
