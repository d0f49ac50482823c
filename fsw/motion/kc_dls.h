/* Damped least squares with a box: the one step that IK and visual servo share. */
#ifndef KC_DLS_H
#define KC_DLS_H

#include <stdint.h>

#include "kc_model.h"

/* Rotation errors count as this arm length times the angle, so that metres and radians can be added. */
#define KC_DLS_LEN_M 0.3

/* Cost of a pose error e (m m m rad rad rad): |p|^2 + (len |r|)^2. */
double kc_dls_cost(const double e[6]);

/* Joint step dq that minimises  |W (e - J dq)|^2 + damping^2 |dq|^2  inside lo <= dq <= hi (lo <= 0 <=
 * hi), W = diag(1 1 1 len len len). Joints that would leave their box are put on its edge one after the
 * other, the worst first, and the rest solved again: at most n passes of O(n^3), deterministic. (Exact
 * unless a joint should come back off its edge; close enough for a step that is taken again.)
 * Jq: columns d pose / d q_j. KC_ERR_NUM, dq = 0, if something is not finite. */
kc_status_t kc_dls_step(const double Jq[][6], uint32_t n, const double e[6], double damping, const double *lo,
                        const double *hi, double *dq);

/* Cost that the linear model leaves after dq. */
double kc_dls_predicted(const double Jq[][6], uint32_t n, const double e[6], const double *dq);

/* Shorten dq to at most step_max in its largest joint; the direction stays. */
void kc_dls_limit(double *dq, uint32_t n, double step_max);

/* Corrected pose and joint Jacobian at encoder readings q, loads included; the rest of the context
 * (time, temperature ...) is zero. */
void kc_dls_eval(const kc_fixed_t *fixed, const double *q, kc_eval_t *work);

/* Interval of a joint step that stays `margin` inside the limits; always contains 0, so a joint that is
 * outside may only move inward. */
void kc_dls_box(const kc_joint_t *j, double margin, double q, double *lo, double *hi);

#endif
