/* kc_clear.c: how well the clearance at a pose is known. One body on the tool above flat ground, so that the clearance
 * is the tool's height: its slopes are the height's row of the arm's Jacobian, by central differences of kc_arm_fk. */
#include "kc_clear.h"

#include <math.h>
#include <string.h>

#include "given_parts.h"
#include "kc_guard.h"
#include "unity.h"

#define RADIUS_M 0.03
#define GROUND_M (-5.0)

static kc_acq_work_t s_acq;
static kc_clear_t s_clear;
static float s_q[KC_JOINT_MAX];

void setUp(void)
{
    given_parts();
    kc_space_t *s = &parts.tables.active.space;
    s->n_body = s->n_volume = 1u; /* a ball about the tool's point */
    s->body[0] = (kc_body_t){0u, {0.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f}, (float)RADIUS_M, 0u};
    s->volume[0] = (kc_volume_t){KC_VOL_BELOW, {0.0f, 0.0f, (float)GROUND_M}, {0.0f, 0.0f, 0.0f}, 0.0f, 0u};
    memset(&s_acq, 0, sizeof s_acq);
    memset(&s_clear, 0, sizeof s_clear);
    memset(s_q, 0, sizeof s_q);
    for (uint32_t j = 0u; j < 7u; j++) { s_q[j] = 0.1f * (float)(j + 1u); }
}

/* Errors of joints 2 and 4: a, in this order. */
static void given_two_coefficients(double var, double cov)
{
    s_acq.n = 2u;
    s_acq.idx[0] = 6u;
    s_acq.idx[1] = 14u;
    s_acq.M[0] = s_acq.M[KC_COEF_MAX + 1u] = var;
    s_acq.M[1] = s_acq.M[KC_COEF_MAX] = cov;
}

static void computed(void)
{
    kc_work_t work = kc_work_unlimited();
    TEST_ASSERT_TRUE(kc_clear_step(&parts.view, s_q, &s_acq, &s_clear, &work));
}

/* Height of the tool with an error of joint j (from 0): a. */
static double height_m(uint32_t j, double a_m)
{
    kc_arm_t arm = parts.tables.active.arm;
    double q[KC_JOINT_MAX];
    kc_pose_t T;
    for (uint32_t i = 0u; i < KC_JOINT_MAX; i++) { q[i] = (double)s_q[i]; }
    arm.joint[j].a_m += a_m;
    kc_arm_fk(&arm, q, &T);
    return T.p_m[2];
}

static double slope(uint32_t j) { return (height_m(j, 1e-4) - height_m(j, -1e-4)) / 2e-4; }

static double scale(uint32_t coef) { return parts.tables.active.terms.coef[coef].scale; }

void test_clearance_and_slopes_are_those_of_the_height(void)
{
    given_two_coefficients(1.0, 0.0);
    computed();
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, height_m(0u, 0.0) - GROUND_M - RADIUS_M, s_clear.clearance_m);
    TEST_ASSERT_TRUE(fabs(slope(1u)) > 0.1 && fabs(slope(3u)) > 0.1);
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, slope(1u) * scale(6u), s_clear.slope_m[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, slope(3u) * scale(14u), s_clear.slope_m[1]);
}

void test_it_is_computed_about_the_latest_correction(void)
{
    given_two_coefficients(1.0, 0.0);
    parts.latest.coef[14] = 0.02;
    computed();
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, height_m(3u, 0.02) - GROUND_M - RADIUS_M, s_clear.clearance_m);
}

/* A ball beside the arm: every coefficient moves the tool against it, also that of the first joint. */
void test_it_is_of_the_arm_as_it_is_now_with_all_that_the_correction_depends_on(void)
{
    kc_active_t *a = &parts.tables.active;
    kc_pose_t T;
    double q[KC_JOINT_MAX];
    a->space.volume[0] = (kc_volume_t){KC_VOL_SPHERE, {1.0f, 2.0f, 0.5f}, {0.0f, 0.0f, 0.0f}, 0.1f, 0u};
    a->terms.term[14].basis[0] = (kc_basis_t){.fn = KC_FN_LIN, .var = KC_VAR_TEMP, .c1 = 1.0};
    parts.telemetry.arm.temp_c = 20.0;
    parts.latest.coef[14] = 0.001;
    given_two_coefficients(1.0, 0.0);
    computed();
    for (uint32_t i = 0u; i < KC_JOINT_MAX; i++) { q[i] = (double)s_q[i]; }
    a->arm.joint[3].a_m += 0.02;
    kc_arm_fk(&a->arm, q, &T);
    double far_m = sqrt(pow(T.p_m[0] - 1.0, 2.0) + pow(T.p_m[1] - 2.0, 2.0) + pow(T.p_m[2] - 0.5, 2.0));
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, far_m - 0.1 - RADIUS_M, s_clear.clearance_m);
}

/* Clear by exactly what is asked, and by a little less. */
static void assert_asked_m(double m)
{
    s_clear.clearance_m = m + 1e-9;
    TEST_ASSERT_TRUE(kc_clear_enough(&s_acq, &s_clear));
    s_clear.clearance_m = m - 1e-9;
    TEST_ASSERT_FALSE(kc_clear_enough(&s_acq, &s_clear));
}

void test_two_sigmas_are_asked_on_top_of_the_guard_s_distance(void)
{
    given_two_coefficients(4.0, 0.0);
    s_clear.slope_m[0] = 0.003;
    s_clear.slope_m[1] = -0.004;
    assert_asked_m(KC_GUARD_CLEAR_M + 2.0 * 2.0 * 0.005);
    given_two_coefficients(4.0, 4.0); /* they differ: .003 - .004 */
    assert_asked_m(KC_GUARD_CLEAR_M + 2.0 * 2.0 * 0.001);
    given_two_coefficients(4.0, -4.0);
    assert_asked_m(KC_GUARD_CLEAR_M + 2.0 * 2.0 * 0.007);
    given_two_coefficients(4.0, 0.0);
    s_acq.n = 0u;
    assert_asked_m(KC_GUARD_CLEAR_M);
}

void test_rounding_below_zero_is_no_uncertainty(void)
{
    given_two_coefficients(0.0, -1e-18);
    s_clear.slope_m[0] = s_clear.slope_m[1] = 1.0;
    assert_asked_m(KC_GUARD_CLEAR_M);
}

void test_what_has_nothing_to_touch_is_clear(void)
{
    parts.tables.active.space.n_volume = 0u;
    given_two_coefficients(1e6, 0.0);
    computed();
    TEST_ASSERT_TRUE(isinf(s_clear.clearance_m));
    TEST_ASSERT_TRUE(kc_clear_enough(&s_acq, &s_clear));
}

void test_an_unknown_clearance_is_none(void)
{
    given_two_coefficients((double)NAN, 0.0);
    s_clear.clearance_m = 1.0;
    s_clear.slope_m[0] = 1e-3;
    TEST_ASSERT_FALSE(kc_clear_enough(&s_acq, &s_clear));
}

void test_in_parts_it_is_the_same(void)
{
    uint32_t steps = 1u;
    kc_clear_t whole;
    given_two_coefficients(1.0, 0.0);
    computed();
    whole = s_clear;
    memset(&s_clear, 0, sizeof s_clear);
    for (bool over = false; !over && steps < 10u; steps += over ? 0u : 1u) {
        kc_work_t work = {.most = 1u}; /* one posture a step */
        over = kc_clear_step(&parts.view, s_q, &s_acq, &s_clear, &work);
    }
    TEST_ASSERT_EQUAL_UINT32(3u, steps);
    TEST_ASSERT_EQUAL_MEMORY(&whole, &s_clear, sizeof whole);
}
