/* kc_pantilt.c: commands inside the limits, and waiting until the unit is there. Where the tool is seen: test_kc_camera.c. */
#include "kc_pantilt.h"

#include <math.h>
#include <string.h>

#include "given_parts.h"
#include "kc_input_fields.h"
#include "unity.h"

#define MOVE_US 5000000u

static kc_pantilt_t s_unit;

void setUp(void)
{
    given_parts(); /* pan -1.6 .. 1.6, tilt -0.6 .. 1.4 */
    parts.tables.active.config.move_timeout_us = MOVE_US;
    memset(&s_unit, 0, sizeof s_unit);
    parts.clock.now_us = parts.place.since_us = 3000000u;
}

static void expect_command(int32_t seq, double pan_rad, double tilt_rad)
{
    TEST_ASSERT_EQUAL_UINT8(1u, parts.out.has_pantilt_cmd);
    TEST_ASSERT_EQUAL_INT32(seq, parts.out.pantilt_cmd.seq);
    TEST_ASSERT_EQUAL_DOUBLE(pan_rad, parts.out.pantilt_cmd.pan_rad);
    TEST_ASSERT_EQUAL_DOUBLE(tilt_rad, parts.out.pantilt_cmd.tilt_rad);
}

static void turn(double pan_rad, double tilt_rad)
{
    memset(&parts.out, 0, sizeof parts.out);
    kc_pantilt_turn(&s_unit, &parts.view, &parts.out, pan_rad, tilt_rad);
}

void test_commands_are_numbered_and_stay_inside_the_limits(void)
{
    turn(0.3, -0.2);
    expect_command(1, 0.3, -0.2);
    turn(2.0, 2.0);
    expect_command(2, 1.6, 1.4);
    turn(-2.0, -2.0);
    expect_command(3, -1.6, -0.6);
}

/* What the unit says so long after the state began; it was sent to 0.3, -0.2. */
static kc_outcome_t after(uint64_t us, double pan_rad, double tilt_rad, uint8_t moving)
{
    memset(&parts.out, 0, sizeof parts.out);
    parts.clock.now_us = parts.place.since_us + us;
    parts.telemetry.pantilt.pan_rad = pan_rad;
    parts.telemetry.pantilt.tilt_rad = tilt_rad;
    parts.telemetry.pantilt.moving = moving;
    return kc_pantilt_wait(&s_unit, &parts.view, &parts.out);
}

void test_it_is_there_when_it_stands_near_both_angles(void)
{
    turn(0.3, -0.2);
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, after(0u, 0.309, -0.209, 0).id);
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, after(0u, 0.311, -0.2, 0).id);
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, after(0u, 0.289, -0.2, 0).id);
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, after(0u, 0.3, -0.211, 0).id);
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, after(0u, 0.3, -0.189, 0).id);
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, after(0u, 0.3, -0.2, 1).id);
    turn(0.0, 0.0); /* to the last bit */
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, after(0u, 0.01, -0.01, 0).id);
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, after(0u, 0.01000000001, 0.0, 0).id);
}

void test_a_command_that_was_lost_is_sent_again_each_second(void)
{
    turn(0.3, -0.2);
    for (int32_t k = 1; k < 4; k++) {
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, after((uint64_t)k * 1000000u - 1u, 0.0, 0.0, 0).id);
        TEST_ASSERT_EQUAL_UINT8(0u, parts.out.has_pantilt_cmd);
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, after((uint64_t)k * 1000000u, 0.0, 0.0, 0).id);
        expect_command(1 + k, 0.3, -0.2);
    }
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, after(4500000u, 0.0, 0.0, 1).id); /* on its way */
    TEST_ASSERT_EQUAL_UINT8(0u, parts.out.has_pantilt_cmd);
}

void test_a_unit_that_takes_too_long_ends_the_calibration(void)
{
    turn(0.3, -0.2);
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, after(MOVE_US, 0.2, -0.2, 1).id);
    kc_outcome_t end = after(MOVE_US + 1u, 0.2, -0.2, 1);
    TEST_ASSERT_EQUAL_INT(KC_OC_ABORT, end.id);
    TEST_ASSERT_EQUAL_INT(KC_CAUSE_PANTILT_LATE, end.cause);
    TEST_ASSERT_EQUAL_UINT8(0u, parts.out.has_pantilt_cmd);
    expect_event(KC_EVT_CAL_MOVE_TIMEOUT, KC_INPUT_PANTILT, MOVE_US + 1.0, 0.0);
}

/* To where the tool is expected, shifted along one axis. */
void test_the_pantilt_unit_is_aimed_at_the_shifted_tool(void)
{
    for (uint32_t axis = 0u; axis < 3u; axis++) {
        kc_pose_t T;
        double off_m[3] = {0.0}, pan = 0.0, tilt = 0.0, pan0 = 0.0, tilt0 = 0.0;
        const kc_camera_t *c = &parts.tables.active.camera;
        off_m[axis] = 0.05;
        kc_view_expect(&parts.view, parts.telemetry.arm.q, &T);
        (void)kc_camera_aim(c, T.p_m, &pan0, &tilt0);
        T.p_m[axis] += 0.05;
        (void)kc_camera_aim(c, T.p_m, &pan, &tilt);
        TEST_ASSERT_TRUE(fabs(pan - pan0) + fabs(tilt - tilt0) > 1e-3);
        s_unit.pan_rad = 1.0; /* so that it turns */
        kc_pantilt_aim(&s_unit, &parts.view, &parts.out, parts.telemetry.arm.q, off_m);
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, pan, parts.out.pantilt_cmd.pan_rad);
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, tilt, parts.out.pantilt_cmd.tilt_rad);
    }
}

void test_a_tool_near_the_middle_of_the_image_needs_no_turn(void)
{
    static const double none[3] = {0.0}, off[7][2] = {{0.0, 0.0},   {0.99, 0.0}, {0.0, -0.99}, {1.01, 0.0},
                                                      {-1.01, 0.0}, {0.0, 1.01}, {0.0, -1.01}};
    kc_pose_t T;
    double pan = 0.0, tilt = 0.0;
    kc_view_expect(&parts.view, parts.telemetry.arm.q, &T);
    (void)kc_camera_aim(&parts.tables.active.camera, T.p_m, &pan, &tilt);
    kc_camera_t *c = &parts.tables.active.camera;
    for (uint32_t i = 0u; i < 21u; i++) { /* 1/40 of the view: of its height, of its width, of a long lens */
        const uint32_t width = i < 7u ? 1920u : 540u;
        const double f = i < 14u ? 1397.0 : 13970.0, most = (i < 7u ? 1080.0 : 540.0) / f / 40.0;
        c->width_px = width;
        c->fx_px = c->fy_px = f;
        memset(&parts.out, 0, sizeof parts.out);
        s_unit.pan_rad = pan + most * off[i % 7u][0];
        s_unit.tilt_rad = tilt + most * off[i % 7u][1];
        kc_pantilt_aim(&s_unit, &parts.view, &parts.out, parts.telemetry.arm.q, none);
        TEST_ASSERT_EQUAL_UINT8(i % 7u < 3u ? 0u : 1u, parts.out.has_pantilt_cmd);
    }
    c->width_px = 0u; /* just at the end of a view that has none */
    memset(&parts.out, 0, sizeof parts.out);
    s_unit.pan_rad = pan;
    s_unit.tilt_rad = tilt;
    kc_pantilt_aim(&s_unit, &parts.view, &parts.out, parts.telemetry.arm.q, none);
    TEST_ASSERT_EQUAL_UINT8(0u, parts.out.has_pantilt_cmd);
}
