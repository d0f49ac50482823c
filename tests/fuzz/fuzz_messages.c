/* What arrives over LCM, through the handlers of the flight process and its queue, into the input of a step; the states
 * of arm and pan-tilt unit also through the component's checks, with the world of the unit tests.
 *
 * Input: messages, each a channel, a length and bytes; the type's fingerprint is put before them, or not. */
#include <string.h>

#include "fuzz.h"
#include "given_world.h"
#include "kc_edge.h"
#include "kc_wire.h"
#include "kcm_time_t.h"

#define MESSAGES_MAX 24u

static kc_edge_t s_edge;
static kc_files_t s_files;
static uint8_t s_buf[4096], s_again[4096], s_arrived[4096];

static const char *const s_channel[] = {"KC_CMD",           "KC_TABLE_UP",  "KC_ARM_STATE",
                                        "KC_PANTILT_STATE", "KC_DETECTION", "KC_TIME"};
#define CHANNELS (sizeof s_channel / sizeof s_channel[0])

static union {
    kcm_cmd_t cmd;
    kcm_table_chunk_t chunk;
    kcm_arm_state_t arm;
    kcm_pantilt_state_t pantilt;
    kcm_detection_t det;
    kcm_time_t time;
} s_message;

/* LCM's decoder and encoder of a channel's type; bytes used, negative if the bytes are none of it. */
static int decode(uint32_t channel, int n)
{
    switch (channel) {
    case 0u: return kcm_cmd_t_decode(s_buf, 0, n, &s_message.cmd);
    case 1u: return kcm_table_chunk_t_decode(s_buf, 0, n, &s_message.chunk);
    case 2u: return kcm_arm_state_t_decode(s_buf, 0, n, &s_message.arm);
    case 3u: return kcm_pantilt_state_t_decode(s_buf, 0, n, &s_message.pantilt);
    case 4u: return kcm_detection_t_decode(s_buf, 0, n, &s_message.det);
    default: return kcm_time_t_decode(s_buf, 0, n, &s_message.time);
    }
}

static int encode(uint32_t channel)
{
    int n = (int)sizeof s_again;
    switch (channel) {
    case 0u: return kcm_cmd_t_encode(s_again, 0, n, &s_message.cmd);
    case 1u: return kcm_table_chunk_t_encode(s_again, 0, n, &s_message.chunk);
    case 2u: return kcm_arm_state_t_encode(s_again, 0, n, &s_message.arm);
    case 3u: return kcm_pantilt_state_t_encode(s_again, 0, n, &s_message.pantilt);
    case 4u: return kcm_detection_t_encode(s_again, 0, n, &s_message.det);
    default: return kcm_time_t_encode(s_again, 0, n, &s_message.time);
    }
}

/* The handlers, as the process subscribes them: called without a network between, which would take most of the time. */
static lcm_msg_handler_t s_handler[CHANNELS];

lcm_subscription_t *__real_lcm_subscribe(lcm_t *lcm, const char *channel, lcm_msg_handler_t handler,
                                         void *user);  // NOLINT: names of the linker's --wrap
lcm_subscription_t *__wrap_lcm_subscribe(lcm_t *lcm, const char *channel, lcm_msg_handler_t handler,
                                         void *user);  // NOLINT
lcm_subscription_t *__wrap_lcm_subscribe(lcm_t *lcm, const char *channel, lcm_msg_handler_t handler,
                                         void *user)
{
    for (uint32_t i = 0u; i < CHANNELS; i++) {
        if (strcmp(channel, s_channel[i]) == 0) { s_handler[i] = handler; }
    }
    return __real_lcm_subscribe(lcm, channel, handler, user);
}

int LLVMFuzzerInitialize(int *argc, char ***argv)
{
    (void)argc;
    (void)argv;
    fuzz_given_world(0u);
    world_boot();
    world_tick();
    MUST(kc_edge_open(&s_edge, "memq://", &s_files, &kc_app_instance, false));
    for (uint32_t i = 0u; i < CHANNELS; i++) { MUST(s_handler[i] != NULL); }
    return 0;
}

/* Bytes of the message, in s_buf: those of the input over a message of zeros, so that a short input gives a whole
 * one; how 1: cut off there; how 2: with a wrong fingerprint, if the input has none. */
static uint32_t make_message(fuzz_t *f, uint32_t channel, uint8_t how)
{
    memset(&s_message, 0, sizeof s_message);
    uint32_t whole = (uint32_t)encode(channel), n = fuzz_u16(f) % (whole + 1u);
    memcpy(s_buf, s_again, whole);
    uint32_t from = (how & 2u) != 0u ? 0u : 8u;
    for (uint32_t i = from; i < n; i++) { s_buf[i] = fuzz_u8(f); }
    fuzz_spoil(f, &s_buf[8], whole - 8u);
    return (how & 1u) != 0u ? n : whole;
}

/* The handler takes what LCM's decoder takes, and the rest counts as an error. faults: bits of all arm states. */
static void receive(uint32_t channel, uint32_t n, int32_t *faults)
{
    uint32_t errors = s_edge.n_rx_errors;
    int used = decode(channel, (int)n);
    MUST(used <= (int)n);
    if (used >= 0) { MUST(encode(channel) == used && memcmp(s_again, s_buf, (size_t)used) == 0); }
    if (used >= 0 && channel == 2u) { *faults |= s_message.arm.fault_mask; }
    uint8_t *end = &s_arrived[sizeof s_arrived - n]; /* what reads past it is found */
    memcpy(end, s_buf, n);
    s_handler[channel](&(lcm_recv_buf_t){.data = end, .data_size = n, .lcm = s_edge.lcm}, s_channel[channel],
                       &s_edge);
    MUST(used >= 0 || s_edge.n_rx_errors == errors + 1u);
}

static void check_queue(const kc_queue_t *q)
{
    uint32_t n[KC_Q_ACCOUNTS] = {0u}, others = 0u;
    MUST(q->n_cmd <= KC_Q_CMD && q->n_chunk <= KC_Q_CHUNK && q->n_det <= KC_Q_DET);
    for (uint32_t i = 0u; i < q->n_cmd; i++) { MUST(++n[q->cmd[i].account] <= KC_Q_CMD_QUOTA); }
    for (uint32_t i = 0u; i < q->n_chunk; i++) { others += q->chunk[i].account == KC_Q_OTHERS; }
    MUST(others <= KC_Q_CHUNK_OTHERS);
}

/* Take all that is due: no step takes more than fits, due messages do not stay, commands of a step are by turns. */
static void take_all(int64_t now_us)
{
    kc_queue_t *q = &s_edge.queue;
    for (uint32_t i = 0u; i < 5u; i++) {
        s_edge.in.n_cmd = s_edge.in.n_chunk = s_edge.in.n_det = 0u;
        kc_queue_take(q, now_us, &s_edge.in);
        MUST(s_edge.in.n_cmd <= KC_CMD_QUEUE_MAX && s_edge.in.n_chunk <= KC_CHUNK_QUEUE_MAX);
        MUST(s_edge.in.n_det <= KC_DET_QUEUE_MAX);
        check_queue(q);
    }
    for (uint32_t i = 0u; i < q->n_cmd; i++) { MUST(q->cmd[i].t_us >= now_us); }
    for (uint32_t i = 0u; i < q->n_chunk; i++) { MUST(q->chunk[i].t_us >= now_us); }
    for (uint32_t i = 0u; i < q->n_det; i++) { MUST(q->det[i].t_us >= now_us); }
}

/* What the component takes of the states: no fault is lost, whatever its message was and whatever came after it. */
static void check_faults(int32_t faults)
{
    static kc_out_t out;
    const kc_app_t *app = &kc_app_instance;
    kc_input_t input = app->input;
    kc_view_t view = app->view;
    view.telemetry = &input.telemetry;
    out.events.n = 0u;
    kc_input_telemetry(&input, &view, &s_edge.in, &out);
    MUST((input.telemetry.arm.fault_mask & faults) == faults);
    MUST(faults == 0 || out.events.n > 0u);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    fuzz_t f = {data, size};
    s_edge.queue.n_cmd = s_edge.queue.n_chunk = s_edge.queue.n_det = 0u;
    s_edge.in.has_arm = s_edge.in.has_pantilt = 0u;
    s_edge.in.arm.fault_mask = 0;
    s_edge.n_rx_errors = 0u;
    s_edge.macs_cmd = KC_EDGE_MACS_CMD;
    s_edge.macs_chunk = KC_EDGE_MACS_CHUNK;
    s_edge.live = (fuzz_u8(&f) & 1u) != 0u;
    s_edge.now_us = (int64_t)(int32_t)fuzz_u32(&f) * 1000;
    int32_t faults = 0;
    for (uint32_t i = 0u; i < MESSAGES_MAX && f.left > 0u; i++) {
        uint32_t channel = fuzz_u8(&f) % CHANNELS;
        uint8_t how = fuzz_u8(&f);
        receive(channel, make_message(&f, channel, how), &faults);
        check_queue(&s_edge.queue);
    }
    check_faults(faults);
    take_all(s_edge.now_us);
    return 0;
}
