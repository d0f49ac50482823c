/* Position-based visual servo: one step toward a goal pose from the pose the camera sees. */
#ifndef KC_SERVO_H
#define KC_SERVO_H

#include <stdint.h>

#include "kc_model.h"

typedef struct {
    double gain;     /* (0, 1] */
    double damping;  /* of the least squares, > 0 */
    double step_max; /* largest joint step [rad or m] */
    double bound;    /* servo bound of every joint, on top of the SPACE table's */
    double tol_pos_m, tol_rot_rad;
    double margin; /* from joint limits */
} kc_servo_opt_t;

typedef enum { KC_SERVO_MOVE = 0, KC_SERVO_THERE = 1, KC_SERVO_STUCK = 2 } kc_servo_result_t;

/* What earlier steps at this candidate taught about the Jacobian. Errors of the last joints, like the
 * paper's 1.3 rad in joint 7, leave the axes in the base frame as they are. But when joint 1, 2 or 3 of the
 * WAM is 1.3 rad off, all axes beyond it turn with it and plain steps do not converge: 0, 0 and 1 % of the
 * reachable goals are reached. Broyden's update corrects the columns by the measured motion: 87, 76 and 98 %,
 * in 11 to 17 steps (tests/oracle/test_ik.py). */
typedef struct {
    uint8_t has_last;
    double q[KC_JOINT_MAX];    /* encoder readings of the observation before */
    kc_pose_t measured;        /* tool pose measured then */
    double B[KC_JOINT_MAX][6]; /* added to the model's d pose / d q_j */
} kc_servo_mem_t;

/* Start afresh: new candidate, other coefficients, or an observation that cannot be trusted. */
void kc_servo_forget(kc_servo_mem_t *mem);

/* One step. measured: tool in the base frame; goal: where it has to be; q: encoder readings; q_seed:
 * joints of the candidate; bound: largest distance of each joint from q_seed (opt->bound at most); out
 * q_cmd. The Jacobian is that of the corrected model at q, corrected by mem (NULL: not). MOVE: command
 * q_cmd. THERE: inside the tolerances, q_cmd = q. STUCK: limits or bound allow no useful step, or
 * something is not finite, q_cmd = q. An observation that the joints cannot have caused (the tool turned
 * more than they did) makes mem forget. O(n^3), deterministic. */
kc_servo_result_t kc_servo_step(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef,
                                const kc_pose_t *measured, const kc_pose_t *goal, const double *q,
                                const double *q_seed, const double *bound, const kc_servo_opt_t *opt,
                                double *q_cmd, kc_eval_t *work, kc_servo_mem_t *mem);

#endif
