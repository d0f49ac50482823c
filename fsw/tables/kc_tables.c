#include "kc_tables.h"

#include <stddef.h>
#include <string.h>

#include "kc_bounds.h"
#include "kc_crc.h"
#include "kc_layout.h"

#define OFS_KIND 4u
#define OFS_VERSION 6u
#define OFS_BYTES 8u
#define OFS_CRC 12u

/* Header fields as TBL_FORMAT numbers them. */
enum { HDR_MAGIC = 0, HDR_KIND = 1, HDR_VERSION = 2, HDR_BYTES = 3 };

_Static_assert(sizeof(kc_tables_t) <= 344u * 1024u, "table memory budget");

static const uint8_t s_magic[4] = {'K', 'C', 'T', '1'};

static uint32_t get_le(const uint8_t *b, uint32_t n)
{
    uint32_t v = 0u;
    for (uint32_t i = 0u; i < n; i++) { v |= (uint32_t)b[i] << (8u * i); }
    return v;
}

static void put_le(uint8_t *b, uint32_t v, uint32_t n)
{
    for (uint32_t i = 0u; i < n; i++) { b[i] = (uint8_t)(v >> (8u * i)); }
}

static kc_walk_t walk_of(kc_walk_mode_t mode)
{
    kc_walk_t w;
    memset(&w, 0, sizeof w);
    w.mode = mode;
    w.pos = KC_TBL_HDR_BYTES;
    return w;
}

/* ---- Images ---- */

kc_status_t kc_tbl_encode(uint16_t kind, const void *src, uint32_t from, uint8_t *buf, uint32_t cap,
                          uint32_t *n)
{
    /* Walks that size and write leave the table alone, so the cast is harmless. */
    void *table = (void *)src;
    uint8_t hdr[KC_TBL_HDR_BYTES];
    kc_walk_t size = walk_of(KC_WALK_SIZE);
    kc_walk_t w = walk_of(KC_WALK_WRITE);
    *n = 0u;
    size.want_crc = from < KC_TBL_HDR_BYTES;
    kc_layout_walk(&size, kind, table);
    if (size.lost) { return KC_ERR_ARG; }
    *n = size.pos;
    memcpy(hdr, s_magic, sizeof s_magic);
    put_le(&hdr[OFS_KIND], kind, 2u);
    put_le(&hdr[OFS_VERSION], kc_layout_version(kind), 2u);
    put_le(&hdr[OFS_BYTES], size.pos - KC_TBL_HDR_BYTES, 4u);
    put_le(&hdr[OFS_CRC], size.crc, 4u);
    w.out = buf;
    w.from = from;
    w.cap = cap;
    w.pos = 0u;
    kc_walk_raw(&w, hdr, KC_TBL_HDR_BYTES);
    kc_layout_walk(&w, kind, table);
    return from <= *n && cap >= *n - from ? KC_OK : KC_ERR_FULL;
}

/* CRC an image of this table would carry. */
static uint32_t table_crc(uint16_t kind, const void *src)
{
    kc_walk_t w = walk_of(KC_WALK_SIZE);
    w.want_crc = 1u;
    kc_layout_walk(&w, kind, (void *)src);
    return w.crc;
}

static bool has_header(const uint8_t *image, uint32_t n)
{
    return n >= KC_TBL_HDR_BYTES && memcmp(image, s_magic, sizeof s_magic) == 0;
}

uint32_t kc_tbl_image_crc(const uint8_t *image, uint32_t n)
{
    return has_header(image, n) ? get_le(&image[OFS_CRC], 4u) : 0u;
}

static kc_status_t bad_header(kc_events_t *ev, int32_t field, double got, double want)
{
    kc_event(ev, KC_EVT_TBL_FORMAT, field, got, want);
    return KC_ERR_FORMAT;
}

static kc_status_t check_header(uint16_t kind, const uint8_t *image, uint32_t n, kc_events_t *ev)
{
    uint32_t crc;
    if (n < KC_TBL_HDR_BYTES) { return bad_header(ev, HDR_BYTES, (double)n, (double)KC_TBL_HDR_BYTES); }
    if (!has_header(image, n)) {
        return bad_header(ev, HDR_MAGIC, (double)get_le(image, 4u), (double)get_le(s_magic, 4u));
    }
    if (get_le(&image[OFS_KIND], 2u) != kind) {
        return bad_header(ev, HDR_KIND, (double)get_le(&image[OFS_KIND], 2u), (double)kind);
    }
    if (get_le(&image[OFS_VERSION], 2u) != kc_layout_version(kind)) {
        return bad_header(ev, HDR_VERSION, (double)get_le(&image[OFS_VERSION], 2u),
                          (double)kc_layout_version(kind));
    }
    if (get_le(&image[OFS_BYTES], 4u) != n - KC_TBL_HDR_BYTES) {
        return bad_header(ev, HDR_BYTES, (double)get_le(&image[OFS_BYTES], 4u),
                          (double)(n - KC_TBL_HDR_BYTES));
    }
    crc = kc_crc32(0u, &image[KC_TBL_HDR_BYTES], n - KC_TBL_HDR_BYTES);
    if (crc == get_le(&image[OFS_CRC], 4u)) { return KC_OK; }
    kc_event(ev, KC_EVT_TBL_CRC, (int32_t)kind, (double)crc, (double)get_le(&image[OFS_CRC], 4u));
    return KC_ERR_CRC;
}

/* The rules between entries that the owner of a kind knows; field 0 in the event. */
static kc_status_t check_rules(uint16_t kind, const void *src, uint32_t n_joints, const kc_arm_t *arm,
                               kc_events_t *ev)
{
    int32_t index = -1;
    double got = 0.0;
    kc_status_t st = KC_OK;
    switch (kind) {
    case KC_TBL_ARM: st = kc_arm_validate(src, &index, &got); break;
    case KC_TBL_CAMERA: st = kc_camera_validate(src, &index, &got); break;
    case KC_TBL_TERMS: st = kc_terms_validate(src, n_joints, &index, &got); break;
    case KC_TBL_SPACE: st = kc_space_validate(src, arm, &index, &got); break;
    case KC_TBL_KERNEL: st = kc_kernel_validate(src, &index, &got); break;
    default: break; /* KIN and CONFIG have no rules beyond their walk */
    }
    if (st == KC_OK) { return KC_OK; }
    kc_event(ev, KC_EVT_TBL_RANGE, index, got, 0.0);
    kc_event(ev, KC_EVT_TBL_BAD_TOTAL, (int32_t)kind, 1.0, 0.0);
    return KC_ERR_RANGE;
}

kc_status_t kc_tbl_decode(uint16_t kind, const uint8_t *image, uint32_t n, void *dst, kc_events_t *ev)
{
    kc_walk_t w = walk_of(KC_WALK_READ);
    kc_status_t st;
    if (kc_layout_struct_bytes(kind) == 0u) {
        return bad_header(ev, HDR_KIND, (double)kind, (double)(KC_TBL_COUNT - 1));
    }
    st = check_header(kind, image, n, ev);
    if (st != KC_OK) { return st; }
    memset(dst, 0, kc_layout_struct_bytes(kind)); /* entries not stored are zero */
    w.in = image;
    w.in_n = n;
    kc_layout_walk(&w, kind, dst);
    if (!w.lost && (w.overrun || w.pos != n)) {
        return bad_header(ev, HDR_BYTES, (double)(n - KC_TBL_HDR_BYTES), (double)(w.pos - KC_TBL_HDR_BYTES));
    }
    if (w.n_bad > 0u) {
        kc_event(ev, w.bad_id, w.bad_index, w.bad_got, (double)w.bad_field);
        kc_event(ev, KC_EVT_TBL_BAD_TOTAL, (int32_t)kind, (double)w.n_bad, 0.0);
        return KC_ERR_RANGE;
    }
    return check_rules(kind, dst, KC_JOINT_MAX, NULL, ev);
}

/* ---- What a table needs of the others ---- */

static kc_status_t needs(const kc_tables_t *tables, uint16_t kind, kc_events_t *ev)
{
    if (tables->active.crc[kind] != 0u) { return KC_OK; }
    kc_event(ev, KC_EVT_TBL_MISSING, (int32_t)kind, 0.0, 0.0);
    return KC_ERR_STATE;
}

static kc_status_t built_for(uint16_t kind, uint32_t crc, uint32_t active, kc_events_t *ev)
{
    if (crc == active) { return KC_OK; }
    kc_event(ev, KC_EVT_TBL_DEPENDS, (int32_t)kind, (double)crc, (double)active);
    return KC_ERR_STATE;
}

static bool made_for_arm(const kc_terms_t *terms, const kc_arm_t *arm)
{
    return terms->kinematics_crc == 0u || terms->kinematics_crc == kc_arm_kinematics_crc(arm);
}

static kc_status_t terms_of_arm(const kc_terms_t *terms, const kc_arm_t *arm, kc_events_t *ev)
{
    if (made_for_arm(terms, arm)) { return KC_OK; }
    kc_event(ev, KC_EVT_TBL_ARM_DIFFERS, KC_TBL_TERMS, (double)terms->kinematics_crc,
             (double)kc_arm_kinematics_crc(arm));
    return KC_ERR_STATE;
}

static kc_status_t kin_in_bounds(const kc_kin_t *kin, const kc_terms_t *terms, kc_events_t *ev)
{
    uint32_t bad = 0u;
    for (uint32_t i = 0u; i < kin->n_coef; i++) {
        const kc_coef_t *c = &terms->coef[i];
        if (kin->value[i] >= c->lb && kin->value[i] <= c->ub) { continue; } /* NaN fails too */
        if (bad++ == 0u) { kc_event(ev, KC_EVT_TBL_RANGE, (int32_t)i, kin->value[i], 2.0); }
    }
    if (bad == 0u) { return KC_OK; }
    kc_event(ev, KC_EVT_TBL_BAD_TOTAL, KC_TBL_KIN, (double)bad, 0.0);
    return KC_ERR_RANGE;
}

kc_status_t kc_tbl_kin_fits(const kc_tables_t *tables, const kc_kin_t *kin, kc_events_t *ev)
{
    const uint32_t *crc = tables->active.crc;
    kc_status_t st = needs(tables, KC_TBL_ARM, ev);
    if (st == KC_OK) { st = needs(tables, KC_TBL_TERMS, ev); }
    if (st == KC_OK && kin->n_coef != tables->active.terms.n_coef) {
        kc_event(ev, KC_EVT_TBL_RANGE, -1, (double)kin->n_coef, 1.0);
        kc_event(ev, KC_EVT_TBL_BAD_TOTAL, KC_TBL_KIN, 1.0, 0.0);
        st = KC_ERR_RANGE;
    }
    if (st != KC_OK || kin->arm_crc == 0u) { return st; } /* nominal: zeros fit every arm */
    st = built_for(KC_TBL_KIN, kin->arm_crc, crc[KC_TBL_ARM], ev);
    if (st == KC_OK) { st = built_for(KC_TBL_KIN, kin->terms_crc, crc[KC_TBL_TERMS], ev); }
    return st == KC_OK ? kin_in_bounds(kin, &tables->active.terms, ev) : st;
}

/* Whether SPACE was verified for every arm that TERMS can describe. Checked by whichever of them comes second. */
static kc_status_t verified(const kc_space_t *space, const kc_terms_t *terms, const kc_arm_t *arm,
                            kc_event_id_t id, kc_events_t *ev)
{
    kc_bounds_bad_t bad;
    if (kc_bounds_check(space, arm, terms, &bad) == KC_OK) { return KC_OK; }
    kc_event(ev, id, (int32_t)bad.coef, bad.sum, bad.verified);
    return KC_ERR_STATE;
}

static kc_status_t check_bounds(const kc_active_t *active, uint16_t kind, const void *src, kc_events_t *ev)
{
    if (kind == KC_TBL_TERMS && active->crc[KC_TBL_SPACE] != 0u) {
        return verified(&active->space, src, &active->arm, KC_EVT_TBL_TERMS_WIDE, ev);
    }
    if (kind == KC_TBL_SPACE && active->crc[KC_TBL_TERMS] != 0u) {
        return verified(src, &active->terms, &active->arm, KC_EVT_TBL_SPACE_NARROW, ev);
    }
    return KC_OK;
}

/* Rules of `src` that lean on the active tables. */
static kc_status_t check_depends(const kc_tables_t *tables, uint16_t kind, const void *src, kc_events_t *ev)
{
    const kc_active_t *a = &tables->active;
    kc_status_t st;
    if (kind == KC_TBL_KIN) { return kc_tbl_kin_fits(tables, src, ev); }
    if (kind != KC_TBL_TERMS && kind != KC_TBL_SPACE) { return KC_OK; }
    st = needs(tables, KC_TBL_ARM, ev);
    if (st == KC_OK && kind == KC_TBL_SPACE) {
        const kc_space_t *s = src;
        st = built_for(KC_TBL_SPACE, s->arm_crc, a->crc[KC_TBL_ARM], ev);
    }
    if (st == KC_OK && kind == KC_TBL_TERMS) { st = terms_of_arm(src, &a->arm, ev); }
    if (st == KC_OK) { st = check_rules(kind, src, a->arm.n_joints, &a->arm, ev); }
    return st == KC_OK ? check_bounds(a, kind, src, ev) : st;
}

/* ---- Activation ---- */

/* Where the struct of each kind is. */
static const size_t s_at[KC_TBL_COUNT] = {
    [KC_TBL_ARM] = offsetof(kc_active_t, arm),       [KC_TBL_CAMERA] = offsetof(kc_active_t, camera),
    [KC_TBL_TERMS] = offsetof(kc_active_t, terms),   [KC_TBL_KIN] = offsetof(kc_active_t, kin),
    [KC_TBL_SPACE] = offsetof(kc_active_t, space),   [KC_TBL_KERNEL] = offsetof(kc_active_t, kernel),
    [KC_TBL_CONFIG] = offsetof(kc_active_t, config),
};

const void *kc_tbl_active_ptr(const kc_active_t *active, uint16_t kind)
{
    return kind >= 1u && kind < KC_TBL_COUNT ? (const uint8_t *)active + s_at[kind] : NULL;
}

uint32_t kc_tbl_active_bytes(uint16_t kind)
{
    return kind == 0u ? (uint32_t)sizeof(kc_kin_t) : kc_layout_struct_bytes(kind);
}

/* Memory is compared with this while flight runs. */
static void seal(kc_active_t *active, uint16_t kind)
{
    const void *data = kind == 0u ? &active->kin_prev : kc_tbl_active_ptr(active, kind);
    active->seal[kind] = kc_crc32(0u, data, kc_tbl_active_bytes(kind));
}

static void drop_event(uint16_t kind, double built_crc, double active_crc, kc_events_t *ev)
{
    kc_event(ev, KC_EVT_TBL_DROPPED, (int32_t)kind, built_crc, active_crc);
}

/* No correction: what KIN falls back to. Without terms there is not even that. */
static void set_nominal(kc_active_t *active)
{
    memset(&active->kin, 0, sizeof active->kin);
    active->crc[KC_TBL_KIN] = 0u;
    if (active->crc[KC_TBL_TERMS] == 0u) { return; }
    active->kin.n_coef = active->terms.n_coef;
    active->crc[KC_TBL_KIN] = table_crc(KC_TBL_KIN, &active->kin);
    seal(active, KC_TBL_KIN);
}

static bool kin_still_fits(const kc_active_t *active, const kc_kin_t *kin)
{
    if (active->crc[KC_TBL_TERMS] == 0u || kin->n_coef != active->terms.n_coef) { return false; }
    if (kin->arm_crc == 0u) { return true; }
    return kin->arm_crc == active->crc[KC_TBL_ARM] && kin->terms_crc == active->crc[KC_TBL_TERMS];
}

static void refit_kin(kc_active_t *active, kc_events_t *ev)
{
    if (active->kin_prev_crc != 0u && !kin_still_fits(active, &active->kin_prev)) {
        memset(&active->kin_prev, 0, sizeof active->kin_prev);
        active->kin_prev_crc = 0u;
    }
    if (active->crc[KC_TBL_KIN] != 0u && kin_still_fits(active, &active->kin)) { return; }
    if (active->kin.arm_crc != 0u) { /* replacing one nominal table by another is no news */
        bool by_arm = active->kin.arm_crc != active->crc[KC_TBL_ARM];
        drop_event(KC_TBL_KIN, by_arm ? (double)active->kin.arm_crc : (double)active->kin.terms_crc,
                   by_arm ? (double)active->crc[KC_TBL_ARM] : (double)active->crc[KC_TBL_TERMS], ev);
    }
    set_nominal(active);
}

/* The ARM table has changed: drop what was made for the old one. */
static void refit_to_arm(kc_active_t *active, uint32_t old_crc, kc_events_t *ev)
{
    int32_t index;
    double got;
    if (active->crc[KC_TBL_TERMS] != 0u &&
        (!made_for_arm(&active->terms, &active->arm) ||
         kc_terms_validate(&active->terms, active->arm.n_joints, &index, &got) != KC_OK)) {
        drop_event(KC_TBL_TERMS, (double)old_crc, (double)active->crc[KC_TBL_ARM], ev);
        active->crc[KC_TBL_TERMS] = 0u;
        memset(&active->terms, 0, sizeof active->terms);
    }
    if (active->crc[KC_TBL_SPACE] != 0u && active->space.arm_crc != active->crc[KC_TBL_ARM]) {
        drop_event(KC_TBL_SPACE, (double)active->space.arm_crc, (double)active->crc[KC_TBL_ARM], ev);
        active->crc[KC_TBL_SPACE] = 0u;
        memset(&active->space, 0, sizeof active->space);
    }
}

static void make_active(kc_active_t *active, uint16_t kind, const void *src, uint32_t crc, kc_events_t *ev)
{
    uint32_t old_crc = active->crc[kind];
    memcpy((uint8_t *)active + s_at[kind], src, kc_layout_struct_bytes(kind));
    active->crc[kind] = crc;
    seal(active, kind);
    kc_event(ev, KC_EVT_TBL_ACTIVATED, (int32_t)kind, (double)crc, 0.0);
    if (kind == KC_TBL_ARM && old_crc != crc) { refit_to_arm(active, old_crc, ev); }
    if (kind == KC_TBL_ARM || kind == KC_TBL_TERMS) { refit_kin(active, ev); }
}

static void keep_prev(kc_active_t *active)
{
    if (active->crc[KC_TBL_KIN] == 0u) { return; }
    active->kin_prev = active->kin;
    active->kin_prev_crc = active->crc[KC_TBL_KIN];
    seal(active, 0u);
}

kc_status_t kc_tbl_set_kin(kc_tables_t *tables, const kc_kin_t *kin, kc_events_t *ev)
{
    kc_status_t st = kc_tbl_kin_fits(tables, kin, ev);
    if (st != KC_OK) { return st; }
    keep_prev(&tables->active);
    make_active(&tables->active, KC_TBL_KIN, kin, table_crc(KC_TBL_KIN, kin), ev);
    return KC_OK;
}

kc_status_t kc_tbl_rollback(kc_tables_t *tables, kc_events_t *ev)
{
    kc_active_t *a = &tables->active;
    if (a->kin_prev_crc == 0u) {
        kc_event(ev, KC_EVT_COR_NO_PREVIOUS, -1, 0.0, 0.0);
        return KC_ERR_STATE;
    }
    a->kin = a->kin_prev;
    a->crc[KC_TBL_KIN] = a->kin_prev_crc;
    seal(a, KC_TBL_KIN);
    memset(&a->kin_prev, 0, sizeof a->kin_prev);
    a->kin_prev_crc = 0u;
    kc_event(ev, KC_EVT_COR_ROLLBACK, -1, (double)a->crc[KC_TBL_KIN], 0.0);
    return KC_OK;
}

/* ---- Boot ---- */

kc_status_t kc_tbl_load(kc_tables_t *tables, uint16_t kind, const uint8_t *image, uint32_t n, kc_events_t *ev)
{
    kc_status_t st = kc_tbl_decode(kind, image, n, tables->scratch, ev);
    if (st == KC_OK) { st = check_depends(tables, kind, tables->scratch, ev); }
    if (st == KC_OK) { make_active(&tables->active, kind, tables->scratch, kc_tbl_image_crc(image, n), ev); }
    return st;
}

kc_status_t kc_tbl_load_prev(kc_tables_t *tables, const uint8_t *image, uint32_t n, kc_events_t *ev)
{
    kc_status_t st = kc_tbl_decode(KC_TBL_KIN, image, n, tables->scratch, ev);
    if (st == KC_OK) { st = kc_tbl_kin_fits(tables, &tables->scratch->kin, ev); }
    if (st != KC_OK) { return st; }
    tables->active.kin_prev = tables->scratch->kin;
    tables->active.kin_prev_crc = kc_tbl_image_crc(image, n);
    seal(&tables->active, 0u);
    return KC_OK;
}

/* ---- Staging ---- */

static void unstage(kc_staging_t *s)
{
    s->state = KC_STAGE_NONE;
    s->kind = 0u;
    s->n = 0u;
    s->total = 0u;
}

static bool chunk_fits(const kc_staging_t *s, uint16_t kind, uint32_t total, uint32_t offset, uint32_t n)
{
    if (n == 0u || n > KC_CHUNK_BYTES || offset >= total || n > total - offset) { return false; }
    if (offset == 0u) { return true; }
    return s->state == KC_STAGE_LOADING && s->kind == kind && s->total == total && s->n == offset;
}

kc_status_t kc_tbl_chunk(kc_tables_t *tables, uint16_t kind, uint32_t total, uint32_t offset,
                         const uint8_t *data, uint32_t n, kc_events_t *ev)
{
    kc_staging_t *s = &tables->staging;
    if (kc_layout_struct_bytes(kind) == 0u) {
        unstage(s);
        return bad_header(ev, HDR_KIND, (double)kind, (double)(KC_TBL_COUNT - 1));
    }
    if (total > KC_IMAGE_MAX) {
        unstage(s);
        (void)bad_header(ev, HDR_BYTES, (double)total, (double)KC_IMAGE_MAX);
        return KC_ERR_FULL;
    }
    if (!chunk_fits(s, kind, total, offset, n)) {
        kc_event(ev, KC_EVT_TBL_CHUNK, (int32_t)kind, (double)offset, (double)s->n);
        unstage(s);
        return KC_ERR_FORMAT;
    }
    memcpy(&s->image[offset], data, n);
    s->state = KC_STAGE_LOADING;
    s->kind = kind;
    s->total = total;
    s->n = offset + n;
    if (s->n == total) {
        s->state = KC_STAGE_COMPLETE;
        kc_event(ev, KC_EVT_TBL_STAGED, (int32_t)kind, (double)total, 0.0);
    }
    return KC_OK;
}

/* Whether the command names the staged image, and all of it is there. */
static kc_status_t check_named(const kc_tables_t *tables, uint16_t kind, uint32_t crc, kc_stage_t least,
                               kc_events_t *ev)
{
    const kc_staging_t *s = &tables->staging;
    uint32_t staged_crc = kc_tbl_image_crc(s->image, s->n);
    if (s->state < least || s->kind != kind) {
        kc_event(ev, KC_EVT_TBL_NOT_READY, (int32_t)kind, 0.0, 0.0);
        return KC_ERR_STATE;
    }
    if (staged_crc == crc) { return KC_OK; }
    kc_event(ev, KC_EVT_CMD_CRC, (int32_t)kind, (double)crc, (double)staged_crc);
    return KC_ERR_CRC;
}

static kc_status_t decode_staged(kc_tables_t *tables, kc_events_t *ev)
{
    kc_staging_t *s = &tables->staging;
    kc_status_t st = kc_tbl_decode(s->kind, s->image, s->n, tables->scratch, ev);
    if (st == KC_OK) { st = check_depends(tables, s->kind, tables->scratch, ev); }
    s->state = st == KC_OK ? KC_STAGE_VALID : KC_STAGE_COMPLETE;
    return st;
}

uint64_t kc_tbl_cost(const kc_tables_t *tables)
{
    return 50000u + 55u * (uint64_t)tables->staging.total + kc_bounds_cost(KC_TERM_MAX);
}

kc_status_t kc_tbl_validate(kc_tables_t *tables, uint16_t kind, uint32_t crc, kc_events_t *ev)
{
    kc_status_t st = check_named(tables, kind, crc, KC_STAGE_COMPLETE, ev);
    return st == KC_OK ? decode_staged(tables, ev) : st;
}

kc_status_t kc_tbl_ready(kc_tables_t *tables, uint16_t kind, uint32_t crc, kc_events_t *ev)
{
    kc_status_t st = check_named(tables, kind, crc, KC_STAGE_VALID, ev);
    return st == KC_OK ? decode_staged(tables, ev) : st;
}

kc_status_t kc_tbl_activate(kc_tables_t *tables, uint16_t kind, uint32_t crc, kc_events_t *ev)
{
    kc_status_t st = kc_tbl_ready(tables, kind, crc, ev);
    if (st != KC_OK) { return st; }
    if (kind == KC_TBL_KIN) { keep_prev(&tables->active); }
    make_active(&tables->active, kind, tables->scratch, crc, ev);
    unstage(&tables->staging);
    return KC_OK;
}

void kc_tbl_discard(kc_tables_t *tables, kc_events_t *ev)
{
    if (tables->staging.state != KC_STAGE_NONE) {
        kc_event(ev, KC_EVT_TBL_DISCARDED, (int32_t)tables->staging.kind, 0.0, 0.0);
    }
    unstage(&tables->staging);
}
