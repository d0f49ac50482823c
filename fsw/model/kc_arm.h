/* A serial arm as a table: DH chain, base and tool frames, limits, masses.
 *
 * Standard (distal) DH, eq. 2:
 *   T_{i-1,i} = Rz(phi_i + q_i) Tz(d_i) Tx(a_i) Rx(alpha_i)   (prismatic: q adds to d)
 *   T(q)      = f_B T_01 ... T_{n-1,n} f_T
 */
#ifndef KC_ARM_H
#define KC_ARM_H

#include <stdint.h>

#include "kc_limits.h"
#include "kc_rot.h"

typedef enum { KC_REVOLUTE = 0, KC_PRISMATIC = 1 } kc_joint_type_t;

typedef struct {
    uint8_t type;     /* kc_joint_type_t */
    uint8_t has_mass; /* mass_kg and com_m are known */
    double phi_rad, alpha_rad, a_m, d_m;
    double q_min, q_max; /* [rad] or [m] */
    double speed_max;    /* [rad/s] or [m/s] */
    double mass_kg;      /* of link i */
    double com_m[3];     /* centre of mass in frame i */
    double gear_ratio;   /* motor turns per joint turn, 0 = unknown */
} kc_joint_t;

typedef struct {
    char name[KC_NAME_LEN];
    uint32_t n_joints; /* 1 .. KC_JOINT_MAX */
    kc_joint_t joint[KC_JOINT_MAX];
    double base_xyz_m[3], base_quat_wxyz[4]; /* f_B: frame 0 in the base frame */
    double tool_xyz_m[3], tool_quat_wxyz[4]; /* f_T: tool in the last link frame */
    double gravity_m_s2[3];                  /* in the base frame */
} kc_arm_t;

/* Nominal forward kinematics. q: n_joints values [rad or m]. Never fails for a
 * validated arm. O(n). */
void kc_arm_fk(const kc_arm_t *arm, const double *q, kc_pose_t *T_base_tool);

/* T <- T T_{i-1,i}(q), nominal: across one joint and its link. */
void kc_arm_link(const kc_joint_t *joint, double q, kc_pose_t *T);

/* What identifies the chain: CRC-32 over type, phi, alpha, a, d of each joint, rounded to 1e-6 and taken as
 * 32-bit little-endian integers of 1e-6. Limits, masses and frames do not enter. Never 0. O(n). */
uint32_t kc_arm_kinematics_crc(const kc_arm_t *arm);

/* First problem found, KC_ERR_RANGE with *index = joint (or -1), *got = the value:
 * counts, joint types, finite numbers, unit quaternions (1e-6), q_min < q_max, speed_max > 0,
 * masses and gear ratios >= 0. */
kc_status_t kc_arm_validate(const kc_arm_t *arm, int32_t *index, double *got);

#endif
