/* kc_pantilt.c: commands inside the limits, and waiting until the unit is there. Aiming: test_kc_camera.c. */
#include "kc_pantilt.h"

#include <string.h>

#include "given_tables.h"
#include "kc_input_fields.h"
#include "unity.h"

#define MOVE_US 5000000u

static kc_active_t s_tables;
static kc_telemetry_t s_heard;
static kc_clock_t s_clock;
static kc_place_t s_place;
static const kc_view_t s_view = {
    .clock = &s_clock, .place = &s_place, .tables = &s_tables, .telemetry = &s_heard};
static kc_out_t s_out;
static kc_pantilt_t s_unit;

void setUp(void);
void setUp(void)
{
    given_camera(&s_tables.camera); /* pan -1.6 .. 1.6, tilt -0.6 .. 1.4 */
    s_tables.config.move_timeout_us = MOVE_US;
    memset(&s_heard, 0, sizeof s_heard);
    memset(&s_unit, 0, sizeof s_unit);
    s_clock.now_us = s_place.since_us = 3000000u;
}

static void expect_command(int32_t seq, double pan_rad, double tilt_rad)
{
    TEST_ASSERT_EQUAL_UINT8(1u, s_out.has_pantilt_cmd);
    TEST_ASSERT_EQUAL_INT32(seq, s_out.pantilt_cmd.seq);
    TEST_ASSERT_EQUAL_DOUBLE(pan_rad, s_out.pantilt_cmd.pan_rad);
    TEST_ASSERT_EQUAL_DOUBLE(tilt_rad, s_out.pantilt_cmd.tilt_rad);
}

static void turn(double pan_rad, double tilt_rad)
{
    memset(&s_out, 0, sizeof s_out);
    kc_pantilt_turn(&s_unit, &s_view, &s_out, pan_rad, tilt_rad);
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
    memset(&s_out, 0, sizeof s_out);
    s_clock.now_us = s_place.since_us + us;
    s_heard.pantilt.pan_rad = pan_rad;
    s_heard.pantilt.tilt_rad = tilt_rad;
    s_heard.pantilt.moving = moving;
    return kc_pantilt_wait(&s_unit, &s_view, &s_out);
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
}

void test_a_command_that_was_lost_is_sent_again_each_second(void)
{
    turn(0.3, -0.2);
    for (int32_t k = 1; k < 4; k++) {
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, after((uint64_t)k * 1000000u - 1u, 0.0, 0.0, 0).id);
        TEST_ASSERT_EQUAL_UINT8(0u, s_out.has_pantilt_cmd);
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, after((uint64_t)k * 1000000u, 0.0, 0.0, 0).id);
        expect_command(1 + k, 0.3, -0.2);
    }
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, after(4500000u, 0.0, 0.0, 1).id); /* on its way */
    TEST_ASSERT_EQUAL_UINT8(0u, s_out.has_pantilt_cmd);
}

void test_a_unit_that_takes_too_long_ends_the_calibration(void)
{
    turn(0.3, -0.2);
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, after(MOVE_US, 0.2, -0.2, 1).id);
    kc_outcome_t end = after(MOVE_US + 1u, 0.2, -0.2, 1);
    TEST_ASSERT_EQUAL_INT(KC_OC_ABORT, end.id);
    TEST_ASSERT_EQUAL_INT(KC_CAUSE_PANTILT_LATE, end.cause);
    TEST_ASSERT_EQUAL_UINT32(1u, s_out.events.n);
    TEST_ASSERT_EQUAL_UINT16(KC_EVT_CAL_MOVE_TIMEOUT, s_out.events.e[0].id);
    TEST_ASSERT_EQUAL_INT32(KC_INPUT_PANTILT, s_out.events.e[0].index);
    TEST_ASSERT_EQUAL_DOUBLE(MOVE_US + 1.0, s_out.events.e[0].got);
    TEST_ASSERT_EQUAL_UINT8(0u, s_out.has_pantilt_cmd);
}
