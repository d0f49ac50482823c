#include "kc_arm.h"

#include "kc_check.h"
#include "kc_crc.h"
#include "kc_libm.h"
#include "kc_vec.h"

void kc_arm_link(const kc_joint_t *joint, double q, kc_pose_t *T)
{
    const double q_rot = joint->type == KC_REVOLUTE ? q : 0.0;
    const double q_lin = joint->type == KC_REVOLUTE ? 0.0 : q;
    kc_pose_screw(T, 2u, joint->d_m + q_lin, joint->phi_rad + q_rot);
    kc_pose_screw(T, 0u, joint->a_m, joint->alpha_rad);
}

void kc_arm_fk(const kc_arm_t *arm, const double *q, kc_pose_t *T_base_tool)
{
    kc_pose_t tool;
    kc_pose_from_quat(arm->base_xyz_m, arm->base_quat_wxyz, T_base_tool);
    for (uint32_t j = 0u; j < arm->n_joints; j++) { kc_arm_link(&arm->joint[j], q[j], T_base_tool); }
    kc_pose_from_quat(arm->tool_xyz_m, arm->tool_quat_wxyz, &tool);
    kc_pose_mul(T_base_tool, &tool, T_base_tool);
}

static uint32_t crc_of_number(uint32_t crc, double x)
{
    const uint32_t v = (uint32_t)(int32_t)kc_clamp(kc_floor(x * 1e6 + 0.5), -2e9, 2e9);
    const uint8_t bytes[4] = {(uint8_t)(v & 0xFFu), (uint8_t)(v >> 8u & 0xFFu), (uint8_t)(v >> 16u & 0xFFu),
                              (uint8_t)(v >> 24u)};
    return kc_crc32(crc, bytes, 4u);
}

uint32_t kc_arm_kinematics_crc(const kc_arm_t *arm)
{
    uint32_t crc = 0u;
    for (uint32_t j = 0u; j < arm->n_joints; j++) {
        const kc_joint_t *g = &arm->joint[j];
        crc = crc_of_number(crc, 1e-6 * (double)g->type);
        crc = crc_of_number(crc, g->phi_rad);
        crc = crc_of_number(crc, g->alpha_rad);
        crc = crc_of_number(crc, g->a_m);
        crc = crc_of_number(crc, g->d_m);
    }
    return crc != 0u ? crc : 1u; /* 0 says "any arm" where it is stored */
}

static void check_joint(kc_check_t *c, const kc_joint_t *j, int32_t index)
{
    kc_check(c, j->type <= KC_PRISMATIC, index, j->type);
    kc_check(c, j->has_mass <= 1u, index, j->has_mass);
    kc_check_finite(c, &j->phi_rad, 1u, index);
    kc_check_finite(c, &j->alpha_rad, 1u, index);
    kc_check_finite(c, &j->a_m, 1u, index);
    kc_check_finite(c, &j->d_m, 1u, index);
    kc_check_finite(c, &j->q_min, 1u, index);
    kc_check_finite(c, &j->q_max, 1u, index);
    kc_check(c, j->q_min < j->q_max, index, j->q_min);
    kc_check_positive(c, j->speed_max, index);
    kc_check_not_negative(c, j->mass_kg, index);
    kc_check_finite(c, j->com_m, 3u, index);
    kc_check_not_negative(c, j->gear_ratio, index);
}

kc_status_t kc_arm_validate(const kc_arm_t *arm, int32_t *index, double *got)
{
    kc_check_t c = kc_check_start();
    kc_check(&c, kc_name_ok(arm->name), -1, 0.0);
    kc_check(&c, arm->n_joints >= 1u && arm->n_joints <= KC_JOINT_MAX, -1, arm->n_joints);
    kc_check_frame(&c, arm->base_xyz_m, arm->base_quat_wxyz, -1);
    kc_check_frame(&c, arm->tool_xyz_m, arm->tool_quat_wxyz, -1);
    kc_check_finite(&c, arm->gravity_m_s2, 3u, -1);
    if (c.st == KC_OK) {
        for (uint32_t j = 0u; j < arm->n_joints; j++) { check_joint(&c, &arm->joint[j], (int32_t)j); }
    }
    return kc_check_end(&c, index, got);
}
