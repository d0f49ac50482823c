/* The SPACE table: candidates, hubs (nodes of the roadmap) and the segments between them that were
 * verified on the ground, that is checked to be free of collisions for the arm with errors. */
#ifndef KC_SPACE_H
#define KC_SPACE_H

#include <stdbool.h>
#include <stdint.h>

#include "kc_arm.h"
#include "kc_limits.h"

/* Bit of kc_cand_t.why: a local initial pose, near the park pose. It is measured at its seed, without servo,
 * before any long move, so that the errors of the arm are known before it leaves the park pose. */
#define KC_CAND_LOCAL 0x8000u
/* The guard does not check the clearance of a move to or from a local initial pose, since the correction is not known
 * there. So these moves have to be short: no joint farther than this from the park pose [rad or m], hub 0, to which the
 * pose's only segment leads. */
#define KC_LOCAL_BOUND 1.0
/* A local initial pose in reserve: only measured while tags were detected at fewer than half of those
 * before it. */
#define KC_CAND_RESERVE 0x4000u
/* Unit of the places of stops on a segment. */
#define KC_STOP_PARTS 256u
#define KC_EDGE_BYTES (KC_CAND_MAX * (KC_CAND_MAX - 1u) / 2u / 8u)

/* Single precision on purpose: 0.1 um and 0.1 urad, half the memory. */
typedef struct {
    float p_m[3]; /* goal pose of the tool in the base frame */
    float q_wxyz[4];
    float q_seed[KC_JOINT_MAX]; /* joints that reach it on the nominal arm */
    float pan_rad, tilt_rad; /* pan-tilt angles that have it in view */
    uint8_t tags; /* bit per tag expected in view */
    uint8_t hub; /* hub with a verified straight segment to the seed */
    uint16_t why; /* bits: checks it passed, see docs/INTERFACES.md */
} kc_cand_t;

/* A capsule that encloses shapes of the arm: from start to end, with hemispheres. */
typedef struct {
    uint8_t frame; /* 0: tool; j: turns with joint j, before d, a and alpha of its link */
    float start_m[3], end_m[3];
    float radius_m;
    uint32_t collision_pairs; /* bit per body before it that it must not touch */
} kc_body_t;

typedef enum {
    KC_VOL_BELOW = 0, /* everything below the height p_m[2] */
    KC_VOL_BOX = 1, /* p_m: middle, size_m: half lengths along the base axes */
    KC_VOL_CAPSULE = 2, /* from p_m to size_m */
    KC_VOL_SPHERE = 3
} kc_volume_kind_t;

/* Keep-out volume, base frame: no body of the arm may enter it. */
typedef struct {
    uint8_t kind; /* kc_volume_kind_t */
    float p_m[3], size_m[3];
    float radius_m; /* capsule and sphere */
    uint32_t excluded; /* bit per body that may be inside it */
} kc_volume_t;

/* DH errors of a joint that the arms had for which the space was verified: that far both ways. */
typedef struct {
    double phi_rad, alpha_rad, a_m, d_m;
} kc_dh_bound_t;

typedef struct {
    uint32_t n_cand, n_hub, n_joints, n_initial;
    uint16_t initial[KC_INITIAL_MAX]; /* candidates of the initial design, in order */
    float hub_q[KC_HUB_MAX][KC_JOINT_MAX];
    uint16_t hub_edge[KC_HUB_MAX]; /* bit h: segment to hub h is verified */
    float servo_bound[KC_JOINT_MAX]; /* largest distance of each joint from a seed */
    uint32_t arm_crc; /* arm table it was built for */
    kc_cand_t cand[KC_CAND_MAX];
    /* direct segments between candidates i > j: bit i (i-1)/2 + j */
    uint8_t edge[KC_EDGE_BYTES];
    uint32_t n_body, n_volume; /* 0 = none */
    kc_body_t body[KC_BODY_MAX];
    kc_volume_t volume[KC_VOLUME_MAX];
    kc_dh_bound_t verified[KC_JOINT_MAX];
    /* Stops of each candidate on the segment from its hub, in order, in parts of it (1 to 255 of KC_STOP_PARTS); 0: none
     * there. There a tag is in view, as at the candidate. n_stop: most of a candidate, 0 = none in the whole table. */
    uint32_t n_stop;
    uint8_t stop[KC_CAND_MAX][KC_STOP_MAX];
} kc_space_t;

/* Whether the segment between two candidates is verified and may be used; false for one that does not exist, and for local
 * initial poses, which have none but that to hub 0. */
bool kc_space_edge(const kc_space_t *space, uint32_t i, uint32_t j);

/* Whether a candidate that exists is a local initial pose, and one in reserve; the number of local initial
 * poses. */
bool kc_space_local(const kc_space_t *space, uint32_t cand);
bool kc_space_reserve(const kc_space_t *space, uint32_t cand);
uint32_t kc_space_n_local(const kc_space_t *space);

/* Number of stops of a candidate that exists. */
uint32_t kc_space_n_stops(const kc_space_t *space, uint32_t cand);
/* Joints at its stop i (below that number). */
void kc_space_stop(const kc_space_t *space, uint32_t cand, uint32_t i, double *q);
/* Whether stop i of a candidate is one that flight can make: in order, after the last one there is none, local initial
 * poses have none. */
bool kc_space_stop_fits(const kc_space_t *space, uint32_t cand, uint32_t i);

/* First problem found: KC_ERR_RANGE, *got = the value, *index = candidate, KC_SPACE_INDEX_HUB + hub,
 * KC_SPACE_INDEX_INITIAL + place in the list of initial poses, KC_SPACE_INDEX_BODY + body,
 * KC_SPACE_INDEX_VOLUME + volume, KC_SPACE_INDEX_VERIFIED + joint from 0, or -1. Checks counts, finite numbers, unit norms (1e-6), hub and
 * initial-pose numbers, that no initial pose is listed twice, that hub segments go both ways, that no edge
 * bit is set beyond n_cand, that local initial poses belong to hub 0 and are near it, and that every candidate is reachable from hub 0; with arm (NULL: skip) also
 * its number of joints and that hubs and seeds lie inside its limits (1e-6, single precision). */
#define KC_SPACE_INDEX_HUB 2000
#define KC_SPACE_INDEX_INITIAL 3000
#define KC_SPACE_INDEX_BODY 4000
#define KC_SPACE_INDEX_VOLUME 5000
#define KC_SPACE_INDEX_VERIFIED 6000
kc_status_t kc_space_validate(const kc_space_t *space, const kc_arm_t *arm, int32_t *index, double *got);

#endif
