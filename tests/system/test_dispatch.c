/* kc_dispatch.c: who may send each command, and in which states it is taken. */
#include "kc_dispatch.h"

#include <string.h>

#include "given_world.h"
#include "unity.h"

#define APP (&kc_app_instance)
#define OPCODE_COUNT ((int32_t)KC_CMD_TABLE_DUMP + 1)

static kc_out_t s_out;

void setUp(void);
void setUp(void)
{
    given_world();
    world_boot();
    world_ticks(2u);
    world.in.n_cmd = 0u;
}

/* Dispatch a command, signed or not, in a state: the event that says why it was refused, NONE if it was not. */
static int32_t refused_for(int32_t opcode, kc_state_t state, bool is_signed)
{
    kc_work_t work = kc_work_of_step();
    kc_cmd_t *cmd = world_cmd(opcode, 0, 0, 0);
    if (is_signed) { world_sign_cmd(cmd); }
    memset(&s_out, 0, sizeof s_out);
    APP->place.state = state;
    (void)kc_dispatch(APP, cmd, false, &work, &s_out);
    world.in.n_cmd = 0u;
    return s_out.n_ack == 1u ? s_out.ack[0].event_id : (int32_t)KC_EVT_NONE;
}

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

void test_each_command_is_taken_in_its_states_and_in_no_other(void)
{
    for (int32_t opcode = 0; opcode < OPCODE_COUNT; opcode++) {
        bool table = opcode >= KC_CMD_TABLE_VALIDATE && opcode <= KC_CMD_TABLE_DISCARD;
        int32_t otherwise = table ? KC_EVT_TBL_BUSY : KC_EVT_CMD_STATE;
        for (uint32_t state = 0u; state < KC_ST_COUNT; state++) {
            int32_t why = refused_for(opcode, (kc_state_t)state, true);
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
    for (int32_t opcode = 0; opcode <= OPCODE_COUNT; opcode++) { /* the last one does not exist */
        bool open = opcode == KC_CMD_NOOP || opcode == KC_CMD_ABORT;
        TEST_ASSERT_EQUAL_INT(open ? KC_EVT_NONE : KC_EVT_CMD_UNSIGNED,
                              refused_for(opcode, KC_ST_IDLE, false));
    }
}

void test_a_signed_command_that_does_not_exist_is_refused_and_answered(void)
{
    const int32_t opcodes[] = {-1, OPCODE_COUNT, INT32_MAX, INT32_MIN};
    for (uint32_t i = 0u; i < 4u; i++) {
        TEST_ASSERT_EQUAL_INT(KC_EVT_CMD_UNKNOWN, refused_for(opcodes[i], KC_ST_IDLE, true));
        TEST_ASSERT_EQUAL_INT(opcodes[i], s_out.ack[0].opcode);
    }
}

void test_only_commands_of_tables_need_time_for_a_whole_table_whatever_the_state(void)
{
    for (int32_t opcode = 0; opcode < OPCODE_COUNT; opcode++) {
        bool table = opcode >= KC_CMD_TABLE_VALIDATE && opcode <= KC_CMD_TABLE_DISCARD;
        kc_work_t work = {1u, 1u}; /* used up */
        kc_cmd_t *cmd = world_cmd(opcode, KC_TBL_CONFIG, 0, 0);
        world_sign_cmd(cmd);
        memset(&s_out, 0, sizeof s_out);
        APP->place.state = KC_ST_MOVE;
        (void)kc_dispatch(APP, cmd, false, &work, &s_out);
        world.in.n_cmd = 0u;
        TEST_ASSERT_TRUE(table == (s_out.ack[0].event_id == KC_EVT_CMD_WORK));
    }
}

void test_what_moves_the_arm_or_changes_what_is_in_force_gives_way_to_an_abort(void)
{
    for (int32_t opcode = 0; opcode < OPCODE_COUNT; opcode++) {
        bool gives_way = opcode == KC_CMD_START || opcode == KC_CMD_APPROVE_ARM ||
                         opcode == KC_CMD_APPROVE_GO || opcode == KC_CMD_ROLLBACK ||
                         opcode == KC_CMD_TABLE_ACTIVATE;
        kc_work_t work = kc_work_of_step();
        kc_cmd_t *cmd = world_cmd(opcode, KC_TBL_CONFIG, 0, 0);
        world_sign_cmd(cmd);
        memset(&s_out, 0, sizeof s_out);
        (void)kc_dispatch(APP, cmd, true, &work, &s_out);
        world.in.n_cmd = 0u;
        TEST_ASSERT_TRUE(gives_way == (s_out.ack[0].event_id == KC_EVT_CMD_ABORTED));
    }
}
