/* Reaching a candidate: what to do where no tag is detected, where to search, from which side to come. */
#ifndef KC_REACH_H
#define KC_REACH_H

#include <stdbool.h>

#include "kc_camera.h"
#include "kc_config.h"

/* What was tried at this candidate. */
typedef struct {
    bool detected;  /* tags were, here */
    bool seed;      /* the joints of the seed, where the nominal arm has the tags in view */
    bool searched;  /* since the arm last moved */
    bool retreated; /* to where tags were detected last */
} kc_tried_t;

typedef enum {
    KC_NO_TAGS_SEED = 0,
    KC_NO_TAGS_SEARCH = 1,
    KC_NO_TAGS_RETREAT = 2,
    KC_NO_TAGS_SKIP = 3
} kc_no_tags_t;

/* No tags where they should be. The correction may still be wrong: first the seed, unless the arm is there
 * (at_seed), then the pan-tilt unit searches. Where tags were detected and then lost, another pan-tilt direction
 * does not help: the servo turned the tags away, or they are hidden. The arm returns to where they were detected
 * last. */
kc_no_tags_t kc_reach_no_tags(const kc_tried_t *tried, bool at_seed);

/* Place i >= 1 of the square spiral around the expected direction, in search steps. O(i). */
void kc_reach_spiral(uint32_t i, double *x, double *y);

/* Number of search positions: all of them before the first measurement (n_meas = 0); later as many as the last
 * residual at that range makes necessary. Tags that should be in the middle of the image and are not detected
 * there are hidden or turned away, and no pan-tilt direction helps. */
uint32_t kc_reach_search_limit(const kc_camera_t *camera, const kc_config_t *config, uint32_t n_meas,
                               double residual_m, double range_m);

/* Where a joint at q moves back to before it comes to q again, by `by` at most, inside [lo, hi]. The side is
 * changed if the other one has more room. */
double kc_reach_draw_back(double q, double lo, double hi, double by, bool below);

#endif
