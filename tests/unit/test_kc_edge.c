/* kc_edge.c: the process's loop over LCM's in-memory network. */
#define _GNU_SOURCE /* NOLINT: mkdtemp, RTLD_NEXT */

#include <dlfcn.h>
#include <errno.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "given_parts.h"
#include "given_process.h"
#include "given_tables.h"
#include "kc_edge.h"
#include "kc_signed.h"
#include "kc_wire.h"
#include "kcm_ack_t.h"
#include "kcm_arm_state_t.h"
#include "kcm_cmd_t.h"
#include "kcm_detection_t.h"
#include "kcm_event_t.h"
#include "kcm_hk_t.h"
#include "kcm_pantilt_state_t.h"
#include "kcm_table_chunk_t.h"
#include "kcm_tick_done_t.h"
#include "kcm_time_t.h"
#include "unity.h"

#define APP (&kc_app_instance)

static const kc_keys_t s_keys = {.n = 1u, .key = {{.id = 1u, .secret = {5u}}}};
static uint64_t s_counter;
static kc_edge_t s_e;
static kc_files_t s_f;
static char s_dir[64];
static uint8_t s_buf[4096];
static kcm_tick_done_t s_done;
static kcm_ack_t s_ack, s_ack_start;
static kcm_event_t s_event[64];
static uint32_t s_n_done, s_n_ack, s_n_hk, s_n_event, s_n_down, s_n_arm_cmd;
static volatile sig_atomic_t s_stop;
static bool s_stop_ack; /* live: stops at the first answer, not at housekeeping */
static uint32_t s_stop_done; /* stops after so many answers to ticks; 0: never */

/* ---- a network and a clock that fail; these take the place of LCM's and the C library's for kc_edge.c ---- */

static struct {
    int subscribing, sizing; /* this subscription fails: 1 the next */
    int publishing; /* so many messages from now on are not sent */
    bool handling; /* a message cannot be handled */
    int poll_errno; /* poll fails, once */
    int clock_reads; /* after so many clock_reads at it the clock is 30 s ahead; 0: never */
    int64_t ahead_s;
    int n_read; /* the clock */
    struct timespec stopped; /* the clock stands here, if not at 0 */
} s_fails;

#define NEXT(type, name, ...) \
    ((type(*)(__VA_ARGS__))dlsym(RTLD_NEXT, name))  // NOLINT(bugprone-macro-parentheses)

lcm_subscription_t *lcm_subscribe(lcm_t *lcm, const char *channel, lcm_msg_handler_t handler, void *user)
{
    if (s_fails.subscribing > 0 && --s_fails.subscribing == 0) { return NULL; }
    return NEXT(lcm_subscription_t *, "lcm_subscribe", lcm_t *, const char *, lcm_msg_handler_t,
                void *)(lcm, channel, handler, user);
}

int lcm_subscription_set_queue_capacity(lcm_subscription_t *s, int n)
{
    if (s_fails.sizing > 0 && --s_fails.sizing == 0) { return -1; }
    return NEXT(int, "lcm_subscription_set_queue_capacity", lcm_subscription_t *, int)(s, n);
}

int lcm_publish(lcm_t *lcm, const char *channel, const void *data, unsigned n)
{
    if (s_fails.publishing > 0) {
        s_fails.publishing--;
        return -1;
    }
    return NEXT(int, "lcm_publish", lcm_t *, const char *, const void *, unsigned)(lcm, channel, data, n);
}

int lcm_handle(lcm_t *lcm) { return s_fails.handling ? -1 : NEXT(int, "lcm_handle", lcm_t *)(lcm); }

int poll(struct pollfd *fds, nfds_t n, int timeout_ms)
{
    if (s_fails.poll_errno != 0) {
        errno = s_fails.poll_errno;
        s_fails.poll_errno = 0;
        return -1;
    }
    return NEXT(int, "poll", struct pollfd *, nfds_t, int)(fds, n, timeout_ms);
}

int clock_gettime(clockid_t id, struct timespec *t)
{
    int done = NEXT(int, "clock_gettime", clockid_t, struct timespec *)(id, t);
    s_fails.n_read++;
    if (s_fails.clock_reads > 0 && --s_fails.clock_reads == 0) { s_fails.ahead_s = 30; }
    t->tv_sec += s_fails.ahead_s;
    if (s_fails.stopped.tv_sec != 0) { *t = s_fails.stopped; }
    return done;
}

static void on_any(const lcm_recv_buf_t *b, const char *channel, void *user)
{
    (void)user;
    int n = (int)b->data_size;
    if (strcmp(channel, "KC_TICK_DONE") == 0) {
        s_n_done++;
        TEST_ASSERT_TRUE(kcm_tick_done_t_decode(b->data, 0, n, &s_done) > 0);
        if (s_done.tick >= 3 || s_n_done == s_stop_done) { s_stop = 1; }
    } else if (strcmp(channel, "KC_ACK") == 0) {
        s_n_ack++;
        TEST_ASSERT_TRUE(kcm_ack_t_decode(b->data, 0, n, &s_ack) > 0);
        if (s_ack.opcode == KC_CMD_START) { s_ack_start = s_ack; }
    }
    s_n_hk += strcmp(channel, "KC_HK") == 0;
    if (s_e.live && (s_stop_ack ? s_n_ack : s_n_hk) >= 1u) { s_stop = 1; }
    if (strcmp(channel, "KC_EVENT") == 0) {
        TEST_ASSERT_TRUE(kcm_event_t_decode(b->data, 0, n, &s_event[s_n_event % 64u]) > 0);
        s_n_event++;
    }
    s_n_down += strcmp(channel, "KC_TABLE_DOWN") == 0;
    s_n_arm_cmd += strcmp(channel, "KC_ARM_CMD") == 0;
}

static void given_edge(bool live)
{
    given_app();
    memset(&APP->input, 0, sizeof APP->input); /* nothing was heard yet */
    kc_app_keys(APP, &s_keys);
    kc_app_boot(APP);
    memset(&s_fails, 0, sizeof s_fails);
    s_n_done = s_n_ack = s_n_hk = s_n_event = s_n_down = s_n_arm_cmd = 0u;
    s_stop = 0;
    memcpy(s_dir, "/tmp/kc_edge_XXXXXX", 20u);
    TEST_ASSERT_NOT_NULL(mkdtemp(s_dir));
    TEST_ASSERT_TRUE(kc_files_open(&s_f, s_dir));
    TEST_ASSERT_TRUE(kc_edge_open(&s_e, "memq://", &s_f, APP, live));
    (void)lcm_subscription_set_queue_capacity(lcm_subscribe(s_e.lcm, "KC_.*", on_any, NULL), 10000);
}

void setUp(void) { given_edge(false); }

void tearDown(void)
{
    char cmd[80];
    kc_edge_close(&s_e);
    (void)close(s_f.dir_fd);
    (void)snprintf(cmd, sizeof cmd, "rm -rf %s", s_dir);
    TEST_ASSERT_EQUAL_INT(0, system(cmd));  // NOLINT(cert-env33-c): the folder is our own
}

#define SEND(type, channel, msg)               \
    (void)lcm_publish(s_e.lcm, channel, s_buf, \
                      (unsigned)kcm_##type##_encode(s_buf, 0, (int)sizeof s_buf, &(msg)))

static void pump(void)
{
    while (lcm_handle_timeout(s_e.lcm, 0) > 0) { kc_edge_tick(&s_e); }
}

static void send_time(int64_t tick)
{
    const kcm_time_t t = {tick, tick * 100000};
    SEND(time_t, "KC_TIME", t);
}

static void send_arm(int64_t tick)
{
    static kcm_arm_state_t a;
    kcm_pantilt_state_t h = {tick * 100000, (int32_t)tick, 0.0, 0.0, 0};
    a.t_us = tick * 100000;
    a.seq = (int32_t)tick;
    a.n_joints = 7;
    SEND(arm_state_t, "KC_ARM_STATE", a);
    SEND(pantilt_state_t, "KC_PANTILT_STATE", h);
}

static void to_wire(const kc_auth_t *a, int32_t *key_id, int64_t *counter, int64_t *mac)
{
    *key_id = (int32_t)a->key_id;
    *counter = (int64_t)a->counter;
    memset(mac, 0, 2u * sizeof *mac);
    for (uint32_t i = 0u; i < KC_MAC_BYTES; i++) {
        mac[i / 8u] = (int64_t)((uint64_t)mac[i / 8u] | (uint64_t)a->mac[i] << (8u * (i % 8u)));
    }
}

static void sign(kcm_cmd_t *m)
{
    kc_cmd_t c;
    kc_wire_cmd(m, &c);
    given_signature(&c, s_keys.key, ++s_counter);
    to_wire(&c.auth, &m->key_id, &m->counter, m->mac);
}

static void sign_chunk(kcm_table_chunk_t *m)
{
    static kc_table_chunk_t c;
    uint8_t head[KC_SIGNED_HEAD_MAX];
    m->source = 2;
    kc_wire_table_up(m, &c);
    c.auth.key_id = s_keys.key[0].id;
    c.auth.counter = ++s_counter;
    kc_auth_text_t text = kc_signed_chunk(&c, head);
    kc_auth_mac(s_keys.key, &text, c.auth.mac);
    to_wire(&c.auth, &m->key_id, &m->counter, m->mac);
}

static void send_cmd(int64_t t_us, int32_t seq, int32_t opcode, int32_t a0)
{
    kcm_cmd_t c;
    memset(&c, 0, sizeof c);
    c.t_us = t_us;
    c.seq = seq;
    c.source = 2;
    c.opcode = opcode;
    c.arg_i[0] = a0;
    if (opcode != KC_CMD_NOOP && opcode != KC_CMD_ABORT) { sign(&c); }
    SEND(cmd_t, "KC_CMD", c);
}

void test_a_tick_is_done_once_and_its_answer_repeated(void)
{
    send_time(1);
    pump();
    TEST_ASSERT_EQUAL_UINT32(1u, s_n_done);
    TEST_ASSERT_EQUAL_INT64(1, s_done.tick);
    TEST_ASSERT_EQUAL_INT(KCM_TICK_DONE_T_WHO_FSW, s_done.who);
    int32_t n = s_done.n_published;
    TEST_ASSERT_EQUAL_INT((int)(s_n_event + s_n_hk), n);
    uint64_t now = APP->clock.now_us;
    send_time(1);
    pump();
    TEST_ASSERT_EQUAL_UINT32(2u, s_n_done);
    TEST_ASSERT_EQUAL_INT(n, s_done.n_published);
    TEST_ASSERT_EQUAL_UINT64(now, APP->clock.now_us);
    send_time(2);
    pump();
    TEST_ASSERT_EQUAL_INT64(2, s_done.tick);
    TEST_ASSERT_EQUAL_INT(0, s_done.n_published);
}

void test_events_and_answers_are_numbered_and_stamped_with_their_step(void)
{
    memset(&s_e.out, 0, sizeof s_e.out);
    send_time(1);
    pump();
    uint32_t n = s_n_event;
    TEST_ASSERT_TRUE(n > 0u && n <= 64u); /* a start is reported */
    send_cmd(150000, 1, 99, 0); /* no such command */
    send_cmd(150000, 2, 98, 0);
    send_time(2);
    pump();
    TEST_ASSERT_TRUE(s_n_event > n && s_n_event <= 64u);
    for (uint32_t i = 0u; i < s_n_event; i++) {
        TEST_ASSERT_EQUAL_INT((int)i + 1, s_event[i].seq);
        TEST_ASSERT_EQUAL_INT64(i < n ? 100000 : 200000, s_event[i].t_us);
        TEST_ASSERT_TRUE(s_event[i].id > 0);
    }
    TEST_ASSERT_EQUAL_UINT32(2u, s_n_ack);
    TEST_ASSERT_EQUAL_INT64(200000, s_ack.t_us);
    TEST_ASSERT_EQUAL_INT(2, s_ack.seq);
    TEST_ASSERT_EQUAL_INT(s_event[s_n_event - 1u].id, s_ack.event_id);
}

void test_a_command_waits_for_the_tick_after_its_stamp(void)
{
    send_time(1);
    pump();
    send_cmd(200000, 1, KC_CMD_NOOP, 0);
    send_time(2);
    pump();
    TEST_ASSERT_EQUAL_UINT32(0u, s_n_ack);
    send_time(3);
    pump();
    TEST_ASSERT_EQUAL_UINT32(1u, s_n_ack);
    TEST_ASSERT_EQUAL_INT(KC_OK, s_ack.status);
    TEST_ASSERT_EQUAL_INT(2, s_ack.source);
}

void test_sensor_messages_count_in_their_own_tick(void)
{
    send_arm(1);
    send_time(1);
    pump();
    TEST_ASSERT_EQUAL_UINT8(1u, APP->input.telemetry.has_arm);
    TEST_ASSERT_EQUAL_UINT8(1u, APP->input.telemetry.has_pantilt);
}

void test_a_fault_in_an_earlier_message_of_a_step_counts(void)
{
    kcm_arm_state_t a;
    memset(&a, 0, sizeof a);
    a.n_joints = 7;
    for (int32_t i = 0; i < 3; i++) {
        a.t_us = 100000;
        a.seq = i + 1;
        a.fault_mask = i == 1 ? 4 : 0;
        SEND(arm_state_t, "KC_ARM_STATE", a);
    }
    send_time(1);
    pump();
    TEST_ASSERT_EQUAL_INT(4, APP->input.telemetry.arm.fault_mask);
    TEST_ASSERT_EQUAL_INT(3, APP->input.telemetry.arm.seq);
}

/* The state before is what the step sees, and refuses. */
void test_a_fault_counts_if_an_old_state_comes_after_it(void)
{
    kcm_arm_state_t a;
    memset(&a, 0, sizeof a);
    a.n_joints = 7;
    send_arm(1);
    send_time(1);
    pump();
    a.t_us = 200000;
    a.seq = 2;
    a.fault_mask = 4;
    SEND(arm_state_t, "KC_ARM_STATE", a);
    a.t_us = 100000;
    a.seq = 1;
    a.fault_mask = 0;
    SEND(arm_state_t, "KC_ARM_STATE", a);
    send_time(2);
    pump();
    TEST_ASSERT_EQUAL_INT(1, APP->input.telemetry.arm.seq);
    TEST_ASSERT_EQUAL_INT(4, APP->input.telemetry.arm.fault_mask);
}

void test_a_calibration_starts_over_the_network_and_moves_the_arm(void)
{
    send_arm(1);
    send_time(1);
    pump();
    send_cmd(100000, 1, KC_CMD_START, -1);
    send_arm(2);
    send_time(2);
    pump();
    TEST_ASSERT_EQUAL_INT(KC_OK, s_ack.status);
    TEST_ASSERT_EQUAL_UINT32(1u, s_n_arm_cmd);
    TEST_ASSERT_TRUE(kc_states_calibrating(kc_app_state(APP)));
}

void test_a_table_goes_up_and_comes_down(void)
{
    static kcm_table_chunk_t c;
    static uint8_t image[KC_IMAGE_MAX];
    kc_config_t config = kc_app_active(APP)->config;
    config.n_poses = 9u;
    uint32_t n = given_image(KC_TBL_CONFIG, &config, image);
    int32_t crc = (int32_t)kc_tbl_image_crc(image, n);
    send_time(1);
    pump();
    c.t_us = 150000;
    c.kind = KC_TBL_CONFIG;
    c.total_bytes = c.n = (int32_t)n;
    memcpy(c.data, image, n);
    sign_chunk(&c);
    SEND(table_chunk_t, "KC_TABLE_UP", c);
    send_time(2);
    pump();
    kcm_cmd_t v;
    memset(&v, 0, sizeof v);
    v.t_us = 200000;
    v.source = 2;
    v.arg_i[0] = KC_TBL_CONFIG;
    v.arg_i[1] = crc;
    for (int32_t k = 0; k < 2; k++) {
        v.seq = k + 1;
        v.opcode = KC_CMD_TABLE_VALIDATE + k;
        sign(&v);
        SEND(cmd_t, "KC_CMD", v);
    }
    send_time(3);
    pump();
    TEST_ASSERT_TRUE(s_f.there[KC_TBL_CONFIG][0]); /* stored before it is active and answered */
    TEST_ASSERT_EQUAL_UINT32(6u, kc_app_active(APP)->config.n_poses);
    TEST_ASSERT_EQUAL_UINT32(1u, s_n_ack);
    send_time(4);
    pump();
    TEST_ASSERT_EQUAL_UINT32(9u, kc_app_active(APP)->config.n_poses);
    TEST_ASSERT_EQUAL_UINT32(2u, s_n_ack);
    send_cmd(400000, 3, KC_CMD_TABLE_DUMP, KC_TBL_CONFIG);
    send_time(5);
    pump();
    TEST_ASSERT_EQUAL_UINT32(1u, s_n_down);
}

void test_rubbish_and_what_finds_no_room_is_counted(void)
{
    static const char *const channels[] = {"KC_CMD",           "KC_TABLE_UP",  "KC_ARM_STATE",
                                           "KC_PANTILT_STATE", "KC_DETECTION", "KC_TIME"};
    static kcm_table_chunk_t c;
    static kcm_detection_t d;
    for (uint32_t i = 0u; i < 6u; i++) { (void)lcm_publish(s_e.lcm, channels[i], "rubbish", 7u); }
    pump();
    TEST_ASSERT_EQUAL_UINT32(6u, s_e.n_rx_errors);
    d.t_us = c.t_us = 50000;
    for (uint32_t i = 0u; i < KC_Q_CMD_QUOTA + 1u; i++) { send_cmd(50000, 1, 0, 0); }
    for (uint32_t i = 0u; i < KC_Q_CHUNK_OTHERS + 1u; i++) { SEND(table_chunk_t, "KC_TABLE_UP", c); }
    for (uint32_t i = 0u; i < KC_Q_DET + 1u; i++) { SEND(detection_t, "KC_DETECTION", d); }
    pump();
    TEST_ASSERT_EQUAL_UINT32(9u, s_e.n_rx_errors);
    send_time(1);
    pump();
    TEST_ASSERT_EQUAL_UINT32(9u, APP->n_rx_errors);
}

static kc_cmd_t *queued(int32_t opcode)
{
    for (uint32_t i = 0u; i < s_e.queue.n_cmd; i++) {
        if (s_e.queue.cmd[i].m.opcode == opcode) { return &s_e.queue.cmd[i].m; }
    }
    return NULL;
}

/* Eight in a step were enough when room went by the source that a message names. */
void test_commands_get_through_a_flood_of_others_in_their_name(void)
{
    kcm_cmd_t forged;
    send_arm(1);
    send_time(1);
    pump();
    memset(&forged, 0, sizeof forged);
    forged.t_us = 100000;
    forged.source = 2;
    for (int32_t i = 0; i < 500; i++) { send_cmd(100000, i + 1, KC_CMD_NOOP, 0); }
    for (uint32_t i = 0u; i < KC_EDGE_MACS_CMD - 1u; i++) {
        forged.opcode = KC_CMD_REJECT;
        forged.key_id = 1;
        forged.counter = 1000 + (int64_t)i;
        SEND(cmd_t, "KC_CMD", forged);
    }
    pump();
    TEST_ASSERT_EQUAL_UINT32(KC_Q_CMD_QUOTA, s_e.queue.n_cmd);
    send_cmd(100000, 1, KC_CMD_START, -1);
    pump();
    TEST_ASSERT_NOT_NULL(queued(KC_CMD_START));
    TEST_ASSERT_EQUAL_UINT32(0u, s_e.macs_cmd); /* the last one was for it */
    send_arm(2);
    send_time(2);
    pump();
    TEST_ASSERT_TRUE(kc_states_calibrating(kc_app_state(APP)));
    TEST_ASSERT_EQUAL_UINT32(KC_EDGE_MACS_CMD, s_e.macs_cmd);
}

/* A step takes 8 of them: the START is the last of its source, and the ABORT was sent after it. */
void test_a_start_in_a_full_queue_does_not_outlive_an_abort(void)
{
    for (int late = 0; late < 2; late++) {
        tearDown();
        setUp();
        send_arm(1);
        send_time(1);
        pump();
        for (int32_t i = 0; i < (int32_t)KC_Q_CMD_QUOTA; i++) { send_cmd(100000, i + 1, KC_CMD_NOOP, 0); }
        for (int32_t i = 0; i < 7; i++) { send_cmd(100000, i + 1, KC_CMD_TABLE_DISCARD, 0); }
        send_cmd(100000, 8, KC_CMD_START, -1);
        if (!late) { send_cmd(100000, 9, KC_CMD_ABORT, 0); }
        for (int64_t tick = 2; tick < 8; tick++) {
            if (late && tick == 3) { send_cmd(200000, 9, KC_CMD_ABORT, 0); } /* the START waits still */
            send_arm((int32_t)tick);
            send_time(tick);
            pump();
            TEST_ASSERT_FALSE(kc_states_calibrating(kc_app_state(APP)));
        }
        TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
        TEST_ASSERT_EQUAL_UINT32(0u, s_e.queue.n_cmd);
        TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, s_ack_start.status);
        TEST_ASSERT_EQUAL_INT(KC_EVT_CMD_ABORTED, s_ack_start.event_id);
    }
}

/* What is left open: more forged signatures in a step than are checked. Then it is one of the others. */
void test_beyond_the_macs_of_a_step_a_command_shares_the_room_of_others(void)
{
    send_time(1);
    pump();
    s_e.macs_cmd = 0u;
    send_cmd(100000, 1, KC_CMD_START, -1);
    pump();
    TEST_ASSERT_NOT_NULL(queued(KC_CMD_START));
    TEST_ASSERT_EQUAL_UINT32(KC_Q_OTHERS, s_e.queue.cmd[0].account);
    send_time(2);
    pump();
    TEST_ASSERT_EQUAL_INT(KC_CMD_START, s_ack.opcode);
    TEST_ASSERT_EQUAL_UINT32(KC_EVT_IN_SILENT,
                             s_ack.event_id); /* its signature was good: the arm is silent */
}

void test_an_upload_gets_through_a_flood_of_chunks(void)
{
    static kcm_table_chunk_t c;
    send_time(1);
    pump();
    c.source = 2;
    c.t_us = 100000;
    for (uint32_t i = 0u; i < 100u; i++) { SEND(table_chunk_t, "KC_TABLE_UP", c); }
    c.kind = KC_TBL_CONFIG;
    c.total_bytes = 5000;
    c.n = 1024;
    for (int32_t k = 0; k < 4; k++) {
        c.offset = 1024 * k;
        c.t_us = 150000;
        sign_chunk(&c);
        SEND(table_chunk_t, "KC_TABLE_UP", c);
    }
    pump();
    TEST_ASSERT_EQUAL_UINT32(KC_EDGE_MACS_CHUNK - 4u, s_e.macs_chunk); /* unsigned ones cost none */
    send_time(2);
    pump();
    TEST_ASSERT_EQUAL_UINT32(4096u, APP->tables.staging.n);
}

void test_a_failed_store_is_reported_with_the_next_step(void)
{
    int fd = s_f.dir_fd;
    s_f.dir_fd = -1;
    send_time(1); /* boot: the journal is stored */
    pump();
    s_f.dir_fd = fd;
    TEST_ASSERT_EQUAL_UINT8(1u, s_e.in.has_store_result);
    TEST_ASSERT_EQUAL_UINT16(KC_STORE_JOURNAL, s_e.in.store_kind);
    uint32_t before = s_n_event;
    send_time(2);
    pump();
    TEST_ASSERT_EQUAL_UINT32(before + 1u, s_n_event);
}

void test_a_negative_time_is_taken_for_zero(void)
{
    kc_edge_step(&s_e, -5);
    TEST_ASSERT_EQUAL_UINT64(0u, APP->clock.now_us);
}

void test_it_says_hello_until_the_first_tick_and_runs_until_it_is_stopped(void)
{
    for (int64_t k = 1; k <= 3; k++) { send_time(k); }
    TEST_ASSERT_TRUE(kc_edge_run(&s_e, &s_stop));
    TEST_ASSERT_EQUAL_UINT32(4u, s_n_done); /* tick 0 and three more */
    TEST_ASSERT_EQUAL_INT64(3, s_e.tick);
}

static const char *running(bool good)
{
    hear(2);
    bool ran = kc_edge_run(&s_e, &s_stop);
    const char *text = heard();
    TEST_ASSERT_EQUAL_INT(good, ran);
    return text;
}

void test_live_it_steps_by_the_clock_and_takes_messages_at_once(void)
{
    tearDown();
    given_edge(true);
    send_cmd(INT64_MAX, 1, KC_CMD_NOOP, 0); /* whatever clock the sender has */
    s_stop_ack = true; /* in the second step */
    const char *text = running(true);
    s_stop_ack = false;
    char tables[80];
    (void)snprintf(tables, sizeof tables, "\nkincal-fsw: tables in force, by CRC: arm %08x camera",
                   (unsigned)kc_app_active(APP)->crc[KC_TBL_ARM]);
    TEST_ASSERT_NOT_NULL_MESSAGE(strstr(text, tables), text);
    TEST_ASSERT_EQUAL_PTR_MESSAGE(strchr(text, '\n') + 1, strstr(text, "kincal-fsw: tables"), text);
    TEST_ASSERT_NULL_MESSAGE(strstr(text + 1, "kincal-fsw: runs on"), text); /* once */
    TEST_ASSERT_TRUE(s_n_hk >= 1u);
    TEST_ASSERT_EQUAL_UINT32(0u, s_n_done);
    TEST_ASSERT_TRUE(APP->clock.now_us > 1600000000000000u);
}

/* What opening says; "" if it succeeds. */
static const char *opening(const char *url, bool live)
{
    static kc_edge_t e;
    hear(2);
    bool opened = kc_edge_open(&e, url, &s_f, APP, live);
    const char *text = heard();
    TEST_ASSERT_EQUAL_INT(text[0] == '\0', opened);
    if (e.lcm != NULL) { kc_edge_close(&e); }
    return text;
}

void test_a_channel_that_cannot_be_subscribed_is_a_failure(void)
{
    const uint32_t n = open_files();
    for (int live = 0; live < 2; live++) {
        for (int at = 1; at <= 6 - live; at++) {
            s_fails.subscribing = at;
            TEST_ASSERT_EQUAL_STRING("kincal-fsw: can't subscribe at memq://\n",
                                     opening("memq://", live != 0));
            s_fails.sizing = at;
            TEST_ASSERT_EQUAL_STRING("kincal-fsw: can't subscribe at memq://\n",
                                     opening("memq://", live != 0));
        }
        TEST_ASSERT_EQUAL_STRING("", opening("memq://", live != 0));
    }
    TEST_ASSERT_EQUAL_UINT32(n, open_files());
}

void test_what_cannot_be_sent_is_counted_and_reported(void)
{
    s_fails.publishing = 3;
    send_time(1); /* itself one of the three */
    s_e.due_tick = 1;
    kc_edge_tick(&s_e);
    TEST_ASSERT_EQUAL_INT(2, s_e.n_tx_errors);
    TEST_ASSERT_EQUAL_INT(s_e.n_sent - 1, s_e.n_done);
    int32_t sent = s_e.n_sent;
    kc_edge_publish(&s_e);
    TEST_ASSERT_EQUAL_INT(2, s_e.out.hk.n_tx_errors);
    TEST_ASSERT_TRUE(s_e.n_sent >= sent);
}

void test_each_kind_of_telemetry_goes_out_on_its_channel(void)
{
    memset(&s_e.out, 0, sizeof s_e.out);
    s_e.out.has_hk = s_e.out.has_arm_cmd = s_e.out.has_table_down = 1u;
    int32_t sent = s_e.n_sent;
    kc_edge_publish(&s_e);
    TEST_ASSERT_EQUAL_INT(sent + 3, s_e.n_sent);
#define ALL(CHANNEL, member, message, copied) s_e.out.has_##member = 1u;
#define COUNT(CHANNEL, member, message, copied) +1
    KC_OUT_LIST(ALL)
    kc_edge_publish(&s_e);
    TEST_ASSERT_EQUAL_INT(sent + 3 + (KC_OUT_LIST(COUNT)), s_e.n_sent);
    TEST_ASSERT_EQUAL_INT(0, s_e.n_tx_errors);
    pump();
    TEST_ASSERT_EQUAL_UINT32(2u, s_n_hk);
    TEST_ASSERT_EQUAL_UINT32(2u, s_n_arm_cmd);
    TEST_ASSERT_EQUAL_UINT32(2u, s_n_down);
}

void test_after_a_failed_store_nothing_more_of_the_step_is_stored(void)
{
    static const uint8_t data[4] = {1, 2, 3, 4};
    int fd = s_f.dir_fd;
    s_e.out.n_store = 2u;
    s_e.out.store[0] = (kc_store_t){KC_STORE_PREV, 4u, data};
    s_e.out.store[1] = (kc_store_t){KC_STORE_PROPOSAL, 4u, data};
    s_f.dir_fd = -1;
    kc_edge_store(&s_e);
    TEST_ASSERT_EQUAL_UINT16(KC_STORE_PREV, s_e.in.store_kind);
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, s_e.in.store_status);
    s_f.dir_fd = fd;
    kc_edge_store(&s_e);
    TEST_ASSERT_EQUAL_UINT16(KC_STORE_PROPOSAL, s_e.in.store_kind);
    TEST_ASSERT_EQUAL_INT(KC_OK, s_e.in.store_status);
}

void test_a_signal_is_no_failure_of_the_network(void)
{
    s_fails.poll_errno = EINTR;
    for (int64_t k = 1; k <= 3; k++) { send_time(k); }
    TEST_ASSERT_EQUAL_STRING("", running(true));
    TEST_ASSERT_EQUAL_INT64(3, s_e.tick);
}

void test_a_network_that_fails_ends_the_run(void)
{
    static const char said[] = "kincal-fsw: the LCM network failed\n";
    s_fails.poll_errno = EBADF;
    TEST_ASSERT_EQUAL_STRING(said, running(false));
    send_time(1);
    s_fails.handling = true;
    TEST_ASSERT_EQUAL_STRING(said, running(false));
    tearDown();
    given_edge(true); /* with a real clock it says first that it runs */
    send_time(1);
    s_fails.handling = true;
    const char *text = running(false);
    size_t before = strlen(text) - strlen(said);
    TEST_ASSERT_EQUAL_STRING(said, &text[before]);
    TEST_ASSERT_NOT_NULL(strstr(text, "kincal-fsw: runs on memq://"));
}

/* It waits longer than the time between two announcements, and is woken before it by another message. */
void test_it_announces_itself_ten_times_a_second(void)
{
    s_n_done = 0u;
    send_cmd(50000, 1, KC_CMD_NOOP, 0);
    s_fails.poll_errno = EINTR;
    struct timespec from, to;
    (void)clock_gettime(CLOCK_MONOTONIC, &from);
    for (int k = 0; k < 2; k++) { send_cmd(50000, 2 + k, KC_CMD_NOOP, 0); }
    s_stop_done = 3u;
    TEST_ASSERT_TRUE(kc_edge_run(&s_e, &s_stop));
    s_stop_done = 0u;
    (void)clock_gettime(CLOCK_MONOTONIC, &to);
    double s = (double)(to.tv_sec - from.tv_sec) + 1e-9 * (double)(to.tv_nsec - from.tv_nsec);
    TEST_ASSERT_TRUE(s >= 0.19);
}

/* While the clock stands there is one step, at its time, however many messages come. */
void test_live_a_message_brings_no_step_before_its_time(void)
{
    tearDown();
    given_edge(true);
    s_fails.stopped = (struct timespec){.tv_sec = 1700000000, .tv_nsec = 250000000};
    for (int32_t i = 0; i < 5; i++) { send_cmd(0, i, KC_CMD_NOOP, 0); }
    TEST_ASSERT_TRUE(kc_edge_run(&s_e, &s_stop));
    TEST_ASSERT_EQUAL_UINT32(1u, s_n_hk);
    TEST_ASSERT_EQUAL_UINT32(0u, s_n_ack); /* they came after it */
    TEST_ASSERT_EQUAL_UINT64(1700000000250000u, APP->clock.clock_us);
    TEST_ASSERT_EQUAL_UINT64(1700000000250000u, APP->clock.now_us);
    s_fails.stopped = (struct timespec){0};
}

/* Suspended for a while, it goes on from now and does not make up for the steps that it missed. */
void test_live_it_does_not_catch_up(void)
{
    tearDown();
    given_edge(true);
    s_fails.clock_reads = 3;
    TEST_ASSERT_TRUE(kc_edge_run(&s_e, &s_stop));
    TEST_ASSERT_EQUAL_INT64(30, s_fails.ahead_s);
    TEST_ASSERT_TRUE(s_fails.n_read < 100); /* three a step, which would be 300 */
}

void test_a_network_that_cannot_be_made_is_refused(void)
{
    TEST_ASSERT_NOT_NULL(
        strstr(opening("nonsense://", false), "kincal-fsw: no LCM network at nonsense://\n"));
}
