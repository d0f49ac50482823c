#include "kc_guard.h"

#include <stddef.h>

#include "kc_libm.h"
#include "kc_vec.h"

#define BISECTIONS 40u  /* position along a body's axis to 1 in 10^12 */
#define NUMBERS_TOL 1e-6 /* tables are single precision */

/* ---- distances ---- */

static void widen(const float a[3], double out[3])
{
    for (uint32_t i = 0u; i < 3u; i++) { out[i] = (double)a[i]; }
}

static void place(const kc_pose_t *T, const float p[3], double out[3])
{
    double d[3];
    widen(p, d);
    kc_m3_mul_v3(T->R, d, out);
    kc_v3_add_scaled(out, 1.0, T->p_m, out);
}

/* Parameter (0 to 1) of the point of the segment from a to a + u that is nearest to p; 0 for one without
 * length. */
static double nearest_part(const double a[3], const double u[3], const double p[3])
{
    double d[3], uu = kc_v3_dot(u, u);
    kc_v3_sub(p, a, d);
    return uu > 0.0 ? kc_clamp(kc_v3_dot(d, u) / uu, 0.0, 1.0) : 0.0;
}

static double to_point(const double a[3], const double u[3], const double p[3])
{
    double on[3], d[3];
    kc_v3_add_scaled(a, nearest_part(a, u, p), u, on);
    kc_v3_sub(p, on, d);
    return kc_v3_norm(d);
}

/* Between two segments, a + s u and b + t v (Ericson, Real-Time Collision Detection, 5.1.9): the nearest
 * points of the lines, if they are inside; else the end that is nearest. */
static double to_segment(const double a[3], const double u[3], const double b[3], const double v[3])
{
    double r[3], on[3], end[3];
    kc_v3_sub(a, b, r);
    kc_v3_add_scaled(b, 1.0, v, end);
    double uu = kc_v3_dot(u, u), uv = kc_v3_dot(u, v), vv = kc_v3_dot(v, v);
    double det = uu * vv - uv * uv;
    double least = kc_min(to_point(a, u, b), to_point(a, u, end));
    kc_v3_add_scaled(a, 1.0, u, end);
    least = kc_min(least, kc_min(to_point(b, v, a), to_point(b, v, end)));
    if (det <= 1e-12 * uu * vv) { return least; } /* parallel, or a point: an end is nearest */
    double s = (uv * kc_v3_dot(v, r) - vv * kc_v3_dot(u, r)) / det;
    double t = (uu * kc_v3_dot(v, r) - uv * kc_v3_dot(u, r)) / det;
    if (s < 0.0 || s > 1.0 || t < 0.0 || t > 1.0) { return least; }
    kc_v3_add_scaled(a, s, u, on);
    kc_v3_add_scaled(b, t, v, end);
    kc_v3_sub(on, end, r);
    return kc_min(least, kc_v3_norm(r));
}

/* From p to a box about the origin; beyond: the part of p outside it. */
static double beyond_box(const double p[3], const double half[3], double beyond[3])
{
    for (uint32_t i = 0u; i < 3u; i++) { beyond[i] = p[i] - kc_clamp(p[i], -half[i], half[i]); }
    return kc_v3_norm(beyond);
}

/* Between a segment and a box about the origin: the squared distance is convex along the segment, its slope
 * is 2 beyond . u. */
static double to_box(const double a[3], const double u[3], const double half[3])
{
    double lo = 0.0, hi = 1.0, p[3], out[3];
    for (uint32_t i = 0u; i < BISECTIONS; i++) {
        double mid = 0.5 * (lo + hi);
        kc_v3_add_scaled(a, mid, u, p);
        (void)beyond_box(p, half, out);
        if (kc_v3_dot(out, u) > 0.0) {
            hi = mid;
        } else {
            lo = mid;
        }
    }
    kc_v3_add_scaled(a, hi, u, p);
    double at_hi = beyond_box(p, half, out);
    kc_v3_add_scaled(a, lo, u, p);
    return kc_min(at_hi, beyond_box(p, half, out));
}

/* Axis of a body from a to a + u, with its middle. */
typedef struct {
    double a[3], u[3], mid[3], half_m;
} axis_t;

static void find_middle(axis_t *axis)
{
    kc_v3_copy(axis->a, axis->mid);
    kc_v3_add_scaled(axis->mid, 0.5, axis->u, axis->mid);
    axis->half_m = 0.5 * kc_v3_norm(axis->u);
}

/* Instructions; tests/bench/wcet.c compares them with what is executed. */
static const uint64_t s_volume_cost[] = {
    [KC_VOL_BELOW] = 100u, [KC_VOL_BOX] = 400u, [KC_VOL_CAPSULE] = 250u, [KC_VOL_SPHERE] = 300u};
#define BOX_COST 5000u  /* more, for the distance of one that may be the nearest */
#define CAPSULE_COST 900u
#define AXES_COST 2000u /* both axes of a body */
#define PAIR_COST 800u
#define PART_COST 1200u  /* more, for each distance of a pair */
#define ROUNDING_M 1e-9 /* a lower bound of a distance must not exceed it by rounding */

/* Lower bounds of distances, by the spheres about the axes. */
static double axis_at_least(const axis_t *one, const axis_t *two)
{
    double d[3];
    kc_v3_sub(one->mid, two->mid, d);
    return kc_v3_norm(d) - one->half_m - two->half_m - ROUNDING_M;
}

static double box_at_least(const kc_volume_t *v, const axis_t *axis)
{
    double p[3], half[3], mid[3], out[3];
    widen(v->p_m, p);
    widen(v->size_m, half);
    kc_v3_sub(axis->mid, p, mid);
    return beyond_box(mid, half, out) - axis->half_m - ROUNDING_M;
}

static double capsule_at_least(const kc_volume_t *v, const axis_t *axis)
{
    axis_t other;
    widen(v->p_m, other.a);
    widen(v->size_m, other.u);
    kc_v3_sub(other.u, other.a, other.u);
    find_middle(&other);
    return axis_at_least(axis, &other) - (double)v->radius_m;
}

/* From the axis a + s u of a body to the volume. */
static double axis_to(const kc_volume_t *v, const double a[3], const double u[3])
{
    double p[3], size[3], d[3];
    widen(v->p_m, p);
    widen(v->size_m, size);
    switch (v->kind) {
    case KC_VOL_BELOW: return kc_min(a[2], a[2] + u[2]) - p[2];
    case KC_VOL_BOX: kc_v3_sub(a, p, d); return to_box(d, u, size);
    case KC_VOL_CAPSULE: kc_v3_sub(size, p, d); return to_segment(a, u, p, d) - (double)v->radius_m;
    default: return to_point(a, u, p) - (double)v->radius_m;
    }
}

/* An end of a body's axis in the base frame. A correction moved the frame along its joint's axis by
 * `along`. A link with a length along that axis (d) keeps its near end: it gets longer, and tilts by
 * `across` towards its far end. Without that length the error may lie before or after the body: it is
 * where it was (`back`) or where the frame is now. */
static void place_end(const kc_guard_arm_t *g, uint32_t j, const float p[3], bool back, double out[3])
{
    double d = j > 0u ? g->arm->joint[j - 1u].d_m : 0.0;
    double z = back ? -g->along_m[j] : 0.0, x = 0.0;
    if (kc_fabs(d) > 0.0) {
        double part = (double)p[2] / d;
        z = g->along_m[j] * (part - 1.0);
        x = g->across_m[j] * part;
    }
    place(&g->frame[j], p, out);
    for (uint32_t i = 0u; i < 3u; i++) {
        out[i] += x * g->frame[j].R[3u * i] + z * g->frame[j].R[3u * i + 2u];
    }
}

/* Different axes of a body: one if an error along the joint's axis has one place, of the tool or a link with a length
 * there. */
static uint32_t count_axes(const kc_arm_t *arm, const kc_body_t *body)
{
    return body->frame == 0u || kc_fabs(arm->joint[body->frame - 1u].d_m) > 0.0 ? 1u : 2u;
}

/* Both axes of every body, or the one: with its frame where the move along the axis ends, and where it began. */
typedef struct {
    axis_t axis[KC_BODY_MAX][2];
    uint32_t n[KC_BODY_MAX];
} axes_t;

static void find_axes(const kc_guard_arm_t *g, axes_t *axes)
{
    for (uint32_t b = 0u; b < g->space->n_body; b++) {
        const kc_body_t *body = &g->space->body[b];
        axes->n[b] = count_axes(g->arm, body);
        for (uint32_t e = 0u; e < axes->n[b]; e++) {
            axis_t *axis = &axes->axis[b][e];
            place_end(g, body->frame, body->start_m, e == 1u, axis->a);
            place_end(g, body->frame, body->end_m, e == 1u, axis->u);
            kc_v3_sub(axis->u, axis->a, axis->u);
            find_middle(axis);
        }
    }
}

/* Smallest distance so far, of which pair, and the instructions that its search was charged with. */
typedef struct {
    double d;
    uint32_t body, met;
    uint64_t cost;
} nearest_t;

static void take_nearer(nearest_t *n, double d, uint32_t body, uint32_t met)
{
    if (d >= n->d) { return; }
    n->d = d;
    n->body = body;
    n->met = met;
}

static void between_bodies(const kc_space_t *s, const axes_t *axes, uint32_t i, uint32_t k, nearest_t *n)
{
    double radii = (double)s->body[i].radius_m + (double)s->body[k].radius_m;
    n->cost += PAIR_COST;
    for (uint32_t e = 0u; e < axes->n[i] * axes->n[k]; e++) {
        const axis_t *one = &axes->axis[i][e / axes->n[k]], *two = &axes->axis[k][e % axes->n[k]];
        if (axis_at_least(one, two) - radii >= n->d) { continue; }
        n->cost += PART_COST;
        take_nearer(n, to_segment(one->a, one->u, two->a, two->u) - radii, i, k);
    }
}

static void nearest_body(const kc_space_t *s, const axes_t *axes, nearest_t *n)
{
    for (uint32_t i = 1u; i < s->n_body; i++) {
        for (uint32_t k = 0u; k < i; k++) {
            if ((s->body[i].collision_pairs >> k & 1u) != 0u) { between_bodies(s, axes, i, k, n); }
        }
    }
}

/* Lower bound of the distance, and what computing the distance itself costs, where both are worth it. */
static double at_least(const kc_volume_t *v, const axis_t *axis, uint64_t *cost)
{
    switch (v->kind) {
    case KC_VOL_BOX: *cost = BOX_COST; return box_at_least(v, axis);
    case KC_VOL_CAPSULE: *cost = CAPSULE_COST; return capsule_at_least(v, axis);
    default: *cost = 0u; return -KC_INF;
    }
}

static void to_volume(const kc_space_t *s, const axis_t *axis, uint32_t body, uint32_t volume, nearest_t *n)
{
    const kc_volume_t *v = &s->volume[volume];
    double radius = (double)s->body[body].radius_m;
    uint64_t more;
    n->cost += s_volume_cost[v->kind];
    if (at_least(v, axis, &more) - radius >= n->d) { return; }
    n->cost += more;
    take_nearer(n, axis_to(v, axis->a, axis->u) - radius, body, volume);
}

static void nearest_volume(const kc_space_t *s, const axes_t *axes, nearest_t *n)
{
    for (uint32_t k = 0u; k < 2u * s->n_body; k++) {
        uint32_t b = k / 2u;
        for (uint32_t v = 0u; v < s->n_volume && k % 2u < axes->n[b]; v++) {
            if ((s->volume[v].excluded >> b & 1u) == 0u) { to_volume(s, &axes->axis[b][k % 2u], b, v, n); }
        }
    }
}

static double answer(const nearest_t *n, uint32_t *body, uint32_t *met)
{
    if (n->d < KC_INF) {
        *body = n->body;
        *met = n->met;
    }
    return n->d;
}

double kc_guard_self_clearance(const kc_guard_arm_t *g, uint32_t *body, uint32_t *other)
{
    axes_t axes;
    nearest_t n = {.d = KC_INF};
    find_axes(g, &axes);
    nearest_body(g->space, &axes, &n);
    return answer(&n, body, other);
}

double kc_guard_clearance(const kc_guard_arm_t *g, uint32_t *body, uint32_t *volume)
{
    axes_t axes;
    nearest_t n = {.d = KC_INF};
    find_axes(g, &axes);
    nearest_volume(g->space, &axes, &n);
    return answer(&n, body, volume);
}

/* ---- limits and verified paths ---- */

static bool within_limits(const kc_guard_request_t *request, kc_guard_reason_t *why)
{
    for (uint32_t j = 0u; j < request->arm->n_joints; j++) {
        double q = request->q_to[j];
        double lo = request->arm->joint[j].q_min + request->margin - NUMBERS_TOL;
        double hi = request->arm->joint[j].q_max - request->margin + NUMBERS_TOL;
        if (q >= lo && q <= hi) { continue; } /* NaN is not */
        *why = (kc_guard_reason_t){(int32_t)j + 1, q, q < lo ? lo : hi};
        return false;
    }
    return true;
}

/* Both ends within the bound of the node, so everything between them too. */
static bool within_bound(const kc_guard_request_t *request, const double *seed, kc_guard_reason_t *why)
{
    double worst = 0.0;
    for (uint32_t j = 0u; j < request->arm->n_joints; j++) {
        double off = kc_max(kc_fabs(request->q_to[j] - seed[j]), kc_fabs(request->q_from[j] - seed[j]));
        double bound = kc_path_bound(request->space, request->to, request->bound[j]);
        double by = off - bound - request->tol - NUMBERS_TOL;
        if (by <= worst) { continue; }
        worst = by;
        *why = (kc_guard_reason_t){(int32_t)j + 1, by, bound};
    }
    return worst <= 0.0;
}

static bool is_at(const kc_guard_request_t *request, const double *seed)
{
    for (uint32_t j = 0u; j < request->arm->n_joints; j++) {
        if (kc_fabs(request->q_to[j] - seed[j]) > NUMBERS_TOL) { return false; }
    }
    return true;
}

static bool on_verified_path(const kc_guard_request_t *request, kc_guard_reason_t *why)
{
    const kc_space_t *s = request->space;
    double seed[KC_JOINT_MAX];
    *why = (kc_guard_reason_t){0, 0.0, 0.0};
    if (!kc_path_is_node(s, request->to)) { return false; }
    kc_path_joints(s, request->to, seed);
    if (request->from != request->to) { /* both places on the segment: a stop is one between its ends */
        return kc_path_on(s, request->from, request->to, request->q_from, 2.0 * request->tol) &&
               kc_path_on(s, request->from, request->to, request->q_to, NUMBERS_TOL);
    }
    /* after a stop on a segment the arm may go to one of its ends */
    return within_bound(request, seed, why) ||
           (is_at(request, seed) && kc_path_leads_to(s, request->to, request->q_from, 2.0 * request->tol));
}

/* ---- keep-out volumes and self-collision ---- */

/* The instructions that it was charged with. */
static uint64_t near_at(const kc_guard_request_t *request, const kc_fixed_t *fixed, double part,
                        kc_guard_near_t *near)
{
    kc_guard_arm_t g = {.arm = request->arm, .space = request->space};
    kc_ctx_t ctx = *request->ctx;
    kc_loads_t work;
    axes_t axes;
    nearest_t n[2] = {{.d = KC_INF}, {.d = KC_INF}};
    for (uint32_t j = 0u; j < request->arm->n_joints; j++) {
        ctx.q[j] = request->q_from[j] + part * (request->q_to[j] - request->q_from[j]);
    }
    const kc_loads_t *loads = kc_fixed_needed_loads(fixed, &ctx, &work);
    kc_fixed_frames(fixed, &ctx, loads, g.frame, g.along_m, g.across_m);
    find_axes(&g, &axes);
    nearest_volume(g.space, &axes, &n[0]);
    nearest_body(g.space, &axes, &n[1]);
    for (uint32_t i = 0u; i < 2u; i++) {
        near->d[i] = n[i].d;
        near->why[i] = (kc_guard_reason_t){(int32_t)n[i].body, -n[i].d, (double)n[i].met};
    }
    return kc_model_cost(request->arm, request->terms, request->coef, false) + AXES_COST * g.space->n_body +
           n[0].cost + n[1].cost;
}

static bool is_local_pose(const kc_space_t *s, uint32_t node)
{
    return node >= KC_HUB_MAX && kc_space_local(s, node - KC_HUB_MAX);
}

/* Upper bound of how far any point of the arm travels during the move: joints turn it about axes that are no
 * farther away than the arm is long. */
static double travel(const kc_guard_request_t *request, double *far)
{
    double reach = KC_GUARD_ABOUT_M + kc_v3_norm(request->arm->tool_xyz_m), turned = 0.0, slid = 0.0;
    *far = 0.0;
    for (uint32_t j = 0u; j < request->arm->n_joints; j++) {
        const kc_joint_t *joint = &request->arm->joint[j];
        double by = kc_fabs(request->q_to[j] - request->q_from[j]);
        bool slides = joint->type == KC_PRISMATIC;
        reach += kc_fabs(joint->a_m) + kc_fabs(joint->d_m) + (slides ? joint->q_max - joint->q_min : 0.0);
        turned += slides ? 0.0 : by;
        slid += slides ? by : 0.0;
        *far = kc_max(*far, by);
    }
    return turned * reach + slid;
}

/* The clearance is checked posture after posture. The step to the next one is so short that no point of the
 * arm can travel farther than the free distance, but not shorter than the least step. */
static double next_part(const kc_guard_request_t *request, const kc_guard_job_t *job)
{
    double far = 0.0, length = travel(request, &far);
    double least = kc_max(KC_GUARD_STEP / kc_max(far, KC_GUARD_STEP), 1.0 / (double)KC_GUARD_STEPS_MAX);
    double free_m = kc_min(job->at.d[0], job->at.d[1]) - KC_GUARD_CLEAR_M;
    return kc_min(1.0, job->part + kc_max(least, free_m / kc_max(length, KC_GUARD_STEP)));
}

static void check_clearance(kc_guard_job_t *job)
{
    for (uint32_t i = 0u; i < 2u && !job->over; i++) {
        double first = job->first.d[i];
        if (job->at.d[i] >= (first < KC_GUARD_CLEAR_M ? first - KC_GUARD_LEAVE_M : KC_GUARD_CLEAR_M)) {
            continue;
        }
        job->why = job->at.why[i];
        job->verdict = i == 0u ? KC_GUARD_VOLUME : KC_GUARD_SELF;
        job->over = true;
    }
}

/* Bound of the loop over postures; the steps of next_part() end before it. What is not checked is not clear. */
static void check_bound(kc_guard_job_t *job)
{
    if (job->over || job->k < KC_GUARD_STEPS_MAX + 2u) { return; }
    job->why = job->at.why[0];
    job->verdict = KC_GUARD_VOLUME;
    job->over = true;
}

/* The instructions that it was charged with. */
static uint64_t next_posture(const kc_guard_request_t *request, const kc_fixed_t *fixed, kc_guard_job_t *job)
{
    uint64_t cost;
    if (job->k == 0u) {
        cost = near_at(request, fixed, 0.0, &job->first);
        job->at = job->first;
    } else {
        job->part = next_part(request, job);
        cost = near_at(request, fixed, job->part, &job->at);
        check_clearance(job);
    }
    job->k++;
    job->over = job->over || !(job->part < 1.0);
    check_bound(job);
    return cost;
}

/* Of a body's two axes against every volume, of pairs of bodies. */
uint64_t kc_guard_clearance_cost(const kc_guard_request_t *request)
{
    const kc_space_t *s = request->space;
    uint64_t cost = kc_model_cost(request->arm, request->terms, request->coef, false);
    for (uint32_t b = 0u; b < s->n_body; b++) {
        const uint32_t n = count_axes(request->arm, &s->body[b]);
        cost += AXES_COST;
        for (uint32_t v = 0u; v < s->n_volume; v++) {
            const uint8_t kind = s->volume[v].kind;
            const uint64_t more = kind == KC_VOL_BOX ? BOX_COST : kind == KC_VOL_CAPSULE ? CAPSULE_COST : 0u;
            cost += (s->volume[v].excluded >> b & 1u) != 0u ? 0u : n * (s_volume_cost[kind] + more);
        }
        for (uint32_t k = 0u; k < b; k++) {
            const uint64_t parts = n * (uint64_t)count_axes(request->arm, &s->body[k]);
            cost += (s->body[b].collision_pairs >> k & 1u) * (PAIR_COST + parts * PART_COST);
        }
    }
    return cost;
}

void kc_guard_begin(const kc_guard_request_t *request, kc_guard_job_t *job)
{
    const kc_space_t *s = request->space;
    *job = (kc_guard_job_t){.verdict = KC_GUARD_OK};
    if (!within_limits(request, &job->why)) {
        job->verdict = KC_GUARD_LIMIT;
    } else if (!on_verified_path(request, &job->why)) {
        job->verdict = KC_GUARD_PATH;
    }
    job->over = job->verdict != KC_GUARD_OK || s->n_body == 0u || is_local_pose(s, request->from) ||
                is_local_pose(s, request->to);
}

bool kc_guard_step(const kc_guard_request_t *request, kc_guard_job_t *job, kc_work_t *work)
{
    const uint64_t cost = kc_guard_clearance_cost(request);
    kc_fixed_t fixed;
    fixed.arm = NULL; /* it is made once there is work for it */
    while (!job->over) {
        if (!kc_work_take(work, cost)) { return false; }
        if (fixed.arm == NULL) { kc_model_fix(request->arm, request->terms, request->coef, &fixed); }
        kc_work_return(work, cost - next_posture(request, &fixed, job));
    }
    return true;
}

double kc_guard_clearance_at(const kc_guard_request_t *request, uint64_t *cost)
{
    kc_guard_near_t near;
    kc_fixed_t fixed;
    kc_model_fix(request->arm, request->terms, request->coef, &fixed);
    *cost = near_at(request, &fixed, 1.0, &near);
    return kc_min(near.d[0], near.d[1]);
}

kc_guard_verdict_t kc_guard_check(const kc_guard_request_t *request, kc_guard_reason_t *why)
{
    kc_work_t work = kc_work_unlimited();
    kc_guard_job_t job;
    kc_guard_begin(request, &job);
    (void)kc_guard_step(request, &job, &work);
    if (job.verdict != KC_GUARD_OK) { *why = job.why; }
    return job.verdict;
}
