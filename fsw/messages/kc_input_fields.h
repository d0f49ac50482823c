/* Names of the inputs and of their fields, as events number them. */
#ifndef KC_INPUT_FIELDS_H
#define KC_INPUT_FIELDS_H

#include <stdint.h>

#include "kc_limits.h"

/* Inputs as events KC_EVT_IN_* name them. */
typedef enum { KC_INPUT_ARM = 1, KC_INPUT_PANTILT = 2, KC_INPUT_DETECTION = 3 } kc_sensor_t;

/* Fields of the inputs, index of IN_RANGE: 100 x input + number. X(first, count, NAME, "name"): a field of
 * `count` elements takes as many numbers from `first` on. */
#define KC_INPUT_FIELD_LIST(X)                                                  \
    X(101, 1u, ARM_T, "arm t_us")                                               \
    X(110, KC_JOINT_MAX, ARM_Q, "arm q_rad")                                    \
    X(120, KC_JOINT_MAX, ARM_DQ, "arm dq_rad_s")                                \
    X(130, KC_JOINT_MAX, ARM_Q_CMD, "arm q_cmd_rad")                            \
    X(140, KC_JOINT_MAX, ARM_DIR, "arm dir")                                    \
    X(150, 1u, ARM_TEMP, "arm temp_c")                                          \
    X(151, 1u, ARM_PAYLOAD, "arm payload_kg")                                   \
    X(152, 3u, ARM_G, "arm g_m_s2")                                             \
    X(201, 1u, PANTILT_T, "pan-tilt t_us")                                      \
    X(202, 1u, PANTILT_PAN, "pan-tilt pan_rad")                                 \
    X(203, 1u, PANTILT_TILT, "pan-tilt tilt_rad")                               \
    X(301, 1u, DET_T, "detection t_us")                                         \
    X(302, 1u, DET_N_TAGS, "detection n_tags")                                  \
    X(303, 3u, DET_P, "detection p_cam_tool_m")                                 \
    X(306, 3u, DET_P_ALT, "detection p_alt_m")                                  \
    X(309, 1u, DET_RMS, "detection rms_px")                                     \
    X(310, 1u, DET_RMS_ALT, "detection rms_alt_px")                             \
    X(311, 1u, DET_RANGE, "detection range_m")                                  \
    X(312, 1u, DET_INCID, "detection incid_rad")                                \
    X(313, 1u, DET_U, "detection u_px")                                         \
    X(314, 1u, DET_V, "detection v_px")                                         \
    X(315, 1u, DET_COV_SHAPE, "detection cov, which is not positive definite,") \
    X(320, 8u * KC_TAG_MAX, DET_CORNER, "detection corner_px")                  \
    X(360, 36u, DET_COV, "detection cov")

#define KC_INPUT_FIELD_ENUM_(first, count, NAME, name) KC_FIELD_##NAME = (first),
typedef enum { KC_INPUT_FIELD_LIST(KC_INPUT_FIELD_ENUM_) } kc_field_t;

/* Name of a field as above, "" for none; never NULL. *element: which one, from 1; 0 if the field has one
 * only. */
const char *kc_input_field(int32_t index, uint32_t *element);

#endif
