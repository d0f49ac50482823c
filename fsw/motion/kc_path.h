/* Candidates, hubs and the segments between them that the ground proved safe. */
#ifndef KC_PATH_H
#define KC_PATH_H

#include <stdint.h>

#include "kc_arm.h"
#include "kc_limits.h"

#define KC_PATH_MAX (KC_HUB_MAX + 2u)
/* What joints may be off a hub [rad or m]: hubs are places to pass, proven no farther about them. */
#define KC_HUB_LEASH 0.05
/* Bit of kc_cand_t.why: a first look. It is measured at its seed, without servo, before anything else: looks
 * about the place where the arm stands tell what is wrong with it before it goes anywhere. */
#define KC_CAND_FIRST 0x8000u
/* A first look that is only taken while fewer than half of those before it saw a tag. */
#define KC_CAND_SPARE 0x4000u
#define KC_EDGE_BYTES (KC_CAND_MAX * (KC_CAND_MAX - 1u) / 2u / 8u)

/* Single precision on purpose: 0.1 um and 0.1 urad, half the memory. */
typedef struct {
    float p_m[3]; /* wanted tool pose in the base frame              */
    float q_wxyz[4];
    float q_seed[KC_JOINT_MAX]; /* joints that reach it on the nominal arm         */
    float pan_rad, tilt_rad; /* head angles that see it                         */
    uint8_t tags; /* bit per tag expected in view                    */
    uint8_t hub; /* hub with a proven straight segment to the seed  */
    uint16_t why; /* bits: checks it passed, see docs/INTERFACES.md  */
} kc_cand_t;

/* A capsule that the arm's shapes lie in: from start to end, with hemispheres. */
typedef struct {
    uint8_t frame;              /* 0: tool; j: turns with joint j, before d, a and alpha of its link */
    float start_m[3], end_m[3];
    float radius_m;
    uint32_t apart;             /* bit per body before it that it must not meet                      */
} kc_body_t;

typedef enum {
    KC_VOL_BELOW = 0,           /* everything below the height p_m[2]              */
    KC_VOL_BOX = 1,             /* p_m: middle, size_m: half lengths along the base axes */
    KC_VOL_CAPSULE = 2,         /* from p_m to size_m                              */
    KC_VOL_SPHERE = 3
} kc_volume_kind_t;

/* Nothing of the arm may be there; base frame. */
typedef struct {
    uint8_t kind;               /* kc_volume_kind_t                                */
    float p_m[3], size_m[3];
    float radius_m;             /* capsule and sphere                              */
    uint32_t spared;            /* bit per body that stands there by design        */
} kc_volume_t;

typedef struct {
    uint32_t n_cand, n_hub, n_joints, n_prior;
    uint16_t prior[KC_PRIOR_MAX]; /* candidate ids that start a calibration */
    float hub_q[KC_HUB_MAX][KC_JOINT_MAX];
    uint16_t hub_edge[KC_HUB_MAX]; /* bit h: segment to hub h is proven      */
    float servo_leash[KC_JOINT_MAX]; /* each joint's distance from a seed proven safe */
    uint32_t arm_crc; /* arm table it was built for             */
    kc_cand_t cand[KC_CAND_MAX];
    uint8_t edge[KC_EDGE_BYTES]; /* direct candidate-candidate segments: bit
                                                 i (i-1)/2 + j for i > j                 */
    uint32_t n_body, n_volume;                /* 0 = none                               */
    kc_body_t body[KC_BODY_MAX];
    kc_volume_t volume[KC_VOLUME_MAX];
} kc_space_t;

/* Where the arm stands: node = hub h, or KC_HUB_MAX + candidate; KC_NODE_NONE unknown. */
#define KC_NODE_NONE 0xffffu

int kc_space_edge(const kc_space_t *s, uint32_t i, uint32_t j);
/* Whether the table holds that node. */
int kc_path_is_node(const kc_space_t *s, uint32_t node);

/* Way points from node `from` to node `to` (both excluded start, included goal), as nodes: at most
 * KC_PATH_MAX. A direct edge if proven, else over hubs (breadth first, lowest index on ties).
 * KC_ERR_PATH if there is none or a node does not exist (KC_NODE_NONE: the arm stands somewhere no
 * segment was proven from); *n = 0 if from == to. O(n_hub^2). */
kc_status_t kc_path_plan(const kc_space_t *s, uint32_t from, uint32_t to, uint16_t *way, uint32_t *n);

/* Whether a candidate that exists is a first look; the first looks among the prior poses. */
int kc_space_first(const kc_space_t *s, uint32_t cand);
int kc_space_spare(const kc_space_t *s, uint32_t cand);
uint32_t kc_space_n_first(const kc_space_t *s);

/* Largest distance of each joint from a node that exists [rad or m]: `leash`, about hubs and first looks
 * KC_HUB_LEASH at most. */
double kc_path_leash(const kc_space_t *s, uint32_t node, double leash);

/* Seed joints of a node that exists, n_joints values. */
void kc_path_joints(const kc_space_t *s, uint32_t node, double *q);

/* Node nearest to q, and its distance: the largest joint difference, each in units of that joint's leash (of
 * hubs: KC_HUB_LEASH at most), so up to 1 is inside the box around the node. Ties: hubs first, then lowest
 * index. KC_NODE_NONE for an empty space. O(n_cand n_joints). */
uint32_t kc_path_nearest(const kc_space_t *s, const double *leash, const double *q, double *dist);

/* An end of a proven segment on which q lies: every joint within tol of one point of the straight line.
 * Candidate to its hub: the hub; else the end with the lower index. KC_NODE_NONE if q is on none. Segments
 * of hubs first, then of candidates. O(n_cand^2 n_joints) at most. */
uint32_t kc_path_on_segment(const kc_space_t *s, const double *q, double tol);

/* Whether q lies within tol of the straight segment between two nodes that the ground proved. */
int kc_path_on(const kc_space_t *s, uint32_t from, uint32_t to, const double *q, double tol);
/* The same for any proven segment that ends at the node. O(n_cand n_joints). */
int kc_path_leads_to(const kc_space_t *s, uint32_t node, const double *q, double tol);

/* First problem found: KC_ERR_RANGE, *got = the value, *index = candidate, KC_SPACE_INDEX_HUB + hub,
 * KC_SPACE_INDEX_PRIOR + place in the list of priors, KC_SPACE_INDEX_BODY + body, KC_SPACE_INDEX_VOLUME +
 * volume, or -1. Checks counts, finite numbers, unit norms (1e-6), hub and prior numbers, that no prior is
 * listed twice, that hub segments go both ways, that no edge bit is set beyond n_cand, and that every
 * candidate is reachable from hub 0; with arm (NULL: skip) also its number of joints and that hubs and
 * seeds lie inside its limits (1e-6, single precision). */
#define KC_SPACE_INDEX_HUB 2000
#define KC_SPACE_INDEX_PRIOR 3000
#define KC_SPACE_INDEX_BODY 4000
#define KC_SPACE_INDEX_VOLUME 5000
kc_status_t kc_space_validate(const kc_space_t *s, const kc_arm_t *arm, int32_t *index, double *got);

#endif
