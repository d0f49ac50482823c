/* Step the flight core with a record of whole calibrations (tests/cross/record.py) and print checksums of all that it
 * gives: text that has to be the same to the byte on every CPU. One line every 100 steps and at the end of each
 * calibration: steps since the start, state, CRC of commands and answers, of events, of telemetry, of proposals, and of
 * what is to be kept. */
#include "replay.h"

#include <stdbool.h>
#include <string.h>

#include "kc_app.h"
#include "kc_codec.h"
#include "kc_libm.h"

#define LINE_STEPS 100u

/* Not the core's memory: the machine of the test has it. */
#ifdef REPLAY_HARNESS_SECTION
#define HARNESS __attribute__((section(REPLAY_HARNESS_SECTION)))
#else
#define HARNESS
#endif

#include "replay_fields.h"

enum { SUM_COMMANDS, SUM_EVENTS, SUM_TELEMETRY, SUM_PROPOSALS, SUM_STORE, SUM_COUNT };

static kc_in_t in;
static kc_out_t out;
HARNESS static uint8_t call[KC_IMAGE_MAX + 64u];
static kc_walk_t sums[SUM_COUNT];
static uint32_t steps;

/* ---- in ---- */

static void walk_in(kc_walk_t *w)
{
    memset(&in, 0, sizeof in);
    kc_walk_u32(w, 0u, &in.n_rx_errors, 0u, UINT32_MAX);
    uint32_t n = kc_walk_count(w, 0u, &in.n_cmd, 0u, KC_CMD_QUEUE_MAX);
    for (uint32_t i = 0u; i < n; i++) { walk_kc_cmd_t(w, &in.cmd[i]); }
    n = kc_walk_count(w, 0u, &in.n_chunk, 0u, KC_CHUNK_QUEUE_MAX);
    for (uint32_t i = 0u; i < n; i++) { walk_kc_table_chunk_t(w, &in.chunk[i]); }
    n = kc_walk_count(w, 0u, &in.n_det, 0u, KC_DET_QUEUE_MAX);
    for (uint32_t i = 0u; i < n; i++) { walk_kc_detection_t(w, &in.det[i]); }
    kc_walk_u8(w, 0u, &in.has_arm, 0u, 1u);
    if (in.has_arm) { walk_kc_arm_state_t(w, &in.arm); }
    kc_walk_u8(w, 0u, &in.has_pantilt, 0u, 1u);
    if (in.has_pantilt) { walk_kc_pantilt_state_t(w, &in.pantilt); }
    kc_walk_u8(w, 0u, &in.has_store_result, 0u, 1u);
    kc_walk_u16(w, 0u, &in.store_kind, 0u, UINT16_MAX);
    kc_walk_i32(w, 0u, &in.store_status, INT32_MIN, INT32_MAX);
}

/* ---- out ---- */

static void sum_commands(kc_walk_t *w)
{
    for (uint32_t i = 0u; i < out.n_ack; i++) { walk_kc_ack_t(w, &out.ack[i]); }
    if (out.has_arm_cmd) { walk_kc_arm_cmd_t(w, &out.arm_cmd); }
    if (out.has_pantilt_cmd) { walk_kc_pantilt_cmd_t(w, &out.pantilt_cmd); }
    if (out.has_frame_request) { kc_walk_i32(w, 0u, &out.frame_request.seq, INT32_MIN, INT32_MAX); }
}

static void sum_telemetry(kc_walk_t *w)
{
    if (out.has_hk) { walk_kc_hk_t(w, &out.hk); }
    if (out.has_meas) { walk_kc_meas_t(w, &out.meas); }
    if (out.has_progress) { walk_kc_progress_t(w, &out.progress); }
    if (out.has_table_down) { walk_kc_table_chunk_t(w, &out.table_down); }
}

static void sum_store(kc_walk_t *w)
{
    for (uint32_t i = 0u; i < out.n_store; i++) {
        kc_store_t *s = &out.store[i];
        kc_walk_u16(w, 0u, &s->kind, 0u, UINT16_MAX);
        kc_walk_u32(w, 0u, &s->n, 0u, UINT32_MAX);
        memcpy(call, s->data, s->n); /* an image at most; a walk may write, in other modes */
        kc_walk_raw(w, call, s->n);
    }
}

static void sum_out(void)
{
    sum_commands(&sums[SUM_COMMANDS]);
    for (uint32_t i = 0u; i < out.events.n; i++) { walk_kc_event_t(&sums[SUM_EVENTS], &out.events.e[i]); }
    sum_telemetry(&sums[SUM_TELEMETRY]);
    if (out.has_proposal) { walk_kc_proposal_t(&sums[SUM_PROPOSALS], &out.proposal); }
    sum_store(&sums[SUM_STORE]);
}

static char *hex(char *at, uint32_t x)
{
    for (uint32_t i = 0u; i < 8u; i++) { *at++ = "0123456789abcdef"[(x >> (28u - 4u * i)) & 15u]; }
    return at;
}

static void print_line(void)
{
    char text[(2u + SUM_COUNT) * 9u + 1u], *at = hex(text, steps);
    *at++ = ' ';
    at = hex(at, (uint32_t)kc_app_state(&kc_app_instance));
    for (uint32_t i = 0u; i < SUM_COUNT; i++) {
        *at++ = ' ';
        at = hex(at, sums[i].crc);
    }
    *at++ = '\n';
    *at = '\0';
    replay_print(text);
}

/* ---- calls ---- */

static void begin(void)
{
    kc_app_init(&kc_app_instance);
    steps = 0u;
    memset(sums, 0, sizeof sums);
    for (uint32_t i = 0u; i < SUM_COUNT; i++) { sums[i].want_crc = 1u; }
}

static void step(kc_walk_t *w)
{
    uint64_t now_us;
    kc_walk_u64(w, 0u, &now_us, 0u, UINT64_MAX);
    walk_in(w);
    kc_app_step(&kc_app_instance, now_us, &in, &out);
    sum_out();
    if (++steps % LINE_STEPS == 0u) { print_line(); }
}

/* A call in `call`; whether it was read to its last byte. */
static bool make_call(uint32_t n)
{
    kc_walk_t w = {.mode = KC_WALK_READ, .in = call, .in_n = n, .pos = 1u};
    switch (call[0]) {
    case 'i':
        if (steps > 0u) { print_line(); }
        begin();
        break;
    case 'k': {
        kc_keys_t keys;
        walk_kc_keys_t(&w, &keys);
        kc_app_keys(&kc_app_instance, &keys);
        break;
    }
    case 'l': {
        uint16_t kind;
        kc_walk_u16(&w, 0u, &kind, 0u, UINT16_MAX);
        (void)kc_app_load(&kc_app_instance, kind, &call[w.pos], n - w.pos);
        w.pos = n;
        break;
    }
    case 'b': kc_app_boot(&kc_app_instance); break;
    case 's': step(&w); break;
    default: return false;
    }
    return w.pos == n && !w.lost && !w.overrun;
}

int replay(void)
{
    uint8_t head[4];
    uint32_t got;
    while ((got = replay_read(head, sizeof head)) == sizeof head) {
        uint32_t n = head[0] | (uint32_t)head[1] << 8 | (uint32_t)head[2] << 16 | (uint32_t)head[3] << 24;
        if (n == 0u || n > sizeof call || replay_read(call, n) != n || !make_call(n)) { return 1; }
    }
    print_line();
    return got != 0u;
}
