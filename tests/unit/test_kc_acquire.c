/* kc_acquire.c: contract; choices against brute force in numpy are in tests/oracle/test_acquire.py. */
#include <math.h>
#include <string.h>

#include "given_observations.h"
#include "given_tables.h"
#include "kc_acquire.h"
#include "unity.h"

#define N_CAND 30u

static kc_arm_t s_arm;
static kc_terms_t s_terms;
static kc_est_t s_est;
static kc_acq_work_t s_work;
static kc_kernel_t s_kernel;
static kc_gp_t s_gp;
static kc_point_t s_cand[N_CAND];
static float s_q[N_CAND * KC_JOINT_MAX];
static uint8_t s_usable[N_CAND];
static double s_cov[36];
static double s_truth[KC_COEF_MAX];
static uint32_t s_c;
static double s_value;

void setUp(void)
{
    uint64_t rng = 11u;
    double q[KC_JOINT_MAX];
    given_arm(&s_arm);
    given_terms(&s_terms);
    given_kernel(&s_kernel);
    given_paper_errors(s_truth);
    memset(s_cov, 0, sizeof s_cov);
    for (int i = 0; i < 6; i++) { s_cov[7 * i] = pow(i < 3 ? OBS_POS_M : OBS_ROT_RAD, 2.0); }
    memset(s_q, 0, sizeof s_q);
    for (uint32_t c = 0u; c < N_CAND; c++) {
        kc_pose_t T;
        given_joints(&s_arm, &rng, q);
        kc_arm_fk(&s_arm, q, &T);
        memcpy(s_cand[c].p_m, T.p_m, sizeof T.p_m);
        kc_R_to_quat(T.R, s_cand[c].q_wxyz);
        for (uint32_t j = 0u; j < s_arm.n_joints; j++) { s_q[c * KC_JOINT_MAX + j] = (float)q[j]; }
        s_usable[c] = 1u;
    }
    (void)kc_gp_init(&s_gp, &s_kernel, 0u, s_cand, N_CAND);
    s_c = 999u;
    s_value = 999.0;
}

static kc_status_t info(kc_acq_t kind)
{
    return kc_acq_info(kind, &s_est, s_q, N_CAND, s_usable, s_cov, 0.3, &s_work, &s_c, &s_value);
}

void test_beta_is_that_of_srinivas(void)
{
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 2.0 * log(600.0 * 16.0 * 9.869604401089358 / 0.6),
                              kc_acq_beta(600u, 4u, 1.0));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.2 * kc_acq_beta(600u, 4u, 1.0), kc_acq_beta(600u, 4u, 0.2));
}

void test_objective_is_scaled_by_the_largest_so_far(void)
{
    const double dp[3] = {0.1, 0.2, 0.0};
    const double dr[3] = {0.5, 0.0, 1.0};
    double y[3];
    kc_acq_objective(dp, dr, 3u, 0.25, 0.01, 0.01, y);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, -(0.25 * 0.5 + 0.75 * 0.5), y[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, -0.25, y[1]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, -0.75, y[2]);
}

void test_objective_does_not_blow_noise_up_beyond_the_floors(void)
{
    const double dp[2] = {0.001, 9.0}; /* the second one is not of this calibration */
    const double dr[2] = {0.002, 9.0};
    double y[2] = {7.0, 7.0};
    kc_acq_objective(dp, dr, 1u, 0.5, 0.01, 0.04, y);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, -(0.5 * 0.1 + 0.5 * 0.05), y[0]);
    TEST_ASSERT_EQUAL_DOUBLE(7.0, y[1]);
    kc_acq_objective((const double[2]){0.4, 0.1}, (const double[2]){0.8, 0.2}, 2u, 0.5, 0.01, 0.04, y);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, -1.0, y[0]); /* the first one is the largest */
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, -0.25, y[1]);
}

void test_ucb_without_data_takes_the_first_usable(void)
{
    s_usable[0] = s_usable[1] = 0u;
    for (uint32_t c = 0u; c < N_CAND; c++) { s_gp.var[c] = 1.0; } /* equal to the bit */
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_acq_ucb(&s_gp, s_usable, 4.0, &s_c, &s_value));
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 2.0, s_value);
    TEST_ASSERT_EQUAL_UINT32(2u, s_c);
}

/* Of two candidates with the same mean the less certain one, by sqrt(beta) times the difference of the sigmas. */
void test_ucb_adds_the_square_root_of_beta_times_sigma(void)
{
    memset(s_usable, 0, sizeof s_usable);
    s_usable[3] = s_usable[7] = 1u;
    s_gp.var[3] = 0.04;
    s_gp.var[7] = 0.09;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_acq_ucb(&s_gp, s_usable, 25.0, &s_c, &s_value));
    TEST_ASSERT_EQUAL_UINT32(7u, s_c);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 5.0 * 0.3, s_value);
}

void test_ucb_takes_the_first_candidate_too(void)
{
    memset(&s_usable[1], 0, N_CAND - 1u);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_acq_ucb(&s_gp, s_usable, 4.0, &s_c, &s_value));
    TEST_ASSERT_EQUAL_UINT32(0u, s_c);
}

void test_ucb_takes_none_beyond_the_last_candidate(void)
{
    (void)kc_gp_init(&s_gp, &s_kernel, 0u, s_cand, N_CAND - 1u);
    s_gp.var[N_CAND - 1u] = 100.0;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_acq_ucb(&s_gp, s_usable, 4.0, &s_c, &s_value));
    TEST_ASSERT_TRUE(s_c < N_CAND - 1u);
}

void test_random_takes_the_only_one_that_is_left(void)
{
    uint64_t rng = 3u;
    memset(s_usable, 0, sizeof s_usable);
    s_usable[N_CAND - 1u] = 1u;
    TEST_ASSERT_EQUAL_INT(KC_ERR_ARG, kc_acq_random(s_usable, N_CAND - 1u, &rng, &s_c)); /* beyond the last */
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_acq_random(s_usable, N_CAND, &rng, &s_c));
    TEST_ASSERT_EQUAL_UINT32(N_CAND - 1u, s_c);
    s_usable[N_CAND - 1u] = 0u; /* and 255 is as usable as 1 */
    s_usable[0] = 255u;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_acq_random(s_usable, N_CAND, &rng, &s_c));
    TEST_ASSERT_EQUAL_UINT32(0u, s_c);
}

void test_ucb_without_exploration_goes_where_the_mean_is_best(void)
{
    (void)kc_gp_add(&s_gp, &s_cand[4], -1.0, s_cand);
    (void)kc_gp_add(&s_gp, &s_cand[9], 1.0, s_cand);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_acq_ucb(&s_gp, s_usable, 0.0, &s_c, &s_value));
    TEST_ASSERT_EQUAL_UINT32(9u, s_c);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, kc_gp_cand_mean(&s_gp, 9u), s_value);
}

void test_ucb_with_much_exploration_leaves_what_it_knows(void)
{
    for (uint32_t c = 0u; c < N_CAND - 1u; c++) { (void)kc_gp_add(&s_gp, &s_cand[c], 0.0, s_cand); }
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_acq_ucb(&s_gp, s_usable, 100.0, &s_c, &s_value));
    TEST_ASSERT_EQUAL_UINT32(N_CAND - 1u, s_c);
}

void test_nothing_usable_is_refused_by_all(void)
{
    uint64_t rng = 5u;
    memset(s_usable, 0, sizeof s_usable);
    given_session(&s_est, &s_arm, &s_terms, s_truth, 6u, 0.0);
    TEST_ASSERT_EQUAL_INT(KC_ERR_ARG, kc_acq_ucb(&s_gp, s_usable, 1.0, &s_c, &s_value));
    TEST_ASSERT_EQUAL_INT(KC_ERR_ARG, kc_acq_random(s_usable, N_CAND, &rng, &s_c));
    TEST_ASSERT_EQUAL_INT(KC_ERR_ARG, info(KC_ACQ_DOPT));
    TEST_ASSERT_EQUAL_INT(KC_ERR_ARG, info(KC_ACQ_VOPT));
    TEST_ASSERT_EQUAL_UINT64(5u, rng);
}

void test_random_takes_every_usable_one_and_no_other(void)
{
    uint64_t rng = 1u;
    uint32_t n[N_CAND] = {0u};
    for (uint32_t c = 0u; c < N_CAND; c += 3u) { s_usable[c] = 0u; }
    for (uint32_t i = 0u; i < 4000u; i++) {
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_acq_random(s_usable, N_CAND, &rng, &s_c));
        n[s_c]++;
    }
    for (uint32_t c = 0u; c < N_CAND; c++) {
        /* 20 usable, 200 each expected, standard deviation 14 */
        if (s_usable[c] == 0u) { TEST_ASSERT_EQUAL_UINT32(0u, n[c]); }
        if (s_usable[c] != 0u) { TEST_ASSERT_UINT32_WITHIN(70u, 200u, n[c]); }
    }
}

void test_same_seed_same_choice(void)
{
    uint64_t a = 77u;
    uint64_t b = 77u;
    uint32_t other;
    for (int i = 0; i < 20; i++) {
        (void)kc_acq_random(s_usable, N_CAND, &a, &s_c);
        (void)kc_acq_random(s_usable, N_CAND, &b, &other);
        TEST_ASSERT_EQUAL_UINT32(other, s_c);
    }
}

void test_information_before_the_local_initial_pose_comes_from_the_prior(void)
{
    given_session(&s_est, &s_arm, &s_terms, s_truth, 0u, 0.0);
    TEST_ASSERT_EQUAL_INT(KC_OK, info(KC_ACQ_DOPT));
    TEST_ASSERT_TRUE(s_c < N_CAND && s_value > 0.0);
    TEST_ASSERT_EQUAL_INT(KC_OK, info(KC_ACQ_VOPT));
    TEST_ASSERT_TRUE(s_c < N_CAND && s_value > 0.0);
}

void test_information_only_falls_in_value_as_observations_come_in(void)
{
    double gain = INFINITY;
    double spread = INFINITY;
    for (uint32_t n = 1u; n < 12u; n += 3u) {
        given_session(&s_est, &s_arm, &s_terms, s_truth, n, 0.0);
        TEST_ASSERT_EQUAL_INT(KC_OK, info(KC_ACQ_DOPT));
        TEST_ASSERT_TRUE(s_value > 0.0 && s_value < gain);
        gain = s_value;
        TEST_ASSERT_EQUAL_INT(KC_OK, info(KC_ACQ_VOPT));
        TEST_ASSERT_TRUE(s_value > 0.0 && s_value < spread);
        spread = s_value;
    }
}

void test_only_usable_candidates_are_chosen_by_information(void)
{
    given_session(&s_est, &s_arm, &s_terms, s_truth, 4u, 0.0);
    (void)info(KC_ACQ_DOPT);
    const uint32_t best = s_c;
    const double gain = s_value;
    s_usable[best] = 0u;
    TEST_ASSERT_EQUAL_INT(KC_OK, info(KC_ACQ_DOPT));
    TEST_ASSERT_TRUE(s_c != best && s_value <= gain);
}

void test_masked_and_disabled_coefficients_and_outliers_carry_no_information(void)
{
    given_session(&s_est, &s_arm, &s_terms, s_truth, 4u, 0.0);
    (void)info(KC_ACQ_DOPT);
    const double all = s_value;
    s_est.opt.free_mask = 0xffffu;
    s_terms.coef[0].enabled = 0u;
    (void)info(KC_ACQ_DOPT);
    TEST_ASSERT_EQUAL_UINT32(15u, s_work.n);
    TEST_ASSERT_TRUE(s_value < all);
    s_est.opt.free_mask = ~(uint64_t)0u;
    s_terms.coef[0].enabled = 1u;
    s_est.outlier[1] = 1u;
    (void)info(KC_ACQ_DOPT);
    TEST_ASSERT_TRUE(s_value > all);
}

void test_own_priors_replace_the_scale(void)
{
    given_session(&s_est, &s_arm, &s_terms, s_truth, 2u, 0.0);
    (void)info(KC_ACQ_DOPT);
    const double loose = s_value;
    s_est.opt.use_prior = 1u;
    for (uint32_t c = 0u; c < s_terms.n_coef; c++) {
        s_terms.coef[c].prior_sigma = 0.01 * s_terms.coef[c].scale;
    }
    TEST_ASSERT_EQUAL_INT(KC_OK, info(KC_ACQ_DOPT));
    TEST_ASSERT_TRUE(s_value < loose);
}

void test_position_only_observations_count_three_rows(void)
{
    given_session(&s_est, &s_arm, &s_terms, s_truth, 6u, 0.0);
    (void)info(KC_ACQ_DOPT);
    const double full = s_value;
    for (uint32_t i = 0u; i < 6u; i++) { s_est.obs[i].has_rot = 0u; }
    TEST_ASSERT_EQUAL_INT(KC_OK, info(KC_ACQ_DOPT));
    TEST_ASSERT_TRUE(s_value > full);
}

void test_impossible_requests_are_refused(void)
{
    given_session(&s_est, &s_arm, &s_terms, s_truth, 4u, 0.0);
    TEST_ASSERT_EQUAL_INT(KC_ERR_ARG, info(KC_ACQ_UCB));
    TEST_ASSERT_EQUAL_INT(KC_ERR_ARG, info(KC_ACQ_RANDOM));
    TEST_ASSERT_EQUAL_INT(KC_ERR_ARG, kc_acq_info(KC_ACQ_VOPT, &s_est, s_q, N_CAND, s_usable, s_cov, 0.0,
                                                  &s_work, &s_c, &s_value));
    s_cov[0] = -1.0;
    TEST_ASSERT_EQUAL_INT(KC_ERR_ARG, info(KC_ACQ_DOPT));
    s_cov[0] = 1e-6;
    s_est.opt.free_mask = 0u;
    TEST_ASSERT_EQUAL_INT(KC_ERR_ARG, info(KC_ACQ_DOPT));
    TEST_ASSERT_EQUAL_UINT32(999u, s_c);
}

void test_a_refused_choice_ends_the_one_before(void)
{
    kc_work_t budget = {1u, 0u};
    given_session(&s_est, &s_arm, &s_terms, s_truth, 4u, 0.0);
    kc_acq_info_begin(KC_ACQ_DOPT, &s_est, s_cov, 0.3, &s_work);
    TEST_ASSERT_FALSE(kc_acq_info_step(&s_est, s_q, N_CAND, s_usable, &s_work, &budget));
    kc_acq_info_begin(KC_ACQ_UCB, &s_est, s_cov, 0.3, &s_work);
    TEST_ASSERT_TRUE(kc_acq_info_step(&s_est, s_q, N_CAND, s_usable, &s_work, &budget));
    TEST_ASSERT_EQUAL_INT(KC_ERR_ARG, s_work.status);
}

void test_a_choice_that_was_not_begun_is_over(void)
{
    kc_work_t budget = {1u, 0u};
    memset(&s_work, 0, sizeof s_work);
    given_session(&s_est, &s_arm, &s_terms, s_truth, 4u, 0.0);
    TEST_ASSERT_TRUE(kc_acq_info_step(&s_est, s_q, N_CAND, s_usable, &s_work, &budget));
    TEST_ASSERT_EQUAL_UINT64(0u, budget.used);
}

void test_what_is_not_finite_is_reported(void)
{
    given_session(&s_est, &s_arm, &s_terms, s_truth, 4u, 0.0);
    s_q[3] = NAN;
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, info(KC_ACQ_DOPT));
    s_est.coef[2] = NAN;
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, info(KC_ACQ_DOPT));
}

/* ---- against the definition: the whole information matrix, inverted anew for each candidate ---- */

#define N_REQ 10u
typedef double matrix_t[N_REQ][N_REQ];

/* Gauss and Jordan without pivoting, for a positive definite matrix: its inverse, and ln of its determinant. */
static double inverted(const matrix_t A, matrix_t out)
{
    matrix_t a;
    double log_det = 0.0;
    memcpy(a, A, sizeof a);
    memset(out, 0, sizeof a);
    for (uint32_t i = 0u; i < N_REQ; i++) { out[i][i] = 1.0; }
    for (uint32_t k = 0u; k < N_REQ; k++) {
        double pivot = a[k][k];
        log_det += log(pivot);
        for (uint32_t j = 0u; j < N_REQ; j++) {
            a[k][j] /= pivot;
            out[k][j] /= pivot;
        }
        for (uint32_t i = 0u; i < N_REQ; i++) {
            double f = i == k ? 0.0 : a[i][k];
            for (uint32_t j = 0u; j < N_REQ; j++) {
                a[i][j] -= f * a[k][j];
                out[i][j] -= f * out[k][j];
            }
        }
    }
    return log_det;
}

static uint32_t s_requested[N_REQ];

/* A += J' diag(1 / var) J of the requested coefficients in units of their scale. */
static void informed(const kc_eval_t *ev, const double *var, uint32_t rows, matrix_t A)
{
    for (uint32_t i = 0u; i < N_REQ; i++) {
        for (uint32_t j = 0u; j < N_REQ; j++) {
            uint32_t a = s_requested[i], b = s_requested[j];
            double s = 0.0;
            for (uint32_t k = 0u; k < rows; k++) { s += ev->J[a][k] * ev->J[b][k] / var[k]; }
            A[i][j] += s * s_terms.coef[a].scale * s_terms.coef[b].scale;
        }
    }
}

/* Eight DH errors, a compliance and an effect of temperature; noise of its own on every axis, one pose without
 * rotation, one outlier, one own prior; it gets warmer from pose to pose. */
static void given_requests(uint32_t n_obs)
{
    const kc_coef_t more = {.name = "more", .lb = -1.0, .ub = 1.0, .scale = 0.003, .enabled = 1u};
    s_terms.coef[28] = s_terms.coef[29] = more;
    s_terms.term[28] = (kc_term_t){.coef = 28u, .frame = 1u, .comp = KC_RZ, .gain = 0.02};
    s_terms.term[28].basis[0] = (kc_basis_t){KC_FN_LIN, KC_VAR_TAU, 2u, 0.0, 1.0};
    s_terms.term[29] = (kc_term_t){.coef = 29u, .frame = 2u, .comp = KC_TX, .gain = 0.3};
    s_terms.term[29].basis[0] = (kc_basis_t){KC_FN_LIN, KC_VAR_TEMP, 0u, 10.0, 0.1};
    s_terms.n_coef = s_terms.n_term = 30u;
    given_session(&s_est, &s_arm, &s_terms, s_truth, n_obs, 0.0);
    s_est.opt.free_mask = 0u;
    for (uint32_t i = 0u; i < N_REQ; i++) {
        s_requested[i] = i < 8u ? 3u * i + 1u : 20u + i;
        s_est.opt.free_mask |= (uint64_t)1u << s_requested[i];
    }
    s_est.opt.use_prior = 1u;
    s_terms.coef[s_requested[3]].prior_sigma = 0.25 * s_terms.coef[s_requested[3]].scale;
    for (uint32_t i = 0u; i < n_obs; i++) {
        s_est.obs[i].ctx.temp_c = 20.0 + 5.0 * (double)i;
        s_est.obs[i].has_rot = i != 2u;
        for (uint32_t k = 0u; k < 6u; k++) { s_est.obs[i].cov[7u * k] *= 1.0 + (double)k + (double)i; }
        s_est.outlier[i] = i == 1u;
    }
    for (uint32_t k = 0u; k < 6u; k++) { s_cov[7u * k] *= 3.0 - 0.4 * (double)k; }
    s_est.coef[1] = 0.05;
    s_est.coef[28] = 0.01;
    s_est.coef[29] = 0.02;
}

static kc_eval_t s_at[N_CAND];

/* What is known before, and the derivatives at the candidates. */
static void known_before(matrix_t A)
{
    static kc_eval_t ev;
    kc_loads_t loads;
    double r[6], var[6];
    memset(A, 0, sizeof(matrix_t));
    for (uint32_t i = 0u; i < N_REQ; i++) { A[i][i] = i == 3u ? 16.0 : 1.0; }
    for (uint32_t i = 0u; i < s_est.n_obs; i++) {
        const kc_obs_t *o = &s_est.obs[i];
        if (s_est.outlier[i] != 0u) { continue; }
        kc_model_loads(&s_arm, &s_terms, s_est.coef, &o->ctx, &loads);
        uint32_t rows = kc_model_residual(&s_arm, &s_terms, s_est.coef, o, &loads, r, &ev);
        for (uint32_t k = 0u; k < 6u; k++) { var[k] = o->cov[7u * k]; }
        informed(&ev, var, rows, A);
    }
    for (uint32_t c = 0u; c < N_CAND; c++) {
        kc_ctx_t ctx = {0};
        ctx.g_m_s2[2] = -9.81;
        if (s_est.n_obs > 0u) { ctx = s_est.obs[s_est.n_obs - 1u].ctx; }
        for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { ctx.q[j] = (double)s_q[c * KC_JOINT_MAX + j]; }
        kc_model_loads(&s_arm, &s_terms, s_est.coef, &ctx, &loads);
        kc_model_eval(&s_arm, &s_terms, s_est.coef, &ctx, &loads, true, &s_at[c]);
    }
}

/* Mean over the candidates of position variance over length^2 plus rotation variance, covariance M. */
static double mean_variance(const matrix_t M, double len_m)
{
    double sum = 0.0;
    for (uint32_t c = 0u; c < N_CAND; c++) {
        const double unit[6] = {len_m * len_m, len_m * len_m, len_m * len_m, 1.0, 1.0, 1.0};
        matrix_t B = {{0.0}};
        informed(&s_at[c], unit, 6u, B);
        for (uint32_t i = 0u; i < N_REQ; i++) {
            for (uint32_t j = 0u; j < N_REQ; j++) { sum += B[i][j] * M[j][i]; }
        }
    }
    return sum / N_CAND;
}

/* Both criteria of every candidate from their definitions; the best of the usable, and its value. */
static void best_by_definition(kc_acq_t kind, uint32_t *best, double *value)
{
    matrix_t before, after, M;
    double var[6];
    known_before(before);
    double log_det = inverted(before, M);
    for (uint32_t k = 0u; k < 6u; k++) { var[k] = s_cov[7u * k]; }
    *value = kind == KC_ACQ_DOPT ? -INFINITY : INFINITY;
    for (uint32_t c = 0u; c < N_CAND; c++) {
        if (s_usable[c] == 0u) { continue; }
        memcpy(after, before, sizeof after);
        informed(&s_at[c], var, 6u, after);
        double det = inverted(after, M), x = kind == KC_ACQ_DOPT ? det - log_det : mean_variance(M, 0.3);
        if (kind == KC_ACQ_DOPT ? x > *value : x < *value) {
            *value = x;
            *best = c;
        }
    }
}

static void assert_best_by_definition(kc_acq_t kind)
{
    uint32_t best = 0u;
    double value;
    best_by_definition(kind, &best, &value);
    TEST_ASSERT_EQUAL_INT(KC_OK, info(kind));
    TEST_ASSERT_EQUAL_UINT32(best, s_c);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9 * value, value, s_value);
}

void test_dopt_takes_the_largest_gain_of_the_determinant(void)
{
    given_requests(5u);
    for (uint32_t i = 0u; i < 6u; i++) {
        assert_best_by_definition(KC_ACQ_DOPT);
        s_usable[s_c] = 0u;
    }
}

void test_vopt_takes_the_least_mean_variance_after_the_measurement(void)
{
    given_requests(5u);
    for (uint32_t i = 0u; i < 6u; i++) {
        assert_best_by_definition(KC_ACQ_VOPT);
        s_usable[s_c] = 0u; /* not measured again, but still predicted */
    }
}

void test_after_one_observation_the_rest_is_as_it_was_there(void)
{
    given_requests(1u);
    assert_best_by_definition(KC_ACQ_DOPT);
}

void test_before_the_first_observation_gravity_is_that_of_the_arm_table(void)
{
    given_requests(0u);
    assert_best_by_definition(KC_ACQ_DOPT);
    assert_best_by_definition(KC_ACQ_VOPT);
}

void test_information_in_parts_gives_the_same_bits(void)
{
    static const kc_acq_t kind[2] = {KC_ACQ_DOPT, KC_ACQ_VOPT};
    given_session(&s_est, &s_arm, &s_terms, s_truth, 6u, 0.0);
    for (uint32_t k = 0u; k < 2u; k++) {
        TEST_ASSERT_EQUAL_INT(KC_OK, info(kind[k]));
        kc_acq_info_begin(kind[k], &s_est, s_cov, 0.3, &s_work);
        uint32_t steps = 0u;
        for (bool over = false; !over; steps++) {
            kc_work_t budget = {1u, 0u};
            over = kc_acq_info_step(&s_est, s_q, N_CAND, s_usable, &s_work, &budget);
        }
        TEST_ASSERT_TRUE(steps > N_CAND);
        TEST_ASSERT_EQUAL_INT(KC_OK, s_work.status);
        TEST_ASSERT_EQUAL_UINT32(s_c, s_work.best);
        TEST_ASSERT_EQUAL_MEMORY(&s_value, &s_work.value, sizeof s_value);
    }
}

/* ---- prior by bounds, safe candidates, cost ---- */

static kc_acq_ask_t asked(kc_acq_t kind) { return (kc_acq_ask_t){.kind = kind, .cov = s_cov, .len_m = 0.3}; }

static void answer(const kc_acq_ask_t *ask)
{
    kc_work_t all = kc_work_unlimited();
    kc_acq_begin(ask, &s_est, &s_work);
    (void)kc_acq_info_step(&s_est, s_q, N_CAND, s_usable, &s_work, &all);
}

/* Position sigma of candidate c before it is measured, alone. */
static double sigma_of(uint32_t c, kc_acq_ask_t ask)
{
    memset(s_usable, 0, sizeof s_usable);
    s_usable[c] = 1u;
    answer(&ask);
    memset(s_usable, 1, sizeof s_usable);
    return sqrt(s_work.sigma2_m2);
}

void test_the_prior_by_bounds_is_that_of_errors_anywhere_between_them(void)
{
    kc_acq_ask_t ask = asked(KC_ACQ_DOPT);
    given_session(&s_est, &s_arm, &s_terms, s_truth, 2u, 0.0);
    for (uint32_t c = 0u; c < s_terms.n_coef; c++) {
        double half = s_terms.coef[c].scale * sqrt(3.0); /* the sigma is the scale */
        s_terms.coef[c].lb = -0.5 * half;
        s_terms.coef[c].ub = 1.5 * half;
    }
    answer(&ask);
    const double usual = s_work.value;
    ask.by_bounds = true;
    answer(&ask);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, usual, s_work.value);
    for (uint32_t c = 0u; c < s_terms.n_coef; c++) { s_terms.coef[c].ub *= 3.0; }
    answer(&ask);
    TEST_ASSERT_TRUE(s_work.value > usual + 1.0);
    s_est.opt.use_prior = 1u; /* an own prior counts, not the bounds */
    for (uint32_t c = 0u; c < s_terms.n_coef; c++) { s_terms.coef[c].prior_sigma = s_terms.coef[c].scale; }
    answer(&ask);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, usual, s_work.value);
    s_est.opt.use_prior = 0u;
    s_terms.coef[0].ub = s_terms.coef[0].lb; /* no room, and nothing to gain */
    answer(&ask);
    TEST_ASSERT_EQUAL_INT(KC_OK, s_work.status);
}

void test_the_prior_of_the_estimator_counts_only_where_it_is_asked_for(void)
{
    kc_acq_ask_t ask = asked(KC_ACQ_DOPT);
    given_session(&s_est, &s_arm, &s_terms, s_truth, 2u, 0.0);
    answer(&ask);
    const double usual = s_work.value;
    s_est.by_prior = 1u;
    for (uint32_t c = 0u; c < s_terms.n_coef; c++) { s_est.prior_sigma[c] = s_terms.coef[c].scale; }
    ask.by_prior = true;
    answer(&ask);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, usual, s_work.value);
    for (uint32_t c = 1u; c < s_terms.n_coef; c++) { s_est.prior_sigma[c] *= 1e-4; }
    answer(&ask);
    TEST_ASSERT_TRUE(s_work.value < 0.5 * usual); /* little is left to learn */
    ask.by_prior = false;
    answer(&ask);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, usual, s_work.value); /* by it alone, if that is not asked for */
}

/* What the ground has uplinked counts like a DH error: poses with torque about a joint that yields show it. */
void test_an_uplinked_effect_counts_in_the_information(void)
{
    kc_acq_ask_t ask = asked(KC_ACQ_DOPT);
    given_session(&s_est, &s_arm, &s_terms, s_truth, 2u, 0.0);
    ask.by_bounds = true;
    answer(&ask);
    const double without = s_work.value;
    const uint32_t n = s_work.n, c = s_terms.n_coef++;
    s_terms.coef[c] =
        (kc_coef_t){.name = "joint_compliance[2]", .lb = -0.01, .ub = 0.01, .scale = 0.005, .enabled = 1u};
    s_terms.term[s_terms.n_term++] = (kc_term_t){
        .coef = (uint16_t)c,
        .frame = 1u,
        .comp = KC_RZ,
        .gain = 1.0,
        .basis = {{.fn = KC_FN_LIN, .var = KC_VAR_TAU, .index = 2u, .c1 = 1.0}, {.var = KC_VAR_ONE}}};
    s_est.opt.free_mask |= (uint64_t)1u << c;
    answer(&ask);
    TEST_ASSERT_EQUAL_UINT32(n + 1u, s_work.n);
    TEST_ASSERT_TRUE(s_work.value > without + 0.1);
    const double with = s_work.value;
    s_terms.coef[c].ub = 1e-4;
    s_terms.coef[c].lb = -1e-4; /* hardly anything that it may be */
    answer(&ask);
    TEST_ASSERT_TRUE(s_work.value < with);
}

void test_what_is_not_safe_is_taken_out_of_what_is_eligible(void)
{
    uint32_t n_safe = 0u;
    double sigma[N_CAND], limit = 0.0;
    kc_acq_ask_t ask = asked(KC_ACQ_DOPT);
    given_session(&s_est, &s_arm, &s_terms, s_truth, 2u, 0.0);
    for (uint32_t c = 0u; c < N_CAND; c++) {
        sigma[c] = sigma_of(c, ask);
        limit += sigma[c] / (double)N_CAND; /* some are below it, some above */
    }
    ask.safe_m = limit;
    answer(&ask);
    for (uint32_t c = 0u; c < N_CAND; c++) { TEST_ASSERT_EQUAL_UINT8(1u, s_usable[c]); } /* not asked for */
    s_usable[0] = 0u; /* what is not usable does not become so */
    ask.only_safe = s_usable;
    answer(&ask);
    for (uint32_t c = 0u; c < N_CAND; c++) {
        TEST_ASSERT_EQUAL_UINT8(c > 0u && sigma[c] <= limit, s_usable[c]);
        n_safe += s_usable[c];
    }
    TEST_ASSERT_TRUE(n_safe > 0u && n_safe < N_CAND - 1u);
    TEST_ASSERT_EQUAL_UINT8(1u, s_usable[s_work.best]);
    memset(s_usable, 1, sizeof s_usable);
}

void test_directions_known_are_none_before_and_at_most_the_rows_of_the_observations(void)
{
    kc_acq_ask_t ask = asked(KC_ACQ_DOPT);
    double before = 0.0;
    for (uint32_t n = 0u; n <= 4u; n++) {
        given_session(&s_est, &s_arm, &s_terms, s_truth, n, 0.0);
        answer(&ask);
        TEST_ASSERT_TRUE(s_work.known <= (double)(6u * n) + 1e-9);
        TEST_ASSERT_TRUE(n == 0u ? fabs(s_work.known) < 1e-9 : s_work.known > before + 2.0);
        before = s_work.known;
    }
}

/* Of each coefficient the part of its variance that is gone: any of them alone, all, and with priors of their own. */
void test_directions_known_are_those_of_the_information_by_dense_algebra(void)
{
    for (uint32_t n = 0u; n <= 5u; n++) {
        matrix_t A, M;
        double known = 0.0;
        kc_acq_ask_t ask;
        setUp();
        given_requests(n);
        known_before(A);
        (void)inverted(A, M);
        for (uint32_t i = 0u; i < N_REQ; i++) { known += 1.0 - M[i][i] * (i == 3u ? 16.0 : 1.0); }
        ask = asked(KC_ACQ_DOPT);
        answer(&ask);
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, known, s_work.known);
        TEST_ASSERT_TRUE(n == 0u || known > 3.0);
    }
}

/* J M J' of the position, with noise of other sizes along every axis and two of them in common. */
void test_the_sigma_of_a_candidate_is_that_of_its_predicted_position(void)
{
    matrix_t A, M;
    given_requests(5u);
    known_before(A);
    (void)inverted(A, M);
    s_cov[1] = s_cov[6] = 0.4 * sqrt(s_cov[0] * s_cov[7]);
    s_cov[4] = s_cov[24] = -0.3 * sqrt(s_cov[0] * s_cov[28]);
    for (uint32_t c = 0u; c < 3u; c++) {
        matrix_t B = {{0.0}};
        const double unit[3] = {1.0, 1.0, 1.0};
        double sum = 0.0;
        informed(&s_at[c], unit, 3u, B);
        for (uint32_t i = 0u; i < N_REQ; i++) {
            for (uint32_t j = 0u; j < N_REQ; j++) { sum += B[i][j] * M[j][i]; }
        }
        double sigma = sigma_of(c, asked(KC_ACQ_DOPT));
        TEST_ASSERT_DOUBLE_WITHIN(1e-9 * sigma, sqrt(sum), sigma);
    }
}

void test_safe_candidates_come_first_and_then_the_most_certain_one(void)
{
    kc_acq_ask_t ask = asked(KC_ACQ_DOPT);
    double sigma[N_CAND], least = INFINITY, most = 0.0;
    uint32_t certain = 0u, best;
    given_session(&s_est, &s_arm, &s_terms, s_truth, 3u, 0.0);
    for (uint32_t c = 0u; c < N_CAND; c++) {
        sigma[c] = sigma_of(c, ask);
        if (sigma[c] < least) { certain = c; }
        least = fmin(least, sigma[c]);
        most = fmax(most, sigma[c]);
    }
    answer(&ask);
    best = s_work.best;
    TEST_ASSERT_TRUE(s_work.safe);
    ask.safe_m = 1.001 * most;
    answer(&ask);
    TEST_ASSERT_EQUAL_UINT32(best, s_work.best);
    ask.safe_m = 0.999 * sigma[best];
    answer(&ask);
    TEST_ASSERT_TRUE(s_work.safe && s_work.best != best);
    TEST_ASSERT_TRUE(sigma[s_work.best] <= ask.safe_m);
    ask.safe_m = 0.999 * least;
    answer(&ask);
    TEST_ASSERT_FALSE(s_work.safe);
    TEST_ASSERT_EQUAL_UINT32(certain, s_work.best);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, least, sqrt(s_work.sigma2_m2));
    TEST_ASSERT_EQUAL_INT(KC_OK, s_work.status);
}

void test_gain_is_counted_for_its_cost(void)
{
    float cost[N_CAND];
    kc_acq_ask_t ask = asked(KC_ACQ_DOPT);
    given_session(&s_est, &s_arm, &s_terms, s_truth, 6u, 0.0);
    answer(&ask);
    const uint32_t best = s_work.best;
    const double most = s_work.value;
    for (uint32_t c = 0u; c < N_CAND; c++) { cost[c] = 4.0f; }
    ask.cost = cost;
    answer(&ask);
    TEST_ASSERT_EQUAL_UINT32(best, s_work.best);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12 * most, most / 4.0, s_work.value);
    cost[best] = 4e6f;
    answer(&ask);
    TEST_ASSERT_TRUE(s_work.best != best);
}

/* vopt: the logarithm of what is left of the variance. */
void test_variance_is_counted_for_its_cost_by_its_logarithm(void)
{
    float cost[N_CAND];
    kc_acq_ask_t ask = asked(KC_ACQ_VOPT);
    given_session(&s_est, &s_arm, &s_terms, s_truth, 6u, 0.0);
    answer(&ask);
    const uint32_t best = s_work.best;
    const double left = s_work.value * (double)N_CAND;
    for (uint32_t c = 0u; c < N_CAND; c++) { cost[c] = 2.0f; }
    ask.cost = cost;
    answer(&ask);
    TEST_ASSERT_EQUAL_UINT32(best, s_work.best);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.5 * log(s_work.total / left), s_work.value);
}

void test_rate_is_no_measure_of_its_own(void)
{
    kc_acq_ask_t ask = asked(KC_ACQ_RATE);
    given_session(&s_est, &s_arm, &s_terms, s_truth, 6u, 0.0);
    answer(&ask);
    TEST_ASSERT_EQUAL_INT(KC_ERR_ARG, s_work.status);
}
