#include "kc_path.h"

#include "kc_libm.h"

static bool is_hub(uint32_t node) { return node < KC_HUB_MAX; }

double kc_path_bound(const kc_space_t *space, uint32_t node, double bound)
{
    bool narrow = is_hub(node) || kc_space_local(space, node - KC_HUB_MAX);
    return narrow ? kc_min(bound, KC_HUB_BOUND) : bound;
}

bool kc_path_is_node(const kc_space_t *space, uint32_t node)
{
    return is_hub(node) ? node < space->n_hub : node - KC_HUB_MAX < space->n_cand;
}

/* Hub of a node: itself, or the candidate's own. */
static uint32_t hub_of(const kc_space_t *space, uint32_t node)
{
    return is_hub(node) ? node : space->cand[node - KC_HUB_MAX].hub;
}

/* Hubs from `start`, breadth first, lowest index first: parent[h] = hub before h, KC_HUB_MAX if not
 * reached. Stops early once `goal` is found; Each hub is entered once,
 * so the work is bounded by n_hub^2. */
static void search_hubs(const kc_space_t *space, uint32_t start, uint32_t goal, uint32_t parent[KC_HUB_MAX])
{
    uint32_t queue[KC_HUB_MAX];
    uint32_t head = 0u, tail = 0u;
    for (uint32_t h = 0u; h < KC_HUB_MAX; h++) { parent[h] = KC_HUB_MAX; }
    parent[start] = start;
    queue[tail++] = start;
    while (head < tail && queue[head] != goal) {
        uint32_t at = queue[head++];
        for (uint32_t h = 0u; h < space->n_hub; h++) {
            if (parent[h] == KC_HUB_MAX && (((uint32_t)space->hub_edge[at] >> h) & 1u) != 0u) {
                parent[h] = at;
                queue[tail++] = h;
            }
        }
    }
}

/* Append the hubs from start (only if `with_start`) to goal, in order. */
static kc_status_t append_hubs(const kc_space_t *space, uint32_t start, uint32_t goal, bool with_start,
                               uint16_t *path, uint32_t *n)
{
    uint32_t parent[KC_HUB_MAX];
    uint32_t back[KC_HUB_MAX];
    uint32_t m = 0u;
    search_hubs(space, start, goal, parent);
    if (parent[goal] == KC_HUB_MAX) { return KC_ERR_PATH; }
    for (uint32_t h = goal; h != start && m < KC_HUB_MAX - 1u; h = parent[h]) { back[m++] = h; }
    if (with_start) { back[m++] = start; }
    while (m > 0u) { path[(*n)++] = (uint16_t)back[--m]; }
    return KC_OK;
}

kc_status_t kc_path_plan(const kc_space_t *space, uint32_t from, uint32_t to, uint16_t *path, uint32_t *n)
{
    kc_status_t st;
    *n = 0u;
    if (!kc_path_is_node(space, from) || !kc_path_is_node(space, to)) { return KC_ERR_PATH; }
    if (from == to) { return KC_OK; }
    if (!is_hub(from) && !is_hub(to) && kc_space_edge(space, from - KC_HUB_MAX, to - KC_HUB_MAX)) {
        path[(*n)++] = (uint16_t)to;
        return KC_OK;
    }
    st = append_hubs(space, hub_of(space, from), hub_of(space, to), !is_hub(from), path, n);
    if (st == KC_OK && !is_hub(to)) { path[(*n)++] = (uint16_t)to; }
    return st;
}

static const float *node_joints(const kc_space_t *space, uint32_t node)
{
    return is_hub(node) ? space->hub_q[node] : space->cand[node - KC_HUB_MAX].q_seed;
}

void kc_path_joints(const kc_space_t *space, uint32_t node, double *q)
{
    const float *from = node_joints(space, node);
    for (uint32_t j = 0u; j < space->n_joints; j++) { q[j] = (double)from[j]; }
}

static double joint_distance(const kc_space_t *space, uint32_t node, const double *bound, const double *q)
{
    const float *a = node_joints(space, node);
    double worst = 0.0;
    for (uint32_t j = 0u; j < space->n_joints; j++) {
        worst = kc_max(kc_fabs((double)a[j] - q[j]) / kc_path_bound(space, node, bound[j]), worst);
    }
    return worst;
}

uint32_t kc_path_nearest(const kc_space_t *space, const double *bound, const double *q, double *dist)
{
    uint32_t best = KC_NODE_NONE;
    *dist = KC_INF;
    for (uint32_t k = 0u; k < space->n_hub + space->n_cand; k++) {
        uint32_t node = k < space->n_hub ? k : KC_HUB_MAX + k - space->n_hub;
        double d = joint_distance(space, node, bound, q);
        if (d < *dist) {
            *dist = d;
            best = node;
        }
    }
    return best;
}

static bool is_between(const float *a, const float *b, const double *q, uint32_t n, double tol)
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
        if (kc_fabs(q[j] - on) > tol) { return false; }
    }
    return true;
}

static uint32_t on_hub_segment(const kc_space_t *space, const double *q, double tol)
{
    for (uint32_t h = 0u; h < space->n_hub; h++) {
        for (uint32_t k = h + 1u; k < space->n_hub; k++) {
            bool verified = ((space->hub_edge[h] >> k) & 1u) != 0u;
            if (verified && is_between(space->hub_q[h], space->hub_q[k], q, space->n_joints, tol)) {
                return h;
            }
        }
    }
    return KC_NODE_NONE;
}

uint32_t kc_path_on_segment(const kc_space_t *space, const double *q, double tol)
{
    uint32_t node = on_hub_segment(space, q, tol);
    if (node != KC_NODE_NONE) { return node; }
    for (uint32_t c = 0u; c < space->n_cand; c++) {
        const kc_cand_t *at = &space->cand[c];
        if (is_between(at->q_seed, space->hub_q[at->hub], q, space->n_joints, tol)) { return at->hub; }
    }
    for (uint32_t c = 1u; c < space->n_cand; c++) {
        for (uint32_t k = 0u; k < c; k++) {
            if (kc_space_edge(space, c, k) &&
                is_between(space->cand[c].q_seed, space->cand[k].q_seed, q, space->n_joints, tol)) {
                return KC_HUB_MAX + k;
            }
        }
    }
    return KC_NODE_NONE;
}

static bool is_verified(const kc_space_t *space, uint32_t a, uint32_t b)
{
    if (is_hub(a) && is_hub(b)) { return (((uint32_t)space->hub_edge[a] >> b) & 1u) != 0u; }
    if (is_hub(a)) { return space->cand[b - KC_HUB_MAX].hub == a; }
    if (is_hub(b)) { return space->cand[a - KC_HUB_MAX].hub == b; }
    return kc_space_edge(space, a - KC_HUB_MAX, b - KC_HUB_MAX);
}

bool kc_path_on(const kc_space_t *space, uint32_t from, uint32_t to, const double *q, double tol)
{
    return kc_path_is_node(space, from) && kc_path_is_node(space, to) && is_verified(space, from, to) &&
           is_between(node_joints(space, from), node_joints(space, to), q, space->n_joints, tol);
}

bool kc_path_leads_to(const kc_space_t *space, uint32_t node, const double *q, double tol)
{
    for (uint32_t k = 0u; k < space->n_hub + space->n_cand; k++) {
        if (kc_path_on(space, k < space->n_hub ? k : KC_HUB_MAX + k - space->n_hub, node, q, tol)) {
            return true;
        }
    }
    return false;
}
