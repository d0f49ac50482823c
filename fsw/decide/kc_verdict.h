/* What a finished calibration says about the arm, and whether its correction may be accepted on board. */
#ifndef KC_VERDICT_H
#define KC_VERDICT_H

#include <stdbool.h>

#include "kc_estimate.h"
#include "kc_tables.h"

typedef enum { KC_VERDICT_NO_CHANGE = 0, KC_VERDICT_CHANGE = 1, KC_VERDICT_POOR = 2 } kc_verdict_t;

/* Probability of so large an improvement of chi-square if the active table were right: in units of the noise
 * that the residuals show, against the number of determined coefficients. */
double kc_verdict_p_no_change(double chi2_gain, double noise_scale, uint32_t rank);

/* As many poses are rejected as the table allows: more may be bad, and took part in the fit. */
bool kc_verdict_all_rejected(const kc_est_t *est);

/* The newest observation is rejected: the arm or its camera may have changed since the others were taken. */
bool kc_verdict_newest_rejected(const kc_est_t *est);

/* How well the estimate explains the poses, the stated errors of the camera chain taken into account. */
typedef struct {
    double noise_scale; /* of the residuals that the chain does not explain */
    double p_fit, p_no_change;
} kc_verdict_fit_t;

/* POOR: the estimator did not finish, too many poses or the newest one were rejected, or the residuals are beyond what
 * the stated noise and camera chain can explain, also without as many poses as may be rejected. Noise somewhat larger
 * than stated is no reason: sigma is scaled by it. */
kc_verdict_t kc_verdict(const kc_config_t *config, const kc_est_t *est, kc_status_t status,
                        const kc_verdict_fit_t *fit, bool tested_early);

/* Level of a test of the table in force. Where one test is made before the end, it and the test at the end have half
 * of no_change_p each, so that both together reject a right table with probability no_change_p at most (Bonferroni). */
double kc_verdict_level(const kc_config_t *config, bool tested_early);

/* What the policy of CONFIG looks at. */
typedef struct {
    bool determined; /* every requested coefficient was */
    bool bounds_active; /* of any coefficient */
    bool all_rejected; /* kc_verdict_all_rejected */
    double p_fit, sigma_pos_m;
    double change_pos_m; /* RMS change of the predicted tool position over the search space */
} kc_verdict_case_t;

/* Small, well determined, nothing odd about it: the table may allow to take it without the ground. */
bool kc_verdict_acceptable(const kc_config_t *config, const kc_verdict_case_t *proposed);

#endif
