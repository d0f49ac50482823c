#include "fuzz.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "given_tables.h"
#include "given_world.h"
#include "kc_crc.h"
#include "kc_layout.h"

void fuzz_broken(const char *what, const char *file, int line)
{
    (void)fprintf(stderr, "%s:%d: does not hold: %s\n", file, line, what);
    abort();
}

/* ---- the input ---- */

uint8_t fuzz_u8(fuzz_t *f)
{
    if (f->left == 0u) { return 0u; }
    f->left--;
    return *f->at++;
}

uint16_t fuzz_u16(fuzz_t *f)
{
    uint16_t low = fuzz_u8(f);
    return (uint16_t)(low | (uint16_t)(fuzz_u8(f) << 8));
}

uint32_t fuzz_u32(fuzz_t *f)
{
    uint32_t low = fuzz_u16(f);
    return low | (uint32_t)fuzz_u16(f) << 16;
}

double fuzz_f64(fuzz_t *f)
{
    static const double edge[] = {
        0.0,    -0.0,  1.0,   -1.0,   NAN, INFINITY, -INFINITY,        1.7976931348623157e308,
        5e-324, 1e-12, 1e300, -1e300, 1e6, -1e6,     3.14159265358979, 0.1};
    uint8_t which = fuzz_u8(f);
    if (which < 0xF0u) { return edge[which % 16u]; }
    uint64_t bits = (uint64_t)fuzz_u32(f) << 32;
    bits |= fuzz_u32(f);
    double x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

/* ---- tables ---- */

fuzz_image_t fuzz_image[KC_TBL_COUNT];

void fuzz_spoil(fuzz_t *f, uint8_t *data, uint32_t n)
{
    uint32_t places = fuzz_u8(f) % 8u;
    for (uint32_t i = 0u; i < places && n > 0u; i++) {
        uint32_t at = fuzz_u16(f) % n;
        uint8_t how = fuzz_u8(f);
        double x = how < 0x40u ? fuzz_f64(f) : 0.0;
        if (how < 0x40u && n - at >= sizeof x) {
            memcpy(&data[at], &x, sizeof x);
        } else if (how < 0x60u) {
            data[at] ^= (uint8_t)(1u << (how & 7u));
        } else {
            data[at] = fuzz_u8(f);
        }
    }
}

void fuzz_seal_image(uint16_t kind, uint8_t *image, uint32_t n)
{
    static const uint8_t magic[4] = {'K', 'C', 'T', '1'};
    if (n < KC_TBL_HDR_BYTES) { return; }
    memcpy(image, magic, sizeof magic);
    image[4] = (uint8_t)kind;
    image[5] = (uint8_t)(kind >> 8);
    image[6] = (uint8_t)kc_layout_version(kind);
    image[7] = 0u;
    given_resealed(image, n);
}

static void keep_image(uint16_t kind, const void *table)
{
    static uint8_t image[KC_IMAGE_MAX];
    fuzz_image_t *i = &fuzz_image[kind];
    i->n = given_image(kind, table, image);
    MUST(i->n > 0u && i->n <= sizeof i->data);
    memcpy(i->data, image, i->n);
}

void fuzz_given_world(uint32_t n_local)
{
    kc_kin_t kin;
    given_world();
    given_kin(&kin);
    given_space(&world.space, 8u, 1u);
    if (n_local > 0u) { given_local_poses(n_local, 1u); }
    world.config.n_poses = n_local + 3u;
    world.config.frames_per_meas = 1u;
    world.config.search_steps = 3u;
    world.config.est.iter_max = 8u;
    world.config.est.free_mask = 0xFFu; /* joints 1 and 2 */
    keep_image(KC_TBL_ARM, &world.arm);
    world.space.arm_crc = kc_tbl_image_crc(fuzz_image[KC_TBL_ARM].data, fuzz_image[KC_TBL_ARM].n);
    keep_image(KC_TBL_CAMERA, &world.camera);
    keep_image(KC_TBL_TERMS, &world.terms);
    keep_image(KC_TBL_KIN, &kin);
    keep_image(KC_TBL_SPACE, &world.space);
    keep_image(KC_TBL_KERNEL, &world.kernel);
    keep_image(KC_TBL_CONFIG, &world.config);
}

void fuzz_check_tables(const kc_active_t *a)
{
    static uint8_t image[KC_IMAGE_MAX];
    for (uint16_t kind = 1u; kind < KC_TBL_COUNT; kind++) {
        const void *table = kc_tbl_active_ptr(a, kind);
        uint32_t n = 0u;
        if (a->crc[kind] == 0u) { continue; }
        MUST(kc_crc32(0u, table, kc_tbl_active_bytes(kind)) == a->seal[kind]);
        MUST(kc_tbl_encode(kind, table, 0u, image, sizeof image, &n) == KC_OK);
        MUST(kc_tbl_image_crc(image, n) == a->crc[kind]);
    }
}

/* ---- a step ---- */

static void check_finite(const double *x, uint32_t n)
{
    for (uint32_t i = 0u; i < n; i++) { MUST(isfinite(x[i])); }
}

/* Inside the box of a node: hubs and candidates, with the bound of a candidate that CONFIG and SPACE allow. */
static bool near_node(const kc_active_t *a, const double *q)
{
    for (uint32_t node = 0u; node < KC_HUB_MAX + a->space.n_cand; node++) {
        bool hub = node < KC_HUB_MAX;
        const float *seed = hub ? a->space.hub_q[node] : a->space.cand[node - KC_HUB_MAX].q_seed;
        bool in = !hub || node < a->space.n_hub;
        for (uint32_t j = 0u; j < a->arm.n_joints && in; j++) {
            double bound = fmin(a->config.servo.bound, (double)a->space.servo_bound[j]);
            if (hub) { bound = fmin(bound, 0.05); }
            in = fabs(q[j] - (double)seed[j]) <= bound + a->config.arrive_tol + 1e-6;
        }
        if (in) { return true; }
    }
    return false;
}

/* At a stop of the current candidate, on its way from the hub. */
static bool at_stop(const kc_app_t *app, const double *q)
{
    const kc_space_t *s = &app->tables.active.space;
    uint32_t cand = (uint32_t)app->cal.candidate;
    double stop[KC_JOINT_MAX];
    for (uint32_t i = 0u; cand < s->n_cand && i < kc_space_n_stops(s, cand); i++) {
        bool at = true;
        kc_space_stop(s, cand, i, stop);
        for (uint32_t j = 0u; j < s->n_joints; j++) { at = at && fabs(q[j] - stop[j]) <= 1e-9; }
        if (at) { return true; }
    }
    return false;
}

static void check_arm_cmd(const kc_app_t *app, const kc_arm_cmd_t *c, kc_state_t before)
{
    const kc_active_t *a = &app->tables.active;
    MUST(c->n_joints <= KC_JOINT_MAX);
    check_finite(c->q, KC_JOINT_MAX);
    check_finite(&c->speed_scale, 1u);
    if (c->hold) { return; } /* where it is: q is ignored */
    MUST(kc_states_calibrating(before) || kc_states_calibrating(kc_app_state(app)));
    MUST(c->n_joints == a->arm.n_joints);
    for (uint32_t j = 0u; j < c->n_joints; j++) {
        MUST(c->q[j] >= a->arm.joint[j].q_min - 1e-6 && c->q[j] <= a->arm.joint[j].q_max + 1e-6);
    }
    MUST(near_node(a, c->q) || at_stop(app, c->q));
}

static void check_commands(const kc_app_t *app, const kc_out_t *out, kc_state_t before)
{
    const kc_camera_t *cam = &app->tables.active.camera;
    if (out->has_arm_cmd) { check_arm_cmd(app, &out->arm_cmd, before); }
    if (out->has_pantilt_cmd) {
        MUST(kc_states_calibrating(before) || kc_states_calibrating(kc_app_state(app)));
        MUST(out->pantilt_cmd.pan_rad >= cam->pan_min_rad && out->pantilt_cmd.pan_rad <= cam->pan_max_rad);
        MUST(out->pantilt_cmd.tilt_rad >= cam->tilt_min_rad &&
             out->pantilt_cmd.tilt_rad <= cam->tilt_max_rad);
    }
}

static void check_telemetry(const kc_out_t *out)
{
    if (out->has_progress) {
        check_finite(&out->progress.acquisition_value, 8u); /* to pred_rot_rad */
        check_finite(&out->progress.chi2, 1u);
        check_finite(&out->progress.fit_pos_m, 3u); /* to energy_j */
        check_finite(out->progress.coef, KC_COEF_MAX);
    }
    if (out->has_proposal) {
        const kc_proposal_t *p = &out->proposal;
        check_finite(p->kin.value, KC_COEF_MAX);
        check_finite(p->kin.sigma, KC_COEF_MAX);
        check_finite(p->cov, KC_COEF_MAX * (KC_COEF_MAX + 1u) / 2u);
        check_finite(&p->chi2, 12u); /* to pred_rot_rad */
    }
    if (out->has_meas) {
        check_finite(out->meas.arm.q, 4u * KC_JOINT_MAX); /* to dir */
        check_finite(out->meas.obs.p_m, 3u);
        check_finite(out->meas.obs.q_wxyz, 4u);
        check_finite(out->meas.obs.cov, 36u);
    }
    if (out->has_hk) {
        check_finite(&out->hk.energy_j, 1u);
        check_finite(&out->hk.mon_bias, 3u);
    }
}

static void check_counts(const kc_app_t *app, const kc_out_t *out)
{
    MUST((uint32_t)kc_app_state(app) < KC_ST_COUNT);
    MUST(out->n_ack <= KC_CMD_QUEUE_MAX + 1u && out->events.n <= KC_EVENTS_MAX);
    MUST(out->n_store <= KC_STORE_QUEUE_MAX);
    for (uint32_t i = 0u; i < out->n_store; i++) {
        MUST(out->store[i].n <= KC_IMAGE_MAX && (out->store[i].n == 0u || out->store[i].data != NULL));
    }
    const kc_table_chunk_t *c = &out->table_down;
    MUST(c->n <= KC_CHUNK_BYTES && c->offset + c->n <= c->total);
    MUST(app->est.n_obs <= KC_MEAS_MAX && app->plan.n_meas <= KC_MEAS_MAX);
}

/* Every pointer inside the component leads back into it. */
static void check_pointers(const kc_app_t *app)
{
    MUST(app->view.clock == &app->clock && app->view.place == &app->place);
    MUST(app->view.tables == &app->tables.active && app->view.telemetry == &app->input.telemetry);
    MUST(app->view.est == &app->est && app->view.servo_steps == &app->observe.servo_steps);
    MUST(app->tables.scratch == &app->arena.idle.scratch);
    MUST(app->tables.staging.image == app->arena.idle.staged);
}

void fuzz_check_step(const kc_app_t *app, const kc_out_t *out, kc_state_t before, uint32_t kin_crc)
{
    check_counts(app, out);
    check_pointers(app);
    check_commands(app, out, before);
    check_telemetry(out);
    for (uint32_t i = 0u; i < out->events.n; i++) { /* nobody has changed memory */
        MUST(out->events.e[i].id != KC_EVT_MEMORY_TABLE && out->events.e[i].id != KC_EVT_MEMORY_OBSERVATIONS);
    }
    MUST(app->tables.active.crc[KC_TBL_KIN] == kin_crc || before == KC_ST_STORE);
}
