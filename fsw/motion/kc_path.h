/* Paths over the roadmap of the SPACE table. */
#ifndef KC_PATH_H
#define KC_PATH_H

#include <stdbool.h>
#include <stdint.h>

#include "kc_space.h"

#define KC_PATH_MAX (KC_HUB_MAX + 2u)
/* Hub bound: how far each joint may be from a hub [rad or m]. Hubs are places to pass. */
#define KC_HUB_BOUND 0.05

/* Nodes of the roadmap: hub h, or KC_HUB_MAX + candidate; KC_NODE_NONE: none. */
#define KC_NODE_NONE 0xffffu

/* Whether the table holds that node. */
bool kc_path_is_node(const kc_space_t *space, uint32_t node);

/* Waypoints from node `from` to node `to` (both excluded start, included goal), as nodes: at most
 * KC_PATH_MAX. A direct edge if verified, else over hubs (breadth first, lowest index on ties).
 * KC_ERR_PATH if there is none or a node does not exist (KC_NODE_NONE: no verified segment begins
 * where the arm is); *n = 0 if from == to. O(n_hub^2). */
kc_status_t kc_path_plan(const kc_space_t *space, uint32_t from, uint32_t to, uint16_t *path, uint32_t *n);

/* Largest distance of each joint from a node that exists [rad or m]: `bound`; at hubs and local initial poses
 * KC_HUB_BOUND at most. */
double kc_path_bound(const kc_space_t *space, uint32_t node, double bound);

/* Seed joints of a node that exists, n_joints values. */
void kc_path_joints(const kc_space_t *space, uint32_t node, double *q);

/* Node nearest to q, and its distance: the largest joint difference, each in units of that joint's bound (at
 * hubs: KC_HUB_BOUND at most), so up to 1 is inside the bound of the node. Ties: hubs first, then lowest
 * index. KC_NODE_NONE for an empty space. O(n_cand n_joints). */
uint32_t kc_path_nearest(const kc_space_t *space, const double *bound, const double *q, double *dist);

/* An end of a verified segment on which q lies: every joint within tol of one point of the straight line.
 * Candidate to its hub: the hub; else the end with the lower index. KC_NODE_NONE if q is on none. Segments
 * of hubs first, then of candidates. O(n_cand^2 n_joints) at most. */
uint32_t kc_path_on_segment(const kc_space_t *space, const double *q, double tol);

/* Whether q lies within tol of the straight segment between two nodes that the ground verified. */
bool kc_path_on(const kc_space_t *space, uint32_t from, uint32_t to, const double *q, double tol);
/* The same for any verified segment that ends at the node. O(n_cand n_joints). */
bool kc_path_leads_to(const kc_space_t *space, uint32_t node, const double *q, double tol);

#endif
