/* kc_consider.c: what it adds to covariance, chi-square and predicted error, by hand in one coefficient. The whole
 * of it against dense least squares: tests/oracle/test_consider.py. */
#include <math.h>
#include <string.h>

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

void setUp(void);
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
    memset(seen, 0, sizeof seen);
    seen[KC_CHAIN_MAST][1] = 3.0;
    kc_consider_pose(&s_con, &s_est, &s_eval, seen, &pos2, &rot2);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 4.0 + 9.0, pos2);
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
