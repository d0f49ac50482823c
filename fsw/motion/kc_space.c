#include "kc_space.h"

#include <stddef.h>

#include "kc_libm.h"

#define UNIT_TOL 1e-6
#define LIMIT_TOL 1e-6 /* seeds are single precision, limits are not */

bool kc_space_local(const kc_space_t *space, uint32_t cand)
{
    return ((uint32_t)space->cand[cand].why & KC_CAND_LOCAL) != 0u;
}

bool kc_space_edge(const kc_space_t *space, uint32_t i, uint32_t j)
{
    uint32_t hi = i > j ? i : j;
    uint32_t lo = i > j ? j : i;
    uint32_t bit;
    if (hi == lo || hi >= space->n_cand) { return false; }
    bit = hi * (hi - 1u) / 2u + lo;
    bool verified = ((uint32_t)space->edge[bit / 8u] >> (bit % 8u) & 1u) != 0u;
    return verified && !kc_space_local(space, i) && !kc_space_local(space, j);
}

bool kc_space_reserve(const kc_space_t *space, uint32_t cand)
{
    return ((uint32_t)space->cand[cand].why & KC_CAND_RESERVE) != 0u;
}

uint32_t kc_space_n_local(const kc_space_t *space)
{
    uint32_t n = 0u;
    for (uint32_t i = 0u; i < space->n_initial; i++) {
        n += kc_space_local(space, space->initial[i]) ? 1u : 0u;
    }
    return n;
}

uint32_t kc_space_n_stops(const kc_space_t *space, uint32_t cand)
{
    uint32_t n = 0u;
    while (n < space->n_stop && space->stop[cand][n] != 0u) { n++; }
    return n;
}

void kc_space_stop(const kc_space_t *space, uint32_t cand, uint32_t i, double *q)
{
    const kc_cand_t *c = &space->cand[cand];
    const float *hub_q = space->hub_q[c->hub];
    double part = (double)space->stop[cand][i] / (double)KC_STOP_PARTS;
    for (uint32_t j = 0u; j < space->n_joints; j++) {
        q[j] = (double)hub_q[j] + part * ((double)c->q_seed[j] - (double)hub_q[j]);
    }
}

bool kc_space_stop_fits(const kc_space_t *space, uint32_t cand, uint32_t i)
{
    const uint8_t *at = space->stop[cand];
    bool in_order = i == 0u || (at[i - 1u] != 0u && at[i] > at[i - 1u]);
    return at[i] == 0u || (in_order && !kc_space_local(space, cand));
}

/* ---- Validation: every entry; the first problem is reported ---- */

static kc_status_t bad(int32_t at, double value, int32_t *index, double *got)
{
    *index = at;
    *got = value;
    return KC_ERR_RANGE;
}

static kc_status_t check_counts(const kc_space_t *space, const kc_arm_t *arm, int32_t *index, double *got)
{
    if (space->n_cand < 1u || space->n_cand > KC_CAND_MAX) {
        return bad(-1, (double)space->n_cand, index, got);
    }
    if (space->n_hub < 1u || space->n_hub > KC_HUB_MAX) { return bad(-1, (double)space->n_hub, index, got); }
    if (space->n_joints < 1u || space->n_joints > KC_JOINT_MAX) {
        return bad(-1, (double)space->n_joints, index, got);
    }
    if (space->n_initial > KC_INITIAL_MAX) { return bad(-1, (double)space->n_initial, index, got); }
    if (space->n_body > KC_BODY_MAX) { return bad(-1, (double)space->n_body, index, got); }
    if (space->n_volume > KC_VOLUME_MAX) { return bad(-1, (double)space->n_volume, index, got); }
    if (arm != NULL && space->n_joints != arm->n_joints) {
        return bad(-1, (double)space->n_joints, index, got);
    }
    for (uint32_t j = 0u; j < space->n_joints; j++) {
        double bound = (double)space->servo_bound[j];
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

static kc_status_t check_hub(const kc_space_t *space, const kc_arm_t *arm, uint32_t h, int32_t *index,
                             double *got)
{
    int32_t at = KC_SPACE_INDEX_HUB + (int32_t)h;
    if ((uint32_t)space->hub_edge[h] >> space->n_hub != 0u) {
        return bad(at, (double)space->hub_edge[h], index, got);
    }
    for (uint32_t k = 0u; k < space->n_hub; k++) { /* a segment is verified in both directions */
        if ((((uint32_t)space->hub_edge[h] >> k) & 1u) != (((uint32_t)space->hub_edge[k] >> h) & 1u)) {
            return bad(at, (double)space->hub_edge[h], index, got);
        }
    }
    return check_joints(space->hub_q[h], space->n_joints, arm, at, index, got);
}

static kc_status_t check_cand(const kc_space_t *space, const kc_arm_t *arm, uint32_t i, int32_t *index,
                              double *got)
{
    const kc_cand_t *c = &space->cand[i];
    double norm2 = 0.0;
    for (uint32_t k = 0u; k < 3u; k++) {
        if (!kc_finite((double)c->p_m[k])) { return bad((int32_t)i, (double)c->p_m[k], index, got); }
    }
    for (uint32_t k = 0u; k < 4u; k++) { norm2 += (double)c->q_wxyz[k] * (double)c->q_wxyz[k]; }
    /* NaN fails too */
    if (!(kc_fabs(kc_sqrt(norm2) - 1.0) <= UNIT_TOL)) { return bad((int32_t)i, kc_sqrt(norm2), index, got); }
    if (!kc_finite((double)c->pan_rad)) { return bad((int32_t)i, (double)c->pan_rad, index, got); }
    if (!kc_finite((double)c->tilt_rad)) { return bad((int32_t)i, (double)c->tilt_rad, index, got); }
    if (c->hub >= space->n_hub) { return bad((int32_t)i, (double)c->hub, index, got); }
    return check_joints(c->q_seed, space->n_joints, arm, (int32_t)i, index, got);
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

static kc_status_t check_body(const kc_space_t *space, uint32_t i, int32_t *index, double *got)
{
    const kc_body_t *b = &space->body[i];
    int32_t at = KC_SPACE_INDEX_BODY + (int32_t)i;
    if (b->frame > space->n_joints) { return bad(at, (double)b->frame, index, got); }
    if (b->collision_pairs >> i != 0u) { return bad(at, (double)b->collision_pairs, index, got); }
    kc_status_t st = check_point(b->start_m, at, index, got);
    if (st == KC_OK) { st = check_point(b->end_m, at, index, got); }
    return st == KC_OK ? check_size(b->radius_m, at, index, got) : st;
}

static kc_status_t check_volume(const kc_space_t *space, uint32_t i, int32_t *index, double *got)
{
    const kc_volume_t *v = &space->volume[i];
    int32_t at = KC_SPACE_INDEX_VOLUME + (int32_t)i;
    if (v->kind > KC_VOL_SPHERE) { return bad(at, (double)v->kind, index, got); }
    if (v->excluded >> space->n_body != 0u) { return bad(at, (double)v->excluded, index, got); }
    kc_status_t st = check_point(v->p_m, at, index, got);
    if (st == KC_OK) { st = check_point(v->size_m, at, index, got); }
    for (uint32_t k = 0u; st == KC_OK && v->kind == KC_VOL_BOX && k < 3u; k++) {
        st = check_size(v->size_m[k], at, index, got);
    }
    bool curved = v->kind == KC_VOL_CAPSULE || v->kind == KC_VOL_SPHERE;
    return st == KC_OK && curved ? check_size(v->radius_m, at, index, got) : st;
}

static kc_status_t check_verified(const kc_space_t *space, uint32_t j, int32_t *index, double *got)
{
    const kc_dh_bound_t *v = &space->verified[j];
    const double bound[4] = {v->phi_rad, v->alpha_rad, v->a_m, v->d_m};
    for (uint32_t k = 0u; k < 4u; k++) {
        if (!kc_finite(bound[k]) || bound[k] < 0.0) {
            return bad(KC_SPACE_INDEX_VERIFIED + (int32_t)j, bound[k], index, got);
        }
    }
    return KC_OK;
}

/* An initial pose must not be listed twice: it would take the place of another one. */
static kc_status_t check_initial(const kc_space_t *space, uint32_t at, int32_t *index, double *got)
{
    bool ok = space->initial[at] < space->n_cand;
    for (uint32_t k = 0u; k < at; k++) { ok = ok && space->initial[k] != space->initial[at]; }
    return ok ? KC_OK : bad(KC_SPACE_INDEX_INITIAL + (int32_t)at, (double)space->initial[at], index, got);
}

static kc_status_t check_near(const kc_space_t *space, uint32_t i, int32_t *index, double *got)
{
    const kc_cand_t *c = &space->cand[i];
    if (c->hub != 0u) { return bad((int32_t)i, (double)c->hub, index, got); }
    for (uint32_t j = 0u; j < space->n_joints; j++) {
        double off = kc_fabs((double)c->q_seed[j] - (double)space->hub_q[0][j]);
        if (off > KC_LOCAL_BOUND) { return bad((int32_t)i, off, index, got); }
    }
    return KC_OK;
}

/* Local initial poses lead the list of initial poses; one that is not in the list would never be measured. */
static kc_status_t check_local(const kc_space_t *space, int32_t *index, double *got)
{
    uint32_t n = 0u, n_initial = kc_space_n_local(space);
    for (uint32_t i = 0u; i < n_initial; i++) {
        if (!kc_space_local(space, space->initial[i])) {
            return bad(KC_SPACE_INDEX_INITIAL + (int32_t)i, (double)space->initial[i], index, got);
        }
    }
    for (uint32_t i = 0u; i < space->n_cand; i++) {
        bool lone = kc_space_reserve(space, i) && !kc_space_local(space, i);
        n += kc_space_local(space, i) ? 1u : 0u;
        if (lone || n > n_initial) { return bad((int32_t)i, (double)space->cand[i].why, index, got); }
    }
    kc_status_t st = KC_OK;
    for (uint32_t i = 0u; st == KC_OK && i < n_initial; i++) {
        st = check_near(space, space->initial[i], index, got);
    }
    return st;
}

static kc_status_t check_edges(const kc_space_t *space, int32_t *index, double *got)
{
    uint32_t n_bits = space->n_cand * (space->n_cand - 1u) / 2u;
    for (uint32_t k = n_bits / 8u; k < KC_EDGE_BYTES; k++) {
        uint32_t keep = k == n_bits / 8u ? n_bits % 8u : 0u; /* bits of this byte that mean something */
        if ((uint32_t)space->edge[k] >> keep != 0u) { return bad(-1, (double)space->edge[k], index, got); }
    }
    return KC_OK;
}

/* Every hub of a candidate must be reachable from hub 0, the park pose. */
static kc_status_t check_connected(const kc_space_t *space, int32_t *index, double *got)
{
    uint32_t reached = 1u; /* bit per hub; each round adds the neighbours of those reached */
    for (uint32_t round = 1u; round < space->n_hub; round++) {
        for (uint32_t h = 0u; h < space->n_hub; h++) {
            if ((reached >> h & 1u) != 0u) { reached |= (uint32_t)space->hub_edge[h]; }
        }
    }
    for (uint32_t i = 0u; i < space->n_cand; i++) {
        if ((reached >> space->cand[i].hub & 1u) == 0u) {
            return bad((int32_t)i, (double)space->cand[i].hub, index, got);
        }
    }
    return KC_OK;
}

kc_status_t kc_space_validate(const kc_space_t *space, const kc_arm_t *arm, int32_t *index, double *got)
{
    kc_status_t st = check_counts(space, arm, index, got);
    if (st != KC_OK) { return st; } /* nothing else can be walked */
    for (uint32_t k = 0u; st == KC_OK && k < space->n_initial; k++) {
        st = check_initial(space, k, index, got);
    }
    for (uint32_t h = 0u; st == KC_OK && h < space->n_hub; h++) { st = check_hub(space, arm, h, index, got); }
    for (uint32_t i = 0u; st == KC_OK && i < space->n_cand; i++) {
        st = check_cand(space, arm, i, index, got);
    }
    for (uint32_t i = 0u; st == KC_OK && i < space->n_body; i++) { st = check_body(space, i, index, got); }
    for (uint32_t i = 0u; st == KC_OK && i < space->n_volume; i++) {
        st = check_volume(space, i, index, got);
    }
    for (uint32_t j = 0u; st == KC_OK && j < space->n_joints; j++) {
        st = check_verified(space, j, index, got);
    }
    if (st == KC_OK) { st = check_local(space, index, got); }
    if (st == KC_OK) { st = check_edges(space, index, got); }
    return st == KC_OK ? check_connected(space, index, got) : st;
}
