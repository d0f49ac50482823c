/* kc_holder.c: approval by two persons, from the numbers of keys to the correction in force. */
#include <string.h>

#include "given_tables.h"
#include "given_world.h"
#include "kc_holder.h"
#include "unity.h"

#define APP (&kc_app_instance)

static uint32_t s_crc, s_before;
static int32_t s_staged;

void setUp(void);
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

static uint32_t active_crc(void) { return kc_app_active(APP)->crc[KC_TBL_KIN]; }

static int32_t by(uint32_t signer, int32_t opcode, int32_t a0, int32_t a1)
{
    world.signer = signer;
    return world_do(opcode, a0, a1, 0);
}

static void given_proposal(void)
{
    world.signer = 0u;
    world_calibrated();
    s_crc = world.proposal.crc;
    s_before = active_crc();
    TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
}

static void armed(void)
{
    given_proposal();
    TEST_ASSERT_EQUAL_INT(KC_OK, by(0u, KC_CMD_APPROVE_ARM, (int32_t)s_crc, 0));
}

static void refused(kc_event_id_t why, kc_status_t status, double got, double want)
{
    TEST_ASSERT_EQUAL_INT(why, world.ack.event_id);
    TEST_ASSERT_EQUAL_INT(status, world.ack.status);
    TEST_ASSERT_EQUAL_DOUBLE(got, world.last[why].got);
    TEST_ASSERT_EQUAL_DOUBLE(want, world.last[why].want);
}

void test_go_by_the_holder_that_armed_is_refused_and_by_another_one_is_taken(void)
{
    armed();
    for (uint32_t signer = 0u; signer < 2u; signer++) { /* the same key, then the other one of its rotation */
        TEST_ASSERT_EQUAL_INT(KC_ERR_AUTH, by(signer, KC_CMD_APPROVE_GO, (int32_t)s_crc, 0));
        refused(KC_EVT_CMD_SAME_KEY, KC_ERR_AUTH, 1.0 + signer, 1.0);
        TEST_ASSERT_EQUAL_INT(KC_CMD_APPROVE_GO, world.last[KC_EVT_CMD_SAME_KEY].index);
        TEST_ASSERT_EQUAL_INT(KC_ST_ARMED, kc_app_state(APP));
        TEST_ASSERT_EQUAL_HEX32(s_before, active_crc());
    }
    TEST_ASSERT_EQUAL_INT(KC_OK, by(2u, KC_CMD_APPROVE_GO, (int32_t)s_crc, 0));
    TEST_ASSERT_EQUAL_HEX32(s_crc, active_crc());
}

void test_an_approval_that_expired_is_armed_anew_and_its_first_key_counts_no_more(void)
{
    world.config.approval_timeout_us = 1000000u;
    armed();
    TEST_ASSERT_TRUE(world_until(KC_ST_REVIEW, 100u));
    TEST_ASSERT_EQUAL_INT(KC_OK, by(2u, KC_CMD_APPROVE_ARM, (int32_t)s_crc, 0));
    TEST_ASSERT_EQUAL_INT(KC_ERR_AUTH, by(2u, KC_CMD_APPROVE_GO, (int32_t)s_crc, 0));
    TEST_ASSERT_EQUAL_INT(KC_OK, by(0u, KC_CMD_APPROVE_GO, (int32_t)s_crc, 0));
}

/* As the approval itself: a restart disarms, and whoever arms then is the first. */
void test_a_restart_disarms_and_forgets_who_armed(void)
{
    armed();
    world_restart();
    world_ticks(11u);
    TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(0u, world.hk.armed_key);
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, by(2u, KC_CMD_APPROVE_GO, (int32_t)s_crc, 0));
    TEST_ASSERT_EQUAL_INT(KC_OK, by(2u, KC_CMD_APPROVE_ARM, (int32_t)s_crc, 0));
    TEST_ASSERT_EQUAL_INT(KC_ERR_AUTH, by(2u, KC_CMD_APPROVE_GO, (int32_t)s_crc, 0));
    TEST_ASSERT_EQUAL_INT(KC_OK, by(0u, KC_CMD_APPROVE_GO, (int32_t)s_crc, 0));
}

void test_who_armed_may_reject_alone_and_so_may_the_other(void)
{
    for (uint32_t signer = 0u; signer < 3u; signer += 2u) {
        setUp();
        armed();
        TEST_ASSERT_EQUAL_INT(KC_OK, by(signer, KC_CMD_REJECT, (int32_t)s_crc, 0));
        TEST_ASSERT_EQUAL_HEX32(s_before, active_crc());
    }
}

/* The way back to what was in force needs one person. */
void test_a_rollback_needs_one_key(void)
{
    armed();
    TEST_ASSERT_EQUAL_INT(KC_OK, by(2u, KC_CMD_APPROVE_GO, (int32_t)s_crc, 0));
    TEST_ASSERT_EQUAL_INT(KC_OK, by(2u, KC_CMD_ROLLBACK, (int32_t)s_crc, 0));
    TEST_ASSERT_EQUAL_HEX32(s_before, active_crc());
}

/* ---- one holder only ---- */

void test_with_the_keys_of_one_holder_the_start_and_the_first_step_say_that_nothing_can_be_approved(void)
{
    world.keys.n = 2u;
    given_proposal();
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_KEYS_ONE_HOLDER));
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, by(0u, KC_CMD_APPROVE_ARM, (int32_t)s_crc, 0));
    refused(KC_EVT_KEYS_ONE_HOLDER, KC_ERR_STATE, 2.0, 0.0);
    TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
    world.keys.n = 3u; /* the remedy that the event names */
    world_restart();
    world_tick();
    TEST_ASSERT_EQUAL_INT(KC_OK, by(0u, KC_CMD_APPROVE_ARM, (int32_t)s_crc, 0));
}

void test_nothing_is_said_of_holders_without_the_rule_or_without_keys(void)
{
    world_boot();
    world_tick();
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_KEYS_ONE_HOLDER));
    setUp();
    world.keys.n = 0u; /* BOOT_NO_KEYS says it */
    world_boot();
    world_tick();
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_KEYS_ONE_HOLDER));
    setUp();
    world.keys.n = 1u;
    world.config.go_by_other_key = 0u;
    world_boot();
    world_tick();
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_KEYS_ONE_HOLDER));
}

/* ---- tables ---- */

static int32_t stage(uint32_t signer, uint16_t kind, const void *table)
{
    world.signer = signer;
    s_staged = world_upload(kind, world.image, given_image(kind, table, world.image));
    return by(signer, KC_CMD_TABLE_VALIDATE, kind, s_staged);
}

void test_a_configuration_that_wants_two_holders_is_refused_while_there_is_one(void)
{
    world.keys.n = 2u;
    world.config.go_by_other_key = 0u;
    world_boot();
    world_tick();
    world.config.go_by_other_key = 1u;
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, stage(0u, KC_TBL_CONFIG, &world.config));
    refused(KC_EVT_KEYS_ONE_HOLDER, KC_ERR_STATE, 2.0, 0.0);
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, by(0u, KC_CMD_TABLE_ACTIVATE, KC_TBL_CONFIG, s_staged));
    refused(KC_EVT_KEYS_ONE_HOLDER, KC_ERR_STATE, 2.0, 0.0);
    TEST_ASSERT_EQUAL_UINT8(0u, kc_app_active(APP)->config.go_by_other_key);
    world.keys.n = 3u; /* with two it is taken, and it takes one to bring the rule in */
    world.config.go_by_other_key = 0u;
    world_restart();
    world_tick();
    world.config.go_by_other_key = 1u;
    TEST_ASSERT_EQUAL_INT(KC_OK, stage(0u, KC_TBL_CONFIG, &world.config));
    TEST_ASSERT_EQUAL_INT(KC_OK, by(0u, KC_CMD_TABLE_ACTIVATE, KC_TBL_CONFIG, s_staged));
    TEST_ASSERT_EQUAL_UINT8(1u, kc_app_active(APP)->config.go_by_other_key);
}

/* One holder alone could end the rule, or uplink a correction past the review. */
void test_under_the_rule_a_configuration_or_correction_takes_two_holders_too(void)
{
    static kc_kin_t kin;
    world_boot();
    world_tick();
    world_kin(&kin);
    TEST_ASSERT_EQUAL_INT(KC_OK, stage(0u, KC_TBL_KIN, &kin));
    TEST_ASSERT_EQUAL_INT(KC_ERR_AUTH, by(0u, KC_CMD_TABLE_ACTIVATE, KC_TBL_KIN, s_staged));
    refused(KC_EVT_CMD_SAME_KEY, KC_ERR_AUTH, 1.0, 1.0);
    TEST_ASSERT_EQUAL_INT(KC_CMD_TABLE_ACTIVATE, world.last[KC_EVT_CMD_SAME_KEY].index);
    TEST_ASSERT_EQUAL_INT(KC_OK, by(2u, KC_CMD_TABLE_ACTIVATE, KC_TBL_KIN, s_staged));
    TEST_ASSERT_EQUAL_HEX32((uint32_t)s_staged, active_crc());
    world.config.go_by_other_key = 0u;
    TEST_ASSERT_EQUAL_INT(KC_OK, stage(2u, KC_TBL_CONFIG, &world.config));
    TEST_ASSERT_EQUAL_INT(KC_ERR_AUTH, by(2u, KC_CMD_TABLE_ACTIVATE, KC_TBL_CONFIG, s_staged));
    TEST_ASSERT_EQUAL_UINT8(1u, kc_app_active(APP)->config.go_by_other_key);
    TEST_ASSERT_EQUAL_INT(KC_OK, by(1u, KC_CMD_TABLE_ACTIVATE, KC_TBL_CONFIG, s_staged));
    TEST_ASSERT_EQUAL_UINT8(0u, kc_app_active(APP)->config.go_by_other_key);
}

void test_other_tables_take_one_holder(void)
{
    world_boot();
    world_tick();
    TEST_ASSERT_EQUAL_INT(KC_OK, stage(0u, KC_TBL_CAMERA, &kc_app_active(APP)->camera));
    TEST_ASSERT_EQUAL_INT(KC_OK, by(0u, KC_CMD_TABLE_ACTIVATE, KC_TBL_CAMERA, s_staged));
}

/* The remedy that KEYS_ONE_HOLDER names: who is left may end the rule. */
void test_the_only_holder_left_may_end_the_rule(void)
{
    world.keys.n = 2u;
    world_boot();
    world_tick();
    world.config.go_by_other_key = 0u;
    TEST_ASSERT_EQUAL_INT(KC_OK, stage(0u, KC_TBL_CONFIG, &world.config));
    TEST_ASSERT_EQUAL_INT(KC_OK, by(0u, KC_CMD_TABLE_ACTIVATE, KC_TBL_CONFIG, s_staged));
    TEST_ASSERT_EQUAL_UINT8(0u, kc_app_active(APP)->config.go_by_other_key);
}

/* ---- stores and images of before ---- */

void test_an_image_with_standard_values_at_its_end_ends_before_them_and_has_the_crc_of_before(void)
{
    static uint8_t with[2048], without[2048];
    static kc_config_t back;
    static kc_events_t ev;
    uint32_t n_with = 0u, n_without = 0u;
    world.config.rest_part = 0.01;
    world.config.no_change_power = 0.99;
    (void)kc_tbl_encode(KC_TBL_CONFIG, &world.config, 0u, with, sizeof with, &n_with);
    world.config.go_by_other_key = 0u;
    (void)kc_tbl_encode(KC_TBL_CONFIG, &world.config, 0u, without, sizeof without, &n_without);
    TEST_ASSERT_EQUAL_UINT32(n_without + 17u, n_with);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_decode(KC_TBL_CONFIG, with, n_with, &back, &ev));
    TEST_ASSERT_EQUAL_UINT8(1u, back.go_by_other_key);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_decode(KC_TBL_CONFIG, without, n_without, &back, &ev));
    TEST_ASSERT_EQUAL_UINT8(0u, back.go_by_other_key);
    TEST_ASSERT_EQUAL_DOUBLE(0.01, back.rest_part);
    TEST_ASSERT_EQUAL_DOUBLE(0.99, back.no_change_power);
    /* each of the three alone makes the image longer; an image that says the standard values would have another CRC */
    world.config.rest_part = 0.02;
    (void)kc_tbl_encode(KC_TBL_CONFIG, &world.config, 0u, with, sizeof with, &n_with);
    TEST_ASSERT_EQUAL_UINT32(n_without + 17u, n_with);
    world.config.rest_part = 0.01;
    world.config.no_change_power = 0.5;
    (void)kc_tbl_encode(KC_TBL_CONFIG, &world.config, 0u, with, sizeof with, &n_with);
    TEST_ASSERT_EQUAL_UINT32(n_without + 17u, n_with);
    const double standard = 0.99;
    memcpy(&with[n_with - 9u], &standard, sizeof standard);
    given_resealed(with, n_with);
    ev.n = 0u;
    TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, kc_tbl_decode(KC_TBL_CONFIG, with, n_with, &back, &ev));
    TEST_ASSERT_EQUAL_UINT32(KC_EVT_TBL_RANGE, ev.e[0].id);
}
