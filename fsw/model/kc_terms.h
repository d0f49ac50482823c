/* Correction terms: every physical effect as data (METHOD.md 9).
 *
 *   twist component c at frame f  +=  coefficient x basis x basis
 *
 * At frame i the corrections are applied as E_i = Tx Rx Ty Ry Rz Tz, right after the
 * frame:  T = f_B E_0 T_01 E_1 ... T_{n-1,n} E_n f_T E_tool. So delta_phi_i = rz and
 * delta_d_i = tz at frame i-1; delta_a_i = tx and delta_alpha_i = rx at frame i.
 * On the camera side  T_meas = T_base_cam E_camera T_cam_tool E_meas. */
#ifndef KC_TERMS_H
#define KC_TERMS_H

#include <stdbool.h>
#include <stdint.h>

#include "kc_arm.h"
#include "kc_limits.h"
#include "kc_variables.h"

typedef enum { KC_TX = 0, KC_TY = 1, KC_TZ = 2, KC_RX = 3, KC_RY = 4, KC_RZ = 5 } kc_comp_t;

/* basis = fn(z),  z = c1 (x - c0), clipped to +-1e12; for sine and cosine to +-KC_ANGLE_MAX, and |c0 c1| is
 * not beyond that. */
typedef enum {
    KC_FN_LIN = 0, /* z */
    KC_FN_SIN = 1,
    KC_FN_COS = 2,
    KC_FN_TANH = 3,
    KC_FN_LN1P = 4, /* ln(1 + max(z, 0)) */
    KC_FN_EXPN = 5, /* exp(-max(z, 0)) */
    KC_FN_STEP = 6, /* 1 for z >= 0, else 0 */
    KC_FN_SQ = 7,   /* z^2 */
    KC_FN_TAN2 = 8, /* tan^2 z, |z| clipped to 1.4 */
    KC_FN_ABS = 9,
    KC_FN_COUNT = 10
} kc_fn_t;

typedef struct {
    uint8_t fn;    /* kc_fn_t */
    uint8_t var;   /* kc_var_t; KC_VAR_ONE makes the basis 1 whatever fn is */
    uint8_t index; /* joint, link or KC_LEVER_INDEX; 0 where the variable has none */
    double c0, c1; /* offset and scale of the argument */
} kc_basis_t;

typedef struct {
    uint16_t coef; /* coefficient it belongs to */
    uint8_t frame; /* 0..n, KC_FRAME_TOOL, _CAMERA, _MEAS */
    uint8_t comp;  /* kc_comp_t */
    double gain;   /* constant factor (unit conversion, coupling sign) */
    kc_basis_t basis[2];
} kc_term_t;

typedef struct {
    char name[KC_NAME_LEN]; /* "J4.a_m", "joint_compliance[2]" */
    double lb, ub;          /* bounds of the total value */
    double prior_sigma;     /* 1-sigma of the prior about 0; 0 = flat */
    double scale;           /* typical size: column scaling of rank decisions, > 0 */
    uint8_t enabled;        /* 0: masked, stays at its table value */
} kc_coef_t;

typedef struct {
    uint32_t n_coef, n_term;
    kc_coef_t coef[KC_COEF_MAX];
    kc_term_t term[KC_TERM_MAX];
    uint32_t kinematics_crc; /* kc_arm_kinematics_crc of the arm they were made for, 0: any */
} kc_terms_t;

/* Input variables of the bases, for one pose. */
typedef struct {
    double q[KC_JOINT_MAX]; /* encoder readings [rad or m] */
    double dir[KC_JOINT_MAX];
    double qdot[KC_JOINT_MAX];
    double g_m_s2[3]; /* gravity in the base frame */
    double temp_c, t_s, payload_kg;
    double range_m, incid_rad, u_norm, v_norm, pan_rad, tilt_rad, tag;
    double p_cam_tool_m[3];
    double pnp[6][KC_PNP_MAX + 1u]; /* by component, then column; column 0 stays 0 */
    double move[KC_MOVE_MAX + 1u];  /* by joint, counted from 1; 0 stays 0 */
} kc_ctx_t;

/* What gravity does to the arm in one pose (the motors hold against it), evaluated on the chain
 * with the given coefficients. Payload is a point mass at the tool point. */
typedef struct {
    double tau[KC_JOINT_MAX];         /* torque about joint j, index j-1 [N m] */
    double tau_payload[KC_JOINT_MAX]; /* of payload_kg alone [N m] */
    double moment[KC_JOINT_MAX + 1u][3];  /* about the origin of frame i, in frame i, of
                                             everything beyond it: links i+1 .. n and
                                             payload [N m] */
    /* What gravity levers are made of; masses play no part. */
    double origin_m[KC_JOINT_MAX + 2u][3]; /* of frame 0 .. n, and of the tool at KC_FRAME_TOOL; base frame */
    double g_link_m_s2[KC_JOINT_MAX + 1u][3]; /* gravity in frame i */
    double g_cross_m_s2[KC_JOINT_MAX + 1u][3][3]; /* gravity x axis c of frame i, base frame */
} kc_loads_t;

/* Value of a basis; q etc. from ctx, torques and moments from loads. Always finite for
 * finite input. */
double kc_basis_eval(const kc_basis_t *b, const kc_ctx_t *ctx, const kc_loads_t *loads);
/* Whether the basis depends on gravity: torque, moment, lever or its direction in a frame. */
bool kc_basis_needs_loads(const kc_basis_t *b);

/* First problem found: KC_ERR_RANGE, *index = coefficient or KC_TERMS_INDEX_TERM + term, *got = value. */
#define KC_TERMS_INDEX_TERM 1000
kc_status_t kc_terms_validate(const kc_terms_t *t, uint32_t n_joints, int32_t *index, double *got);

/* The 4 n DH error coefficients (phi, alpha, a, d of joint 1, then joint 2 ...), names
 * "J1.phi_rad" "J1.alpha_rad" "J1.a_m" "J1.d_m", appended to t with the given bounds
 * (one each for phi, alpha, a, d). KC_ERR_FULL, t unchanged, if they do not fit. */
kc_status_t kc_terms_add_dh(kc_terms_t *t, uint32_t n_joints, const double bound[4]);

#endif
