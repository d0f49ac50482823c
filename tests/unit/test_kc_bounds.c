/* kc_bounds.c: what a space was verified for, how large a term can be, and whether TERMS stay inside. */
#include <math.h>
#include <string.h>

#include "given_tables.h"
#include "kc_bounds.h"
#include "unity.h"

static kc_space_t s_space;
static kc_arm_t s_arm;
static kc_terms_t s_terms;
static kc_bounds_bad_t s_bad;

void setUp(void)
{
    memset(&s_space, 0, sizeof s_space);
    memset(&s_terms, 0, sizeof s_terms);
    given_arm(&s_arm);
    s_space.n_joints = 7u;
    for (uint32_t j = 0u; j < 7u; j++) {
        double k = (double)(j + 1u);
        s_space.verified[j] = (kc_dh_bound_t){0.1 * k, 0.01 * k, 0.001 * k, 0.0001 * k};
    }
}

/* ---- what was verified ---- */

static void expect_verified(double want, uint32_t frame, uint32_t comp)
{
    TEST_ASSERT_EQUAL_DOUBLE(want, kc_bounds_verified(&s_space, frame, comp));
}

void test_the_axes_of_dh_errors_have_their_bounds(void)
{
    expect_verified(0.1, 0u, KC_RZ);    /* J1.phi */
    expect_verified(0.0001, 0u, KC_TZ); /* J1.d */
    expect_verified(0.01, 1u, KC_RX);   /* J1.alpha */
    expect_verified(0.001, 1u, KC_TX);  /* J1.a */
    expect_verified(0.7, 6u, KC_RZ);
    expect_verified(0.0007, 6u, KC_TZ);
    expect_verified(0.07, 7u, KC_RX);
    expect_verified(0.007, 7u, KC_TX);
}

void test_other_axes_have_the_smaller_bound_of_their_kind(void)
{
    expect_verified(0.03, 3u, KC_RY);   /* J3.alpha, not J4.phi */
    expect_verified(0.0004, 3u, KC_TY); /* J4.d, not J3.a */
    s_space.verified[3].phi_rad = 0.02;
    expect_verified(0.02, 3u, KC_RY);
}

void test_ends_of_the_arm_have_what_is_there(void)
{
    expect_verified(0.1, 0u, KC_RX);
    expect_verified(0.1, 0u, KC_RY);
    expect_verified(0.0001, 0u, KC_TX);
    expect_verified(0.07, 7u, KC_RZ);
    expect_verified(0.07, 7u, KC_RY);
    expect_verified(0.007, 7u, KC_TZ);
}

void test_the_tool_counts_as_the_last_link_and_what_acts_on_the_measurement_as_base_or_tool(void)
{
    for (uint32_t comp = 0u; comp < 6u; comp++) {
        double last = kc_bounds_verified(&s_space, 7u, comp);
        expect_verified(last, KC_FRAME_TOOL, comp);
        expect_verified(last, KC_FRAME_MEAS, comp);
        expect_verified(kc_bounds_verified(&s_space, 0u, comp), KC_FRAME_CAMERA, comp);
    }
}

void test_an_arm_of_the_largest_size_is_not_read_beyond_its_end(void)
{
    s_space.n_joints = KC_JOINT_MAX;
    s_space.verified[7] = (kc_dh_bound_t){0.8, 0.08, 0.008, 0.0008};
    expect_verified(0.08, KC_FRAME_TOOL, KC_RZ);
    expect_verified(0.08, KC_JOINT_MAX, KC_RX);
}

/* ---- how large a term can be ---- */

static double size_of(uint8_t fn, uint8_t var, uint8_t index, double c0, double c1)
{
    const kc_term_t t = {.gain = 1.0, .basis = {{fn, var, index, c0, c1}}};
    return kc_bounds_size(&s_arm, &t);
}

static void expect_size(double want, uint8_t var, uint8_t index)
{
    TEST_ASSERT_DOUBLE_WITHIN(1e-12 * want, want, size_of(KC_FN_LIN, var, index, 0.0, 1.0));
}

void test_a_constant_is_one_and_the_gain_counts(void)
{
    kc_term_t t = {.gain = -3.0};
    TEST_ASSERT_EQUAL_DOUBLE(3.0, kc_bounds_size(&s_arm, &t));
    t.basis[1] = (kc_basis_t){KC_FN_LIN, KC_VAR_DIR, 1u, 0.0, 2.0};
    TEST_ASSERT_EQUAL_DOUBLE(6.0, kc_bounds_size(&s_arm, &t));
}

void test_functions_at_the_largest_argument(void)
{
    const uint8_t q = KC_VAR_Q;
    TEST_ASSERT_EQUAL_DOUBLE(9.52, size_of(KC_FN_LIN, q, 5u, 0.0, -2.0)); /* -4.76 .. 1.24 */
    TEST_ASSERT_EQUAL_DOUBLE(9.52, size_of(KC_FN_ABS, q, 5u, 0.0, 2.0));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 9.52 * 9.52, size_of(KC_FN_SQ, q, 5u, 0.0, 2.0));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, log1p(9.52), size_of(KC_FN_LN1P, q, 5u, 0.0, 2.0));
    TEST_ASSERT_EQUAL_DOUBLE(1.0, size_of(KC_FN_SIN, q, 5u, 0.0, 2.0));
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.0476, size_of(KC_FN_SIN, q, 5u, 0.0, 0.01));
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.0476, size_of(KC_FN_TANH, q, 5u, 0.0, 0.01));
    TEST_ASSERT_EQUAL_DOUBLE(1.0, size_of(KC_FN_COS, q, 5u, 0.0, 0.01));
    TEST_ASSERT_EQUAL_DOUBLE(1.0, size_of(KC_FN_STEP, q, 5u, 0.0, 0.01));
    TEST_ASSERT_EQUAL_DOUBLE(1.0, size_of(KC_FN_EXPN, q, 5u, 0.0, 0.01));
    TEST_ASSERT_EQUAL_DOUBLE(33.62, size_of(KC_FN_TAN2, KC_VAR_INCID, 0u, 0.0, 1.0));
    TEST_ASSERT_EQUAL_DOUBLE(1e12, size_of(KC_FN_LIN, q, 5u, 0.0, 1e13)); /* clipped as on board */
}

void test_the_farther_end_of_a_range_counts(void)
{
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 3.24, size_of(KC_FN_LIN, KC_VAR_Q, 5u, -2.0, 1.0));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 5.76, size_of(KC_FN_LIN, KC_VAR_Q, 5u, 1.0, 1.0));
}

void test_both_ends_of_every_range_count(void)
{
    static const struct {
        uint8_t var;
        double lo, hi;
    } range[] = {{KC_VAR_TEMP, -200.0, 150.0},
                 {KC_VAR_PAYLOAD, 0.0, 0.5},
                 {KC_VAR_RANGE, 0.0, 3.0},
                 {KC_VAR_INCID, 0.0, 1.57079632679489662},
                 {KC_VAR_R2, 0.0, 2.0},
                 {KC_VAR_XCAM, -3.0, 3.0},
                 {KC_VAR_YCAM, -3.0, 3.0},
                 {KC_VAR_ZCAM, -3.0, 3.0},
                 {KC_VAR_U, -1.0, 1.0},
                 {KC_VAR_V, -1.0, 1.0},
                 {KC_VAR_PAN, -3.14159265358979324, 3.14159265358979324},
                 {KC_VAR_TILT, -3.14159265358979324, 3.14159265358979324}};
    for (uint32_t i = 0u; i < sizeof range / sizeof range[0]; i++) {
        for (double c0 = -400.0; c0 <= 400.0; c0 += 800.0) {
            const double far = c0 > 0.0 ? c0 - range[i].lo : range[i].hi - c0;
            TEST_ASSERT_DOUBLE_WITHIN(1e-9, far, size_of(KC_FN_LIN, range[i].var, 0u, c0, 1.0));
        }
    }
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, 1e5, size_of(KC_FN_LIN, KC_VAR_T, 0u, 7e6, 1.0)); /* from c0 */
}

void test_every_joint_has_its_own_speed_and_limits(void)
{
    for (uint32_t j = 0u; j < 7u; j++) {
        s_arm.joint[j].speed_max = 0.1 * (double)(j + 1u);
        s_arm.joint[j].q_max = 3.0 + (double)j;
    }
    for (uint8_t j = 1u; j <= 7u; j++) {
        expect_size(0.1 * j, KC_VAR_QDOT, j);
        expect_size(j == 5u ? 7.0 : 2.0 + j, KC_VAR_Q, j);
    }
}

void test_variables_that_the_arm_table_bounds(void)
{
    expect_size(2.6, KC_VAR_Q, 1u);
    expect_size(0.8, KC_VAR_QDOT, 3u);
    expect_size(9.81, KC_VAR_GX, 0u);
    expect_size(9.81, KC_VAR_GY, 7u);
    expect_size(9.81, KC_VAR_GZ, 3u);
}

void test_a_variable_without_a_range_is_outside_every_bound(void)
{
    for (uint32_t var = KC_VAR_PNP_TX; var <= KC_VAR_MOVE; var++) {
        expect_size(1e12, (uint8_t)var, 1u); /* flight computes none */
    }
    expect_size(1e12, KC_VAR_COUNT, 0u);
}

void test_gravity_moments_are_of_all_that_is_beyond_at_full_length(void)
{
    /* beyond frame 6: link 7 with its centre of mass 0.06 m and 3.35 mm away, tool another 0.1 m on */
    double com = sqrt(.00015 * .00015 + .00007 * .00007 + .00335 * .00335);
    double load = KC_BOUNDS_PAYLOAD_KG * 0.16, own = .07548 * (0.06 + com);
    expect_size(9.81 * (own + load), KC_VAR_MX, 6u);
    expect_size(9.81 * (own + load), KC_VAR_MY, 6u);
    expect_size(9.81 * (own + load), KC_VAR_MZ, 6u);
    expect_size(9.81 * (own + load), KC_VAR_TAU, 7u);
    expect_size(9.81 * load, KC_VAR_TAU_PAYLOAD, 7u);
    expect_size(9.81 * 0.16, KC_VAR_LEVX, KC_LEVER_INDEX(6u, KC_LEVER_TOOL));
    expect_size(9.81 * 0.16, KC_VAR_LEVY, KC_LEVER_INDEX(6u, 7u));
    expect_size(9.81 * 0.16, KC_VAR_LEVZ, KC_LEVER_INDEX(6u, 7u));
    s_arm.joint[7] = s_arm.joint[6]; /* beyond the last */
    expect_size(9.81 * (own + load), KC_VAR_TAU, 7u);
    s_arm.joint[6].has_mass = 0u;
    expect_size(9.81 * load, KC_VAR_TAU, 7u);
}

void test_a_link_is_as_long_in_both_directions(void)
{
    s_arm.joint[6].d_m = -0.06;
    s_arm.joint[6].a_m = -0.02;
    expect_size(9.81 * 0.18, KC_VAR_LEVX, KC_LEVER_INDEX(6u, KC_LEVER_TOOL));
}

void test_a_joint_that_slides_has_its_stroke_and_a_force(void)
{
    s_arm.joint[6].type = KC_PRISMATIC;
    s_arm.joint[6].q_min = -0.3;
    s_arm.joint[6].q_max = 0.2;
    expect_size(9.81 * 0.46, KC_VAR_LEVX, KC_LEVER_INDEX(6u, KC_LEVER_TOOL));
    expect_size(9.81 * (.07548 + KC_BOUNDS_PAYLOAD_KG), KC_VAR_TAU, 7u);
    expect_size(9.81 * KC_BOUNDS_PAYLOAD_KG, KC_VAR_TAU_PAYLOAD, 7u);
}

void test_variables_with_stated_ranges(void)
{
    expect_size(200.0, KC_VAR_TEMP, 0u);
    TEST_ASSERT_EQUAL_DOUBLE(180.0, size_of(KC_FN_LIN, KC_VAR_TEMP, 0u, -20.0, 1.0));
    TEST_ASSERT_EQUAL_DOUBLE(1e5, size_of(KC_FN_LIN, KC_VAR_T, 0u, 1e9, 1.0));
    expect_size(KC_BOUNDS_PAYLOAD_KG, KC_VAR_PAYLOAD, 0u);
    expect_size(KC_BOUNDS_DISTANCE_M, KC_VAR_RANGE, 0u);
    expect_size(KC_BOUNDS_DISTANCE_M, KC_VAR_XCAM, 0u);
    expect_size(KC_BOUNDS_DISTANCE_M, KC_VAR_YCAM, 0u);
    expect_size(KC_BOUNDS_DISTANCE_M, KC_VAR_ZCAM, 0u);
    expect_size(1.5707963267948966, KC_VAR_INCID, 0u);
    expect_size(1.0, KC_VAR_DIR, 2u);
    expect_size(1.0, KC_VAR_TAG, 0u);
    expect_size(1.0, KC_VAR_U, 0u);
    expect_size(1.0, KC_VAR_V, 0u);
    expect_size(2.0, KC_VAR_R2, 0u);
    expect_size(3.141592653589793, KC_VAR_PAN, 0u);
    expect_size(3.141592653589793, KC_VAR_TILT, 0u);
}

/* ---- the check ---- */

static void given_coef(double lb, double ub, uint8_t frame, uint8_t comp)
{
    s_terms.coef[s_terms.n_coef] = (kc_coef_t){.lb = lb, .ub = ub, .scale = 1.0, .enabled = 1u};
    s_terms.term[s_terms.n_term] =
        (kc_term_t){.coef = (uint16_t)s_terms.n_coef, .frame = frame, .comp = comp, .gain = 1.0};
    s_terms.n_coef++;
    s_terms.n_term++;
}

static void expect_check(kc_status_t want)
{
    TEST_ASSERT_EQUAL_INT(want, kc_bounds_check(&s_space, &s_arm, &s_terms, &s_bad));
}

void test_a_bound_may_be_a_tenth_more_than_verified_and_not_more(void)
{
    given_coef(-0.22, 0.22, 1u, KC_RZ); /* J2.phi, verified for 0.2 */
    static const kc_bounds_bad_t none;
    memset(&s_bad, 0x11, sizeof s_bad);
    expect_check(KC_OK);
    TEST_ASSERT_EQUAL_MEMORY(&none, &s_bad, sizeof none);
    s_terms.coef[0].ub = 0.2201;
    expect_check(KC_ERR_RANGE);
    s_terms.coef[0] = (kc_coef_t){.lb = -0.2201, .ub = 0.0, .scale = 1.0, .enabled = 1u};
    expect_check(KC_ERR_RANGE);
    TEST_ASSERT_EQUAL_UINT32(0u, s_bad.coef);
    TEST_ASSERT_EQUAL_UINT32(1u, s_bad.frame);
    TEST_ASSERT_EQUAL_UINT32(KC_RZ, s_bad.comp);
    TEST_ASSERT_EQUAL_DOUBLE(0.2201, s_bad.sum);
    TEST_ASSERT_EQUAL_DOUBLE(0.2, s_bad.verified);
}

void test_coefficients_that_act_at_one_place_add_up(void)
{
    given_coef(-0.15, 0.15, 1u, KC_RZ);
    given_coef(-0.15, 0.15, 2u, KC_RZ); /* another joint */
    given_coef(-0.01, 0.01, 1u, KC_RX); /* another axis */
    expect_check(KC_OK);
    given_coef(0.0, 0.08, 1u, KC_RZ);
    expect_check(KC_ERR_RANGE);
    TEST_ASSERT_EQUAL_UINT32(3u, s_bad.coef);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.23, s_bad.sum);
}

void test_a_coefficient_is_as_large_as_its_terms_let_it_act(void)
{
    given_coef(-0.07, 0.07, 1u, KC_RZ);
    s_terms.term[0].basis[0] = (kc_basis_t){KC_FN_LIN, KC_VAR_Q, 3u, 0.0, 1.0}; /* up to 2.8 */
    expect_check(KC_OK);
    s_terms.coef[0].ub = 0.08;
    expect_check(KC_ERR_RANGE);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.224, s_bad.sum);
}

void test_a_disabled_coefficient_is_not_estimated_and_does_not_count(void)
{
    given_coef(-5.0, 5.0, 1u, KC_RZ);
    s_terms.coef[0].enabled = 0u;
    expect_check(KC_OK);
    s_terms.coef[0].enabled = 1u;
    expect_check(KC_ERR_RANGE);
}

void test_what_lies_beyond_the_last_term_does_not_count(void)
{
    given_coef(-0.2, 0.2, 1u, KC_RZ);
    s_terms.term[1] = s_terms.term[0];
    expect_check(KC_OK);
    s_terms.n_term = 2u;
    expect_check(KC_ERR_RANGE);
}

void test_no_bound_is_taken_where_nothing_was_verified(void)
{
    s_space.verified[1].phi_rad = 0.0;
    given_coef(0.0, 0.0, 1u, KC_RZ);
    expect_check(KC_OK);
    s_terms.coef[0].ub = 1e-9;
    expect_check(KC_ERR_RANGE);
}

void test_the_cost_grows_with_the_terms(void)
{
    TEST_ASSERT_EQUAL_UINT64(2000u * KC_TERM_MAX, kc_bounds_cost(KC_TERM_MAX) - kc_bounds_cost(0u));
}
