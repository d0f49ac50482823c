/* kc_qp.c: small problems with known answers, and how it can end. Random ones: tests/oracle. */
#include <math.h>
#include <string.h>

#include "given_dense.h"
#include "kc_qp.h"
#include "kc_qp_priv.h"
#include "kc_rng.h"
#include "unity.h"

static kc_qp_t s_qp;

/* n variables, H = 0, box -1 .. 1, g = 0, start 0; in the work space what another problem left. */
static void given(uint32_t n)
{
    memset(&s_qp, 0, sizeof s_qp);
    for (uint32_t i = 0u; i < KC_COEF_MAX * KC_COEF_MAX; i++) { s_qp.L[i] = 3.0; }
    for (uint32_t i = 0u; i < KC_COEF_MAX; i++) {
        s_qp.d[i] = -2.0;
        s_qp.grad[i] = 9.0;
    }
    s_qp.n = n;
    for (uint32_t i = 0u; i < n; i++) {
        s_qp.lb[i] = -1.0;
        s_qp.ub[i] = 1.0;
    }
}

static double *H(uint32_t i, uint32_t j) { return &s_qp.H[i * KC_COEF_MAX + j]; }

static void given_identity(uint32_t n)
{
    given(n);
    for (uint32_t i = 0u; i < n; i++) { *H(i, i) = 1.0; }
}

void test_a_minimum_inside_the_box_is_found(void)
{
    given_identity(2u);
    *H(0, 1) = *H(1, 0) = 0.5;
    s_qp.g[0] = -0.5;
    s_qp.g[1] = -0.25;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.5, s_qp.x[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.0, s_qp.x[1]);
    TEST_ASSERT_EQUAL_UINT8(KC_QP_FREE, s_qp.active[0]);
    TEST_ASSERT_EQUAL_UINT8(KC_QP_FREE, s_qp.active[1]);
}

void test_bounds_that_hold_are_reported_with_their_side(void)
{
    given_identity(3u);
    s_qp.g[0] = 5.0;
    s_qp.g[1] = -5.0;
    s_qp.g[2] = 0.25;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    TEST_ASSERT_EQUAL_DOUBLE(-1.0, s_qp.x[0]);
    TEST_ASSERT_EQUAL_DOUBLE(1.0, s_qp.x[1]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, -0.25, s_qp.x[2]);
    TEST_ASSERT_EQUAL_UINT8(KC_QP_AT_LOWER, s_qp.active[0]);
    TEST_ASSERT_EQUAL_UINT8(KC_QP_AT_UPPER, s_qp.active[1]);
    TEST_ASSERT_EQUAL_UINT8(KC_QP_FREE, s_qp.active[2]);
    TEST_ASSERT_TRUE(s_qp.kkt <= 1e-9);
}

void test_a_start_on_the_wrong_bound_is_left_again(void)
{
    given_identity(2u);
    s_qp.g[0] = -0.5;
    s_qp.g[1] = 0.5;
    s_qp.x[0] = -7.0; /* clipped to the lower bound */
    s_qp.x[1] = 7.0;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.5, s_qp.x[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, -0.5, s_qp.x[1]);
}

void test_many_bounds_met_at_the_same_point_are_taken_together(void)
{
    given_identity(10u);
    for (uint32_t i = 0u; i < 10u; i++) { s_qp.g[i] = -3.0; }
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    for (uint32_t i = 0u; i < 10u; i++) { TEST_ASSERT_EQUAL_UINT8(KC_QP_AT_UPPER, s_qp.active[i]); }
    TEST_ASSERT_TRUE(s_qp.iters <= 2u);
}

void test_a_variable_without_room_stays(void)
{
    given_identity(2u);
    s_qp.lb[0] = s_qp.ub[0] = 0.5;
    s_qp.g[0] = -9.0;
    *H(0, 1) = *H(1, 0) = 0.5;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    TEST_ASSERT_EQUAL_DOUBLE(0.5, s_qp.x[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, -0.25, s_qp.x[1]);
}

void test_a_flat_direction_with_a_slope_ends_at_the_bound(void)
{
    given(2u); /* cost (x0 + x1)^2 / 2 + x0 - x1: flat along (1, -1), falling */
    *H(0, 0) = *H(1, 1) = *H(0, 1) = *H(1, 0) = 1.0;
    s_qp.g[0] = 1.0;
    s_qp.g[1] = -1.0;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    TEST_ASSERT_EQUAL_DOUBLE(-1.0, s_qp.x[0]);
    TEST_ASSERT_EQUAL_DOUBLE(1.0, s_qp.x[1]);
}

void test_a_flat_direction_without_a_slope_is_left_alone(void)
{
    given(2u); /* cost (x0 + x1 - 1)^2 / 2 */
    *H(0, 0) = *H(1, 1) = *H(0, 1) = *H(1, 0) = 1.0;
    s_qp.g[0] = s_qp.g[1] = -1.0;
    s_qp.x[1] = 0.25;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.75, s_qp.x[0]);
    TEST_ASSERT_EQUAL_DOUBLE(0.25, s_qp.x[1]);
}

void test_a_direction_that_is_only_nearly_flat_has_its_minimum(void)
{
    given(2u); /* second pivot 1e-13: below what the factor trusts, but real curvature */
    *H(0, 0) = *H(0, 1) = *H(1, 0) = 1.0;
    *H(1, 1) = 1.0 + 0x1p-44;
    s_qp.g[1] = -0x1p-46;
    s_qp.lb[1] = s_qp.lb[0] = -1e9;
    s_qp.ub[1] = s_qp.ub[0] = 1e9;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, 0.25, s_qp.x[1]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, -0.25, s_qp.x[0]);
}

void test_infinite_bounds_are_allowed(void)
{
    given_identity(2u);
    s_qp.lb[0] = s_qp.lb[1] = -HUGE_VAL;
    s_qp.ub[0] = s_qp.ub[1] = HUGE_VAL;
    s_qp.g[0] = 100.0;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, -100.0, s_qp.x[0]);
}

void test_unbounded_below_is_an_answer_and_x_stays_finite(void)
{
    given(1u);
    s_qp.ub[0] = HUGE_VAL;
    s_qp.g[0] = -1.0;
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, kc_qp_solve(&s_qp));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_qp.x[0]);
    given(1u);
    s_qp.lb[0] = -HUGE_VAL;
    s_qp.g[0] = 1.0;
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, kc_qp_solve(&s_qp));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_qp.x[0]);
}

void test_no_curvature_and_no_slope_is_solved_at_once(void)
{
    given(3u);
    s_qp.x[1] = 0.5;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    TEST_ASSERT_EQUAL_UINT32(0u, s_qp.iters);
    TEST_ASSERT_EQUAL_DOUBLE(0.5, s_qp.x[1]);
}

void test_the_full_size_fits(void)
{
    given_identity(KC_COEF_MAX);
    for (uint32_t i = 0u; i < KC_COEF_MAX; i++) { s_qp.g[i] = (i % 2u) ? 0.25 : -4.0; }
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    TEST_ASSERT_EQUAL_DOUBLE(1.0, s_qp.x[62]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, -0.25, s_qp.x[63]);
}

void test_a_matrix_that_is_not_convex_still_ends_inside_the_box(void)
{
    given(4u); /* the contract asks for convexity; without it the loop must end all the same */
    for (uint32_t i = 0u; i < 4u; i++) {
        for (uint32_t j = 0u; j < 4u; j++) { *H(i, j) = (i == j) ? -1.0 : 2.0; }
        s_qp.g[i] = 0.1 * (double)i - 0.1;
    }
    const kc_status_t st = kc_qp_solve(&s_qp);
    TEST_ASSERT_TRUE(st == KC_OK || st == KC_ERR_ITER);
    TEST_ASSERT_TRUE(s_qp.iters <= KC_QP_ITER_PER_VAR * 4u);
    for (uint32_t i = 0u; i < 4u; i++) { TEST_ASSERT_TRUE(s_qp.x[i] >= -1.0 && s_qp.x[i] <= 1.0); }
}

static void refused(void)
{
    double before[KC_COEF_MAX];
    memcpy(before, s_qp.x, sizeof before);
    TEST_ASSERT_EQUAL_INT(KC_ERR_ARG, kc_qp_solve(&s_qp));
    TEST_ASSERT_EQUAL_MEMORY(before, s_qp.x, sizeof before);
}

void test_impossible_input_is_refused(void)
{
    given(0u);
    refused();
    given(KC_COEF_MAX);
    s_qp.n = KC_COEF_MAX + 1u;
    refused();
    given(2u);
    s_qp.lb[1] = 2.0;
    refused();
    given(2u);
    *H(1, 0) = NAN;
    refused();
    given(2u);
    s_qp.g[1] = INFINITY;
    refused();
    given(2u);
    s_qp.x[0] = NAN;
    refused();
    given(2u);
    s_qp.ub[0] = NAN;
    refused();
    given(2u);
    s_qp.lb[0] = s_qp.ub[0] = HUGE_VAL;
    refused();
    given(2u);
    s_qp.lb[0] = s_qp.ub[0] = -HUGE_VAL;
    refused();
}

/* H = 11' + 1e-7 I: 1e7 of each variable cancel in the gradient, so its rounding is more than what is accepted of a
 * well-conditioned problem. */
void test_a_gradient_that_is_rounding_counts_as_none(void)
{
    given_identity(2u);
    *H(0, 0) = *H(1, 1) = 1.0 + 1e-7;
    *H(0, 1) = *H(1, 0) = 1.0;
    s_qp.g[0] = 1.0;
    s_qp.g[1] = -1.1875;
    for (uint32_t i = 0u; i < 2u; i++) {
        s_qp.lb[i] = -1e12;
        s_qp.ub[i] = 1e12;
    }
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    TEST_ASSERT_DOUBLE_WITHIN(1.0, -1.09375e7, s_qp.x[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1.0, 1.09375e7, s_qp.x[1]);
    TEST_ASSERT_TRUE(s_qp.kkt > 1e-9); /* of which 1e7 are rounding of the last bit */
}

/* Terms of the gradient: 1 + 3 + 1 and 0 + 1.5 + 2, in units of `unit`, so that 5e-14 is rounding. */
static void given_terms(double unit)
{
    given(2u);
    *H(0, 0) = *H(1, 1) = unit;
    *H(0, 1) = *H(1, 0) = 0.5 * unit;
    s_qp.g[0] = unit;
    s_qp.x[0] = 3.0;
    s_qp.x[1] = -2.0;
    for (uint32_t i = 0u; i < 2u; i++) {
        s_qp.lb[i] = -9.0;
        s_qp.ub[i] = 9.0;
    }
    s_qp.x[2] = 100.0; /* of another problem */
    *H(0, 2) = *H(1, 2) = *H(2, 2) = *H(2, 0) = 50.0;
    s_qp.g[2] = 70.0;
    kc_qp_begin(&s_qp);
}

void test_negligible_is_a_part_of_the_largest_sum_of_terms(void)
{
    static const double units[3] = {1.0, 0x1p-10, 0x1p10};
    for (uint32_t k = 0u; k < 3u; k++) {
        const double unit = units[k];
        given_terms(unit);
        TEST_ASSERT_TRUE(kc_qp_negligible(&s_qp, 3.9e-14 * unit)); /* of the own terms of x0 */
        TEST_ASSERT_TRUE(kc_qp_negligible(&s_qp, 4.9e-14 * unit));
        TEST_ASSERT_FALSE(kc_qp_negligible(&s_qp, 5.1e-14 * unit));
        TEST_ASSERT_FALSE(kc_qp_negligible(&s_qp, 5.9e-14 * unit));
        TEST_ASSERT_FALSE(kc_qp_negligible(&s_qp, 6.1e-14 * unit)); /* the largest |H| for all */
        TEST_ASSERT_EQUAL_DOUBLE(unit, s_qp.g_max);
        TEST_ASSERT_EQUAL_DOUBLE(unit, s_qp.H_max);
        s_qp.floor_g = 1e-3 * unit;
        TEST_ASSERT_TRUE(kc_qp_negligible(&s_qp, 1e-3 * unit));
        TEST_ASSERT_FALSE(kc_qp_negligible(&s_qp, 1.1e-3 * unit));
    }
}

/* What projected Newton leaves to the active-set method. */
static void begin_without_projected_newton(void)
{
    kc_qp_begin(&s_qp);
    s_qp.newton = 0u;
}

static void solve_without_projected_newton(void)
{
    begin_without_projected_newton();
    for (uint32_t i = 0u; i < KC_QP_ITER_PER_VAR * KC_COEF_MAX && kc_qp_iterate(&s_qp); i++) {}
}

void test_running_out_of_iterations_is_an_answer(void)
{
    given_identity(2u);
    s_qp.g[0] = s_qp.g[1] = 0.25;
    s_qp.x[0] = s_qp.x[1] = -1.0; /* on bounds that it has to leave, one after the other */
    begin_without_projected_newton();
    s_qp.iters = KC_QP_ITER_PER_VAR * 2u - 1u;
    TEST_ASSERT_FALSE(kc_qp_iterate(&s_qp));
    TEST_ASSERT_EQUAL_INT(KC_ERR_ITER, s_qp.status);
    TEST_ASSERT_TRUE(s_qp.kkt > 1e-3);
    for (uint32_t i = 0u; i < 2u; i++) { TEST_ASSERT_TRUE(s_qp.x[i] >= -1.0 && s_qp.x[i] <= 1.0); }
}

/* As if rounding hid the truth: the gradient is not what the step was made for, and the step does not lower it. */
void test_a_gradient_that_newtons_method_does_not_lower_is_not_tried_again(void)
{
    given_identity(1u);
    kc_qp_begin(&s_qp);
    s_qp.grad[0] = 0.5;
    TEST_ASSERT_TRUE(kc_qp_iterate(&s_qp));
    TEST_ASSERT_EQUAL_DOUBLE(-0.5, s_qp.x[0]);
    TEST_ASSERT_EQUAL_DOUBLE(0.5, s_qp.floor_g);
    TEST_ASSERT_FALSE(kc_qp_iterate(&s_qp));
    TEST_ASSERT_EQUAL_DOUBLE(-0.5, s_qp.x[0]);
    TEST_ASSERT_EQUAL_INT(KC_ERR_ITER, s_qp.status); /* and it is no solution */
}

/* Both start at the wrong bound; at the limit of iterations one of them has just been freed. What is left is its
 * gradient, 50 + 1, over the largest of g. */
void test_what_is_left_at_the_iteration_limit_is_reported_in_parts_of_the_gradient(void)
{
    given_identity(2u);
    s_qp.g[0] = -50.0;
    s_qp.g[1] = -20.0;
    s_qp.x[0] = s_qp.x[1] = -1.0;
    begin_without_projected_newton();
    s_qp.iters = KC_QP_ITER_PER_VAR * 2u - 1u;
    TEST_ASSERT_FALSE(kc_qp_iterate(&s_qp));
    TEST_ASSERT_EQUAL_INT(KC_ERR_ITER, s_qp.status);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 51.0 / 50.0, s_qp.kkt);
    TEST_ASSERT_EQUAL_UINT8(KC_QP_AT_LOWER, s_qp.active[0]); /* where x stands */
    TEST_ASSERT_EQUAL_UINT8(KC_QP_AT_LOWER, s_qp.active[1]);
}

/* Both variables come off their bounds at once. */
void test_iterations_are_counted(void)
{
    given_identity(2u);
    s_qp.iters = 7u; /* of another problem */
    s_qp.g[0] = -0.5;
    s_qp.g[1] = -0.25;
    s_qp.x[0] = s_qp.x[1] = -1.0;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    TEST_ASSERT_EQUAL_UINT32(1u, s_qp.iters);
    TEST_ASSERT_EQUAL_DOUBLE(0.5, s_qp.x[0]);
    TEST_ASSERT_EQUAL_DOUBLE(0.25, s_qp.x[1]);
}

/* A release and a step are an iteration each: both variables come off their bounds, the worse one first. */
void test_iterations_of_the_active_set_method_are_counted(void)
{
    given_identity(2u);
    s_qp.g[0] = -0.5;
    s_qp.g[1] = -0.25;
    s_qp.x[0] = s_qp.x[1] = -1.0;
    solve_without_projected_newton();
    TEST_ASSERT_EQUAL_INT(KC_OK, s_qp.status);
    TEST_ASSERT_EQUAL_UINT32(4u, s_qp.iters);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.5, s_qp.x[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.25, s_qp.x[1]);
}

/* A flat direction is followed at once, whatever was in the work space. */
void test_one_step_along_a_flat_direction_meets_both_bounds(void)
{
    given(2u);
    *H(0, 0) = *H(1, 1) = *H(0, 1) = *H(1, 0) = 1.0;
    s_qp.g[0] = 1.0;
    s_qp.g[1] = -1.5;
    s_qp.x[0] = -0.5;
    s_qp.x[1] = 0.5;
    s_qp.lb[0] = -9.0;
    begin_without_projected_newton();
    s_qp.floor_g = 1.0; /* Newton's method has done what it can */
    (void)kc_qp_iterate(&s_qp);
    TEST_ASSERT_EQUAL_DOUBLE(1.0, s_qp.x[1]); /* as far as x1 may go, and x0 against it */
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, -1.0, s_qp.x[0]);
}

/* A small gradient at the upper bound that points inward: it is left, however small. */
void test_a_bound_that_does_not_hold_against_the_gradient_is_left(void)
{
    given_identity(1u);
    s_qp.g[0] = -0.5;
    s_qp.x[0] = 1.0;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.5, s_qp.x[0]);
}

/* H of four coupled variables in a box that holds none of them: one step of Newton's method, to the solution of
 * H x = -g that was made up. */
void test_without_active_bounds_the_minimum_is_one_step_away(void)
{
    static const double want[4] = {0.7, -0.2, 0.5, -0.9};
    static const double h[4][4] = {
        {4.0, 1.0, -0.5, 0.3}, {1.0, 3.0, 0.7, -0.4}, {-0.5, 0.7, 5.0, 1.1}, {0.3, -0.4, 1.1, 2.0}};
    given(4u);
    for (uint32_t i = 0u; i < 4u; i++) {
        s_qp.g[i] = 0.0;
        for (uint32_t j = 0u; j < 4u; j++) {
            *H(i, j) = h[i][j];
            s_qp.g[i] -= h[i][j] * want[j];
        }
    }
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    for (uint32_t i = 0u; i < 4u; i++) { TEST_ASSERT_DOUBLE_WITHIN(1e-14, want[i], s_qp.x[i]); }
    TEST_ASSERT_EQUAL_UINT32(1u, s_qp.iters);
}

/* x1 is x0 over again and rests; x2 has nothing to do with either: one step, which projected Newton leaves to the other method. */
void test_a_dependent_variable_leaves_no_trace_in_those_behind_it(void)
{
    given_identity(3u);
    *H(0, 1) = *H(1, 0) = 1.0;
    s_qp.g[0] = s_qp.g[1] = -0.5;
    s_qp.g[2] = -0.25;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    TEST_ASSERT_EQUAL_UINT32(2u, s_qp.iters);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.5, s_qp.x[0] + s_qp.x[1]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.25, s_qp.x[2]);
}

void test_what_was_refused_has_no_next_iteration(void)
{
    given_identity(2u);
    s_qp.g[1] = NAN;
    kc_qp_begin(&s_qp);
    TEST_ASSERT_FALSE(kc_qp_iterate(&s_qp));
    TEST_ASSERT_EQUAL_INT(KC_ERR_ARG, s_qp.status);
}

/* H = A'A + 1 of five variables in a box that holds two of them: inside, the gradient is zero; at a bound it points out. */
void test_the_conditions_of_karush_kuhn_and_tucker_hold_at_the_solution(void)
{
    static const double A[5][5] = {{1.0, 0.4, -0.3, 0.2, 0.6},
                                   {-0.7, 1.1, 0.5, -0.2, 0.1},
                                   {0.3, -0.6, 0.9, 0.8, -0.4},
                                   {0.2, 0.1, -0.5, 1.2, 0.7},
                                   {-0.1, 0.3, 0.6, -0.9, 1.4}};
    uint32_t inside = 0u;
    given(5u);
    for (uint32_t i = 0u; i < 5u; i++) {
        s_qp.g[i] = 3.0 * A[i][4] - 2.5 * A[i][1];
        for (uint32_t j = 0u; j < 5u; j++) {
            *H(i, j) = i == j ? 1.0 : 0.0;
            for (uint32_t k = 0u; k < 5u; k++) { *H(i, j) += A[k][i] * A[k][j]; }
        }
    }
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    for (uint32_t i = 0u; i < 5u; i++) {
        double grad = s_qp.g[i];
        for (uint32_t j = 0u; j < 5u; j++) { grad += *H(i, j) * s_qp.x[j]; }
        TEST_ASSERT_TRUE(s_qp.x[i] >= -1.0 && s_qp.x[i] <= 1.0);
        if (s_qp.active[i] == KC_QP_FREE) {
            inside++;
            TEST_ASSERT_DOUBLE_WITHIN(1e-13, 0.0, grad);
        } else {
            TEST_ASSERT_TRUE(s_qp.active[i] == KC_QP_AT_LOWER ? grad > 1e-3 : grad < -1e-3);
            TEST_ASSERT_EQUAL_DOUBLE(s_qp.active[i] == KC_QP_AT_LOWER ? -1.0 : 1.0, s_qp.x[i]);
        }
    }
    TEST_ASSERT_TRUE(inside > 0u && inside < 5u);
}

/* ---- projected Newton ---- */

/* Two variables that hold each other: minimum without a box at (u, v). */
static void given_coupled(double h01, double u, double v)
{
    given_identity(2u);
    *H(0, 1) = *H(1, 0) = h01;
    s_qp.g[0] = -(u + h01 * v);
    s_qp.g[1] = -(h01 * u + v);
    s_qp.lb[1] = -100.0;
    s_qp.ub[1] = 100.0;
}

/* Minimum (2, -0.5): x0 meets its bound 1, x1 goes all the way, and the cost falls. Then x1 alone goes to -1.5 + 1 + 0 =
 * its minimum beside x0 = 1. */
void test_a_projected_step_that_lowers_the_cost_is_taken_whole(void)
{
    given_coupled(0.5, 2.0, -0.5);
    kc_qp_begin(&s_qp);
    TEST_ASSERT_TRUE(kc_qp_iterate(&s_qp));
    TEST_ASSERT_EQUAL_DOUBLE(1.0, s_qp.x[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, -0.5, s_qp.x[1]);
    TEST_ASSERT_EQUAL_UINT8(KC_QP_AT_UPPER, s_qp.active[0]);
    TEST_ASSERT_FALSE(s_qp.at_minimum);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.5 - 0.5 - 0.5, s_qp.grad[1]); /* H01 x0 + x1 + g1, without a product */
    TEST_ASSERT_TRUE(kc_qp_iterate(&s_qp));
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.0, s_qp.x[1]);
    TEST_ASSERT_TRUE(s_qp.at_minimum);
    TEST_ASSERT_FALSE(kc_qp_iterate(&s_qp));
    TEST_ASSERT_EQUAL_INT(KC_OK, s_qp.status);
    TEST_ASSERT_EQUAL_UINT32(2u, s_qp.iters);
}

/* Minimum (10, -9.5): with x0 at its bound 1, x1 = -9.5 costs more than the start. The path bends at (1, -0.95), and
 * x1 goes on to where its gradient 0.9 + x1 + 0.5 is zero. */
void test_a_projected_step_that_raises_the_cost_becomes_a_path_past_its_bend(void)
{
    given_coupled(0.9, 10.0, -9.5);
    kc_qp_begin(&s_qp);
    TEST_ASSERT_TRUE(kc_qp_iterate(&s_qp));
    TEST_ASSERT_EQUAL_DOUBLE(1.0, s_qp.x[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, -1.4, s_qp.x[1]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, 0.0, s_qp.grad[1]);
    TEST_ASSERT_EQUAL_UINT8(KC_QP_AT_UPPER, s_qp.active[0]);
    TEST_ASSERT_EQUAL_UINT8(KC_QP_FREE, s_qp.active[1]);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, -1.4, s_qp.x[1]);
}

/* The same beside a variable that is where it should be: it has no direction, and no bound to meet. */
void test_a_path_leaves_a_variable_without_direction_alone(void)
{
    given_coupled(0.9, 10.0, -9.5);
    s_qp.n = 3u;
    *H(2, 2) = 1.0;
    s_qp.lb[2] = -1.0;
    s_qp.ub[2] = 1.0;
    s_qp.x[2] = 0.25;
    s_qp.g[2] = -0.25;
    kc_qp_begin(&s_qp);
    TEST_ASSERT_TRUE(kc_qp_iterate(&s_qp));
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, -1.4, s_qp.x[1]);
    TEST_ASSERT_EQUAL_DOUBLE(0.25, s_qp.x[2]);
    TEST_ASSERT_EQUAL_UINT8(KC_QP_FREE, s_qp.active[2]);
}

/* Nothing clips a step that ends at the bounds exactly: it is the minimum. */
void test_a_whole_step_may_end_at_a_bound(void)
{
    given_identity(2u);
    s_qp.g[0] = -1.0;
    s_qp.g[1] = 1.0;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    TEST_ASSERT_EQUAL_UINT32(1u, s_qp.iters);
    TEST_ASSERT_EQUAL_UINT8(KC_QP_AT_UPPER, s_qp.active[0]);
    TEST_ASSERT_EQUAL_UINT8(KC_QP_AT_LOWER, s_qp.active[1]);
}

/* Minimum (10, -8.9): behind the bend at (1, -0.89) the cost rises at once. */
void test_a_path_ends_at_the_bend_where_the_cost_would_rise(void)
{
    given_coupled(0.9, 10.0, -8.9);
    kc_qp_begin(&s_qp);
    TEST_ASSERT_TRUE(kc_qp_iterate(&s_qp));
    TEST_ASSERT_EQUAL_DOUBLE(1.0, s_qp.x[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, -0.89, s_qp.x[1]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, 0.9 - 0.89 - 0.1, s_qp.grad[1]);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, -0.8, s_qp.x[1]);
}

/* The same to the other side: x0 meets its lower bound. */
void test_a_path_bends_at_lower_bounds_too(void)
{
    given_coupled(0.9, -10.0, 9.5);
    kc_qp_begin(&s_qp);
    TEST_ASSERT_TRUE(kc_qp_iterate(&s_qp));
    TEST_ASSERT_EQUAL_DOUBLE(-1.0, s_qp.x[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, 1.4, s_qp.x[1]);
}

/* Both gradients at the lower bounds point inward, so both become free; but Newton's direction, (5.48, -4.52), leads
 * x1 out of the box at once. x0 alone goes to its minimum. */
void test_a_variable_that_newtons_direction_leads_out_of_the_box_stays(void)
{
    given_identity(2u);
    *H(0, 1) = *H(1, 0) = 0.99;
    s_qp.g[0] = -1.0;
    s_qp.g[1] = -0.9;
    s_qp.lb[0] = s_qp.lb[1] = 0.0;
    s_qp.ub[0] = s_qp.ub[1] = 100.0;
    kc_qp_begin(&s_qp);
    TEST_ASSERT_TRUE(s_qp.at_minimum); /* nothing is free */
    TEST_ASSERT_TRUE(kc_qp_iterate(&s_qp));
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, 1.0, s_qp.x[0]);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_qp.x[1]);
    TEST_ASSERT_EQUAL_UINT8(KC_QP_AT_LOWER, s_qp.active[1]);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, 1.0, s_qp.x[0]);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_qp.x[1]);
}

/* Bounds that hold at the start stay until the minimum beside them is reached; then all that do not hold are left. */
void test_a_start_at_the_right_bounds_takes_one_step(void)
{
    given_identity(6u);
    for (uint32_t i = 0u; i < 6u; i++) {
        s_qp.g[i] = i < 3u ? -7.0 : -0.25;
        s_qp.x[i] = i < 3u ? 1.0 : 0.0;
    }
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    TEST_ASSERT_EQUAL_UINT32(1u, s_qp.iters);
    TEST_ASSERT_EQUAL_DOUBLE(0.25, s_qp.x[5]);
}

/* Of two fixed variables the one becomes free whose bound does not hold. */
void test_only_bounds_that_do_not_hold_are_left(void)
{
    given_identity(2u);
    s_qp.g[0] = -5.0;
    s_qp.g[1] = -0.25;
    s_qp.x[0] = 1.0;
    s_qp.x[1] = -1.0;
    kc_qp_begin(&s_qp);
    TEST_ASSERT_TRUE(kc_qp_iterate(&s_qp));
    TEST_ASSERT_EQUAL_UINT32(1u, s_qp.m);
    TEST_ASSERT_EQUAL_UINT32(1u, s_qp.idx[0]);
    TEST_ASSERT_EQUAL_DOUBLE(0.25, s_qp.x[1]);
    TEST_ASSERT_FALSE(kc_qp_iterate(&s_qp));
    TEST_ASSERT_EQUAL_UINT8(KC_QP_AT_UPPER, s_qp.active[0]);
}

/* A start that is solved is left alone, free variables and fixed ones. */
void test_a_start_that_is_the_solution_takes_no_iteration(void)
{
    given_identity(2u);
    s_qp.g[0] = -0.5;
    s_qp.g[1] = -5.0;
    s_qp.x[0] = 0.5;
    s_qp.x[1] = 1.0;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    TEST_ASSERT_EQUAL_UINT32(0u, s_qp.iters);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_qp.kkt);
}

/* Room times room times curvature: 4, 16, 4 again, 0.04, and without a bound infinite; 0 curvature without a bound is
 * 0 times infinity. */
void test_variables_with_much_room_are_factored_first(void)
{
    static const uint32_t want[6] = {4u, 5u, 1u, 0u, 2u, 3u};
    given_identity(6u);
    *H(1, 1) = 4.0;
    s_qp.lb[3] = -0.1;
    s_qp.ub[3] = 0.1;
    s_qp.ub[4] = HUGE_VAL;
    *H(5, 5) = 0.0;
    s_qp.lb[5] = -HUGE_VAL;
    kc_qp_begin(&s_qp);
    TEST_ASSERT_EQUAL_UINT32_ARRAY(want, s_qp.idx, 6u);
}

/* An unsettling H of eleven variables, positive definite. */
static void given_dense(void)
{
    given(11u);
    for (uint32_t i = 0u; i < 11u; i++) {
        for (uint32_t j = 0u; j < 11u; j++) {
            const uint32_t far = i > j ? i - j : j - i;
            *H(i, j) = (far == 0u ? 3.0 : 0.0) + 1.0 / (1.0 + (double)far) + (double)((i * j) % 3u) / 8.0;
        }
    }
}

static void free_only(const uint8_t *is_free)
{
    for (uint32_t i = 0u; i < 11u; i++) { s_qp.active[i] = is_free[i] != 0u ? KC_QP_FREE : KC_QP_AT_UPPER; }
}

static void factor_is_of_these(const uint32_t *idx, uint32_t m)
{
    TEST_ASSERT_EQUAL_UINT32(m, s_qp.m);
    TEST_ASSERT_EQUAL_UINT32(m, s_qp.rows);
    TEST_ASSERT_EQUAL_UINT32_ARRAY(idx, s_qp.idx, m);
    for (uint32_t i = 0u; i < m; i++) {
        for (uint32_t j = 0u; j <= i; j++) { /* (L D)(L') and L' = (L D)' / D */
            double h = s_qp.L[i * KC_COEF_MAX + j];
            for (uint32_t k = 0u; k < j; k++) {
                h += s_qp.L[i * KC_COEF_MAX + k] * s_qp.L[k * KC_COEF_MAX + j];
            }
            TEST_ASSERT_DOUBLE_WITHIN(1e-14, *H(idx[i], idx[j]), h);
            if (j < i) {
                const double l = s_qp.L[i * KC_COEF_MAX + j] * s_qp.inv_d[j];
                TEST_ASSERT_EQUAL_DOUBLE(l, s_qp.L[j * KC_COEF_MAX + i]);
            }
        }
        TEST_ASSERT_DOUBLE_WITHIN(1e-15, 1.0, s_qp.L[i * KC_COEF_MAX + i] * s_qp.inv_d[i]);
    }
}

/* Some leave, some come, all leave and come: order and numbers are those of a factor made anew. */
void test_the_factor_that_is_kept_is_that_of_the_free_variables(void)
{
    static const uint8_t few[11] = {1u, 1u, 1u, 1u, 1u, 0u, 1u, 1u, 0u, 1u, 1u}; /* 5 and 8 leave */
    static const uint8_t back[11] = {1u, 1u, 1u, 1u, 1u, 1u, 0u, 1u, 1u, 1u, 1u}; /* and come, 6 leaves */
    static const uint8_t late[11] = {1u, 1u, 1u, 1u, 1u, 1u, 0u, 1u, 1u, 1u, 0u}; /* 10 leaves */
    static const uint8_t none[11] = {0u};
    static const uint8_t all[11] = {1u, 1u, 1u, 1u, 1u, 1u, 1u, 1u, 1u, 1u, 1u};
    static const uint32_t all_of[11] = {0u, 1u, 2u, 3u, 4u, 5u, 6u, 7u, 8u, 9u, 10u};
    static const uint32_t few_of[9] = {0u, 1u, 2u, 3u, 4u, 6u, 7u, 9u, 10u};
    static const uint32_t back_of[10] = {0u, 1u, 2u, 3u, 4u, 7u, 9u, 10u, 5u, 8u};
    static const uint32_t late_of[9] = {0u, 1u, 2u, 3u, 4u, 7u, 9u, 5u, 8u};
    given_dense();
    kc_qp_begin(&s_qp);
    for (uint32_t i = 0u; i < 11u; i++) { s_qp.idx[i] = i; }
    TEST_ASSERT_TRUE(kc_qp_factor(&s_qp, true));
    factor_is_of_these(all_of, 11u);
    free_only(few);
    TEST_ASSERT_TRUE(kc_qp_factor(&s_qp, true));
    factor_is_of_these(few_of, 9u);
    free_only(back);
    TEST_ASSERT_TRUE(kc_qp_factor(&s_qp, true));
    factor_is_of_these(back_of, 10u);
    free_only(late);
    TEST_ASSERT_TRUE(kc_qp_factor(&s_qp, true));
    factor_is_of_these(late_of, 9u);
    free_only(none);
    TEST_ASSERT_TRUE(kc_qp_factor(&s_qp, true));
    TEST_ASSERT_EQUAL_UINT32(0u, s_qp.m);
    free_only(all);
    TEST_ASSERT_TRUE(kc_qp_factor(&s_qp, true));
    factor_is_of_these(all_of, 11u);
}

/* What is kept is not computed again: a row before the first change, and the columns before it of a later one. */
void test_of_the_factor_stays_what_comes_before_the_first_change(void)
{
    static const uint8_t without_6[11] = {1u, 1u, 1u, 1u, 1u, 1u, 0u, 1u, 1u, 1u, 1u};
    given_dense();
    kc_qp_begin(&s_qp);
    for (uint32_t i = 0u; i < 11u; i++) { s_qp.idx[i] = i; }
    TEST_ASSERT_TRUE(kc_qp_factor(&s_qp, true));
    s_qp.L[2u * KC_COEF_MAX + 1u] = 77.0;
    s_qp.L[9u * KC_COEF_MAX + 3u] = 78.0;
    s_qp.L[9u * KC_COEF_MAX + 4u] = 79.0;
    free_only(without_6);
    (void)kc_qp_factor(&s_qp, false);
    TEST_ASSERT_EQUAL_DOUBLE(77.0, s_qp.L[2u * KC_COEF_MAX + 1u]);
    TEST_ASSERT_EQUAL_DOUBLE(78.0, s_qp.L[8u * KC_COEF_MAX + 3u]); /* 9 is now in place 8 */
    TEST_ASSERT_TRUE(s_qp.L[8u * KC_COEF_MAX + 4u] < 70.0); /* columns are kept by fours */
}

/* A variable that depends on those before it ends the strict factor, which then begins anew. */
void test_a_dependent_variable_is_left_to_the_active_set_method(void)
{
    given_dense();
    for (uint32_t i = 0u; i < 11u; i++) { *H(4, i) = *H(i, 4) = *H(1, i); }
    *H(4, 4) = *H(1, 1);
    kc_qp_begin(&s_qp);
    for (uint32_t i = 0u; i < 11u; i++) { s_qp.idx[i] = i; }
    TEST_ASSERT_FALSE(kc_qp_factor(&s_qp, true));
    TEST_ASSERT_EQUAL_UINT32(0u, s_qp.rows);
    TEST_ASSERT_TRUE(kc_qp_factor(&s_qp, false));
    TEST_ASSERT_EQUAL_UINT32(11u, s_qp.rows);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_qp.inv_d[4]);
    for (uint32_t j = 5u; j < 11u; j++) { TEST_ASSERT_EQUAL_DOUBLE(0.0, s_qp.L[4u * KC_COEF_MAX + j]); }
    TEST_ASSERT_TRUE(s_qp.inv_d[10] > 0.0);
}

/* Column 3 is column 0 and twice column 1 and none of column 2: it goes up where they go down, at no cost. */
void test_the_flat_direction_of_a_dependent_variable_is_what_it_depends_on(void)
{
    static const double A[3][4] = {{1.0, 0.0, 0.5, 1.0}, {0.5, 1.0, 0.25, 2.5}, {-1.0, 2.0, 1.0, 3.0}};
    static const double down[4] = {1.0, 2.0, 0.0, -1.0};
    given(4u);
    for (uint32_t i = 0u; i < 4u; i++) {
        for (uint32_t j = 0u; j < 4u; j++) {
            for (uint32_t k = 0u; k < 3u; k++) { *H(i, j) += A[k][i] * A[k][j]; }
        }
    }
    kc_qp_begin(&s_qp);
    for (uint32_t i = 0u; i < 4u; i++) { s_qp.idx[i] = i; }
    TEST_ASSERT_TRUE(kc_qp_factor(&s_qp, false));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_qp.inv_d[3]);
    s_qp.grad[3] = 0.1;
    kc_qp_flat_direction(&s_qp, 3u);
    for (uint32_t i = 0u; i < 4u; i++) { TEST_ASSERT_DOUBLE_WITHIN(1e-14, down[i], s_qp.d[i]); }
    s_qp.grad[3] = -0.1;
    kc_qp_flat_direction(&s_qp, 3u);
    for (uint32_t i = 0u; i < 4u; i++) { TEST_ASSERT_DOUBLE_WITHIN(1e-14, -down[i], s_qp.d[i]); }
}

/* As if rounding hid the truth: a variable at its bound is free against its gradient, and there is no way to go. */
void test_where_projected_newton_cannot_move_the_active_set_method_does(void)
{
    given_identity(2u);
    s_qp.g[0] = -5.0;
    s_qp.g[1] = -0.5;
    s_qp.x[0] = 1.0;
    kc_qp_begin(&s_qp);
    s_qp.active[0] = KC_QP_FREE;
    s_qp.active[1] = KC_QP_AT_LOWER;
    TEST_ASSERT_TRUE(kc_qp_iterate(&s_qp));
    TEST_ASSERT_EQUAL_UINT32(0u, s_qp.newton);
    TEST_ASSERT_EQUAL_UINT8(KC_QP_AT_UPPER, s_qp.active[0]);
    TEST_ASSERT_EQUAL_UINT8(KC_QP_FREE, s_qp.active[1]);
    TEST_ASSERT_TRUE(kc_qp_iterate(&s_qp));
    TEST_ASSERT_EQUAL_DOUBLE(0.5, s_qp.x[1]);
    TEST_ASSERT_FALSE(kc_qp_iterate(&s_qp));
    TEST_ASSERT_EQUAL_INT(KC_OK, s_qp.status);
}

/* As if H had changed behind the factor: the projected step raises the cost, behind the bend of the path the cost
 * curves down, and no bound ends it. */
void test_a_path_without_an_end_is_not_gone(void)
{
    given_coupled(0.9, 10.0, -9.5);
    s_qp.lb[1] = -HUGE_VAL;
    kc_qp_begin(&s_qp);
    for (uint32_t i = 0u; i < 2u; i++) { s_qp.idx[i] = i; }
    TEST_ASSERT_TRUE(kc_qp_factor(&s_qp, true));
    *H(0, 0) = -1000.0;
    *H(0, 1) = -2.0;
    TEST_ASSERT_TRUE(kc_qp_iterate(&s_qp));
    TEST_ASSERT_EQUAL_UINT32(0u, s_qp.newton);
    TEST_ASSERT_TRUE(s_qp.x[0] <= 1.0 && s_qp.x[1] > -100.0);
}

/* The same number of iterations is left to the other method when those of projected Newton are used up. */
void test_after_its_last_iteration_projected_newton_hands_over(void)
{
    given_coupled(0.5, 2.0, -0.5);
    kc_qp_begin(&s_qp);
    TEST_ASSERT_EQUAL_UINT32(8u, s_qp.newton);
    s_qp.newton = 1u;
    TEST_ASSERT_TRUE(kc_qp_iterate(&s_qp));
    TEST_ASSERT_EQUAL_UINT32(0u, s_qp.newton);
    TEST_ASSERT_EQUAL_UINT32(1u, s_qp.iters);
    TEST_ASSERT_EQUAL_DOUBLE(1.0 - 2.0 + 0.5 * -0.5 + 0.25,
                             s_qp.grad[0]); /* of all variables, not only of free ones */
    TEST_ASSERT_TRUE(kc_qp_iterate(&s_qp));
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.0, s_qp.x[1]);
    TEST_ASSERT_FALSE(kc_qp_iterate(&s_qp));
    TEST_ASSERT_EQUAL_INT(KC_OK, s_qp.status);
}

/* So little curvature that the minimum is no number: no solution, whatever the comparisons say. */
void test_a_minimum_beyond_all_numbers_is_no_solution(void)
{
    given(1u);
    *H(0, 0) = 1e-300;
    s_qp.g[0] = 1e10;
    s_qp.lb[0] = -HUGE_VAL;
    s_qp.ub[0] = HUGE_VAL;
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, kc_qp_solve(&s_qp));
}

/* Every size has its own remainder of the fours in which rows are taken: H = 11' + 1, so that x = c - (sum of c) / (n + 1)
 * for g = -c. */
void test_every_size_is_solved(void)
{
    for (uint32_t n = 1u; n <= KC_COEF_MAX; n++) {
        double sum = 0.0;
        given_identity(n);
        for (uint32_t i = 0u; i < n; i++) {
            const double c = 0.4 * (double)(i % 5u) - 0.8;
            for (uint32_t j = 0u; j < n; j++) { *H(i, j) += 1.0; }
            s_qp.g[i] = -c;
            sum += c;
        }
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
        for (uint32_t i = 0u; i < n; i++) {
            TEST_ASSERT_DOUBLE_WITHIN(1e-14, -s_qp.g[i] - sum / (1.0 + (double)n), s_qp.x[i]);
        }
    }
}

/* ---- random problems: what has to hold whatever their numbers ---- */

/* H = A'A of this rank plus a diagonal; bounds of which some hold at the solution. */
static void given_random(uint32_t n, uint32_t rank, double scale, uint64_t seed)
{
    static double A[KC_COEF_MAX][KC_COEF_MAX];
    uint64_t rng = seed;
    given(n);
    for (uint32_t i = 0u; i < rank; i++) {
        for (uint32_t j = 0u; j < n; j++) { A[i][j] = drawn(&rng); }
    }
    for (uint32_t i = 0u; i < n; i++) {
        for (uint32_t j = 0u; j < n; j++) {
            for (uint32_t k = 0u; k < rank; k++) { *H(i, j) += scale * A[k][i] * A[k][j]; }
        }
        s_qp.g[i] = scale * drawn(&rng);
        s_qp.lb[i] = -0.05 - 0.5 * kc_rng_uniform(&rng);
        s_qp.ub[i] = 0.05 + 0.5 * kc_rng_uniform(&rng);
        s_qp.x[i] = 0.04 * kc_rng_uniform(&rng);
    }
}

static double gradient_at(const double *x, uint32_t i)
{
    double sum = s_qp.g[i];
    for (uint32_t j = 0u; j < s_qp.n; j++) { sum += *H(i, j) * x[j]; }
    return sum;
}

void test_after_every_step_of_newtons_method_the_gradient_is_that_at_x(void)
{
    uint32_t n_bent = 0u;
    for (uint32_t seed = 1u; seed < 60u; seed++) {
        const uint32_t n = 2u + seed % 9u;
        given_random(n, n + 2u, 1.0, seed);
        kc_qp_begin(&s_qp);
        for (uint32_t k = 0u; k < 8u && kc_qp_newton_step(&s_qp); k++) {
            n_bent += s_qp.at_minimum ? 0u : 1u;
            for (uint32_t i = 0u; i < n; i++) {
                TEST_ASSERT_TRUE(s_qp.x[i] >= s_qp.lb[i] && s_qp.x[i] <= s_qp.ub[i]);
                if (s_qp.active[i] != KC_QP_FREE && !s_qp.at_minimum) { continue; }
                TEST_ASSERT_DOUBLE_WITHIN(1e-12, gradient_at(s_qp.x, i), s_qp.grad[i]);
            }
        }
    }
    TEST_ASSERT_TRUE(n_bent > 30u);
}

/* In other units of the cost the solution is the same, that of singular problems too. */
void test_the_solution_does_not_depend_on_the_unit_of_the_cost(void)
{
    static const double scale[] = {1e-9, 1e-6, 1e6, 1e9};
    for (uint32_t seed = 1u; seed < 40u; seed++) {
        const uint32_t n = 3u + seed % 8u, rank = seed % 2u == 0u ? n + 1u : n - 1u - seed % 2u;
        double x[KC_COEF_MAX];
        given_random(n, rank, 1.0, seed);
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
        memcpy(x, s_qp.x, sizeof x);
        for (uint32_t k = 0u; k < 4u; k++) {
            given_random(n, rank, scale[k], seed);
            TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
            for (uint32_t i = 0u; i < n; i++) { TEST_ASSERT_DOUBLE_WITHIN(1e-6, x[i], s_qp.x[i]); }
        }
    }
}

/* Rows, columns, bounds and a start that a larger problem has left. */
void test_what_lies_beyond_its_variables_plays_no_part(void)
{
    static kc_qp_t clean;
    for (uint32_t n = 1u; n < 12u; n++) {
        given_random(n, n + 1u, 1.0, n);
        (void)kc_qp_solve(&s_qp);
        clean = s_qp;
        given_random(n, n + 1u, 1.0, n);
        for (uint32_t i = 0u; i < KC_COEF_MAX; i++) {
            for (uint32_t j = 0u; j < KC_COEF_MAX; j++) {
                if (i >= n || j >= n) { *H(i, j) = 7.0; }
            }
            if (i < n) { continue; }
            s_qp.g[i] = 50.0;
            s_qp.x[i] = 3.0;
            s_qp.lb[i] = -9.0;
            s_qp.ub[i] = 8.0;
            s_qp.active[i] = KC_QP_FREE;
        }
        TEST_ASSERT_EQUAL_INT(clean.status, kc_qp_solve(&s_qp));
        TEST_ASSERT_EQUAL_UINT32(clean.iters, s_qp.iters);
        TEST_ASSERT_EQUAL_MEMORY(clean.x, s_qp.x, n * sizeof clean.x[0]);
        TEST_ASSERT_EQUAL_MEMORY(clean.grad, s_qp.grad, n * sizeof clean.grad[0]);
        TEST_ASSERT_EQUAL_MEMORY(clean.active, s_qp.active, n);
        TEST_ASSERT_EQUAL_DOUBLE(clean.kkt, s_qp.kkt);
        for (uint32_t i = n; i < KC_COEF_MAX; i++) { TEST_ASSERT_EQUAL_DOUBLE(3.0, s_qp.x[i]); }
    }
}

/* g and three terms of 1 in each component: 4e-14 of gradient is rounding, whatever the signs. */
void test_rounding_is_a_part_of_all_terms_whatever_their_signs(void)
{
    for (uint32_t signs = 0u; signs < 8u; signs++) {
        given(3u);
        for (uint32_t i = 0u; i < 3u; i++) {
            for (uint32_t j = 0u; j < 3u; j++) { *H(i, j) = (signs & 1u) != 0u && i != j ? -1.0 : 1.0; }
            s_qp.g[i] = (signs & 2u) != 0u ? -1.0 : 1.0;
            s_qp.x[i] = (signs & 4u) != 0u ? -1.0 : 1.0;
        }
        s_qp.g_max = s_qp.H_max = 1.0;
        TEST_ASSERT_TRUE(kc_qp_rounding(&s_qp, 3.9e-14));
        TEST_ASSERT_FALSE(kc_qp_rounding(&s_qp, 4.1e-14));
    }
}

/* Of every size, with one variable beside 0 or all of them. */
void test_the_gradient_is_the_dense_sum(void)
{
    for (uint32_t n = 1u; n < 14u; n++) {
        for (uint32_t one = 0u; one <= n; one++) {
            given_random(n, n, 1.0, n);
            for (uint32_t i = 0u; i < n; i++) { s_qp.x[i] = one == n || i == one ? 0.3 + 0.1 * i : 0.0; }
            kc_qp_gradient(&s_qp);
            for (uint32_t i = 0u; i < n; i++) {
                TEST_ASSERT_DOUBLE_WITHIN(1e-13, gradient_at(s_qp.x, i), s_qp.grad[i]);
            }
            TEST_ASSERT_EQUAL_DOUBLE(9.0, s_qp.grad[n]); /* as it was */
        }
    }
}
