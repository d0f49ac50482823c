/* kc_cmd.c: every command accepted or refused: answer, event and state together. */
#include <math.h>
#include <string.h>

#include "given_tables.h"
#include "given_world.h"
#include "kc_sequence.h"
#include "kc_signed.h"
#include "kc_update.h"
#include "unity.h"

#define APP (&kc_app_instance)

static uint8_t s_image[KC_IMAGE_MAX], s_dumped[KC_IMAGE_MAX];
static uint32_t s_n;

void setUp(void) { given_world(); }

static void given_idle(void)
{
    world_boot();
    world_ticks(2u);
}

/* The command of this tick is refused: answer, event, and nothing changed. */
static void refused(int32_t status, uint16_t event)
{
    uint32_t before = APP->cmd_log.n_refused, n = world_events(event);
    bool arm = world.arm_silent, pantilt = world.pantilt_silent;
    world.arm_silent = world.pantilt_silent = true; /* the command is all that comes in */
    world_remember();
    world_tick();
    world.arm_silent = arm;
    world.pantilt_silent = pantilt;
    TEST_ASSERT_EQUAL_INT(status, world.ack.status);
    TEST_ASSERT_EQUAL_INT(event, world.ack.event_id);
    TEST_ASSERT_EQUAL_UINT32(n + 1u, world_events(event));
    TEST_ASSERT_EQUAL_UINT32(before + 1u, APP->cmd_log.n_refused);
    TEST_ASSERT_TRUE_MESSAGE(world_unchanged(), "something changed");
}

static void accepted(void)
{
    uint32_t before = APP->cmd_log.n_ok, n = world_events(KC_EVT_CMD_ACCEPTED);
    world_tick();
    (void)world_stored(10u);
    TEST_ASSERT_EQUAL_INT(KC_OK, world.ack.status);
    TEST_ASSERT_EQUAL_INT(0, world.ack.event_id);
    TEST_ASSERT_EQUAL_UINT32(before + 1u, APP->cmd_log.n_ok);
    TEST_ASSERT_EQUAL_UINT32(n + 1u, world_events(KC_EVT_CMD_ACCEPTED));
}

/* ---- source, sequence, opcode ---- */

void test_a_repeated_or_older_command_number_is_refused(void)
{
    for (int32_t back = 0; back < 3; back++) {
        given_world();
        given_idle();
        world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = 10;
        accepted();
        world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = 10 - back;
        refused(KC_ERR_STALE, KC_EVT_CMD_STALE);
        TEST_ASSERT_EQUAL_DOUBLE(10.0, world.last[KC_EVT_CMD_STALE].want);
    }
}

void test_a_repetition_is_refused_however_late_it_comes(void)
{
    given_idle();
    world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = 10;
    accepted();
    world_ticks(150u);
    world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = 10;
    refused(KC_ERR_STALE, KC_EVT_CMD_STALE);
}

void test_abort_is_taken_whatever_its_number(void)
{
    const int32_t numbers[] = {10, 3, -5, INT32_MIN, INT32_MAX};
    for (uint32_t i = 0u; i < 5u; i++) {
        given_world();
        world_started();
        world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = 10;
        accepted();
        world_cmd(KC_CMD_ABORT, 0, 0, 0)->seq = numbers[i];
        world_tick();
        TEST_ASSERT_EQUAL_INT(KC_OK, world.ack.status);
        TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
        world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = 11; /* its number counts for nothing else */
        accepted();
    }
}

void test_a_number_far_ahead_is_refused_and_locks_nobody_out(void)
{
    given_idle();
    world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = 10;
    accepted();
    world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = 0x7fffffff;
    refused(KC_ERR_STALE, KC_EVT_CMD_STALE);
    world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = 11;
    accepted();
}

void test_a_source_that_began_with_the_largest_number_is_heard_again(void)
{
    given_idle();
    world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = 0x7fffffff;
    accepted();
    world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = 5;
    refused(KC_ERR_STALE, KC_EVT_CMD_STALE);
    world_ticks(100u);
    world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = 6;
    accepted();
}

void test_numbers_wrap(void)
{
    given_idle();
    world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = INT32_MAX;
    accepted();
    world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = INT32_MIN;
    accepted();
    world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = INT32_MAX;
    refused(KC_ERR_STALE, KC_EVT_CMD_STALE);
}

void test_numbers_are_kept_for_each_source_and_count_only_without_a_signature(void)
{
    given_idle();
    world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = 10;
    accepted();
    kc_cmd_t *c = world_cmd(KC_CMD_NOOP, 0, 0, 0);
    c->source = 2;
    c->seq = 3;
    accepted();
    world_cmd(KC_CMD_TABLE_DUMP, 0, 0, 0)->seq = 11; /* signed */
    refused(KC_ERR_ARG, KC_EVT_CMD_ARG);
    world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = 11;
    accepted();
    world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = 11;
    refused(KC_ERR_STALE, KC_EVT_CMD_STALE);
}

void test_an_unknown_source_is_refused(void)
{
    const int32_t sources[] = {0, 3, -1};
    for (uint32_t i = 0u; i < 3u; i++) {
        given_world();
        given_idle();
        world_cmd(i == 0u ? KC_CMD_NOOP : KC_CMD_START, 0, 0, 0)->source = sources[i];
        refused(KC_ERR_ARG, KC_EVT_CMD_SOURCE);
        TEST_ASSERT_EQUAL_INT(-1, world.last[KC_EVT_CMD_SOURCE].index);
        TEST_ASSERT_EQUAL_DOUBLE(sources[i], world.last[KC_EVT_CMD_SOURCE].got);
    }
}

void test_abort_is_taken_of_any_source(void)
{
    const int32_t sources[] = {0, 3, 77, -1, INT32_MIN};
    for (uint32_t i = 0u; i < 5u; i++) {
        given_world();
        world_started();
        TEST_ASSERT_TRUE(world_calibrating());
        world_cmd(KC_CMD_ABORT, 0, 0, 0)->source = sources[i];
        accepted();
        TEST_ASSERT_EQUAL_INT(sources[i], world.ack.source);
        TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
    }
}

static void expect_stopped(int32_t opcode)
{
    TEST_ASSERT_EQUAL_INT(opcode, world.last[KC_EVT_CMD_ABORTED].index);
    TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
}

/* The last that anybody said may have been ABORT: the order within a step is not that of the senders. */
void test_abort_wins_over_a_start_of_the_same_step_in_whatever_order(void)
{
    for (int first = 0; first < 2; first++) {
        given_world();
        given_idle();
        if (first) { world_cmd(KC_CMD_ABORT, 0, 0, 0)->source = 1; }
        (void)world_cmd(KC_CMD_START, -1, 4, 1);
        if (!first) { world_cmd(KC_CMD_ABORT, 0, 0, 0)->source = 1; }
        world_tick();
        TEST_ASSERT_EQUAL_UINT32(2u, world.n_acks);
        const kc_ack_t *start = &world.out.ack[first ? 1 : 0], *abort = &world.out.ack[first ? 0 : 1];
        TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, start->status);
        TEST_ASSERT_EQUAL_INT(KC_EVT_CMD_ABORTED, start->event_id);
        TEST_ASSERT_EQUAL_INT(KC_CMD_ABORT, abort->opcode);
        TEST_ASSERT_EQUAL_INT(KC_OK, abort->status);
        expect_stopped(KC_CMD_START);
        TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_CAL_START));
        for (uint32_t i = 0u; i < 30u; i++) {
            world_tick();
            TEST_ASSERT_FALSE(world.out.has_arm_cmd && !world.out.arm_cmd.hold);
        }
        TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_START, -1, 4, 1)); /* a later one is taken */
    }
}

/* The edge takes no more of its queue than a step has room for: the rest came before the ABORT too. */
void test_a_start_that_waited_with_an_abort_is_refused_in_a_later_step(void)
{
    given_idle();
    world_cmd(KC_CMD_START, -1, 4, 1)->stopped = 1u;
    kc_cmd_t again;
    world_tick();
    again = world.sent[world.counter % KC_CMD_QUEUE_MAX];
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, world.ack.status);
    TEST_ASSERT_EQUAL_INT(KC_EVT_CMD_ABORTED, world.ack.event_id);
    TEST_ASSERT_EQUAL_INT(KC_ST_IDLE, kc_app_state(APP));
    world.as_sent = true; /* its counter is used up: a recorder cannot send it again without the mark */
    again.stopped = 0u;
    *world_cmd(KC_CMD_START, -1, 4, 1) = again;
    refused(KC_ERR_STALE, KC_EVT_CMD_REPLAYED);
}

void test_more_commands_than_one_step_takes_are_left_out(void)
{
    given_idle();
    for (uint32_t i = 0u; i < KC_CMD_QUEUE_MAX; i++) { (void)world_cmd(KC_CMD_NOOP, 0, 0, 0); }
    world.in.n_cmd = 100u;
    world_tick();
    TEST_ASSERT_EQUAL_UINT32(KC_CMD_QUEUE_MAX, world.n_acks);
}

/* ---- commands in the wrong state ---- */

void test_tables_cannot_change_while_a_calibration_runs(void)
{
    const int32_t cmds[] = {KC_CMD_TABLE_VALIDATE, KC_CMD_TABLE_ACTIVATE, KC_CMD_TABLE_DISCARD};
    world_started();
    for (uint32_t i = 0u; i < 3u; i++) {
        (void)world_cmd(cmds[i], KC_TBL_CONFIG, 0, 0);
        TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, (world_tick(), world.ack.status));
        TEST_ASSERT_EQUAL_INT(KC_EVT_TBL_BUSY, world.ack.event_id);
    }
    world.in.n_chunk = 1u;
    world.in.chunk[0].kind = KC_TBL_CONFIG;
    world.in.chunk[0].total = world.in.chunk[0].n = 100u;
    world_tick();
    TEST_ASSERT_EQUAL_INT(KC_STAGE_NONE, APP->tables.staging.state);
    TEST_ASSERT_EQUAL_UINT32(4u, world_events(KC_EVT_TBL_BUSY));
    TEST_ASSERT_TRUE(world_calibrating());
}

/* ---- tables up ---- */

static void given_new_config(void)
{
    given_idle();
    world.config.n_poses = 9u;
    s_n = given_image(KC_TBL_CONFIG, &world.config, s_image);
}

void test_a_table_goes_up_and_becomes_active_and_is_stored(void)
{
    given_new_config();
    int32_t crc = world_upload(KC_TBL_CONFIG, s_image, s_n);
    (void)world_cmd(KC_CMD_TABLE_VALIDATE, KC_TBL_CONFIG, crc, 0);
    accepted();
    (void)world_cmd(KC_CMD_TABLE_ACTIVATE, KC_TBL_CONFIG, crc, 0);
    accepted();
    TEST_ASSERT_EQUAL_UINT32(9u, kc_app_active(APP)->config.n_poses);
    TEST_ASSERT_EQUAL_UINT32(s_n, world.stored[KC_TBL_CONFIG][0]);
    TEST_ASSERT_EQUAL_MEMORY(s_image, world.store[KC_TBL_CONFIG][0], s_n);
    world_restart();
    TEST_ASSERT_EQUAL_UINT32(9u, kc_app_active(APP)->config.n_poses);
}

void test_chunks_out_of_order_or_of_no_kind_are_refused(void)
{
    given_new_config();
    world.in.n_chunk = 1u;
    world.in.chunk[0].kind = KC_TBL_CONFIG;
    world.in.chunk[0].total = s_n;
    world.in.chunk[0].offset = 10u;
    world.in.chunk[0].n = 10u;
    world_tick();
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_TBL_CHUNK));
    const int32_t kinds[] = {0, KC_TBL_COUNT, -3, 65537};
    for (uint32_t i = 0u; i < 4u; i++) {
        world.in.n_chunk = 1u;
        world.in.chunk[0].kind = kinds[i];
        world.in.chunk[0].total = world.in.chunk[0].n = 10u;
        world_tick();
        TEST_ASSERT_EQUAL_UINT32(i + 1u, world_events(KC_EVT_TBL_FORMAT));
        TEST_ASSERT_EQUAL_INT(KC_STAGE_NONE, APP->tables.staging.state);
    }
}

/* ---- tables down ---- */

static uint32_t collect(uint32_t max)
{
    uint32_t total = 0u;
    for (uint32_t i = 0u; i < max; i++) {
        const kc_table_chunk_t *c = &world.out.table_down;
        if (world.out.has_table_down) {
            memcpy(&s_dumped[c->offset], c->data, c->n);
            total = c->total;
            if (c->offset + c->n == c->total) { return total; }
        }
        world_tick();
    }
    return 0u;
}

void test_a_table_comes_down_as_it_went_up(void)
{
    given_idle();
    s_n = given_image(KC_TBL_SPACE, &world.space, s_image);
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_TABLE_DUMP, KC_TBL_SPACE, 0, 0));
    TEST_ASSERT_EQUAL_UINT32(s_n, collect(200u));
    TEST_ASSERT_EQUAL_MEMORY(s_image, s_dumped, s_n);
    world_tick();
    TEST_ASSERT_EQUAL_UINT8(0u, world.out.has_table_down);
}

/* ---- found missing by mutants ---- */

/* Silence counts from the source's last command, however late it is. */
void test_late_too_a_wild_number_is_refused_while_its_source_is_heard(void)
{
    world_boot();
    world_ticks(300u);
    world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = 5000000;
    world_tick();
    TEST_ASSERT_EQUAL_INT(KC_OK, world.ack.status);
    world_ticks(5u);
    world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = 7;
    refused(KC_ERR_STALE, KC_EVT_CMD_STALE);
}

/* One more is announced than there is room for: what lies behind the queue is no chunk. */
void test_of_chunks_no_more_are_read_than_the_queue_holds(void)
{
    given_idle();
    s_n = 2u * KC_CHUNK_QUEUE_MAX * KC_CHUNK_BYTES; /* of an image whose content does not matter yet */
    memset(&world.in, 0, sizeof world.in);
    world.in.n_chunk = KC_CHUNK_QUEUE_MAX + 1u;
    for (uint32_t i = 0u; i < KC_CHUNK_QUEUE_MAX; i++) {
        kc_table_chunk_t *c = &world.in.chunk[i];
        c->kind = KC_TBL_SPACE;
        c->total = s_n;
        c->offset = i * KC_CHUNK_BYTES;
        c->n = KC_CHUNK_BYTES;
        world_sign_chunk(c);
    }
    kc_app_step(APP, world.now_us + TICK_US, &world.in, &world.out);
    TEST_ASSERT_EQUAL_UINT32(KC_CHUNK_QUEUE_MAX * KC_CHUNK_BYTES, APP->tables.staging.n);
    TEST_ASSERT_EQUAL_UINT32(0u, world.out.events.n);
}

/* The command of this tick is refused, and its event says what it is about. */
static void refused_for(int32_t status, uint16_t event, int32_t index, double got, double want)
{
    refused(status, event);
    TEST_ASSERT_EQUAL_INT(index, world.last[event].index);
    TEST_ASSERT_EQUAL_DOUBLE(got, world.last[event].got);
    TEST_ASSERT_EQUAL_DOUBLE(want, world.last[event].want);
}

/* Sent as the test made it, so that nobody signs it. */
static kc_cmd_t *unsigned_cmd(int32_t opcode, int32_t source)
{
    kc_cmd_t *c = world_cmd(opcode, 0, 0, 0);
    world.as_sent = true;
    c->source = source;
    return c;
}

void test_a_command_that_is_not_admitted_is_reported_with_source_and_key(void)
{
    given_idle();
    (void)unsigned_cmd(KC_CMD_ROLLBACK, 2);
    refused_for(KC_ERR_AUTH, KC_EVT_CMD_UNSIGNED, 2, 0.0, 0.0);
    kc_cmd_t *c = unsigned_cmd(KC_CMD_ROLLBACK, 2);
    world_sign_cmd(c);
    uint32_t key = c->auth.key_id;
    c->arg_i[2] ^= 1;
    refused_for(KC_ERR_AUTH, KC_EVT_CMD_FORGED, 2, (double)key, 0.0);
    c = unsigned_cmd(KC_CMD_ROLLBACK, 2);
    world_sign_cmd(c);
    c->auth.key_id = 9999u;
    refused_for(KC_ERR_AUTH, KC_EVT_CMD_KEY, 2, 9999.0, 0.0);
    c = unsigned_cmd(KC_CMD_TABLE_DISCARD, 2);
    world_sign_cmd(c);
    const kc_cmd_t same = *c;
    accepted();
    *unsigned_cmd(KC_CMD_TABLE_DISCARD, 2) = same;
    refused_for(KC_ERR_STALE, KC_EVT_CMD_REPLAYED, 2, (double)same.auth.counter, (double)same.auth.counter);
    unsigned_cmd(KC_CMD_NOOP, 2)->seq = 5;
    accepted();
    unsigned_cmd(KC_CMD_NOOP, 2)->seq = 4;
    refused_for(KC_ERR_STALE, KC_EVT_CMD_STALE, 2, 4.0, 5.0);
}

/* The window of numbers ahead, and the silence after which another beginning is taken: to the last of both. */
void test_the_bounds_of_command_numbers_are_exact(void)
{
    given_idle();
    world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = 10;
    accepted();
    world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = 10 + 1000001;
    refused(KC_ERR_STALE, KC_EVT_CMD_STALE);
    world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = 10 + 1000000;
    accepted();
    world_ticks(99u);
    world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = 9; /* 10 s later exactly */
    refused(KC_ERR_STALE, KC_EVT_CMD_STALE);
    world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = 10; /* within the window behind: never */
    refused(KC_ERR_STALE, KC_EVT_CMD_STALE);
    world_cmd(KC_CMD_NOOP, 0, 0, 0)->seq = 9;
    accepted();
}

static uint64_t charged(void)
{
    kc_work_t work = kc_work_of_step();
    memset(&world.out, 0, sizeof world.out);
    kc_sequence_commands(APP, &work, &world.in, &world.out);
    world.in.n_cmd = world.in.n_chunk = 0u;
    return work.used;
}

/* Whether it is accepted or not. */
void test_what_a_step_takes_in_is_charged(void)
{
    const uint64_t head = kc_auth_cost(KC_SIGNED_HEAD_MAX);
    given_idle();
    (void)world_cmd(KC_CMD_NOOP, 0, 0, 0);
    TEST_ASSERT_EQUAL_UINT64(0u, charged()); /* no signature to check */
    for (uint32_t n = 1u; n < 3u; n++) {
        for (uint32_t i = 0u; i < n; i++) { world_sign_cmd(world_cmd(KC_CMD_REJECT, 0, 0, 0)); }
        TEST_ASSERT_EQUAL_UINT64(n * head, charged());
        world.in.n_chunk = n;
        TEST_ASSERT_EQUAL_UINT64(n * kc_auth_cost(KC_SIGNED_HEAD_MAX + KC_CHUNK_BYTES), charged());
    }
    world_sign_cmd(world_cmd(KC_CMD_TABLE_VALIDATE, 0, 0, 0));
    TEST_ASSERT_EQUAL_UINT64(head + kc_tbl_cost(&APP->tables), charged());
    world_sign_cmd(world_cmd(KC_CMD_START, -1, 0, 0));
    TEST_ASSERT_EQUAL_UINT64(head + kc_update_start_cost(&APP->view), charged());
    TEST_ASSERT_TRUE(world_calibrating());
}
