/* What the SPACE table was verified for, against what the TERMS table lets the arm be (SPACES.md).
 *
 * Every correction term turns or shifts what comes after its frame. Along the axes of DH errors (rz, tz before a
 * joint, rx, tx after it) that is an error for which the space states a bound, whatever the term depends on. So at
 * each frame and axis the bounds of all enabled coefficients, each times the largest size of its terms, add up, and
 * the sum may be a tenth more than the space's bound. Along other axes the smaller bound of the same kind (angle,
 * length) at that frame counts. The tool frame counts as the last link; what acts on the measurement can stand for an
 * arm that is off, so the camera counts as the base and the measured pose as the tool. */
#ifndef KC_BOUNDS_H
#define KC_BOUNDS_H

#include "kc_space.h"
#include "kc_terms.h"

/* The sum of the bounds may be so many times what was verified. */
#define KC_BOUNDS_EXCESS 1.1

/* What flight can meet beyond what ARM states: joint limits, speeds, masses, size of gravity. Variables are taken to
 * stay inside; the payload is that of a scoop. */
#define KC_BOUNDS_TEMP_MIN_C (-200.0)
#define KC_BOUNDS_TEMP_MAX_C 150.0
#define KC_BOUNDS_TIME_S 1e5 /* from c0 of the basis */
#define KC_BOUNDS_PAYLOAD_KG 0.5
#define KC_BOUNDS_DISTANCE_M 3.0 /* camera to tool, and its components */

/* Error that the space was verified for at a frame along an axis [rad or m]; frame and comp as kc_terms_validate
 * allows. */
double kc_bounds_verified(const kc_space_t *space, uint32_t frame, uint32_t comp);

/* Largest size of gain x basis x basis [rad or m per unit of the coefficient]: not smaller than any value that flight
 * can meet. O(n_joints). */
double kc_bounds_size(const kc_arm_t *arm, const kc_term_t *t);

/* Where TERMS lets the arm be more than it was verified for. */
typedef struct {
    uint32_t coef; /* the first with which the sum is too large */
    uint32_t frame, comp; /* where */
    double sum, verified; /* [rad or m] */
} kc_bounds_bad_t;

/* KC_OK; KC_ERR_RANGE with *bad set. All three tables validated, with as many joints. O(n_term n_joints). */
kc_status_t kc_bounds_check(const kc_space_t *space, const kc_arm_t *arm, const kc_terms_t *terms,
                            kc_bounds_bad_t *bad);
/* Bound of the instructions of kc_bounds_check for so many terms. */
uint64_t kc_bounds_cost(uint32_t n_term);

#endif
