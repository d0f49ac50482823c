#include "kc_path.h"

#include <stddef.h>
#include <string.h>

#include "kc_libm.h"

#define UNIT_TOL 1e-6
#define LIMIT_TOL 1e-6 /* seeds are single precision, limits are not */

int kc_space_edge(const kc_space_t *s, uint32_t i, uint32_t j)
{
    uint32_t hi = i > j ? i : j;
    uint32_t lo = i > j ? j : i;
    uint32_t bit;
    if (hi == lo || hi >= s->n_cand) { return 0; }
    bit = hi * (hi - 1u) / 2u + lo;
    return (int)(((uint32_t)s->edge[bit / 8u] >> (bit % 8u)) & 1u);
}

static int is_hub(uint32_t node) { return node < KC_HUB_MAX; }

int kc_space_local(const kc_space_t *s, uint32_t cand)
{
    return ((uint32_t)s->cand[cand].why & KC_CAND_LOCAL) != 0u;
}

int kc_space_reserve(const kc_space_t *s, uint32_t cand)
{
    return ((uint32_t)s->cand[cand].why & KC_CAND_RESERVE) != 0u;
}

uint32_t kc_space_n_local(const kc_space_t *s)
{
    uint32_t n = 0u;
    for (uint32_t i = 0u; i < s->n_initial; i++) { n += kc_space_local(s, s->initial[i]) ? 1u : 0u; }
    return n;
}

double kc_path_bound(const kc_space_t *s, uint32_t node, double bound)
{
    int narrow = is_hub(node) || kc_space_local(s, node - KC_HUB_MAX);
    return narrow ? kc_min(bound, KC_HUB_BOUND) : bound;
}

int kc_path_is_node(const kc_space_t *s, uint32_t node)
{
    return is_hub(node) ? node < s->n_hub : node - KC_HUB_MAX < s->n_cand;
}

/* Hub of a node: itself, or the candidate's own. */
static uint32_t hub_of(const kc_space_t *s, uint32_t node)
{
    return is_hub(node) ? node : s->cand[node - KC_HUB_MAX].hub;
}

/* Hubs from `start`, breadth first, lowest index first: parent[h] = hub before h, KC_HUB_MAX if not
 * reached. Stops early once `goal` is found; goal >= KC_HUB_MAX reaches all. Each hub is entered once,
 * so the work is bounded by n_hub^2. */
static void search_hubs(const kc_space_t *s, uint32_t start, uint32_t goal, uint32_t parent[KC_HUB_MAX])
{
    uint32_t queue[KC_HUB_MAX];
    uint32_t head = 0u, tail = 0u;
    for (uint32_t h = 0u; h < KC_HUB_MAX; h++) { parent[h] = KC_HUB_MAX; }
    parent[start] = start;
    queue[tail++] = start;
    while (head < tail && queue[head] != goal) {
        uint32_t at = queue[head++];
        for (uint32_t h = 0u; h < s->n_hub; h++) {
            if (parent[h] == KC_HUB_MAX && (((uint32_t)s->hub_edge[at] >> h) & 1u) != 0u) {
                parent[h] = at;
                queue[tail++] = h;
            }
        }
    }
}

/* Append the hubs from start (only if `with_start`) to goal, in order. */
static kc_status_t append_hubs(const kc_space_t *s, uint32_t start, uint32_t goal, int with_start,
                               uint16_t *path, uint32_t *n)
{
    uint32_t parent[KC_HUB_MAX];
    uint32_t back[KC_HUB_MAX];
    uint32_t m = 0u;
    search_hubs(s, start, goal, parent);
    if (parent[goal] == KC_HUB_MAX) { return KC_ERR_PATH; }
    for (uint32_t h = goal; h != start && m < KC_HUB_MAX - 1u; h = parent[h]) { back[m++] = h; }
    if (with_start) { back[m++] = start; }
    while (m > 0u) { path[(*n)++] = (uint16_t)back[--m]; }
    return KC_OK;
}

kc_status_t kc_path_plan(const kc_space_t *s, uint32_t from, uint32_t to, uint16_t *path, uint32_t *n)
{
    kc_status_t st;
    *n = 0u;
    if (!kc_path_is_node(s, from) || !kc_path_is_node(s, to)) { return KC_ERR_PATH; }
    if (from == to) { return KC_OK; }
    if (!is_hub(from) && !is_hub(to) && kc_space_edge(s, from - KC_HUB_MAX, to - KC_HUB_MAX)) {
        path[(*n)++] = (uint16_t)to;
        return KC_OK;
    }
    st = append_hubs(s, hub_of(s, from), hub_of(s, to), !is_hub(from), path, n);
    if (st == KC_OK && !is_hub(to)) { path[(*n)++] = (uint16_t)to; }
    return st;
}

static const float *node_joints(const kc_space_t *s, uint32_t node)
{
    return is_hub(node) ? s->hub_q[node] : s->cand[node - KC_HUB_MAX].q_seed;
}

void kc_path_joints(const kc_space_t *s, uint32_t node, double *q)
{
    const float *from = node_joints(s, node);
    for (uint32_t j = 0u; j < s->n_joints; j++) { q[j] = (double)from[j]; }
}

static double joint_distance(const kc_space_t *s, uint32_t node, const double *bound, const double *q)
{
    const float *a = node_joints(s, node);
    double worst = 0.0;
    for (uint32_t j = 0u; j < s->n_joints; j++) {
        worst = kc_max(kc_fabs((double)a[j] - q[j]) / kc_path_bound(s, node, bound[j]), worst);
    }
    return worst;
}

uint32_t kc_path_nearest(const kc_space_t *s, const double *bound, const double *q, double *dist)
{
    uint32_t best = KC_NODE_NONE;
    *dist = KC_INF;
    for (uint32_t k = 0u; k < s->n_hub + s->n_cand; k++) {
        uint32_t node = k < s->n_hub ? k : KC_HUB_MAX + k - s->n_hub;
        double d = joint_distance(s, node, bound, q);
        if (d < *dist) {
            *dist = d;
            best = node;
        }
    }
    return best;
}

static int is_between(const float *a, const float *b, const double *q, uint32_t n, double tol)
{
    double num = 0.0, den = 0.0;
    for (uint32_t j = 0u; j < n; j++) {
        double d = (double)b[j] - (double)a[j];
        num += (q[j] - (double)a[j]) * d;
        den += d * d;
    }
    double t = den > 0.0 ? kc_clamp(num / den, 0.0, 1.0) : 0.0;
    for (uint32_t j = 0u; j < n; j++) {
        double on = (double)a[j] + t * ((double)b[j] - (double)a[j]);
        if (kc_fabs(q[j] - on) > tol) { return 0; }
    }
    return 1;
}

static uint32_t on_hub_segment(const kc_space_t *s, const double *q, double tol)
{
    for (uint32_t h = 0u; h < s->n_hub; h++) {
        for (uint32_t k = h + 1u; k < s->n_hub; k++) {
            int verified = ((s->hub_edge[h] >> k) & 1u) != 0u;
            if (verified && is_between(s->hub_q[h], s->hub_q[k], q, s->n_joints, tol)) { return h; }
        }
    }
    return KC_NODE_NONE;
}

uint32_t kc_path_on_segment(const kc_space_t *s, const double *q, double tol)
{
    uint32_t node = on_hub_segment(s, q, tol);
    if (node != KC_NODE_NONE) { return node; }
    for (uint32_t c = 0u; c < s->n_cand; c++) {
        const kc_cand_t *at = &s->cand[c];
        if (is_between(at->q_seed, s->hub_q[at->hub], q, s->n_joints, tol)) { return at->hub; }
    }
    for (uint32_t c = 1u; c < s->n_cand; c++) {
        for (uint32_t k = 0u; k < c; k++) {
            if (kc_space_edge(s, c, k) &&
                is_between(s->cand[c].q_seed, s->cand[k].q_seed, q, s->n_joints, tol)) {
                return KC_HUB_MAX + k;
            }
        }
    }
    return KC_NODE_NONE;
}

static int is_verified(const kc_space_t *s, uint32_t a, uint32_t b)
{
    if (is_hub(a) && is_hub(b)) { return (((uint32_t)s->hub_edge[a] >> b) & 1u) != 0u; }
    if (is_hub(a)) { return s->cand[b - KC_HUB_MAX].hub == a; }
    if (is_hub(b)) { return s->cand[a - KC_HUB_MAX].hub == b; }
    return kc_space_edge(s, a - KC_HUB_MAX, b - KC_HUB_MAX);
}

int kc_path_on(const kc_space_t *s, uint32_t from, uint32_t to, const double *q, double tol)
{
    return kc_path_is_node(s, from) && kc_path_is_node(s, to) && is_verified(s, from, to) &&
           is_between(node_joints(s, from), node_joints(s, to), q, s->n_joints, tol);
}

int kc_path_leads_to(const kc_space_t *s, uint32_t node, const double *q, double tol)
{
    for (uint32_t k = 0u; k < s->n_hub + s->n_cand; k++) {
        if (kc_path_on(s, k < s->n_hub ? k : KC_HUB_MAX + k - s->n_hub, node, q, tol)) { return 1; }
    }
    return 0;
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
    int round = v->kind == KC_VOL_CAPSULE || v->kind == KC_VOL_SPHERE;
    return st == KC_OK && round ? check_size(v->radius_m, at, index, got) : st;
}

/* An initial pose must not be listed twice: it would take the place of another one. */
static kc_status_t check_initial(const kc_space_t *s, uint32_t at, int32_t *index, double *got)
{
    int ok = s->initial[at] < s->n_cand;
    for (uint32_t k = 0u; k < at; k++) { ok = ok && s->initial[k] != s->initial[at]; }
    return ok ? KC_OK : bad(KC_SPACE_INDEX_INITIAL + (int32_t)at, (double)s->initial[at], index, got);
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
        int lone = kc_space_reserve(s, i) && !kc_space_local(s, i);
        n += kc_space_local(s, i) ? 1u : 0u;
        if (lone || n > n_initial) { return bad((int32_t)i, (double)s->cand[i].why, index, got); }
    }
    return KC_OK;
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
    uint32_t parent[KC_HUB_MAX];
    search_hubs(s, 0u, KC_HUB_MAX, parent);
    for (uint32_t i = 0u; i < s->n_cand; i++) {
        if (parent[s->cand[i].hub] == KC_HUB_MAX) {
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
    if (st == KC_OK) { st = check_local(s, index, got); }
    if (st == KC_OK) { st = check_edges(s, index, got); }
    return st == KC_OK ? check_connected(s, index, got) : st;
}
