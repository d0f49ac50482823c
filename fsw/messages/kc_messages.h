/* Messages to and from flight as plain structs. Field meanings: fsw/msg, message of the same name. What arm, pan-tilt unit
 * and tag detector report: kc_sensors.h. */
#ifndef KC_MESSAGES_H
#define KC_MESSAGES_H

#include <stdint.h>

#include "kc_auth.h"
#include "kc_estimate.h"
#include "kc_fields.h"
#include "kc_sensors.h"
#include "kc_tables.h"

/* clang-format off */
#define KC_CMD_FIELDS(F, A)                                                    \
    F(uint64_t, t_us) F(int32_t, seq) F(int32_t, source) F(int32_t, opcode)    \
    A(int32_t, arg_i, 4) F(uint64_t, arg_u64) A(double, arg_d, 4)
typedef struct {
    KC_CMD_FIELDS(KC_FIELD_, KC_ARRAY_)
    kc_auth_t auth;
    uint8_t stopped; /* not sent: an ABORT waited with it, and may have been taken in an earlier step */
} kc_cmd_t;

#define KC_ACK_FIELDS(F, A)                                                  \
    F(int32_t, source) F(int32_t, seq) F(int32_t, opcode) F(int32_t, status) \
    F(int32_t, event_id)
typedef struct {
    KC_ACK_FIELDS(KC_FIELD_, KC_ARRAY_)
} kc_ack_t;

#define KC_TABLE_CHUNK_FIELDS(F, A)                                                      \
    F(int32_t, source) F(int32_t, kind) F(uint32_t, offset) F(uint32_t, n)               \
    A(uint8_t, data, KC_CHUNK_BYTES)
typedef struct {
    KC_TABLE_CHUNK_FIELDS(KC_FIELD_, KC_ARRAY_)
    uint64_t t_us; /* of a chunk to flight */
    uint32_t total;
    kc_auth_t auth;
} kc_chunk_t;
typedef kc_chunk_t kc_table_chunk_t; /* by its name as a message */

#define KC_ARM_CMD_FIELDS(F, A)                                                   \
    F(int32_t, seq) F(uint32_t, n_joints) F(double, speed_scale) F(uint8_t, hold)
typedef struct {
    KC_ARM_CMD_FIELDS(KC_FIELD_, KC_ARRAY_)
    double q[KC_JOINT_MAX];
} kc_arm_cmd_t;

#define KC_PANTILT_CMD_FIELDS(F, A) F(int32_t, seq) F(double, pan_rad) F(double, tilt_rad)
typedef struct {
    KC_PANTILT_CMD_FIELDS(KC_FIELD_, KC_ARRAY_)
} kc_pantilt_cmd_t;

#define KC_FRAME_REQUEST_FIELDS(F, A) F(int32_t, seq)
typedef struct {
    KC_FRAME_REQUEST_FIELDS(KC_FIELD_, KC_ARRAY_)
} kc_frame_request_t;

#define KC_MEAS_FIELDS(F, A)                                                           \
    F(uint64_t, t_us) F(uint32_t, session) F(uint32_t, pose) F(int32_t, candidate)     \
    F(int32_t, replicate) F(uint32_t, n_joints) F(double, pan_rad) F(double, tilt_rad) \
    F(uint32_t, n_frames) F(uint32_t, observation) F(int32_t, taken_at)
typedef struct {
    KC_MEAS_FIELDS(KC_FIELD_, KC_ARRAY_)
    kc_arm_state_t arm;
    kc_obs_t obs;
    kc_detection_t det; /* averaged over n_frames */
    uint32_t crc[KC_TBL_COUNT];
} kc_meas_t;

#define KC_PROGRESS_FIELDS(F, A)                                                           \
    F(uint32_t, session) F(uint32_t, pose) F(uint32_t, n_goal) F(int32_t, candidate)       \
    F(int32_t, replicate) F(uint32_t, servo_steps) F(int32_t, acquisition)                 \
    F(double, acquisition_value) F(double, res_pos_m) F(double, res_rot_rad) F(double, f)  \
    F(double, gp_mean) F(double, gp_sigma) F(double, pred_pos_m) F(double, pred_rot_rad)   \
    F(uint32_t, rank) F(uint32_t, n_free) F(uint32_t, dof) F(double, chi2)                 \
    F(int32_t, est_status) F(double, fit_pos_m) F(double, fit_rot_rad) F(double, energy_j) \
    A(double, coef, KC_COEF_MAX)
typedef struct {
    KC_PROGRESS_FIELDS(KC_FIELD_, KC_ARRAY_)
} kc_progress_t;

#define KC_PROPOSAL_FIELDS(F, A)                                                                 \
    F(uint32_t, session) F(uint32_t, crc) F(int32_t, verdict) F(uint32_t, n_poses)               \
    F(uint32_t, n_outliers) A(uint8_t, status, KC_COEF_MAX) A(uint64_t, confounded, KC_COEF_MAX) \
    A(double, cov, KC_COEF_MAX * (KC_COEF_MAX + 1u) / 2u) F(uint32_t, rank) F(uint32_t, n_free)  \
    F(uint32_t, dof) F(double, chi2) F(double, noise_scale) F(double, p_fit)                     \
    F(double, p_no_change) F(double, kkt) F(double, cond) F(double, fit_pos_m)                   \
    F(double, fit_rot_rad) F(double, before_pos_m) F(double, before_rot_rad)                     \
    F(double, pred_pos_m) F(double, pred_rot_rad) F(uint32_t, crc_kin_before) F(uint8_t, frame) \
    F(double, pred_noise_pos_m) F(double, pred_noise_rot_rad) F(double, pred_camera_pos_m)       \
    F(double, pred_camera_rot_rad) F(double, pred_lander_pos_m) F(double, pred_lander_rot_rad) \
    F(uint8_t, ended) F(uint32_t, n_checked) F(double, confidence) F(double, bound_pos_m)        \
    F(double, bound_rot_rad)
typedef struct {
    KC_PROPOSAL_FIELDS(KC_FIELD_, KC_ARRAY_)
    kc_kin_t kin; /* what would become active; encode gives crc */
} kc_proposal_t;

/* mon_*: newest verdict of the monitor; mon_joint from 1, 0 = none. n_tx_errors: filled in by the edge. */
#define KC_HK_FIELDS(F, A)                                                                       \
    F(int32_t, seq) F(int32_t, state) F(uint32_t, session) F(uint32_t, n_poses)                  \
    F(uint32_t, n_poses_goal) F(int32_t, candidate) F(uint32_t, servo_steps) F(uint32_t, n_meas) \
    F(uint32_t, n_rejected) F(uint32_t, n_cmd_ok) F(uint32_t, n_cmd_refused)                     \
    F(uint32_t, n_events) F(uint32_t, n_events_dropped) F(int32_t, last_event_id)                \
    F(int32_t, n_tx_errors) F(uint32_t, n_rx_errors) A(uint32_t, table_crc, KC_TBL_COUNT)        \
    F(int32_t, staged_kind) F(uint32_t, staged_bytes) F(int32_t, staged_state)                   \
    F(int32_t, boot_state) F(int32_t, boot_pose) F(uint32_t, boot_count)                         \
    F(uint32_t, proposal_crc) F(double, energy_j) F(int32_t, mon_state) F(int32_t, mon_joint)    \
    F(uint32_t, mon_suspects) F(uint32_t, mon_n_obs) F(double, mon_bias) F(double, mon_sigma)    \
    F(double, mon_p) F(uint32_t, proposal_verdict) F(uint64_t, approval_left_us)                 \
    A(double, mon_chance, KC_JOINT_MAX)                                                          \
    F(uint32_t, armed_key) F(int32_t, go_by_other_key) F(uint32_t, kin_prev_crc)
typedef struct {
    KC_HK_FIELDS(KC_FIELD_, KC_ARRAY_)
} kc_hk_t;
/* clang-format on */

#endif
