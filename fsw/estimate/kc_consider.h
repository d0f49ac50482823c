/* Consider parameters (Schmidt): errors of the camera chain that CAMERA states the size of and the estimator does
 * not know of. The estimate stays that of the poses alone; what the chain's errors do to it goes into covariance,
 * predicted error and probabilities.
 *
 * Whitened: r = J x + H c + noise, c ~ N(0, I) (columns of H are those of 1 sigma). With P = (J'J)^-1 the estimate
 * moves by S c, S = P J'H, so its covariance is P + S S'. The least chi-square over x and c is
 * r'r - b'(I + A)^-1 b with A = H'H - (J'H)'S, b = H'r: that of the data with covariance I + H H', by sums of one
 * column a parameter. In the order of kc_camera.h, the first n parameters alone are the leading blocks. What the
 * data say of c themselves has mean (I + A)^-1 b and covariance (I + A)^-1; the predicted error is by these: of an
 * error of the chain that shows in the residuals, as much as shows, of one that does not, as much as is stated.
 * METHOD.md 6.1. */
#ifndef KC_CONSIDER_H
#define KC_CONSIDER_H

#include "kc_camera.h"
#include "kc_estimate.h"

/* Caller owns it, about 27 KiB. */
typedef struct {
    double S[KC_COEF_MAX * KC_CHAIN_COUNT]; /* J'H while poses are added, then S; row: a coefficient */
    double HH[KC_CHAIN_COUNT * KC_CHAIN_COUNT]; /* H'H, then the Cholesky factor of I + H'H */
    double A[KC_CHAIN_COUNT * KC_CHAIN_COUNT];
    double
        L[KC_CHAIN_COUNT * KC_CHAIN_COUNT]; /* Cholesky factor of I + A, A over the variance of the noise */
    double b_before[KC_CHAIN_COUNT]; /* H'r with the table in force, then L^-1 of it */
    double b[KC_CHAIN_COUNT]; /* H'r with the estimate */
    double b_after[KC_CHAIN_COUNT]; /* L^-1 b */
    double JJ[KC_COEF_MAX]; /* diagonal of J'J: information on each coefficient, if the others are right */
    double visible[KC_COEF_MAX]; /* the same, the chain as unknown as stated; kc_consider_visible */
} kc_consider_t;

/* One pose of a sum: whitened residuals with the table in force and with the estimate, the whitener, model and
 * chain (kc_camera_chain) there. */
typedef struct {
    const double *before, *after; /* 6 */
    const double *W; /* 36 */
    const kc_eval_t *eval;
    double (*H)[6];
} kc_consider_pose_t;

void kc_consider_begin(kc_consider_t *c);
void kc_consider_add(kc_consider_t *c, const kc_est_t *est, const kc_consider_pose_t *pose);
uint64_t kc_consider_add_cost(const kc_est_t *est); /* bound of its instructions */
/* All poses are added, before the end: `visible`, the diagonal of J'(I + H H')^-1 J with the first n parameters of the
 * chain. */
void kc_consider_visible(kc_consider_t *c, const kc_est_t *est, uint32_t n);
/* All poses are added; est: solved, its covariance is used. */
void kc_consider_end(kc_consider_t *c, const kc_est_t *est);
#define KC_CONSIDER_END_COST 1500000u

/* What the first n parameters take off the chi-square of the poses: with the table in force, with the estimate.
 * After kc_consider_end. */
double kc_consider_explains_before(const kc_consider_t *c, uint32_t n);
double kc_consider_explains_after(const kc_consider_t *c, uint32_t n);
/* The noise is this many times as stated: c is known that much worse. After kc_consider_explains_after. */
void kc_consider_scale(kc_consider_t *c, double noise_scale);
/* Their part of the covariance of coefficients i and j. */
double kc_consider_cov(const kc_consider_t *c, uint32_t i, uint32_t j);
/* Mean squares that they add to the error of a predicted pose: position [m^2] and rotation [rad^2]. seen: against
 * where the camera sees it, the chain there; NULL: in the base frame. */
void kc_consider_pose(const kc_consider_t *c, const kc_est_t *est, const kc_eval_t *eval, double (*seen)[6],
                      double *pos2, double *rot2);
/* Motion of a predicted pose (dp [m], rotation vector [rad]) for one unit of each of what stays unknown of c: unit
 * covariance, mean b_after. */
void kc_consider_motion(const kc_consider_t *c, const kc_est_t *est, const kc_eval_t *eval, double (*seen)[6],
                        double move[6][KC_CHAIN_COUNT]);
uint64_t kc_consider_pose_cost(const kc_est_t *est);

#endif
