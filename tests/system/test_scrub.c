/* kc_scrub.c: memory that changes by itself is found, named, and not used any more. */
#include <string.h>

#include "given_tables.h"
#include "given_world.h"
#include "unity.h"

#define APP (&kc_app_instance)
#define ROUND 100u /* ticks in which all of the memory has been looked at */

void setUp(void)
{
    given_world();
    world.config.n_poses = 8u;
    world.truth.joint[6].phi_rad = 0.1;
}

static void flip(void *at, uint32_t n, uint32_t bit)
{
    ((uint8_t *)at)[bit / 8u % n] ^= (uint8_t)(1u << bit % 8u);
}

static void expect_safe(uint32_t event, int32_t index)
{
    TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(event));
    TEST_ASSERT_EQUAL_INT(index, world.last[event].index);
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_ABORTED));
    TEST_ASSERT_EQUAL_DOUBLE((double)KC_CAUSE_MEMORY, world.last[KC_EVT_CAL_ABORTED].got);
    TEST_ASSERT_EQUAL_INT(1, world.arm_cmd.hold);
}

void test_healthy_memory_is_left_alone_through_a_calibration_and_an_approval(void)
{
    world_calibrated();
    int32_t crc = (int32_t)world.proposal.crc;
    (void)world_do(KC_CMD_APPROVE_ARM, crc, 0, 0);
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_APPROVE_GO, crc, 0, 0));
    world_ticks(2u * ROUND);
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_ROLLBACK, crc, 0, 0));
    world_ticks(2u * ROUND);
    TEST_ASSERT_EQUAL_INT(KC_ST_IDLE, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(0u,
                             world_events(KC_EVT_MEMORY_TABLE) + world_events(KC_EVT_MEMORY_OBSERVATIONS));
}

void test_any_flipped_bit_of_any_active_table_ends_in_safe_and_a_restart_heals_it(void)
{
    for (uint16_t kind = 1u; kind < KC_TBL_COUNT; kind++) {
        for (uint32_t k = 0u; k < 4u; k++) {
            setUp();
            world_boot();
            world_ticks(1u + 13u * k); /* wherever the comparison stands */
            kc_active_t *a = &APP->tables.active;
            uint32_t n = kc_tbl_active_bytes(kind), crc = a->crc[kind];
            flip((void *)kc_tbl_active_ptr(a, kind), n, k * (8u * n / 4u) + 5u * k);
            world_ticks(ROUND);
            expect_safe(KC_EVT_MEMORY_TABLE, kind);
            TEST_ASSERT_EQUAL_UINT32(0u, a->crc[kind]);
            TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, world_do(KC_CMD_START, -1, 0, 0));
            TEST_ASSERT_EQUAL_INT(KC_EVT_TBL_MISSING, world.ack.event_id);
            world_restart();
            world_tick();
            TEST_ASSERT_EQUAL_UINT32(crc, a->crc[kind]);
            TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_BOOT_LOST));
            TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_START, -1, 0, 0));
        }
    }
}

void test_a_flipped_bit_while_the_arm_moves_holds_it(void)
{
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_SETTLE, 300u));
    flip(&APP->tables.active.arm, (uint32_t)sizeof(kc_arm_t), 77u);
    TEST_ASSERT_TRUE(world_until(KC_ST_SAFE, ROUND));
    expect_safe(KC_EVT_MEMORY_TABLE, KC_TBL_ARM);
}

void test_the_correction_for_rollback_is_compared_too_and_comes_back_from_the_store(void)
{
    world_calibrated();
    int32_t crc = (int32_t)world.proposal.crc;
    (void)world_do(KC_CMD_APPROVE_ARM, crc, 0, 0);
    (void)world_do(KC_CMD_APPROVE_GO, crc, 0, 0);
    uint32_t prev = kc_app_active(APP)->kin_prev_crc;
    flip(&APP->tables.active.kin_prev, (uint32_t)sizeof(kc_kin_t), 1000u);
    world_ticks(ROUND);
    expect_safe(KC_EVT_MEMORY_TABLE, (int32_t)KC_STORE_PREV);
    TEST_ASSERT_EQUAL_HEX32(0u, kc_app_active(APP)->kin_prev_crc);
    TEST_ASSERT_EQUAL_HEX32(prev, APP->journal.last.prev_crc); /* the store still has it */
    TEST_ASSERT_EQUAL_HEX32((uint32_t)crc, APP->journal.last.kin_crc);
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, world_do(KC_CMD_ROLLBACK, crc, 0, 0));
    world_restart();
    world_tick();
    TEST_ASSERT_EQUAL_UINT32(prev, kc_app_active(APP)->kin_prev_crc);
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_ROLLBACK, crc, 0, 0));
}

void test_a_correction_that_changed_in_memory_can_be_replaced_from_the_ground(void)
{
    static kc_kin_t kin;
    world_boot();
    world_tick();
    flip(&APP->tables.active.kin, (uint32_t)sizeof(kc_kin_t), 700u);
    world_ticks(ROUND);
    expect_safe(KC_EVT_MEMORY_TABLE, KC_TBL_KIN);
    world_kin(&kin);
    int32_t crc = world_upload(KC_TBL_KIN, world.image, given_image(KC_TBL_KIN, &kin, world.image));
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_TABLE_VALIDATE, KC_TBL_KIN, crc, 0));
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_TABLE_ACTIVATE, KC_TBL_KIN, crc, 0));
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_START, -1, 0, 0));
}

void test_a_flipped_bit_of_an_observation_ends_the_calibration_and_a_new_one_may_start(void)
{
    world_started();
    for (uint32_t i = 0u; i < 4000u && APP->est.n_obs < 5u; i++) { world_tick(); }
    world_tick(); /* the newest is sealed at the end of its step */
    flip(&APP->est.obs[2], (uint32_t)sizeof(kc_obs_t), 333u);
    for (uint32_t i = 0u; i < ROUND && world_calibrating(); i++) { world_tick(); }
    expect_safe(KC_EVT_MEMORY_OBSERVATIONS, -1);
    world_ticks(2u * ROUND);
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_MEMORY_OBSERVATIONS)); /* said once */
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_START, -1, 0, 0));
    for (uint32_t i = 0u; i < 4000u && world_calibrating(); i++) { world_tick(); }
    TEST_ASSERT_EQUAL_UINT32(1u, world.n_proposal);
}

void test_a_fault_in_the_step_that_asks_for_storing_makes_nothing_of_it(void)
{
    world_calibrated();
    uint32_t crc = world.proposal.crc, before = kc_app_active(APP)->crc[KC_TBL_KIN];
    (void)world_do(KC_CMD_APPROVE_ARM, (int32_t)crc, 0, 0);
    APP->scrub.part = KC_TBL_CONFIG; /* next in line */
    APP->scrub.at = 0u;
    flip(&APP->tables.active.config, (uint32_t)sizeof(kc_config_t), 4u);
    (void)world_cmd(KC_CMD_APPROVE_GO, (int32_t)crc, 0, 0);
    world_tick();
    expect_safe(KC_EVT_MEMORY_TABLE, KC_TBL_CONFIG);
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, world.ack.status);
    world_ticks(3u);
    TEST_ASSERT_EQUAL_UINT32(before, kc_app_active(APP)->crc[KC_TBL_KIN]);
    world_restart();
    world_tick();
    TEST_ASSERT_EQUAL_UINT32(before, kc_app_active(APP)->crc[KC_TBL_KIN]);
    TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
}
