/* Position-based visual servo: one step toward a goal pose from the pose the camera sees. */
#ifndef KC_SERVO_H
#define KC_SERVO_H

#include <stdint.h>

#include "kc_model.h"

typedef struct {
    double gain;             /* (0, 1]                                                */
    double damping;          /* of the least squares, > 0                             */
    double step_max;         /* largest joint step [rad or m]                         */
    double leash;            /* largest distance of any joint from its seed           */
    double tol_pos_m, tol_rot_rad;
    double margin;           /* from joint limits                                     */
} kc_servo_opt_t;

typedef enum { KC_SERVO_MOVE = 0, KC_SERVO_THERE = 1, KC_SERVO_STUCK = 2 } kc_servo_result_t;

/* seen: tool in the base frame as measured; goal: wanted. q: current encoder readings; q_seed: the
 * candidate's joints; out q_cmd. The Jacobian is that of the corrected model at q. MOVE: command q_cmd;
 * THERE: inside the tolerances, q_cmd = q; STUCK: limits or leash allow no useful step. */
kc_servo_result_t kc_servo_step(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef,
                                const kc_pose_t *seen, const kc_pose_t *goal, const double *q,
                                const double *q_seed, const kc_servo_opt_t *opt, double *q_cmd,
                                kc_eval_t *work);

#endif
