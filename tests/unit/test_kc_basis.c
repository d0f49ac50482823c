/* kc_basis.c: every function at its corners, every variable, hostile numbers. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "kc_libm.h"
#include "kc_terms.h"
#include "unity.h"

static kc_ctx_t s_ctx;
static kc_loads_t s_loads;

void setUp(void)
{
    memset(&s_ctx, 0, sizeof s_ctx);
    memset(&s_loads, 0, sizeof s_loads);
}

static double value(uint8_t fn, uint8_t var, uint8_t index, double c0, double c1)
{
    const kc_basis_t b = {fn, var, index, c0, c1};
    return kc_basis_eval(&b, &s_ctx, &s_loads);
}

/* fn at argument z, through the temperature. */
static double at(uint8_t fn, double z)
{
    s_ctx.temp_c = z;
    return value(fn, KC_VAR_TEMP, 0u, 0.0, 1.0);
}

void test_the_constant_is_one_whatever_the_function(void)
{
    for (uint8_t fn = 0u; fn < KC_FN_COUNT; fn++) {
        TEST_ASSERT_EQUAL_DOUBLE(1.0, value(fn, KC_VAR_ONE, 0u, 5.0, 7.0));
    }
}

void test_offset_and_scale_make_the_argument(void)
{
    s_ctx.temp_c = 25.0;
    TEST_ASSERT_EQUAL_DOUBLE(10.0, value(KC_FN_LIN, KC_VAR_TEMP, 0u, 20.0, 2.0));
}

void test_functions_at_their_corners(void)
{
    TEST_ASSERT_EQUAL_DOUBLE(-3.0, at(KC_FN_LIN, -3.0));
    TEST_ASSERT_EQUAL_DOUBLE(kc_sin(0.5), at(KC_FN_SIN, 0.5));
    TEST_ASSERT_EQUAL_DOUBLE(1.0, at(KC_FN_COS, 0.0));
    TEST_ASSERT_EQUAL_DOUBLE(1.0, at(KC_FN_TANH, 100.0));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, at(KC_FN_LN1P, -5.0));
    TEST_ASSERT_EQUAL_DOUBLE(kc_log1p(3.0), at(KC_FN_LN1P, 3.0));
    TEST_ASSERT_EQUAL_DOUBLE(1.0, at(KC_FN_EXPN, -5.0));
    TEST_ASSERT_EQUAL_DOUBLE(kc_exp(-2.0), at(KC_FN_EXPN, 2.0));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, at(KC_FN_STEP, -1e-9));
    TEST_ASSERT_EQUAL_DOUBLE(1.0, at(KC_FN_STEP, 0.0));
    TEST_ASSERT_EQUAL_DOUBLE(9.0, at(KC_FN_SQ, -3.0));
    TEST_ASSERT_EQUAL_DOUBLE(3.0, at(KC_FN_ABS, -3.0));
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 1.0, at(KC_FN_TAN2, 0.25 * KC_PI));
    TEST_ASSERT_EQUAL_DOUBLE(at(KC_FN_TAN2, 1.4), at(KC_FN_TAN2, -1.6));
}

void test_each_variable_reads_its_own_field(void)
{
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) {
        s_ctx.q[j] = 10.0 + j;
        s_ctx.dir[j] = (j % 2u) ? 1.0 : -1.0;
        s_ctx.qdot[j] = 30.0 + j;
        s_loads.tau[j] = 40.0 + j;
        s_loads.tau_payload[j] = 50.0 + j;
    }
    for (uint32_t i = 0u; i <= KC_JOINT_MAX; i++) {
        for (uint32_t k = 0u; k < 3u; k++) {
            s_loads.moment[i][k] = 100.0 + 10.0 * i + k;
            s_loads.g_link_m_s2[i][k] = 300.0 + 10.0 * i + k;
        }
    }
    s_ctx.temp_c = 1.0;
    s_ctx.t_s = 2.0;
    s_ctx.payload_kg = 3.0;
    s_ctx.range_m = 4.0;
    s_ctx.incid_rad = 5.0;
    s_ctx.u_norm = 6.0;
    s_ctx.v_norm = 7.0;
    s_ctx.pan_rad = 8.0;
    s_ctx.tilt_rad = 9.0;
    s_ctx.tag = 0.5;
    for (uint32_t k = 0u; k < 3u; k++) { s_ctx.p_cam_tool_m[k] = 200.0 + k; }
    for (uint32_t k = 0u; k < 6u; k++) { s_ctx.pnp[k][KC_PNP_MAX] = 400.0 + k; }
    s_ctx.move[KC_MOVE_MAX] = 500.0;

    static const struct {
        uint8_t var, index;
        double want;
    } expected[] = {
        {KC_VAR_Q, 1u, 10.0},
        {KC_VAR_Q, 8u, 17.0},
        {KC_VAR_DIR, 1u, -1.0},
        {KC_VAR_DIR, 2u, 1.0},
        {KC_VAR_QDOT, 3u, 32.0},
        {KC_VAR_TAU, 4u, 43.0},
        {KC_VAR_TAU_PAYLOAD, 5u, 54.0},
        {KC_VAR_MX, 0u, 100.0},
        {KC_VAR_MY, 8u, 181.0},
        {KC_VAR_MZ, 3u, 132.0},
        {KC_VAR_TEMP, 0u, 1.0},
        {KC_VAR_T, 0u, 2.0},
        {KC_VAR_PAYLOAD, 0u, 3.0},
        {KC_VAR_RANGE, 0u, 4.0},
        {KC_VAR_INCID, 0u, 5.0},
        {KC_VAR_U, 0u, 6.0},
        {KC_VAR_V, 0u, 7.0},
        {KC_VAR_R2, 0u, 85.0},
        {KC_VAR_PAN, 0u, 8.0},
        {KC_VAR_TILT, 0u, 9.0},
        {KC_VAR_XCAM, 0u, 200.0},
        {KC_VAR_YCAM, 0u, 201.0},
        {KC_VAR_ZCAM, 0u, 202.0},
        {KC_VAR_TAG, 0u, 0.5},
        {KC_VAR_PNP_TX, KC_PNP_MAX, 400.0},
        {KC_VAR_PNP_TY, KC_PNP_MAX, 401.0},
        {KC_VAR_PNP_TZ, KC_PNP_MAX, 402.0},
        {KC_VAR_PNP_RX, KC_PNP_MAX, 403.0},
        {KC_VAR_PNP_RY, KC_PNP_MAX, 404.0},
        {KC_VAR_PNP_RZ, KC_PNP_MAX, 405.0},
        {KC_VAR_PNP_RZ, KC_PNP_MAX + 1u, 0.0}, /* beyond the last column */
        {KC_VAR_MOVE, KC_MOVE_MAX, 500.0},
        {KC_VAR_MOVE, KC_MOVE_MAX + 1u, 0.0}, /* beyond the last joint */
        {KC_VAR_GX, 0u, 300.0},
        {KC_VAR_GY, 8u, 381.0},
        {KC_VAR_GZ, 3u, 332.0},
    };
    for (size_t k = 0u; k < sizeof expected / sizeof expected[0]; k++) {
        TEST_ASSERT_EQUAL_DOUBLE(expected[k].want,
                                 value(KC_FN_LIN, expected[k].var, expected[k].index, 0.0, 1.0));
    }
}

/* Frame 2 at (1, 0, 0), its axes those of the base; body 4 at (1, 2, 3), the tool at (4, 5, 6); gravity down. */
static void given_levers(void)
{
    static const double link[3] = {1.0, 0.0, 0.0}, body[3] = {1.0, 2.0, 3.0}, tool[3] = {4.0, 5.0, 6.0};
    static const double g_cross[3][3] = {{0.0, -10.0, 0.0}, {10.0, 0.0, 0.0}, {0.0, 0.0, 0.0}};
    memcpy(s_loads.origin_m[2], link, sizeof link);
    memcpy(s_loads.origin_m[4], body, sizeof body);
    memcpy(s_loads.origin_m[KC_FRAME_TOOL], tool, sizeof tool);
    memcpy(s_loads.g_cross_m_s2[2], g_cross, sizeof g_cross);
}

void test_a_lever_is_the_moment_of_one_kilogram_at_a_body_about_a_link(void)
{
    given_levers();
    const uint8_t body = KC_LEVER_INDEX(2u, 4u), tool = KC_LEVER_INDEX(2u, KC_LEVER_TOOL);
    TEST_ASSERT_EQUAL_DOUBLE(-20.0, value(KC_FN_LIN, KC_VAR_LEVX, body, 0.0, 1.0));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, value(KC_FN_LIN, KC_VAR_LEVY, body, 0.0, 1.0));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, value(KC_FN_LIN, KC_VAR_LEVZ, body, 0.0, 1.0));
    TEST_ASSERT_EQUAL_DOUBLE(-50.0, value(KC_FN_LIN, KC_VAR_LEVX, tool, 0.0, 1.0));
    TEST_ASSERT_EQUAL_DOUBLE(30.0, value(KC_FN_LIN, KC_VAR_LEVY, tool, 0.0, 1.0));
}

void test_levers_beyond_the_largest_arm_read_as_zero(void)
{
    given_levers();
    TEST_ASSERT_EQUAL_DOUBLE(0.0, value(KC_FN_LIN, KC_VAR_LEVX, KC_LEVER_INDEX(2u, 9u), 0.0, 1.0));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, value(KC_FN_LIN, KC_VAR_LEVX, KC_LEVER_INDEX(9u, 4u), 0.0, 1.0));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, value(KC_FN_LIN, KC_VAR_GX, KC_JOINT_MAX + 1u, 0.0, 1.0));
}

void test_what_no_valid_table_holds_reads_as_zero(void)
{
    s_ctx.q[0] = 5.0;
    TEST_ASSERT_EQUAL_DOUBLE(0.0, value(KC_FN_LIN, KC_VAR_Q, 0u, 0.0, 1.0));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, value(KC_FN_LIN, KC_VAR_Q, KC_JOINT_MAX + 1u, 0.0, 1.0));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, value(KC_FN_LIN, KC_VAR_MX, KC_JOINT_MAX + 1u, 0.0, 1.0));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, value(KC_FN_LIN, KC_VAR_COUNT, 0u, 0.0, 1.0));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, value(KC_FN_COUNT, KC_VAR_Q, 1u, 0.0, 1.0));
}

void test_every_function_stays_finite_for_huge_arguments(void)
{
    static const double huge[4] = {DBL_MAX, -DBL_MAX, 1e200, -1e200};
    for (uint8_t fn = 0u; fn < KC_FN_COUNT; fn++) {
        for (int k = 0; k < 4; k++) {
            s_ctx.temp_c = huge[k];
            TEST_ASSERT_TRUE(isfinite(value(fn, KC_VAR_TEMP, 0u, -huge[k], 1e100)));
            TEST_ASSERT_TRUE(isfinite(value(fn, KC_VAR_TEMP, 0u, -huge[k], 0.0)));
        }
    }
}

void test_only_what_gravity_does_needs_loads(void)
{
    for (uint8_t var = 0u; var < KC_VAR_COUNT; var++) {
        const kc_basis_t b = {KC_FN_LIN, var, 1u, 0.0, 1.0};
        const int want = var == KC_VAR_TAU || var == KC_VAR_MX || var == KC_VAR_MY || var == KC_VAR_MZ ||
                         var == KC_VAR_TAU_PAYLOAD || var == KC_VAR_GX || var == KC_VAR_GY ||
                         var == KC_VAR_GZ || var == KC_VAR_LEVX || var == KC_VAR_LEVY || var == KC_VAR_LEVZ;
        TEST_ASSERT_EQUAL_INT(want, kc_basis_needs_loads(&b));
    }
}

void test_a_number_that_is_no_variable_has_no_index_and_needs_nothing(void)
{
    TEST_ASSERT_EQUAL_INT(KC_INDEX_COLUMN, kc_var_index(KC_VAR_PNP_RZ));
    TEST_ASSERT_EQUAL_INT(KC_FROM_POINTS, kc_var_from(KC_VAR_PNP_RZ));
    TEST_ASSERT_EQUAL_INT(KC_INDEX_NONE, kc_var_index(KC_VAR_COUNT));
    TEST_ASSERT_EQUAL_INT(KC_FROM_RECORD, kc_var_from(KC_VAR_COUNT));
}
