/* Arm with corrections: forward kinematics, loads, Jacobian of every coefficient. */
#ifndef KC_MODEL_H
#define KC_MODEL_H

#include <stdbool.h>
#include <stdint.h>

#include "kc_terms.h"

/* One observation: joint readings and measured tool pose, in the base frame. */
typedef struct {
    kc_ctx_t ctx;
    double p_m[3];    /* measured tool position */
    double q_wxyz[4]; /* measured orientation, used if has_rot */
    double cov[36];         /* 6x6 row-major covariance of (p, rotation vector), base
                               frame; 3x3 top left used if !has_rot */
    double p_cam_m[3]; /* camera in the base frame, used if has_cam */
    double q_cam_wxyz[4];
    uint8_t has_rot, has_cam;
} kc_obs_t;

/* A line in space: both motions of a screw share it. */
typedef struct {
    double axis[3];    /* direction, of length 1 */
    double point_m[3]; /* one of its points */
} kc_line_t;

/* A motion along an axis and about it, with sine and cosine of its angle. */
typedef struct {
    double shift_m, angle_rad, sine, cosine;
} kc_screw_t;

/* Twists of all frames: sums of the correction terms. */
typedef struct {
    double of[KC_FRAME_COUNT][6];
} kc_twists_t;

/* Terms by number, in order. */
typedef struct {
    uint32_t n_listed;
    uint16_t listed[KC_TERM_MAX];
} kc_term_list_t;

/* What an arm, its terms and coefficients give for every pose: kc_model_fix makes it, nobody else writes it. It holds as
 * long as those three do not change. About 3 KiB; caller owns it. */
typedef struct {
    const kc_arm_t *arm;
    const kc_terms_t *terms; /* NULL: none, all poses are nominal */
    const double *coef; /* NULL: all zero */
    bool loads_count; /* a term depends on loads whose coefficient is enabled or not 0 */
    kc_pose_t base, tool; /* f_B and f_T of the arm */
    kc_twists_t tw; /* of the constant terms; 0 where others add to them */
    /* Screws of the twist at frame 0 .. n, by axis; of the link before the frame; and of both on their common x. Where the
     * twist is not constant, each pose has its own. */
    kc_screw_t twist[KC_JOINT_MAX + 1u][3], link[KC_JOINT_MAX + 1u], x[KC_JOINT_MAX + 1u];
    uint8_t varies[KC_FRAME_COUNT]; /* bit: component of the twist that is not constant */
    /* Terms that are not constant or add to such a component: on the arm, on the camera side, and those on the arm that
     * move it and do not depend on loads. */
    kc_term_list_t on_arm, on_camera, unloaded;
} kc_fixed_t;

/* Everything one pose gives: about 5 KiB; caller owns it. */
typedef struct {
    kc_pose_t T; /* tool in base, corrected */
    bool has_measured; /* what was measured is in measured_m and the lines: kc_model_residual with has_cam */
    double measured_m[3]; /* measured tool position, corrected */
    /* Screws of the twist at a frame, by axis, base frame: kc_model_twist makes derivatives of them. Of camera and
     * measurement the axes point the other way: d(model - measured). */
    kc_line_t line[KC_FRAME_COUNT][3];
    double Jq[KC_JOINT_MAX][6]; /* d pose / d q_j at fixed corrections
                                                 (their slope in q, e.g. an encoder
                                                 gain of 1 %, is left out) */
    double J[KC_COEF_MAX][6]; /* d pose / d coefficient */
} kc_eval_t;

/* Bound of the instructions of kc_model_needed_loads together with kc_model_eval (want_J as there), kc_model_residual
 * (want_J = 1), kc_model_miss or kc_model_frames (0), with the making of
 * one kc_fixed_t. coef: the coefficients, or those of them that are not enabled. */
uint64_t kc_model_cost(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, bool want_J);

/* For poses of the same coefficients (NULL: all zero; then terms may be NULL too, if no J is wanted). O(n + n_term).
 * What follows is kc_model_NAME of these coefficients, bit for bit: each of those makes a kc_fixed_t for itself. */
void kc_model_fix(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, kc_fixed_t *fixed);
void kc_fixed_loads(const kc_fixed_t *fixed, const kc_ctx_t *ctx, kc_loads_t *loads);
/* In work; or zeros that nobody has to write. */
const kc_loads_t *kc_fixed_needed_loads(const kc_fixed_t *fixed, const kc_ctx_t *ctx, kc_loads_t *work);
void kc_fixed_eval(const kc_fixed_t *fixed, const kc_ctx_t *ctx, const kc_loads_t *loads, bool want_J,
                   kc_eval_t *ev);
void kc_fixed_frames(const kc_fixed_t *fixed, const kc_ctx_t *ctx, const kc_loads_t *loads, kc_pose_t *frame,
                     double *along_m, double *across_m);
uint32_t kc_fixed_residual(const kc_fixed_t *fixed, const kc_obs_t *obs, const kc_loads_t *loads, double r[6],
                           kc_eval_t *ev);
uint32_t kc_fixed_miss(const kc_fixed_t *fixed, const kc_obs_t *obs, const kc_loads_t *loads, double r[6],
                       kc_eval_t *ev);

/* Gravity torques, moments and levers with the coefficients `coef` (NULL: all zero). Bases that
 * depend on loads count as zero here: loads are those of the chain without load-dependent
 * corrections, which differ at second order. */
void kc_model_loads(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, const kc_ctx_t *ctx,
                    kc_loads_t *loads);

/* The same where a term depends on them whose coefficient is enabled or not 0. Else they are zero, and cost nothing: no
 * pose depends on them, only J of what is not estimated. */
void kc_model_needed_loads(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef,
                           const kc_ctx_t *ctx, kc_loads_t *loads);

/* Corrected pose, joint Jacobian and coefficient Jacobian at fixed loads (the derivative
 * through the loads is second order and left out; Gauss-Newton re-evaluates them).
 * coef: n_coef values (NULL: all zero). want_J = 0 skips lines and J; with coef NULL too, terms may be NULL (here, in
 * kc_model_loads and in kc_model_needed_loads). O(n + n_term). */
void kc_model_eval(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, const kc_ctx_t *ctx,
                   const kc_loads_t *loads, bool want_J, kc_eval_t *ev);

/* d pose / d component comp of the twist at a frame: (dp; dtheta) in the base frame, rotation about the tool point.
 * Camera and meas frame: d(model - measured), zero without has_cam and after kc_model_eval. ev: as kc_model_eval with
 * want_J or kc_model_residual filled it. O(1). */
void kc_model_twist(const kc_eval_t *ev, uint32_t frame, uint32_t comp, double row[6]);

/* Frames of the bodies of the arm: frame[0] = the tool, frame[j] = what turns (or slides) with joint j, j
 * = 1 .. n_joints, on its axis before d, a and alpha of its link. along_m[j]: how far corrections moved it
 * along that axis; across_m[j]: how far they move what comes after its link along a; both 0 for j = 0. O(n
 * + n_term). */
void kc_model_frames(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, const kc_ctx_t *ctx,
                     const kc_loads_t *loads, kc_pose_t *frame, double *along_m, double *across_m);

/* Residual r = measured - model (kc_pose_residual) with camera-side corrections applied to
 * the measured pose, and J[c] = d(model - measured)/d coefficient c, so that
 * r(coef + x) ~ r - J'x. Camera-side terms need has_cam and are zero without it.
 * rows: 6, or 3 if !has_rot (the rotation part is then zero, and the meas frame has the orientation
 * of the model). Returns rows. */
uint32_t kc_model_residual(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef,
                           const kc_obs_t *obs, const kc_loads_t *loads, double r[6], kc_eval_t *ev);
/* The same without J and lines. */
uint32_t kc_model_miss(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, const kc_obs_t *obs,
                       const kc_loads_t *loads, double r[6], kc_eval_t *ev);

#endif
