#include "kc_guard.h"

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
static void place_end(const kc_guard_arm_t *g, uint32_t j, const float p[3], int back, double out[3])
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

/* Axis of a body from a to a + u. */
static void axis_of(const kc_guard_arm_t *g, const kc_body_t *b, int back, double a[3], double u[3])
{
    place_end(g, b->frame, b->start_m, back, a);
    place_end(g, b->frame, b->end_m, back, u);
    kc_v3_sub(u, a, u);
}

static double between_bodies(const kc_guard_arm_t *g, const kc_body_t *one, const kc_body_t *two)
{
    double least = KC_INF, a[3], u[3], b[3], v[3];
    for (int e = 0; e < 4; e++) {
        axis_of(g, one, e / 2, a, u);
        axis_of(g, two, e % 2, b, v);
        least = kc_min(least, to_segment(a, u, b, v));
    }
    return least - (double)one->radius_m - (double)two->radius_m;
}

double kc_guard_self_clearance(const kc_guard_arm_t *g, uint32_t *body, uint32_t *other)
{
    const kc_space_t *s = g->space;
    double least = KC_INF;
    for (uint32_t i = 1u; i < s->n_body; i++) {
        for (uint32_t k = 0u; k < i; k++) {
            if ((s->body[i].collision_pairs >> k & 1u) == 0u) { continue; }
            double d = between_bodies(g, &s->body[i], &s->body[k]);
            if (d >= least) { continue; }
            least = d;
            *body = i;
            *other = k;
        }
    }
    return least;
}

double kc_guard_clearance(const kc_guard_arm_t *g, uint32_t *body, uint32_t *volume)
{
    const kc_space_t *s = g->space;
    double least = KC_INF, a[3], u[3];
    for (uint32_t k = 0u; k < 2u * s->n_body; k++) {
        uint32_t b = k / 2u;
        axis_of(g, &s->body[b], (int)(k % 2u), a, u);
        for (uint32_t v = 0u; v < s->n_volume; v++) {
            if ((s->volume[v].excluded >> b & 1u) != 0u) { continue; }
            double d = axis_to(&s->volume[v], a, u) - (double)s->body[b].radius_m;
            if (d >= least) { continue; }
            least = d;
            *body = b;
            *volume = v;
        }
    }
    return least;
}

/* ---- limits and verified paths ---- */

static int within_limits(const kc_guard_request_t *request, kc_guard_reason_t *why)
{
    for (uint32_t j = 0u; j < request->arm->n_joints; j++) {
        double q = request->q_to[j];
        double lo = request->arm->joint[j].q_min + request->margin - NUMBERS_TOL;
        double hi = request->arm->joint[j].q_max - request->margin + NUMBERS_TOL;
        if (q >= lo && q <= hi) { continue; } /* NaN is not */
        *why = (kc_guard_reason_t){(int32_t)j + 1, q, q < lo ? lo : hi};
        return 0;
    }
    return 1;
}

/* Both ends within the bound of the node, so everything between them too. */
static int within_bound(const kc_guard_request_t *request, const double *seed, kc_guard_reason_t *why)
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

static int is_at(const kc_guard_request_t *request, const double *seed)
{
    for (uint32_t j = 0u; j < request->arm->n_joints; j++) {
        if (kc_fabs(request->q_to[j] - seed[j]) > NUMBERS_TOL) { return 0; }
    }
    return 1;
}

static int on_verified_path(const kc_guard_request_t *request, kc_guard_reason_t *why)
{
    const kc_space_t *s = request->space;
    double seed[KC_JOINT_MAX];
    *why = (kc_guard_reason_t){0, 0.0, 0.0};
    if (!kc_path_is_node(s, request->to)) { return 0; }
    kc_path_joints(s, request->to, seed);
    if (is_at(request, seed) && request->from != request->to) {
        return kc_path_on(s, request->from, request->to, request->q_from, 2.0 * request->tol);
    }
    if (request->from != request->to) { return 0; }
    /* after a stop on a segment the arm may go to one of its ends */
    return within_bound(request, seed, why) ||
           (is_at(request, seed) && kc_path_leads_to(s, request->to, request->q_from, 2.0 * request->tol));
}

/* ---- keep-out volumes and self-collision ---- */

static void near_at(const kc_guard_request_t *request, double part, kc_guard_near_t *n)
{
    kc_guard_arm_t g = {.arm = request->arm, .space = request->space};
    kc_ctx_t ctx = *request->ctx;
    kc_loads_t loads;
    uint32_t body = 0u, met = 0u;
    for (uint32_t j = 0u; j < request->arm->n_joints; j++) {
        ctx.q[j] = request->q_from[j] + part * (request->q_to[j] - request->q_from[j]);
    }
    kc_model_loads(request->arm, request->terms, request->coef, &ctx, &loads);
    kc_model_frames(request->arm, request->terms, request->coef, &ctx, &loads, g.frame, g.along_m,
                    g.across_m);
    n->d[0] = kc_guard_clearance(&g, &body, &met);
    n->why[0] = (kc_guard_reason_t){(int32_t)body, -n->d[0], (double)met};
    n->d[1] = kc_guard_self_clearance(&g, &body, &met);
    n->why[1] = (kc_guard_reason_t){(int32_t)body, -n->d[1], (double)met};
}

static int is_local_pose(const kc_space_t *s, uint32_t node)
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
        int slides = joint->type == KC_PRISMATIC;
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

static void next_posture(const kc_guard_request_t *request, kc_guard_job_t *job)
{
    if (job->k == 0u) {
        near_at(request, 0.0, &job->first);
        job->at = job->first;
    } else {
        job->part = next_part(request, job);
        near_at(request, job->part, &job->at);
        check_clearance(job);
    }
    job->k++;
    job->over = job->over || job->k > KC_GUARD_STEPS_MAX + 1u || !(job->part < 1.0);
}

/* Bound of the instructions for one posture: of a body's two axes against every volume, of pairs of bodies. */
static uint64_t posture_cost(const kc_guard_request_t *request)
{
    static const uint64_t volume[] = {
        [KC_VOL_BELOW] = 100u, [KC_VOL_BOX] = 5000u, [KC_VOL_CAPSULE] = 900u, [KC_VOL_SPHERE] = 300u};
    const kc_space_t *s = request->space;
    uint64_t cost = kc_model_cost(request->arm, request->terms, 0);
    for (uint32_t b = 0u; b < s->n_body; b++) {
        cost += 2000u;
        for (uint32_t v = 0u; v < s->n_volume; v++) {
            cost += (s->volume[v].excluded >> b & 1u) != 0u ? 0u : 2u * volume[s->volume[v].kind];
        }
        for (uint32_t k = 0u; k < b; k++) { cost += (s->body[b].collision_pairs >> k & 1u) * 5500u; }
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
    const uint64_t cost = posture_cost(request);
    while (!job->over) {
        if (!kc_work_take(work, cost)) { return false; }
        next_posture(request, job);
    }
    return true;
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
