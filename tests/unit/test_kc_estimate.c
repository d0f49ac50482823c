/* kc_estimate.c with its fit: contract; numbers against scipy are in tests/oracle/test_estimate.py. */
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "given_dense.h"
#include "kc_chi2.h"
#include "given_observations.h"
#include "given_tables.h"
#include "kc_est_priv.h"
#include "kc_rng.h"
#include "unity.h"

static kc_arm_t s_arm;
static kc_terms_t s_terms;
static kc_est_t s_est, s_other;
static kc_obs_t s_obs;
static double s_truth[KC_COEF_MAX];

void setUp(void)
{
    given_arm(&s_arm);
    given_terms(&s_terms);
    given_paper_errors(s_truth);
    given_session(&s_est, &s_arm, &s_terms, s_truth, 0u, 0.0);
}

static void given(uint32_t n, double noise) { given_session(&s_est, &s_arm, &s_terms, s_truth, n, noise); }

static kc_obs_t *given_one(void)
{
    uint64_t rng = 3u;
    double q[KC_JOINT_MAX];
    given_joints(&s_arm, &rng, q);
    given_one_observation(&s_arm, &s_terms, s_truth, q, 0.0, &rng, &s_obs);
    return &s_obs;
}

static void assert_refused_unchanged(void)
{
    const uint32_t n = s_est.n_obs;
    TEST_ASSERT_EQUAL_INT(KC_ERR_ARG, kc_est_add(&s_est, &s_obs));
    TEST_ASSERT_EQUAL_UINT32(n, s_est.n_obs);
}

/* ---- adding ---- */

void test_good_observations_are_kept_until_full(void)
{
    kc_obs_t *o = given_one();
    for (uint32_t i = 0u; i < KC_MEAS_MAX; i++) { TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_add(&s_est, o)); }
    TEST_ASSERT_EQUAL_INT(KC_ERR_FULL, kc_est_add(&s_est, o));
    TEST_ASSERT_EQUAL_UINT32(KC_MEAS_MAX, s_est.n_obs);
    TEST_ASSERT_EQUAL_MEMORY(o, &s_est.obs[KC_MEAS_MAX - 1u], sizeof *o);
}

void test_every_number_of_an_observation_must_be_finite(void)
{
#define NUMBERS(member) {offsetof(kc_obs_t, member), sizeof(((kc_obs_t *)0)->member) / sizeof(double)}
    static const struct {
        size_t at, n;
    } of[] = {NUMBERS(ctx.q),         NUMBERS(ctx.dir),    NUMBERS(ctx.qdot),         NUMBERS(ctx.g_m_s2),
              NUMBERS(ctx.temp_c),    NUMBERS(ctx.t_s),    NUMBERS(ctx.payload_kg),   NUMBERS(ctx.range_m),
              NUMBERS(ctx.incid_rad), NUMBERS(ctx.u_norm), NUMBERS(ctx.v_norm),       NUMBERS(ctx.pan_rad),
              NUMBERS(ctx.tilt_rad),  NUMBERS(p_m),        NUMBERS(ctx.p_cam_tool_m), NUMBERS(q_wxyz),
              NUMBERS(p_cam_m),       NUMBERS(q_cam_wxyz)};
    const double bad = NAN;
    for (size_t i = 0; i < sizeof of / sizeof *of; i++) {
        for (size_t k = 0; k < of[i].n; k++) {
            given_one()->has_cam = 1u;
            s_obs.q_cam_wxyz[0] = 1.0;
            memcpy((unsigned char *)&s_obs + of[i].at + k * sizeof bad, &bad, sizeof bad);
            assert_refused_unchanged();
        }
    }
    for (size_t k = 0; k < 36u; k++) { /* of a covariance the lower triangle is used */
        if (k % 6u > k / 6u) { continue; }
        given_one()->cov[k] = bad;
        assert_refused_unchanged();
    }
}

void test_orientation_must_be_a_unit_quaternion_if_there_is_one(void)
{
    given_one()->q_wxyz[0] += 1e-3;
    assert_refused_unchanged();
    s_obs.has_rot = 0u;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_add(&s_est, &s_obs));
}

void test_camera_pose_is_checked_if_there_is_one(void)
{
    given_one()->p_cam_m[1] = INFINITY;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_add(&s_est, &s_obs));
    s_obs.has_cam = 1u;
    assert_refused_unchanged();
    s_obs.p_cam_m[1] = 0.0;
    assert_refused_unchanged(); /* zero quaternion */
    s_obs.q_cam_wxyz[0] = 1.0;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_add(&s_est, &s_obs));
}

void test_covariance_must_be_positive_definite_where_it_is_used(void)
{
    given_one()->cov[28] = 0.0; /* rotation part */
    assert_refused_unchanged();
    s_obs.has_rot = 0u;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_add(&s_est, &s_obs));
    s_obs.cov[14] = -1e-6; /* of z, the last one of a position */
    assert_refused_unchanged();
    s_obs.cov[14] = 1e-6;
    s_obs.cov[0] = -1e-6;
    assert_refused_unchanged();
}

/* ---- refusals ---- */

static void assert_solve_refused(void) { TEST_ASSERT_EQUAL_INT(KC_ERR_ARG, kc_est_solve(&s_est)); }

void test_nothing_observed_is_refused(void) { assert_solve_refused(); }

void test_options_out_of_range_are_refused(void)
{
    given(6u, 0.0);
    const kc_est_opt_t good = s_est.opt;
    s_est.opt.iter_max = 0u;
    assert_solve_refused();
    s_est.opt.iter_max = 101u;
    assert_solve_refused();
    s_est.opt.iter_max = 100u;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    s_est.opt = good;
    s_est.opt.tol_step = 0.0;
    assert_solve_refused();
    s_est.opt = good;
    s_est.opt.rank_tol = NAN;
    assert_solve_refused();
    s_est.opt.rank_tol = 0.0;
    assert_solve_refused();
    s_est.opt = good;
    s_est.opt.outlier_p = -0.1;
    assert_solve_refused();
    s_est.opt = good;
    s_est.n_obs = KC_MEAS_MAX + 1u;
    assert_solve_refused();
}

void test_bad_coefficient_tables_are_refused(void)
{
    given(6u, 0.0);
    s_terms.coef[3].lb = 2.0;
    assert_solve_refused();
    given_terms(&s_terms);
    s_terms.coef[3].scale = 0.0;
    assert_solve_refused();
    given_terms(&s_terms);
    s_est.start[5] = NAN;
    assert_solve_refused();
    s_est.start[5] = 0.0;
    s_terms.n_coef = KC_COEF_MAX + 1u;
    assert_solve_refused();
}

/* Bounds, scale and start of each of them; none behind them. */
void test_every_coefficient_is_checked(void)
{
    for (uint32_t c = 0u; c < 28u; c++) {
        for (uint32_t k = 0u; k < 3u; k++) {
            given(6u, 0.0);
            given_terms(&s_terms);
            if (k == 0u) { s_terms.coef[c].lb = 2.0 * s_terms.coef[c].ub; }
            if (k == 1u) { s_terms.coef[c].scale = 0.0; }
            if (k == 2u) { s_est.start[c] = INFINITY; }
            TEST_ASSERT_FALSE(kc_est_options_good(&s_est));
            s_terms.n_coef = c;
            TEST_ASSERT_TRUE(kc_est_options_good(&s_est));
        }
    }
}

void test_as_many_coefficients_as_there_may_be_are_taken(void)
{
    given(12u, 0.0);
    for (; s_terms.n_coef < KC_COEF_MAX; s_terms.n_coef++) {
        s_terms.coef[s_terms.n_coef] = (kc_coef_t){.name = "more", .lb = -1.0, .ub = 1.0, .scale = 1.0};
    }
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 1.3, s_est.coef[24]);
}

void test_numbers_that_overflow_are_reported(void)
{
    given(6u, 0.0);
    s_est.obs[2].p_m[0] = 1e300;
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, kc_est_solve(&s_est));
}

/* The residuals at start are finite, the cost with its prior is not. */
void test_a_prior_that_overflows_is_reported(void)
{
    given(6u, 0.0);
    s_est.opt.use_prior = 1u;
    s_terms.coef[0].prior_sigma = 1e-200;
    s_est.start[0] = 0.01;
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, kc_est_solve(&s_est));
}

/* No pose depends on it, nothing is held, and its prior is so wide that its row counts as zero. */
void test_a_coefficient_that_nothing_bounds_has_no_covariance(void)
{
    given(12u, 0.0);
    s_terms.coef[s_terms.n_coef++] =
        (kc_coef_t){.name = "more", .lb = -1.0, .ub = 1.0, .scale = 1.0, .prior_sigma = 1e146, .enabled = 1u};
    s_est.opt.use_prior = s_est.hold_none = 1u;
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, kc_est_solve(&s_est));
    s_terms.coef[s_terms.n_coef - 1u].prior_sigma = 1.0;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 1.0, s_est.sigma[s_terms.n_coef - 1u]);
}

/* ---- solving ---- */

void test_the_papers_errors_are_found_from_zero(void)
{
    given(12u, 0.0);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    for (uint32_t c = 0u; c < 28u; c++) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, s_truth[c], s_est.coef[c]);
        TEST_ASSERT_EQUAL_UINT8(KC_COEF_ESTIMATED, s_est.status[c]);
        TEST_ASSERT_TRUE(s_est.sigma[c] > 0.0);
        TEST_ASSERT_EQUAL_UINT64(0u, s_est.confounded[c]);
    }
    TEST_ASSERT_EQUAL_UINT32(28u, s_est.rank);
    TEST_ASSERT_EQUAL_UINT32(28u, s_est.n_free);
    TEST_ASSERT_EQUAL_UINT32(72u - 28u, s_est.dof);
    TEST_ASSERT_EQUAL_UINT8(0u, s_est.weak);
    TEST_ASSERT_TRUE(s_est.fit_pos_m < 1e-9 && s_est.before_pos_m > 0.1);
    TEST_ASSERT_TRUE(s_est.fit_rot_rad < 1e-9 && s_est.before_rot_rad > 0.1);
    TEST_ASSERT_TRUE(s_est.kkt < 1e-6);
    TEST_ASSERT_TRUE(s_est.cond > 1.0 && s_est.cond < 1e4);
    TEST_ASSERT_TRUE(s_est.iters > 3u && s_est.iters < 30u);
}

void test_one_coefficient_has_a_condition_of_one(void)
{
    given(6u, 0.0);
    s_est.opt.free_mask = 1u << 24;
    (void)kc_est_solve(&s_est);
    TEST_ASSERT_EQUAL_UINT32(1u, s_est.rank);
    TEST_ASSERT_EQUAL_DOUBLE(1.0, s_est.cond);
}

void test_a_solution_begins_with_an_empty_report(void)
{
    given(6u, 0.0);
    for (uint32_t c = 0u; c < KC_COEF_MAX; c++) {
        s_est.status[c] = KC_COEF_HELD;
        s_est.sigma[c] = 1.0;
        s_est.confounded[c] = 5u;
    }
    for (uint32_t i = 0u; i < KC_MEAS_MAX; i++) { s_est.outlier[i] = 1u; }
    s_est.n_outliers = s_est.rank = s_est.n_free = s_est.iters = 7u;
    s_est.weak = 1u;
    s_est.kkt = s_est.cond = 3.0;
    s_est.without = 5u;
    s_est.start[5] = s_est.start[6] = s_est.start[27] = 99.0; /* clipped, if estimated */
    s_est.opt.free_mask = ~((uint64_t)1u << 6);
    kc_est_begin(&s_est);
    TEST_ASSERT_EQUAL_DOUBLE(s_terms.coef[5].ub, s_est.coef[5]);
    TEST_ASSERT_EQUAL_DOUBLE(99.0, s_est.coef[6]);
    TEST_ASSERT_EQUAL_DOUBLE(s_terms.coef[27].ub, s_est.coef[27]);
    for (uint32_t c = 0u; c < KC_COEF_MAX; c++) {
        TEST_ASSERT_EQUAL_UINT8(KC_COEF_MASKED, s_est.status[c]);
        TEST_ASSERT_EQUAL_DOUBLE(0.0, s_est.sigma[c]);
        TEST_ASSERT_EQUAL_UINT64(0u, s_est.confounded[c]);
    }
    for (uint32_t i = 0u; i < KC_MEAS_MAX; i++) { TEST_ASSERT_EQUAL_UINT8(i == 4u, s_est.outlier[i]); }
    TEST_ASSERT_EQUAL_UINT32(1u, s_est.n_outliers);
    TEST_ASSERT_EQUAL_UINT32(0u, s_est.rank + s_est.iters + s_est.weak);
    TEST_ASSERT_EQUAL_UINT32(27u, s_est.n_free);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_est.kkt + s_est.cond);
}

void test_noise_is_within_what_is_said(void)
{
    given(20u, 1.0);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    for (uint32_t c = 0u; c < 28u; c++) {
        TEST_ASSERT_DOUBLE_WITHIN(4.0 * s_est.sigma[c], s_truth[c], s_est.coef[c]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-15, s_est.sigma[c] * s_est.sigma[c], s_est.cov[c * (KC_COEF_MAX + 1u)]);
    }
    TEST_ASSERT_DOUBLE_WITHIN(0.3, 1.0, s_est.noise_scale);
    TEST_ASSERT_TRUE(kc_chi2_sf(s_est.chi2, s_est.dof) > 1e-3);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, s_est.chi2, s_est.cost);
}

void test_same_data_same_bits(void)
{
    given(9u, 1.0);
    (void)kc_est_solve(&s_est);
    memcpy(&s_other, &s_est, sizeof s_est);
    (void)kc_est_solve(&s_est);
    TEST_ASSERT_EQUAL_MEMORY(s_other.coef, s_est.coef, sizeof s_est.coef);
    TEST_ASSERT_EQUAL_MEMORY(s_other.cov, s_est.cov, sizeof s_est.cov);
    TEST_ASSERT_EQUAL_UINT32(28u, s_est.n_free); /* counted from the beginning */
    TEST_ASSERT_EQUAL_UINT32(s_other.iters, s_est.iters);
}

void test_a_coefficient_whose_bounds_are_equal_is_that_value(void)
{
    given(12u, 0.0);
    s_terms.coef[5].lb = s_terms.coef[5].ub = 0.4;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_DOUBLE(0.4, s_est.coef[5]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 1.3, s_est.coef[24]);
}

void test_few_poses_use_the_weak_prior_and_report_it(void)
{
    given(6u, 1.0);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT8(1u, s_est.weak);
    TEST_ASSERT_TRUE(s_est.cost > s_est.chi2);
    for (uint32_t c = 0u; c < 28u; c++) {
        TEST_ASSERT_TRUE(s_est.sigma[c] <= KC_EST_WEAK_SIGMA * s_terms.coef[c].scale);
    }
}

void test_iteration_limit_keeps_the_best_so_far(void)
{
    given(12u, 1.0);
    s_est.opt.iter_max = 1u;
    TEST_ASSERT_EQUAL_INT(KC_ERR_ITER, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT32(1u, s_est.iters);
    s_est.opt.iter_max = 2u;
    TEST_ASSERT_EQUAL_INT(KC_ERR_ITER, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT32(2u, s_est.iters);
    TEST_ASSERT_TRUE(s_est.fit_pos_m < s_est.before_pos_m);
    TEST_ASSERT_EQUAL_UINT32(28u, s_est.rank);
}

void test_cost_never_rises_with_more_iterations(void)
{
    double cost = INFINITY;
    given(8u, 1.0);
    s_est.opt.outlier_max = 0u;
    for (uint32_t it = 1u; it < 20u; it++) {
        s_est.opt.iter_max = it;
        (void)kc_est_solve(&s_est);
        TEST_ASSERT_TRUE(s_est.cost <= cost);
        cost = s_est.cost;
    }
}

void test_masked_and_disabled_coefficients_keep_their_start(void)
{
    given(12u, 0.0);
    s_est.opt.free_mask = ~((uint64_t)1u << 5);
    s_terms.coef[9].enabled = 0u;
    s_est.start[5] = 0.4; /* the truth, so the rest can still be found */
    s_est.start[9] = 0.0;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT8(KC_COEF_MASKED, s_est.status[5]);
    TEST_ASSERT_EQUAL_UINT8(KC_COEF_MASKED, s_est.status[9]);
    TEST_ASSERT_DOUBLE_WITHIN(0.0, 0.4, s_est.coef[5]);
    TEST_ASSERT_DOUBLE_WITHIN(0.0, 0.0, s_est.sigma[5]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 1.3, s_est.coef[24]);
    TEST_ASSERT_EQUAL_UINT32(26u, s_est.n_free);
    for (uint32_t c = 0u; c < KC_COEF_MAX; c++) {
        TEST_ASSERT_DOUBLE_WITHIN(0.0, 0.0, s_est.cov[5u * KC_COEF_MAX + c]);
        TEST_ASSERT_DOUBLE_WITHIN(0.0, 0.0, s_est.cov[c * KC_COEF_MAX + 9u]);
    }
}

void test_bounds_hold_for_the_total_and_are_reported(void)
{
    given(12u, 0.0);
    s_terms.coef[24].ub = 1.2;
    s_terms.coef[5].lb = 0.5;
    s_est.start[5] = 0.0; /* clipped to 0.5 */
    s_est.opt.outlier_max = 0u;
    TEST_ASSERT_TRUE(kc_est_solve(&s_est) == KC_OK);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 1.2, s_est.coef[24]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.5, s_est.coef[5]);
    TEST_ASSERT_EQUAL_UINT8(KC_COEF_AT_UPPER, s_est.status[24]);
    TEST_ASSERT_EQUAL_UINT8(KC_COEF_AT_LOWER, s_est.status[5]);
    TEST_ASSERT_DOUBLE_WITHIN(0.0, 0.0, s_est.sigma[24]);
    TEST_ASSERT_DOUBLE_WITHIN(0.0, 0.0, s_est.cov[5u * (KC_COEF_MAX + 1u)]);
    TEST_ASSERT_TRUE(s_est.sigma[0] > 0.0);
    TEST_ASSERT_TRUE(s_est.kkt < 1e-5);
    uint32_t at_bound = 0u;
    for (uint32_t c = 0u; c < 28u; c++) { at_bound += s_est.status[c] != KC_COEF_ESTIMATED; }
    TEST_ASSERT_EQUAL_UINT32(72u - 28u + at_bound, s_est.dof);
}

void test_priors_pull_and_enter_the_cost(void)
{
    given(12u, 1.0);
    s_est.opt.use_prior = 1u;
    s_terms.coef[0].prior_sigma = 1e-6;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_DOUBLE_WITHIN(3e-6, 0.0, s_est.coef[0]);
    TEST_ASSERT_TRUE(s_est.sigma[0] <= 1e-6);
    TEST_ASSERT_TRUE(s_est.cost > s_est.chi2);
}

void test_replicates_count_as_rows_but_not_as_rank(void)
{
    kc_obs_t *o = given_one();
    for (int i = 0; i < 10; i++) { (void)kc_est_add(&s_est, o); }
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT32(6u, s_est.rank);
    TEST_ASSERT_EQUAL_UINT32(54u, s_est.dof);
}

void test_one_observation_without_degrees_of_freedom_has_no_noise_scale(void)
{
    given(1u, 1.0);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT32(0u, s_est.dof);
    TEST_ASSERT_DOUBLE_WITHIN(0.0, 1.0, s_est.noise_scale);
}

void test_position_only_has_no_rotation_residual(void)
{
    s_arm.tool_xyz_m[2] = 0.0; /* on the last axis: rank 24 */
    given(20u, 1.0);
    for (uint32_t i = 0u; i < 20u; i++) { s_est.obs[i].has_rot = 0u; }
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT32(24u, s_est.rank);
    TEST_ASSERT_DOUBLE_WITHIN(0.0, 0.0, s_est.fit_rot_rad);
    TEST_ASSERT_EQUAL_UINT32(60u - 24u, s_est.dof);
}

void test_pose_covariance_is_that_of_the_coefficients_seen_through_the_jacobian(void)
{
    static kc_eval_t work;
    double cov[36];
    double p[3] = {0.0, 0.0, 0.0};
    kc_loads_t loads;
    kc_fixed_t fixed;
    given(12u, 1.0);
    (void)kc_est_solve(&s_est);
    kc_model_fix(&s_arm, &s_terms, s_est.coef, &fixed);
    kc_est_pose_cov(&s_est, &fixed, &s_est.obs[3].ctx, &work, cov);
    kc_model_loads(&s_arm, &s_terms, s_est.coef, &s_est.obs[3].ctx, &loads);
    kc_model_eval(&s_arm, &s_terms, s_est.coef, &s_est.obs[3].ctx, &loads, true, &s_other.eval);
    for (uint32_t i = 0u; i < 28u; i++) {
        for (uint32_t j = 0u; j < 28u; j++) {
            for (int k = 0; k < 3; k++) {
                p[k] += s_other.eval.J[i][k] * s_est.cov[i * KC_COEF_MAX + j] * s_other.eval.J[j][k];
            }
        }
    }
    for (int k = 0; k < 3; k++) { TEST_ASSERT_DOUBLE_WITHIN(1e-12, p[k], cov[7 * k]); }
    TEST_ASSERT_TRUE(cov[0] > 0.0 && cov[0] < 1e-5);
}

/* Some coefficients are masked, the first, the last and some between; what stands in cov for them plays no part. */
void test_pose_covariance_is_of_the_estimated_coefficients_alone(void)
{
    static kc_eval_t work;
    static const uint64_t masks[] = {0xffffffffull, 0xffffffeull, 0x7ffffffull,
                                     0xaaaaaaaull,  0xf0f0f0full, 0x1ull};
    for (uint32_t m = 0u; m < sizeof masks / sizeof masks[0]; m++) {
        double cov[36], scale = 0.0;
        kc_loads_t loads;
        kc_fixed_t fixed;
        given(12u, 1.0);
        s_est.opt.free_mask = masks[m];
        (void)kc_est_solve(&s_est);
        kc_model_fix(&s_arm, &s_terms, s_est.coef, &fixed);
        kc_model_loads(&s_arm, &s_terms, s_est.coef, &s_est.obs[5].ctx, &loads);
        kc_model_eval(&s_arm, &s_terms, s_est.coef, &s_est.obs[5].ctx, &loads, true, &s_other.eval);
        for (uint32_t c = 0u; c < 28u; c++) {
            for (uint32_t k = 0u; k < 28u && (masks[m] >> c & 1u) == 0u; k++) {
                s_est.cov[c * KC_COEF_MAX + k] = s_est.cov[k * KC_COEF_MAX + c] = 1.0;
            }
        }
        kc_est_pose_cov(&s_est, &fixed, &s_est.obs[5].ctx, &work, cov);
        for (uint32_t k = 0u; k < 6u; k++) { scale = fmax(scale, cov[7u * k]); }
        for (uint32_t k = 0u; k < 36u; k++) {
            double want = 0.0;
            for (uint32_t i = 0u; i < 28u; i++) {
                for (uint32_t j = 0u; j < 28u; j++) {
                    if ((masks[m] >> i & masks[m] >> j & 1u) == 0u) { continue; }
                    want += s_other.eval.J[i][k / 6u] * s_est.cov[i * KC_COEF_MAX + j] *
                            s_other.eval.J[j][k % 6u];
                }
            }
            TEST_ASSERT_DOUBLE_WITHIN(1e-9 * scale, want, cov[k]);
        }
    }
}

/* R'R and R'z of the columns that stay are what they were; the columns are those of the fit. */
void test_columns_that_are_not_in_the_fit_leave_and_the_others_stay_as_they_were(void)
{
    static const uint32_t column[6] = {1u, 4u, 5u, 9u, 20u, 27u};
    static double before[7][7];
    for (uint32_t set = 1u; set < 64u; set++) {
        uint32_t place[7], n = 0u;
        uint64_t rng = set;
        memset(s_est.R, 0, sizeof s_est.R);
        for (uint32_t i = 0u; i < 6u; i++) {
            for (uint32_t j = i; j < 7u; j++) {
                s_est.R[i * KC_EST_LD + j] = kc_rng_uniform(&rng) + (i == j ? 1.0 : 0.0);
            }
        }
        for (uint32_t a = 0u; a < 7u; a++) {
            for (uint32_t b = 0u; b < 7u; b++) {
                before[a][b] = 0.0;
                for (uint32_t i = 0u; i < 6u; i++) {
                    before[a][b] += s_est.R[i * KC_EST_LD + a] * s_est.R[i * KC_EST_LD + b];
                }
            }
        }
        memcpy(s_est.column, column, sizeof column);
        s_est.n_column = 6u;
        for (uint32_t j = 0u; j < 6u; j++) {
            if ((set >> j & 1u) == 0u) { continue; }
            s_est.idx[n] = column[j];
            place[n++] = j;
        }
        place[n] = 6u;
        s_est.n_idx = n;
        kc_est_narrow(&s_est);
        TEST_ASSERT_EQUAL_UINT32(n, s_est.n_column);
        TEST_ASSERT_EQUAL_UINT32_ARRAY(s_est.idx, s_est.column, n);
        for (uint32_t a = 0u; a <= n; a++) {
            for (uint32_t b = 0u; b < n; b++) {
                double now = 0.0;
                for (uint32_t i = 0u; i <= b && (a == n || i <= a); i++) {
                    now += s_est.R[i * KC_EST_LD + a] * s_est.R[i * KC_EST_LD + b];
                }
                TEST_ASSERT_DOUBLE_WITHIN(1e-12, before[place[a]][place[b]], now);
            }
        }
    }
}

/* ---- a step of the fit ---- */

void test_a_step_is_given_up_when_the_damping_has_grown_enough(void)
{
    s_est.n_idx = 0u;
    s_est.job.tries = 0u;
    s_est.job.lambda = 1.0;
    TEST_ASSERT_EQUAL_INT(KC_EST_STEP_AGAIN, kc_est_try(&s_est));
    s_est.job.lambda = 1e12; /* by now no step is left of it */
    TEST_ASSERT_EQUAL_INT(KC_EST_STEP_NONE, kc_est_try(&s_est));
    s_est.job.lambda = 1.0;
    s_est.job.tries = 20u;
    TEST_ASSERT_EQUAL_INT(KC_EST_STEP_NONE, kc_est_try(&s_est));
}

/* What a fit has to better: the cost at its start, prior and all. */
void test_a_fit_begins_with_the_cost_at_the_start(void)
{
    double chi2 = 0.0;
    kc_loads_t loads;
    double r[6];
    given(9u, 1.0);
    s_est.opt.use_prior = 1u;
    s_terms.coef[3].prior_sigma = 0.001;
    s_est.start[3] = 0.02; /* 20 sigma */
    for (uint32_t i = 0u; i < 9u; i++) {
        const kc_obs_t *o = &s_est.obs[i];
        kc_model_loads(&s_arm, &s_terms, s_est.start, &o->ctx, &loads);
        (void)kc_model_residual(&s_arm, &s_terms, s_est.start, o, &loads, r, &s_other.eval);
        for (uint32_t k = 0u; k < 6u; k++) { chi2 += r[k] * r[k] / o->cov[7u * k]; }
    }
    kc_est_begin(&s_est);
    for (uint32_t i = 0u; i < 200u && s_est.job.cost <= 0.0; i++) {
        kc_work_t one = {1u, 0u};
        TEST_ASSERT_FALSE(kc_est_step(&s_est, &one));
    }
    TEST_ASSERT_DOUBLE_WITHIN(1e-9 * chi2, chi2 + 400.0, s_est.job.cost);
}

/* A model of two coefficients with cost -2 x0 + x0^2 + x0 x1 + x1^2 at the step (1, 0.5): it falls by 0.25. */
static kc_est_step_t compared(double cost, double trial_cost)
{
    s_est.n_idx = s_est.qp.n = 2u;
    s_est.qp.g[0] = -1.0;
    s_est.qp.g[1] = 0.0;
    s_est.qp.H[0] = s_est.qp.H[KC_COEF_MAX + 1u] = 1.0;
    s_est.qp.H[1] = s_est.qp.H[KC_COEF_MAX] = 0.5;
    s_est.qp.x[0] = 1.0;
    s_est.qp.x[1] = 0.5;
    s_est.opt.tol_step = 1e-9;
    s_est.job.largest = 1.0;
    s_est.job.lambda = 2.0;
    s_est.job.tries = 3u;
    s_est.job.cost = cost;
    return kc_est_compare(&s_est, trial_cost);
}

void test_a_rise_that_rounding_can_explain_ends_the_fit_and_a_larger_one_is_damped(void)
{
    /* rounding hides 1e-13 of the cost */
    TEST_ASSERT_EQUAL_INT(KC_EST_STEP_LAST, compared(2.6e12, 2.7e12));
    TEST_ASSERT_EQUAL_DOUBLE(2.0, s_est.job.lambda);
    TEST_ASSERT_EQUAL_INT(KC_EST_STEP_AGAIN, compared(2.4e12, 2.5e12));
    TEST_ASSERT_EQUAL_DOUBLE(16.0, s_est.job.lambda);
    TEST_ASSERT_EQUAL_UINT32(4u, s_est.job.tries);
}

void test_a_step_that_does_not_raise_the_cost_is_taken_and_the_damping_eased(void)
{
    s_est.coef[0] = 0.0;
    s_est.trial[0] = 0.25;
    TEST_ASSERT_EQUAL_INT(KC_EST_STEP_TAKEN, compared(5.0, 5.0));
    TEST_ASSERT_EQUAL_DOUBLE(0.25, s_est.coef[0]);
    TEST_ASSERT_EQUAL_DOUBLE(5.0, s_est.job.cost);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.2, s_est.job.lambda);
    TEST_ASSERT_EQUAL_UINT32(3u, s_est.job.tries);
}

/* One coefficient whose cost is (x - centre)^2. */
static uint8_t status_at(double x, double centre)
{
    s_est.n_idx = 1u;
    s_est.idx[0] = 0u;
    s_est.coef[0] = x;
    s_est.R[0] = 1.0;
    s_est.R[1] = centre - x;
    (void)kc_est_kkt(&s_est, 1.0);
    return s_est.status[0];
}

void test_a_bound_is_active_only_if_the_cost_would_fall_beyond_it(void)
{
    const kc_coef_t *k = &s_terms.coef[0];
    TEST_ASSERT_EQUAL_UINT8(KC_COEF_AT_UPPER, status_at(k->ub, k->ub + 0.1));
    TEST_ASSERT_EQUAL_UINT8(KC_COEF_ESTIMATED, status_at(k->ub, k->ub - 0.1));
    TEST_ASSERT_EQUAL_UINT8(KC_COEF_AT_LOWER, status_at(k->lb, k->lb - 0.1));
    TEST_ASSERT_EQUAL_UINT8(KC_COEF_ESTIMATED, status_at(k->lb, k->lb + 0.1));
    TEST_ASSERT_EQUAL_UINT8(KC_COEF_ESTIMATED, status_at(0.0, 0.1));
}

/* Within 1e-9 of the coefficient's scale of a bound it is on it, and not beyond that. */
void test_how_close_to_a_bound_is_on_it_goes_by_the_scale(void)
{
    static const double scale[] = {1e-3, 0.2, 50.0};
    for (uint32_t i = 0u; i < sizeof scale / sizeof scale[0]; i++) {
        kc_coef_t *k = &s_terms.coef[0];
        k->scale = scale[i];
        TEST_ASSERT_EQUAL_UINT8(KC_COEF_AT_UPPER, status_at(k->ub - 0.7e-9 * scale[i], k->ub + 0.1));
        TEST_ASSERT_EQUAL_UINT8(KC_COEF_ESTIMATED, status_at(k->ub - 1.4e-9 * scale[i], k->ub + 0.1));
        TEST_ASSERT_EQUAL_UINT8(KC_COEF_AT_LOWER, status_at(k->lb + 0.7e-9 * scale[i], k->lb - 0.1));
        TEST_ASSERT_EQUAL_UINT8(KC_COEF_ESTIMATED, status_at(k->lb + 1.4e-9 * scale[i], k->lb - 0.1));
    }
}

/* At bounds a QP takes several iterations, between which a step may end. */
void test_at_bounds_a_solution_in_parts_has_the_same_bits(void)
{
    static kc_est_t whole;
    given(12u, 1.0);
    s_terms.coef[24].ub = 1.2;
    s_terms.coef[5].ub = 0.3;
    s_terms.coef[11].lb = 0.155;
    s_est.opt.outlier_p = 0.0;
    whole = s_est;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&whole));
    for (uint64_t most = 20000u; most <= 140000u; most += 12000u) {
        kc_est_begin(&s_est);
        for (bool over = false; !over;) {
            kc_work_t work = {most, 0u};
            over = kc_est_step(&s_est, &work);
        }
        TEST_ASSERT_EQUAL_INT(KC_OK, s_est.job.status);
        TEST_ASSERT_EQUAL_UINT32(whole.iters, s_est.iters);
        TEST_ASSERT_EQUAL_MEMORY(whole.coef, s_est.coef, sizeof s_est.coef);
        TEST_ASSERT_EQUAL_MEMORY(whole.cov, s_est.cov, sizeof s_est.cov);
    }
}

/* A bit of an observation flips during the fit; the memory check (kc_scrub.c) may be late. */
void test_an_observation_damaged_during_the_fit_never_gives_a_covariance_that_is_none(void)
{
    uint32_t n_failed = 0u;
    bool done = false;
    for (uint32_t units = 0u; !done; units++) {
        given(6u, 1.0);
        s_est.opt.outlier_p = 0.0;
        kc_est_begin(&s_est);
        for (uint32_t i = 0u; i < units && !done; i++) {
            kc_work_t one = {1u, 0u};
            done = kc_est_step(&s_est, &one);
        }
        s_est.obs[5].ctx.q[3] = NAN;
        kc_work_t all = kc_work_unlimited();
        (void)kc_est_step(&s_est, &all);
        n_failed += s_est.job.status == KC_OK ? 0u : 1u;
        if (s_est.job.status != KC_OK) { continue; }
        for (uint32_t i = 0u; i < 28u; i++) {
            for (uint32_t j = 0u; j < 28u; j++) {
                TEST_ASSERT_TRUE(isfinite(s_est.cov[i * KC_COEF_MAX + j]));
            }
        }
    }
    TEST_ASSERT_TRUE(n_failed > 50u);
}

/* ---- the report, against dense sums at the solution ---- */

#define N_DH 28u
typedef double matrix_t[N_DH][N_DH];

static struct {
    double chi2, prior, pos2, rot2, grad[N_DH];
    uint32_t rows, n_pos, n_rot;
    matrix_t information;
} s_sum;

/* Over the inliers at coef; covariances are diagonal. sigma, centre: of the prior, 0 for none. */
static void sum_at(const double *coef, const double *sigma, const double *centre)
{
    memset(&s_sum, 0, sizeof s_sum);
    for (uint32_t i = 0u; i < s_est.n_obs; i++) {
        const kc_obs_t *o = &s_est.obs[i];
        kc_loads_t loads;
        double r[6];
        if (s_est.outlier[i] != 0u) { continue; }
        kc_model_loads(&s_arm, &s_terms, coef, &o->ctx, &loads);
        uint32_t rows = kc_model_residual(&s_arm, &s_terms, coef, o, &loads, r, &s_other.eval);
        s_sum.rows += rows;
        s_sum.n_pos++;
        s_sum.n_rot += rows == 6u ? 1u : 0u;
        for (uint32_t k = 0u; k < rows; k++) {
            double var = o->cov[7u * k];
            s_sum.chi2 += r[k] * r[k] / var;
            *(k < 3u ? &s_sum.pos2 : &s_sum.rot2) += r[k] * r[k];
            for (uint32_t a = 0u; a < N_DH; a++) {
                s_sum.grad[a] += s_other.eval.J[a][k] * r[k] / var;
                for (uint32_t b = 0u; b < N_DH; b++) {
                    s_sum.information[a][b] += s_other.eval.J[a][k] * s_other.eval.J[b][k] / var;
                }
            }
        }
    }
    for (uint32_t a = 0u; a < N_DH; a++) {
        if (sigma[a] <= 0.0) { continue; }
        double off = (coef[a] - centre[a]) / sigma[a];
        s_sum.prior += off * off;
        s_sum.grad[a] -= off / sigma[a];
        s_sum.information[a][a] += 1.0 / (sigma[a] * sigma[a]);
    }
}

static void assert_close(double want, double got)
{
    TEST_ASSERT_DOUBLE_WITHIN(1e-7 * fabs(want) + 1e-300, want, got);
}

static void assert_fit_and_noise(void)
{
    assert_close(s_sum.chi2, s_est.chi2);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9 * s_est.cost, s_sum.chi2 + s_sum.prior, s_est.cost);
    assert_close(sqrt(s_sum.pos2 / s_sum.n_pos), s_est.fit_pos_m);
    assert_close(s_sum.n_rot > 0u ? sqrt(s_sum.rot2 / s_sum.n_rot) : 0.0, s_est.fit_rot_rad);
}

/* What the estimator says at its solution: chi-square, cost, RMS, degrees of freedom, covariance; and that no
 * coefficient inside its bounds can make the cost fall. */
static void assert_report(const double *sigma, const double *centre)
{
    static matrix_t inside, cov;
    uint32_t idx[N_DH], n = 0u;
    double worst = 0.0;
    sum_at(s_est.coef, sigma, centre);
    assert_fit_and_noise();
    for (uint32_t a = 0u; a < N_DH; a++) {
        if (s_est.status[a] == KC_COEF_ESTIMATED) { idx[n++] = a; }
    }
    TEST_ASSERT_EQUAL_UINT32(s_sum.rows - n, s_est.dof);
    assert_close(sqrt(s_sum.chi2 / (double)s_est.dof), s_est.noise_scale);
    for (uint32_t i = 0u; i < n; i++) {
        double column = sqrt(s_sum.information[idx[i]][idx[i]]);
        worst = fmax(worst, fabs(s_sum.grad[idx[i]]) / (column * fmax(1.0, sqrt(s_est.cost))));
        for (uint32_t j = 0u; j < n; j++) { inside[i][j] = s_sum.information[idx[i]][idx[j]]; }
    }
    TEST_ASSERT_TRUE(worst < 1e-5);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, worst, s_est.kkt);
    dense_invert(n, N_DH, inside[0], cov[0]);
    for (uint32_t i = 0u; i < n; i++) {
        assert_close(sqrt(cov[i][i]), s_est.sigma[idx[i]]);
        for (uint32_t j = 0u; j < n; j++) {
            double part = cov[i][j] / sqrt(cov[i][i] * cov[j][j]);
            double got = s_est.cov[idx[i] * KC_COEF_MAX + idx[j]] / sqrt(cov[i][i] * cov[j][j]);
            TEST_ASSERT_DOUBLE_WITHIN(1e-6, part, got);
        }
    }
}

static const double NO_PRIOR[N_DH];

/* Noise of its own on every axis, one pose without rotation. */
static void given_uneven(uint32_t n)
{
    given(n, 1.0);
    s_est.opt.tol_step = 1e-10;
    for (uint32_t i = 0u; i < n; i++) {
        s_est.obs[i].has_rot = i != 4u;
        for (uint32_t k = 0u; k < 6u; k++) {
            s_est.obs[i].cov[7u * k] *= 1.0 + 0.3 * (double)k + 0.1 * (double)i;
        }
    }
}

void test_the_report_of_a_fit_is_that_of_dense_sums(void)
{
    given_uneven(14u);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT32(N_DH, s_est.rank);
    assert_report(NO_PRIOR, NO_PRIOR);
    sum_at(s_est.start, NO_PRIOR, NO_PRIOR);
    assert_close(sqrt(s_sum.pos2 / s_sum.n_pos), s_est.before_pos_m);
    assert_close(sqrt(s_sum.rot2 / s_sum.n_rot), s_est.before_rot_rad);
}

void test_without_an_outlier_the_report_is_that_of_the_others(void)
{
    given_uneven(16u);
    s_est.obs[9].p_m[0] += 0.05;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT8(1u, s_est.outlier[9]);
    assert_report(NO_PRIOR, NO_PRIOR);
}

void test_own_priors_pull_to_zero_and_count_in_cost_and_covariance(void)
{
    double sigma[N_DH] = {0.0};
    given_uneven(14u);
    s_est.opt.use_prior = 1u;
    for (uint32_t a = 1u; a < N_DH; a += 3u) {
        sigma[a] = s_terms.coef[a].prior_sigma = 0.2 * s_terms.coef[a].scale;
        s_est.start[a] = 0.01; /* no matter where it starts */
    }
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    assert_report(sigma, NO_PRIOR);
    TEST_ASSERT_TRUE(s_est.cost > s_est.chi2 + 1.0);
}

/* It counts as an observation of each coefficient: chi-square, degrees of freedom, covariance; about its own mean,
 * wherever the fit starts, and few poses are enough. */
void test_a_prior_from_earlier_measurements_counts_as_observations(void)
{
    double mean[KC_COEF_MAX] = {0.0};
    given_uneven(3u);
    s_est.opt.outlier_p = 0.0;
    s_est.opt.use_prior = 1u; /* it takes the place of any other */
    s_est.by_prior = s_est.hold_none = 1u;
    s_est.prior_mean = mean;
    for (uint32_t a = 0u; a < N_DH; a++) {
        s_terms.coef[a].prior_sigma = 1e-4;
        s_est.prior_sigma[a] = (0.02 + 0.01 * (double)a) * s_terms.coef[a].scale;
        mean[a] = s_truth[a] + 0.03 * s_terms.coef[a].scale;
        s_est.start[a] = s_truth[a] - 0.2 * s_terms.coef[a].scale;
    }
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    sum_at(s_est.coef, s_est.prior_sigma, mean);
    assert_close(s_sum.chi2 + s_sum.prior, s_est.chi2);
    assert_close(s_est.chi2, s_est.cost);
    TEST_ASSERT_EQUAL_UINT32(s_sum.rows, s_est.dof); /* 15 rows and 28 of the prior, for 28 coefficients */
    assert_close(sqrt(s_est.chi2 / (double)s_sum.rows), s_est.noise_scale);
    for (uint32_t a = 0u; a < N_DH; a++) {
        TEST_ASSERT_EQUAL_UINT8(KC_COEF_ESTIMATED, s_est.status[a]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-4 * sqrt(s_sum.information[a][a]), 0.0, s_sum.grad[a]);
        TEST_ASSERT_TRUE(s_est.sigma[a] < s_est.prior_sigma[a]);
    }
}

void test_the_weak_prior_pulls_to_the_start_by_three_typical_sizes(void)
{
    double sigma[N_DH];
    given_uneven(8u); /* 45 rows for 28 */
    for (uint32_t a = 0u; a < N_DH; a++) {
        sigma[a] = 3.0 * s_terms.coef[a].scale;
        s_est.start[a] = s_truth[a] + 0.5 * s_terms.coef[a].scale;
    }
    s_est.opt.outlier_p = 0.0;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT8(1u, s_est.weak);
    assert_report(sigma, s_est.start);
}

/* 28 coefficients: 57 rows of ten poses, one without rotation, are enough and 54 are not; for 27 they are. */
void test_the_weak_prior_goes_when_there_are_two_rows_for_each_coefficient(void)
{
    given_uneven(10u);
    (void)kc_est_solve(&s_est);
    TEST_ASSERT_EQUAL_UINT8(0u, s_est.weak);
    given_uneven(10u);
    s_est.obs[3].has_rot = 0u; /* 54 */
    (void)kc_est_solve(&s_est);
    TEST_ASSERT_EQUAL_UINT8(1u, s_est.weak);
    given(10u, 1.0);
    for (uint32_t i = 0u; i < 2u; i++) { s_est.obs[i].has_rot = 0u; } /* 54 */
    s_est.opt.free_mask = (1u << 27) - 1u;
    (void)kc_est_solve(&s_est);
    TEST_ASSERT_EQUAL_UINT8(0u, s_est.weak); /* 54 rows, 27 coefficients: just enough */
}

void test_at_bounds_the_report_is_that_of_the_coefficients_inside(void)
{
    given_uneven(14u);
    s_terms.coef[24].ub = 1.25;
    s_terms.coef[5].ub = 0.38;
    s_terms.coef[11].lb = 0.155;
    s_est.opt.outlier_p = 0.0;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT8(KC_COEF_AT_UPPER, s_est.status[24]);
    assert_report(NO_PRIOR, NO_PRIOR);
}

/* Far from the solution a full step can lead uphill: it is not taken. */
void test_from_far_away_no_iteration_makes_the_cost_rise(void)
{
    uint64_t rng = 4u;
    for (uint32_t start = 0u; start < 4u; start++) {
        double from[KC_COEF_MAX] = {0.0};
        given(12u, 1.0);
        s_est.opt.outlier_p = 0.0;
        for (uint32_t a = 0u; a < N_DH; a += 2u) {
            from[a] = 0.4 * given_noise(&rng) * (a % 4u == 0u ? 1.0 : 0.1);
        }
        for (uint32_t a = 0u; a < N_DH; a++) {
            from[a] = fmin(fmax(from[a], s_terms.coef[a].lb), s_terms.coef[a].ub);
        }
        memcpy(s_est.start, from, sizeof from);
        sum_at(from, NO_PRIOR, NO_PRIOR);
        double cost = s_sum.chi2;
        for (uint32_t n = 1u; n <= 6u; n++) {
            s_est.opt.iter_max = n;
            (void)kc_est_solve(&s_est);
            sum_at(s_est.coef, NO_PRIOR, NO_PRIOR);
            TEST_ASSERT_TRUE(s_sum.chi2 <= cost * (1.0 + 1e-12));
            cost = s_sum.chi2;
        }
    }
}

/* Of a uniform distribution; bounds that meet are a millionth of the scale apart. */
void test_bounds_count_as_the_sigma_between_them(void)
{
    static const double cases[][3] = {
        {3.0, 0.01, 3.0}, {0.0, 0.01, 1e-8}, {0.0, 20.0, 2e-5}, {1e-3, 0.1, 1e-3}};
    for (uint32_t i = 0u; i < sizeof cases / sizeof cases[0]; i++) { /* width, scale, width that counts */
        const kc_coef_t coef = {.lb = -1.0, .ub = -1.0 + cases[i][0], .scale = cases[i][1]};
        TEST_ASSERT_DOUBLE_WITHIN(1e-9 * cases[i][2], cases[i][2] / sqrt(12.0), kc_est_bound_sigma(&coef));
    }
}

/* Where data are few: by the bounds only if asked and if no coefficient is held. */
void test_which_prior_a_coefficient_has(void)
{
    const kc_coef_t *k = &s_terms.coef[5];
    for (uint32_t i = 0u; i < 16u; i++) {
        double centre = 9.0;
        given_session(&s_est, &s_arm, &s_terms, s_truth, 1u, 0.0);
        s_terms.coef[5].prior_sigma = 0.004;
        s_est.start[5] = 0.03;
        s_est.weak = i & 1u;
        s_est.by_bounds = i >> 1u & 1u;
        s_est.hold_none = i >> 2u & 1u;
        s_est.opt.use_prior = i >> 3u & 1u;
        const double sigma = (i & 8u) != 0u   ? 0.004
                             : (i & 1u) == 0u ? INFINITY
                             : (i & 6u) == 6u ? kc_est_bound_sigma(k)
                                              : KC_EST_WEAK_SIGMA * k->scale;
        TEST_ASSERT_EQUAL_DOUBLE(1.0 / sigma, kc_est_prior_precision(&s_est, 5u, &centre));
        TEST_ASSERT_EQUAL_DOUBLE((i & 8u) != 0u ? 0.0 : 0.03, centre);
    }
}
