/* kc_dispatch.c: who may send each command, in which states it is taken, what it does and how it is answered. */
#include "kc_dispatch.h"

#include <string.h>

#include "given_parts.h"
#include "given_tables.h"
#include "kc_signed.h"
#include "unity.h"

#define APP (&kc_app_instance)
#define OPCODE_COUNT ((int32_t)KC_CMD_TABLE_DUMP + 1)
#define SEED 77

static const kc_keys_t s_keys = {.n = 1u, .key = {{.id = 1u, .secret = {5u}}}};
static kc_cmd_t s_cmd;
static kc_out_t s_out;
static kc_work_t s_work;
static bool s_signed, s_aborted;

void setUp(void)
{
    given_app();
    kc_app_keys(APP, &s_keys);
    kc_counters_begin(&APP->cmd_log.counters, &s_keys);
    kc_counters_clock(&APP->cmd_log.counters, PARTS_NOW_US);
    s_work = kc_work_of_step();
    s_signed = true;
    s_aborted = false;
}

static kc_outcome_t sent(int32_t opcode, int32_t a0, int32_t a1, int32_t a2, int32_t a3)
{
    static uint64_t counter = 0u;
    s_cmd = (kc_cmd_t){.t_us = PARTS_NOW_US, .seq = 9, .source = KC_SRC_GROUND, .opcode = opcode};
    const int32_t arg[] = {a0, a1, a2, a3};
    memcpy(s_cmd.arg_i, arg, sizeof arg);
    if (s_signed) { given_signature(&s_cmd, s_keys.key, ++counter); }
    memset(&s_out, 0, sizeof s_out);
    return kc_dispatch(APP, &s_cmd, s_aborted, &s_work, &s_out);
}

/* The event that says why a command is refused in a state, NONE if it is not. */
static int32_t refused_for(int32_t opcode, kc_state_t state)
{
    APP->place.state = state;
    (void)sent(opcode, 0, 0, 0, 0);
    return s_out.n_ack == 1u ? s_out.ack[0].event_id : (int32_t)KC_EVT_NONE;
}

/* ---- who, and when ---- */

/* As docs/STATES.md has it. */
static bool taken(int32_t opcode, kc_state_t state)
{
    switch (opcode) {
    case KC_CMD_NOOP:
    case KC_CMD_ABORT:
    case KC_CMD_TABLE_DUMP: return true;
    case KC_CMD_APPROVE_ARM: return state == KC_ST_REVIEW;
    case KC_CMD_APPROVE_GO: return state == KC_ST_ARMED;
    case KC_CMD_REJECT: return state == KC_ST_REVIEW || state == KC_ST_ARMED;
    default: return state == KC_ST_IDLE || state == KC_ST_SAFE;
    }
}

static bool of_table(int32_t opcode)
{
    return opcode >= KC_CMD_TABLE_VALIDATE && opcode <= KC_CMD_TABLE_DISCARD;
}

void test_each_command_is_taken_in_its_states_and_in_no_other(void)
{
    for (int32_t opcode = 0; opcode < OPCODE_COUNT; opcode++) {
        int32_t otherwise = of_table(opcode) ? KC_EVT_TBL_BUSY : KC_EVT_CMD_STATE;
        for (uint32_t state = 0u; state < KC_ST_COUNT; state++) {
            setUp();
            int32_t why = refused_for(opcode, (kc_state_t)state);
            if (taken(opcode, (kc_state_t)state)) {
                TEST_ASSERT_TRUE(why != otherwise);
            } else {
                TEST_ASSERT_EQUAL_INT(otherwise, why);
                TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, s_out.ack[0].status);
            }
        }
    }
}

void test_all_but_noop_and_abort_have_to_be_signed(void)
{
    s_signed = false;
    for (int32_t opcode = 0; opcode <= OPCODE_COUNT; opcode++) { /* the last one does not exist */
        bool open = opcode == KC_CMD_NOOP || opcode == KC_CMD_ABORT;
        TEST_ASSERT_EQUAL_INT(open ? KC_EVT_NONE : KC_EVT_CMD_UNSIGNED, refused_for(opcode, KC_ST_IDLE));
    }
    TEST_ASSERT_EQUAL_UINT64(0u, s_work.used);
    s_signed = true;
    (void)sent(KC_CMD_NOOP, 0, 0, 0, 0);
    TEST_ASSERT_EQUAL_UINT64(kc_auth_cost(KC_SIGNED_HEAD_MAX), s_work.used);
}

void test_a_signed_command_that_does_not_exist_is_refused_and_answered(void)
{
    const int32_t opcodes[] = {-1, OPCODE_COUNT, INT32_MAX, INT32_MIN};
    for (uint32_t i = 0u; i < 4u; i++) {
        TEST_ASSERT_EQUAL_INT(KC_EVT_CMD_UNKNOWN, refused_for(opcodes[i], KC_ST_IDLE));
        TEST_ASSERT_EQUAL_INT(opcodes[i], s_out.ack[0].opcode);
        TEST_ASSERT_EQUAL_INT(KC_ERR_ARG, s_out.ack[0].status);
    }
}

void test_only_commands_of_tables_need_time_for_a_whole_table_whatever_the_state(void)
{
    for (int32_t opcode = 0; opcode < OPCODE_COUNT; opcode++) {
        s_work = (kc_work_t){1u, 1u}; /* used up */
        TEST_ASSERT_TRUE(of_table(opcode) == (refused_for(opcode, KC_ST_MOVE) == KC_EVT_CMD_WORK));
    }
}

void test_what_moves_the_arm_or_changes_what_is_in_force_gives_way_to_an_abort(void)
{
    s_aborted = true;
    for (int32_t opcode = 0; opcode < OPCODE_COUNT; opcode++) {
        bool gives_way = opcode == KC_CMD_START || opcode == KC_CMD_APPROVE_ARM ||
                         opcode == KC_CMD_APPROVE_GO || opcode == KC_CMD_ROLLBACK ||
                         opcode == KC_CMD_TABLE_ACTIVATE;
        TEST_ASSERT_TRUE(gives_way == (refused_for(opcode, KC_ST_IDLE) == KC_EVT_CMD_ABORTED));
        int at = event_at(&s_out.events, KC_EVT_CMD_ABORTED);
        if (at >= 0) { TEST_ASSERT_EQUAL_DOUBLE(0.0, s_out.events.e[at].got); }
    }
}

/* ---- what it does ---- */

void test_an_abort_is_answered_at_once_and_counted(void)
{
    TEST_ASSERT_EQUAL_INT(KC_OC_ABORT, sent(KC_CMD_ABORT, 0, 0, 0, 0).id);
    const kc_ack_t want = {KC_SRC_GROUND, 9, KC_CMD_ABORT, KC_OK, KC_EVT_NONE};
    TEST_ASSERT_EQUAL_UINT32(1u, s_out.n_ack);
    TEST_ASSERT_EQUAL_MEMORY(&want, &s_out.ack[0], sizeof want);
    TEST_ASSERT_EQUAL_UINT32(1u, APP->cmd_log.n_ok);
}

static void given_staged(kc_stage_t state)
{
    APP->tables.staging.state = state;
    APP->tables.staging.kind = KC_TBL_CONFIG;
    APP->tables.staging.n = 20u;
}

void test_a_discarded_table_is_gone(void)
{
    given_staged(KC_STAGE_COMPLETE);
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, sent(KC_CMD_TABLE_DISCARD, 0, 0, 0, 0).id);
    TEST_ASSERT_EQUAL_INT(KC_OK, s_out.ack[0].status);
    TEST_ASSERT_EQUAL_INT(KC_STAGE_NONE, APP->tables.staging.state);
}

/* A correction waits, one is in force and one is kept: each command names the right one. */
void test_what_has_to_be_stored_is_answered_only_when_it_is_stored(void)
{
    static const struct {
        kc_opcode_t opcode;
        kc_state_t state;
        kc_change_kind_t change;
    } cases[] = {{KC_CMD_APPROVE_GO, KC_ST_ARMED, KC_CHANGE_APPROVE},
                 {KC_CMD_REJECT, KC_ST_REVIEW, KC_CHANGE_REJECT},
                 {KC_CMD_ROLLBACK, KC_ST_SAFE, KC_CHANGE_ROLLBACK}};
    kc_kin_t kin = APP->tables.active.kin;
    kin.arm_crc = PARTS_CRC + KC_TBL_ARM;
    kin.terms_crc = PARTS_CRC + KC_TBL_TERMS;
    uint32_t crc = kc_review_encode(&APP->review, &kin, KC_VERDICT_CHANGE);
    APP->review.crc = crc;
    APP->tables.active.kin_prev_crc = 3u;
    for (uint32_t i = 0u; i < 3u; i++) {
        APP->place.state = cases[i].state;
        uint32_t named = i < 2u ? crc : PARTS_CRC + KC_TBL_KIN;
        TEST_ASSERT_EQUAL_INT(KC_OC_STORE, sent((int32_t)cases[i].opcode, (int32_t)named, 0, 0, 0).id);
        TEST_ASSERT_EQUAL_UINT32(0u, s_out.n_ack);
        TEST_ASSERT_EQUAL_INT(cases[i].change, APP->change.kind);
        TEST_ASSERT_EQUAL_INT(i == 2u, APP->change.safe);
        TEST_ASSERT_TRUE(APP->change.by_command);
        TEST_ASSERT_EQUAL_MEMORY(&s_cmd, &APP->change.cmd, sizeof s_cmd);
    }
    APP->place.state = KC_ST_REVIEW;
    TEST_ASSERT_EQUAL_INT(KC_OC_ARM, sent(KC_CMD_APPROVE_ARM, (int32_t)crc, 0, 0, 0).id);
    TEST_ASSERT_EQUAL_INT(KC_OK, s_out.ack[0].status);
}

/* ---- START ---- */

static kc_outcome_t started(bool from_suspects)
{
    return sent(KC_CMD_START, KC_ACQ_DOPT, 5, SEED, from_suspects);
}

void test_start_begins_everything_of_a_calibration_anew(void)
{
    given_staged(KC_STAGE_VALID);
    APP->observe.servo_steps = 3u;
    APP->latest.n_checked = APP->est.n_obs = 3u;
    TEST_ASSERT_EQUAL_INT(KC_OC_START, started(false).id);
    TEST_ASSERT_EQUAL_INT(KC_OK, s_out.ack[0].status);
    TEST_ASSERT_EQUAL_INT(KC_STAGE_NONE, APP->tables.staging.state);
    TEST_ASSERT_EQUAL_UINT64(SEED, APP->rng);
    TEST_ASSERT_EQUAL_UINT32(5u, APP->plan.n_goal);
    TEST_ASSERT_EQUAL_UINT32(1u, APP->cal.session);
    TEST_ASSERT_EQUAL_UINT64(APP->tables.active.config.est.free_mask, APP->est.opt.free_mask);
    TEST_ASSERT_EQUAL_UINT32(0u, APP->observe.servo_steps + APP->latest.n_checked + APP->est.n_obs);
    TEST_ASSERT_EQUAL_UINT8(0u, APP->est.by_prior);
    TEST_ASSERT_EQUAL_UINT64(kc_auth_cost(KC_SIGNED_HEAD_MAX) + kc_update_start_cost(&APP->view),
                             s_work.used);
}

static void expect_not_started(kc_event_id_t why, kc_status_t status, double got, double want)
{
    given_staged(KC_STAGE_VALID);
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, started(why == KC_EVT_CAL_NO_SUSPECTS).id);
    TEST_ASSERT_EQUAL_INT(status, s_out.ack[0].status);
    parts.out = s_out;
    expect_event(why, -1, got, want);
    TEST_ASSERT_EQUAL_INT(KC_STAGE_VALID, APP->tables.staging.state);
    TEST_ASSERT_EQUAL_UINT32(0u, APP->cal.session);
}

void test_start_is_refused_where_no_verified_path_begins(void)
{
    double dist = 0.0;
    for (uint32_t j = 0u; j < 7u; j++) { APP->input.telemetry.arm.q[j] = j % 2u == 0u ? 2.5 : -1.5; }
    TEST_ASSERT_EQUAL_UINT32(KC_NODE_NONE, kc_move_node(&APP->move, &APP->view, &dist));
    expect_not_started(KC_EVT_CAL_NO_PATH, KC_ERR_PATH, dist, 1.0);
}

/* The monitor names joint 3, whose offset is coefficient 8; of those in the mask. */
void test_start_from_suspects_needs_a_suspect_whose_offset_is_free(void)
{
    kc_monitoring_t *m = &APP->monitoring;
    memcpy(m->crc, APP->tables.active.crc, sizeof m->crc);
    expect_not_started(KC_EVT_CAL_NO_SUSPECTS, KC_ERR_STATE, 0.0, 0.0);
    m->suspects.joints = 4u;
    APP->tables.active.config.est.free_mask = ~(1ull << 8u) & ((1ull << 28u) - 1u);
    expect_not_started(KC_EVT_CAL_NO_SUSPECTS, KC_ERR_STATE, 4.0, 0.0);
    APP->tables.active.config.est.free_mask |= 1ull << 8u;
    m->session = 1u; /* a calibration since */
    expect_not_started(KC_EVT_CAL_NO_SUSPECTS, KC_ERR_STATE, 4.0, 0.0);
    m->session = 0u;
    TEST_ASSERT_EQUAL_INT(KC_OC_START, started(true).id);
    TEST_ASSERT_EQUAL_UINT8(1u, APP->est.by_prior);
}
