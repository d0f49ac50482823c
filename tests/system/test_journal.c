/* kc_journal.c: the record that survives power loss. */
#include <string.h>

#include "given_world.h"
#include "kc_crc.h"
#include "kc_verdict.h"
#include "unity.h"

#define APP (&kc_app_instance)

static uint8_t s_rec[KC_JOURNAL_BYTES];

void setUp(void) { given_world(); }

static void given_record(void)
{
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 300u));
    TEST_ASSERT_EQUAL_UINT32(KC_JOURNAL_BYTES, world.stored[KC_STORE_JOURNAL][0]);
    memcpy(s_rec, world.store[KC_STORE_JOURNAL][0], sizeof s_rec);
    kc_app_init(APP);
}

static void reseal(void)
{
    uint32_t crc = kc_crc32(0u, s_rec, KC_JOURNAL_BYTES - 4u);
    for (uint32_t i = 0u; i < 4u; i++) { s_rec[KC_JOURNAL_BYTES - 4u + i] = (uint8_t)(crc >> (8u * i)); }
}

void test_a_record_says_state_session_pose_and_candidate(void)
{
    given_record();
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_app_load(APP, KC_STORE_JOURNAL, s_rec, sizeof s_rec));
    TEST_ASSERT_EQUAL_UINT32(KC_ST_MEASURE, APP->journal.found.state);
    TEST_ASSERT_EQUAL_UINT32(1u, APP->journal.found.session);
    TEST_ASSERT_EQUAL_UINT32(0u, APP->journal.found.pose);
    TEST_ASSERT_EQUAL_INT(0, APP->journal.found.candidate);
    TEST_ASSERT_EQUAL_UINT32(1u, APP->journal.found.boot_count);
    TEST_ASSERT_EQUAL_MEMORY("KCJ5", s_rec, 4u);
}

void test_a_damaged_record_is_refused_and_the_older_one_is_taken(void)
{
    given_record();
    TEST_ASSERT_EQUAL_INT(KC_ERR_FORMAT, kc_app_load(APP, KC_STORE_JOURNAL, s_rec, sizeof s_rec - 1u));
    s_rec[9] ^= 4u;
    TEST_ASSERT_EQUAL_INT(KC_ERR_CRC, kc_app_load(APP, KC_STORE_JOURNAL, s_rec, sizeof s_rec));
    s_rec[9] ^= 4u;
    s_rec[4] = 99u; /* no such state */
    reseal();
    TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, kc_app_load(APP, KC_STORE_JOURNAL, s_rec, sizeof s_rec));
    TEST_ASSERT_EQUAL_UINT32(0u, APP->journal.found.boot_count);
    s_rec[4] = KC_ST_IDLE;
    reseal();
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_app_load(APP, KC_STORE_JOURNAL, s_rec, sizeof s_rec));
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, kc_app_load(APP, KC_STORE_JOURNAL, s_rec, sizeof s_rec));
    TEST_ASSERT_EQUAL_UINT32(1u, APP->boot_events.n); /* one word for each kind of store */
}

void test_every_change_of_state_is_stored_in_the_step_that_makes_it(void)
{
    kc_state_t last;
    world_boot();
    world_tick();
    (void)world_do(KC_CMD_START, -1, 2, 1);
    for (uint32_t i = 0u; i < 400u && (world_calibrating() || kc_app_state(APP) == KC_ST_STORE); i++) {
        last = kc_app_state(APP);
        world_tick();
        if (kc_app_state(APP) == last || kc_app_state(APP) == KC_ST_STORE) { continue; }
        const uint8_t *rec = world.out.store[world.out.n_store - 1u].data;
        TEST_ASSERT_EQUAL_UINT16(KC_STORE_JOURNAL, world.out.store[world.out.n_store - 1u].kind);
        TEST_ASSERT_EQUAL_UINT8(kc_app_state(APP), rec[4]);
    }
    TEST_ASSERT_FALSE(world_calibrating());
}

void test_a_quiet_component_stores_nothing(void)
{
    world_boot();
    world_ticks(2u); /* the record twice, since keys have got their counters */
    for (uint32_t i = 0u; i < 20u; i++) {
        world_tick();
        TEST_ASSERT_EQUAL_UINT32(0u, world.out.n_store);
    }
}

void test_a_record_that_could_not_be_stored_is_tried_again_each_second_and_reported_once(void)
{
    world_boot();
    world_tick();
    world.store_fails = -1;
    (void)world_do(KC_CMD_ABORT, 0, 0, 0); /* to SAFE: a new record */
    world_ticks(35u);
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_STORE_FAIL));
    TEST_ASSERT_EQUAL_INT((int32_t)KC_STORE_JOURNAL, world.last[KC_EVT_STORE_FAIL].index);
    TEST_ASSERT_EQUAL_UINT8(KC_ST_IDLE, world.store[KC_STORE_JOURNAL][0][4]);
    world.store_fails = 0;
    world_ticks(12u);
    TEST_ASSERT_EQUAL_UINT8(KC_ST_SAFE, world.store[KC_STORE_JOURNAL][0][4]);
    world.store_fails = 1;
    (void)world_do(KC_CMD_START, -1, 0, 1);
    world_ticks(3u);
    TEST_ASSERT_EQUAL_UINT32(2u, world_events(KC_EVT_STORE_FAIL)); /* news again */
}

/* ---- the former record: counters that belong to no key ---- */

static void put(uint32_t at, uint64_t x, uint32_t bytes)
{
    for (uint32_t i = 0u; i < bytes; i++) { s_rec[at + i] = (uint8_t)(x >> (8u * i)); }
}

#define FORMER_BYTES 96u

static void given_former(uint64_t counter)
{
    memset(s_rec, 0, sizeof s_rec);
    memcpy(s_rec, "KCJ3", 4u);
    put(4u, KC_ST_SAFE, 4u);
    put(8u, 17u, 4u); /* session */
    put(16u, 5u, 4u); /* boots */
    put(28u, 0xffffffffu, 4u); /* no candidate */
    put(44u, 0u, 4u); /* prev_crc */
    for (uint32_t i = 0u; i < 4u; i++) { put(48u + 8u * i, counter + i, 8u); }
    put(FORMER_BYTES - 4u, kc_crc32(0u, s_rec, FORMER_BYTES - 4u), 4u);
    memcpy(world.store[KC_STORE_JOURNAL][0], s_rec, FORMER_BYTES);
    world.stored[KC_STORE_JOURNAL][0] = FORMER_BYTES;
}

void test_a_record_of_the_former_layout_is_read_and_its_counters_become_those_of_every_key(void)
{
    world.keys.n = 2u;
    world.keys.key[1] = (kc_key_t){.id = 2u, .secret = {1u}};
    given_former(1000u);
    world_boot();
    world_tick();
    TEST_ASSERT_EQUAL_UINT32(17u, APP->cal.session);
    TEST_ASSERT_EQUAL_UINT32(6u, world.hk.boot_count);
    TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_BOOT_NO_JOURNAL) +
                                     world_events(KC_EVT_BOOT_JOURNAL_LOST) +
                                     world_events(KC_EVT_BOOT_SLOT_BAD));
    for (uint32_t k = 0u; k < 2u; k++) {
        const kc_counted_t *c = kc_counters_of(&APP->cmd_log.counters, k + 1u);
        TEST_ASSERT_NOT_NULL(c);
        TEST_ASSERT_EQUAL_UINT64(1000u, c->last[0][0]);
        TEST_ASSERT_EQUAL_UINT64(1003u, c->last[1][1]);
    }
    (void)world_cmd(KC_CMD_TABLE_DISCARD, 0, 0, 0);
    world.counter = 999u; /* the next is the last one taken */
    world_tick();
    TEST_ASSERT_EQUAL_INT(KC_EVT_CMD_REPLAYED, world.ack.event_id);
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_TABLE_DISCARD, 0, 0, 0));
    TEST_ASSERT_EQUAL_MEMORY("KCJ5", world.store[KC_STORE_JOURNAL][0], 4u);
}

/* Without keys they have no owner yet, and wait. */
void test_counters_of_the_former_layout_outlive_a_start_without_keys(void)
{
    given_former(1000u);
    world.keys.n = 0u;
    world_boot();
    world_ticks(3u);
    TEST_ASSERT_EQUAL_MEMORY("KCJ5", world.store[KC_STORE_JOURNAL][0], 4u);
    world.keys.n = 1u;
    world_restart();
    world_tick();
    TEST_ASSERT_EQUAL_UINT64(1000u, kc_counters_of(&APP->cmd_log.counters, 1u)->last[0][0]);
    world.keys.key[0].id = 2u; /* a new key begins anew */
    world_restart();
    world_tick();
    TEST_ASSERT_EQUAL_UINT64(0u, kc_counters_of(&APP->cmd_log.counters, 2u)->last[0][0]);
}

void test_a_damaged_record_of_the_former_layout_is_refused(void)
{
    given_former(1000u);
    kc_app_init(APP);
    TEST_ASSERT_EQUAL_INT(KC_ERR_FORMAT, kc_app_load(APP, KC_STORE_JOURNAL, s_rec, FORMER_BYTES - 1u));
    s_rec[50] ^= 1u;
    TEST_ASSERT_EQUAL_INT(KC_ERR_CRC, kc_app_load(APP, KC_STORE_JOURNAL, s_rec, FORMER_BYTES));
    s_rec[50] ^= 1u;
    memcpy(s_rec, "KCJ5", 4u); /* of another length */
    put(FORMER_BYTES - 4u, kc_crc32(0u, s_rec, FORMER_BYTES - 4u), 4u);
    TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, kc_app_load(APP, KC_STORE_JOURNAL, s_rec, FORMER_BYTES));
}

/* ---- the record before this one: counters of two keys ---- */

#define TWO_KEYS_BYTES 144u

static void given_two_keys(void)
{
    memset(s_rec, 0, sizeof s_rec);
    memcpy(s_rec, "KCJ4", 4u);
    put(4u, KC_ST_SAFE, 4u);
    put(8u, 17u, 4u); /* session */
    put(16u, 5u, 4u); /* boots */
    put(28u, 0xffffffffu, 4u); /* no candidate */
    for (uint32_t k = 0u; k < 2u; k++) {
        put(48u + 44u * k, 1u + k, 4u);
        put(52u + 44u * k, 70u + k, 8u); /* since */
        for (uint32_t i = 0u; i < 4u; i++) { put(60u + 44u * k + 8u * i, 1000u * (k + 1u) + i, 8u); }
    }
    put(136u, 2u, 4u); /* verdict */
    put(TWO_KEYS_BYTES - 4u, kc_crc32(0u, s_rec, TWO_KEYS_BYTES - 4u), 4u);
    memcpy(world.store[KC_STORE_JOURNAL][0], s_rec, TWO_KEYS_BYTES);
    world.stored[KC_STORE_JOURNAL][0] = TWO_KEYS_BYTES;
}

void test_a_record_with_two_keys_is_read_whole_and_the_next_one_has_room_for_four(void)
{
    given_two_keys();
    world.keys.n = 4u;
    for (uint32_t k = 1u; k < 4u; k++) { world.keys.key[k] = (kc_key_t){.id = k == 1u ? 2u : 99u + k}; }
    world_boot();
    world_ticks(2u);
    TEST_ASSERT_EQUAL_UINT32(17u, APP->cal.session);
    TEST_ASSERT_EQUAL_UINT32(6u, world.hk.boot_count);
    TEST_ASSERT_EQUAL_UINT32(KC_VERDICT_POOR, APP->journal.found.proposal_verdict);
    for (uint32_t k = 0u; k < 2u; k++) {
        const kc_counted_t *c = kc_counters_of(&APP->cmd_log.counters, k + 1u);
        TEST_ASSERT_NOT_NULL(c);
        TEST_ASSERT_EQUAL_UINT64(70u + k, c->since_us);
        TEST_ASSERT_EQUAL_UINT64(1000u * (k + 1u), c->last[0][0]);
        TEST_ASSERT_EQUAL_UINT64(1000u * (k + 1u) + 3u, c->last[1][1]);
    }
    TEST_ASSERT_NOT_NULL(kc_counters_of(&APP->cmd_log.counters, 101u));
    TEST_ASSERT_NOT_NULL(kc_counters_of(&APP->cmd_log.counters, 102u));
    TEST_ASSERT_EQUAL_MEMORY("KCJ5", world.store[KC_STORE_JOURNAL][0], 4u);
    world_restart();
    world_tick();
    TEST_ASSERT_EQUAL_UINT64(2003u, kc_counters_of(&APP->cmd_log.counters, 2u)->last[1][1]);
    TEST_ASSERT_NOT_NULL(kc_counters_of(&APP->cmd_log.counters, 102u));
}
