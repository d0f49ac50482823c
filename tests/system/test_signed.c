/* kc_signed.c: which bytes are signed, and that no stranger gets past them: by way of kc_app_step. */
#include <stddef.h>
#include <string.h>

#include "given_tables.h"
#include "given_world.h"
#include "kc_signed.h"
#include "unity.h"

#define APP (&kc_app_instance)

static kc_table_chunk_t s_chunk;

void setUp(void)
{
    given_world();
    world_boot();
    world_ticks(2u);
    world.arm_silent = world.pantilt_silent = true; /* commands are all that comes in */
}

static kc_cmd_t given_start(void)
{
    kc_cmd_t c = {
        .t_us = world.now_us, .seq = 7, .source = 1, .opcode = KC_CMD_START, .arg_i = {-1, 4, 3, 0}};
    world_sign_cmd(&c);
    return c;
}

static const kc_table_chunk_t *given_chunk(void)
{
    world.config.n_poses = 9u;
    uint32_t n = given_image(KC_TBL_CONFIG, &world.config, world.image);
    s_chunk = (kc_table_chunk_t){.t_us = world.now_us, .kind = KC_TBL_CONFIG, .total = n, .n = n};
    memcpy(s_chunk.data, world.image, n);
    world_sign_chunk(&s_chunk);
    return &s_chunk;
}

static void send(const kc_cmd_t *c)
{
    world.as_sent = true;
    world.in.cmd[world.in.n_cmd++] = *c;
    world_tick();
}

static void send_chunk(const kc_table_chunk_t *c)
{
    world.as_sent = true;
    world.in.chunk[world.in.n_chunk++] = *c;
    world_tick();
}

static uint32_t refusals(void)
{
    return world_events(KC_EVT_CMD_UNSIGNED) + world_events(KC_EVT_CMD_KEY) +
           world_events(KC_EVT_CMD_FORGED) + world_events(KC_EVT_CMD_REPLAYED) +
           world_events(KC_EVT_CMD_SOURCE);
}

/* Refused with one event, and nothing changed: no table, no state, no counter. */
static void refused(const kc_cmd_t *c)
{
    kc_cmd_log_t log = APP->cmd_log;
    uint32_t before = refusals();
    world_remember();
    send(c);
    TEST_ASSERT_EQUAL_UINT32(before + 1u, refusals());
    TEST_ASSERT_TRUE(world.ack.status == KC_ERR_AUTH || world.ack.status == KC_ERR_STALE ||
                     world.ack.status == KC_ERR_ARG);
    TEST_ASSERT_TRUE(world_unchanged());
    TEST_ASSERT_EQUAL_MEMORY(&log.counters, &APP->cmd_log.counters, sizeof log.counters);
    TEST_ASSERT_EQUAL_MEMORY(log.seq, APP->cmd_log.seq, sizeof log.seq);
}

static void refused_chunk(const kc_table_chunk_t *c)
{
    kc_cmd_log_t log = APP->cmd_log;
    uint32_t before = refusals();
    world_remember();
    send_chunk(c);
    TEST_ASSERT_EQUAL_UINT32(before + 1u, refusals());
    TEST_ASSERT_TRUE(world_unchanged());
    TEST_ASSERT_EQUAL_MEMORY(&log.counters, &APP->cmd_log.counters, sizeof log.counters);
}

static int32_t taken(const kc_cmd_t *c)
{
    uint32_t before = refusals();
    send(c);
    TEST_ASSERT_EQUAL_UINT32(before, refusals());
    return world.ack.status;
}

/* ---- layout ---- */

/* ---- strangers ---- */

static bool is_padding(size_t at)
{
    size_t key_end = offsetof(kc_cmd_t, auth.key_id) + 4u, arg_end = offsetof(kc_cmd_t, arg_i) + 16u;
    return (at >= key_end && at < offsetof(kc_cmd_t, auth.counter)) ||
           (at >= arg_end && at < offsetof(kc_cmd_t, arg_u64)) ||
           at >= offsetof(kc_cmd_t, stopped); /* and what nobody sends */
}

void test_a_command_with_any_bit_flipped_changes_nothing(void)
{
    const kc_cmd_t good = given_start();
    uint32_t n = 0u;
    for (uint32_t bit = 0u; bit < 8u * sizeof good; bit++) {
        kc_cmd_t c = good;
        if (is_padding(bit / 8u)) { continue; }
        ((uint8_t *)&c)[bit / 8u] ^= (uint8_t)(1u << bit % 8u);
        refused(&c);
        n++;
    }
    TEST_ASSERT_EQUAL_UINT32(8u * (KC_SIGNED_HEAD_MAX - 16u + KC_MAC_BYTES), n); /* no label, but the MAC */
    world.arm_silent = world.pantilt_silent = false;
    world_ticks(2u);
    TEST_ASSERT_EQUAL_INT(KC_OK, taken(&good));
    TEST_ASSERT_TRUE(world_calibrating());
}

void test_a_chunk_with_any_bit_flipped_changes_nothing(void)
{
    static kc_table_chunk_t good;
    good = *given_chunk();
    for (uint32_t bit = 0u; bit < 8u * KC_CHUNK_BYTES; bit += 7u) { /* every bit: test_kc_auth.c */
        s_chunk = good;
        s_chunk.data[bit / 8u] ^= (uint8_t)(1u << bit % 8u);
        refused_chunk(&s_chunk);
    }
    uint32_t *fields[] = {
        (uint32_t *)&s_chunk.source, (uint32_t *)&s_chunk.kind, &s_chunk.total, &s_chunk.offset, &s_chunk.n,
        &s_chunk.auth.key_id};
    for (uint32_t f = 0u; f < 6u; f++) {
        for (uint32_t bit = 0u; bit < 32u; bit++) {
            s_chunk = good;
            *fields[f] ^= 1u << bit;
            refused_chunk(&s_chunk);
        }
    }
    for (uint32_t bit = 0u; bit < 64u; bit++) {
        s_chunk = good;
        s_chunk.auth.counter ^= 1ull << bit;
        refused_chunk(&s_chunk);
        s_chunk = good;
        s_chunk.t_us ^= 1ull << bit;
        refused_chunk(&s_chunk);
    }
    TEST_ASSERT_EQUAL_INT(KC_STAGE_NONE, APP->tables.staging.state);
    send_chunk(&good);
    TEST_ASSERT_TRUE(APP->tables.staging.state != KC_STAGE_NONE);
}

void test_what_changes_anything_is_refused_without_a_signature(void)
{
    static const int32_t all[] = {KC_CMD_START,
                                  KC_CMD_APPROVE_ARM,
                                  KC_CMD_APPROVE_GO,
                                  KC_CMD_REJECT,
                                  KC_CMD_ROLLBACK,
                                  KC_CMD_TABLE_VALIDATE,
                                  KC_CMD_TABLE_ACTIVATE,
                                  KC_CMD_TABLE_DISCARD,
                                  11,
                                  -1};
    for (uint32_t i = 0u; i < sizeof all / sizeof all[0]; i++) {
        const kc_cmd_t c = {.seq = (int32_t)i + 1, .source = 2, .opcode = all[i]};
        uint32_t before = world_events(KC_EVT_CMD_UNSIGNED);
        refused(&c);
        TEST_ASSERT_EQUAL_UINT32(before + 1u, world_events(KC_EVT_CMD_UNSIGNED));
        TEST_ASSERT_EQUAL_INT(KC_ERR_AUTH, world.ack.status);
    }
    s_chunk = *given_chunk();
    s_chunk.auth.key_id = 0u;
    refused_chunk(&s_chunk);
}

void test_without_keys_nothing_can_be_changed_and_events_say_so(void)
{
    const kc_cmd_t start = given_start();
    kc_cmd_t noop = {.seq = 1, .source = 1, .opcode = KC_CMD_NOOP};
    world.keys.n = 0u;
    world_boot();
    world_tick();
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_BOOT_NO_KEYS));
    refused(&start);
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CMD_KEY));
    TEST_ASSERT_EQUAL_INT(KC_OK, taken(&noop));
    noop.opcode = KC_CMD_ABORT;
    TEST_ASSERT_EQUAL_INT(KC_OK, taken(&noop));
    TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
}

void test_abort_is_taken_with_any_signature_or_none(void)
{
    kc_cmd_t c = {.seq = 1, .source = 1, .opcode = KC_CMD_ABORT};
    for (uint32_t i = 0u; i < 3u; i++) {
        setUp();
        c.auth.key_id = i; /* none; of a known key, forged; of an unknown key */
        TEST_ASSERT_EQUAL_INT(KC_OK, taken(&c));
        TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
    }
}

void test_a_number_of_a_stranger_does_not_lock_a_signed_sender_out(void)
{
    kc_cmd_t stranger = {.seq = 1000, .source = 1, .opcode = KC_CMD_NOOP}, own = stranger;
    TEST_ASSERT_EQUAL_INT(KC_OK, taken(&stranger));
    own.seq = 2;
    world_sign_cmd(&own);
    TEST_ASSERT_EQUAL_INT(KC_OK, taken(&own));
    stranger.auth.key_id = 1u;
    stranger.auth.counter = UINT64_MAX;
    refused(&stranger);
    own.seq = 3;
    world_sign_cmd(&own);
    TEST_ASSERT_EQUAL_INT(KC_OK, taken(&own));
}

void test_a_chunk_is_no_command_and_sources_and_channels_have_counters_of_their_own(void)
{
    kc_cmd_t c = {.seq = 1, .source = 2, .opcode = KC_CMD_TABLE_DISCARD};
    s_chunk = *given_chunk();
    c.auth = s_chunk.auth; /* the MAC of a chunk */
    refused(&c);
    world_sign_cmd(&c);
    send_chunk(&s_chunk); /* signed before the command */
    TEST_ASSERT_EQUAL_INT(KC_OK, taken(&c));
    c.source = 1;
    refused(&c); /* the same signature from another source */
    world.counter = 0u;
    world_sign_cmd(&c);
    TEST_ASSERT_EQUAL_INT(KC_OK, taken(&c)); /* the executive has counters of its own */
}

/* ---- repeated, reordered, after a restart ---- */

void test_a_repeated_or_overtaken_command_is_refused(void)
{
    kc_cmd_t first = {.seq = 1, .source = 2, .opcode = KC_CMD_TABLE_DISCARD}, second = first;
    world_sign_cmd(&first);
    world_sign_cmd(&second);
    TEST_ASSERT_EQUAL_INT(KC_OK, taken(&second));
    refused(&first);
    refused(&second);
    TEST_ASSERT_EQUAL_UINT32(2u, world_events(KC_EVT_CMD_REPLAYED));
    TEST_ASSERT_EQUAL_DOUBLE((double)second.auth.counter, world.last[KC_EVT_CMD_REPLAYED].want);
}

/* Power is lost right after the step that took them; then again with the newest record of the journal lost too. */
void test_nothing_that_was_taken_is_taken_again_after_a_restart(void)
{
    for (uint32_t lost = 0u; lost < 2u; lost++) {
        setUp();
        kc_cmd_t c = {.seq = 1, .source = 2, .opcode = KC_CMD_TABLE_DISCARD};
        world_sign_cmd(&c);
        TEST_ASSERT_EQUAL_INT(KC_OK, taken(&c));
        send_chunk(given_chunk());
        if (lost > 0u) {
            world_tick(); /* writes the second copy */
            world.stored[KC_STORE_JOURNAL][0] = 0u;
        }
        world_restart();
        world_tick();
        TEST_ASSERT_EQUAL_INT(KC_STAGE_NONE, APP->tables.staging.state);
        refused(&c);
        refused_chunk(&s_chunk);
        TEST_ASSERT_EQUAL_UINT32(2u, world_events(KC_EVT_CMD_REPLAYED));
        world_sign_cmd(&c);
        TEST_ASSERT_EQUAL_INT(KC_OK, taken(&c));
    }
}

/* Refused for its state: its counter is used up all the same, so that it is not done later. */
void test_a_refused_command_is_not_taken_after_a_restart_either(void)
{
    kc_cmd_t c = given_start();
    world_ticks(25u);
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, taken(&c)); /* the arm is silent */
    world_restart();
    world.arm_silent = world.pantilt_silent = false;
    world_ticks(2u);
    uint32_t before = world_events(KC_EVT_CMD_REPLAYED);
    send(&c);
    TEST_ASSERT_EQUAL_UINT32(before + 1u, world_events(KC_EVT_CMD_REPLAYED));
    TEST_ASSERT_FALSE(world_calibrating());
}

static void given_keys(uint32_t first, uint32_t n)
{
    world.keys.n = n;
    for (uint32_t k = 0u; k < n; k++) {
        world.keys.key[k] = (kc_key_t){.id = first + k, .secret = {(uint8_t)(first + k)}};
    }
}

static kc_cmd_t given_discard(void)
{
    kc_cmd_t c = {.seq = 1, .source = 2, .opcode = KC_CMD_TABLE_DISCARD};
    world_sign_cmd(&c);
    return c;
}

static void restart(void)
{
    world_restart();
    world_tick();
}

/* 1; 1 and 2, 1 signs; 2. */
void test_both_keys_of_a_rotation_are_taken_and_a_retired_one_is_not(void)
{
    given_keys(1u, 2u);
    restart();
    kc_cmd_t c = given_discard();
    TEST_ASSERT_EQUAL_INT(KC_OK, taken(&c));
    kc_cmd_t old = given_discard();
    given_keys(2u, 1u);
    kc_cmd_t own = given_discard();
    TEST_ASSERT_EQUAL_INT(KC_OK, taken(&own)); /* flight still has both */
    restart();
    refused(&old);
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CMD_KEY));
    refused(&own);
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CMD_REPLAYED));
}

/* Counters belong to keys: what one key has used up is no bound for another. */
void test_a_key_whose_numbers_are_used_up_is_replaced_by_another_one(void)
{
    APP->cmd_log.counters.key[0].last[KC_SIGNED_CMD][1] = UINT64_MAX;
    kc_cmd_t c = given_discard();
    refused(&c);
    world_ticks(2u);
    given_keys(1u, 2u); /* rotated; the new one signs after retire */
    restart();
    given_keys(2u, 1u);
    restart();
    c = given_discard();
    TEST_ASSERT_EQUAL_INT(KC_OK, taken(&c));
}

void test_a_wild_counter_locks_nobody_out(void)
{
    const uint64_t wild[] = {UINT64_MAX, INT64_MAX, 1ull << 62, KC_AUTH_JUMP_MAX + 100u};
    for (uint32_t i = 0u; i < 4u; i++) {
        kc_cmd_t c = {.seq = 1, .source = 2, .opcode = KC_CMD_TABLE_DISCARD}, own = c;
        uint64_t counter = world.counter;
        world.counter = wild[i] - 1u;
        world_sign_cmd(&c); /* by a holder of the key */
        world.counter = counter;
        uint32_t before = world_events(KC_EVT_CMD_COUNTER);
        send(&c);
        TEST_ASSERT_EQUAL_UINT32(before + 1u, world_events(KC_EVT_CMD_COUNTER));
        TEST_ASSERT_EQUAL_DOUBLE((double)wild[i], world.last[KC_EVT_CMD_COUNTER].got);
        TEST_ASSERT_DOUBLE_WITHIN(100.0, (double)KC_AUTH_JUMP_MAX, world.last[KC_EVT_CMD_COUNTER].want);
        TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, world.ack.status);
        world_sign_cmd(&own);
        TEST_ASSERT_EQUAL_INT(KC_OK, taken(&own));
    }
}

/* ---- age ---- */

static void too_old(const kc_cmd_t *c, int32_t event)
{
    uint32_t before = world_events((uint32_t)event);
    world_remember();
    send(c);
    TEST_ASSERT_EQUAL_UINT32(before + 1u, world_events((uint32_t)event));
    TEST_ASSERT_EQUAL_INT(KC_ERR_STALE, world.ack.status);
    TEST_ASSERT_EQUAL_INT(event, world.ack.event_id);
    TEST_ASSERT_TRUE(world_unchanged());
}

static kc_cmd_t given_discard_at(int64_t ago_us)
{
    kc_cmd_t c = {.t_us = (uint64_t)((int64_t)world.now_us - ago_us), .seq = 1, .source = 2};
    c.opcode = KC_CMD_TABLE_DISCARD;
    world_sign_cmd(&c);
    return c;
}

#define DAY_US 86400000000ll

/* Held back, so that no later one was taken: a recorder could run it whenever he liked. */
void test_a_start_that_was_suppressed_is_not_taken_days_later(void)
{
    const kc_cmd_t start = given_start();
    world.now_us += 3u * (uint64_t)DAY_US;
    world_tick(); /* TIME_STEP */
    too_old(&start, KC_EVT_CMD_OLD);
    TEST_ASSERT_EQUAL_DOUBLE(3.6e9, world.last[KC_EVT_CMD_OLD].want);
    TEST_ASSERT_DOUBLE_WITHIN(1e7, 3.0 * (double)DAY_US, world.last[KC_EVT_CMD_OLD].got);
    TEST_ASSERT_FALSE(world_calibrating());
    uint32_t before = world_events(KC_EVT_CMD_REPLAYED); /* its counter is used up */
    send(&start);
    TEST_ASSERT_EQUAL_UINT32(before + 1u, world_events(KC_EVT_CMD_REPLAYED));
}

void test_the_largest_age_is_that_of_config_before_and_after_now(void)
{
    world.now_us += (uint64_t)DAY_US;
    world_tick();
    kc_cmd_t c = given_discard_at(3600000000ll - TICK_US); /* an hour, when it is handled */
    TEST_ASSERT_EQUAL_INT(KC_OK, taken(&c));
    c = given_discard_at(3600000000ll - TICK_US + 1);
    too_old(&c, KC_EVT_CMD_OLD);
    c = given_discard_at(-3600000000ll - TICK_US);
    TEST_ASSERT_EQUAL_INT(KC_OK, taken(&c));
    c = given_discard_at(-3600000000ll - TICK_US - 1);
    too_old(&c, KC_EVT_CMD_OLD);
    APP->tables.active.config.signed_age_max_us = 0u;
    world_seal(KC_TBL_CONFIG);
    c = given_discard_at(-DAY_US);
    TEST_ASSERT_EQUAL_INT(KC_OK, taken(&c));
}

void test_an_old_chunk_is_refused_too(void)
{
    const kc_table_chunk_t *c = given_chunk();
    world.now_us += 2u * (uint64_t)DAY_US;
    send_chunk(c);
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CMD_OLD));
    TEST_ASSERT_EQUAL_INT(KC_STAGE_NONE, APP->tables.staging.state);
}

/* ABORT and what is stamped by flight's own telemetry are taken whatever flight's clock says. */
void test_a_clock_that_was_set_wrong_stops_nobody_who_stamps_by_it(void)
{
    for (int64_t wrong_us = -365 * DAY_US; wrong_us <= 365 * DAY_US; wrong_us += 2 * 365 * DAY_US) {
        setUp();
        world.now_us += 1000u * (uint64_t)DAY_US;
        world_tick();
        world.skew_us = wrong_us;
        world_tick();
        TEST_ASSERT_TRUE(world_events(KC_EVT_TIME_STEP) >= 1u);
        kc_cmd_t c = given_discard_at(0); /* by the true clock */
        too_old(&c, KC_EVT_CMD_OLD);
        c = given_discard(); /* by flight's */
        TEST_ASSERT_EQUAL_INT(KC_OK, taken(&c));
        world.skew_us = 0; /* and it is set right again */
        world_tick();
        c = given_discard();
        TEST_ASSERT_EQUAL_INT(KC_OK, taken(&c));
    }
}

/* ---- without a journal ---- */

static void lose_journal(bool damaged)
{
    for (uint32_t copy = 0u; copy < 2u; copy++) {
        if (damaged) { world.store[KC_STORE_JOURNAL][copy][9] ^= 4u; }
        if (!damaged) { world.stored[KC_STORE_JOURNAL][copy] = 0u; }
    }
}

void test_with_both_copies_of_the_journal_gone_nothing_from_before_is_taken(void)
{
    for (int damaged = 0; damaged < 2; damaged++) {
        setUp();
        TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_BOOT_NO_JOURNAL));
        world.arm_silent = world.pantilt_silent = false;
        world_tick();
        kc_cmd_t start = given_start(), abort = {.seq = 9, .source = 2, .opcode = KC_CMD_ABORT};
        TEST_ASSERT_EQUAL_INT(KC_OK, taken(&start));
        TEST_ASSERT_EQUAL_INT(KC_OK, taken(&abort));
        world_ticks(3u);
        lose_journal(damaged != 0);
        restart();
        TEST_ASSERT_EQUAL_UINT32(damaged != 0 ? 1u : 0u, world_events(KC_EVT_BOOT_JOURNAL_LOST));
        TEST_ASSERT_EQUAL_UINT32(damaged != 0 ? 0u : 1u, world_events(KC_EVT_BOOT_NO_JOURNAL));
        for (int again = 0; again < 2; again++) { /* and after another restart */
            send(&start);
            TEST_ASSERT_EQUAL_INT(KC_ERR_STALE, world.ack.status);
            TEST_ASSERT_FALSE(world_calibrating());
            world_ticks(2u);
            restart();
        }
        TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_BOOT_NO_JOURNAL) +
                                         world_events(KC_EVT_BOOT_JOURNAL_LOST));
        world.arm_silent = world.pantilt_silent = false;
        world_ticks(2u);
        start = given_start();
        TEST_ASSERT_EQUAL_INT(KC_OK, taken(&start));
        TEST_ASSERT_TRUE(world_calibrating());
    }
}

/* One that was made before is refused by its time: the first one here says so, whatever its counter. */
void test_what_was_made_before_flight_knew_the_key_is_refused_with_both_times(void)
{
    kc_cmd_t c = given_discard(), later;
    lose_journal(false);
    world_ticks(5u);
    lose_journal(false);
    world_restart();
    world_tick();
    uint64_t since_us = world.now_us;
    later = given_discard();
    too_old(&c, KC_EVT_CMD_BEFORE);
    TEST_ASSERT_EQUAL_DOUBLE((double)c.t_us, world.last[KC_EVT_CMD_BEFORE].got);
    TEST_ASSERT_EQUAL_DOUBLE((double)since_us, world.last[KC_EVT_CMD_BEFORE].want);
    TEST_ASSERT_EQUAL_INT(KC_OK, taken(&later)); /* made in the first step: as old as the key here */
}

/* A waiting correction can only come from an earlier run. */
void test_a_store_with_more_than_a_journal_in_it_was_used_before(void)
{
    world.stored[KC_STORE_PROPOSAL][0] = given_image(KC_TBL_CONFIG, &world.config,
                                                     world.store[KC_STORE_PROPOSAL][0]);
    lose_journal(false);
    restart();
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_BOOT_JOURNAL_LOST));
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_BOOT_NO_JOURNAL));
    world.keys.n = 0u; /* nothing signed is taken anyway */
    lose_journal(false);
    restart();
    TEST_ASSERT_EQUAL_UINT32(0u,
                             world_events(KC_EVT_BOOT_JOURNAL_LOST) + world_events(KC_EVT_BOOT_NO_JOURNAL));
}

/* ---- dumps ---- */

void test_a_stranger_does_not_stop_a_dump(void)
{
    kc_cmd_t dump = {.seq = 1, .source = 2, .opcode = KC_CMD_TABLE_DUMP, .arg_i = {KC_TBL_SPACE}};
    kc_cmd_t stranger = dump;
    world_sign_cmd(&dump);
    TEST_ASSERT_EQUAL_INT(KC_OK, taken(&dump));
    uint32_t n = (world.out.table_down.total - 1u) / KC_CHUNK_BYTES; /* chunks after the first */
    TEST_ASSERT_TRUE(n >= 1u);
    for (uint32_t i = 1u; i <= n; i++) {
        stranger.seq = 2 + (int32_t)i;
        send(&stranger);
        TEST_ASSERT_EQUAL_INT(KC_ERR_AUTH, world.ack.status);
        TEST_ASSERT_EQUAL_UINT8(1u, world.out.has_table_down);
        TEST_ASSERT_EQUAL_UINT32(i * KC_CHUNK_BYTES, world.out.table_down.offset);
    }
}

/* ---- what the edge asks ---- */

void test_it_is_vouched_for_what_a_step_would_take(void)
{
    uint32_t macs = 3u;
    kc_cmd_t c = given_discard(), bad;
    TEST_ASSERT_TRUE(kc_app_vouches_cmd(APP, &c, &macs));
    TEST_ASSERT_EQUAL_UINT32(2u, macs);
    bad = c;
    bad.arg_i[0] = 1;
    TEST_ASSERT_FALSE(kc_app_vouches_cmd(APP, &bad, &macs));
    TEST_ASSERT_EQUAL_UINT32(1u, macs);
    /* no MAC is computed for what is refused without it */
    bad = c;
    bad.source = 3;
    TEST_ASSERT_FALSE(kc_app_vouches_cmd(APP, &bad, &macs));
    bad = c;
    bad.auth.key_id = 0u;
    TEST_ASSERT_FALSE(kc_app_vouches_cmd(APP, &bad, &macs));
    bad.auth.key_id = 2u;
    TEST_ASSERT_FALSE(kc_app_vouches_cmd(APP, &bad, &macs));
    bad = c;
    bad.auth.counter = 0u;
    TEST_ASSERT_FALSE(kc_app_vouches_cmd(APP, &bad, &macs));
    TEST_ASSERT_EQUAL_UINT32(1u, macs);
    TEST_ASSERT_TRUE(kc_app_vouches_cmd(APP, &c, &macs));
    TEST_ASSERT_FALSE(kc_app_vouches_cmd(APP, &c, &macs)); /* none left */
    TEST_ASSERT_EQUAL_UINT32(0u, macs);
    TEST_ASSERT_EQUAL_INT(KC_OK, taken(&c));
    macs = 1u;
    TEST_ASSERT_FALSE(kc_app_vouches_cmd(APP, &c, &macs)); /* nobody sends it twice */
    TEST_ASSERT_EQUAL_UINT32(1u, macs);
}

void test_chunks_are_vouched_for_alike(void)
{
    uint32_t macs = 2u;
    kc_table_chunk_t c = *given_chunk();
    TEST_ASSERT_TRUE(kc_app_vouches_chunk(APP, &c, &macs));
    c.data[1000] ^= 1u;
    TEST_ASSERT_FALSE(kc_app_vouches_chunk(APP, &c, &macs));
    TEST_ASSERT_EQUAL_UINT32(0u, macs);
    macs = 1u;
    c.source = 0;
    TEST_ASSERT_FALSE(kc_app_vouches_chunk(APP, &c, &macs));
    TEST_ASSERT_EQUAL_UINT32(1u, macs);
}
