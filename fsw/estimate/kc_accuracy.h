/* How far off a correction may be over many poses, at a confidence: the mean square of the error of the tool over them
 * is a weighted sum of chi-squares, since errors of neighbouring poses go together. From second moments of how what is
 * unknown moves the tool; METHOD.md 5.2. */
#ifndef KC_ACCURACY_H
#define KC_ACCURACY_H

#include "kc_consider.h"

#define KC_ACCURACY_MAX (KC_COEF_MAX + KC_CHAIN_COUNT)
#define KC_ACCURACY_PAIRS (KC_ACCURACY_MAX * (KC_ACCURACY_MAX + 1u) / 2u)

/* Sums over poses of products of motions of the tool: position, rotation. Lower triangle, row by row; the
 * coefficients, then the errors of the chain that are still unknown (unit variance). Caller owns it, 31 KiB. */
typedef struct {
    float pos[KC_ACCURACY_PAIRS], rot[KC_ACCURACY_PAIRS];
    uint32_t n_coef, n_poses;
} kc_accuracy_t;

void kc_accuracy_begin(kc_accuracy_t *a, const kc_est_t *est);
/* One pose: the model there, and what the chain does to the tool (kc_consider_motion). */
void kc_accuracy_add(kc_accuracy_t *a, const kc_eval_t *eval, double (*chain)[KC_CHAIN_COUNT]);
uint64_t kc_accuracy_add_cost(const kc_est_t *est); /* bound of its instructions */
/* Mean square over the poses, at least one, of what one unit of coefficient c moves the tool by. */
double kc_accuracy_square(const kc_accuracy_t *a, const float *sums, uint32_t c);

/* Degrees of freedom of the chi-square with the mean and variance of the mean square (Satterthwaite), between 1 and
 * KC_ACCURACY_MAX. sums: pos or rot; the covariance of the coefficients is that of est times scale^2; known: mean of
 * the errors of the chain (kc_consider_t.b_after). */
double kc_accuracy_dof(const kc_accuracy_t *a, const float *sums, const kc_est_t *est, double scale,
                       const double known[KC_CHAIN_COUNT]);
uint64_t kc_accuracy_dof_cost(const kc_est_t *est); /* bound of its instructions */
/* What the error, of this RMS, exceeds with probability 1 - confidence. Confidence 0: the RMS itself. */
double kc_accuracy_bound(double rms, double dof, double confidence);

#endif
