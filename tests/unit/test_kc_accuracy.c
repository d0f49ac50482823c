/* kc_accuracy.c: degrees of freedom and bounds by hand; tests/oracle/test_accuracy.py compares quantiles with those of
 * weighted chi-squares. */
#include <math.h>
#include <string.h>

#include "kc_accuracy.h"
#include "unity.h"

static kc_accuracy_t s_accuracy;
static kc_est_t s_est;
static kc_terms_t s_terms;
static kc_eval_t s_eval;
static double s_chain[6][KC_CHAIN_COUNT], s_known[KC_CHAIN_COUNT];

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
