#include "given_small_arm.h"

#include <string.h>

void given_small_arm(kc_arm_t *arm)
{
    memset(arm, 0, sizeof *arm);
    memcpy(arm->name, "test arm", 8);
    arm->n_joints = 3u;
    for (uint32_t j = 0u; j < 3u; j++) {
        kc_joint_t *joint = &arm->joint[j];
        joint->type = (j == 1u) ? KC_PRISMATIC : KC_REVOLUTE;
        joint->has_mass = 1u;
        joint->phi_rad = 0.1 + 0.2 * j;
        joint->alpha_rad = 0.8 - 0.5 * j;
        joint->a_m = 0.3 + 0.1 * j;
        joint->d_m = 0.2 - 0.1 * j;
        joint->q_min = -2.0;
        joint->q_max = 2.0;
        joint->speed_max = 0.8;
        joint->mass_kg = 1.0 + j;
        joint->com_m[0] = -0.1;
        joint->com_m[2] = 0.05 * j;
    }
    arm->base_xyz_m[2] = 0.35;
    arm->base_quat_wxyz[0] = 0.8;
    arm->base_quat_wxyz[1] = 0.6;
    arm->tool_xyz_m[2] = 0.1;
    arm->tool_quat_wxyz[0] = 0.6;
    arm->tool_quat_wxyz[3] = -0.8;
    arm->gravity_m_s2[2] = -9.81;
}
