/* Sequences of steps: the component with the world of the unit tests (arm, pan-tilt unit, camera, store), begun at
 * several places of a calibration, with commands, tables, spoiled messages, silence, clock steps, failing stores and
 * a power loss by the input.
 *
 * Input: where to begin, then actions of one byte each and what they need. */
#include <stdlib.h>
#include <string.h>

#include "fuzz.h"
#include "given_world.h"
#include "kc_wire.h"

#define APP (&kc_app_instance)
#define ACTIONS_MAX 64u
#define STEPS_MAX 96u

/* Up to its images, which no step changes. */
#define WORLD_BYTES offsetof(world_t, store)

/* ---- the store: two newest of each small kind; larger ones are taken and forgotten */

#define SLOT_BYTES 2048u
typedef struct {
    uint32_t n[WORLD_KINDS][2];
    uint8_t data[WORLD_KINDS][2][SLOT_BYTES];
} slots_t;
static slots_t s_slots;
static uint8_t s_fails; /* requests that fail from now on */

static kc_status_t keep(const kc_store_t *s)
{
    uint32_t *n = s_slots.n[s->kind];
    MUST(s->kind < WORLD_KINDS);
    if (s_fails > 0u) {
        s_fails--;
        return s_fails % 2u == 0u ? KC_ERR_NUM : KC_ERR_CRC;
    }
    if (s->n > SLOT_BYTES) { return KC_OK; }
    if (s->n > 0u && n[0] == s->n && memcmp(s_slots.data[s->kind][0], s->data, s->n) == 0) { return KC_OK; }
    memcpy(s_slots.data[s->kind][1], s_slots.data[s->kind][0], SLOT_BYTES);
    n[1] = s->n > 0u ? n[0] : 0u;
    if (s->n > 0u) { memcpy(s_slots.data[s->kind][0], s->data, s->n); }
    n[0] = s->n;
    return KC_OK;
}

/* ---- what the input changes of the next step ---- */

typedef struct {
    uint8_t which, field; /* which: 0 nothing, 1 arm, 2 pan-tilt unit, 3 detection */
    double value;
    uint32_t number;
} spoil_t;

static spoil_t s_spoil;
static kc_table_chunk_t s_chunk[KC_CHUNK_QUEUE_MAX];
static uint32_t s_n_chunk;
static kc_detection_t s_det; /* the newest one that was seen */
static int32_t s_faults; /* of the arm, in the input of the last step */

static void spoil_arm(kc_arm_state_t *a, const spoil_t *s)
{
    uint32_t j = (s->field >> 3) % KC_JOINT_MAX;
    switch (s->field % 10u) {
    case 0u: a->q[j] = s->value; break;
    case 1u: a->dq[j] = s->value; break;
    case 2u: a->q_cmd[j] = s->value; break;
    case 3u: a->dir[j] = s->value; break;
    case 4u: a->n_joints = s->number; break;
    case 5u: a->t_us += (uint64_t)(int64_t)(int32_t)s->number; break;
    case 6u: a->seq = (int32_t)s->number; break;
    case 7u: a->fault_mask = (int32_t)s->number; break;
    case 8u: *(j == 0u ? &a->temp_c : j == 1u ? &a->payload_kg : &a->g_m_s2[j % 3u]) = s->value; break;
    default: a->moving = (uint8_t)s->number; break;
    }
}

static void spoil_pantilt(kc_pantilt_state_t *p, const spoil_t *s)
{
    switch (s->field % 5u) {
    case 0u: p->pan_rad = s->value; break;
    case 1u: p->tilt_rad = s->value; break;
    case 2u: p->t_us += (uint64_t)(int64_t)(int32_t)s->number; break;
    case 3u: p->seq = (int32_t)s->number; break;
    default: p->moving = (uint8_t)s->number; break;
    }
}

static void spoil_det(kc_detection_t *d, const spoil_t *s)
{
    uint32_t k = s->number;
    switch (s->field % 14u) {
    case 0u: d->p_cam_tool_m[k % 3u] = s->value; break;
    case 1u: d->p_cam_tool_m[k % 3u] += 1e-3 * (double)(int8_t)(k >> 8); break;
    case 2u: d->q_cam_tool_wxyz[k % 4u] = s->value; break;
    case 3u: d->cov[k % 36u] = s->value; break;
    case 4u: d->cov[7u * (k % 6u)] *= s->value; break;
    case 5u: d->n_tags = k; break;
    case 6u: d->tag_id[k % KC_TAG_MAX] = (int32_t)(k >> 8); break;
    case 7u: d->seq = (int32_t)k; break;
    case 8u: d->t_us += (uint64_t)(int64_t)(int32_t)k; break;
    case 9u: d->rms_px = s->value; break;
    case 10u: d->p_alt_m[k % 3u] = s->value; break;
    case 11u: d->q_alt_wxyz[k % 4u] = s->value; break;
    case 12u: d->corner_px[k % (8u * KC_TAG_MAX)] = s->value; break;
    default: *(k % 2u == 0u ? &d->range_m : &d->u_px) = s->value; break;
    }
}

/* Called by the world before a step. */
static void spoil_in(kc_in_t *in)
{
    for (uint32_t i = 0u; i < s_n_chunk; i++) { in->chunk[i] = s_chunk[i]; }
    in->n_chunk = s_n_chunk;
    s_n_chunk = 0u;
    if (in->n_det > 0u) { s_det = in->det[0]; }
    if (s_spoil.which == 1u) { spoil_arm(&in->arm, &s_spoil); }
    if (s_spoil.which == 2u) { spoil_pantilt(&in->pantilt, &s_spoil); }
    if (s_spoil.which == 3u) {
        if (in->n_det == 0u) { in->det[in->n_det++] = s_det; } /* one that nobody requested */
        spoil_det(&in->det[0], &s_spoil);
    }
    s_spoil.which = 0u;
    s_faults = in->has_arm ? in->arm.fault_mask : 0;
}

/* A fault of the arm is taken whatever else its message is, and ends a calibration; it goes when a state without one
 * is accepted. before: taken before this step. */
static void check_faults(int32_t before)
{
    const kc_telemetry_t *t = &APP->input.telemetry;
    bool accepted = t->has_arm && t->arm_ok_us == APP->clock.now_us;
    int32_t held = accepted ? 0 : before;
    MUST((t->arm.fault_mask & (s_faults | held)) == (s_faults | held));
    MUST(t->arm.fault_mask == 0 || !world_calibrating());
}

/* ---- actions ---- */

static uint32_t s_steps;

/* All that is published can be encoded as a message. */
static void check_messages(const kc_out_t *o)
{
    static uint8_t buf[24u * 1024u];
#define MEMBER(CHANNEL, member, message, wire) kcm_##message##_t member;
    static union {
        KC_OUT_LIST(MEMBER)
    } m;
#define ENCODES(CHANNEL, member, message, wire)                                 \
    if (o->has_##member) {                                                      \
        wire(&o->member, 0, &m.member);                                         \
        MUST(kcm_##message##_t_encode(buf, 0, (int)sizeof buf, &m.member) > 0); \
    }
    KC_OUT_LIST(ENCODES)
}

static void step(void)
{
    kc_state_t before = kc_app_state(APP);
    uint32_t kin_crc = kc_app_active(APP)->crc[KC_TBL_KIN];
    int32_t fault = APP->input.telemetry.arm.fault_mask;
    if (s_steps++ >= STEPS_MAX) { return; }
    world_tick();
    fuzz_check_step(APP, &world.out, before, kin_crc);
    check_faults(fault);
    check_messages(&world.out);
}

static void steps(uint32_t n)
{
    for (uint32_t i = 0u; i < n && s_steps < STEPS_MAX; i++) { step(); }
}

static void command(int32_t opcode, int32_t a0, int32_t a1, int32_t a2)
{
    if (world.in.n_cmd < KC_CMD_QUEUE_MAX) { (void)world_cmd(opcode, a0, a1, a2); }
}

/* A command with right arguments, where there are such. */
static void right_command(int32_t opcode, uint8_t arg)
{
    const kc_active_t *a = kc_app_active(APP);
    int32_t proposed = (int32_t)APP->review.crc;
    int32_t kind = (int32_t)APP->tables.staging.kind;
    int32_t staged = (int32_t)kc_tbl_image_crc(APP->arena.idle.staged, KC_TBL_HDR_BYTES);
    switch (opcode) {
    case KC_CMD_START: command(opcode, (int32_t)(arg % 5u) - 1, arg >> 6, arg); break;
    case KC_CMD_APPROVE_ARM: command(opcode, proposed, (int32_t)(arg & 1u), 0); break;
    case KC_CMD_APPROVE_GO:
    case KC_CMD_REJECT: command(opcode, proposed, 0, 0); break;
    case KC_CMD_ROLLBACK: command(opcode, (int32_t)a->crc[KC_TBL_KIN], 0, 0); break;
    case KC_CMD_TABLE_VALIDATE:
    case KC_CMD_TABLE_ACTIVATE: command(opcode, kind, staged, 0); break;
    case KC_CMD_TABLE_DUMP: command(opcode, arg % 9u, 0, 0); break;
    default: command(opcode, 0, 0, 0); break;
    }
}

static void wrong_command(fuzz_t *f)
{
    if (world.in.n_cmd >= KC_CMD_QUEUE_MAX) { return; }
    kc_cmd_t *c = world_cmd((int32_t)(int8_t)fuzz_u8(f), 0, 0, 0);
    uint8_t what = fuzz_u8(f);
    if (what & 1u) { c->source = (int32_t)(int8_t)fuzz_u8(f); }
    if (what & 2u) { c->seq = (int32_t)fuzz_u32(f); }
    if (what & 4u) { c->arg_i[0] = (int32_t)fuzz_u32(f); }
    if (what & 8u) { c->arg_i[1] = (int32_t)fuzz_u32(f); }
    if (what & 16u) { c->arg_u64 = (uint64_t)fuzz_u32(f) << (what >> 5) * 4u; }
}

/* A table, spoiled or not, in as many chunks as fit into a step; then what puts it in force. */
static void uplink(fuzz_t *f)
{
    static uint8_t image[sizeof fuzz_image[0].data];
    uint16_t kind = 1u + fuzz_u8(f) % (KC_TBL_COUNT - 1u);
    uint8_t how = fuzz_u8(f);
    uint32_t n = fuzz_image[kind].n;
    memcpy(image, fuzz_image[kind].data, n);
    if (how & 1u) { fuzz_spoil(f, image, n); }
    if ((how & 2u) == 0u) { fuzz_seal_image(kind, image, n); }
    for (s_n_chunk = 0u; s_n_chunk < KC_CHUNK_QUEUE_MAX && s_n_chunk * KC_CHUNK_BYTES < n; s_n_chunk++) {
        kc_table_chunk_t *c = &s_chunk[s_n_chunk];
        uint32_t at = s_n_chunk * KC_CHUNK_BYTES;
        *c = (kc_table_chunk_t){.kind = kind, .total = n, .offset = at};
        c->n = n - at < KC_CHUNK_BYTES ? n - at : KC_CHUNK_BYTES;
        memcpy(c->data, &image[at], c->n);
    }
    if (how & 4u) { /* a bad chunk */
        kc_table_chunk_t *c = &s_chunk[fuzz_u8(f) % KC_CHUNK_QUEUE_MAX];
        *(how & 8u ? &c->n : how & 16u ? &c->offset : &c->total) = fuzz_u32(f);
        if (how & 32u) { c->kind = (int32_t)(int8_t)fuzz_u8(f); }
    }
    step();
    if (how & 64u) { return; }
    right_command(KC_CMD_TABLE_VALIDATE, 0u);
    step();
    right_command(KC_CMD_TABLE_ACTIVATE, 0u);
    steps(3u);
}

static void toggle(uint8_t what)
{
    bool *const setting[] = {&world.arm_silent, &world.pantilt_silent, &world.camera_silent,
                             &world.arm_frozen, &world.pantilt_frozen};
    if (what < 0x50u) {
        bool *s = setting[what % 5u];
        *s = !*s;
    } else if (what < 0x70u) {
        world.arm_ignores = what & 7;
    } else if (what < 0x90u) {
        world.hide = what & 31;
    } else if (what < 0xA0u) {
        world.pantilt_ignores = what & 7;
    } else if (what < 0xB0u) {
        world.jump_m = 0.01 * (what & 15);
    } else if (what < 0xD0u) {
        world.bias[what & 7] += (what & 8) ? 0.03 : -0.2;
    } else {
        world.arm_vibrates = what & 15;
    }
}

/* What is stored, spoiled or not, is all that is left. */
static void power_loss(fuzz_t *f)
{
    uint8_t how = fuzz_u8(f);
    uint16_t kind = (uint16_t)(fuzz_u8(f) % WORLD_KINDS);
    if (how & 1u) { fuzz_spoil(f, s_slots.data[kind][(how >> 1) & 1u], s_slots.n[kind][(how >> 1) & 1u]); }
    kc_app_init(APP);
    kc_app_keys(APP, &world.keys);
    static const uint16_t order[] = {KC_STORE_JOURNAL, 1, 2, 3, 4, 5, 6, 7, KC_STORE_PREV, KC_STORE_PROPOSAL};
    for (uint32_t i = 0u; i < sizeof order / sizeof order[0]; i++) {
        uint16_t k = order[i];
        for (uint32_t s = 0u; s < 2u; s++) {
            if (s_slots.n[k][s] > 0u) { (void)kc_app_load(APP, k, s_slots.data[k][s], s_slots.n[k][s]); }
        }
        if (k < KC_TBL_COUNT && k != KC_TBL_KIN) {
            (void)kc_app_load(APP, k, fuzz_image[k].data, fuzz_image[k].n);
        }
    }
    kc_app_boot(APP);
    world.requested = 0;
    memset(&world.in, 0, sizeof world.in);
    step();
}

/* Detections that nobody requested, at other joints: what the monitor gets. */
static void observe(uint8_t what)
{
    for (uint32_t i = 0u; i < 1u + what / 64u; i++) {
        world.q_cmd[i] += 0.1;
        steps(1u);
        world.requested = 1;
        steps(1u);
    }
}

static void act(fuzz_t *f)
{
    uint8_t what = fuzz_u8(f);
    switch (what % 13u) {
    case 0u:
    case 1u:
    case 2u: steps(1u + (what >> 4)); break;
    case 3u:
    case 4u: right_command(fuzz_u8(f) % 11, what); break;
    case 5u: wrong_command(f); break;
    case 6u:
    case 7u:
        s_spoil = (spoil_t){.which = (uint8_t)(1u + (what >> 4) % 3u), .field = fuzz_u8(f)};
        s_spoil.value = fuzz_f64(f);
        s_spoil.number = fuzz_u32(f);
        step();
        break;
    case 8u: toggle(fuzz_u8(f)); break;
    case 9u: uplink(f); break;
    case 10u:
        if (what & 0x80u) {
            world.skew_us += (int64_t)(int32_t)fuzz_u32(f);
        } else {
            s_fails = what >> 4;
        }
        break;
    case 11u: power_loss(f); break;
    default: observe(what); break;
    }
}

/* ---- places to begin at ---- */

typedef struct {
    kc_app_t app;
    slots_t slots;
    uint8_t world[WORLD_BYTES];
} begin_t;

#define BEGINS_MAX 48u
static begin_t *s_begin[BEGINS_MAX];
static uint32_t s_n_begin;

static void remember(void)
{
    MUST(s_n_begin < BEGINS_MAX);
    begin_t *b = s_begin[s_n_begin++] = malloc(sizeof *b);
    MUST(b != NULL);
    memcpy(&b->app, APP, sizeof b->app);
    b->slots = s_slots;
    memcpy(b->world, &world, WORLD_BYTES);
}

static void begin(const begin_t *b)
{
    memcpy(APP, &b->app, sizeof b->app);
    s_slots = b->slots;
    memcpy(&world, b->world, WORLD_BYTES);
    s_spoil.which = 0u;
    s_n_chunk = 0u;
    s_fails = 0u;
    s_steps = 0u;
}

/* The first step in each state of a calibration that is flown to its approval. */
static void remember_calibration(void)
{
    uint64_t seen = 0u;
    for (uint32_t i = 0u; i < 4000u && kc_app_state(APP) != KC_ST_REVIEW; i++) {
        uint64_t bit = (uint64_t)1u << kc_app_state(APP);
        if (world_calibrating() && (seen & bit) == 0u) { remember(); }
        seen |= bit;
        world_tick();
    }
    MUST(kc_app_state(APP) == KC_ST_REVIEW);
    remember();
    MUST(world_do(KC_CMD_APPROVE_ARM, (int32_t)APP->review.crc, 0, 0) == KC_OK);
    remember();
    MUST(world_do(KC_CMD_APPROVE_GO, (int32_t)APP->review.crc, 0, 0) == KC_OK);
    MUST(world_stored(100u) && kc_app_active(APP)->kin_prev_crc != 0u);
    remember();
}

static void fly(uint32_t n_local)
{
    fuzz_given_world(n_local);
    memset(&s_slots, 0, sizeof s_slots);
    world.keep = keep;
    world.spoil_in = spoil_in;
    world.bias[1] = 0.05;
    world.view_rad = 0.3;
    world_boot();
    world_tick();
    remember();
    world.config.approach_rad = n_local > 0u ? 0.1 : 0.0; /* WITHDRAW, APPROACH and REST, or not */
    world_started();
    remember_calibration();
}

int LLVMFuzzerInitialize(int *argc, char ***argv)
{
    (void)argc;
    (void)argv;
    fly(0u);
    fly(4u);
    return 0;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    fuzz_t f = {data, size};
    begin(s_begin[fuzz_u8(&f) % s_n_begin]);
    for (uint32_t i = 0u; i < ACTIONS_MAX && f.left > 0u && s_steps < STEPS_MAX; i++) { act(&f); }
    fuzz_check_tables(kc_app_active(APP));
    return 0;
}
