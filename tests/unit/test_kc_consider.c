/* kc_consider.c: what it adds to covariance, chi-square and predicted error, by hand in one coefficient. The whole
 * of it against dense least squares: tests/oracle/test_consider.py. */
#include <math.h>
#include <string.h>

#include "given_dense.h"
#include "kc_consider.h"
#include "unity.h"

static kc_consider_t s_con;
static kc_est_t s_est;
static kc_terms_t s_terms;
static kc_eval_t s_eval;
static double s_H[KC_CHAIN_COUNT][6];

/* Two poses of one coefficient that moves the tool along x: chain error 0 moves both as the coefficient does, 13
 * only the second one, along y. */
static const double BEFORE[2][6] = {{3.0, 1.0}, {5.0, 2.0}}, AFTER[2][6] = {{-1.0, 1.0}, {1.0, 2.0}};
static const double W[36] = {1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0,
                             0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1};

static void add(uint32_t i, double first, double second)
{
    memset(s_H, 0, sizeof s_H);
    s_H[0][0] = first;
    if (i == 1u) { s_H[KC_CHAIN_MAST][1] = second; }
    const kc_consider_pose_t pose = {BEFORE[i], AFTER[i], W, &s_eval, s_H};
    kc_consider_add(&s_con, &s_est, &pose);
}

static void given_sums(double first, double second)
{
    memset(&s_est, 0, sizeof s_est);
    memset(&s_terms, 0, sizeof s_terms);
    memset(&s_eval, 0, sizeof s_eval);
    s_terms.n_coef = 1u;
    s_est.terms = &s_terms;
    s_est.cov[0] = 0.5; /* J'J = 2 */
    s_eval.J[0][0] = 1.0;
    kc_consider_begin(&s_con);
    add(0u, first, second);
    add(1u, first, second);
    kc_consider_end(&s_con, &s_est);
}

void setUp(void) { given_sums(2.0, 3.0); }

void test_an_error_that_the_coefficient_imitates_goes_into_its_covariance(void)
{
    TEST_ASSERT_EQUAL_DOUBLE(4.0, kc_consider_cov(&s_con, 0u, 0u)); /* S = 2 */
    given_sums(0.0, 3.0);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, kc_consider_cov(&s_con, 0u, 0u));
}

void test_an_error_that_only_residuals_show_is_taken_off_their_chi_square(void)
{
    /* b = 3 x 2, 1 + A = 1 + 9; the first one shows in no residual */
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 36.0 / 10.0, kc_consider_explains_after(&s_con, KC_CHAIN_COUNT));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, kc_consider_explains_after(&s_con, KC_CHAIN_MAST));
    /* of the table in force: 2 x (3 + 5) over 1 + 8 as well */
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 256.0 / 9.0, kc_consider_explains_before(&s_con, KC_CHAIN_MAST));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 256.0 / 9.0 + 3.6, kc_consider_explains_before(&s_con, KC_CHAIN_COUNT));
}

/* In the base frame the first error counts in full, since the residuals say nothing of it, and the second not at
 * all. Against the camera the first one, of the tags, too, and of the second what it most likely is. */
void test_the_predicted_error_is_what_the_residuals_leave_open_and_what_they_show(void)
{
    double pos2, rot2, seen[KC_CHAIN_COUNT][6];
    kc_consider_pose(&s_con, &s_est, &s_eval, NULL, &pos2, &rot2);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 4.0, pos2);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, rot2);
    memset(seen, 0, sizeof seen);
    seen[0][0] = 2.0;
    seen[KC_CHAIN_MAST][1] = 3.0;
    seen[KC_CHAIN_MAST][5] = 1.0;
    kc_consider_pose(&s_con, &s_est, &s_eval, seen, &pos2, &rot2);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 4.0 + 9.0 * (0.6 * 0.6 + 0.1), pos2);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.6 * 0.6 + 0.1, rot2);
}

void test_with_more_noise_the_residuals_say_less_of_the_chain(void)
{
    double pos2, rot2, seen[KC_CHAIN_COUNT][6];
    memset(seen, 0, sizeof seen);
    seen[KC_CHAIN_MAST][1] = 1.0;
    kc_consider_scale(&s_con, 3.0); /* A = 9 / 9, b = 6 / 9 */
    kc_consider_pose(&s_con, &s_est, &s_eval, seen, &pos2, &rot2);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 4.0 + 1.0 / 9.0 + 0.5, pos2);
    kc_consider_scale(&s_con, 1.0);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 3.6, kc_consider_explains_after(&s_con, KC_CHAIN_COUNT));
}

/* Sums whose digits are lost: the chain explains nothing, and is as unknown as stated. */
void test_sums_that_cannot_be_factored_explain_nothing(void)
{
    double pos2, rot2, seen[KC_CHAIN_COUNT][6];
    given_sums(2.0, 1e200);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, kc_consider_explains_after(&s_con, KC_CHAIN_COUNT));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, kc_consider_explains_before(&s_con, KC_CHAIN_COUNT));
    for (uint32_t k = 0u; k < KC_CHAIN_COUNT; k++) {
        TEST_ASSERT_EQUAL_DOUBLE(0.0, s_con.b_after[k]);
        for (uint32_t j = 0u; j <= k; j++) {
            TEST_ASSERT_EQUAL_DOUBLE(j == k ? 1.0 : 0.0, s_con.L[k * KC_CHAIN_COUNT + j]);
        }
    }
    memset(seen, 0, sizeof seen);
    seen[KC_CHAIN_MAST][1] = 3.0;
    kc_consider_pose(&s_con, &s_est, &s_eval, seen, &pos2, &rot2);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 4.0 + 9.0, pos2);
}

/* The same where two errors look alike: neither is said to tell of the other. */
void test_sums_that_cannot_be_factored_couple_nothing(void)
{
    kc_consider_begin(&s_con);
    memset(s_H, 0, sizeof s_H);
    s_H[2][1] = s_H[KC_CHAIN_MAST][1] = s_H[KC_CHAIN_MAST + 4u][1] = s_H[KC_CHAIN_COUNT - 1u][1] = 1e200;
    const kc_consider_pose_t pose = {BEFORE[0], AFTER[0], W, &s_eval, s_H};
    kc_consider_add(&s_con, &s_est, &pose);
    kc_consider_end(&s_con, &s_est);
    for (uint32_t k = 0u; k < KC_CHAIN_COUNT; k++) {
        TEST_ASSERT_EQUAL_DOUBLE(0.0, s_con.b_after[k]);
        for (uint32_t j = 0u; j <= k; j++) {
            TEST_ASSERT_EQUAL_DOUBLE(j == k ? 1.0 : 0.0, s_con.L[k * KC_CHAIN_COUNT + j]);
            TEST_ASSERT_EQUAL_DOUBLE(j == k ? 1.0 : 0.0, s_con.HH[k * KC_CHAIN_COUNT + j]);
        }
    }
}

void test_of_an_exact_chain_nothing_remains(void)
{
    double pos2, rot2;
    given_sums(0.0, 0.0);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, kc_consider_explains_after(&s_con, KC_CHAIN_COUNT));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, kc_consider_explains_before(&s_con, KC_CHAIN_COUNT));
    kc_consider_pose(&s_con, &s_est, &s_eval, NULL, &pos2, &rot2);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, pos2);
}

/* ---- three coefficients and the whole chain, against least squares over both at once ---- */

#define N_COEF 3u
#define N_POSE 5u
#define N_ALL (N_COEF + KC_CHAIN_COUNT)

static struct {
    double W[36], J[N_COEF][6], H[KC_CHAIN_COUNT][6], r[6];
} s_pose[N_POSE];
static double s_all[N_ALL][N_ALL], s_rhs[N_ALL], s_cov[N_ALL][N_ALL], s_solution[N_ALL];
static uint64_t s_rng;

/* Whitened row k of unknown i of a pose: coefficients, then the chain. */
static double element(uint32_t pose, uint32_t i, uint32_t k)
{
    const double *col = i < N_COEF ? s_pose[pose].J[i] : s_pose[pose].H[i - N_COEF];
    double s = 0.0;
    for (uint32_t j = 0u; j <= k; j++) { s += s_pose[pose].W[6u * k + j] * col[j]; }
    return s;
}

/* Normal equations of coefficients and the first n errors of the chain, which have a prior of 1, from whitened
 * residuals; the noise is `scale` times as stated. Returns the least chi-square. */
static double least_squares(uint32_t n, double scale, const double r[N_POSE][6])
{
    double chi2 = 0.0;
    memset(s_all, 0, sizeof s_all);
    memset(s_rhs, 0, sizeof s_rhs);
    for (uint32_t p = 0u; p < N_POSE; p++) {
        for (uint32_t k = 0u; k < 6u; k++) {
            chi2 += r[p][k] * r[p][k];
            for (uint32_t i = 0u; i < N_COEF + n; i++) {
                s_rhs[i] += element(p, i, k) * r[p][k] / (scale * scale);
                for (uint32_t j = 0u; j < N_COEF + n; j++) {
                    s_all[i][j] += element(p, i, k) * element(p, j, k) / (scale * scale);
                }
            }
        }
    }
    for (uint32_t i = 0u; i < n; i++) { s_all[N_COEF + i][N_COEF + i] += 1.0; }
    dense_invert(N_COEF + n, N_ALL, s_all[0], s_cov[0]);
    for (uint32_t i = 0u; i < N_COEF + n; i++) {
        s_solution[i] = 0.0;
        for (uint32_t j = 0u; j < N_COEF + n; j++) { s_solution[i] += s_cov[i][j] * s_rhs[j]; }
        chi2 -= s_solution[i] * s_rhs[i];
    }
    return chi2;
}

static double s_before[N_POSE][6], s_after[N_POSE][6];

/* Whitened residuals before and after the estimate of the coefficients alone; sums of all poses. */
static void given_poses(void)
{
    s_rng = 21u;
    memset(&s_est, 0, sizeof s_est);
    s_terms.n_coef = N_COEF;
    s_est.terms = &s_terms;
    for (uint32_t p = 0u; p < N_POSE; p++) {
        for (uint32_t k = 0u; k < 6u; k++) {
            s_before[p][k] = 3.0 * drawn(&s_rng);
            for (uint32_t j = 0u; j < 6u; j++) {
                s_pose[p].W[6u * k + j] = j < k ? 0.3 * drawn(&s_rng) : j == k ? 1.5 + drawn(&s_rng) : 0.0;
            }
            for (uint32_t i = 0u; i < N_COEF; i++) { s_pose[p].J[i][k] = drawn(&s_rng); }
            for (uint32_t i = 0u; i < KC_CHAIN_COUNT; i++) { s_pose[p].H[i][k] = 0.7 * drawn(&s_rng); }
        }
    }
    (void)least_squares(0u, 1.0, (const double(*)[6])s_before);
    kc_consider_begin(&s_con);
    for (uint32_t i = N_COEF * KC_CHAIN_COUNT; i < KC_COEF_MAX * KC_CHAIN_COUNT; i++) { s_con.S[i] = NAN; }
    for (uint32_t p = 0u; p < N_POSE; p++) {
        for (uint32_t k = 0u; k < 6u; k++) {
            s_after[p][k] = s_before[p][k];
            for (uint32_t i = 0u; i < N_COEF; i++) { s_after[p][k] -= element(p, i, k) * s_solution[i]; }
        }
        memcpy(s_eval.J, s_pose[p].J, sizeof s_pose[p].J);
        const kc_consider_pose_t pose = {s_before[p], s_after[p], s_pose[p].W, &s_eval, s_pose[p].H};
        kc_consider_add(&s_con, &s_est, &pose);
    }
    for (uint32_t i = 0u; i < N_COEF; i++) {
        for (uint32_t j = 0u; j < N_COEF; j++) { s_est.cov[i * KC_COEF_MAX + j] = s_cov[i][j]; }
    }
    kc_consider_end(&s_con, &s_est);
}

/* With the estimate: what the chain takes off is the difference of two least squares. */
void test_the_chain_takes_off_what_least_squares_over_it_take_off(void)
{
    given_poses();
    double alone = least_squares(0u, 1.0, (const double(*)[6])s_after);
    static const uint32_t n[] = {1u, KC_CHAIN_DRIFT, KC_CHAIN_MAST, KC_CHAIN_COUNT};
    for (uint32_t i = 0u; i < sizeof n / sizeof n[0]; i++) {
        double off = alone - least_squares(n[i], 1.0, (const double(*)[6])s_after);
        TEST_ASSERT_DOUBLE_WITHIN(1e-10, off, kc_consider_explains_after(&s_con, n[i]));
    }
}

/* Information on each coefficient alone with the first n errors of the chain unknown: what their least squares leave. */
void test_what_is_visible_of_a_coefficient_is_what_the_chain_cannot_imitate(void)
{
    static const uint32_t n[] = {0u, 1u, KC_CHAIN_DRIFT, KC_CHAIN_MAST, KC_CHAIN_COUNT};
    static double own[N_ALL][N_ALL], inverse[N_ALL][N_ALL];
    for (uint32_t k = 0u; k < sizeof n / sizeof n[0]; k++) {
        given_poses(); /* sums without their end are needed */
        kc_consider_begin(&s_con);
        for (uint32_t p = 0u; p < N_POSE; p++) {
            memcpy(s_eval.J, s_pose[p].J, sizeof s_pose[p].J);
            const kc_consider_pose_t pose = {s_before[p], s_after[p], s_pose[p].W, &s_eval, s_pose[p].H};
            kc_consider_add(&s_con, &s_est, &pose);
        }
        kc_consider_visible(&s_con, &s_est, n[k]);
        (void)least_squares(n[k], 1.0, (const double(*)[6])s_after);
        for (uint32_t c = 0u; c < N_COEF; c++) { /* the coefficient first, then the chain */
            memset(own, 0, sizeof own);
            for (uint32_t i = 0u; i <= n[k]; i++) {
                for (uint32_t j = 0u; j <= n[k]; j++) {
                    own[i][j] = s_all[i == 0u ? c : N_COEF + i - 1u][j == 0u ? c : N_COEF + j - 1u];
                }
            }
            dense_invert(n[k] + 1u, N_ALL, own[0], inverse[0]);
            TEST_ASSERT_DOUBLE_WITHIN(1e-9, 1.0 / inverse[0][0], s_con.visible[c]);
        }
    }
}

/* With the table in force nothing but the chain is fitted. */
void test_before_the_estimate_the_coefficients_explain_nothing(void)
{
    given_poses();
    for (uint32_t p = 0u; p < N_POSE; p++) { memset(s_pose[p].J, 0, sizeof s_pose[p].J); }
    (void)least_squares(KC_CHAIN_COUNT, 1.0, (const double(*)[6])s_before);
    static double chain[N_ALL][N_ALL], inverse[N_ALL][N_ALL];
    double off = 0.0;
    memset(chain, 0, sizeof chain);
    for (uint32_t i = 0u; i < KC_CHAIN_COUNT; i++) {
        memcpy(chain[i], &s_all[N_COEF + i][N_COEF], KC_CHAIN_COUNT * sizeof(double));
    }
    dense_invert(KC_CHAIN_COUNT, N_ALL, chain[0], inverse[0]);
    for (uint32_t i = 0u; i < KC_CHAIN_COUNT; i++) {
        for (uint32_t j = 0u; j < KC_CHAIN_COUNT; j++) {
            off += s_rhs[N_COEF + i] * inverse[i][j] * s_rhs[N_COEF + j];
        }
    }
    TEST_ASSERT_DOUBLE_WITHIN(1e-10, off, kc_consider_explains_before(&s_con, KC_CHAIN_COUNT));
}

/* The estimate moves by -P J'H c: its covariance grows by that of c, which is the identity. */
static void moved(double S[N_COEF][KC_CHAIN_COUNT])
{
    (void)least_squares(KC_CHAIN_COUNT, 1.0, (const double(*)[6])s_after);
    for (uint32_t i = 0u; i < N_COEF; i++) {
        for (uint32_t k = 0u; k < KC_CHAIN_COUNT; k++) {
            S[i][k] = 0.0;
            for (uint32_t j = 0u; j < N_COEF; j++) {
                S[i][k] += s_est.cov[i * KC_COEF_MAX + j] * s_all[j][N_COEF + k];
            }
        }
    }
}

void test_the_covariance_grows_by_what_the_chain_does_to_the_estimate(void)
{
    double S[N_COEF][KC_CHAIN_COUNT];
    given_poses();
    moved(S);
    for (uint32_t i = 0u; i < N_COEF; i++) {
        for (uint32_t j = 0u; j < N_COEF; j++) {
            double s = 0.0;
            for (uint32_t k = 0u; k < KC_CHAIN_COUNT; k++) { s += S[i][k] * S[j][k]; }
            TEST_ASSERT_DOUBLE_WITHIN(1e-12, s, kc_consider_cov(&s_con, i, j));
        }
    }
}

/* Mean and covariance of the chain, given the residuals, are those of least squares over both. A predicted pose is off by
 * what the chain does to the estimate, less what it does to the camera's view of that pose. */
static void assert_predicted(double scale, bool from_camera)
{
    double S[N_COEF][KC_CHAIN_COUNT], seen[KC_CHAIN_COUNT][6], square[6], pos2, rot2;
    moved(S);
    (void)least_squares(KC_CHAIN_COUNT, scale, (const double(*)[6])s_after);
    for (uint32_t k = 0u; k < KC_CHAIN_COUNT; k++) {
        for (uint32_t a = 0u; a < 6u; a++) { seen[k][a] = drawn(&s_rng); }
    }
    for (uint32_t a = 0u; a < 6u; a++) {
        double e[KC_CHAIN_COUNT], mean = 0.0;
        square[a] = 0.0;
        for (uint32_t k = 0u; k < KC_CHAIN_COUNT; k++) {
            e[k] = from_camera && k >= KC_CHAIN_DRIFT ? -seen[k][a] : 0.0;
            for (uint32_t i = 0u; i < N_COEF; i++) { e[k] += s_eval.J[i][a] * S[i][k]; }
            mean += e[k] * s_solution[N_COEF + k];
        }
        for (uint32_t k = 0u; k < KC_CHAIN_COUNT; k++) {
            for (uint32_t l = 0u; l < KC_CHAIN_COUNT; l++) {
                square[a] += e[k] * s_cov[N_COEF + k][N_COEF + l] * e[l];
            }
        }
        square[a] += mean * mean;
    }
    kc_consider_scale(&s_con, scale);
    kc_consider_pose(&s_con, &s_est, &s_eval, from_camera ? seen : NULL, &pos2, &rot2);
    TEST_ASSERT_DOUBLE_WITHIN(1e-10, square[0] + square[1] + square[2], pos2);
    TEST_ASSERT_DOUBLE_WITHIN(1e-10, square[3] + square[4] + square[5], rot2);
}

void test_a_predicted_pose_is_off_by_what_least_squares_know_of_the_chain(void)
{
    given_poses();
    assert_predicted(1.0, false);
    assert_predicted(1.0, true);
    assert_predicted(2.5, true);
}
