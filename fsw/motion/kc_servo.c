#include "kc_servo.h"

#include <stddef.h>
#include <string.h>

#include "kc_dls.h"
#include "kc_libm.h"
#include "kc_vec.h"

/* A step is useless if it removes less than this part of the squared error even by the model's own
 * prediction. */
#define USEFUL 0.02
/* After shorter moves the difference of two observations is mostly noise [rad or m]. */
#define LEARN_MIN 0.03
/* A model that explains this part of a move converges by itself, and faster than with a learned Jacobian. */
#define LEARN_SHARE 0.5
/* The tool cannot have turned more than all joints together, apart from encoder gains and noise. */
#define TURN_GAIN 1.1
#define TURN_NOISE_RAD 0.05

/* Interval of a joint step: limits with margin, and the servo bound around the candidate's seed, inside which
 * the arm was verified to be free of collisions. */
static void box_of(const kc_joint_t *joint, double margin, double bound, double q, double q_seed, double *lo,
                   double *hi)
{
    kc_dls_box(joint, margin, q, lo, hi);
    *lo = kc_max(*lo, kc_min(q_seed - bound - q, 0.0));
    *hi = kc_min(*hi, kc_max(q_seed + bound - q, 0.0));
}

void kc_servo_forget(kc_servo_mem_t *mem) { memset(mem, 0, sizeof *mem); }

/* Model's joint Jacobian at q plus what was learned, into work->Jq. */
static void jacobian(const kc_fixed_t *fixed, const double *q, const kc_servo_mem_t *mem, kc_eval_t *work)
{
    kc_dls_eval(fixed, q, work);
    if (mem == NULL) { return; }
    for (uint32_t j = 0u; j < fixed->arm->n_joints; j++) {
        for (uint32_t r = 0u; r < 6u; r++) { work->Jq[j][r] += mem->B[j][r]; }
    }
}

/* Broyden (1965), only where the model fails, and with its Jacobian halfway along the move:
 * B += (dx - (J + B) s) s' / s's. */
static void learn(const kc_fixed_t *fixed, const kc_pose_t *measured, const double *q, kc_servo_mem_t *mem,
                  kc_eval_t *work)
{
    const kc_arm_t *arm = fixed->arm;
    double s[KC_JOINT_MAX], mid[KC_JOINT_MAX], dx[6];
    double s2 = 0.0, turn = 0.0, moved;
    for (uint32_t j = 0u; j < arm->n_joints; j++) {
        s[j] = q[j] - mem->q[j];
        mid[j] = 0.5 * (q[j] + mem->q[j]);
        s2 += s[j] * s[j];
        turn += kc_fabs(s[j]);
    }
    kc_pose_residual(measured, &mem->measured, dx);
    if (kc_v3_norm(&dx[3]) > TURN_GAIN * turn + TURN_NOISE_RAD) {
        kc_servo_forget(mem);
        return;
    }
    if (s2 < LEARN_MIN * LEARN_MIN) { return; }
    moved = kc_dls_cost(dx);
    jacobian(fixed, mid, mem, work);
    for (uint32_t j = 0u; j < arm->n_joints; j++) {
        for (uint32_t r = 0u; r < 6u; r++) { dx[r] -= work->Jq[j][r] * s[j]; }
    }
    if (kc_dls_cost(dx) < LEARN_SHARE * LEARN_SHARE * moved) { return; }
    for (uint32_t j = 0u; j < arm->n_joints; j++) {
        for (uint32_t r = 0u; r < 6u; r++) { mem->B[j][r] += dx[r] * s[j] / s2; }
    }
}

static void remember(const kc_pose_t *measured, const double *q, uint32_t n, kc_servo_mem_t *mem)
{
    mem->has_last = 1u;
    mem->measured = *measured;
    memcpy(mem->q, q, n * sizeof *q);
}

kc_servo_result_t kc_servo_step(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef,
                                const kc_pose_t *measured, const kc_pose_t *goal, const double *q,
                                const double *q_seed, const double *bound, const kc_servo_opt_t *opt,
                                double *q_cmd, kc_eval_t *work, kc_servo_mem_t *mem)
{
    double e[6], lo[KC_JOINT_MAX], hi[KC_JOINT_MAX], dq[KC_JOINT_MAX];
    uint32_t n = arm->n_joints;
    kc_fixed_t fixed;
    kc_status_t st;
    memcpy(q_cmd, q, n * sizeof *q);
    kc_pose_residual(goal, measured, e);
    if (kc_v3_norm(e) <= opt->tol_pos_m && kc_v3_norm(&e[3]) <= opt->tol_rot_rad) { return KC_SERVO_THERE; }
    if (!kc_v_finite(e, 6u)) { return KC_SERVO_STUCK; }
    kc_model_fix(arm, terms, coef, &fixed);
    if (mem != NULL) {
        if (mem->has_last) { learn(&fixed, measured, q, mem, work); }
        remember(measured, q, n, mem);
    }
    jacobian(&fixed, q, mem, work);
    for (uint32_t j = 0u; j < n; j++) {
        box_of(&arm->joint[j], opt->margin, kc_min(opt->bound, bound[j]), q[j], q_seed[j], &lo[j], &hi[j]);
    }
    st = kc_dls_step(work->Jq, n, e, opt->damping, lo, hi, dq);
    if (st != KC_OK || kc_dls_predicted(work->Jq, n, e, dq) > (1.0 - USEFUL) * kc_dls_cost(e)) {
        return KC_SERVO_STUCK;
    }
    kc_dls_limit(dq, n, opt->step_max / opt->gain);
    for (uint32_t j = 0u; j < n; j++) { q_cmd[j] += opt->gain * dq[j]; }
    return KC_SERVO_MOVE;
}
