/* The last look at an arm command before it is sent: limits, proven ways, keep-out volumes, the arm itself.
 *
 * Ways and boxes were proven on the ground for many arms that are wrong; this asks again on board, for the
 * arm as it is believed to be now. Hardly any safety distance is added: the ground has it in what it proved,
 * and more here would only refuse what is proven. */
#ifndef KC_GUARD_H
#define KC_GUARD_H

#include <stdint.h>

#include "kc_model.h"
#include "kc_path.h"

#define KC_GUARD_STEP 0.02      /* least step between postures that are looked at [rad or m] ...        */
#define KC_GUARD_STEPS_MAX 100u /* ... and no more steps than so many, however long the way             */
#define KC_GUARD_ABOUT_M 0.3    /* what stands on the arm reaches so far beyond its links               */

#define KC_GUARD_CLEAR_M 0.005 /* nothing that counts for the guard may come nearer                    */
#define KC_GUARD_LEAVE_M 0.002 /* but an arm that is nearer already may go this much deeper to get away */

typedef struct {
    const kc_arm_t *arm;
    const kc_terms_t *terms;
    const double *coef;        /* the correction in use                                          */
    const kc_space_t *space;
    const kc_ctx_t *ctx;       /* what else the bases see; its q is not used                     */
    const double *q_from;      /* where the arm stands                                           */
    const double *q_to;        /* where it shall go, straight in joint space                     */
    uint32_t from, to;         /* nodes whose proven segment this is; equal: inside that node's box */
    const double *leash;       /* half size of a candidate's box; a hub's is KC_HUB_LEASH at most */
    double margin;             /* to keep from the limits                                        */
    double tol;                /* an arm stands where it was sent within this [rad or m]         */
} kc_guard_ask_t;

typedef enum {
    KC_GUARD_FINE = 0,
    KC_GUARD_LIMIT = 1,        /* index = joint from 1, got = its value, want = the limit less margin */
    KC_GUARD_WAY = 2,          /* index = joint from 1 that is farthest beyond, got = by how much
                                  [rad or m], want = what it may be off; 0, 0, 0: no such segment     */
    KC_GUARD_VOLUME = 3,       /* index = body, got = depth [m], want = volume                        */
    KC_GUARD_SELF = 4          /* index = body, got = depth [m], want = the other body                */
} kc_guard_verdict_t;

typedef struct {
    int32_t index;
    double got, want;
} kc_guard_why_t;

/* An arm at some joints, as kc_model_frames places it. */
typedef struct {
    const kc_arm_t *arm;
    const kc_space_t *space;
    kc_pose_t frame[KC_JOINT_MAX + 1u];
    double along_m[KC_JOINT_MAX + 1u], across_m[KC_JOINT_MAX + 1u];
} kc_guard_arm_t;

/* Distance between bodies and volumes, the smallest of all pairs but those that are spared, and which pair;
 * negative inside (for a box: no deeper than the body's radius). KC_INF without any. Corrections along a
 * joint's axis make a link with a length there longer, those of a let it lean; other bodies count at both ends
 * of the move along the axis.
 * O(n_body n_volume). */
double kc_guard_clearance(const kc_guard_arm_t *g, uint32_t *body, uint32_t *volume);
/* The same between bodies that must not meet. O(n_body^2). */
double kc_guard_self_clearance(const kc_guard_arm_t *g, uint32_t *body, uint32_t *other);

/* First reason why the command must not be sent. An arm that is too near to something already, by a
 * correction that was not known before, may leave it. First looks are how the arm gets known; on the way to
 * them and back nothing is measured against what is believed of it. At most KC_GUARD_STEPS_MAX + 1
 * postures. Space and arm must be validated. */
kc_guard_verdict_t kc_guard_check(const kc_guard_ask_t *ask, kc_guard_why_t *why);

#endif
