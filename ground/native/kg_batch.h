/* The flight model at many poses in one call, for the ground's tools. Compiled into the ground's build of
 * the core only; every number comes from fsw/model, so that a fit on the ground and one on board agree.
 *
 * Arrays are row-major and dense, n poses each; a pose is 12 doubles, position [m] then rotation matrix, as
 * kc_pose_t. Pointers to results may be NULL: not wanted. Nothing is kept between calls. */
#ifndef KG_BATCH_H
#define KG_BATCH_H

#include <stdbool.h>
#include <stdint.h>

#include "kc_model.h"

/* Frames of an arm as results have them: 0 .. n_joints, then tool, camera, measurement. */
#define KG_FRAMES(n_joints) ((n_joints) + 4u)

/* Where the sensor sees the tool is found by iteration; it stops when no coordinate moves by more [m]. */
#define KG_VIEW_TOL_M 1e-13
#define KG_VIEW_PASS_MAX 20u

/* Observations as the terms shall see them at the coefficients: gravity loads, and in ctx of `held` where the
 * model expects the tool in the sensor frame (the measured place would carry the noise of the residual into
 * the columns, and a wrong scale could shrink the residual itself). `held`: n copies of `obs` with
 * p_cam_tool_m set, and with u_norm, v_norm set from it unless keep_image. Fixed point within KG_VIEW_TOL_M,
 * or the last of KG_VIEW_PASS_MAX passes. One pass is exact when no term looks at the view. */
void kg_hold(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, uint32_t n,
             const kc_obs_t *obs, bool keep_image, kc_obs_t *held, kc_loads_t *loads);

/* Residuals and derivatives at the coefficients, base frame, loads and view as held. rows: 6, or 3 for
 * positions alone.
 *   r      n x rows                     measured - model
 *   J      n x rows x n_coef            d(model - measured) / d coefficient
 *   twist  n x KG_FRAMES x 6 x rows     the same by frame and component
 *   Jq     n x rows x n_joints          d pose / d joint */
void kg_evaluate(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, uint32_t n, uint32_t rows,
                 const kc_obs_t *held, const kc_loads_t *loads, double *r, double *J, double *twist,
                 double *Jq);

/* r alone, n x rows: the same to rounding, in half the time. A fit that tries steps asks for no more. */
void kg_residuals(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, uint32_t n, uint32_t rows,
                  const kc_obs_t *held, const kc_loads_t *loads, double *r);

/* The corrected tool in the base frame, n poses, and d pose / d coefficient, n x 6 x n_coef; nothing measured
 * plays a part. */
void kg_poses(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, uint32_t n,
              const kc_obs_t *held, const kc_loads_t *loads, kc_pose_t *pose, double *J);

/* Values of one basis, n of them. */
void kg_basis(const kc_basis_t *basis, uint32_t n, const kc_obs_t *held, const kc_loads_t *loads,
              double *out);

/* Nominal chain at joint vectors q, n x n_joints: frame 0 on the base, frame i at the end of link i, then the
 * tool: n x (n_joints + 2) poses. */
void kg_frames(const kc_arm_t *arm, uint32_t n, const double *q, kc_pose_t *frames);

#endif
