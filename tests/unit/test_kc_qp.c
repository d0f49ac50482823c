/* kc_qp.c: small problems with known answers, and how it can end. Random ones: tests/oracle. */
#include <math.h>
#include <string.h>

#include "kc_qp.h"
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
    s_qp.g[1] = -1.1;
    for (uint32_t i = 0u; i < 2u; i++) {
        s_qp.lb[i] = -1e12;
        s_qp.ub[i] = 1e12;
    }
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    TEST_ASSERT_DOUBLE_WITHIN(1.0, -1.05e7, s_qp.x[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1.0, 1.05e7, s_qp.x[1]);
    TEST_ASSERT_TRUE(s_qp.kkt > 1e-9); /* of which 1e7 are rounding of the last bit */
}

void test_running_out_of_iterations_is_an_answer(void)
{
    given_identity(2u);
    s_qp.g[0] = s_qp.g[1] = 0.25;
    kc_qp_begin(&s_qp);
    s_qp.x[0] = s_qp.x[1] = -1.0; /* on bounds that it has to leave, one after the other */
    kc_qp_begin(&s_qp);
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
    kc_qp_begin(&s_qp);
    s_qp.iters = KC_QP_ITER_PER_VAR * 2u - 1u;
    TEST_ASSERT_FALSE(kc_qp_iterate(&s_qp));
    TEST_ASSERT_EQUAL_INT(KC_ERR_ITER, s_qp.status);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 51.0 / 50.0, s_qp.kkt);
    TEST_ASSERT_EQUAL_UINT8(KC_QP_FREE, s_qp.active[0]);
    TEST_ASSERT_EQUAL_UINT8(KC_QP_AT_LOWER, s_qp.active[1]);
}

/* A release and a step are an iteration each: both variables come off their bounds, the worse one first. */
void test_iterations_are_counted(void)
{
    given_identity(2u);
    s_qp.iters = 7u; /* of another problem */
    s_qp.g[0] = -0.5;
    s_qp.g[1] = -0.25;
    s_qp.x[0] = s_qp.x[1] = -1.0;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
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
    kc_qp_begin(&s_qp);
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

/* x1 is x0 over again and rests; x2 has nothing to do with either: one step. */
void test_a_dependent_variable_leaves_no_trace_in_those_behind_it(void)
{
    given_identity(3u);
    *H(0, 1) = *H(1, 0) = 1.0;
    s_qp.g[0] = s_qp.g[1] = -0.5;
    s_qp.g[2] = -0.25;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_qp_solve(&s_qp));
    TEST_ASSERT_EQUAL_UINT32(1u, s_qp.iters);
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
