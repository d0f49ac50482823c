/* Table images: what is accepted writes back to the same bytes, by uplink and at boot alike; what is refused changes
 * nothing; an accepted table can be used.
 *
 * Input: kind, how, then either places at which a good image is spoiled, or an image. */
#include <math.h>
#include <string.h>

#include "fuzz.h"
#include "kc_bounds.h"
#include "kc_guard.h"

static kc_tables_t s_good, s_loaded, s_staged;
static kc_tbl_scratch_t s_scratch;
static uint8_t s_image[KC_IMAGE_MAX], s_again[KC_IMAGE_MAX], s_stage[KC_IMAGE_MAX];
static union {
    kc_space_t space;
    kc_terms_t terms;
    kc_kernel_t kernel;
} s_table;

int LLVMFuzzerInitialize(int *argc, char ***argv)
{
    kc_events_t ev = {0};
    (void)argc;
    (void)argv;
    fuzz_given_world(3u);
    s_good.scratch = &s_scratch;
    s_good.staging.image = s_stage;
    for (uint16_t kind = 1u; kind < KC_TBL_COUNT; kind++) {
        MUST(kc_tbl_load(&s_good, kind, fuzz_image[kind].data, fuzz_image[kind].n, &ev) == KC_OK);
    }
    s_loaded = s_staged = s_good;
    return 0;
}

/* The image of the input; its size. */
static uint32_t make_image(fuzz_t *f, uint16_t kind, uint8_t how)
{
    const fuzz_image_t *good = &fuzz_image[kind < KC_TBL_COUNT ? kind : 0u];
    uint32_t n = good->n;
    if ((how & 1u) != 0u) {
        n = f->left < sizeof s_image ? (uint32_t)f->left : (uint32_t)sizeof s_image;
        memcpy(s_image, f->at, n);
    } else {
        memcpy(s_image, good->data, n);
        uint32_t cut = (how & 4u) != 0u ? fuzz_u16(f) % (n + 1u) : 0u;
        fuzz_spoil(f, s_image, n);
        n -= cut;
    }
    if ((how & 2u) == 0u) { fuzz_seal_image(kind, s_image, n); }
    return n;
}

/* By chunks, validate and activate, as an uplink. */
static kc_status_t uplink(uint16_t kind, uint32_t n, kc_events_t *ev)
{
    kc_tables_t *t = &s_staged;
    uint32_t crc = kc_tbl_image_crc(s_image, n);
    kc_status_t st = n > 0u ? KC_OK : KC_ERR_FORMAT;
    for (uint32_t at = 0u; at < n && st == KC_OK; at += KC_CHUNK_BYTES) {
        uint32_t part = n - at < KC_CHUNK_BYTES ? n - at : KC_CHUNK_BYTES;
        st = kc_tbl_chunk(t, kind, n, at, &s_image[at], part, ev);
    }
    if (st == KC_OK) { st = kc_tbl_validate(t, kind, crc, ev); }
    if (st == KC_OK) {
        st = kc_tbl_ready(t, kind, crc, ev);
        MUST(kc_tbl_activate(t, kind, crc, ev) == st);
    }
    if (st != KC_OK) { kc_tbl_discard(t, ev); }
    return st;
}

static void check_roadmap(const kc_active_t *a)
{
    uint16_t path[KC_PATH_MAX + 1u];
    double q[KC_JOINT_MAX] = {0.0}, dist, bound[KC_JOINT_MAX];
    uint32_t n = 0u, last = KC_HUB_MAX + a->space.n_cand - 1u;
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { bound[j] = (double)a->space.servo_bound[j]; }
    MUST(kc_path_plan(&a->space, 0u, last, path, &n) == KC_OK && n > 0u &&
         n <= KC_PATH_MAX); /* all are reachable */
    MUST(path[n - 1u] == last);
    kc_path_joints(&a->space, last, q);
    MUST(kc_path_nearest(&a->space, bound, q, &dist) != KC_NODE_NONE && dist <= 1.0);
}

/* Numbers that an accepted table gives are finite. */
static void use(const kc_active_t *a, fuzz_t *f)
{
    double q[KC_JOINT_MAX], pan = 0.0, tilt = 0.0;
    kc_pose_t T;
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) {
        q[j] = a->arm.joint[j].q_min + (a->arm.joint[j].q_max - a->arm.joint[j].q_min) * fuzz_u8(f) / 255.0;
    }
    kc_arm_fk(&a->arm, q, &T);
    MUST(isfinite(T.p_m[0] + T.p_m[1] + T.p_m[2]) && isfinite(T.R[0] + T.R[4] + T.R[8]));
    (void)kc_camera_aim(&a->camera, T.p_m, &pan, &tilt);
    MUST(pan >= a->camera.pan_min_rad && pan <= a->camera.pan_max_rad);
    MUST(tilt >= a->camera.tilt_min_rad && tilt <= a->camera.tilt_max_rad);
    kc_camera_pose(&a->camera, pan, tilt, &T);
    MUST(isfinite(T.p_m[0] + T.p_m[1] + T.p_m[2]));
    if (a->crc[KC_TBL_SPACE] != 0u) { check_roadmap(a); }
    if (a->crc[KC_TBL_SPACE] != 0u && a->crc[KC_TBL_TERMS] != 0u) {
        kc_bounds_bad_t bad;
        MUST(kc_bounds_check(&a->space, &a->arm, &a->terms, &bad) == KC_OK);
    }
    if (a->crc[KC_TBL_TERMS] != 0u) {
        static const double coef[KC_COEF_MAX];
        kc_ctx_t ctx;
        kc_eval_t e;
        memset(&ctx, 0, sizeof ctx);
        memcpy(ctx.q, q, sizeof q);
        kc_loads_t loads;
        kc_model_loads(&a->arm, &a->terms, coef, &ctx, &loads);
        kc_model_eval(&a->arm, &a->terms, coef, &ctx, &loads, 1, &e);
        MUST(isfinite(e.T.p_m[0] + e.T.p_m[1] + e.T.p_m[2])); /* no correction: the nominal arm */
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    fuzz_t f = {data, size};
    kc_events_t ev = {0};
    uint32_t again = 0u;
    uint16_t kind = fuzz_u8(&f) % (KC_TBL_COUNT + 1u);
    uint8_t how = fuzz_u8(&f);
    uint32_t n = make_image(&f, kind, how);

    kc_status_t decoded = kc_tbl_decode(kind, s_image, n, &s_table, &ev);
    if (decoded == KC_OK) {
        MUST(kc_tbl_encode(kind, &s_table, 0u, s_again, sizeof s_again, &again) == KC_OK);
        MUST(again == n && memcmp(s_image, s_again, n) == 0);
    }
    kc_status_t loaded = kc_tbl_load(&s_loaded, kind, s_image, n, &ev);
    kc_status_t staged = uplink(kind, n, &ev);
    MUST((loaded == KC_OK) == (staged == KC_OK));
    MUST(loaded != KC_OK || decoded == KC_OK);
    if (loaded == KC_OK) {
        MUST(memcmp(s_loaded.active.crc, s_staged.active.crc, sizeof s_loaded.active.crc) == 0);
        MUST(s_loaded.active.crc[kind] == kc_tbl_image_crc(s_image, n));
        use(&s_loaded.active, &f);
        fuzz_check_tables(&s_loaded.active);
        s_loaded = s_staged = s_good;
    } else {
        MUST(memcmp(&s_loaded.active, &s_good.active, sizeof s_good.active) == 0);
        MUST(memcmp(&s_staged.active, &s_good.active, sizeof s_good.active) == 0);
    }
    return 0;
}
