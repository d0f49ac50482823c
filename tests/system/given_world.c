#include "given_world.h"

#include <math.h>
#include <string.h>

#include "given_parts.h"
#include "given_tables.h"
#include "kc_rng.h"
#include "kc_signed.h"
#include "kc_vec.h"
#include "unity.h"

world_t world;

static const uint16_t s_kinds[] = {KC_STORE_JOURNAL, 1, 2, 3, 4, 5, 6, 7, KC_STORE_PREV, KC_STORE_PROPOSAL};

void given_world(void)
{
    memset(&world, 0, sizeof world);
    given_arm(&world.arm);
    given_camera(&world.camera);
    given_terms(&world.terms);
    given_kernel(&world.kernel);
    given_config(&world.config);
    world.config.settle_us = 100000u;
    world.config.n_poses = 6u;
    world.truth = world.arm;
    world.now_us = 1000000u;
    world.rng = 7u;
    world.keys.n = 1u;
    world.keys.key[0].id = 1u;
    for (uint32_t i = 0u; i < KC_KEY_BYTES; i++) { world.keys.key[0].secret[i] = (uint8_t)(i + 1u); }
    world.noise_m = 1e-4;
    world.noise_rad = 2e-4;
    given_space(&world.space, 24u, 1u);
}

void overstate(kc_detection_t *d)
{
    for (uint32_t i = 0u; i < 36u; i++) { d->cov[i] *= 1e-2; }
}

void given_overstated_detections(void)
{
    world.spoil = overstate;
    world.noise_m = 2e-3;
    world.noise_rad = 8e-3;
    world.config.frames_per_meas = 1u;
    world.config.est.outlier_p = 0.0;
}

void given_pose_of_seed(kc_cand_t *c)
{
    kc_pose_t T;
    double q[KC_JOINT_MAX], quat[4];
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { q[j] = (double)c->q_seed[j]; }
    kc_arm_fk(&world.arm, q, &T);
    kc_R_to_quat(T.R, quat);
    for (uint32_t k = 0u; k < 3u; k++) { c->p_m[k] = (float)T.p_m[k]; }
    for (uint32_t k = 0u; k < 4u; k++) { c->q_wxyz[k] = (float)quat[k]; }
}

void given_local_poses(uint32_t n, uint32_t n_reserve)
{
    static const float home[KC_JOINT_MAX] = {-0.4f, 0.13f, -0.31f, 1.35f, -0.52f, -0.05f, -0.86f};
    kc_space_t *s = &world.space;
    memcpy(s->hub_q[0], home, sizeof home);
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { world.q[j] = world.q_cmd[j] = (double)home[j]; }
    memmove(&s->initial[n], s->initial, s->n_initial * sizeof s->initial[0]);
    s->n_initial += n;
    for (uint32_t i = 0u; i < n; i++) {
        uint32_t cand = s->n_cand - n + i;
        kc_cand_t *c = &s->cand[cand];
        s->initial[i] = (uint16_t)cand;
        memcpy(c->q_seed, home, sizeof home);
        if (i > 0u) { c->q_seed[(i - 1u) % 7u] += (float)(i < 8u ? LOCAL_STEP_RAD : -LOCAL_STEP_RAD); }
        given_pose_of_seed(c);
        c->hub = 0u;
        c->why = (uint16_t)(i < n - n_reserve ? KC_CAND_LOCAL : KC_CAND_LOCAL | KC_CAND_RESERVE);
    }
}

static void offer(uint16_t kind, const void *table)
{
    uint32_t n = given_image(kind, table, world.image);
    (void)kc_app_load(&kc_app_instance, kind, world.image, n);
}

static void offer_default(uint16_t kind)
{
    switch (kind) {
    case KC_TBL_ARM: offer(kind, &world.arm); break;
    case KC_TBL_CAMERA: offer(kind, &world.camera); break;
    case KC_TBL_TERMS: offer(kind, &world.terms); break;
    case KC_TBL_SPACE:
        world.space.arm_crc = kc_app_instance.tables.active.crc[KC_TBL_ARM];
        offer(kind, &world.space);
        break;
    case KC_TBL_KERNEL: offer(kind, &world.kernel); break;
    case KC_TBL_CONFIG: offer(kind, &world.config); break;
    default: break; /* no correction: nominal */
    }
}

void world_boot(void)
{
    kc_app_init(&kc_app_instance);
    kc_app_keys(&kc_app_instance, &world.keys);
    for (uint32_t i = 0u; i < sizeof s_kinds / sizeof s_kinds[0]; i++) {
        uint16_t k = s_kinds[i];
        for (uint32_t s = 0u; s < 2u; s++) {
            if (world.stored[k][s] > 0u) {
                (void)kc_app_load(&kc_app_instance, k, world.store[k][s], world.stored[k][s]);
            }
        }
        offer_default(k);
    }
    kc_app_boot(&kc_app_instance);
}

void world_restart(void)
{
    world.requested = false;
    memset(&world.in, 0, sizeof world.in);
    memset(world.events, 0, sizeof world.events);
    world.cmd_seq[1] = world.cmd_seq[2] = 0;
    world_boot();
}

/* ---- arm and pan-tilt unit ---- */

static bool approach(double *x, double goal, double step)
{
    double d = goal - *x;
    if (fabs(d) <= step) {
        *x = goal;
        return fabs(d) > 0.0;
    }
    *x += d > 0.0 ? step : -step;
    return true;
}

/* All joints arrive together: straight in joint space. */
static bool move_arm(void)
{
    double far = 0.0;
    if (world.arm_frozen) { return false; }
    for (uint32_t j = 0u; j < world.arm.n_joints; j++) { far = fmax(far, fabs(world.q_cmd[j] - world.q[j])); }
    double step = world.arm_slow ? 0.002 : 0.4, part = far > step ? step / far : 1.0;
    for (uint32_t j = 0u; j < world.arm.n_joints; j++) {
        double d = world.q_cmd[j] - world.q[j];
        if (fabs(d) > 1e-9) { world.dir[j] = d > 0.0 ? 1.0 : -1.0; }
    }
    for (uint32_t j = 0u; j < world.arm.n_joints; j++) { world.q[j] += part * (world.q_cmd[j] - world.q[j]); }
    return far > 0.0;
}

static void report_arm(bool moving)
{
    kc_arm_state_t *a = &world.in.arm;
    world.in.has_arm = !world.arm_silent;
    memset(a, 0, sizeof *a);
    a->t_us = world.now_us;
    a->seq = ++world.arm_seq;
    a->n_joints = world.arm.n_joints;
    memcpy(a->q, world.q, sizeof a->q);
    memcpy(a->q_cmd, world.q_cmd, sizeof a->q_cmd);
    memcpy(a->dir, world.dir, sizeof a->dir);
    a->moving = moving || world.arm_vibrates > 0;
    world.arm_vibrates -= world.arm_vibrates > 0;
    a->fault_mask = world.fault;
    a->temp_c = 20.0;
    a->g_m_s2[2] = -9.81;
}

static void report_pantilt(bool moving)
{
    kc_pantilt_state_t *h = &world.in.pantilt;
    world.in.has_pantilt = !world.pantilt_silent;
    h->t_us = world.now_us;
    h->seq = ++world.pantilt_seq;
    h->pan_rad = world.pan;
    h->tilt_rad = world.tilt;
    h->moving = moving || world.pantilt_vibrates > 0;
    world.pantilt_vibrates -= world.pantilt_vibrates > 0;
}

/* ---- camera ---- */

static double noise(double sigma) { return sigma * sqrt(3.0) * (2.0 * kc_rng_uniform(&world.rng) - 1.0); }

static bool hidden(const kc_pose_t *T)
{
    double off = atan2(sqrt(T->p_m[0] * T->p_m[0] + T->p_m[1] * T->p_m[1]), T->p_m[2]);
    double far = 0.0;
    for (uint32_t j = 0u; j < world.arm.n_joints; j++) {
        far = fmax(far, fabs(world.q[j] - world.q_start[j]));
    }
    if (world.view_rad > 0.0 && off > world.view_rad) { return true; }
    if (world.hide_beyond > 0.0 && far > world.hide_beyond) { return true; }
    if (world.hide > 0) {
        world.hide--;
        return true;
    }
    return false;
}

static void expose(kc_detection_t *d)
{
    double q_true[KC_JOINT_MAX], w[3], E[9], R[9], sp = fmax(world.noise_m, 1e-5),
                                                   sr = fmax(world.noise_rad, 1e-5);
    kc_pose_t T_tool, T_cam, T;
    memset(d, 0, sizeof *d);
    d->t_us = world.now_us;
    d->seq = world.frame_requested;
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { q_true[j] = world.q[j] + world.bias[j]; }
    kc_arm_fk(&world.truth, q_true, &T_tool);
    kc_camera_pose(&world.camera, world.pan, world.tilt + world.tilt_bias_rad, &T_cam);
    kc_pose_inv(&T_cam, &T);
    kc_pose_mul(&T, &T_tool, &T);
    for (uint32_t i = 0u; i < KC_TAG_MAX; i++) { d->tag_id[i] = -1; }
    if (hidden(&T)) { return; }
    d->n_tags = 2u;
    d->tag_id[0] = 0;
    d->tag_id[1] = 1;
    for (uint32_t i = 0u; i < 3u; i++) {
        d->p_cam_tool_m[i] = T.p_m[i] + noise(sp);
        w[i] = noise(sr);
    }
    d->p_cam_tool_m[0] += world.jump_m;
    world.jump_m = 0.0;
    kc_R_exp(w, E);
    kc_m3_mul(E, T.R, R);
    kc_R_to_quat(R, d->q_cam_tool_wxyz);
    for (uint32_t i = 0u; i < 6u; i++) { d->cov[7u * i] = i < 3u ? sp * sp : sr * sr; }
    memcpy(d->p_alt_m, d->p_cam_tool_m, sizeof d->p_alt_m);
    memcpy(d->q_alt_wxyz, d->q_cam_tool_wxyz, sizeof d->q_alt_wxyz);
    d->rms_px = 0.3;
    d->rms_alt_px = 5.0;
    d->range_m = kc_v3_norm(T.p_m);
    d->u_px = 960.0;
    d->v_px = 540.0;
}

static void take_frame(void)
{
    world.in.n_det = 0u;
    if (!world.requested) { return; }
    world.requested = false;
    if (world.camera_silent) { return; }
    world.in.n_det = world.frames_at_once > 0u ? world.frames_at_once : 1u;
    for (uint32_t i = 0u; i < world.in.n_det; i++) {
        kc_detection_t *d = &world.in.det[i];
        expose(d);
        d->t_us -= world.in.n_det - 1u - i;
        if (world.spoil != NULL) { world.spoil(d); }
    }
}

/* ---- what came out ---- */

static void obey(void)
{
    const kc_out_t *o = &world.out;
    if (o->has_arm_cmd) {
        world.arm_cmd = o->arm_cmd;
        if (world.arm_ignores > 0) {
            world.arm_ignores--;
        } else {
            memcpy(world.q_cmd, o->arm_cmd.hold ? world.q : o->arm_cmd.q, sizeof world.q_cmd);
        }
    }
    if (o->has_pantilt_cmd) {
        world.n_pantilt_cmd++;
        if (world.pantilt_ignores > 0) {
            world.pantilt_ignores--;
        } else {
            world.pan_cmd = o->pantilt_cmd.pan_rad;
            world.tilt_cmd = o->pantilt_cmd.tilt_rad;
        }
    }
    if (o->has_frame_request) {
        world.requested = true;
        world.frame_requested = o->frame_request.seq;
        world.n_frames++;
    }
}

static kc_status_t keep(const kc_store_t *s)
{
    uint16_t k = s->kind;
    if (world.keep != NULL) { return world.keep(s); }
    if (world.store_fails != 0 && (world.store_fails_kind == 0u || world.store_fails_kind == k)) {
        world.store_fails -= world.store_fails > 0;
        return KC_ERR_NUM;
    }
    if (s->n == 0u) {
        world.stored[k][0] = world.stored[k][1] = 0u;
        return KC_OK;
    }
    if (world.stored[k][0] == s->n && memcmp(world.store[k][0], s->data, s->n) == 0) { return KC_OK; }
    memcpy(world.store[k][1], world.store[k][0], world.stored[k][0]);
    world.stored[k][1] = world.stored[k][0];
    memcpy(world.store[k][0], s->data, s->n);
    world.stored[k][0] = s->n;
    return KC_OK;
}

/* Up to the first failure; the component hears of it in the next step. */
static void store_all(const kc_out_t *o)
{
    kc_status_t st = KC_OK;
    for (uint32_t i = 0u; i < o->n_store && st == KC_OK; i++) {
        st = keep(&o->store[i]);
        world.in.has_store_result = 1u;
        world.in.store_kind = o->store[i].kind;
        world.in.store_status = (int32_t)st;
    }
}

static void remember_answered(const kc_ack_t *ack)
{
    for (uint32_t i = 0u; i < KC_CMD_QUEUE_MAX; i++) {
        const kc_cmd_t *c = &world.sent[i];
        bool same = c->source == ack->source && c->seq == ack->seq && c->opcode == ack->opcode;
        if (same && ack->status == KC_OK) { world.answered = *c; }
    }
}

/* A number that the text of an event does not name is 0. */
static void assert_as_documented(const kc_event_t *e)
{
    const char *name = kc_event_name(e->id), *text = kc_event_text(e->id);
    TEST_ASSERT_TRUE_MESSAGE(text[0] != '\0', name);
    if (strstr(text, "{got") == NULL) { TEST_ASSERT_EQUAL_DOUBLE_MESSAGE(0.0, e->got, name); }
    if (strstr(text, "{want") == NULL) { TEST_ASSERT_EQUAL_DOUBLE_MESSAGE(0.0, e->want, name); }
}

static void listen(void)
{
    const kc_out_t *o = &world.out;
    store_all(o);
    for (uint32_t i = 0u; i < o->events.n; i++) {
        assert_as_documented(&o->events.e[i]);
        world.events[o->events.e[i].id]++;
        world.last[o->events.e[i].id] = o->events.e[i];
    }
    for (uint32_t i = 0u; i < o->n_ack; i++) {
        world.ack = o->ack[i];
        world.n_acks++;
        remember_answered(&world.ack);
    }
    if (o->has_meas) { world.meas[world.n_meas++ % KC_MEAS_MAX] = o->meas; }
    if (o->has_progress) { world.progress[world.n_progress++ % KC_MEAS_MAX] = o->progress; }
    if (o->has_proposal) {
        world.proposal = o->proposal;
        world.n_proposal++;
    }
    if (o->has_hk) {
        world.hk = o->hk;
        world.n_hk++;
    }
}

/* ---- commands ---- */

void world_sign_cmd(kc_cmd_t *c)
{
    if (c->t_us == 0u) { c->t_us = (uint64_t)((int64_t)world.now_us + world.skew_us); }
    given_signature(c, &world.keys.key[world.signer], ++world.counter);
    world.sent[world.counter % KC_CMD_QUEUE_MAX] = *c;
}

void world_sign_chunk(kc_table_chunk_t *c)
{
    uint8_t head[KC_SIGNED_HEAD_MAX];
    if (c->source == 0) { c->source = KC_SRC_GROUND; }
    if (c->t_us == 0u) { c->t_us = (uint64_t)((int64_t)world.now_us + world.skew_us); }
    c->auth.key_id = world.keys.key[world.signer].id;
    c->auth.counter = ++world.counter;
    kc_auth_text_t text = kc_signed_chunk(c, head);
    kc_auth_mac(&world.keys.key[world.signer], &text, c->auth.mac);
}

static bool open_to_all(const kc_cmd_t *c) { return c->opcode == KC_CMD_NOOP || c->opcode == KC_CMD_ABORT; }

static void sign_all(void)
{
    if (world.as_sent) { return; }
    for (uint32_t i = 0u; i < world.in.n_chunk && i < KC_CHUNK_QUEUE_MAX; i++) {
        world_sign_chunk(&world.in.chunk[i]);
    }
    for (uint32_t i = 0u; i < world.in.n_cmd && i < KC_CMD_QUEUE_MAX; i++) {
        if (!open_to_all(&world.in.cmd[i])) { world_sign_cmd(&world.in.cmd[i]); }
    }
}

void world_tick(void)
{
    world.now_us += TICK_US;
    bool arm = move_arm();
    bool pantilt = false;
    if (!world.pantilt_frozen) {
        pantilt = approach(&world.pan, world.pan_cmd, 0.5);
        pantilt = approach(&world.tilt, world.tilt_cmd, 0.5) || pantilt;
    }
    report_arm(arm);
    report_pantilt(pantilt);
    take_frame();
    if (world.spoil_in != NULL) { world.spoil_in(&world.in); }
    sign_all();
    kc_app_step(&kc_app_instance, (uint64_t)((int64_t)world.now_us + world.skew_us), &world.in, &world.out);
    memset(&world.in, 0, sizeof world.in);
    obey();
    listen();
}

void world_ticks(uint32_t n)
{
    for (uint32_t i = 0u; i < n; i++) { world_tick(); }
}

bool world_until(kc_state_t state, uint32_t max)
{
    for (uint32_t i = 0u; i < max; i++) {
        if (kc_app_state(&kc_app_instance) == state) { return true; }
        world_tick();
    }
    return kc_app_state(&kc_app_instance) == state;
}

bool world_until_event(uint32_t id, uint32_t max)
{
    uint32_t before = world.events[id];
    for (uint32_t i = 0u; i < max && world.events[id] == before; i++) { world_tick(); }
    return world.events[id] > before;
}

void world_seal(uint16_t kind) { given_seal(&kc_app_instance.tables.active, kind); }

void world_kin(kc_kin_t *kin)
{
    given_kin(kin);
    kin->arm_crc = kc_app_active(&kc_app_instance)->crc[KC_TBL_ARM];
    kin->terms_crc = kc_app_active(&kc_app_instance)->crc[KC_TBL_TERMS];
}

int32_t world_upload(uint16_t kind, const uint8_t *image, uint32_t n)
{
    for (uint32_t at = 0u; at < n; at += KC_CHUNK_BYTES) {
        uint32_t left = n - at, part = left < KC_CHUNK_BYTES ? left : KC_CHUNK_BYTES;
        world.in.chunk[0] = (kc_table_chunk_t){.kind = kind, .total = n, .offset = at, .n = part};
        memcpy(world.in.chunk[0].data, &image[at], part);
        world.in.n_chunk = 1u;
        world_tick();
    }
    return (int32_t)kc_tbl_image_crc(image, n);
}

bool world_stored(uint32_t max)
{
    for (uint32_t i = 0u; i < max && kc_app_state(&kc_app_instance) == KC_ST_STORE; i++) { world_tick(); }
    return kc_app_state(&kc_app_instance) != KC_ST_STORE;
}

bool world_measuring(void)
{
    kc_state_t state = kc_app_state(&kc_app_instance);
    return state == KC_ST_OBSERVE || state == KC_ST_MEASURE;
}

bool world_calibrating(void) { return kc_states_calibrating(kc_app_state(&kc_app_instance)); }

uint32_t world_events(uint32_t id) { return world.events[id]; }

kc_cmd_t *world_cmd(int32_t opcode, int32_t a0, int32_t a1, int32_t a2)
{
    kc_cmd_t *c = &world.in.cmd[world.in.n_cmd++];
    memset(c, 0, sizeof *c);
    c->source = 1;
    c->seq = ++world.cmd_seq[1];
    c->opcode = opcode;
    c->arg_i[0] = a0;
    c->arg_i[1] = a1;
    c->arg_i[2] = a2;
    return c;
}

int32_t world_do(int32_t opcode, int32_t a0, int32_t a1, int32_t a2)
{
    (void)world_cmd(opcode, a0, a1, a2);
    uint32_t before = world.n_acks;
    world_tick();
    for (uint32_t i = 0u; i < 100u && world.n_acks == before; i++) { world_tick(); } /* it is stored first */
    return world.ack.status;
}

void world_started(void)
{
    world_boot();
    world_tick();
    memcpy(world.q_start, world.q, sizeof world.q_start);
    (void)world_do(KC_CMD_START, -1, 0, 3);
}

uint32_t world_kin_crc(void) { return kc_app_active(&kc_app_instance)->crc[KC_TBL_KIN]; }

uint32_t world_approve(void)
{
    const int32_t crc = (int32_t)world.proposal.crc;
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_APPROVE_ARM, crc, 0, 0));
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_APPROVE_GO, crc, 0, 0));
    return world.proposal.crc;
}

void world_calibrated(void)
{
    world_started();
    for (uint32_t i = 0u; i < 4000u && world_calibrating(); i++) { world_tick(); }
    (void)world_stored(100u);
}

/* ---- nothing changed ---- */

typedef struct {
    kc_active_t active;
    kc_cal_t cal;
    kc_plan_t plan;
    kc_latest_t latest;
    kc_frames_t frames;
    kc_state_t state;
    kc_stage_t staged;
    uint32_t staged_n, staged_kind, proposal_crc, n_obs;
    int32_t arm_seq, pantilt_seq;
} memory_t;

static memory_t s_then, s_now;

static void remember(memory_t *m)
{
    const kc_app_t *a = &kc_app_instance;
    memset(m, 0, sizeof *m);
    m->active = a->tables.active;
    m->cal = a->cal;
    m->cal.energy_j = 0.0; /* goes on with time */
    m->cal.energy_us = 0u;
    m->plan = a->plan;
    m->latest = a->latest;
    m->frames = a->frames;
    m->state = a->place.state;
    m->staged = a->tables.staging.state;
    m->staged_n = a->tables.staging.n;
    m->staged_kind = a->tables.staging.kind;
    m->proposal_crc = a->review.crc;
    m->n_obs = a->est.n_obs;
    m->arm_seq = a->input.telemetry.arm.seq;
    m->pantilt_seq = a->input.telemetry.pantilt.seq;
}

void world_remember(void) { remember(&s_then); }

bool world_unchanged(void)
{
    remember(&s_now);
    return memcmp(&s_then, &s_now, sizeof s_then) == 0;
}
