/* Observations of the 7-DOF WAM with known errors, for tests of what learns from them. The flight model
 * makes them, so these tests ask whether the estimator inverts it; tests/oracle ask whether both are
 * right. */
#ifndef GIVEN_OBSERVATIONS_H
#define GIVEN_OBSERVATIONS_H

#include "kc_estimate.h"

#define OBS_POS_M 0.5e-3
#define OBS_ROT_RAD 3.5e-3

/* Normal deviate, near enough (twelve uniform numbers), from a repeatable stream. */
double given_noise(uint64_t *rng);
/* Joints uniform within the arm's limits. */
void given_joints(const kc_arm_t *arm, uint64_t *rng, double *q);
/* One full-pose observation at joints q of the arm with errors `truth`, noise times `noise`. */
void given_one_observation(const kc_arm_t *arm, const kc_terms_t *terms, const double *truth, const double *q,
                           double noise, uint64_t *rng, kc_obs_t *obs);
/* The paper's four errors among the 28 DH coefficients. */
void given_paper_errors(double truth[KC_COEF_MAX]);
/* est: empty, all 28 DH coefficients requested, options as flown; then n observations of the paper's arm. */
void given_session(kc_est_t *est, const kc_arm_t *arm, const kc_terms_t *terms, const double *truth,
                   uint32_t n, double noise);

#endif
