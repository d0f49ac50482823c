/* kc_input.c: what is taken of a message, and what is refused with an event and nothing changed. */
#include "kc_input.h"

#include <math.h>
#include <string.h>

#include "given_parts.h"
#include "kc_input_fields.h"
#include "unity.h"

#define SEQ 40
#define LAST_US (PARTS_NOW_US - 100000u) /* of the messages accepted last */
#define ASKED_US (PARTS_NOW_US - 50000u)

static kc_input_t s_input, s_before;
static kc_in_t s_in;
static kc_request_t s_request;
static kc_frames_t s_frames;
static kc_detection_t *const s_det = &s_in.det[0];

/* Good messages for this step: arm and pan-tilt unit, and one frame that is awaited after another one was taken. */
void setUp(void)
{
    given_parts();
    parts.view.telemetry = &s_input.telemetry;
    memset(&s_input, 0, sizeof s_input);
    s_input.telemetry.arm = (kc_arm_state_t){.t_us = LAST_US, .seq = SEQ, .n_joints = 7u};
    s_input.telemetry.pantilt = (kc_pantilt_state_t){.t_us = LAST_US, .seq = SEQ};
    s_input.telemetry.has_arm = s_input.telemetry.has_pantilt = true;
    s_input.telemetry.arm_ok_us = s_input.telemetry.pantilt_ok_us = LAST_US;
    memset(&s_in, 0, sizeof s_in);
    s_in.arm = (kc_arm_state_t){.t_us = PARTS_NOW_US, .seq = SEQ + 1, .n_joints = 7u};
    s_in.pantilt = (kc_pantilt_state_t){.t_us = PARTS_NOW_US, .seq = SEQ + 1};
    *s_det = (kc_detection_t){.t_us = PARTS_NOW_US,
                              .seq = SEQ,
                              .n_tags = 2u,
                              .tag_id = {0, 1},
                              .p_cam_tool_m = {0.0, 0.0, 1.0},
                              .q_cam_tool_wxyz = {1.0},
                              .q_alt_wxyz = {1.0},
                              .rms_alt_px = 100.0,
                              .rms_px = 0.1,
                              .range_m = 1.0};
    for (uint32_t i = 0u; i < 6u; i++) { s_det->cov[7u * i] = 1e-6; }
    s_request = (kc_request_t){.frame = KC_FRAME_AWAITED, .seq = SEQ, .asked_us = ASKED_US};
    kc_frames_clear(&s_frames);
    kc_frames_add(&s_frames, s_det, &s_in.arm, &s_in.pantilt);
}

static void telemetry(uint8_t has_arm, uint8_t has_pantilt)
{
    memset(&parts.out, 0, sizeof parts.out);
    s_in.has_arm = has_arm;
    s_in.has_pantilt = has_pantilt;
    s_before = s_input;
    kc_input_telemetry(&s_input, &parts.view, &s_in, &parts.out);
}

static void refused(uint8_t arm, kc_event_id_t id, int32_t index)
{
    telemetry(arm, !arm);
    TEST_ASSERT_EQUAL_UINT32(1u, parts.out.events.n);
    TEST_ASSERT_EQUAL_UINT16(id, parts.out.events.e[0].id);
    TEST_ASSERT_EQUAL_INT32(index, parts.out.events.e[0].index);
    TEST_ASSERT_EQUAL_MEMORY(&s_before, &s_input, sizeof s_input);
}

/* A field, a value below and one above its range; index: how the event calls it. */
typedef struct {
    double *field, below, above;
    int32_t index;
} spoiled_t;

/* ---- arm ---- */

void test_what_is_good_is_taken_with_its_time(void)
{
    telemetry(1u, 1u);
    TEST_ASSERT_EQUAL_UINT32(0u, parts.out.events.n);
    TEST_ASSERT_EQUAL_MEMORY(&s_in.arm, &s_input.telemetry.arm, sizeof s_in.arm);
    TEST_ASSERT_EQUAL_MEMORY(&s_in.pantilt, &s_input.telemetry.pantilt, sizeof s_in.pantilt);
    TEST_ASSERT_EQUAL_UINT64(PARTS_NOW_US, s_input.telemetry.arm_ok_us);
    TEST_ASSERT_EQUAL_UINT64(PARTS_NOW_US, s_input.telemetry.pantilt_ok_us);
    memset(&s_input, 0, sizeof s_input);
    telemetry(1u, 1u);
    TEST_ASSERT_TRUE(s_input.telemetry.has_arm && s_input.telemetry.has_pantilt);
}

void test_telemetry_out_of_range_or_not_finite_is_refused(void)
{
    kc_joint_t *joint = parts.tables.active.arm.joint;
    const spoiled_t s[] = {
        {&s_in.arm.q[0], joint[0].q_min - 0.51, joint[0].q_max + 0.51, KC_FIELD_ARM_Q},
        {&s_in.arm.q[3], joint[3].q_min - 0.51, joint[3].q_max + 0.51, KC_FIELD_ARM_Q + 3},
        {&s_in.arm.dq[1], -50.1, 50.1, KC_FIELD_ARM_DQ + 1},
        {&s_in.arm.q_cmd[6], -100.1, 100.1, KC_FIELD_ARM_Q_CMD + 6},
        {&s_in.arm.dir[2], -1.1, 1.1, KC_FIELD_ARM_DIR + 2},
        {&s_in.arm.temp_c, -273.2, 500.1, KC_FIELD_ARM_TEMP},
        {&s_in.arm.payload_kg, -0.1, 1000.1, KC_FIELD_ARM_PAYLOAD},
        {&s_in.arm.g_m_s2[1], -30.1, 30.1, KC_FIELD_ARM_G + 1},
        {&s_in.pantilt.pan_rad, -6.29, 6.29, KC_FIELD_PANTILT_PAN},
        {&s_in.pantilt.tilt_rad, -6.29, 6.29, KC_FIELD_PANTILT_TILT},
    };
    for (uint32_t i = 0u; i < sizeof s / sizeof s[0]; i++) {
        const double bad[] = {s[i].below, s[i].above, NAN, -INFINITY};
        const double good = *s[i].field;
        for (uint32_t k = 0u; k < 4u; k++) {
            *s[i].field = bad[k];
            refused(i < 8u, KC_EVT_IN_RANGE, s[i].index);
            if (k < 2u) { TEST_ASSERT_DOUBLE_WITHIN(0.11, bad[k], parts.out.events.e[0].want); }
        }
        *s[i].field = good;
    }
}

void test_readings_at_and_a_little_beyond_the_limits_of_a_joint_are_taken(void)
{
    s_in.arm.q[3] = parts.tables.active.arm.joint[3].q_max + 0.49;
    telemetry(1u, 0u);
    TEST_ASSERT_EQUAL_INT32(SEQ + 1, s_input.telemetry.arm.seq);
}

/* Up to 100 numbers may be lost; beyond, and behind, the stamp decides, until nothing newer has come for 5 s: then the
 * sender's clock was set back. Numbers wrap. */
void test_what_is_newer_is_said_by_the_number_or_else_by_the_stamp(void)
{
    static const struct {
        int32_t ahead, later_us;
        uint64_t silent_us;
        kc_event_id_t event; /* NONE: taken; STALE: refused; JUMP: taken all the same */
    } cases[] = {
        {1, -1, 0u, KC_EVT_NONE},
        {100, 0, 0u, KC_EVT_NONE},
        {101, 0, 0u, KC_EVT_IN_STALE},
        {101, 1, 0u, KC_EVT_IN_JUMP},
        {0, 0, 0u, KC_EVT_IN_STALE},
        {0, 1, 0u, KC_EVT_IN_JUMP},
        {-1, -1, 0u, KC_EVT_IN_STALE},
        {-1, 1, 0u, KC_EVT_IN_JUMP},
        {INT32_MIN, 0, 0u, KC_EVT_IN_STALE},
        {INT32_MAX, 1, 0u, KC_EVT_IN_JUMP},
        {-9, -9, 5000000u, KC_EVT_IN_STALE},
        {-9, -9, 5000001u, KC_EVT_IN_JUMP},
    };
    for (uint32_t i = 0u; i < 2u * sizeof cases / sizeof cases[0]; i++) {
        const uint8_t arm = i % 2u == 0u;
        const uint32_t n = i / 2u;
        setUp();
        s_input.telemetry.arm_ok_us = s_input.telemetry.pantilt_ok_us = PARTS_NOW_US - cases[n].silent_us;
        s_in.arm.seq = s_in.pantilt.seq = (int32_t)((uint32_t)SEQ + (uint32_t)cases[n].ahead);
        s_in.arm.t_us = s_in.pantilt.t_us = (uint64_t)((int64_t)LAST_US + cases[n].later_us);
        telemetry(arm, !arm);
        TEST_ASSERT_EQUAL_UINT32(cases[n].event != KC_EVT_NONE, parts.out.events.n);
        if (cases[n].event != KC_EVT_NONE) {
            expect_event(cases[n].event, arm ? KC_INPUT_ARM : KC_INPUT_PANTILT, (double)s_in.arm.seq, SEQ);
        }
        int32_t now = arm ? s_input.telemetry.arm.seq : s_input.telemetry.pantilt.seq;
        TEST_ASSERT_EQUAL_INT32(cases[n].event == KC_EVT_IN_STALE ? SEQ : s_in.arm.seq, now);
    }
}

/* A stranger's message with the largest number and a stamp as far ahead as is taken: the next genuine one counts. */
void test_a_wild_number_blocks_no_message_after_it(void)
{
    const kc_in_t genuine = s_in;
    s_in.arm.seq = s_in.pantilt.seq = INT32_MAX;
    s_in.arm.t_us = s_in.pantilt.t_us = PARTS_NOW_US + 50000u;
    telemetry(1u, 1u);
    TEST_ASSERT_EQUAL_INT32(INT32_MAX, s_input.telemetry.arm.seq);
    s_in = genuine;
    s_in.arm.t_us = s_in.pantilt.t_us = PARTS_NOW_US + 100000u;
    parts.clock.now_us = parts.clock.clock_us = PARTS_NOW_US + 100000u;
    telemetry(1u, 1u);
    TEST_ASSERT_EQUAL_INT32(SEQ + 1, s_input.telemetry.arm.seq);
    TEST_ASSERT_EQUAL_INT32(SEQ + 1, s_input.telemetry.pantilt.seq);
}

void test_telemetry_of_another_time_is_refused(void)
{
    static const int64_t late_us[] = {-2000001, -2000000, 50000, 50001};
    for (uint32_t i = 0u; i < 8u; i++) {
        const uint8_t arm = i % 2u == 0u;
        const int64_t by = late_us[i / 2u];
        setUp();
        s_in.arm.t_us = s_in.pantilt.t_us = (uint64_t)((int64_t)PARTS_NOW_US + by);
        if (by < -2000000 || by > 50000) {
            refused(arm, KC_EVT_IN_RANGE, arm ? KC_FIELD_ARM_T : KC_FIELD_PANTILT_T);
        } else {
            telemetry(arm, !arm);
            TEST_ASSERT_EQUAL_UINT32(0u, parts.out.events.n);
        }
    }
    memset(&s_input, 0, sizeof s_input);
    parts.clock.clock_us = 100000u; /* an early clock takes what is as old as it can be */
    s_in.arm.t_us = 0u;
    telemetry(1u, 0u);
    TEST_ASSERT_EQUAL_UINT32(0u, parts.out.events.n);
}

void test_arm_state_with_the_wrong_number_of_joints_is_refused(void)
{
    static const uint32_t counts[] = {0u, 6u, 8u, UINT32_MAX};
    for (uint32_t i = 0u; i < 4u; i++) {
        s_in.arm.n_joints = counts[i];
        refused(1u, KC_EVT_IN_COUNT, KC_INPUT_ARM);
        expect_event(KC_EVT_IN_COUNT, KC_INPUT_ARM, (double)counts[i], 7.0);
    }
}

/* Found by fuzzing: nothing checks these entries, and they are published. */
void test_entries_beyond_the_joints_of_the_arm_are_not_taken(void)
{
    kc_arm_state_t want = s_in.arm;
    s_in.arm.q[0] = want.q[0] = 0.5;
    s_in.arm.q[7] = s_in.arm.dq[7] = (double)NAN;
    s_in.arm.q_cmd[7] = (double)INFINITY;
    s_in.arm.dir[7] = -1e265;
    telemetry(1u, 0u);
    TEST_ASSERT_EQUAL_MEMORY(&want, &s_input.telemetry.arm, sizeof want);
}

/* ---- faults of the arm ---- */

static void fault(int32_t mask, int32_t reported, int32_t counts)
{
    s_in.arm.fault_mask = mask;
    s_in.arm.seq++;
    telemetry(1u, 0u);
    if (reported != 0) { expect_event(KC_EVT_ARM_FAULT, -1, (double)reported, 0.0); }
    TEST_ASSERT_EQUAL_UINT32(0u, parts.out.events.n);
    TEST_ASSERT_EQUAL_INT32(counts, s_input.telemetry.arm.fault_mask);
}

void test_an_arm_fault_is_reported_once_and_anew_when_it_comes_again(void)
{
    fault(5, 5, 5);
    fault(5, 0, 5);
    fault(4, 4, 4);
    fault(0, 0, 0);
    fault(4, 4, 4);
}

/* Bits of several bad messages add up, also without an arm table; a good one says what is left. */
void test_faults_of_bad_messages_add_up_until_a_good_one(void)
{
    parts.tables.active.crc[KC_TBL_ARM] = 0u; /* nothing is said of the rest of the message */
    fault(1, 1, 1);
    fault(2, 3, 3);
    fault(0, 0, 3);
    TEST_ASSERT_EQUAL_INT32(SEQ, s_input.telemetry.arm.seq);
    parts.tables.active.crc[KC_TBL_ARM] = PARTS_CRC;
    fault(2, 2, 2);
    TEST_ASSERT_TRUE(s_input.telemetry.arm.seq > SEQ);
}

/* ---- silence ---- */

void test_a_fault_or_silence_ends_a_calibration(void)
{
    static const struct {
        int32_t fault;
        uint32_t arm_us, pantilt_us;
        kc_sensor_t event; /* of the one that is silent */
        kc_cause_t cause;
    } cases[] = {{0, 2000000u, 2000000u, KC_INPUT_ARM, KC_CAUSE_COMMAND},
                 {0, 2000001u, 0u, KC_INPUT_ARM, KC_CAUSE_SILENT},
                 {0, 0u, 2000001u, KC_INPUT_PANTILT, KC_CAUSE_SILENT},
                 {8, 2000001u, 2000001u, KC_INPUT_ARM, KC_CAUSE_ARM_FAULT}};
    for (uint32_t i = 0u; i < 8u; i++) {
        const uint32_t n = i / 2u;
        const kc_cause_t cause = i % 2u == 0u ? KC_CAUSE_COMMAND : cases[n].cause;
        parts.place.state = i % 2u == 0u ? KC_ST_REVIEW : KC_ST_SEARCH; /* none is under way; one is */
        s_input.telemetry.arm.fault_mask = cases[n].fault;
        s_input.telemetry.arm_ok_us = PARTS_NOW_US - cases[n].arm_us;
        s_input.telemetry.pantilt_ok_us = PARTS_NOW_US - cases[n].pantilt_us;
        kc_outcome_t oc = kc_input_silence(&parts.view, &parts.out);
        TEST_ASSERT_EQUAL_INT(cause == KC_CAUSE_COMMAND ? KC_OC_STAY : KC_OC_ABORT, oc.id);
        TEST_ASSERT_EQUAL_INT(cause, oc.cause);
        if (cause == KC_CAUSE_SILENT) {
            expect_event(KC_EVT_IN_SILENT, (int32_t)cases[n].event, 2000001.0, 2000000.0);
        }
        TEST_ASSERT_EQUAL_UINT32(0u, parts.out.events.n);
    }
}

/* ---- detections ---- */

static void detected(void)
{
    memset(&parts.out, 0, sizeof parts.out);
    kc_input_detection(&s_input, &s_request, &s_frames, &parts.view, s_det, &parts.out);
}

static void expect_frame(kc_frame_t frame, uint32_t n_rejected)
{
    TEST_ASSERT_EQUAL_INT(frame, s_request.frame);
    TEST_ASSERT_EQUAL_UINT32(n_rejected, s_input.n_rejected);
}

/* Refused as if it had never come: the frame is still awaited. Then all is good again. */
static void det_refused(kc_event_id_t id, int32_t index)
{
    detected();
    TEST_ASSERT_EQUAL_UINT32(1u, parts.out.events.n);
    TEST_ASSERT_EQUAL_UINT16(id, parts.out.events.e[0].id);
    TEST_ASSERT_EQUAL_INT32(index, parts.out.events.e[0].index);
    expect_frame(KC_FRAME_AWAITED, 0u);
    setUp();
}

/* Well formed but not good enough: the frame is used up. */
static void det_spent(kc_event_id_t id, int32_t index, double got, double want)
{
    detected();
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, got, parts.out.events.e[0].got);
    expect_event(id, index, parts.out.events.e[0].got, want);
    expect_frame(KC_FRAME_UNCERTAIN, 1u);
    setUp();
}

void test_a_good_frame_is_taken_and_the_same_again_is_not(void)
{
    detected();
    TEST_ASSERT_EQUAL_UINT32(0u, parts.out.events.n);
    expect_frame(KC_FRAME_DETECTED, 0u);
    TEST_ASSERT_EQUAL_MEMORY(s_det, &s_request.det, sizeof *s_det);
    detected();
    expect_event(KC_EVT_DET_UNREQUESTED, -1, SEQ, 0.0);
}

void test_a_frame_without_tags_is_taken_and_said(void)
{
    s_det->n_tags = 0u;
    detected();
    expect_event(KC_EVT_DET_NONE, -1, SEQ, 0.0);
    expect_frame(KC_FRAME_NO_TAGS, 0u);
}

void test_a_frame_with_another_number_is_refused(void)
{
    for (int32_t by = -1; by < 2; by += 2) {
        s_det->seq = SEQ + by;
        detected();
        expect_event(KC_EVT_DET_UNREQUESTED, -1, SEQ + by, SEQ);
        expect_frame(KC_FRAME_AWAITED, 0u);
    }
}

/* Not before its request by more than clocks differ, and not older than CONFIG allows. */
void test_a_frame_of_another_time_is_refused(void)
{
    static const uint64_t asked_us[] = {50000u, 5000000u}, oldest_us[] = {100000u, 1000000u};
    for (uint32_t i = 0u; i < 2u; i++) {
        setUp();
        s_request.asked_us = PARTS_NOW_US - asked_us[i];
        s_det->t_us = PARTS_NOW_US - oldest_us[i] - 1u;
        detected();
        expect_event(KC_EVT_DET_OLD, -1, (double)oldest_us[i] + 1.0, (double)oldest_us[i]);
        s_det->t_us++;
        detected();
        expect_frame(KC_FRAME_DETECTED, 0u);
    }
    setUp();
    s_det->t_us = PARTS_NOW_US + 50001u;
    det_refused(KC_EVT_IN_RANGE, KC_FIELD_DET_T);
    s_det->t_us = PARTS_NOW_US + 50000u;
    detected();
    expect_frame(KC_FRAME_DETECTED, 0u);
}

void test_a_frame_with_an_unknown_tag_or_one_named_twice_is_refused(void)
{
    static const struct {
        uint32_t n;
        int32_t id[3], wrong;
    } cases[] = {{2u, {0, 17, 2}, 1}, {2u, {0, 0, 2}, 1}, {3u, {0, 1, 0}, 2}, {3u, {1, 0, 0}, 2}};
    for (uint32_t i = 0u; i < 4u; i++) {
        parts.tables.active.camera.n_tags = 3u;
        parts.tables.active.camera.tag[2].id = 2;
        s_det->n_tags = cases[i].n;
        memcpy(s_det->tag_id, cases[i].id, sizeof cases[i].id);
        detected();
        expect_event(KC_EVT_DET_UNKNOWN_TAG, cases[i].wrong, (double)cases[i].id[cases[i].wrong], 0.0);
        expect_frame(KC_FRAME_AWAITED, 0u);
    }
    s_det->n_tags = KC_TAG_MAX + 1u;
    det_refused(KC_EVT_IN_RANGE, KC_FIELD_DET_N_TAGS);
}

void test_a_frame_whose_quaternion_is_not_unit_is_refused(void)
{
    static const double w[] = {1.0 + 1.1e-6, 1.0 - 1.1e-6, NAN};
    for (uint32_t i = 0u; i < 6u; i++) {
        *(i % 2u == 0u ? s_det->q_cam_tool_wxyz : s_det->q_alt_wxyz) = w[i / 2u];
        det_refused(KC_EVT_IN_NOT_UNIT, KC_INPUT_DETECTION);
    }
    for (uint32_t k = 0u; k < 4u; k++) { /* each entry is looked at */
        s_det->q_cam_tool_wxyz[0] = 0.0;
        s_det->q_cam_tool_wxyz[k] = -1.0;
        s_det->q_alt_wxyz[0] = 0.6;
        s_det->q_alt_wxyz[k] = k == 0u ? 1.0 : -0.8;
        detected();
        TEST_ASSERT_TRUE(s_request.frame != KC_FRAME_AWAITED);
        setUp();
    }
}

void test_a_frame_with_a_value_out_of_range_is_refused(void)
{
    const spoiled_t s[] = {
        {&s_det->p_cam_tool_m[1], -10.1, 10.1, KC_FIELD_DET_P + 1},
        {&s_det->p_alt_m[2], -10.1, 10.1, KC_FIELD_DET_P_ALT + 2},
        {&s_det->rms_px, -0.1, 100000.1, KC_FIELD_DET_RMS},
        {&s_det->rms_alt_px, -0.1, 100000.1, KC_FIELD_DET_RMS_ALT},
        {&s_det->range_m, -0.1, 10.1, KC_FIELD_DET_RANGE},
        {&s_det->incid_rad, -0.1, 3.15, KC_FIELD_DET_INCID},
        {&s_det->u_px, -100000.1, 100000.1, KC_FIELD_DET_U},
        {&s_det->v_px, -100000.1, 100000.1, KC_FIELD_DET_V},
        {&s_det->corner_px[31], -100000.1, 100000.1, KC_FIELD_DET_CORNER + 31},
        {&s_det->cov[35], -1000.1, 1000.1, KC_FIELD_DET_COV + 35},
        {&s_det->cov[0], 0.0, 0.0, KC_FIELD_DET_COV_SHAPE}, /* not positive definite */
    };
    for (uint32_t i = 0u; i < sizeof s / sizeof s[0]; i++) {
        const double bad[] = {s[i].below, s[i].above, NAN};
        for (uint32_t k = 0u; k < (s[i].index == KC_FIELD_DET_COV_SHAPE ? 1u : 3u); k++) {
            *s[i].field = bad[k];
            det_refused(KC_EVT_IN_RANGE, s[i].index);
        }
        if (s[i].index >= KC_FIELD_DET_COV) { continue; }
        *s[i].field = s[i].below + 0.1; /* the limit */
        detected();
        TEST_ASSERT_TRUE(s_request.frame != KC_FRAME_AWAITED);
        setUp();
    }
}

void test_a_detection_that_is_too_uncertain_or_jumps_uses_up_its_frame(void)
{
    for (uint32_t i = 0u; i < 6u; i++) {
        s_det->cov[7u * i] = 0.2 * 0.2;
        det_spent(KC_EVT_DET_UNCERTAIN, i < 3u ? 0 : 1, 0.2, i < 3u ? 0.02 : 0.1);
    }
    s_det->rms_px = 3.1;
    det_spent(KC_EVT_DET_UNCERTAIN, 2, 3.1, 3.0);
    s_det->p_cam_tool_m[0] += 0.03;
    det_spent(KC_EVT_DET_JUMP, 0, 0.03, 0.02);
    s_det->q_cam_tool_wxyz[0] = cos(0.1);
    s_det->q_cam_tool_wxyz[1] = sin(0.1);
    det_spent(KC_EVT_DET_JUMP, 1, 0.2, 0.1);
}

/* ---- detections outside calibrations ---- */

void test_outside_calibrations_a_detection_is_of_use_if_it_is_new_recent_and_good(void)
{
    static const struct {
        int64_t age_us, newest_ago_us;
        uint32_t n_tags;
        double rms_px;
        kc_event_id_t event; /* NONE: it is of use */
    } cases[] = {
        {1000000, 1000001, 2u, 0.1, KC_EVT_NONE},
        {1000001, 2000000, 2u, 0.1, KC_EVT_DET_OLD},
        {-50001, 2000000, 2u, 0.1, KC_EVT_IN_RANGE},
        {0, 0, 2u, 0.1, KC_EVT_IN_STALE},
        {0, 1, 0u, 0.1, KC_EVT_DET_NONE},
        {0, 1, 2u, 3.1, KC_EVT_DET_UNCERTAIN},
        {0, 1, 9u, 0.1, KC_EVT_IN_RANGE},
    };
    for (uint32_t i = 0u; i < sizeof cases / sizeof cases[0]; i++) {
        memset(&parts.out, 0, sizeof parts.out);
        s_det->t_us = (uint64_t)((int64_t)PARTS_NOW_US - cases[i].age_us);
        s_det->n_tags = cases[i].n_tags;
        s_det->rms_px = cases[i].rms_px;
        bool of_use = kc_input_observation(
            &parts.view, (uint64_t)((int64_t)PARTS_NOW_US - cases[i].newest_ago_us), s_det, &parts.out);
        TEST_ASSERT_EQUAL_INT(cases[i].event == KC_EVT_NONE, of_use);
        TEST_ASSERT_EQUAL_UINT16(cases[i].event, parts.out.events.e[0].id);
    }
}
