/* kc_change.c: what a restart finds of a change that was refused, cut off or in an abort. What each change asks of the
 * store: test_kc_change.c. Kills and real files: test_files.c. */
#include <string.h>

#include "given_tables.h"
#include "given_world.h"
#include "unity.h"

#define APP (&kc_app_instance)

static uint32_t s_crc, s_before;

void setUp(void)
{
    given_world();
    world.config.n_poses = 8u;
    world.truth.joint[6].phi_rad = 0.1;
}

static const kc_store_t *stored_in_step(uint16_t kind)
{
    for (uint32_t i = 0u; i < world.out.n_store; i++) {
        if (world.out.store[i].kind == kind) { return &world.out.store[i]; }
    }
    return NULL;
}

static void restarted(void)
{
    world_restart();
    world_tick();
}

static void armed(void)
{
    world_calibrated();
    s_crc = world.proposal.crc;
    s_before = world_kin_crc();
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_APPROVE_ARM, (int32_t)s_crc, 0, 0));
}

static void expect_in_force(uint32_t kin, uint32_t proposal, kc_state_t state)
{
    TEST_ASSERT_EQUAL_UINT32(kin, world_kin_crc());
    TEST_ASSERT_EQUAL_UINT32(proposal, APP->review.crc);
    TEST_ASSERT_EQUAL_INT(state, kc_app_state(APP));
}

/* The fault of the old code: acknowledged, sent as active, and lost at the next start without a word. 0: any kind. */
void test_whichever_kind_the_store_refuses_nothing_is_half_made(void)
{
    static const uint16_t kinds[] = {0u, KC_TBL_KIN, KC_STORE_PREV, KC_STORE_JOURNAL};
    for (uint32_t i = 0u; i < 4u; i++) {
        setUp();
        armed();
        world.store_fails = -1;
        world.store_fails_kind = kinds[i];
        TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, world_do(KC_CMD_APPROVE_GO, (int32_t)s_crc, 0, 0));
        TEST_ASSERT_EQUAL_INT(KC_EVT_STORE_REFUSED, world.ack.event_id);
        expect_in_force(s_before, s_crc, KC_ST_REVIEW);
        world.store_fails = 0;
        world_ticks(12u); /* the journal is stored again */
        restarted();
        expect_in_force(s_before, s_crc, KC_ST_REVIEW);
        world_approve();
        expect_in_force(s_crc, 0u, KC_ST_IDLE);
    }
}

void test_the_step_that_puts_a_large_table_in_force_has_no_time_for_another(void)
{
    armed();
    (void)world_cmd(KC_CMD_APPROVE_GO, (int32_t)s_crc, 0, 0);
    world_tick();
    APP->tables.staging.total = KC_IMAGE_MAX; /* what a large one is charged with; nothing is staged */
    (void)world_cmd(KC_CMD_TABLE_VALIDATE, KC_TBL_SPACE, 1, 0);
    world_tick();
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_COR_ACTIVE));
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CMD_WORK));
    TEST_ASSERT_EQUAL_INT(KC_CMD_TABLE_VALIDATE, world.last[KC_EVT_CMD_WORK].index);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, world.last[KC_EVT_CMD_WORK].got);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, world.last[KC_EVT_CMD_WORK].want);
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, world.ack.status);
}

/* The journal, both copies of it, says the same as the answer. */
void test_an_approval_that_cannot_be_made_leaves_the_old_correction_after_restarts_too(void)
{
    armed();
    (void)world_cmd(KC_CMD_APPROVE_GO, (int32_t)s_crc, 0, 0);
    for (uint32_t i = 0u; i < 10u && stored_in_step(KC_STORE_PREV) == NULL; i++) { world_tick(); }
    APP->review.kin.terms_crc ^= 1u;
    world_tick();
    TEST_ASSERT_EQUAL_INT(KC_EVT_CHANGE_FAILED, world.ack.event_id);
    expect_in_force(s_before, s_crc, KC_ST_REVIEW);
    world_ticks(3u);
    for (int newest_lost = 0; newest_lost < 2; newest_lost++) {
        if (newest_lost) { world.stored[KC_STORE_JOURNAL][0] = 0u; }
        restarted();
        expect_in_force(s_before, s_crc, KC_ST_REVIEW);
    }
    world_approve();
    expect_in_force(s_crc, 0u, KC_ST_IDLE);
}

void test_a_proposal_that_cannot_be_stored_waits_in_memory_and_its_loss_is_reported(void)
{
    world.store_fails = -1;
    world.store_fails_kind = KC_STORE_PROPOSAL;
    world_calibrated();
    TEST_ASSERT_EQUAL_HEX32(world.proposal.crc, APP->review.crc);
    /* the record that failed with it is stored again, in this very step */
    TEST_ASSERT_NOT_NULL(stored_in_step(KC_STORE_JOURNAL));
    world_tick();
    restarted();
    TEST_ASSERT_EQUAL_INT(KC_ST_IDLE, kc_app_state(APP));
    TEST_ASSERT_EQUAL_DOUBLE((double)world.proposal.crc, world.last[KC_EVT_BOOT_LOST].want);
}

/* ---- a table, and an abort ---- */

static void given_idle(void)
{
    setUp();
    world_boot();
    world_tick();
    s_before = kc_app_active(APP)->crc[KC_TBL_CONFIG];
}

static void stage_config(void)
{
    world.config.n_poses = 9u;
    s_crc = (uint32_t)world_upload(KC_TBL_CONFIG, world.image,
                                   given_image(KC_TBL_CONFIG, &world.config, world.image));
    world.config.n_poses = 8u;
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_TABLE_VALIDATE, KC_TBL_CONFIG, (int32_t)s_crc, 0));
}

static void activated(void) { (void)world_cmd(KC_CMD_TABLE_ACTIVATE, KC_TBL_CONFIG, (int32_t)s_crc, 0); }

/* Its image changes in memory when the store has been asked for it. */
static void spoil_staged(void)
{
    for (uint32_t i = 0u; i < 10u && kc_app_state(APP) != KC_ST_STORE; i++) { world_tick(); }
    APP->tables.staging.image[40] ^= 1u;
}

static void expect_of_before_after_a_restart(void)
{
    restarted();
    TEST_ASSERT_EQUAL_HEX32(s_before, kc_app_active(APP)->crc[KC_TBL_CONFIG]);
}

/* It was left in the store, and was in force after the next start without an event. */
void test_abort_leaves_no_table_in_the_store_that_could_not_be_made(void)
{
    for (uint32_t ticks = 0u; ticks < 6u; ticks++) {
        given_idle();
        stage_config();
        activated();
        spoil_staged();
        world_ticks(ticks);
        (void)world_cmd(KC_CMD_ABORT, 0, 0, 0);
        world_tick();
        TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP)); /* it does not wait */
        world_ticks(3u);
        TEST_ASSERT_EQUAL_HEX32(s_before, kc_app_active(APP)->crc[KC_TBL_CONFIG]);
        TEST_ASSERT_EQUAL_HEX32(s_before, kc_tbl_image_crc(world.store[KC_TBL_CONFIG][0], 16u));
        TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_STORE_REFUSED));
        TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
        stage_config(); /* the next upload is as always */
        TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_TABLE_ACTIVATE, KC_TBL_CONFIG, (int32_t)s_crc, 0));
        s_before = s_crc;
        expect_of_before_after_a_restart();
    }
}

/* Ticks after which memory that has changed is found. */
static uint32_t given_changed_kernel(void)
{
    uint32_t n = 0u;
    for (uint32_t again = 0u; again < 2u; again++) {
        given_idle();
        stage_config();
        APP->tables.active.kernel.sigma_eps *= 2.0;
        for (; again == 0u && n < 2000u && world_events(KC_EVT_MEMORY_TABLE) == 0u; n++) { world_tick(); }
    }
    TEST_ASSERT_TRUE(n > 9u && n < 2000u);
    return n;
}

/* Memory that has changed is found in the very step that asks for the table to be stored. */
void test_an_abort_in_the_step_that_asks_for_a_table_withdraws_it(void)
{
    world_ticks(given_changed_kernel() - 1u);
    activated();
    world_tick();
    TEST_ASSERT_EQUAL_INT(KC_CMD_TABLE_ACTIVATE, world.ack.opcode);
    TEST_ASSERT_EQUAL_INT(KC_EVT_CAL_ABORTED, world.ack.event_id);
    TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
    TEST_ASSERT_NULL(stored_in_step(KC_TBL_CONFIG));
    TEST_ASSERT_NOT_NULL(stored_in_step(KC_STORE_JOURNAL));
    TEST_ASSERT_EQUAL_UINT32(2u, world.out.n_store); /* records of the command and of the abort */
    world_ticks(2u);
    expect_of_before_after_a_restart();
}

/* Also where the image of before is asked for in the very step that finds the memory changed. */
void test_changed_memory_in_any_step_of_a_put_back_leaves_the_table_of_before(void)
{
    for (uint32_t early = 1u; early < 9u; early++) {
        world_ticks(given_changed_kernel() - early);
        activated();
        spoil_staged();
        world_ticks(12u);
        TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_MEMORY_TABLE));
        TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
        expect_of_before_after_a_restart();
    }
}
