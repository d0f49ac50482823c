/* kc_sequence.c: from state to state by what the parts hold; the parts are set by hand. Whole calibrations:
 * test_app.c. */
#include "kc_sequence.h"

#include <string.h>

#include "given_tables.h"
#include "kc_app_parts.h"
#include "unity.h"

#define APP (&kc_app_instance)
#define NOW_US 9000000u
#define SINCE_US 5000000u
#define POSES 4u

static kc_out_t s_out;
static kc_work_t s_work;
static kc_in_t s_in;

static void in_state(kc_state_t state)
{
    APP->place = (kc_place_t){state, SINCE_US};
    s_work = kc_work_of_step();
    memset(&s_out, 0, sizeof s_out);
}

/* An arm and a pan-tilt unit that were heard just now, in a calibration that has measured POSES poses. */
void setUp(void)
{
    kc_active_t *a = &APP->tables.active;
    kc_app_init(APP);
    memset(&s_in, 0, sizeof s_in);
    given_arm(&a->arm);
    given_camera(&a->camera);
    given_terms(&a->terms);
    given_config(&a->config);
    given_space(&a->space, 9u, 1u);
    APP->clock.now_us = APP->cal.start_us = APP->cal.energy_us = NOW_US;
    APP->input.telemetry.arm_ok_us = APP->input.telemetry.pantilt_ok_us = NOW_US;
    APP->plan.n_meas = POSES;
    APP->request.frame = KC_FRAME_AWAITED;
    APP->frames.n = 2u;
}

static void run_in(kc_state_t state)
{
    in_state(state);
    kc_sequence_run(APP, &s_work, &s_out);
}

static void aborted(int32_t pose, kc_cause_t cause)
{
    int at = event_at(&s_out.events, KC_EVT_CAL_ABORTED);
    TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
    TEST_ASSERT_TRUE(at >= 0);
    TEST_ASSERT_EQUAL_INT32(pose, s_out.events.e[at].index);
    TEST_ASSERT_EQUAL_DOUBLE((double)cause, s_out.events.e[at].got);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_out.events.e[at].want);
    TEST_ASSERT_TRUE(s_out.has_arm_cmd && s_out.arm_cmd.hold);
    TEST_ASSERT_EQUAL_INT(KC_FRAME_NONE, APP->request.frame);
}

/* ---- the record ---- */

void test_a_record_says_what_the_parts_hold(void)
{
    in_state(KC_ST_REVIEW);
    APP->cal.session = 3u;
    APP->cal.candidate = 5;
    APP->boot_count = 7u;
    APP->tables.active.crc[KC_TBL_KIN] = 11u;
    APP->tables.active.kin_prev_crc = 12u;
    APP->review.crc = 13u;
    APP->review.verdict = KC_VERDICT_POOR;
    APP->move.seg_from = 1u;
    APP->move.seg_to = 69u;
    APP->clock.clock_us = 77u;
    APP->cmd_log.counters.key[1].key_id = 2u;
    const kc_journal_t r = kc_sequence_record(APP);
    const uint32_t got[] = {r.state,        r.session,          r.pose,
                            r.boot_count,   r.kin_crc,          r.prev_crc,
                            r.proposal_crc, r.proposal_verdict, (uint32_t)r.candidate,
                            r.seg_from,     r.seg_to,           r.counters.key[1].key_id};
    const uint32_t want[] = {KC_ST_REVIEW, 3u, POSES, 7u, 11u, 12u, 13u, KC_VERDICT_POOR, 5u, 1u, 69u, 2u};
    TEST_ASSERT_EQUAL_UINT32_ARRAY(want, got, sizeof want / sizeof want[0]);
    TEST_ASSERT_EQUAL_UINT64(77u, r.t_us);
}

/* It is still in the store, and comes back from there. */
void test_what_was_lost_in_memory_is_recorded_as_before(void)
{
    APP->journal.last.kin_crc = 21u;
    APP->journal.last.prev_crc = 22u;
    for (uint32_t lost = 0u; lost < 4u; lost++) {
        uint32_t kin = lost & 1u, prev = lost >> 1u;
        APP->scrub.lost = kin << KC_TBL_KIN | prev;
        kc_journal_t r = kc_sequence_record(APP);
        TEST_ASSERT_EQUAL_UINT32(kin ? 21u : 0u, r.kin_crc);
        TEST_ASSERT_EQUAL_UINT32(prev ? 22u : 0u, r.prev_crc);
    }
    APP->tables.active.crc[KC_TBL_KIN] = 11u; /* replaced since */
    APP->tables.active.kin_prev_crc = 12u;
    kc_journal_t r = kc_sequence_record(APP);
    TEST_ASSERT_EQUAL_UINT32(11u, r.kin_crc);
    TEST_ASSERT_EQUAL_UINT32(12u, r.prev_crc);
}

/* ---- from state to state ---- */

void test_states_that_wait_for_commands_do_nothing(void)
{
    static const kc_state_t waits[] = {KC_ST_IDLE, KC_ST_REVIEW, KC_ST_ARMED, KC_ST_SAFE};
    static kc_out_t none;
    APP->input.telemetry.arm_ok_us = 0u; /* nobody has to be heard */
    for (uint32_t i = 0u; i < 4u; i++) {
        run_in(waits[i]);
        TEST_ASSERT_EQUAL_INT(waits[i], kc_app_state(APP));
        TEST_ASSERT_EQUAL_UINT64(SINCE_US, APP->place.since_us);
        TEST_ASSERT_EQUAL_MEMORY(&none, &s_out, sizeof none);
        TEST_ASSERT_EQUAL_UINT64(0u, s_work.used);
    }
}

void test_an_outcome_leads_to_the_state_of_the_table_at_this_time(void)
{
    APP->tables.active.config.approval_timeout_us = NOW_US - SINCE_US - 1u;
    run_in(KC_ST_ARMED);
    TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT64(NOW_US, APP->place.since_us);
}

/* The unit is where it was sent, and nothing has to settle. */
void test_states_that_take_no_time_follow_in_one_step(void)
{
    APP->tables.active.config.settle_us = 0u;
    APP->request.fails = 2u;
    APP->request.seq = 30;
    run_in(KC_ST_AIM);
    TEST_ASSERT_EQUAL_INT(KC_ST_OBSERVE, kc_app_state(APP));
    TEST_ASSERT_TRUE(s_out.has_frame_request);
    TEST_ASSERT_EQUAL_INT32(31, s_out.frame_request.seq);
    TEST_ASSERT_EQUAL_UINT32(0u, APP->request.fails);
}

/* The arm stands where it was sent, at zero; the pan-tilt unit has to turn to the tool. */
void test_the_unit_is_aimed_where_the_arm_arrives_at_a_stop_or_not(void)
{
    for (uint32_t stop = 0u; stop < 2u; stop++) {
        setUp();
        APP->move.i_path = APP->move.n_path = 1u;
        APP->move.to_stop = stop != 0u;
        run_in(KC_ST_MOVE);
        TEST_ASSERT_EQUAL_INT(KC_ST_AIM, kc_app_state(APP));
        TEST_ASSERT_TRUE(s_out.has_pantilt_cmd);
        TEST_ASSERT_TRUE((stop != 0u) == APP->observe.at_stop);
    }
}

void test_an_arm_that_sees_nothing_at_a_stop_goes_on_to_its_candidate(void)
{
    APP->cal.candidate = 2;
    kc_path_joints(&APP->tables.active.space, KC_HUB_MAX + 2u, APP->input.telemetry.arm.q);
    memcpy(APP->move.q_final, APP->input.telemetry.arm.q, sizeof APP->move.q_final);
    APP->observe.at_stop = true;
    APP->request.frame = KC_FRAME_NO_TAGS;
    run_in(KC_ST_OBSERVE);
    TEST_ASSERT_EQUAL_INT(KC_ST_MOVE, kc_app_state(APP));
    TEST_ASSERT_TRUE(s_out.has_arm_cmd);
    TEST_ASSERT_EQUAL_DOUBLE_ARRAY(APP->move.q_final, s_out.arm_cmd.q, 7u);
    TEST_ASSERT_FALSE(APP->observe.at_stop);
}

void test_who_settles_again_begins_its_time_again(void)
{
    APP->rest = (kc_rest_t){true, 0u}; /* of the candidate before */
    run_in(KC_ST_AIM);
    TEST_ASSERT_EQUAL_INT(KC_ST_SETTLE, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT64(NOW_US, APP->rest.since_us);
}

void test_silence_or_a_fault_of_the_arm_ends_a_calibration_and_holds_it(void)
{
    APP->input.telemetry.pantilt_ok_us = NOW_US - KC_SILENT_US - 1u;
    run_in(KC_ST_MOVE);
    aborted((int32_t)POSES, KC_CAUSE_SILENT);
    TEST_ASSERT_EQUAL_UINT32(2u, APP->frames.n); /* only MEASURE has any */
    setUp();
    APP->input.telemetry.arm.fault_mask = 4;
    run_in(KC_ST_MEASURE);
    aborted((int32_t)POSES, KC_CAUSE_ARM_FAULT);
    TEST_ASSERT_EQUAL_UINT32(0u, APP->frames.n);
}

/* A pose is measured where an extra observation was made just before: it takes its place, and nothing is left of it. */
void test_an_extra_observation_at_the_place_of_a_pose_is_dropped_when_observing_ends(void)
{
    for (uint32_t same = 0u; same < 2u; same++) {
        setUp();
        APP->observe.same_place = same != 0u;
        APP->plan.n_obs = APP->est.n_obs = 6u;
        APP->input.telemetry.arm.fault_mask = 4;
        run_in(KC_ST_OBSERVE);
        TEST_ASSERT_EQUAL_UINT32(6u - same, APP->est.n_obs);
        TEST_ASSERT_EQUAL_UINT32(6u - same, APP->plan.n_obs);
        TEST_ASSERT_FALSE(APP->observe.same_place);
    }
}

void test_a_budget_that_is_used_up_ends_what_the_arm_does(void)
{
    APP->tables.active.config.budget_us = 1u;
    APP->est.terms = &APP->tables.active.terms;
    for (uint32_t selects = 0u; selects < 2u; selects++) { /* while SELECT works the arm does nothing */
        APP->cal.start_us = NOW_US - 2u;
        APP->request.frame = KC_FRAME_AWAITED;
        in_state(selects ? KC_ST_SELECT : KC_ST_MOVE);
        s_work.used = s_work.most;
        kc_sequence_run(APP, &s_work, &s_out);
        TEST_ASSERT_EQUAL_INT(KC_ST_PROPOSE, kc_app_state(APP));
        TEST_ASSERT_EQUAL_UINT8(!selects, s_out.has_arm_cmd);
        TEST_ASSERT_EQUAL_INT(selects ? KC_FRAME_AWAITED : KC_FRAME_NONE, APP->request.frame);
    }
    APP->plan.n_local = POSES; /* nothing that a proposal could use */
    APP->plan.n_min = 1u;
    run_in(KC_ST_MOVE);
    aborted((int32_t)POSES, KC_CAUSE_BUDGET);
}

void test_changed_memory_ends_it(void)
{
    APP->tables.active.crc[KC_TBL_ARM] = 5u;
    APP->tables.active.seal[KC_TBL_ARM] = 1u; /* of another arm */
    in_state(KC_ST_REVIEW);
    for (uint32_t i = 0u; i < 1000u && s_out.events.n == 0u; i++) { kc_sequence_scrub(APP, &s_work, &s_out); }
    aborted(-1, KC_CAUSE_MEMORY);
    TEST_ASSERT_EQUAL_UINT32(0u, APP->tables.active.crc[KC_TBL_ARM]);
}

/* ---- charges ---- */

void test_the_answer_of_the_store_is_charged_where_a_change_waits_for_it(void)
{
    APP->tables.staging.total = 5000u;
    for (uint32_t has = 0u; has < 2u; has++) {
        s_in.has_store_result = (uint8_t)has;
        in_state(KC_ST_STORE);
        kc_sequence_stored(APP, &s_work, &s_in, &s_out);
        TEST_ASSERT_EQUAL_UINT64(has * kc_tbl_cost(&APP->tables), s_work.used);
        in_state(KC_ST_IDLE);
        kc_sequence_stored(APP, &s_work, &s_in, &s_out);
        TEST_ASSERT_EQUAL_UINT64(0u, s_work.used);
    }
}

void test_what_is_put_back_is_charged(void)
{
    static const kc_change_kind_t kinds[] = {KC_CHANGE_TABLE, KC_CHANGE_PUT_BACK};
    for (uint32_t i = 0u; i < 2u; i++) {
        APP->change.kind = kinds[i];
        APP->change.due_us = NOW_US + 1u; /* not yet */
        run_in(KC_ST_STORE);
        TEST_ASSERT_EQUAL_INT(KC_ST_STORE, kc_app_state(APP));
        TEST_ASSERT_EQUAL_UINT64(i * KC_CHANGE_BACK_COST, s_work.used);
    }
    uint64_t used[2];
    for (uint32_t i = 0u; i < 2u; i++) { /* by an abort at once */
        setUp();
        in_state(KC_ST_STORE);
        APP->change.kind = kinds[i];
        s_in.n_cmd = 1u;
        s_in.cmd[0] = (kc_cmd_t){.source = 1, .seq = 1, .opcode = KC_CMD_ABORT};
        kc_sequence_commands(APP, &s_work, &s_in, &s_out);
        used[i] = s_work.used;
    }
    TEST_ASSERT_EQUAL_UINT64(KC_CHANGE_BACK_COST, used[1] - used[0]);
}

/* ---- inputs ---- */

void test_an_abort_ends_a_review_and_drops_what_waits(void)
{
    in_state(KC_ST_REVIEW);
    APP->review.crc = 13u;
    s_in.n_cmd = 1u;
    s_in.cmd[0] = (kc_cmd_t){.source = 1, .seq = 1, .opcode = KC_CMD_ABORT};
    kc_sequence_commands(APP, &s_work, &s_in, &s_out);
    aborted(-1, KC_CAUSE_COMMAND);
    TEST_ASSERT_EQUAL_UINT32(0u, APP->review.crc);
}

void test_detections_go_to_the_calibration_or_to_the_monitor(void)
{
    s_in.n_det = 1u;
    s_in.det[0] = (kc_detection_t){.seq = 30, .q_cam_tool_wxyz = {1.0}, .q_alt_wxyz = {1.0}};
    for (uint32_t kind = 1u; kind < KC_TBL_COUNT; kind++) { APP->tables.active.crc[kind] = kind; }
    for (uint32_t idle = 0u; idle < 2u; idle++) {
        APP->request.frame = KC_FRAME_AWAITED;
        APP->request.seq = 30;
        APP->request.asked_us = NOW_US;
        in_state(idle ? KC_ST_IDLE : KC_ST_OBSERVE);
        kc_sequence_detections(APP, &s_work, &s_in, &s_out);
        TEST_ASSERT_EQUAL_INT(idle ? KC_FRAME_AWAITED : KC_FRAME_NO_TAGS, APP->request.frame);
    }
}
