/* KinCal as a component. kc_app_step is its only entry: time and messages in, messages out; no clock,
 * file or socket is touched, and the same inputs give the same outputs to the byte. */
#ifndef KC_APP_H
#define KC_APP_H

#include <stdbool.h>
#include <stdint.h>

#include "kc_auth.h"
#include "kc_estimate.h"
#include "kc_fields.h"
#include "kc_sensors.h"
#include "kc_states.h"
#include "kc_tables.h"
#include "kc_verdict.h"

typedef enum {
    KC_CMD_NOOP = 0,
    KC_CMD_START = 1,
    KC_CMD_ABORT = 2,
    KC_CMD_APPROVE_ARM = 3,
    KC_CMD_APPROVE_GO = 4,
    KC_CMD_REJECT = 5,
    KC_CMD_ROLLBACK = 6,
    KC_CMD_TABLE_VALIDATE = 7,
    KC_CMD_TABLE_ACTIVATE = 8,
    KC_CMD_TABLE_DISCARD = 9,
    KC_CMD_TABLE_DUMP = 10
} kc_opcode_t;

/* arg_i[1] of APPROVE_ARM. FIT: although the fit is poor, or its verdict is not known. */
#define KC_OVERRIDE_NONE 0
#define KC_OVERRIDE_FIT 1

/* Who commands; sequence numbers are kept per source. */
typedef enum { KC_SRC_EXECUTIVE = 1, KC_SRC_GROUND = 2 } kc_source_t;
#define KC_SOURCE_MAX 2u

/* What may come signed. Each has counters of its own, so that their order within a step does not matter. */
typedef enum { KC_SIGNED_CMD = 0, KC_SIGNED_CHUNK = 1 } kc_signed_kind_t;
#define KC_SIGNED_COUNT 2u

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

/* ---- messages. Field meanings: fsw/msg, message of the same name ---- */

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
    F(uint32_t, n_frames)
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
    F(double, pred_camera_rot_rad) F(double, pred_lander_pos_m) F(double, pred_lander_rot_rad)
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
    F(double, mon_p) F(uint32_t, proposal_verdict) F(uint64_t, approval_left_us)
typedef struct {
    KC_HK_FIELDS(KC_FIELD_, KC_ARRAY_)
} kc_hk_t;
/* clang-format on */

/* ---- channels: what comes in and goes out, and by which name ----
 *
 * X(CHANNEL, member, message, copied): channel KC_CHANNEL, member of kc_in_t or kc_out_t, kc_message_t here and
 * kcm_message_t on the wire. copied: FIELDS, as KC_CHANNEL_FIELDS lists them; or OWN, by a function of kc_wire.c.
 * The member of a new channel has the channel's name.
 *
 * To flight. QUEUED(..., order, step, room): each one counts, at most `step` come in with a step and `room` wait.
 * order SEQ: by their field seq (others: kc_queue.c). NEWEST: the newest of a step counts. */
#define KC_IN_LIST(QUEUED, NEWEST)                                                   \
    QUEUED(CMD, cmd, cmd, OWN, TURN, KC_CMD_QUEUE_MAX, KC_Q_CMD)                     \
    QUEUED(TABLE_UP, chunk, table_chunk, OWN, PLACE, KC_CHUNK_QUEUE_MAX, KC_Q_CHUNK) \
    QUEUED(DETECTION, det, detection, OWN, SEQ, KC_DET_QUEUE_MAX, KC_Q_DET)          \
    NEWEST(ARM_STATE, arm, arm_state, OWN)                                           \
    NEWEST(PANTILT_STATE, pantilt, pantilt_state, OWN)

/* From flight, in the order in which they are published, after answers and events. */
#define KC_OUT_LIST(X)                                     \
    X(ARM_CMD, arm_cmd, arm_cmd, OWN)                      \
    X(PANTILT_CMD, pantilt_cmd, pantilt_cmd, FIELDS)       \
    X(FRAME_REQUEST, frame_request, frame_request, FIELDS) \
    X(MEAS, meas, meas, OWN)                               \
    X(PROGRESS, progress, progress, FIELDS)                \
    X(PROPOSAL, proposal, proposal, OWN)                   \
    X(TABLE_DOWN, table_down, table_chunk, OWN)            \
    X(HK, hk, hk, FIELDS)

#define KC_IN_COUNT_(CHANNEL, member, message, copied, order, step, room) uint32_t n_##member;
#define KC_IN_QUEUED_(CHANNEL, member, message, copied, order, step, room) kc_##message##_t member[step];
#define KC_IN_HAS_(CHANNEL, member, message, copied) uint8_t has_##member;
#define KC_IN_NEWEST_(CHANNEL, member, message, copied) kc_##message##_t member;
#define KC_IN_NONE_(...)
typedef struct {
    KC_IN_LIST(KC_IN_COUNT_, KC_IN_NONE_)
    uint32_t n_rx_errors;
    KC_IN_LIST(KC_IN_QUEUED_, KC_IN_NONE_)
    KC_IN_LIST(KC_IN_NONE_, KC_IN_HAS_)
    KC_IN_LIST(KC_IN_NONE_, KC_IN_NEWEST_)
    /* answer of the edge to the store requests of the last step, if there were any: KC_OK when all of them are
     * done and read back; else that of the first failure and its kind, those after it were not done */
    uint8_t has_store_result;
    uint16_t store_kind;
    int32_t store_status;
} kc_in_t;

/* What the edge must keep through power loss: done in order, up to the first failure, each one read back. Each
 * kind has two slots; the edge writes the older one (write new file, sync, rename) and numbers it, or nothing if
 * the newest holds the same already. A write that failed leaves the newest slot as it was. kind 1..7: a table image; KC_STORE_PROPOSAL: the KIN
 * image that waits for review; KC_STORE_PREV: the KIN image for rollback; KC_STORE_JOURNAL: a
 * kc_journal_t record. n = 0: delete. */
#define KC_STORE_PROPOSAL 16u
#define KC_STORE_PREV 17u
#define KC_STORE_JOURNAL 18u
#define KC_STORE_QUEUE_MAX 10u
#define KC_JOURNAL_BYTES 144u
#define KC_KIN_IMAGE_MAX 1280u
typedef struct {
    uint16_t kind;
    uint32_t n;
    const uint8_t *data; /* valid until the next step */
} kc_store_t;

#define KC_OUT_HAS_(CHANNEL, member, message, copied) uint8_t has_##member;
#define KC_OUT_MEMBER_(CHANNEL, member, message, copied) kc_##message##_t member;
typedef struct {
    uint32_t n_ack, n_store;
    kc_ack_t ack[KC_CMD_QUEUE_MAX + 1u]; /* also of a command that had to be stored */
    kc_events_t events;
    kc_store_t store[KC_STORE_QUEUE_MAX];
    KC_OUT_LIST(KC_OUT_HAS_)
    KC_OUT_LIST(KC_OUT_MEMBER_)
} kc_out_t;

/* The component's whole state; static, caller owns it, callers touch nothing inside. */
struct kc_app;
typedef struct kc_app kc_app_t;
extern kc_app_t kc_app_instance; /* the one instance of the flight process */

/* Start. Tables come next through kc_app_load, then kc_app_boot. */
void kc_app_init(kc_app_t *app);
/* The keys whose holders may command, before boot. Without them only what needs no signature is taken. */
void kc_app_keys(kc_app_t *app, const kc_keys_t *keys);
/* Offer a stored or default image before boot: the edge offers every image it finds, best first (newest
 * slot, older slot, default of the table directory); the first good one of each kind wins, of KIN, PREV and
 * PROPOSAL the one that the journal names. kind as in kc_store_t. n = 0: a copy that cannot be read, BOOT_SLOT_BAD.
 * KC_ERR_* : refused, offer the next. Order of kinds: JOURNAL, 1..7, PREV, PROPOSAL. */
kc_status_t kc_app_load(kc_app_t *app, uint16_t kind, const uint8_t *data, uint32_t n);
/* KC_IMAGE_MAX bytes into which the edge may read what it offers, until kc_app_boot: nothing is staged before. */
uint8_t *kc_app_image_room(kc_app_t *app);
/* All offered: records events for what is missing and for the state in which the last run ended; they come
 * out of the first step. */
void kc_app_boot(kc_app_t *app);
/* One tick. now_us: mission time, the clock that stamps messages. Where it stands still, steps back or steps
 * ahead, one tick counts as elapsed; time-outs go by elapsed time and see nothing of a step. */
void kc_app_step(kc_app_t *app, uint64_t now_us, const kc_in_t *in, kc_out_t *out);

/* Whether a step would take the signature of this message as things stand. For the edge: what a holder of a key sent
 * finds room that others cannot take. Nothing is taken or admitted by it. *macs: how many MACs may still be computed,
 * each of kc_auth_cost instructions, counted down; at 0 the answer is false. */
bool kc_app_vouches_cmd(const kc_app_t *app, const kc_cmd_t *c, uint32_t *macs);
bool kc_app_vouches_chunk(const kc_app_t *app, const kc_chunk_t *c, uint32_t *macs);

/* For tests and the ground: the active tables. */
const kc_active_t *kc_app_active(const kc_app_t *app);
kc_state_t kc_app_state(const kc_app_t *app);

#endif
