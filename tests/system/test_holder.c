/* kc_holder.c: approval by two persons, from the start to the correction in force. Tables: test_kc_cmd.c. */
#include "given_world.h"
#include "unity.h"

#define APP (&kc_app_instance)

static uint32_t s_crc;

void setUp(void)
{
    given_world();
    world.config.n_poses = 8u;
    world.config.go_by_other_key = 1u;
    world.truth.joint[6].phi_rad = 0.1;
    world.keys.n = 3u; /* 1 and 2 are the keys of a rotation, 101 is the other person's */
    world.keys.key[1] = (kc_key_t){.id = 2u, .secret = {2u}};
    world.keys.key[2] = (kc_key_t){.id = 101u, .secret = {3u}};
}

static int32_t by(uint32_t signer, int32_t opcode)
{
    world.signer = signer;
    return world_do(opcode, (int32_t)s_crc, 0, 0);
}

static void given_proposal(void)
{
    world_calibrated();
    s_crc = world.proposal.crc;
    TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
}

void test_go_by_the_holder_that_armed_is_refused_and_by_another_one_is_taken(void)
{
    given_proposal();
    TEST_ASSERT_EQUAL_INT(KC_OK, by(0u, KC_CMD_APPROVE_ARM));
    for (uint32_t signer = 0u; signer < 2u; signer++) { /* the same key, then the other one of its rotation */
        TEST_ASSERT_EQUAL_INT(KC_ERR_AUTH, by(signer, KC_CMD_APPROVE_GO));
        TEST_ASSERT_EQUAL_INT(KC_EVT_CMD_SAME_KEY, world.ack.event_id);
        TEST_ASSERT_EQUAL_INT(KC_ST_ARMED, kc_app_state(APP));
        TEST_ASSERT_EQUAL_HEX32(world.proposal.crc_kin_before, world_kin_crc());
    }
    TEST_ASSERT_EQUAL_INT(KC_OK, by(2u, KC_CMD_APPROVE_GO));
    TEST_ASSERT_EQUAL_HEX32(s_crc, world_kin_crc());
}

/* As the approval itself: a restart disarms, and whoever arms then is the first. */
void test_a_restart_disarms_and_forgets_who_armed(void)
{
    given_proposal();
    TEST_ASSERT_EQUAL_INT(KC_OK, by(0u, KC_CMD_APPROVE_ARM));
    world_restart();
    world_ticks(11u);
    TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(0u, world.hk.armed_key);
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, by(2u, KC_CMD_APPROVE_GO));
    TEST_ASSERT_EQUAL_INT(KC_OK, by(2u, KC_CMD_APPROVE_ARM));
    TEST_ASSERT_EQUAL_INT(KC_ERR_AUTH, by(2u, KC_CMD_APPROVE_GO));
    TEST_ASSERT_EQUAL_INT(KC_OK, by(0u, KC_CMD_APPROVE_GO));
}

void test_with_the_keys_of_one_holder_the_start_and_the_first_step_say_that_nothing_can_be_approved(void)
{
    world.keys.n = 2u;
    given_proposal();
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_KEYS_ONE_HOLDER));
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, by(0u, KC_CMD_APPROVE_ARM));
    TEST_ASSERT_EQUAL_INT(KC_EVT_KEYS_ONE_HOLDER, world.ack.event_id);
    TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
    world.keys.n = 3u; /* the remedy that the event names */
    world_restart();
    world_tick();
    TEST_ASSERT_EQUAL_INT(KC_OK, by(0u, KC_CMD_APPROVE_ARM));
}
