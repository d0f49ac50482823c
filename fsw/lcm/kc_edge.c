#define _POSIX_C_SOURCE 200809L /* NOLINT: sigaction, clock_gettime, openat */

#include "kc_edge.h"

#include <errno.h>
#include <poll.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "kc_wire.h"

#define HELLO_MS 100        /* period of announcements before the first tick */
#define BACKLOG 512         /* messages LCM may hold for us, per channel                          */

/* ---- receiving: one decoded message at a time, then into the queue ---- */

static union {
    kcm_cmd_t cmd;
    kcm_table_chunk_t chunk;
    kcm_detection_t det;
    kcm_arm_state_t arm;
    kcm_pantilt_state_t pantilt;
    kcm_time_t time;
} s_rx;

static int64_t clock_us(clockid_t id)
{
    struct timespec t;
    (void)clock_gettime(id, &t);
    return (int64_t)t.tv_sec * 1000000 + t.tv_nsec / 1000;
}

/* MACs that may be computed until the next step. */
static void renew(kc_edge_t *edge)
{
    edge->macs_cmd = KC_EDGE_MACS_CMD;
    edge->macs_chunk = KC_EDGE_MACS_CHUNK;
}

/* In live mode every message is due at once, whatever clock stamped it. */
static int64_t stamp(const kc_edge_t *edge, int64_t t_us) { return edge->live ? INT64_MIN : t_us; }

/* What could not be decoded, or finds no room, is counted. */
static bool counted(kc_edge_t *edge, bool good)
{
    edge->n_rx_errors += good ? 0u : 1u;
    return good;
}

/* The message of a buffer into s_rx.member; whether it could be decoded. */
#define DECODE(edge, buf, type, member) \
    counted((edge), kcm_##type##_decode((buf)->data, 0, (int)(buf)->data_size, &s_rx.member) >= 0)

static void on_cmd(const lcm_recv_buf_t *buf, const char *channel, void *user)
{
    static kc_cmd_t cmd;
    kc_edge_t *edge = user;
    (void)channel;
    if (!DECODE(edge, buf, cmd_t, cmd)) { return; }
    kc_wire_cmd(&s_rx.cmd, &cmd);
    bool vouched = kc_app_vouches_cmd(edge->app, &cmd, &edge->macs_cmd);
    (void)counted(edge, kc_queue_cmd(&edge->queue, stamp(edge, s_rx.cmd.t_us), edge->now_us, &cmd, vouched));
}

static void on_chunk(const lcm_recv_buf_t *buf, const char *channel, void *user)
{
    static kc_table_chunk_t chunk;
    kc_edge_t *edge = user;
    (void)channel;
    if (!DECODE(edge, buf, table_chunk_t, chunk)) { return; }
    kc_wire_table_up(&s_rx.chunk, &chunk);
    bool vouched = kc_app_vouches_chunk(edge->app, &chunk, &edge->macs_chunk);
    (void)counted(edge,
                  kc_queue_chunk(&edge->queue, stamp(edge, s_rx.chunk.t_us), edge->now_us, &chunk, vouched));
}

static void on_det(const lcm_recv_buf_t *buf, const char *channel, void *user)
{
    static kc_detection_t det;
    kc_edge_t *edge = user;
    (void)channel;
    if (!DECODE(edge, buf, detection_t, det)) { return; }
    kc_wire_detection(&s_rx.det, &det);
    (void)counted(edge, kc_queue_det(&edge->queue, stamp(edge, s_rx.det.t_us), edge->now_us, &det));
}

static void on_arm(const lcm_recv_buf_t *buf, const char *channel, void *user)
{
    kc_edge_t *edge = user;
    (void)channel;
    if (!DECODE(edge, buf, arm_state_t, arm)) { return; }
    kc_wire_arm_state(&s_rx.arm, &edge->in.arm);
    edge->in.has_arm = 1u;
}

static void on_pantilt(const lcm_recv_buf_t *buf, const char *channel, void *user)
{
    kc_edge_t *edge = user;
    (void)channel;
    if (!DECODE(edge, buf, pantilt_state_t, pantilt)) { return; }
    kc_wire_pantilt_state(&s_rx.pantilt, &edge->in.pantilt);
    edge->in.has_pantilt = 1u;
}

static void on_time(const lcm_recv_buf_t *buf, const char *channel, void *user)
{
    kc_edge_t *edge = user;
    (void)channel;
    if (!DECODE(edge, buf, time_t, time)) { return; }
    edge->repeat = s_rx.time.tick == edge->tick;
    edge->due_tick = s_rx.time.tick;
    edge->due_us = s_rx.time.now_us;
}

static bool subscribe(kc_edge_t *edge, const char *channel, lcm_msg_handler_t handler)
{
    lcm_subscription_t *s = lcm_subscribe(edge->lcm, channel, handler, edge);
    return s != NULL && lcm_subscription_set_queue_capacity(s, BACKLOG) == 0;
}

bool kc_edge_open(kc_edge_t *edge, const char *url, kc_files_t *files, kc_app_t *app, bool live)
{
    memset(edge, 0, sizeof *edge);
    edge->files = files;
    edge->app = app;
    edge->live = live;
    edge->url = url;
    renew(edge);
    edge->lcm = lcm_create(url);
    if (edge->lcm == NULL) {
        (void)fprintf(stderr, "kincal-fsw: no LCM network at %s\n", url);
        return false;
    }
    bool good = (live || subscribe(edge, "KC_TIME", on_time)) && subscribe(edge, "KC_CMD", on_cmd) &&
                subscribe(edge, "KC_TABLE_UP", on_chunk) && subscribe(edge, "KC_DETECTION", on_det) &&
                subscribe(edge, "KC_ARM_STATE", on_arm) && subscribe(edge, "KC_PANTILT_STATE", on_pantilt);
    if (!good) { (void)fprintf(stderr, "kincal-fsw: can't subscribe at %s\n", url); }
    return good;
}

void kc_edge_close(kc_edge_t *edge) { lcm_destroy(edge->lcm); }

/* ---- publishing: generated _publish() would use the heap ---- */

static uint8_t s_buf[24u * 1024u];

#define TX(CHANNEL, member, message, wire) kcm_##message##_t member;
static union {
    KC_OUT_LIST(TX)
    kcm_ack_t ack;
    kcm_event_t event;
    kcm_tick_done_t done;
} s_tx;

static void publish(kc_edge_t *edge, const char *channel, int n)
{
    if (n < 0 || lcm_publish(edge->lcm, channel, s_buf, (unsigned)n) != 0) {
        edge->n_tx_errors++;
    } else {
        edge->n_sent++;
    }
}

#define PUBLISH(edge, channel, type, member) \
    publish((edge), (channel), kcm_##type##_encode(s_buf, 0, (int)sizeof s_buf, &s_tx.member))

static void publish_answers(kc_edge_t *edge)
{
    const kc_out_t *o = &edge->out;
    for (uint32_t i = 0u; i < o->n_ack; i++) {
        kc_wire_ack(&o->ack[i], edge->now_us, &s_tx.ack);
        PUBLISH(edge, "KC_ACK", ack_t, ack);
    }
    for (uint32_t i = 0u; i < o->events.n; i++) {
        kc_wire_event(&o->events.e[i], edge->now_us, ++edge->event_seq, &s_tx.event);
        PUBLISH(edge, "KC_EVENT", event_t, event);
    }
}

#define PUBLISH_OUT(CHANNEL, member, message, wire)         \
    if (o->has_##member) {                                  \
        wire(&o->member, edge->now_us, &s_tx.member);       \
        PUBLISH(edge, "KC_" #CHANNEL, message##_t, member); \
    }

void kc_edge_publish(kc_edge_t *edge)
{
    kc_out_t *o = &edge->out;
    o->hk.n_tx_errors = edge->n_tx_errors; /* before this step's messages */
    KC_OUT_LIST(PUBLISH_OUT)
}

/* ---- one step ---- */

/* Up to the first failure; the component hears how it went with the next step. */
void kc_edge_store(kc_edge_t *edge)
{
    kc_status_t st = KC_OK;
    for (uint32_t i = 0u; i < edge->out.n_store && st == KC_OK; i++) {
        st = kc_files_store(edge->files, &edge->out.store[i]);
        edge->in.has_store_result = 1u;
        edge->in.store_kind = edge->out.store[i].kind;
        edge->in.store_status = (int32_t)st;
    }
}

/* Nobody hears of a change before it is stored. */
void kc_edge_step(kc_edge_t *edge, int64_t now_us)
{
    edge->now_us = now_us;
    edge->in.n_rx_errors = edge->n_rx_errors;
    kc_queue_take(&edge->queue, now_us, &edge->in);
    renew(edge);
    kc_app_step(edge->app, (uint64_t)(now_us > 0 ? now_us : 0), &edge->in, &edge->out);
    memset(&edge->in, 0, sizeof edge->in);
    kc_edge_store(edge);
    publish_answers(edge);
    kc_edge_publish(edge);
}

/* ---- lockstep ---- */

static void done(kc_edge_t *edge)
{
    s_tx.done = (kcm_tick_done_t){edge->tick, KCM_TICK_DONE_T_WHO_FSW, edge->n_done};
    PUBLISH(edge, "KC_TICK_DONE", tick_done_t, done);
}

void kc_edge_tick(kc_edge_t *edge)
{
    if (edge->repeat) {
        edge->repeat = false;
        done(edge);
    } else if (edge->due_tick != edge->tick) {
        int32_t sent = edge->n_sent;
        kc_edge_step(edge, edge->due_us);
        edge->n_done = edge->n_sent - sent;
        edge->tick = edge->due_tick;
        done(edge);
    }
}

/* Handle the next message, or wait for one up to the time-out; false if the network failed. */
static bool wait_message(kc_edge_t *edge, int timeout_ms)
{
    struct pollfd p = {lcm_get_fileno(edge->lcm), POLLIN, 0};
    int r = poll(&p, 1u, timeout_ms);
    if (r < 0) { return errno == EINTR; }
    return r == 0 || lcm_handle(edge->lcm) == 0;
}

static bool run_lockstep(kc_edge_t *edge, const volatile sig_atomic_t *stop)
{
    int64_t hello = 0;
    while (!*stop) {
        int64_t now = clock_us(CLOCK_MONOTONIC);
        if (edge->tick == 0 && now >= hello) {
            hello = now + (int64_t)HELLO_MS * 1000;
            done(edge);
        }
        if (!wait_message(edge, HELLO_MS)) { return false; }
        kc_edge_tick(edge);
    }
    return true;
}

/* ---- live ---- */

/* One who started the process by hand sees that it runs, where, and with which tables. */
static void say_running(const kc_hk_t *hk, const char *url)
{
    static const char *const kind[KC_TBL_COUNT] = {"",    "arm",   "camera", "terms",
                                                   "kin", "space", "kernel", "config"};
    (void)fprintf(stderr, "kincal-fsw: runs on %s, real clock; commands on KC_CMD, housekeeping on KC_HK\n",
                  url);
    (void)fprintf(stderr, "kincal-fsw: tables in force, by CRC:");
    for (int k = KC_TBL_ARM; k < KC_TBL_COUNT; k++) {
        (void)fprintf(stderr, " %s %08x", kind[k], (unsigned)hk->table_crc[k]); /* 0: none */
    }
    (void)fprintf(stderr, "\n");
}

static bool run_live(kc_edge_t *edge, const volatile sig_atomic_t *stop)
{
    int64_t due = clock_us(CLOCK_MONOTONIC);
    bool said = false;
    while (!*stop) {
        int64_t left = due - clock_us(CLOCK_MONOTONIC);
        if (left > 0) {
            if (!wait_message(edge, (int)((left + 999) / 1000))) { return false; }
            continue;
        }
        kc_edge_step(edge, clock_us(CLOCK_REALTIME));
        if (!said) { say_running(&edge->out.hk, edge->url); } /* the first step has housekeeping */
        said = true;
        due += KC_EDGE_TICK_US;
        if (clock_us(CLOCK_MONOTONIC) >
            due + 10 * (int64_t)KC_EDGE_TICK_US) { /* fell behind: don't catch up */
            due = clock_us(CLOCK_MONOTONIC);
        }
    }
    return true;
}

bool kc_edge_run(kc_edge_t *edge, const volatile sig_atomic_t *stop)
{
    bool good = edge->live ? run_live(edge, stop) : run_lockstep(edge, stop);
    if (!good) { (void)fprintf(stderr, "kincal-fsw: the LCM network failed\n"); }
    return good;
}
