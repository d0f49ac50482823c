/* kc_outlier.c: wrong poses go, good ones stay. */
#include <math.h>
#include <string.h>

#include "given_dense.h"
#include "given_observations.h"
#include "given_tables.h"
#include "kc_chi2.h"
#include "kc_est_priv.h"
#include "kc_la.h"
#include "kc_rot.h"
#include "unity.h"

static kc_arm_t s_arm;
static kc_terms_t s_terms;
static kc_est_t s_est;
static kc_camera_t s_camera;
static double s_truth[KC_COEF_MAX];

void setUp(void)
{
    given_arm(&s_arm);
    given_terms(&s_terms);
    given_paper_errors(s_truth);
}

static void assert_truth_within_4_sigma(void)
{
    for (uint32_t c = 0u; c < 28u; c++) {
        TEST_ASSERT_DOUBLE_WITHIN(4.0 * s_est.sigma[c], s_truth[c], s_est.coef[c]);
    }
}

void test_good_poses_stay(void)
{
    given_session(&s_est, &s_arm, &s_terms, s_truth, 20u, 1.0);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT32(0u, s_est.n_outliers);
}

void test_a_wrong_pose_goes_and_the_fit_is_repeated_without_it(void)
{
    given_session(&s_est, &s_arm, &s_terms, s_truth, 15u, 1.0);
    s_est.obs[7].p_m[1] += 0.01; /* 20 sigma */
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT32(1u, s_est.n_outliers);
    TEST_ASSERT_EQUAL_UINT8(1u, s_est.outlier[7]);
    TEST_ASSERT_EQUAL_UINT32(84u - 28u, s_est.dof);
    TEST_ASSERT_TRUE(s_est.fit_pos_m < 1e-3);
    assert_truth_within_4_sigma();
}

void test_several_gross_ones_go_too(void)
{
    given_session(&s_est, &s_arm, &s_terms, s_truth, 20u, 1.0);
    s_est.obs[3].p_m[0] += 0.2;
    s_est.obs[11].p_m[2] -= 0.05;
    const double flipped[4] = {0.0, 1.0, 0.0, 0.0};
    memcpy(s_est.obs[15].q_wxyz, flipped, sizeof flipped);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT32(3u, s_est.n_outliers);
    TEST_ASSERT_EQUAL_UINT8(1u, s_est.outlier[3] & s_est.outlier[11] & s_est.outlier[15]);
    assert_truth_within_4_sigma();
}

/* One unit a step, and many: the same bits as at once. */
void test_a_solution_in_parts_has_the_same_bits(void)
{
    static kc_est_t whole;
    static const uint64_t most[2] = {1u, 1000000u};
    given_session(&whole, &s_arm, &s_terms, s_truth, 15u, 1.0);
    whole.obs[7].p_m[1] += 0.01;
    s_est = whole;
    (void)kc_est_solve(&whole);
    TEST_ASSERT_EQUAL_UINT32(1u, whole.n_outliers);
    kc_work_t all = kc_work_unlimited();
    kc_est_begin(&s_est);
    TEST_ASSERT_TRUE(kc_est_step(&s_est, &all));
    /* an iteration: its 14 or 15 inliers, one of the QP, the phases before and after; inliers once for each test of
     * outliers; and as many steps as the charges fill */
    const uint64_t least[2] = {17u * (uint64_t)whole.iters + 15u + 14u, all.used / most[1]};
    for (uint32_t k = 0u; k < 2u; k++) {
        kc_est_begin(&s_est);
        uint32_t steps = 0u;
        for (bool over = false; !over; steps++) {
            kc_work_t work = {most[k], 0u};
            over = kc_est_step(&s_est, &work);
        }
        TEST_ASSERT_TRUE(steps >= least[k] && least[k] > 5u);
        TEST_ASSERT_EQUAL_INT(KC_OK, s_est.job.status);
        TEST_ASSERT_EQUAL_MEMORY(whole.coef, s_est.coef, sizeof s_est.coef);
        TEST_ASSERT_EQUAL_MEMORY(whole.sigma, s_est.sigma, sizeof s_est.sigma);
        TEST_ASSERT_EQUAL_MEMORY(whole.cov, s_est.cov, sizeof s_est.cov);
        TEST_ASSERT_EQUAL_MEMORY(whole.outlier, s_est.outlier, sizeof s_est.outlier);
        TEST_ASSERT_EQUAL_MEMORY(&whole.kkt, &s_est.kkt, sizeof s_est.kkt);
    }
}

/* Iterations are counted in each fit anew: as few as one fit needs are enough for two. */
void test_a_repeated_fit_has_all_its_iterations(void)
{
    given_session(&s_est, &s_arm, &s_terms, s_truth, 15u, 1.0);
    s_est.obs[7].p_m[1] += 0.01;
    (void)kc_est_solve(&s_est);
    TEST_ASSERT_EQUAL_UINT32(1u, s_est.n_outliers);
    s_est.opt.iter_max = s_est.iters - 1u;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT32(s_est.opt.iter_max + 1u, s_est.iters);
}

void test_no_more_go_than_allowed(void)
{
    given_session(&s_est, &s_arm, &s_terms, s_truth, 20u, 1.0);
    s_est.opt.outlier_max = 1u;
    s_est.obs[3].p_m[0] += 0.2;
    s_est.obs[11].p_m[2] -= 0.05;
    (void)kc_est_solve(&s_est);
    TEST_ASSERT_EQUAL_UINT32(1u, s_est.n_outliers);
    TEST_ASSERT_EQUAL_UINT8(1u, s_est.outlier[3]);
}

void test_probability_zero_turns_rejection_off(void)
{
    given_session(&s_est, &s_arm, &s_terms, s_truth, 15u, 1.0);
    s_est.opt.outlier_p = 0.0;
    s_est.obs[7].p_m[1] += 0.05;
    (void)kc_est_solve(&s_est);
    TEST_ASSERT_EQUAL_UINT32(0u, s_est.n_outliers);
    TEST_ASSERT_TRUE(s_est.noise_scale > 2.0);
}

void test_a_pose_that_alone_determines_a_direction_is_never_an_outlier(void)
{
    /* five poses, 30 rows for 28 unknowns: with any error, no pose differs from the others */
    given_session(&s_est, &s_arm, &s_terms, s_truth, 5u, 1.0);
    s_est.obs[2].p_m[0] += 0.1;
    (void)kc_est_solve(&s_est);
    TEST_ASSERT_EQUAL_UINT32(0u, s_est.n_outliers);
}

/* Five poses and one coefficient that moves the arm along one axis, which the third measures better than the others, so
 * that the deletion of the third leaves `part` of the variance of its residual. */
static void given_one_leading_pose(uint32_t axis, double part)
{
    memset(&s_terms, 0, sizeof s_terms);
    memset(s_truth, 0, sizeof s_truth);
    memset(s_arm.base_xyz_m, 0, sizeof s_arm.base_xyz_m);
    s_terms.n_coef = s_terms.n_term = 1u;
    s_terms.coef[0] = (kc_coef_t){.name = "base", .lb = -1.0, .ub = 1.0, .scale = 0.1, .enabled = 1u};
    s_terms.term[0].comp = (uint8_t)axis;
    s_terms.term[0].gain = s_terms.term[0].basis[0].c1 = s_terms.term[0].basis[1].c1 = 1.0;
    given_session(&s_est, &s_arm, &s_terms, s_truth, 5u, 0.0);
    for (uint32_t i = 0u; i < 5u; i++) {
        /* a turn of the base moves the arm as well: nothing is seen of that */
        for (uint32_t k = 0u; k < 6u; k++) { s_est.obs[i].cov[7u * k] = k == axis ? 1e-3 : 1e9; }
    }
    s_est.obs[2].cov[7u * axis] = 1e-3 * part / (4.0 * (1.0 - part));
}

/* Five poses one second apart, known to 1 mm (first: 0) or 1 mrad (first: 3) along each axis, and one coefficient that
 * moves or turns the arm along x, with a camera whose chain is exact. */
static void given_poses_of_an_exact_camera(uint32_t first)
{
    given_one_leading_pose(first, 0.5);
    given_camera(&s_camera);
    s_camera.mast_sigma_m = s_camera.mast_sigma_rad = s_camera.zero_sigma_rad = s_camera.axis_sigma_rad = 0.0;
    s_camera.plate_sigma_m = s_camera.plate_sigma_rad = s_camera.tag_size_sigma = 0.0;
    s_camera.drift_sigma_m_s = s_camera.drift_sigma_rad_s = 0.0;
    s_est.camera = &s_camera;
    s_est.opt.outlier_p = 1e-300; /* tested, none rejected */
    for (uint32_t i = 0u; i < 5u; i++) {
        for (uint32_t k = first; k < first + 3u; k++) { s_est.obs[i].cov[7u * k] = 1e-6; }
        s_est.obs[i].ctx.t_s = 1000.0 + (double)i;
    }
}

/* Observation i is seen farther along, or turned about, an axis. */
static void seen_off(uint32_t i, uint32_t component, double by)
{
    kc_obs_t *o = &s_est.obs[i];
    double w[3] = {0.0}, turn[9], R[9];
    kc_pose_t T;
    if (component < 3u) {
        o->p_m[component] += by;
        return;
    }
    w[component - 3u] = by;
    kc_R_exp(w, turn);
    kc_pose_from_quat(o->p_m, o->q_wxyz, &T);
    kc_m3_mul(turn, T.R, R);
    kc_R_to_quat(R, o->q_wxyz);
}

/* Of residual and variance, in mm, along one axis: the others are exact. */
static void assert_worst(double residual_mm, double variance_mm2)
{
    const uint32_t rows = s_est.obs[0].has_rot != 0u ? 6u : 3u;
    const double p = kc_chi2_sf(residual_mm * residual_mm / variance_mm2, rows);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT32(5u, s_est.job.n_tested);
    TEST_ASSERT_DOUBLE_WITHIN(1e-6 * p, p, s_est.job.p_worst);
}

/* A shift or a turn of the mast moves all poses alike: what is stated, 0.5 mm or mrad, and four others know it to
 * 1/(4 + 4). */
void test_a_residual_is_what_the_other_poses_do_not_know_of_the_camera_chain(void)
{
    static const uint32_t cases[][2] = {{0u, 1u}, {0u, 2u}, {3u, 4u}, {3u, 5u}}; /* first, another axis */
    for (uint32_t c = 0u; c < 4u; c++) {
        const uint32_t first = cases[c][0], other = cases[c][1], third = 2u * first + 3u - other;
        double *sigma = first == 0u ? &s_camera.mast_sigma_m : &s_camera.mast_sigma_rad;
        given_poses_of_an_exact_camera(first);
        s_terms.n_coef = s_terms.n_term = 2u; /* and one along the third axis, which fits */
        s_terms.coef[1] = s_terms.coef[0];
        s_terms.term[1] = s_terms.term[0];
        s_terms.term[1].coef = 1u;
        s_terms.term[1].comp = (uint8_t)third;
        seen_off(3u, other, 0.005);
        assert_worst(5.0, 1.0); /* it is no coefficient's: nothing of it is fitted */
        *sigma = 0.0005;
        assert_worst(5.0, 1.0 + 1.0 / (4.0 + 4.0));
        seen_off(3u, other, -0.005);
        for (uint32_t i = 0u; i < 5u; i++) { seen_off(i, other, 0.002); }
        /* the four others expect 4/8 of the 2 */
        assert_worst(1.0, 1.0 + 1.0 / (4.0 + 4.0));
        /* x is a coefficient's as well: the other four have taken all of it */
        for (uint32_t i = 0u; i < 5u; i++) {
            seen_off(i, other, -0.002);
            seen_off(i, first, 0.002);
        }
        assert_worst(0.0, 1.0);
        for (uint32_t i = 0u; i < 5u; i++) { seen_off(i, first, -0.002); }
        for (uint32_t axis = first; axis < first + 3u; axis++) { /* the four others know those two to 1/4 */
            seen_off(3u, axis, 0.005);
            assert_worst(5.0, 1.0 + (axis == other ? 1.0 / (4.0 + 4.0) : 1.0 / 4.0));
            seen_off(3u, axis, -0.005);
        }
    }
}

/* One is off by 30 mm, another by 20: without the first, 23 degrees of freedom show more than is stated. */
void test_noise_that_the_other_poses_show_counts_if_it_is_larger_than_stated(void)
{
    given_poses_of_an_exact_camera(0u);
    seen_off(1u, 1u, 0.02);
    seen_off(3u, 2u, 0.03);
    assert_worst(30.0, 400.0 / (30.0 - 1.0 - 6.0));
}

/* A drift of 1 mm/s from the first pose on is seen 4 s after it: by 1, 2 and 3 mm of the others. */
void test_the_drift_of_the_camera_is_known_by_the_time_of_the_other_poses(void)
{
    given_poses_of_an_exact_camera(0u);
    s_camera.drift_sigma_m_s = 0.001;
    s_est.obs[4].p_m[2] += 0.008;
    assert_worst(8.0, 1.0 + 16.0 / (1.0 + 1.0 + 4.0 + 9.0));
}

void test_positions_alone_know_of_the_camera_chain_too(void)
{
    given_poses_of_an_exact_camera(0u);
    for (uint32_t i = 0u; i < 5u; i++) { s_est.obs[i].has_rot = 0u; }
    s_camera.mast_sigma_m = 0.0005;
    for (uint32_t axis = 1u; axis < 3u; axis++) {
        seen_off(3u, axis, 0.005);
        assert_worst(5.0, 1.0 + 1.0 / (4.0 + 4.0));
        seen_off(3u, axis, -0.005);
    }
}

/* ---- the same by dense algebra: coefficients and errors of the chain fitted together, without the pose that is tested ---- */

#define N_POSES 9u
#define N_FITTED 6u
#define N_BOTH (N_FITTED + KC_CHAIN_COUNT)

static double s_row[N_POSES][N_BOTH + 1u][6]; /* whitened, of one pose: columns, then the residual */

/* Poses of which two have no rotation, some seconds apart; each error of the chain is about as large as the noise. */
static void given_a_chain_that_matters(uint32_t wrong)
{
    given_arm(&s_arm);
    given_terms(&s_terms);
    memset(s_truth, 0, sizeof s_truth);
    given_camera(&s_camera);
    s_camera.mast_sigma_m = s_camera.plate_sigma_m = 1e-3;
    s_camera.mast_sigma_rad = s_camera.zero_sigma_rad = 1.5e-3;
    s_camera.plate_sigma_rad = s_camera.axis_sigma_rad = 4e-3;
    s_camera.tag_size_sigma = 2e-3;
    s_camera.drift_sigma_m_s = s_camera.drift_sigma_rad_s = 2e-4;
    given_session(&s_est, &s_arm, &s_terms, s_truth, N_POSES, 1.0);
    for (uint32_t i = 0u; i < N_POSES; i++) {
        s_est.obs[i].ctx.t_s = 500.0 + (double)i;
        s_est.obs[i].ctx.pan_rad = 0.1 * (double)i;
        s_est.obs[i].ctx.tilt_rad = 0.3 - 0.05 * (double)i;
        s_est.obs[i].has_rot = i % 5u == 1u ? 0 : 1;
    }
    seen_off(wrong, wrong % 3u, 0.006);
    s_est.camera = &s_camera;
    s_est.opt.outlier_p = 1e-300;
    s_est.opt.tol_step = 1e-12;
    s_est.opt.free_mask = 0u;
    for (uint32_t c = 0u; c < N_FITTED; c++) { s_est.opt.free_mask |= (uint64_t)1u << (4u * c + c % 4u); }
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT32(N_FITTED, s_est.n_column);
    kc_est_pass_begin(&s_est, KC_EST_PASS_OUTLIER, s_est.coef);
    for (uint32_t i = 0u; i < N_POSES; i++) {
        const kc_obs_t *o = &s_est.obs[i];
        double raw[6], H[KC_CHAIN_COUNT][6], W[36];
        const uint32_t m = kc_est_block(&s_est, i, raw);
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_la_whiten(o->cov, m, W));
        kc_est_chain_motion(&s_est, &s_camera, i, H);
        memset(s_row[i], 0, sizeof s_row[i]);
        memcpy(s_row[i], s_est.blk, sizeof s_row[i][0] * N_FITTED);
        memcpy(s_row[i][N_BOTH], &s_est.blk[6u * N_FITTED], sizeof s_row[i][0]);
        for (uint32_t k = 0u; k < KC_CHAIN_COUNT; k++) {
            for (uint32_t a = 0u; a < m; a++) {
                for (uint32_t b = 0u; b <= a; b++) { s_row[i][N_FITTED + k][a] += W[6u * a + b] * H[k][b]; }
            }
        }
    }
}

/* Least squares of all poses but one (N_POSES: of all); what remains of chi-square. */
static double fit_without(uint32_t without, double *inverse, double *x)
{
    double A[N_BOTH * N_BOTH] = {0.0}, g[N_BOTH] = {0.0}, chi2 = 0.0;
    for (uint32_t k = N_FITTED; k < N_BOTH; k++) { A[k * (N_BOTH + 1u)] = 1.0; }
    for (uint32_t i = 0u; i < N_POSES; i++) {
        if (i == without) { continue; }
        const double(*row)[6] = (const double(*)[6])s_row[i];
        for (uint32_t k = 0u; k < N_BOTH; k++) {
            g[k] += dense_dot(row[k], row[N_BOTH], 6u);
            for (uint32_t l = 0u; l < N_BOTH; l++) { A[k * N_BOTH + l] += dense_dot(row[k], row[l], 6u); }
        }
        chi2 += dense_dot(row[N_BOTH], row[N_BOTH], 6u);
    }
    dense_invert(N_BOTH, N_BOTH, A, inverse);
    for (uint32_t k = 0u; k < N_BOTH; k++) { x[k] = dense_dot(&inverse[k * N_BOTH], g, N_BOTH); }
    return chi2 - dense_dot(g, x, N_BOTH);
}

void test_deleted_residuals_are_those_of_a_fit_of_coefficients_and_chain_without_the_pose(void)
{
    static double inverse[N_BOTH * N_BOTH], x[N_BOTH], unused[N_BOTH * N_BOTH];
    for (uint32_t i = 0u; i < N_POSES; i++) {
        given_a_chain_that_matters(i);
        const uint32_t rows = s_est.obs[i].has_rot != 0u ? 6u : 3u;
        const double rest = fit_without(i, inverse, x);
        double S[36], off[6], y[6];
        for (uint32_t a = 0u; a < 6u; a++) {
            off[a] = s_row[i][N_BOTH][a];
            for (uint32_t k = 0u; k < N_BOTH; k++) { off[a] -= s_row[i][k][a] * x[k]; }
            for (uint32_t b = 0u; b < 6u; b++) {
                S[6u * a + b] = a == b ? 1.0 : 0.0;
                for (uint32_t k = 0u; k < N_BOTH; k++) {
                    for (uint32_t l = 0u; l < N_BOTH; l++) {
                        S[6u * a + b] += s_row[i][k][a] * inverse[k * N_BOTH + l] * s_row[i][l][b];
                    }
                }
            }
        }
        dense_solve6(S, off, y);
        const double d2 = dense_dot(off, y, 6u), all = fit_without(N_POSES, unused, x);
        TEST_ASSERT_DOUBLE_WITHIN(1e-5 * all, all, rest + d2);
        const double others = rest / (double)(s_est.job.sums.rows - N_FITTED - rows);
        const double p = kc_chi2_sf(d2 / fmax(1.0, others), rows);
        TEST_ASSERT_EQUAL_UINT32(i, s_est.job.worst);
        TEST_ASSERT_DOUBLE_WITHIN(1e-4 * p, p, s_est.job.p_worst);
    }
}

/* Of a chain that is stated too large for the digits nothing is taken to be known. */
void test_a_chain_of_absurd_size_explains_nothing(void)
{
    given_poses_of_an_exact_camera(0u);
    s_camera.mast_sigma_m = 1e200;
    s_est.obs[3].p_m[1] += 0.005;
    assert_worst(5.0, 1.0);
}

/* Below a hundredth it is never an outlier; the four others are tested. */
void test_a_pose_that_alone_determines_one_axis_is_not_tested(void)
{
    for (uint32_t axis = 0u; axis < 6u; axis++) {
        given_one_leading_pose(axis, 0.009);
        (void)kc_est_solve(&s_est);
        TEST_ASSERT_EQUAL_UINT32(1u, s_est.rank);
        TEST_ASSERT_EQUAL_UINT32(4u, s_est.job.n_tested);
        given_one_leading_pose(axis, 0.011);
        (void)kc_est_solve(&s_est);
        TEST_ASSERT_EQUAL_UINT32(5u, s_est.job.n_tested);
        for (double part = 1e-13; part > 1e-20; part *= 0.5) { /* of rounding, also below zero */
            given_one_leading_pose(axis, part);
            (void)kc_est_solve(&s_est);
            TEST_ASSERT_EQUAL_UINT32(4u, s_est.job.n_tested);
        }
    }
}

/* Without it as many rows remain as coefficients: there is no noise to compare it with. */
void test_a_pose_without_which_nothing_is_left_over_is_not_tested(void)
{
    given_session(&s_est, &s_arm, &s_terms, s_truth, 5u, 1.0);
    s_est.opt.free_mask = (1u << 24) - 1u; /* 30 rows for 24 */
    for (uint32_t c = 0u; c < 28u; c++) { s_est.start[c] = s_truth[c]; }
    (void)kc_est_solve(&s_est);
    TEST_ASSERT_EQUAL_UINT32(24u, s_est.n_free);
    TEST_ASSERT_EQUAL_UINT32(0u, s_est.job.n_tested);
    s_est.opt.free_mask = (1u << 20) - 1u;
    (void)kc_est_solve(&s_est);
    TEST_ASSERT_TRUE(s_est.job.n_tested > 0u);
}

/* Priors hold the coefficients, so that six poses for 28 of them leave their residuals alone: all are tested, and the
 * wrong one goes. */
void test_with_tight_priors_no_pose_determines_a_direction_alone(void)
{
    memset(s_truth, 0, sizeof s_truth);
    given_session(&s_est, &s_arm, &s_terms, s_truth, 6u, 1.0);
    for (uint32_t c = 0u; c < 28u; c++) { s_terms.coef[c].prior_sigma = 1e-3 * s_terms.coef[c].scale; }
    s_est.opt.use_prior = 1u;
    s_est.opt.outlier_max = 1u;
    s_est.obs[2].p_m[0] += 0.1;
    (void)kc_est_solve(&s_est);
    TEST_ASSERT_EQUAL_UINT32(6u, s_est.job.n_tested);
    TEST_ASSERT_EQUAL_UINT8(1u, s_est.outlier[2]);
    /* of exact poses one is off by 5 sigma: as likely as the stated noise makes it, though the others show less */
    given_session(&s_est, &s_arm, &s_terms, s_truth, 6u, 0.0);
    s_est.opt.use_prior = 1u;
    s_est.opt.outlier_p = 1e-9;
    s_est.obs[2].p_m[0] += 5.0 * OBS_POS_M;
    (void)kc_est_solve(&s_est);
    TEST_ASSERT_EQUAL_UINT32(0u, s_est.n_outliers);
    TEST_ASSERT_DOUBLE_WITHIN(0.1 * kc_chi2_sf(25.0, 6u), kc_chi2_sf(25.0, 6u), s_est.job.p_worst);
}

void test_noise_larger_than_stated_is_no_reason_to_reject(void)
{
    given_session(&s_est, &s_arm, &s_terms, s_truth, 25u, 4.0);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT32(0u, s_est.n_outliers);
    TEST_ASSERT_DOUBLE_WITHIN(1.0, 4.0, s_est.noise_scale);
}

void test_a_fit_that_ran_out_of_iterations_rejects_no_pose(void)
{
    given_session(&s_est, &s_arm, &s_terms, s_truth, 15u, 1.0);
    s_est.obs[7].p_m[1] += 0.05;
    s_est.opt.iter_max = 1u;
    TEST_ASSERT_EQUAL_INT(KC_ERR_ITER, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT32(0u, s_est.n_outliers);
}

void test_an_observation_left_out_beforehand_is_an_outlier_whatever_its_residual(void)
{
    given_session(&s_est, &s_arm, &s_terms, s_truth, 15u, 1.0);
    s_est.obs[3].p_m[1] += 0.3; /* so far off that it would spoil the first fit */
    s_est.without = 4u;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT32(1u, s_est.n_outliers);
    TEST_ASSERT_EQUAL_UINT8(1u, s_est.outlier[3]);
    TEST_ASSERT_EQUAL_UINT32(14u * 6u - s_est.rank, s_est.dof);
    TEST_ASSERT_TRUE(s_est.noise_scale < 2.0);
    s_est.without = 0u;
    s_est.opt.outlier_p = 0.0;
    (void)kc_est_solve(&s_est);
    TEST_ASSERT_EQUAL_UINT32(0u, s_est.n_outliers);
    TEST_ASSERT_TRUE(s_est.noise_scale > 2.0);
}

/* How improbable the worst pose is times how many were tested, counted anew for each fit: with the limit just above
 * that of the second wrong pose both go, just below it one stays. */
void test_poses_tested_are_counted_anew_after_each_rejection(void)
{
    for (uint32_t k = 0u; k < 2u; k++) {
        double least = 0.0;
        for (uint32_t both = 0u; both < 2u; both++) {
            given_session(&s_est, &s_arm, &s_terms, s_truth, 20u, 1.0);
            s_est.obs[3].p_m[0] += 0.2;
            s_est.obs[12].p_m[1] += 0.0035;
            s_est.without = both == 0u ? 4u : 0u;
            s_est.opt.outlier_p = both == 0u ? 1e-300 : (k == 0u ? 1.3 : 0.8) * least;
            TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
            if (both == 0u) {
                least = s_est.job.p_worst * (double)s_est.job.n_tested;
                TEST_ASSERT_TRUE(least > 1e-20 && least < 1e-3 && s_est.job.worst == 12u);
            }
        }
        TEST_ASSERT_EQUAL_UINT32(k == 0u ? 2u : 1u, s_est.n_outliers);
        TEST_ASSERT_EQUAL_UINT8(k == 0u ? 1u : 0u, s_est.outlier[12]);
    }
}
