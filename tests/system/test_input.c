/* kc_input.c: faults of the arm in a whole calibration, and detections on their way in. Message by message:
 * test_kc_input.c. */
#include <math.h>
#include <string.h>

#include "given_world.h"
#include "unity.h"

#define APP (&kc_app_instance)

void setUp(void) { given_world(); }

static void nothing(kc_arm_state_t *s) { (void)s; }
static void repeated(kc_arm_state_t *s)
{
    s->seq = APP->input.telemetry.arm.seq;
    s->t_us = APP->input.telemetry.arm.t_us;
}
static void overtaken(kc_arm_state_t *s)
{
    repeated(s);
    s->seq--;
    s->t_us--;
}
static void too_old(kc_arm_state_t *s) { s->t_us -= 3000000u; } /* or far ahead */
static void far_ahead(kc_arm_state_t *s) { s->t_us = UINT64_MAX; }
static void not_a_number(kc_arm_state_t *s) { s->q[0] = NAN; }
static void out_of_range(kc_arm_state_t *s) { s->temp_c = 1e9; }
static void no_joints(kc_arm_state_t *s) { s->n_joints = 0u; }
static void many_joints(kc_arm_state_t *s) { s->n_joints = UINT32_MAX; }
static void (*const s_wrong[])(kc_arm_state_t *) = {
    nothing, repeated, overtaken, too_old, far_ahead, not_a_number, out_of_range, no_joints, many_joints};

static uint32_t s_case;
static int32_t s_mask;
static void fault_in_a_bad_message(kc_in_t *in)
{
    in->arm.fault_mask = s_mask;
    if (s_mask != 0) { s_wrong[s_case](&in->arm); }
}
static void bad_message(kc_in_t *in) { s_wrong[s_case](&in->arm); }

/* Whatever else is wrong with the message: the calibration ends, and START is refused until a good state says
 * that there is no fault any more. Bad ones without a fault do not. */
void test_a_fault_counts_whatever_else_is_wrong_with_its_message(void)
{
    for (s_case = 0u; s_case < sizeof s_wrong / sizeof s_wrong[0]; s_case++) {
        given_world();
        world_started();
        world_ticks(25u);
        TEST_ASSERT_TRUE(world_calibrating());
        s_mask = 4;
        world.spoil_in = fault_in_a_bad_message;
        world_tick();
        TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
        TEST_ASSERT_EQUAL_INT(1, world.arm_cmd.hold);
        TEST_ASSERT_EQUAL_DOUBLE((double)KC_CAUSE_ARM_FAULT, world.last[KC_EVT_CAL_ABORTED].got);
        TEST_ASSERT_EQUAL_DOUBLE(4.0, world.last[KC_EVT_ARM_FAULT].got);
        TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_ARM_FAULT));
        if (s_case > 0u) {
            world.spoil_in = bad_message;
            TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, world_do(KC_CMD_START, 0, 0, 1));
            TEST_ASSERT_EQUAL_INT(KC_EVT_ARM_FAULT, world.ack.event_id);
        }
        world.spoil_in = NULL;
        world_ticks(5u);
        TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
        TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_START, 0, 0, 1));
    }
}

/* In the middle of a measurement, with one frame taken and the next one awaited. */
void test_of_detections_no_more_are_read_than_the_queue_holds(void)
{
    static kc_in_t in;
    static kc_out_t out;
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 300u));
    in.n_det = KC_DET_QUEUE_MAX + 1u;
    for (uint32_t i = 0u; i < KC_DET_QUEUE_MAX; i++) { in.det[i] = APP->request.det; } /* none is awaited */
    memset(&in.has_arm, 0x55, 1u); /* what lies behind */
    in.arm = APP->input.telemetry.arm;
    in.arm.seq += 1;
    in.arm.t_us = world.now_us + TICK_US;
    kc_app_step(APP, world.now_us + TICK_US, &in, &out);
    TEST_ASSERT_EQUAL_UINT32(1u, out.events.n); /* the same event is counted, not repeated */
    TEST_ASSERT_EQUAL_UINT16(KC_EVT_DET_UNREQUESTED, out.events.e[0].id);
}
