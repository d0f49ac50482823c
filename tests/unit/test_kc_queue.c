/* kc_queue.c: when messages are due, and in which order. */
#include <string.h>

#include "kc_queue.h"
#include "unity.h"

static kc_queue_t s_q;
static kc_in_t s_in;
static kc_cmd_t s_c;
static kc_table_chunk_t s_k;
static kc_detection_t s_d;
static uint64_t s_counter;

void setUp(void)
{
    memset(&s_q, 0, sizeof s_q);
    memset(&s_in, 0, sizeof s_in);
    memset(&s_c, 0, sizeof s_c);
    s_k.source = 2;
}

/* Signed by a holder of a key, each with a counter of its own. */
static bool cmd(int64_t t, int32_t source, int32_t seq)
{
    s_c.source = source;
    s_c.seq = seq;
    s_c.auth = (kc_auth_t){.key_id = 1u, .counter = ++s_counter};
    return kc_queue_cmd(&s_q, t, 1000, &s_c, true);
}

/* By anybody. */
static bool others(int64_t t, int32_t source, int32_t seq)
{
    s_c.source = source;
    s_c.seq = seq;
    s_c.auth = (kc_auth_t){0};
    return kc_queue_cmd(&s_q, t, 1000, &s_c, false);
}

static bool chunk(int64_t t, int32_t kind, uint32_t offset)
{
    s_k.kind = kind;
    s_k.offset = offset;
    s_k.auth = (kc_auth_t){.key_id = 1u, .counter = ++s_counter};
    return kc_queue_chunk(&s_q, t, 1000, &s_k, true);
}

static bool others_chunk(int64_t t, int32_t kind, uint32_t offset)
{
    s_k.kind = kind;
    s_k.offset = offset;
    return kc_queue_chunk(&s_q, t, 1000, &s_k, false);
}

static bool det(int64_t t, int32_t seq)
{
    s_d.seq = seq;
    return kc_queue_det(&s_q, t, 1000, &s_d);
}

void test_a_message_is_due_when_its_time_has_passed(void)
{
    (void)cmd(1000, 1, 1);
    (void)chunk(1000, 1, 0u);
    (void)det(1000, 1);
    kc_queue_take(&s_q, 1000, &s_in);
    TEST_ASSERT_EQUAL_UINT32(0u, s_in.n_cmd + s_in.n_chunk + s_in.n_det);
    kc_queue_take(&s_q, 1001, &s_in);
    TEST_ASSERT_EQUAL_UINT32(1u, s_in.n_cmd);
    TEST_ASSERT_EQUAL_UINT32(1u, s_in.n_chunk);
    TEST_ASSERT_EQUAL_UINT32(1u, s_in.n_det);
    TEST_ASSERT_EQUAL_UINT32(0u, s_q.n_cmd + s_q.n_chunk + s_q.n_det);
}

void test_order_does_not_depend_on_arrival(void)
{
    static const int order[3][6] = {{0, 1, 2, 3, 4, 5}, {5, 4, 3, 2, 1, 0}, {3, 0, 5, 1, 4, 2}};
    for (int o = 0; o < 3; o++) {
        setUp();
        for (int i = 0; i < 6; i++) {
            int k = order[o][i];
            (void)cmd(k % 2 ? 500 : 400, 1 + k / 3, k); /* sources 1 1 1 2 2 2 */
            (void)chunk(k < 3 ? 100 : 200, 7 - (k % 3), (uint32_t)k);
            if (k < 4) { (void)det(300 + k, 10 - k); }
        }
        kc_queue_take(&s_q, 900, &s_in);
        const int32_t kinds[6] = {5, 6, 7, 5, 6, 7};
        const int32_t seqs[6] = {0, 3, 1, 4, 2, 5}; /* the sources in turn */
        for (int i = 0; i < 6; i++) {
            TEST_ASSERT_EQUAL_INT(seqs[i], s_in.cmd[i].seq);
            TEST_ASSERT_EQUAL_INT(kinds[i], s_in.chunk[i].kind);
        }
        TEST_ASSERT_EQUAL_UINT32(2u, s_in.chunk[0].offset); /* the earlier upload */
        for (int i = 0; i < 4; i++) { TEST_ASSERT_EQUAL_INT(7 + i, s_in.det[i].seq); }
    }
}

void test_chunks_of_one_kind_come_by_offset(void)
{
    (void)chunk(5, 3, 2048u);
    (void)chunk(5, 3, 0u);
    (void)chunk(5, 3, 1024u);
    kc_queue_take(&s_q, 6, &s_in);
    for (uint32_t i = 0u; i < 3u; i++) { TEST_ASSERT_EQUAL_UINT32(1024u * i, s_in.chunk[i].offset); }
}

void test_a_step_takes_what_it_can_and_leaves_the_rest(void)
{
    for (int32_t i = 0; i < 12; i++) {
        (void)cmd(1, 1 + i % 2, 12 - i);
        (void)chunk(1, 1, (uint32_t)(12 - i));
        if (i < 6) { (void)det(1, 6 - i); }
    }
    kc_queue_take(&s_q, 2, &s_in);
    TEST_ASSERT_EQUAL_UINT32(KC_CMD_QUEUE_MAX, s_in.n_cmd);
    TEST_ASSERT_EQUAL_UINT32(KC_CHUNK_QUEUE_MAX, s_in.n_chunk);
    TEST_ASSERT_EQUAL_UINT32(KC_DET_QUEUE_MAX, s_in.n_det);
    memset(&s_in, 0, sizeof s_in);
    kc_queue_take(&s_q, 2, &s_in);
    TEST_ASSERT_EQUAL_INT(10, s_in.cmd[0].seq);
    TEST_ASSERT_EQUAL_UINT32(9u, s_in.chunk[0].offset);
    TEST_ASSERT_EQUAL_INT(5, s_in.det[0].seq);
    TEST_ASSERT_EQUAL_UINT32(4u, s_in.n_cmd);
}

void test_what_finds_no_room_or_lies_too_far_ahead_is_refused(void)
{
    for (uint32_t i = 0u; i < KC_Q_CMD_QUOTA; i++) { TEST_ASSERT_TRUE(cmd(1, 1, 1)); }
    for (uint32_t i = 0u; i < KC_Q_CHUNK - KC_Q_CHUNK_OTHERS; i++) { TEST_ASSERT_TRUE(chunk(1, 1, 1u)); }
    for (uint32_t i = 0u; i < KC_Q_DET; i++) { TEST_ASSERT_TRUE(det(1, 1)); }
    TEST_ASSERT_FALSE(cmd(1, 1, 1));
    TEST_ASSERT_FALSE(chunk(1, 1, 1u));
    TEST_ASSERT_FALSE(det(1, 1));
    setUp();
    TEST_ASSERT_FALSE(cmd(1001 + KC_Q_AHEAD_US, 1, 1));
    TEST_ASSERT_FALSE(chunk(1001 + KC_Q_AHEAD_US, 1, 1u));
    TEST_ASSERT_FALSE(det(1001 + KC_Q_AHEAD_US, 1));
    TEST_ASSERT_TRUE(det(INT64_MIN, 1)); /* live: due at once */
    kc_queue_take(&s_q, 0, &s_in);
    TEST_ASSERT_EQUAL_UINT32(1u, s_in.n_det);
}

static bool abort_of_others(int32_t source, int32_t seq)
{
    s_c.opcode = KC_CMD_ABORT;
    bool waits = others(1, source, seq);
    s_c.opcode = KC_CMD_NOOP;
    return waits;
}

static bool abort_cmd(int32_t source, int32_t seq)
{
    s_c.opcode = KC_CMD_ABORT;
    bool waits = cmd(1, source, seq);
    s_c.opcode = KC_CMD_NOOP;
    return waits;
}

/* Whatever source it names: commands that a holder of a key sent find room, and are taken in the next step. */
void test_a_flood_of_strangers_costs_nobody_anything(void)
{
    int32_t flood[] = {1, 2, 99};
    for (uint32_t f = 0u; f < 3u; f++) {
        setUp();
        for (int32_t i = 0; i < 100; i++) { (void)others(1, flood[f], i - 50); }
        for (int32_t i = 0; i < 100; i++) { (void)abort_of_others(flood[f], i - 50); }
        for (int32_t s = 1; s <= 2; s++) {
            for (uint32_t i = 0u; i < KC_Q_CMD_QUOTA; i++) { TEST_ASSERT_TRUE(cmd(1, s, 1000 + (int32_t)i)); }
        }
        TEST_ASSERT_EQUAL_UINT32(KC_Q_CMD, s_q.n_cmd);
        kc_queue_take(&s_q, 2, &s_in);
        uint32_t n[3] = {0u};
        for (uint32_t i = 0u; i < s_in.n_cmd; i++) {
            n[s_in.cmd[i].auth.key_id != 0u ? s_in.cmd[i].source : 0]++;
        }
        TEST_ASSERT_TRUE(n[1] >= 2u && n[2] >= 2u);
        TEST_ASSERT_EQUAL_INT(KC_CMD_ABORT, s_in.cmd[0].opcode);
    }
}

void test_a_flood_of_one_holder_of_a_key_costs_the_others_nothing(void)
{
    for (int32_t f = 1; f <= 2; f++) {
        setUp();
        for (int32_t i = 0; i < 100; i++) { (void)cmd(1, f, i); }
        for (int32_t i = 0; i < 100; i++) { (void)abort_cmd(f, i); }
        TEST_ASSERT_EQUAL_UINT32(2u * KC_Q_CMD_QUOTA, s_q.n_cmd);
        for (uint32_t i = 0u; i < KC_Q_CMD_QUOTA; i++) { TEST_ASSERT_TRUE(cmd(1, 3 - f, 1000)); }
        TEST_ASSERT_TRUE(others(1, 3 - f, 1));
        kc_queue_take(&s_q, 2, &s_in);
        uint32_t n = 0u;
        for (uint32_t i = 0u; i < s_in.n_cmd; i++) { n += s_in.cmd[i].source != f; }
        TEST_ASSERT_TRUE(n >= 4u);
    }
}

void test_all_that_nobody_vouches_for_shares_one_account(void)
{
    for (int32_t i = 0; i < 100; i++) { (void)others(1, i % 5, i); }
    TEST_ASSERT_EQUAL_UINT32(KC_Q_CMD_QUOTA, s_q.n_cmd);
    for (int32_t i = 0; i < 100; i++) { (void)abort_of_others(i % 5, i); }
    TEST_ASSERT_EQUAL_UINT32(2u * KC_Q_CMD_QUOTA, s_q.n_cmd);
}

void test_abort_finds_room_where_its_own_source_has_none(void)
{
    for (uint32_t i = 0u; i < KC_Q_CMD_QUOTA; i++) { (void)cmd(1, 1, (int32_t)i); }
    TEST_ASSERT_FALSE(cmd(1, 1, 50));
    TEST_ASSERT_TRUE(abort_cmd(1, 51));
    for (uint32_t i = 0u; i < KC_Q_CMD_QUOTA; i++) { (void)others(1, 1, (int32_t)i); }
    TEST_ASSERT_FALSE(others(1, 1, 52));
    TEST_ASSERT_TRUE(abort_of_others(1, 53));
}

/* Else a recorder could fill a source's account with copies of what it has just sent. */
void test_a_copy_of_what_waits_takes_no_room_of_its_sender(void)
{
    TEST_ASSERT_TRUE(cmd(1, 1, 5));
    for (uint32_t i = 0u; i < 100u; i++) { (void)kc_queue_cmd(&s_q, 1, 1000, &s_c, true); }
    TEST_ASSERT_EQUAL_UINT32(1u + KC_Q_CMD_QUOTA, s_q.n_cmd);
    for (uint32_t i = 1u; i < KC_Q_CMD_QUOTA; i++) { TEST_ASSERT_TRUE(cmd(1, 1, 6)); }
    TEST_ASSERT_TRUE(chunk(1, 1, 0u));
    for (uint32_t i = 0u; i < 100u; i++) { (void)kc_queue_chunk(&s_q, 1, 1000, &s_k, true); }
    TEST_ASSERT_EQUAL_UINT32(1u + KC_Q_CHUNK_OTHERS, s_q.n_chunk);
    s_k.source = 1; /* counters are of a sender: the same number of another one is no copy */
    TEST_ASSERT_TRUE(kc_queue_chunk(&s_q, 1, 1000, &s_k, true));
    TEST_ASSERT_EQUAL_UINT32(2u + KC_Q_CHUNK_OTHERS, s_q.n_chunk);
}

void test_a_flood_of_chunks_that_nobody_vouches_for_does_not_hold_up_an_upload(void)
{
    for (uint32_t i = 0u; i < 100u; i++) { (void)others_chunk(0, 1, 0u); }
    TEST_ASSERT_EQUAL_UINT32(KC_Q_CHUNK_OTHERS, s_q.n_chunk);
    for (uint32_t i = 0u; i < KC_CHUNK_QUEUE_MAX; i++) { TEST_ASSERT_TRUE(chunk(1, 7, 1024u * i)); }
    kc_queue_take(&s_q, 2, &s_in);
    TEST_ASSERT_EQUAL_UINT32(KC_CHUNK_QUEUE_MAX, s_in.n_chunk);
    for (uint32_t i = 0u; i < KC_CHUNK_QUEUE_MAX; i++) {
        TEST_ASSERT_EQUAL_UINT32(1024u * i, s_in.chunk[i].offset);
    }
}

/* Whoever sent it, whatever its number and however much waits; a second one has no more to stop. */
void test_one_abort_is_the_first_of_its_step(void)
{
    for (int vouched = 0; vouched < 2; vouched++) {
        setUp();
        TEST_ASSERT_TRUE(vouched ? abort_cmd(1, 400) : abort_of_others(1, 400));
        TEST_ASSERT_TRUE(abort_of_others(3, 1));
        for (int32_t i = 1; i < (int32_t)KC_Q_CMD_QUOTA; i++) {
            TEST_ASSERT_TRUE(cmd(1, 1, i));
            TEST_ASSERT_TRUE(cmd(1, 2, i));
            TEST_ASSERT_TRUE(others(1, 2, i));
        }
        kc_queue_take(&s_q, 2, &s_in);
        TEST_ASSERT_EQUAL_UINT32(KC_CMD_QUEUE_MAX, s_in.n_cmd);
        TEST_ASSERT_EQUAL_INT(KC_CMD_ABORT, s_in.cmd[0].opcode);
        uint32_t aborts = 0u;
        for (uint32_t i = 0u; i < s_in.n_cmd; i++) { aborts += s_in.cmd[i].opcode == KC_CMD_ABORT; }
        TEST_ASSERT_EQUAL_UINT32(1u, aborts);
    }
}

/* All 21 are taken in three steps: each came before the ABORT, or with it. What comes later, and what is stamped later, is
 * not concerned. */
void test_what_waits_with_an_abort_is_marked_until_it_is_taken(void)
{
    TEST_ASSERT_TRUE(abort_of_others(1, 400));
    for (int32_t i = 1; i < (int32_t)KC_Q_CMD_QUOTA; i++) {
        TEST_ASSERT_TRUE(cmd(1, 1, i));
        TEST_ASSERT_TRUE(cmd(1, 2, i));
        TEST_ASSERT_TRUE(others(1, 2, i));
    }
    TEST_ASSERT_TRUE(cmd(2, 1, 90)); /* not due yet, by one */
    uint32_t n = 0u, marked = 0u;
    for (uint32_t step = 0u; step < 3u; step++) {
        memset(&s_in, 0, sizeof s_in);
        kc_queue_take(&s_q, 2, &s_in);
        for (uint32_t i = 0u; i < s_in.n_cmd; i++) { marked += s_in.cmd[i].stopped; }
        n += s_in.n_cmd;
        if (step == 0u) { TEST_ASSERT_TRUE(others(1, 1, 9)); }
    }
    TEST_ASSERT_EQUAL_UINT32(1u + 21u + 1u, n);
    TEST_ASSERT_EQUAL_UINT32(1u + 21u, marked);
    memset(&s_in, 0, sizeof s_in);
    kc_queue_take(&s_q, 100, &s_in);
    TEST_ASSERT_EQUAL_UINT32(1u, s_in.n_cmd);
    TEST_ASSERT_EQUAL_UINT8(0u, s_in.cmd[0].stopped);
}

void test_numbers_that_wrap_keep_their_order(void)
{
    (void)cmd(1, 1, INT32_MIN);
    (void)cmd(1, 1, INT32_MAX);
    kc_queue_take(&s_q, 2, &s_in);
    TEST_ASSERT_EQUAL_INT(INT32_MAX, s_in.cmd[0].seq);
    TEST_ASSERT_EQUAL_INT(INT32_MIN, s_in.cmd[1].seq);
}

/* By each of the two alone: no room, and a stamp too far ahead. */
void test_chunks_and_detections_are_refused_for_either_reason(void)
{
    TEST_ASSERT_FALSE(chunk(1001 + KC_Q_AHEAD_US, 1, 0u));
    TEST_ASSERT_FALSE(det(1001 + KC_Q_AHEAD_US, 1));
    for (uint32_t i = 0u; i < KC_Q_CHUNK - KC_Q_CHUNK_OTHERS; i++) {
        TEST_ASSERT_TRUE(chunk(1000 + KC_Q_AHEAD_US, 1, i));
    }
    for (uint32_t i = 0u; i < KC_Q_DET; i++) { TEST_ASSERT_TRUE(det(1000 + KC_Q_AHEAD_US, (int32_t)i)); }
    TEST_ASSERT_FALSE(chunk(500, 1, 0u));
    TEST_ASSERT_FALSE(det(500, 1));
}

/* Found by fuzzing: the difference of the two overflowed, and the message was taken. */
void test_a_stamp_as_far_ahead_as_numbers_go_is_refused(void)
{
    s_c.source = 1;
    TEST_ASSERT_FALSE(kc_queue_cmd(&s_q, INT64_MAX, -5, &s_c, true));
    TEST_ASSERT_FALSE(kc_queue_cmd(&s_q, INT64_MAX, INT64_MIN, &s_c, true));
    TEST_ASSERT_TRUE(kc_queue_cmd(&s_q, INT64_MAX, INT64_MAX - KC_Q_AHEAD_US, &s_c, true));
}
