#include "kc_space.h"

#include <stddef.h>

#include "kc_libm.h"

#define UNIT_TOL 1e-6
#define LIMIT_TOL 1e-6 /* seeds are single precision, limits are not */

bool kc_space_local(const kc_space_t *s, uint32_t cand)
{
    return ((uint32_t)s->cand[cand].why & KC_CAND_LOCAL) != 0u;
}

bool kc_space_edge(const kc_space_t *s, uint32_t i, uint32_t j)
{
    uint32_t hi = i > j ? i : j;
    uint32_t lo = i > j ? j : i;
    uint32_t bit;
    if (hi == lo || hi >= s->n_cand) { return false; }
    bit = hi * (hi - 1u) / 2u + lo;
    bool verified = ((uint32_t)s->edge[bit / 8u] >> (bit % 8u) & 1u) != 0u;
    return verified && !kc_space_local(s, i) && !kc_space_local(s, j);
}

bool kc_space_reserve(const kc_space_t *s, uint32_t cand)
{
    return ((uint32_t)s->cand[cand].why & KC_CAND_RESERVE) != 0u;
}

uint32_t kc_space_n_local(const kc_space_t *s)
{
    uint32_t n = 0u;
    for (uint32_t i = 0u; i < s->n_initial; i++) { n += kc_space_local(s, s->initial[i]) ? 1u : 0u; }
    return n;
}

uint32_t kc_space_n_stops(const kc_space_t *s, uint32_t cand)
{
    uint32_t n = 0u;
    while (n < s->n_stop && s->stop[cand][n] != 0u) { n++; }
    return n;
}

void kc_space_stop(const kc_space_t *s, uint32_t cand, uint32_t i, double *q)
{
    const kc_cand_t *c = &s->cand[cand];
    const float *hub_q = s->hub_q[c->hub];
    double part = (double)s->stop[cand][i] / (double)KC_STOP_PARTS;
    for (uint32_t j = 0u; j < s->n_joints; j++) {
        q[j] = (double)hub_q[j] + part * ((double)c->q_seed[j] - (double)hub_q[j]);
    }
}

bool kc_space_stop_fits(const kc_space_t *s, uint32_t cand, uint32_t i)
{
    const uint8_t *at = s->stop[cand];
    bool in_order = i == 0u || (at[i - 1u] != 0u && at[i] > at[i - 1u]);
    return at[i] == 0u || (in_order && !kc_space_local(s, cand));
}

/* ---- Validation: every entry; the first problem is reported ---- */

static kc_status_t bad(int32_t at, double value, int32_t *index, double *got)
{
    *index = at;
    *got = value;
    return KC_ERR_RANGE;
}

static kc_status_t check_counts(const kc_space_t *s, const kc_arm_t *arm, int32_t *index, double *got)
{
    if (s->n_cand < 1u || s->n_cand > KC_CAND_MAX) { return bad(-1, (double)s->n_cand, index, got); }
    if (s->n_hub < 1u || s->n_hub > KC_HUB_MAX) { return bad(-1, (double)s->n_hub, index, got); }
    if (s->n_joints < 1u || s->n_joints > KC_JOINT_MAX) { return bad(-1, (double)s->n_joints, index, got); }
    if (s->n_initial > KC_INITIAL_MAX) { return bad(-1, (double)s->n_initial, index, got); }
    if (s->n_body > KC_BODY_MAX) { return bad(-1, (double)s->n_body, index, got); }
    if (s->n_volume > KC_VOLUME_MAX) { return bad(-1, (double)s->n_volume, index, got); }
    if (arm != NULL && s->n_joints != arm->n_joints) { return bad(-1, (double)s->n_joints, index, got); }
    for (uint32_t j = 0u; j < s->n_joints; j++) {
        double bound = (double)s->servo_bound[j];
        if (!kc_finite(bound) || bound <= 0.0) { return bad(-1, bound, index, got); }
    }
    return KC_OK;
}

static kc_status_t check_joints(const float *q, uint32_t n, const kc_arm_t *arm, int32_t at, int32_t *index,
                                double *got)
{
    for (uint32_t j = 0u; j < n; j++) {
        double v = (double)q[j];
        if (!kc_finite(v)) { return bad(at, v, index, got); }
        if (arm == NULL) { continue; }
        if (v < arm->joint[j].q_min - LIMIT_TOL || v > arm->joint[j].q_max + LIMIT_TOL) {
            return bad(at, v, index, got);
        }
    }
    return KC_OK;
}

static kc_status_t check_hub(const kc_space_t *s, const kc_arm_t *arm, uint32_t h, int32_t *index,
                             double *got)
{
    int32_t at = KC_SPACE_INDEX_HUB + (int32_t)h;
    if ((uint32_t)s->hub_edge[h] >> s->n_hub != 0u) { return bad(at, (double)s->hub_edge[h], index, got); }
    for (uint32_t k = 0u; k < s->n_hub; k++) { /* a segment is verified in both directions */
        if ((((uint32_t)s->hub_edge[h] >> k) & 1u) != (((uint32_t)s->hub_edge[k] >> h) & 1u)) {
            return bad(at, (double)s->hub_edge[h], index, got);
        }
    }
    return check_joints(s->hub_q[h], s->n_joints, arm, at, index, got);
}

static kc_status_t check_cand(const kc_space_t *s, const kc_arm_t *arm, uint32_t i, int32_t *index,
                              double *got)
{
    const kc_cand_t *c = &s->cand[i];
    double norm2 = 0.0;
    for (uint32_t k = 0u; k < 3u; k++) {
        if (!kc_finite((double)c->p_m[k])) { return bad((int32_t)i, (double)c->p_m[k], index, got); }
    }
    for (uint32_t k = 0u; k < 4u; k++) { norm2 += (double)c->q_wxyz[k] * (double)c->q_wxyz[k]; }
    /* NaN fails too */
    if (!(kc_fabs(kc_sqrt(norm2) - 1.0) <= UNIT_TOL)) { return bad((int32_t)i, kc_sqrt(norm2), index, got); }
    if (!kc_finite((double)c->pan_rad)) { return bad((int32_t)i, (double)c->pan_rad, index, got); }
    if (!kc_finite((double)c->tilt_rad)) { return bad((int32_t)i, (double)c->tilt_rad, index, got); }
    if (c->hub >= s->n_hub) { return bad((int32_t)i, (double)c->hub, index, got); }
    return check_joints(c->q_seed, s->n_joints, arm, (int32_t)i, index, got);
}

static kc_status_t check_point(const float p[3], int32_t at, int32_t *index, double *got)
{
    for (uint32_t k = 0u; k < 3u; k++) {
        if (!kc_finite((double)p[k])) { return bad(at, (double)p[k], index, got); }
    }
    return KC_OK;
}

/* Above zero and finite; NaN fails too. */
static kc_status_t check_size(float x, int32_t at, int32_t *index, double *got)
{
    return x > 0.0f && kc_finite((double)x) ? KC_OK : bad(at, (double)x, index, got);
}

static kc_status_t check_body(const kc_space_t *s, uint32_t i, int32_t *index, double *got)
{
    const kc_body_t *b = &s->body[i];
    int32_t at = KC_SPACE_INDEX_BODY + (int32_t)i;
    if (b->frame > s->n_joints) { return bad(at, (double)b->frame, index, got); }
    if (b->collision_pairs >> i != 0u) { return bad(at, (double)b->collision_pairs, index, got); }
    kc_status_t st = check_point(b->start_m, at, index, got);
    if (st == KC_OK) { st = check_point(b->end_m, at, index, got); }
    return st == KC_OK ? check_size(b->radius_m, at, index, got) : st;
}

static kc_status_t check_volume(const kc_space_t *s, uint32_t i, int32_t *index, double *got)
{
    const kc_volume_t *v = &s->volume[i];
    int32_t at = KC_SPACE_INDEX_VOLUME + (int32_t)i;
    if (v->kind > KC_VOL_SPHERE) { return bad(at, (double)v->kind, index, got); }
    if (v->excluded >> s->n_body != 0u) { return bad(at, (double)v->excluded, index, got); }
    kc_status_t st = check_point(v->p_m, at, index, got);
    if (st == KC_OK) { st = check_point(v->size_m, at, index, got); }
    for (uint32_t k = 0u; st == KC_OK && v->kind == KC_VOL_BOX && k < 3u; k++) {
        st = check_size(v->size_m[k], at, index, got);
    }
    bool curved = v->kind == KC_VOL_CAPSULE || v->kind == KC_VOL_SPHERE;
    return st == KC_OK && curved ? check_size(v->radius_m, at, index, got) : st;
}

static kc_status_t check_verified(const kc_space_t *s, uint32_t j, int32_t *index, double *got)
{
    const kc_dh_bound_t *v = &s->verified[j];
    const double bound[4] = {v->phi_rad, v->alpha_rad, v->a_m, v->d_m};
    for (uint32_t k = 0u; k < 4u; k++) {
        if (!kc_finite(bound[k]) || bound[k] < 0.0) {
            return bad(KC_SPACE_INDEX_VERIFIED + (int32_t)j, bound[k], index, got);
        }
    }
    return KC_OK;
}

/* An initial pose must not be listed twice: it would take the place of another one. */
static kc_status_t check_initial(const kc_space_t *s, uint32_t at, int32_t *index, double *got)
{
    bool ok = s->initial[at] < s->n_cand;
    for (uint32_t k = 0u; k < at; k++) { ok = ok && s->initial[k] != s->initial[at]; }
    return ok ? KC_OK : bad(KC_SPACE_INDEX_INITIAL + (int32_t)at, (double)s->initial[at], index, got);
}

static kc_status_t check_near(const kc_space_t *s, uint32_t i, int32_t *index, double *got)
{
    const kc_cand_t *c = &s->cand[i];
    if (c->hub != 0u) { return bad((int32_t)i, (double)c->hub, index, got); }
    for (uint32_t j = 0u; j < s->n_joints; j++) {
        double off = kc_fabs((double)c->q_seed[j] - (double)s->hub_q[0][j]);
        if (off > KC_LOCAL_BOUND) { return bad((int32_t)i, off, index, got); }
    }
    return KC_OK;
}

/* Local initial poses lead the list of initial poses; one that is not in the list would never be measured. */
static kc_status_t check_local(const kc_space_t *s, int32_t *index, double *got)
{
    uint32_t n = 0u, n_initial = kc_space_n_local(s);
    for (uint32_t i = 0u; i < n_initial; i++) {
        if (!kc_space_local(s, s->initial[i])) {
            return bad(KC_SPACE_INDEX_INITIAL + (int32_t)i, (double)s->initial[i], index, got);
        }
    }
    for (uint32_t i = 0u; i < s->n_cand; i++) {
        bool lone = kc_space_reserve(s, i) && !kc_space_local(s, i);
        n += kc_space_local(s, i) ? 1u : 0u;
        if (lone || n > n_initial) { return bad((int32_t)i, (double)s->cand[i].why, index, got); }
    }
    kc_status_t st = KC_OK;
    for (uint32_t i = 0u; st == KC_OK && i < n_initial; i++) {
        st = check_near(s, s->initial[i], index, got);
    }
    return st;
}

static kc_status_t check_edges(const kc_space_t *s, int32_t *index, double *got)
{
    uint32_t n_bits = s->n_cand * (s->n_cand - 1u) / 2u;
    for (uint32_t k = n_bits / 8u; k < KC_EDGE_BYTES; k++) {
        uint32_t keep = k == n_bits / 8u ? n_bits % 8u : 0u; /* bits of this byte that mean something */
        if ((uint32_t)s->edge[k] >> keep != 0u) { return bad(-1, (double)s->edge[k], index, got); }
    }
    return KC_OK;
}

/* Every hub of a candidate must be reachable from hub 0, the park pose. */
static kc_status_t check_connected(const kc_space_t *s, int32_t *index, double *got)
{
    uint32_t reached = 1u; /* bit per hub; each round adds the neighbours of those reached */
    for (uint32_t round = 1u; round < s->n_hub; round++) {
        for (uint32_t h = 0u; h < s->n_hub; h++) {
            if ((reached >> h & 1u) != 0u) { reached |= (uint32_t)s->hub_edge[h]; }
        }
    }
    for (uint32_t i = 0u; i < s->n_cand; i++) {
        if ((reached >> s->cand[i].hub & 1u) == 0u) {
            return bad((int32_t)i, (double)s->cand[i].hub, index, got);
        }
    }
    return KC_OK;
}

kc_status_t kc_space_validate(const kc_space_t *s, const kc_arm_t *arm, int32_t *index, double *got)
{
    kc_status_t st = check_counts(s, arm, index, got);
    if (st != KC_OK) { return st; } /* nothing else can be walked */
    for (uint32_t k = 0u; st == KC_OK && k < s->n_initial; k++) { st = check_initial(s, k, index, got); }
    for (uint32_t h = 0u; st == KC_OK && h < s->n_hub; h++) { st = check_hub(s, arm, h, index, got); }
    for (uint32_t i = 0u; st == KC_OK && i < s->n_cand; i++) { st = check_cand(s, arm, i, index, got); }
    for (uint32_t i = 0u; st == KC_OK && i < s->n_body; i++) { st = check_body(s, i, index, got); }
    for (uint32_t i = 0u; st == KC_OK && i < s->n_volume; i++) { st = check_volume(s, i, index, got); }
    for (uint32_t j = 0u; st == KC_OK && j < s->n_joints; j++) { st = check_verified(s, j, index, got); }
    if (st == KC_OK) { st = check_local(s, index, got); }
    if (st == KC_OK) { st = check_edges(s, index, got); }
    return st == KC_OK ? check_connected(s, index, got) : st;
}
