/* Which joints are off when the monitor finds something, and how sure: every joint and every two joints together are
 * compared by what their biases explain of the newest observations.
 *
 * A set of joints S has the weight odds^(|S| - 1) x the likelihood of the observations, their biases integrated over
 * +-KC_SUSPECT_BIAS (Laplace: the likelihood at the best biases times the volume that it leaves them). So a second
 * joint is named only if it explains more than noise would let it. Sets whose residuals are implausible as noise have
 * no weight. The chance of a joint is the share of the sets that it is in. As in kc_monitor.h, errors that all
 * observations share are taken to act in the worst direction: by as much as they make a bias less certain, differences
 * of chi-square count less. METHOD.md 10.1. */
#ifndef KC_SUSPECTS_H
#define KC_SUSPECTS_H

#include "kc_monitor.h"

#define KC_SUSPECT_BIAS 1.6 /* [rad or m] */
#define KC_SUSPECT_ODDS 0.1 /* of a second joint that slipped at the same time */
#define KC_SUSPECT_OBS 6u /* observations weighed at most, the newest: as many as a step has time for */
#define KC_SUSPECT_MIN 0.01 /* least chance of a joint that is named among those that may be meant */

typedef struct {
    uint32_t n_obs; /* observations behind it; 0: nothing to weigh */
    uint32_t joints; /* the most probable set, bit per joint; 0: no set explains the observations */
    uint32_t suspects; /* bit per joint whose chance is KC_SUSPECT_MIN or more */
    double chance[KC_JOINT_MAX];
    double bias[KC_JOINT_MAX]; /* of the most probable set: true joint - reading [rad or m] ... */
    double sigma[KC_JOINT_MAX]; /* ... and its sigma, shared part of the noise included; else 0 */
    double p_rest; /* probability of the residuals that the most probable set leaves */
} kc_suspects_t;

/* Weigh the sets over the newest n_obs observations held, KC_SUSPECT_OBS at most. */
void kc_suspects_weigh(const kc_monitor_t *m, uint32_t n_obs, kc_suspects_t *s);
uint64_t kc_suspects_cost(const kc_monitor_t *m); /* bound of its instructions */

#endif
