/* kc_accuracy.c: degrees of freedom and bounds by hand and by dense algebra; tests/oracle/test_accuracy.py compares quantiles with those of
 * weighted chi-squares. */
#include <math.h>
#include <string.h>

#include "given_dense.h"
#include "kc_accuracy.h"
#include "unity.h"

static kc_accuracy_t s_accuracy;
static kc_est_t s_est;
static kc_terms_t s_terms;
static kc_eval_t s_eval;
static double s_chain[6][KC_CHAIN_COUNT], s_known[KC_CHAIN_COUNT + 1u];

void setUp(void)
{
    memset(&s_est, 0, sizeof s_est);
    memset(&s_eval, 0, sizeof s_eval);
    memset(s_chain, 0, sizeof s_chain);
    memset(s_known, 0, sizeof s_known);
    s_terms.n_coef = 3u;
    s_est.terms = &s_terms;
    for (uint32_t c = 0u; c < 3u; c++) { s_est.cov[c * (KC_COEF_MAX + 1u)] = 1e-6; }
    kc_accuracy_begin(&s_accuracy, &s_est);
}

static double dof(void)
{
    kc_accuracy_add(&s_accuracy, &s_eval, s_chain);
    return kc_accuracy_dof(&s_accuracy, s_accuracy.pos, &s_est, 2.0, s_known);
}

void test_an_error_along_one_direction_has_one_degree_of_freedom(void)
{
    s_eval.J[0][0] = 1.0;
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, 1.0, dof());
    TEST_ASSERT_EQUAL_DOUBLE(1.0, kc_accuracy_square(&s_accuracy, s_accuracy.pos, 0u));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, kc_accuracy_square(&s_accuracy, s_accuracy.rot, 0u));
}

void test_three_alike_have_three(void)
{
    for (uint32_t c = 0u; c < 3u; c++) { s_eval.J[c][c] = 1.0; }
    TEST_ASSERT_DOUBLE_WITHIN(1e-5, 3.0, dof());
}

/* Variances 4 and 1 in units of 1e-6 scale^2: (4 + 1)^2 / (16 + 1). */
void test_unequal_ones_have_fewer(void)
{
    s_eval.J[0][0] = 2.0;
    s_eval.J[1][1] = 1.0;
    TEST_ASSERT_DOUBLE_WITHIN(1e-5, 25.0 / 17.0, dof());
}

/* What goes together at all poses is one direction, whatever the number of poses. */
void test_poses_that_are_off_together_count_once(void)
{
    s_eval.J[0][0] = 1.0;
    for (uint32_t k = 0u; k < 5u; k++) { kc_accuracy_add(&s_accuracy, &s_eval, s_chain); }
    TEST_ASSERT_DOUBLE_WITHIN(1e-5, 1.0, dof());
    TEST_ASSERT_EQUAL_UINT32(6u, s_accuracy.n_poses);
}

/* The chain as large as the noise, 2 mm each: two directions; along the same one: one. */
void test_the_chain_is_part_of_it(void)
{
    s_eval.J[0][0] = 1.0;
    s_chain[1][5] = 2e-3;
    TEST_ASSERT_DOUBLE_WITHIN(1e-5, 2.0, dof());
    setUp();
    s_eval.J[0][0] = 1.0;
    s_chain[0][5] = 2e-3;
    TEST_ASSERT_DOUBLE_WITHIN(1e-5, 1.0, dof());
}

/* Chain alone, what is known of it 3 sigma: mean 1 + 9, half the variance 1 + 2 x 9. */
void test_what_is_known_of_the_chain_does_not_vary(void)
{
    s_chain[0][5] = 1e-3;
    s_known[5] = 3.0;
    TEST_ASSERT_DOUBLE_WITHIN(1e-5, 100.0 / 19.0, dof());
}

void test_nothing_unknown_is_a_bound_of_nothing(void)
{
    TEST_ASSERT_EQUAL_DOUBLE(1.0, dof());
    TEST_ASSERT_EQUAL_DOUBLE(0.0, kc_accuracy_bound(0.0, 1.0, 0.9));
}

/* Quantiles of chi-square at 0.9: 6.251 of 3, 2.706 of 1 (tables). */
void test_a_bound_is_the_quantile_over_the_mean(void)
{
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 1.443536009384632e-3, kc_accuracy_bound(1e-3, 3.0, 0.9));
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 1.6448536269514722e-3, kc_accuracy_bound(1e-3, 1.0, 0.9));
    TEST_ASSERT_EQUAL_DOUBLE(1e-3, kc_accuracy_bound(1e-3, 3.0, 0.0));
}

/* ---- any arm, by dense algebra ---- */

#define N_ALL (3u + KC_CHAIN_COUNT)

static double s_S[2][N_ALL][N_ALL],
    s_V[N_ALL][N_ALL]; /* of position, of rotation; covariance of what is unknown */

/* Poses of an arm whose every number is different, and their sums. */
static void given_poses(uint32_t n, uint64_t *rng)
{
    memset(s_S, 0, sizeof s_S);
    for (uint32_t k = 0u; k < n; k++) {
        double *row[N_ALL], chain[KC_CHAIN_COUNT][6];
        for (uint32_t i = 0u; i < N_ALL; i++) {
            row[i] = i < 3u ? s_eval.J[i] : chain[i - 3u];
            for (uint32_t c = 0u; c < 6u; c++) { row[i][c] = drawn(rng) * (i < 3u ? 1.0 : 1e-3); }
        }
        for (uint32_t c = 0u; c < 6u; c++) {
            for (uint32_t i = 0u; i < KC_CHAIN_COUNT; i++) { s_chain[c][i] = chain[i][c]; }
            for (uint32_t i = 0u; i < N_ALL; i++) {
                for (uint32_t j = 0u; j < N_ALL; j++) { s_S[c / 3u][i][j] += row[i][c] * row[j][c]; }
            }
        }
        kc_accuracy_add(&s_accuracy, &s_eval, s_chain);
    }
}

/* Covariance A A' of the coefficients, times scale^2; of the chain unit, with a mean. Behind all of it is no number. */
static void given_unknown(double scale, uint64_t *rng)
{
    double A[3][3];
    memset(s_V, 0, sizeof s_V);
    for (uint32_t k = 0u; k < KC_COEF_MAX * KC_COEF_MAX; k++) { s_est.cov[k] = NAN; }
    for (uint32_t k = N_ALL * (N_ALL + 1u) / 2u; k < sizeof s_accuracy.pos / sizeof *s_accuracy.pos; k++) {
        s_accuracy.pos[k] = s_accuracy.rot[k] = (float)NAN;
    }
    s_known[KC_CHAIN_COUNT] = NAN;
    for (uint32_t i = 0u; i < 3u; i++) {
        for (uint32_t j = 0u; j < 3u; j++) { A[i][j] = 1e-3 * drawn(rng); }
    }
    for (uint32_t i = 0u; i < 3u; i++) {
        for (uint32_t j = 0u; j < 3u; j++) {
            double v = 0.0;
            for (uint32_t k = 0u; k < 3u; k++) { v += A[i][k] * A[j][k]; }
            s_est.cov[i * KC_COEF_MAX + j] = v;
            s_V[i][j] = scale * scale * v;
        }
    }
    for (uint32_t i = 0u; i < KC_CHAIN_COUNT; i++) {
        s_V[3u + i][3u + i] = 1.0;
        s_known[i] = drawn(rng);
    }
}

/* 2 mean^2 / variance of x' S x, x normal of covariance V and mean b: mean tr(S V) + b' S b, variance
 * 2 tr(S V S V) + 4 b' S V S b. */
static double dense_dof(double (*S)[N_ALL])
{
    double P[N_ALL][N_ALL], Sb[N_ALL], b[N_ALL] = {0.0}, mean = 0.0, var = 0.0;
    memcpy(&b[3], s_known, KC_CHAIN_COUNT * sizeof *b);
    for (uint32_t i = 0u; i < N_ALL; i++) {
        Sb[i] = 0.0;
        for (uint32_t j = 0u; j < N_ALL; j++) {
            P[i][j] = 0.0;
            for (uint32_t k = 0u; k < N_ALL; k++) { P[i][j] += S[i][k] * s_V[k][j]; }
            Sb[i] += S[i][j] * b[j];
        }
        mean += P[i][i] + b[i] * Sb[i];
    }
    for (uint32_t i = 0u; i < N_ALL; i++) {
        for (uint32_t j = 0u; j < N_ALL; j++) {
            var += 2.0 * P[i][j] * P[j][i] + 4.0 * Sb[i] * s_V[i][j] * Sb[j];
        }
    }
    return 2.0 * mean * mean / var;
}

void test_degrees_of_freedom_are_those_of_the_moments_by_dense_algebra(void)
{
    uint64_t rng = 11u;
    for (uint32_t k = 0u; k < 20u; k++) {
        const double scale = 0.5 + 0.25 * (double)k;
        setUp();
        given_poses(1u + k % 4u, &rng);
        given_unknown(scale, &rng);
        const float *sums[2] = {s_accuracy.pos, s_accuracy.rot};
        for (uint32_t kind = 0u; kind < 2u; kind++) {
            double want = dense_dof(s_S[kind]);
            TEST_ASSERT_TRUE(want > 1.0 && want < 50.0);
            TEST_ASSERT_DOUBLE_WITHIN(1e-4 * want, want,
                                      kc_accuracy_dof(&s_accuracy, sums[kind], &s_est, scale, s_known));
            for (uint32_t c = 0u; c < 3u; c++) {
                double square = s_S[kind][c][c] / (double)s_accuracy.n_poses;
                TEST_ASSERT_DOUBLE_WITHIN(1e-6 * square, square,
                                          kc_accuracy_square(&s_accuracy, sums[kind], c));
            }
        }
    }
}

/* As many coefficients as there may be, alike and each by itself: all count, and none beyond. */
void test_as_many_as_there_may_be_count(void)
{
    static double errors[6][KC_CHAIN_COUNT];
    s_terms.n_coef = KC_COEF_MAX;
    kc_accuracy_begin(&s_accuracy, &s_est);
    for (uint32_t c = 0u; c < KC_COEF_MAX; c++) { /* a pose for each */
        memset(&s_eval, 0, sizeof s_eval);
        s_eval.J[c][0] = 1.0;
        s_est.cov[c * (KC_COEF_MAX + 1u)] = 1e-6;
        kc_accuracy_add(&s_accuracy, &s_eval, errors);
    }
    TEST_ASSERT_DOUBLE_WITHIN(1e-3, KC_COEF_MAX,
                              kc_accuracy_dof(&s_accuracy, s_accuracy.pos, &s_est, 1.0, s_known));
    TEST_ASSERT_EQUAL_DOUBLE(1.0 / KC_COEF_MAX, kc_accuracy_square(&s_accuracy, s_accuracy.pos, 0u));
}

void test_the_costs_grow_as_the_loops(void)
{
    s_terms.n_coef = 0u;
    uint64_t add = kc_accuracy_add_cost(&s_est), dof_none = kc_accuracy_dof_cost(&s_est);
    s_terms.n_coef = KC_COEF_MAX;
    TEST_ASSERT_TRUE(kc_accuracy_add_cost(&s_est) > add + 30u * KC_COEF_MAX * KC_COEF_MAX);
    TEST_ASSERT_TRUE(kc_accuracy_dof_cost(&s_est) > dof_none + 20u * KC_COEF_MAX * KC_COEF_MAX * KC_COEF_MAX);
}
