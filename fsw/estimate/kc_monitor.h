/* Miscalibration monitor for normal operation: does the tool stand where the joint readings say?
 *
 * The last KC_MON_OBS_MAX observations are held as residuals against the active correction. For every
 * joint and every onset (the newest 2, 3 ... observations) a generalised likelihood ratio asks whether a
 * constant bias of that joint alone explains them, all coefficients held. The bias moves the tool by an
 * exact turn about the joint's axis (shift, if prismatic), so a bias of a few tenths of a radian fits as
 * well as a small one.
 *
 * Noise. No variance of an observation is below the floor, which stands for errors that all observations
 * share (lens, tag size). That part is taken to push every observation in the same, worst direction: it
 * never averages out.
 *
 * Named: the bias is significant (chance below KC_MON_P an observation, over all joints and onsets
 * together) and the remaining residuals are plausible as noise. A single outlier is therefore no alarm.
 * Unexplained: several observations in a row are off, each by itself, and no single joint explains them
 * (two joints, a bent link, camera, tool). */
#ifndef KC_MONITOR_H
#define KC_MONITOR_H

#include <stdint.h>

#include "kc_limits.h"
#include "kc_model.h"

#define KC_MON_OBS_MAX 8u /* observations held */
#define KC_MON_OBS_MIN 2u /* needed to name a joint */
#define KC_MON_OBS_OFF 3u /* in a row, to report an unexplained error */
#define KC_MON_P 5e-5 /* largest false-alarm rate an observation (really a seventh: onsets overlap) */
#define KC_MON_P_REST 1e-6 /* least probability of the residuals that a named joint leaves */
#define KC_MON_TIE 9.21 /* joints within this chi-square (100:1) count as alternatives */

typedef enum {
    KC_MON_QUIET = 0,
    KC_MON_NAMED = 1,
    KC_MON_UNEXPLAINED = 2,
    KC_MON_SEVERAL = 3 /* two joints together explain what none alone does (kc_suspects.h) */
} kc_mon_state_t;

typedef struct {
    double r[6];                /* measured - predicted [m m m rad rad rad], base frame */
    double W[36];               /* whitens r, floor included */
    double Jq[KC_JOINT_MAX][6]; /* d predicted / d joint */
} kc_mon_obs_t;

/* Caller owns it (static), below 6 KiB. */
typedef struct {
    uint32_t n_joints, prismatic; /* prismatic: bit per joint */
    double floor2[6];             /* smallest variances */
    uint32_t n, next;             /* observations held; place of the next one */
    kc_mon_obs_t obs[KC_MON_OBS_MAX];
} kc_monitor_t;

typedef struct {
    kc_mon_state_t state;
    uint32_t joint;      /* most suspect, from 0; valid when named */
    uint32_t suspects;   /* bit per joint that may be meant, `joint` too */
    uint32_t n_obs;      /* observations behind it */
    double bias, sigma;  /* true joint - reading [rad or m], shared part of the noise included */
    double stat;         /* (bias / sigma)^2 */
    double p;            /* largest chance of this finding on a healthy arm; 1 when quiet */
    double rest, p_rest; /* chi-square that remains, and its probability */
    double off_m, off_rad; /* newest observation: distance to the prediction */
} kc_mon_verdict_t;

/* Empty. Floors as in CONFIG (sigma_pos_min_m, sigma_rot_min_rad), 0 or more. */
void kc_monitor_init(kc_monitor_t *m, const kc_arm_t *arm, double floor_pos_m, double floor_rot_rad);
/* Add an observation of the arm with coefficients coef (NULL: all zero); replaces the oldest one when
 * full. work: scratch. KC_ERR_ARG if it has no orientation, KC_ERR_NUM if its covariance is not positive
 * definite or the residual is not finite; m unchanged then. */
kc_status_t kc_monitor_add(kc_monitor_t *m, const kc_arm_t *arm, const kc_terms_t *terms, const double *coef,
                           const kc_obs_t *obs, kc_eval_t *work);
/* Observation i of those held, counted back from the newest (0). */
const kc_mon_obs_t *kc_monitor_back(const kc_monitor_t *m, uint32_t i);
/* Verdict on the observations held. O(n_joints KC_MON_OBS_MAX^2). */
void kc_monitor_evaluate(const kc_monitor_t *m, kc_mon_verdict_t *v);
uint64_t kc_monitor_evaluate_cost(const kc_monitor_t *m); /* bound of its instructions */

#endif
