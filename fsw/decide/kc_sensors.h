/* What arm, pan-tilt unit and tag detector report. Field meanings: fsw/msg, message of the same name. */
#ifndef KC_SENSORS_H
#define KC_SENSORS_H

#include <stdint.h>

#include "kc_limits.h"

typedef struct {
    uint64_t t_us;
    int32_t seq;
    uint32_t n_joints;
    double q[KC_JOINT_MAX], dq[KC_JOINT_MAX], q_cmd[KC_JOINT_MAX], dir[KC_JOINT_MAX];
    uint8_t moving;
    int32_t fault_mask;
    double temp_c, payload_kg, g_m_s2[3];
} kc_arm_state_t;
typedef struct {
    uint64_t t_us;
    int32_t seq;
    double pan_rad, tilt_rad;
    uint8_t moving;
} kc_pantilt_state_t;
typedef struct {
    uint64_t t_us;
    int32_t seq;
    uint32_t n_tags;
    int32_t tag_id[KC_TAG_MAX];
    double p_cam_tool_m[3], q_cam_tool_wxyz[4], cov[36];
    double p_alt_m[3], q_alt_wxyz[4], rms_px, rms_alt_px;
    double range_m, incid_rad, u_px, v_px, corner_px[8u * KC_TAG_MAX];
} kc_detection_t;

#endif
