/* kc_input.c: everything refused with an event and nothing changed. */
#include <math.h>
#include <string.h>

#include "given_world.h"
#include "unity.h"

#define APP (&kc_app_instance)

static kc_in_t s_in;
static kc_out_t s_out;

void setUp(void);
void setUp(void) { given_world(); }

/* A live component at rest, and a good arm and pan-tilt unit message for the next step. */
static void given_idle(void)
{
    world_boot();
    world_ticks(2u);
    memset(&s_in, 0, sizeof s_in);
    s_in.arm = APP->input.telemetry.arm;
    s_in.arm.seq++;
    s_in.arm.t_us = world.now_us + TICK_US;
    s_in.pantilt = APP->input.telemetry.pantilt;
    s_in.pantilt.seq++;
    s_in.pantilt.t_us = world.now_us + TICK_US;
}

static void step(void)
{
    world.now_us += TICK_US;
    kc_app_step(APP, world.now_us, &s_in, &s_out);
}

static const kc_event_t *only_event(uint16_t id)
{
    const kc_event_t *e = NULL;
    for (uint32_t i = 0u; i < s_out.events.n; i++) {
        if (s_out.events.e[i].id == id) { e = &s_out.events.e[i]; }
    }
    TEST_ASSERT_NOT_NULL_MESSAGE(e, "the event is missing");
    return e;
}

/* The message in s_in is refused: this event, nothing else, and nothing changed. */
static void refused(uint16_t id, int32_t index)
{
    world_remember();
    step();
    TEST_ASSERT_EQUAL_UINT32(1u, s_out.events.n);
    TEST_ASSERT_EQUAL_INT(index, only_event(id)->index);
    TEST_ASSERT_TRUE_MESSAGE(world_unchanged(), "something changed");
}

/* ---- arm ---- */

typedef struct {
    double *field;
    double value;
    int32_t index;
} spoiled_t;

static void refuse_each(const spoiled_t *s, uint32_t n, uint8_t arm)
{
    for (uint32_t i = 0u; i < n; i++) {
        double good = *s[i].field;
        const double bad[3] = {s[i].value, NAN, -INFINITY};
        for (uint32_t k = 0u; k < 3u; k++) {
            given_idle();
            s_in.has_arm = arm;
            s_in.has_pantilt = !arm;
            *s[i].field = bad[k];
            refused(KC_EVT_IN_RANGE, s[i].index);
        }
        *s[i].field = good;
    }
}

void test_arm_state_out_of_range_or_not_finite_is_refused(void)
{
    const spoiled_t s[] = {
        {&s_in.arm.q[0], 3.2, 110},        {&s_in.arm.q[3], -1.5, 113},      {&s_in.arm.dq[1], 60.0, 121},
        {&s_in.arm.q_cmd[6], 101.0, 136},  {&s_in.arm.dir[2], 2.0, 142},     {&s_in.arm.temp_c, 501.0, 150},
        {&s_in.arm.payload_kg, -1.0, 151}, {&s_in.arm.g_m_s2[1], 31.0, 153},
    };
    refuse_each(s, sizeof s / sizeof s[0], 1u);
}

void test_arm_state_repeated_or_overtaken_is_refused(void)
{
    for (int32_t back = 0; back < 3; back++) {
        given_idle();
        s_in.has_arm = 1u;
        s_in.arm.seq = APP->input.telemetry.arm.seq - back;
        s_in.arm.t_us = APP->input.telemetry.arm.t_us - (uint64_t)back;
        refused(KC_EVT_IN_STALE, KC_INPUT_ARM);
        TEST_ASSERT_EQUAL_DOUBLE((double)APP->input.telemetry.arm.seq, only_event(KC_EVT_IN_STALE)->want);
    }
}

/* Up to 100 numbers may be lost; beyond, and behind, the stamp decides. */
void test_a_number_far_ahead_counts_by_its_stamp_alone(void)
{
    const int32_t far[] = {101, -1, INT32_MIN, INT32_MAX};
    given_idle();
    s_in.has_arm = 1u;
    s_in.arm.seq = APP->input.telemetry.arm.seq + 100;
    s_in.arm.t_us = APP->input.telemetry.arm.t_us;
    step();
    TEST_ASSERT_EQUAL_UINT32(0u, s_out.events.n);
    for (uint32_t i = 0u; i < 4u; i++) {
        given_idle();
        s_in.has_arm = 1u;
        s_in.arm.seq = (int32_t)((uint32_t)APP->input.telemetry.arm.seq + (uint32_t)far[i]);
        s_in.arm.t_us = APP->input.telemetry.arm.t_us;
        refused(KC_EVT_IN_STALE, KC_INPUT_ARM);
        s_in.arm.t_us++;
        step();
        TEST_ASSERT_EQUAL_INT(KC_INPUT_ARM, only_event(KC_EVT_IN_JUMP)->index);
        TEST_ASSERT_EQUAL_INT(s_in.arm.seq, APP->input.telemetry.arm.seq);
    }
}

/* A stranger's message with the largest number and a stamp as far ahead as is taken: the next genuine one counts. */
void test_a_wild_number_blocks_no_message_after_it(void)
{
    given_idle();
    kc_in_t genuine = s_in;
    s_in.has_arm = s_in.has_pantilt = 1u;
    s_in.arm.seq = s_in.pantilt.seq = INT32_MAX;
    s_in.arm.t_us = s_in.pantilt.t_us = world.now_us + TICK_US + 50000u;
    step();
    TEST_ASSERT_EQUAL_INT(INT32_MAX, APP->input.telemetry.arm.seq);
    s_in = genuine;
    s_in.has_arm = s_in.has_pantilt = 1u;
    s_in.arm.t_us = s_in.pantilt.t_us = world.now_us + TICK_US;
    step();
    TEST_ASSERT_EQUAL_INT(genuine.arm.seq, APP->input.telemetry.arm.seq);
    TEST_ASSERT_EQUAL_INT(genuine.pantilt.seq, APP->input.telemetry.pantilt.seq);
}

void test_arm_state_of_another_time_is_refused(void)
{
    given_idle();
    s_in.has_arm = 1u;
    s_in.arm.t_us = world.now_us + 2u * TICK_US;
    refused(KC_EVT_IN_RANGE, 101);
    world.now_us += 3000000u;
    given_idle();
    s_in.has_arm = 1u;
    s_in.arm.t_us = world.now_us - 2500000u;
    refused(KC_EVT_IN_RANGE, 101);
}

void test_arm_state_with_the_wrong_number_of_joints_is_refused(void)
{
    const uint32_t counts[] = {0u, 6u, 8u, UINT32_MAX};
    for (uint32_t i = 0u; i < 4u; i++) {
        given_idle();
        s_in.has_arm = 1u;
        s_in.arm.n_joints = counts[i];
        refused(KC_EVT_IN_COUNT, KC_INPUT_ARM);
    }
}

void test_a_controller_that_was_started_again_is_heard_at_once(void)
{
    given_idle();
    s_in.has_arm = s_in.has_pantilt = 1u;
    APP->input.telemetry.arm.seq = APP->input.telemetry.pantilt.seq = 1000;
    s_in.arm.seq = s_in.pantilt.seq = 1;
    step();
    TEST_ASSERT_EQUAL_UINT32(2u, s_out.events.n);
    TEST_ASSERT_EQUAL_INT(1, APP->input.telemetry.arm.seq);
    TEST_ASSERT_EQUAL_INT(1, APP->input.telemetry.pantilt.seq);
}

/* Its clock as well: after a while, when nothing newer has come. */
void test_a_controller_whose_clock_was_set_back_is_heard_after_a_while(void)
{
    given_idle();
    s_in.has_arm = s_in.has_pantilt = 1u;
    APP->input.telemetry.arm.seq = APP->input.telemetry.pantilt.seq = 1000;
    APP->input.telemetry.arm.t_us = APP->input.telemetry.pantilt.t_us = UINT64_MAX;
    s_in.arm.seq = s_in.pantilt.seq = 1;
    for (uint32_t i = 0u; i < 60u; i++) {
        TEST_ASSERT_EQUAL_INT(i <= 50u ? 1000 : s_in.arm.seq - 1, APP->input.telemetry.arm.seq);
        s_in.arm.t_us = s_in.pantilt.t_us = world.now_us + TICK_US;
        step();
        s_in.arm.seq++;
        s_in.pantilt.seq++;
    }
    TEST_ASSERT_TRUE(APP->input.telemetry.pantilt.seq < 100);
    TEST_ASSERT_EQUAL_UINT32(0u, s_out.events.n);
}

void test_without_an_arm_table_the_arm_is_not_listened_to(void)
{
    kc_app_init(APP);
    kc_app_boot(APP);
    world_ticks(2u);
    TEST_ASSERT_EQUAL_UINT8(0u, APP->input.telemetry.has_arm);
    TEST_ASSERT_EQUAL_UINT8(1u, APP->input.telemetry.has_pantilt);
}

void test_an_early_clock_takes_what_is_as_old_as_it_can_be(void)
{
    world.now_us = 0u;
    world_boot();
    world_tick();
    TEST_ASSERT_EQUAL_UINT8(1u, APP->input.telemetry.has_arm);
}

void test_an_arm_fault_is_reported_once(void)
{
    world_boot();
    world_tick();
    world.fault = 5;
    world_ticks(4u);
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_ARM_FAULT));
    TEST_ASSERT_EQUAL_DOUBLE(5.0, world.last[KC_EVT_ARM_FAULT].got);
    world.fault = 0;
    world_tick();
    world.fault = 5;
    world_tick();
    TEST_ASSERT_EQUAL_UINT32(2u, world_events(KC_EVT_ARM_FAULT));
    TEST_ASSERT_EQUAL_INT(KC_ST_IDLE, kc_app_state(APP));
}

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

/* Bits of several bad messages add up; a good one says what is left. */
void test_faults_of_bad_messages_add_up_until_a_good_one(void)
{
    given_idle();
    s_in.has_arm = 1u;
    s_in.arm.n_joints = 0u;
    for (int32_t bit = 1; bit < 8; bit *= 2) {
        s_in.arm.fault_mask = bit;
        step();
        TEST_ASSERT_EQUAL_INT(2 * bit - 1, APP->input.telemetry.arm.fault_mask);
        TEST_ASSERT_EQUAL_DOUBLE((double)(2 * bit - 1), only_event(KC_EVT_ARM_FAULT)->got);
    }
    s_in.arm.n_joints = 7u;
    s_in.arm.fault_mask = 2;
    s_in.arm.t_us = world.now_us;
    step();
    TEST_ASSERT_EQUAL_INT(2, APP->input.telemetry.arm.fault_mask);
}

void test_a_fault_counts_without_an_arm_table_too(void)
{
    kc_app_init(APP);
    kc_app_boot(APP);
    world.fault = 3;
    world_ticks(2u);
    TEST_ASSERT_EQUAL_INT(3, APP->input.telemetry.arm.fault_mask);
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_ARM_FAULT));
}

/* ---- pan-tilt unit ---- */

void test_pantilt_state_out_of_range_is_refused(void)
{
    const spoiled_t s[] = {{&s_in.pantilt.pan_rad, 7.0, 202}, {&s_in.pantilt.tilt_rad, 7.0, 203}};
    refuse_each(s, 2u, 0u);
}

void test_pantilt_state_that_is_stale_or_of_another_time_is_refused(void)
{
    given_idle();
    s_in.has_pantilt = 1u;
    s_in.pantilt.seq = APP->input.telemetry.pantilt.seq;
    s_in.pantilt.t_us = APP->input.telemetry.pantilt.t_us;
    refused(KC_EVT_IN_STALE, KC_INPUT_PANTILT);
    given_idle();
    s_in.has_pantilt = 1u;
    s_in.pantilt.t_us = world.now_us + 3u * TICK_US;
    refused(KC_EVT_IN_RANGE, 201);
}

/* ---- detections: in the middle of a measurement, one frame taken and the next one requested ---- */

static kc_detection_t *given_frame(void)
{
    given_world();
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 300u));
    TEST_ASSERT_EQUAL_UINT32(1u, APP->frames.n);
    TEST_ASSERT_EQUAL_INT(KC_FRAME_AWAITED, APP->request.frame);
    memset(&s_in, 0, sizeof s_in);
    s_in.n_det = 1u;
    s_in.det[0] = APP->request.det;
    s_in.det[0].seq = APP->request.seq;
    s_in.det[0].t_us = world.now_us + TICK_US;
    return &s_in.det[0];
}

/* Refused as if it had never come: the frame is still waited for. */
static void det_refused(uint16_t id, int32_t index)
{
    refused(id, index);
    TEST_ASSERT_EQUAL_INT(KC_FRAME_AWAITED, APP->request.frame);
    TEST_ASSERT_EQUAL_INT(KC_ST_MEASURE, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT8(0u, s_out.has_frame_request);
}

void test_a_good_frame_is_taken(void)
{
    (void)given_frame();
    step();
    TEST_ASSERT_EQUAL_UINT32(0u, s_out.events.n);
    TEST_ASSERT_EQUAL_UINT32(2u, APP->frames.n);
}

void test_a_frame_that_was_not_requested_is_refused(void)
{
    given_frame()->seq += 1;
    det_refused(KC_EVT_DET_UNREQUESTED, -1);
    given_frame()->seq -= 1;
    det_refused(KC_EVT_DET_UNREQUESTED, -1);
    given_idle();
    APP->place.state = KC_ST_REVIEW;
    s_in.n_det = 1u;
    refused(KC_EVT_DET_UNREQUESTED, -1);
}

void test_a_frame_that_is_repeated_is_refused(void)
{
    kc_detection_t *d = given_frame();
    s_in.det[1] = *d;
    s_in.n_det = 2u;
    step();
    TEST_ASSERT_EQUAL_UINT32(2u, APP->frames.n);
    TEST_ASSERT_EQUAL_DOUBLE((double)d->seq, only_event(KC_EVT_DET_UNREQUESTED)->got);
}

void test_a_frame_too_old_is_refused(void)
{
    given_frame();
    world.now_us += 1500000u; /* older than the table allows */
    det_refused(KC_EVT_DET_OLD, -1);
    TEST_ASSERT_EQUAL_DOUBLE(1000000.0, only_event(KC_EVT_DET_OLD)->want);
}

void test_a_frame_taken_before_its_request_is_refused(void)
{
    kc_detection_t *d = given_frame();
    d->t_us = APP->request.asked_us - 60000u;
    det_refused(KC_EVT_DET_OLD, -1);
}

void test_a_frame_from_the_future_is_refused(void)
{
    given_frame()->t_us += 2u * TICK_US;
    det_refused(KC_EVT_IN_RANGE, 301);
}

void test_a_frame_with_an_unknown_tag_is_refused(void)
{
    given_frame()->tag_id[1] = 17;
    det_refused(KC_EVT_DET_UNKNOWN_TAG, 1);
    TEST_ASSERT_EQUAL_DOUBLE(17.0, only_event(KC_EVT_DET_UNKNOWN_TAG)->got);
    given_frame()->tag_id[1] = 0; /* the same one twice */
    det_refused(KC_EVT_DET_UNKNOWN_TAG, 1);
    given_frame()->n_tags = 5u;
    det_refused(KC_EVT_IN_RANGE, 302);
}

void test_a_frame_whose_quaternion_is_not_unit_is_refused(void)
{
    given_frame()->q_cam_tool_wxyz[0] += 1e-3;
    det_refused(KC_EVT_IN_NOT_UNIT, KC_INPUT_DETECTION);
    given_frame()->q_alt_wxyz[0] = NAN;
    det_refused(KC_EVT_IN_NOT_UNIT, KC_INPUT_DETECTION);
}

void test_a_frame_with_a_value_out_of_range_is_refused(void)
{
    kc_detection_t *d = &s_in.det[0];
    const spoiled_t s[] = {
        {&d->p_cam_tool_m[1], 11.0, 304},
        {&d->p_alt_m[2], 11.0, 308},
        {&d->rms_px, -1.0, 309},
        {&d->rms_alt_px, -1.0, 310},
        {&d->range_m, 11.0, 311},
        {&d->incid_rad, 4.0, 312},
        {&d->u_px, 1e6, 313},
        {&d->v_px, 1e6, 314},
        {&d->corner_px[5], 1e6, 325},
        {&d->cov[3], 2e3, 363},
    };
    for (uint32_t i = 0u; i < sizeof s / sizeof s[0]; i++) {
        (void)given_frame();
        *s[i].field = s[i].value;
        det_refused(KC_EVT_IN_RANGE, s[i].index);
        (void)given_frame();
        *s[i].field = NAN;
        det_refused(KC_EVT_IN_RANGE, s[i].index);
    }
}

void test_a_frame_whose_covariance_is_not_positive_definite_is_refused(void)
{
    given_frame()->cov[0] = 0.0;
    det_refused(KC_EVT_IN_RANGE, 315);
}

/* Well formed but not good enough: refused, and another frame is requested. */
static void det_spent(uint16_t id, int32_t index)
{
    uint32_t rejected = APP->input.n_rejected;
    world_remember();
    step();
    TEST_ASSERT_EQUAL_UINT32(1u, s_out.events.n);
    TEST_ASSERT_EQUAL_INT(index, only_event(id)->index);
    TEST_ASSERT_TRUE_MESSAGE(world_unchanged(), "something changed");
    TEST_ASSERT_EQUAL_UINT8(1u, s_out.has_frame_request);
    TEST_ASSERT_EQUAL_UINT32(rejected + 1u, APP->input.n_rejected);
}

void test_a_detection_that_jumps_is_refused_and_the_average_stays(void)
{
    given_frame()->p_cam_tool_m[0] += 0.03;
    det_spent(KC_EVT_DET_JUMP, 0);
    kc_detection_t *d = given_frame();
    double half = 0.1, c = cos(half), s = sin(half), q[4];
    const double turn[4] = {c, s, 0.0, 0.0};
    kc_quat_mul(turn, d->q_cam_tool_wxyz, q);
    memcpy(d->q_cam_tool_wxyz, q, sizeof q);
    det_spent(KC_EVT_DET_JUMP, 1);
    TEST_ASSERT_DOUBLE_WITHIN(1e-3, 0.2, only_event(KC_EVT_DET_JUMP)->got);
}

void test_a_detection_that_is_too_uncertain_is_refused(void)
{
    given_frame()->cov[7] = 0.03 * 0.03;
    det_spent(KC_EVT_DET_UNCERTAIN, 0);
    TEST_ASSERT_EQUAL_DOUBLE(0.03, only_event(KC_EVT_DET_UNCERTAIN)->got);
    given_frame()->cov[35] = 0.2 * 0.2;
    det_spent(KC_EVT_DET_UNCERTAIN, 1);
    given_frame()->rms_px = 4.0;
    det_spent(KC_EVT_DET_UNCERTAIN, 2);
}

/* ---- the rest ---- */

/* Found by fuzzing: nothing checks these entries, and they are published. */
void test_entries_beyond_the_joints_of_the_arm_are_not_taken(void)
{
    given_idle();
    s_in.has_arm = 1u;
    for (uint32_t j = s_in.arm.n_joints; j < KC_JOINT_MAX; j++) {
        s_in.arm.q[j] = s_in.arm.dq[j] = (double)NAN;
        s_in.arm.q_cmd[j] = (double)INFINITY;
        s_in.arm.dir[j] = -1e265;
    }
    step();
    const kc_arm_state_t *a = &APP->input.telemetry.arm;
    TEST_ASSERT_EQUAL_INT(s_in.arm.seq, a->seq);
    TEST_ASSERT_LESS_THAN_UINT32(KC_JOINT_MAX, a->n_joints);
    for (uint32_t j = a->n_joints; j < KC_JOINT_MAX; j++) {
        TEST_ASSERT_EQUAL_DOUBLE(0.0, a->q[j]);
        TEST_ASSERT_EQUAL_DOUBLE(0.0, a->dq[j]);
        TEST_ASSERT_EQUAL_DOUBLE(0.0, a->q_cmd[j]);
        TEST_ASSERT_EQUAL_DOUBLE(0.0, a->dir[j]);
    }
    TEST_ASSERT_EQUAL_DOUBLE(world.q[0], a->q[0]);
}

void test_a_tag_that_is_named_twice_is_refused_wherever_it_stands(void)
{
    kc_detection_t *d = given_frame();
    APP->tables.active.camera.n_tags = 3u;
    APP->tables.active.camera.tag[2] = APP->tables.active.camera.tag[1];
    APP->tables.active.camera.tag[2].id = 2;
    world_seal(KC_TBL_CAMERA);
    d->n_tags = 3u;
    d->tag_id[2] = 0; /* that of the first; the one between is another */
    det_refused(KC_EVT_DET_UNKNOWN_TAG, 2);
    d->tag_id[2] = 2;
    step();
    TEST_ASSERT_EQUAL_UINT32(2u, APP->frames.n);
}

void test_of_detections_no_more_are_read_than_the_queue_holds(void)
{
    kc_detection_t good = *given_frame();
    good.seq -= 1; /* not the one that is waited for */
    s_in.n_det = KC_DET_QUEUE_MAX + 1u;
    for (uint32_t i = 0u; i < KC_DET_QUEUE_MAX; i++) { s_in.det[i] = good; }
    memset(&s_in.has_arm, 0x55, 1u); /* what lies behind */
    s_in.arm = APP->input.telemetry.arm;
    s_in.arm.seq += 1;
    s_in.arm.t_us = world.now_us + TICK_US;
    step();
    TEST_ASSERT_EQUAL_UINT32(1u, s_out.events.n);
    TEST_ASSERT_EQUAL_UINT16(KC_EVT_DET_UNREQUESTED, s_out.events.e[0].id);
}
