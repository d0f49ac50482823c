/* What arm, pan-tilt unit and tag detector report. Field meanings: fsw/msg, message of the same name. */
#ifndef KC_SENSORS_H
#define KC_SENSORS_H

#include <stdint.h>

#include "kc_fields.h"
#include "kc_limits.h"

/* clang-format off */
#define KC_ARM_STATE_FIELDS(F, A)                                             \
    F(uint64_t, t_us) F(int32_t, seq) F(uint32_t, n_joints) F(double, temp_c) \
    F(double, payload_kg) A(double, g_m_s2, 3)
typedef struct {
    KC_ARM_STATE_FIELDS(KC_FIELD_, KC_ARRAY_)
    double q[KC_JOINT_MAX], dq[KC_JOINT_MAX], q_cmd[KC_JOINT_MAX], dir[KC_JOINT_MAX];
    uint8_t moving;
    int32_t fault_mask;
} kc_arm_state_t;

#define KC_PANTILT_STATE_FIELDS(F, A)                                        \
    F(uint64_t, t_us) F(int32_t, seq) F(double, pan_rad) F(double, tilt_rad)
typedef struct {
    KC_PANTILT_STATE_FIELDS(KC_FIELD_, KC_ARRAY_)
    uint8_t moving;
} kc_pantilt_state_t;

#define KC_DETECTION_FIELDS(F, A)                                                             \
    F(uint64_t, t_us) F(int32_t, seq) F(uint32_t, n_tags) A(int32_t, tag_id, KC_TAG_MAX)      \
    A(double, p_cam_tool_m, 3) A(double, q_cam_tool_wxyz, 4) A(double, p_alt_m, 3)            \
    A(double, q_alt_wxyz, 4) F(double, rms_px) F(double, rms_alt_px) F(double, range_m)       \
    F(double, incid_rad) F(double, u_px) F(double, v_px) A(double, corner_px, 8 * KC_TAG_MAX)
typedef struct {
    KC_DETECTION_FIELDS(KC_FIELD_, KC_ARRAY_)
    double cov[36];
} kc_detection_t;
/* clang-format on */

#endif
