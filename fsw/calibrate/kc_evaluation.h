/* What a correction is worth, the stated errors of the camera chain taken into account: statistics of the observations
 * and the error that is predicted over the search space. REPORT decides by it whether it is good enough; PROPOSE states
 * it. */
#ifndef KC_EVALUATION_H
#define KC_EVALUATION_H

#include "kc_accuracy.h"
#include "kc_channels.h"
#include "kc_verdict.h"
#include "kc_view.h"

/* Its memory, where the choice of candidates has its own (kc_choice.h, kc_arena.h): 58 KiB. */
typedef struct {
    kc_consider_t chain;
    kc_accuracy_t error;
} kc_evaluation_t;

/* Sums over observations and candidates; where they stand between two steps. */
typedef struct {
    uint32_t i_obs, i_cand, i_bound; /* next ones */
    uint32_t n; /* inliers summed */
    bool considered; /* the sums over observations are evaluated */
    double pos2, rot2; /* squared residuals with the table in force [m^2], [rad^2] */
    double chi2_before, chi2_after;
    double change2; /* squared changes of the tool position [m^2] */
    double camera_pos2, camera_rot2, lander_pos2, lander_rot2; /* squared errors by the camera chain */
    double chi2; /* of the data, what the camera chain explains taken off */
    kc_verdict_fit_t fit; /* the same */
    kc_residual_t noise; /* RMS over the search space, of the noise alone */
    kc_residual_t predicted; /* and with the chain, in the frame of CONFIG */
    kc_residual_t bound; /* what that error exceeds with probability 1 - stop_confidence */
    kc_residual_t chain; /* the same of the chain alone: no more poses reduce it */
} kc_evaluated_t;

void kc_evaluation_begin(kc_evaluated_t *evaluated, kc_evaluation_t *evaluation, const kc_view_t *view);
/* False: goes on in the next step. */
bool kc_evaluation_run(kc_evaluated_t *evaluated, kc_evaluation_t *evaluation, const kc_view_t *view,
                       kc_work_t *work);

/* RMS over the search space of noise and a sum of squares. */
double kc_evaluation_rms(const kc_evaluated_t *evaluated, const kc_view_t *view, double noise, double sum2);
double kc_evaluation_change_m(const kc_evaluated_t *evaluated, const kc_view_t *view);
/* Values of the coefficients as they are proposed: those that were not estimated keep those of the table in force. */
bool kc_evaluation_estimated(uint8_t status); /* kc_coef_status_t */
void kc_evaluation_values(const kc_view_t *view, double *value);

/* Probability that a test of the active table at this level shows an error of any one coefficient that puts the tool
 * off by what CONFIG requires, RMS over the search space: the least of all coefficients. with_chain: the camera chain as
 * unknown as stated; else by the noise alone, what more poses can improve. After kc_evaluation_run, with
 * all that is requested determined (kc_fit_determined). */
double kc_evaluation_power(const kc_evaluated_t *evaluated, const kc_evaluation_t *evaluation,
                           const kc_view_t *view, double level, bool with_chain);

#endif
