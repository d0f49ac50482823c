/* Does the arm still stand where its readings say? Miscalibration monitor for normal operation.
 *
 * The last KC_MON_LOOKS looks are held as residuals against the active correction. For every joint and
 * every onset (the newest 2, 3 ... looks) a generalised likelihood ratio asks whether a constant bias of
 * that joint alone explains them, all coefficients held. The bias moves the tool by an exact turn about the
 * joint's axis (shift, if prismatic), so a bias of a few tenths of a radian fits as well as a small one.
 *
 * Noise. No variance of a look is below the floor, which stands for what looks share (lens, tag size):
 * that part is taken to push the estimate the same, worst way in every look and never averages out.
 *
 * Named: the bias is significant (chance below KC_MON_P a look, over all joints and onsets together) and
 * what it leaves is plausible as noise. One wild look is therefore no alarm. Unexplained: several looks in
 * a row are off, each by itself, and no single joint tells why (two joints, a bent link, camera, tool). */
#ifndef KC_MONITOR_H
#define KC_MONITOR_H

#include <stdint.h>

#include "kc_limits.h"
#include "kc_model.h"

#define KC_MON_LOOKS 8u     /* looks held                                                         */
#define KC_MON_MIN_LOOKS 2u /* needed to name a joint                                             */
#define KC_MON_OFF_LOOKS 3u /* in a row, to say that something unknown is wrong                   */
#define KC_MON_P 5e-5       /* bound of the chance of an alarm a healthy look (onsets overlap: a seventh) */
#define KC_MON_P_REST 1e-6  /* what a named joint leaves must not be less likely than this        */
#define KC_MON_TIE 9.21     /* joints within this much chi-square (100:1) are not told apart      */

typedef enum { KC_MON_QUIET = 0, KC_MON_NAMED = 1, KC_MON_UNEXPLAINED = 2 } kc_mon_state_t;

typedef struct {
    double r[6];                  /* seen - predicted [m m m rad rad rad], base frame  */
    double W[36];                 /* whitens r, floor included                         */
    double Jq[KC_JOINT_MAX][6];   /* d predicted / d joint                             */
} kc_mon_look_t;

/* Caller owns it (static), below 6 KiB. */
typedef struct {
    uint32_t n_joints, prismatic; /* prismatic: bit per joint                          */
    double floor2[6];             /* smallest variances                                */
    uint32_t n, next;             /* looks held; place of the next one                 */
    kc_mon_look_t look[KC_MON_LOOKS];
} kc_monitor_t;

typedef struct {
    kc_mon_state_t state;
    uint32_t joint;               /* most suspect, from 0; valid when named            */
    uint32_t suspects;            /* bit per joint that could be meant, `joint` too    */
    uint32_t n_looks;             /* looks behind it                                   */
    double bias, sigma;           /* true joint - reading [rad or m], shared part of the noise included */
    double stat;                  /* (bias / sigma)^2                                  */
    double p;                     /* chance of this finding on a healthy arm, at most; 1 when quiet  */
    double rest, p_rest;          /* chi-square it leaves, and the chance of that      */
    double off_m, off_rad;        /* newest look: distance to the prediction           */
} kc_mon_verdict_t;

/* Empty. Floors as in CONFIG (sigma_pos_min_m, sigma_rot_min_rad), 0 or more. */
void kc_monitor_init(kc_monitor_t *m, const kc_arm_t *arm, double floor_pos_m, double floor_rot_rad);
/* A look at the arm with coefficients coef (NULL: all zero), replaces the oldest one when full. work:
 * scratch. KC_ERR_ARG if it has no orientation, KC_ERR_NUM if its covariance is not positive definite or the
 * residual is not finite; m unchanged then. */
kc_status_t kc_monitor_add(kc_monitor_t *m, const kc_arm_t *arm, const kc_terms_t *terms, const double *coef,
                           const kc_obs_t *obs, kc_eval_t *work);
/* What the looks held say. O(n_joints KC_MON_LOOKS^2). */
void kc_monitor_judge(const kc_monitor_t *m, kc_mon_verdict_t *v);

#endif
