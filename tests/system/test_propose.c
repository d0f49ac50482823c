/* kc_propose.c: from a calibration to the correction in force: review in two steps, acceptance on board, rollback. What a
 * proposal states: test_kc_propose.c. */
#include "given_world.h"
#include "unity.h"

#define APP (&kc_app_instance)

void setUp(void)
{
    given_world();
    world.config.n_poses = 8u;
    world.truth.joint[6].phi_rad = 0.1;
}

/* ---- review ---- */

static void refused(int32_t opcode, uint32_t crc, int32_t status, uint16_t event)
{
    kc_state_t state = kc_app_state(APP);
    uint32_t active = world_kin_crc(), waiting = APP->review.crc;
    TEST_ASSERT_EQUAL_INT(status, world_do(opcode, (int32_t)crc, 0, 0));
    TEST_ASSERT_EQUAL_INT(event, world.ack.event_id);
    TEST_ASSERT_TRUE(world_events(event) > 0u);
    TEST_ASSERT_EQUAL_INT(state, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(active, world_kin_crc());
    TEST_ASSERT_EQUAL_UINT32(waiting, APP->review.crc);
}

void test_approval_takes_two_steps_bound_to_the_crc(void)
{
    world_calibrated();
    uint32_t crc = world.proposal.crc, before = world_kin_crc();
    refused(KC_CMD_APPROVE_GO, crc, KC_ERR_STATE, KC_EVT_CMD_STATE);
    refused(KC_CMD_APPROVE_ARM, crc + 1u, KC_ERR_CRC, KC_EVT_CMD_CRC);
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_APPROVE_ARM, (int32_t)crc, 0, 0));
    TEST_ASSERT_EQUAL_INT(KC_ST_ARMED, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_COR_ARMED));
    refused(KC_CMD_APPROVE_ARM, crc, KC_ERR_STATE, KC_EVT_CMD_STATE);
    refused(KC_CMD_APPROVE_GO, crc + 1u, KC_ERR_CRC, KC_EVT_CMD_CRC);
    TEST_ASSERT_EQUAL_UINT32(before, world_kin_crc());
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_APPROVE_GO, (int32_t)crc, 0, 0));
    TEST_ASSERT_EQUAL_INT(KC_ST_IDLE, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(crc, world_kin_crc());
    TEST_ASSERT_EQUAL_UINT32(before, kc_app_active(APP)->kin_prev_crc);
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_COR_ACTIVE));
}

void test_a_corrected_arm_needs_no_change(void)
{
    world_calibrated();
    uint32_t crc = world.proposal.crc;
    (void)world_approve();
    (void)world_do(KC_CMD_START, -1, 0, 5);
    for (uint32_t i = 0u; i < 3000u && world_calibrating(); i++) { world_tick(); }
    TEST_ASSERT_EQUAL_UINT32(2u, world.n_proposal);
    TEST_ASSERT_EQUAL_UINT32(2u, world.proposal.session);
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_NO_CHANGE, world.proposal.verdict);
    TEST_ASSERT_EQUAL_UINT32(crc, world_kin_crc());
}

void test_a_rejected_proposal_is_gone(void)
{
    world_calibrated();
    uint32_t crc = world.proposal.crc, before = world_kin_crc();
    refused(KC_CMD_REJECT, crc + 1u, KC_ERR_CRC, KC_EVT_CMD_CRC);
    (void)world_do(KC_CMD_APPROVE_ARM, (int32_t)crc, 0, 0); /* still possible when armed */
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_REJECT, (int32_t)crc, 0, 0));
    TEST_ASSERT_EQUAL_INT(KC_ST_IDLE, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_COR_REJECTED));
    TEST_ASSERT_EQUAL_UINT32(0u, world.stored[KC_STORE_PROPOSAL][0]);
    TEST_ASSERT_EQUAL_UINT32(before, world_kin_crc());
    refused(KC_CMD_APPROVE_ARM, crc, KC_ERR_STATE, KC_EVT_CMD_STATE);
}

/* ---- a poor proposal ---- */

static uint32_t given_poor(void)
{
    given_overstated_detections();
    world_calibrated();
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_POOR, world.proposal.verdict);
    return world.proposal.crc;
}

void test_a_poor_proposal_is_not_armed_without_an_override(void)
{
    uint32_t crc = given_poor();
    refused(KC_CMD_APPROVE_ARM, crc, KC_ERR_ARG, KC_EVT_COR_POOR);
    refused(KC_CMD_APPROVE_GO, crc, KC_ERR_STATE, KC_EVT_CMD_STATE);
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_COR_ARMED));
    world_ticks(11u);
    TEST_ASSERT_EQUAL_UINT32(KC_VERDICT_POOR, world.hk.proposal_verdict);
    TEST_ASSERT_EQUAL_UINT64(0u, world.hk.approval_left_us);
}

void test_a_poor_proposal_is_approved_by_an_override_in_the_signed_command(void)
{
    uint32_t crc = given_poor();
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_APPROVE_ARM, (int32_t)crc, KC_OVERRIDE_FIT, 0));
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_COR_OVERRIDE));
    TEST_ASSERT_EQUAL_INT(KC_ST_ARMED, kc_app_state(APP));
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_APPROVE_GO, (int32_t)crc, 0, 0));
    TEST_ASSERT_EQUAL_UINT32(crc, world_kin_crc());
}

void test_an_override_that_is_put_into_a_command_after_it_was_signed_is_a_forgery(void)
{
    uint32_t crc = given_poor();
    kc_cmd_t *c = world_cmd(KC_CMD_APPROVE_ARM, (int32_t)crc, KC_OVERRIDE_NONE, 0);
    world_sign_cmd(c);
    c->arg_i[1] = KC_OVERRIDE_FIT;
    world.as_sent = true;
    world_tick();
    world.as_sent = false;
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CMD_FORGED));
    TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
}

void test_a_poor_proposal_is_poor_after_a_restart_too_and_armed_before_it_no_more(void)
{
    uint32_t crc = given_poor();
    (void)world_do(KC_CMD_APPROVE_ARM, (int32_t)crc, KC_OVERRIDE_FIT, 0);
    world_restart();
    world_tick();
    TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(KC_VERDICT_POOR, world.hk.proposal_verdict);
    refused(KC_CMD_APPROVE_GO, crc, KC_ERR_STATE, KC_EVT_CMD_STATE);
    refused(KC_CMD_APPROVE_ARM, crc, KC_ERR_ARG, KC_EVT_COR_POOR);
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_APPROVE_ARM, (int32_t)crc, KC_OVERRIDE_FIT, 0));
}

/* A good fit, but nobody knows that any more. */
void test_a_proposal_whose_verdict_was_lost_with_the_journal_needs_an_override(void)
{
    world_calibrated();
    uint32_t crc = world.proposal.crc;
    world.stored[KC_STORE_JOURNAL][0] = world.stored[KC_STORE_JOURNAL][1] = 0u;
    world_restart();
    world_tick();
    TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(0u, world.hk.proposal_verdict);
    refused(KC_CMD_APPROVE_ARM, crc, KC_ERR_ARG, KC_EVT_COR_NO_VERDICT);
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_COR_POOR));
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_APPROVE_ARM, (int32_t)crc, KC_OVERRIDE_FIT, 0));
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_COR_OVERRIDE));
}

/* ---- accepted on board ---- */

static void given_policy(void)
{
    setUp();
    world.truth.joint[6].phi_rad = 0.01;
    world.config.n_poses = 16u;
    world.config.accept_on_board = 1u;
    world.config.accept_change_max_pos_m = 0.01;
    world.config.accept_sigma_max_pos_m = 0.01;
    world.config.accept_p_fit_min = 1e-6;
}

void test_a_small_well_determined_correction_is_accepted_on_board(void)
{
    given_policy();
    world_calibrated();
    TEST_ASSERT_EQUAL_INT(KC_ST_IDLE, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(world.proposal.crc, world_kin_crc());
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_COR_ON_BOARD));
    TEST_ASSERT_EQUAL_UINT32(world.proposal.crc,
                             kc_tbl_image_crc(world.store[KC_TBL_KIN][0], world.stored[KC_TBL_KIN][0]));
}

void test_without_a_policy_everything_waits_for_the_ground(void)
{
    given_policy();
    world.config.accept_on_board = 0u;
    world_calibrated();
    TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_COR_ON_BOARD));
}

/* ---- rollback ---- */

void test_rollback_brings_the_table_before_back(void)
{
    world_calibrated();
    uint32_t crc = world.proposal.crc, before = world_kin_crc();
    (void)world_approve();
    refused(KC_CMD_ROLLBACK, before, KC_ERR_CRC, KC_EVT_CMD_CRC);
    (void)world_do(KC_CMD_ABORT, 0, 0, 0);
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_ROLLBACK, (int32_t)crc, 0, 0));
    TEST_ASSERT_EQUAL_INT(KC_ST_IDLE, kc_app_state(APP)); /* out of SAFE too */
    TEST_ASSERT_EQUAL_UINT32(before, world_kin_crc());
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_COR_ROLLBACK));
    TEST_ASSERT_EQUAL_UINT32(0u, world.stored[KC_STORE_PREV][0]);
    refused(KC_CMD_ROLLBACK, before, KC_ERR_STATE, KC_EVT_COR_NO_PREVIOUS);
    world_restart();
    TEST_ASSERT_EQUAL_UINT32(before, world_kin_crc());
}
