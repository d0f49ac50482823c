/* Last check of an arm command before it is sent: joint limits, verified path, keep-out volumes,
 * self-collision.
 *
 * Paths and servo bounds were verified on the ground for many arms with errors. The guard checks again on
 * board, for the arm with its newest correction. It adds hardly any clearance: the verification has it
 * already, and more would refuse verified moves. */
#ifndef KC_GUARD_H
#define KC_GUARD_H

#include <stdbool.h>
#include <stdint.h>

#include "kc_model.h"
#include "kc_path.h"
#include "kc_work.h"

#define KC_GUARD_STEP 0.02      /* least step between postures that are checked [rad or m] ... */
#define KC_GUARD_STEPS_MAX 100u /* ... and the most steps, however long the move */
#define KC_GUARD_ABOUT_M 0.3    /* how far bodies on the arm reach beyond its links */

#define KC_GUARD_CLEAR_M 0.005 /* least clearance */
#define KC_GUARD_LEAVE_M 0.002 /* an arm that is nearer already may come this much nearer to get away */

typedef struct {
    const kc_arm_t *arm;
    const kc_terms_t *terms;
    const double *coef; /* the correction in use */
    const kc_space_t *space;
    const kc_ctx_t *ctx; /* inputs of the bases; its q is not used */
    const double *q_from; /* where the arm is */
    const double *q_to; /* where the command sends it, straight in joint space */
    uint32_t from, to;  /* nodes of the verified segment; equal: within the bound of that node */
    const double *bound; /* servo bound of each joint; a hub's is KC_HUB_BOUND at most */
    double margin;      /* distance to keep from the limits */
    double tol;         /* an arm arrives within this of its target [rad or m] */
} kc_guard_request_t;

/* First reason against a command, and what kc_guard_reason_t says about it:
 *   LIMIT   index = joint from 1, got = its target, want = limit less margin
 *   PATH    index = joint from 1 that is farthest outside, got = by how much [rad or m], want = its bound;
 *           0, 0, 0: there is no such segment
 *   VOLUME  index = body, got = depth [m], want = volume
 *   SELF    index = body, got = depth [m], want = the other body */
typedef enum {
    KC_GUARD_OK = 0,
    KC_GUARD_LIMIT = 1,
    KC_GUARD_PATH = 2,
    KC_GUARD_VOLUME = 3,
    KC_GUARD_SELF = 4
} kc_guard_verdict_t;

typedef struct {
    int32_t index;
    double got, want;
} kc_guard_reason_t;

/* An arm at some joints, as kc_model_frames places it. */
typedef struct {
    const kc_arm_t *arm;
    const kc_space_t *space;
    kc_pose_t frame[KC_JOINT_MAX + 1u];
    double along_m[KC_JOINT_MAX + 1u], across_m[KC_JOINT_MAX + 1u];
} kc_guard_arm_t;

/* Distance between bodies and volumes, the smallest of all pairs that are not excluded, and which pair;
 * negative inside (for a box: no deeper than the body's radius). KC_INF without any. Corrections along a
 * joint's axis make a link with a length there longer, those of a let it lean; other bodies count at both
 * ends of the move along the axis. O(n_body n_volume). */
double kc_guard_clearance(const kc_guard_arm_t *g, uint32_t *body, uint32_t *volume);
/* The same between bodies that must not touch. O(n_body^2). */
double kc_guard_self_clearance(const kc_guard_arm_t *g, uint32_t *body, uint32_t *other);

/* Clearance at a part of the move: of volumes, between bodies, and which. */
typedef struct {
    double d[2];
    kc_guard_reason_t why[2];
} kc_guard_near_t;

/* Where a check stands between two steps. */
typedef struct {
    kc_guard_near_t first, at; /* where the move begins, and at the newest posture */
    double part;               /* of the move, up to the newest posture */
    uint32_t k;                /* next posture */
    bool over;
    kc_guard_verdict_t verdict; /* when it is over */
    kc_guard_reason_t why;
} kc_guard_job_t;

/* First reason why the command must not be sent. An arm that is too near to something already, according
 * to a new correction, may leave it. Clearances are not checked on moves to and from local initial poses:
 * there the correction is not known yet. At most KC_GUARD_STEPS_MAX + 2 postures; should they not do, the
 * verdict is VOLUME. Space and arm must be validated. */
kc_guard_verdict_t kc_guard_check(const kc_guard_request_t *request, kc_guard_reason_t *why);
/* The same in parts: begin, then step, once a step of the process and with the same request, until it answers
 * true; then the job holds verdict and reason. */
void kc_guard_begin(const kc_guard_request_t *request, kc_guard_job_t *job);
bool kc_guard_step(const kc_guard_request_t *request, kc_guard_job_t *job, kc_work_t *work);

/* The smaller of both clearances at q_to; KC_INF without any pair. *cost: the instructions that it is charged with, and
 * a bound of them. Of the request only arm, terms, coef, space, ctx and both q are used. */
double kc_guard_clearance_at(const kc_guard_request_t *request, uint64_t *cost);
uint64_t kc_guard_clearance_cost(const kc_guard_request_t *request);

#endif
