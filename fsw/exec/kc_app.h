/* KinCal as a component. kc_app_step is its only entry: time and messages in, messages out; no clock,
 * file or socket is touched, and the same inputs give the same outputs to the byte. */
#ifndef KC_APP_H
#define KC_APP_H

#include <stdint.h>

#include "kc_auth.h"
#include "kc_estimate.h"
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

/* Field meanings: fsw/msg/ message of the same name. */
typedef struct {
    uint64_t t_us;
    int32_t seq, source, opcode, arg_i[4];
    uint64_t arg_u64;
    double arg_d[4];
    kc_auth_t auth;
} kc_cmd_t;
typedef struct {
    int32_t source, seq, opcode, status, event_id;
} kc_ack_t;
typedef struct {
    uint64_t t_us;
    int32_t source, kind;
    uint32_t total, offset, n;
    uint8_t data[KC_CHUNK_BYTES];
    kc_auth_t auth;
} kc_chunk_t;
typedef struct {
    int32_t seq;
    uint32_t n_joints;
    double q[KC_JOINT_MAX], speed_scale;
    uint8_t hold;
} kc_arm_cmd_t;
typedef struct {
    int32_t seq;
    double pan_rad, tilt_rad;
} kc_pantilt_cmd_t;

typedef struct {
    uint32_t n_cmd, n_chunk, n_det, n_rx_errors;
    kc_cmd_t cmd[KC_CMD_QUEUE_MAX];
    kc_chunk_t chunk[KC_CHUNK_QUEUE_MAX];
    kc_detection_t det[KC_DET_QUEUE_MAX];
    uint8_t has_arm, has_pantilt;
    kc_arm_state_t arm;
    kc_pantilt_state_t pantilt;
    /* answer of the edge to the store requests of the last step, if there were any: KC_OK when all of them are
     * done and read back; else that of the first failure and its kind, those after it were not done */
    uint8_t has_store_result;
    uint16_t store_kind;
    int32_t store_status;
} kc_in_t;

typedef struct {
    uint32_t pose;
    int32_t candidate, replicate;
    uint32_t n_joints;
    kc_arm_state_t arm;
    kc_obs_t obs;
    kc_detection_t det; /* det: averaged over n_frames */
    double pan_rad, tilt_rad;
    uint32_t n_frames;
    uint64_t t_us;
    uint32_t session;
    uint32_t crc[KC_TBL_COUNT];
} kc_meas_t;

typedef struct {
    uint32_t session, pose, n_goal;
    int32_t candidate, replicate;
    uint32_t servo_steps;
    int32_t acquisition;
    double acquisition_value, res_pos_m, res_rot_rad, f, gp_mean, gp_sigma, pred_pos_m, pred_rot_rad;
    uint32_t rank, n_free, dof;
    double chi2;
    int32_t est_status;
    double fit_pos_m, fit_rot_rad;
    double energy_j;
    double coef[KC_COEF_MAX];
} kc_progress_t;

typedef struct {
    uint32_t session, crc;
    int32_t verdict;
    uint32_t n_poses, n_outliers;
    kc_kin_t kin; /* what would become active; encode gives crc */
    uint8_t status[KC_COEF_MAX];
    uint64_t confounded[KC_COEF_MAX];
    double cov[KC_COEF_MAX * (KC_COEF_MAX + 1u) / 2u];
    uint32_t rank, n_free, dof;
    double chi2, noise_scale, p_fit, p_no_change, kkt, cond;
    double fit_pos_m, fit_rot_rad, before_pos_m, before_rot_rad, pred_pos_m, pred_rot_rad;
    uint32_t crc_kin_before;
} kc_proposal_t;

typedef struct {
    int32_t seq, state;
    uint32_t session, n_poses, n_poses_goal;
    int32_t candidate;
    uint32_t servo_steps;
    uint32_t n_meas, n_rejected, n_cmd_ok, n_cmd_refused, n_events, n_events_dropped;
    int32_t last_event_id;
    uint32_t n_rx_errors, crc[KC_TBL_COUNT];
    int32_t staged_kind;
    uint32_t staged_bytes;
    int32_t staged_state;
    int32_t boot_state, boot_pose;
    uint32_t boot_count, proposal_crc;
    double energy_j;
    int32_t mon_state, mon_joint; /* newest verdict of the monitor; joint from 1, 0 = none */
    uint32_t mon_suspects, mon_n_obs;
    double mon_bias, mon_sigma, mon_p;
} kc_hk_t;

/* What the edge must keep through power loss: done in order, up to the first failure, each one read back. Each
 * kind has two slots; the edge writes the older one (write new file, sync, rename) and numbers it, or nothing if
 * the newest holds the same already. A write that failed leaves the newest slot as it was. kind 1..7: a table image; KC_STORE_PROPOSAL: the KIN
 * image that waits for review; KC_STORE_PREV: the KIN image for rollback; KC_STORE_JOURNAL: a
 * kc_journal_t record. n = 0: delete. */
#define KC_STORE_PROPOSAL 16u
#define KC_STORE_PREV 17u
#define KC_STORE_JOURNAL 18u
#define KC_STORE_QUEUE_MAX 10u
#define KC_JOURNAL_BYTES 96u
#define KC_KIN_IMAGE_MAX 1280u
typedef struct {
    uint16_t kind;
    uint32_t n;
    const uint8_t *data; /* valid until the next step */
} kc_store_t;

typedef struct {
    uint32_t n_ack, n_event, n_store;
    kc_ack_t ack[KC_CMD_QUEUE_MAX + 1u]; /* also of a command that had to be stored */
    kc_events_t events;
    kc_store_t store[KC_STORE_QUEUE_MAX];
    uint8_t has_arm_cmd, has_pantilt_cmd, has_frame_request, has_hk, has_meas, has_progress, has_proposal,
        has_dump;
    kc_arm_cmd_t arm_cmd;
    kc_pantilt_cmd_t pantilt_cmd;
    int32_t frame_seq;
    kc_hk_t hk;
    kc_meas_t meas;
    kc_progress_t progress;
    kc_proposal_t proposal;
    kc_chunk_t dump;
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
 * PROPOSAL the one that the journal names. kind as in kc_store_t. KC_ERR_* : refused, offer the next. Order of
 * kinds: JOURNAL, 1..7, PREV, PROPOSAL. */
kc_status_t kc_app_load(kc_app_t *app, uint16_t kind, const uint8_t *data, uint32_t n);
/* All offered: records events for what is missing and for the state in which the last run ended; they come
 * out of the first step. */
void kc_app_boot(kc_app_t *app);
/* One tick. now_us: mission time, the clock that stamps messages. Where it stands still, steps back or steps
 * ahead, one tick counts as elapsed; time-outs go by elapsed time and see nothing of a step. */
void kc_app_step(kc_app_t *app, uint64_t now_us, const kc_in_t *in, kc_out_t *out);

/* For tests and the ground: the active tables. */
const kc_active_t *kc_app_active(const kc_app_t *app);
kc_state_t kc_app_state(const kc_app_t *app);

#endif
