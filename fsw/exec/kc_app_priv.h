/* Inside of the component: its state and the functions that its files share. Nobody else includes this
 * but the unit tests of those files.
 *
 *   kc_app.c      the entry: start, load, boot, one step
 *   kc_input.c    inputs are checked here, or refused with an event
 *   kc_cmd.c      commands, acknowledgements, table chunks, dumps
 *   kc_move.c     MOVE, AIM, SETTLE: verified paths, pan-tilt unit, waiting for rest
 *   kc_observe.c     OBSERVE, SERVO, SEARCH: frames, planar flip, visual servo, spiral
 *   kc_approach.c the side from which every joint comes to a pose before it is measured
 *   kc_measure.c  MEASURE: frames averaged into one measurement
 *   kc_monitoring.c  IDLE: observations outside calibrations feed the miscalibration monitor
 *   kc_update.c   UPDATE: estimator, GP, choice of the next candidate
 *   kc_propose.c  proposal, verdict, approval, rollback
 *   kc_journal.c  what is kept through power loss
 *   kc_hk.c       housekeeping */
#ifndef KC_APP_PRIV_H
#define KC_APP_PRIV_H

#include "kc_app.h"
#include "kc_monitor.h"

#define KC_SILENT_US 2000000u /* longest silence of arm or pan-tilt unit while it matters */
#define KC_RESYNC_US 5000000u /* stale for longer than this: the sender was started again */
#define KC_TICK_US 100000u    /* what counts as elapsed where the clock stands still or steps */
#define KC_CLOCK_GAP_US 2000000u /* the clock moved on by more than this: it was set */
#define KC_CMD_WINDOW 1000000u    /* how far a command's number may be ahead of the last one */
#define KC_CMD_RESYNC_US 10000000u /* a source silent for longer may begin anew outside that window */
#define KC_RESEND_US 1000000u /* a command that the arm does not echo is sent again after this */
#define KC_HK_PERIOD_US 1000000u
#define KC_ARMED_US 600000000u  /* APPROVE_GO must follow APPROVE_ARM within ten minutes */
#define KC_PANTILT_TOL_RAD 0.01 /* pan-tilt unit within this of its target has arrived */
#define KC_ECHO_TOL 1e-6        /* joint difference up to which the arm echoes its target */
#define KC_CHAIN_MAX 4u         /* states that one step may pass through */
#define KC_PRED_MAX 256u        /* candidates used for the predicted uncertainty */
#define KC_RANGE_MIN_M 0.1      /* nearer than this the tool is not measured */
/* Share of a frame's error variance that all frames of a scene at rest have in common (pixel phase,
 * compression, half-hidden edges). */
#define KC_FRAME_SHARED 0.25
#define KC_FLIP_RMS_FACTOR 2.0    /* planar flip: largest RMS ratio of the second solution */
#define KC_FLIP_TRUST_RAD 0.5     /* and its largest distance from the model's prediction */
#define KC_POOR_NOISE_SCALE 3.0   /* noise this many times as stated: the fit is poor */
#define KC_POOR_NOISE_SCALE_P 2.0 /* and this many times, if the fit is less likely than ... */
#define KC_POOR_P_FIT 1e-9
#define KC_MONITORING_FRESH_US 500000u /* oldest readings that an observation is compared with */
#define KC_MONITORING_REPEAT_SIGMA 3.0 /* change of a bias that is reported again [sigma] */

/* Parts of UPDATE, one a step, so that no step has to do all the work. */
typedef enum {
    KC_UP_SELECT = 0, /* choose the next candidate or finish */
    KC_UP_ADD = 1,    /* residual before, observation in, first solution */
    KC_UP_WARM = 2,   /* second start if the first fit is not good */
    KC_UP_GP = 3,
    KC_UP_REPORT = 4, /* predicted uncertainty, progress */
    KC_UP_PROPOSE = 5
} kc_up_t;

/* One calibration. */
typedef struct {
    uint32_t session, n_goal, n_meas, n_rejected;
    uint32_t n_own; /* poses requested, local initial poses not counted */
    kc_acq_t acq;
    uint64_t rng, free_mask, start_us;
    double coef[KC_COEF_MAX]; /* latest correction, for aiming and for f */
    uint8_t usable[KC_CAND_MAX];
    uint16_t cand_of[KC_MEAS_MAX]; /* candidate of each measurement */
    uint8_t outlier_reported[KC_MEAS_MAX];
    uint32_t i_initial;           /* next initial pose */
    uint32_t n_tried, n_local;    /* local initial poses begun, measured */
    uint32_t n_rep, rep_at;       /* replicates done; n_meas when the last was chosen */
    int32_t candidate, replicate; /* current one, -1: none */
    uint32_t servo_steps;
    double acq_value;
    int32_t chosen_by;            /* kc_acq_t; -1 = initial pose or replicate */
    uint8_t gp_ok, stop, trusted; /* trusted: the estimate predicted the newest pose better */
    kc_up_t up;
    kc_status_t est_status;
    double range_m; /* camera to tool, last measurement */
    double res_pos_m, res_rot_rad, f, gp_mean, gp_sigma, pred_pos_m, pred_rot_rad;
} kc_cal_t;

/* Current move of the arm: verified waypoints, then the corrected joints inside the servo bound. */
typedef struct {
    uint32_t node; /* where the arm is or was last */
    uint16_t path[KC_PATH_MAX + 1u];
    uint32_t n_path, i_path;
    double q_target[KC_JOINT_MAX]; /* last arm command */
    double q_final[KC_JOINT_MAX];  /* joints at the candidate, after the waypoints */
    uint16_t seg_from, seg_to;     /* current verified segment, kept through an abort */
    uint64_t sent_us, start_us, rest_us;
    uint8_t resting;
    uint8_t approach;            /* phase, see kc_approach.c; 0: none */
    double q_meas[KC_JOINT_MAX]; /* joints at the measurement, after the approach */
} kc_leg_t;

/* Pan-tilt unit and frames. */
typedef struct {
    double pan_rad, tilt_rad; /* last pan-tilt command */
    double base_pan_rad, base_tilt_rad; /* middle of the search */
    double off_m[3];          /* measured minus predicted tool position, this candidate */
    uint64_t pantilt_us, requested_us;
    uint8_t pantilt_sent, waiting, got, unsure, after; /* after: state that follows SETTLE */
    uint8_t searched, turning;       /* searched: since the arm last moved */
    uint8_t detected_here, retreat;  /* tags detected at this candidate; returning there */
    uint8_t at_seed;                 /* the joints of the seed were tried */
    double q_detected[KC_JOINT_MAX]; /* joints at the last detection */
    uint32_t fails, i_search;
    int32_t frame_seq;
    kc_detection_t det;
    kc_pose_t measured, predicted; /* tool in base, camera corrections applied; model */
    kc_servo_mem_t servo;          /* of this candidate */
} kc_observe_t;

/* Frames of the current measurement. */
typedef struct {
    uint32_t n;
    kc_pose_t first;           /* camera-to-tool of the first frame */
    double dp_m[3], dw_rad[3]; /* sums of differences to the first frame */
    double cov[36], q[KC_JOINT_MAX], dq[KC_JOINT_MAX];
    double range_m, incid_rad, u_px, v_px, rms_px, rms_alt_px, pan_rad, tilt_rad;
    double corner_px[8u * KC_TAG_MAX];
    uint8_t same_tags;
    kc_detection_t det; /* of the first frame */
} kc_frames_t;

/* Normal operation. */
typedef struct {
    kc_monitor_t monitor;
    kc_mon_verdict_t reported;           /* last verdict that was reported */
    kc_mon_verdict_t newest;             /* verdict on the observations held */
    uint32_t crc[KC_TBL_COUNT], session; /* tables and calibration of the observations */
    uint64_t rest_us, t_us;              /* elapsed: at rest since; newest observation */
    uint8_t resting;
} kc_monitoring_t;

/* Content of the journal. */
typedef struct {
    uint32_t state, session, pose, boot_count, kin_crc, proposal_crc;
    int32_t candidate;
    uint16_t seg_from, seg_to;
    uint64_t t_us;
} kc_journal_t;

struct kc_app {
    kc_tables_t tables;
    union {
        kc_gp_t gp;               /* while a calibration runs */
        kc_tbl_scratch_t scratch; /* otherwise */
    } big;
    kc_est_t est;
    kc_eval_t eval;
    kc_point_t cand_pt[KC_CAND_MAX];
    double y[KC_MEAS_MAX], dp_m[KC_MEAS_MAX], dr_rad[KC_MEAS_MAX];

    kc_state_t state, reported_state;
    uint64_t now_us;   /* elapsed time: every time-out counts in it, and no stamp of a message */
    uint64_t clock_us; /* mission time of the newest step */
    uint64_t state_us, hk_us;
    uint8_t stepped, journal_due;

    kc_arm_state_t arm;
    kc_pantilt_state_t pantilt;
    uint8_t has_arm, has_pantilt;
    uint64_t arm_ok_us, pantilt_ok_us, arm_seen_us, pantilt_seen_us;
    int32_t fault_reported;

    kc_cal_t cal;
    double energy_j;    /* used since START */
    uint64_t energy_us; /* time up to which it is counted */
    kc_leg_t leg;
    kc_observe_t observe;
    kc_frames_t frames;
    kc_monitoring_t monitoring;

    kc_kin_t proposal_kin;
    uint8_t proposal_image[KC_KIN_IMAGE_MAX];
    uint32_t proposal_n, proposal_crc; /* 0: none */
    uint8_t kin_image[KC_KIN_IMAGE_MAX], prev_image[KC_KIN_IMAGE_MAX];

    int32_t cmd_seq[KC_SOURCE_MAX];
    uint8_t cmd_seen[KC_SOURCE_MAX];
    uint64_t cmd_us[KC_SOURCE_MAX]; /* elapsed time of the last number taken */
    kc_ack_t *ack; /* of the command being handled */

    uint16_t dump_kind;
    uint32_t dump_at, dump_crc; /* kind 0: no dump */
    uint32_t ev_mark;           /* events before the command being handled */

    int32_t arm_seq, pantilt_seq, hk_seq;
    kc_events_t boot_events;
    kc_journal_t journal;
    uint8_t journal_bytes[KC_JOURNAL_BYTES];
    int32_t boot_state, boot_pose;
    uint32_t boot_count, session, loaded; /* loaded: bit per kind of table */

    uint32_t n_meas, n_rejected, n_cmd_ok, n_cmd_refused, n_events, n_dropped, n_rx_errors;
    int32_t last_event_id;
};
_Static_assert(sizeof(struct kc_app) <= 880u * 1024u, "memory budget of the component");

/* kc_app.c */
void kc_app_enter(kc_app_t *app, kc_state_t state);
int kc_app_calibrating(const kc_app_t *app);
/* Elapsed time at which a message with this stamp was made, as far as clocks agree. */
uint64_t kc_app_elapsed(const kc_app_t *app, uint64_t stamp_us);
/* Hold the arm, record the cause, go to SAFE. A correction that waits for review is dropped. */
void kc_app_abort(kc_app_t *app, kc_out_t *out, kc_cause_t cause);

/* kc_input.c */
void kc_input_take(kc_app_t *app, const kc_in_t *in, kc_out_t *out);
void kc_input_check_silence(kc_app_t *app, kc_out_t *out);

/* kc_cmd.c */
void kc_cmd_take(kc_app_t *app, const kc_in_t *in, kc_out_t *out);
void kc_cmd_dump(kc_app_t *app, kc_out_t *out);
/* Raise an event and, while a command is handled, make it the reason in its answer. */
kc_status_t kc_cmd_refuse(kc_app_t *app, kc_out_t *out, kc_event_id_t id, int32_t index, double got,
                          double want, kc_status_t st);

/* kc_move.c */
double kc_move_dist(const kc_app_t *app, const double *q);
void kc_move_hold(kc_app_t *app, kc_out_t *out);
/* Every arm command but hold goes through here. The guard (kc_guard.h) checks it as a move along the verified
 * segment between two nodes, or within the bound of one node. 0: refused, with an event, and the candidate is
 * skipped (kc_observe_skip). */
int kc_move_send(kc_app_t *app, kc_out_t *out, uint32_t from, uint32_t to, const double *q);
/* The same, within the servo bound of the current candidate. */
int kc_move_near(kc_app_t *app, kc_out_t *out, const double *q);
int kc_move_arrived(const kc_app_t *app);
int kc_move_late(kc_app_t *app, kc_out_t *out);
/* Goal pose of the tool at a candidate. */
void kc_move_goal(const kc_app_t *app, uint32_t cand, kc_pose_t *T);
/* Joints that bring the corrected arm to the candidate, as far as the servo bound allows. Not reaching it
 * is no error: the servo continues from there, and a pose measured beside its candidate is as good. */
void kc_move_joints(kc_app_t *app, uint32_t cand, uint32_t iter_max, double *q);
/* Joint intervals at a candidate: limits with margin, and the servo bound around the seed. */
void kc_move_box(const kc_app_t *app, uint32_t cand, double *lo, double *hi);
/* Plan the path to the candidate (a replicate: over its hub, so that it is approached again) and start;
 * KC_ERR_PATH: nothing done. */
kc_status_t kc_move_begin(kc_app_t *app, kc_out_t *out, uint32_t cand);
/* Servo bound of each joint: the smaller one of SPACE and CONFIG. */
void kc_move_bound(const kc_app_t *app, double *bound);
/* Node within whose bound the arm is, or KC_NODE_NONE. dist: distance from the nearest node, in bounds. */
uint32_t kc_move_node(const kc_app_t *app, double *dist);
void kc_move_pantilt(kc_app_t *app, kc_out_t *out, double pan_rad, double tilt_rad);
int kc_move_pantilt_there(const kc_app_t *app);
void kc_move_settle(kc_app_t *app, kc_state_t after);
int kc_move_run(kc_app_t *app, kc_out_t *out);
int kc_move_aim(kc_app_t *app, kc_out_t *out);
int kc_move_settled(kc_app_t *app, kc_out_t *out);

/* kc_observe.c */
typedef enum {
    KC_OBSERVE_WAIT = 0,
    KC_OBSERVE_DETECTED = 1,
    KC_OBSERVE_NO_TAGS = 2, /* a frame without tags */
    KC_OBSERVE_UNCERTAIN = 3, /* too uncertain in spite of all retries */
    KC_OBSERVE_TIMEOUT = 4 /* no frame came */
} kc_observe_result_t;
/* Planar flip: either solution of a frame may be right. Puts the one first that is nearer to the
 * prediction with coefficients coef. */
void kc_observe_unflip(kc_app_t *app, const double *coef, kc_detection_t *det);
kc_observe_result_t kc_observe_poll(kc_app_t *app, kc_out_t *out);
void kc_observe_skip(kc_app_t *app, kc_out_t *out);
void kc_observe_begin(kc_app_t *app);
void kc_observe_obs(const kc_app_t *app, const double p_cam_m[3], const double q_cam[4],
                    const kc_detection_t *det, const kc_arm_state_t *arm, const kc_pantilt_state_t *pantilt,
                    kc_obs_t *obs);
int kc_observe_run(kc_app_t *app, kc_out_t *out);
int kc_observe_servo(kc_app_t *app, kc_out_t *out);
int kc_observe_search(kc_app_t *app, kc_out_t *out);

/* kc_approach.c */
/* Choose a side for every joint at random and move back to it; 0 and nothing done if CONFIG does not
 * enable it. */
int kc_approach_begin(kc_app_t *app, kc_out_t *out);
/* Call when the arm has arrived; 1 if that was part of an approach, whose next part begins. */
int kc_approach_arrived(kc_app_t *app, kc_out_t *out);

/* kc_measure.c */
void kc_measure_begin(kc_app_t *app);
/* Distance of a frame to the frames before it; 0 without any. */
void kc_measure_jump(const kc_app_t *app, const kc_detection_t *det, double *pos_m, double *rot_rad);
int kc_measure_run(kc_app_t *app, kc_out_t *out);

/* kc_monitoring.c */
/* Whether a detection that no calibration waits for is passed to the monitor. */
int kc_monitoring_wants(const kc_app_t *app);
/* Record since when arm and pan-tilt unit are at rest; call after every step's telemetry. */
void kc_monitoring_rest(kc_app_t *app);
/* Take a checked detection. It is not compared, with an event, unless arm and pan-tilt unit had settled
 * before. */
void kc_monitoring_observe(kc_app_t *app, kc_out_t *out, const kc_detection_t *d);

/* kc_update.c */
kc_status_t kc_update_start(kc_app_t *app, kc_out_t *out, kc_acq_t acq, uint32_t n_goal, uint32_t seed,
                            uint64_t free_mask);
int kc_update_run(kc_app_t *app, kc_out_t *out);
void kc_update_predict(kc_app_t *app);
/* Count energy. When time or energy is used up: stop moving and propose from what was measured. */
void kc_update_budget(kc_app_t *app, kc_out_t *out);
/* Input variables of the bases at candidate c, at rest. */
void kc_update_ctx(const kc_app_t *app, uint32_t c, kc_ctx_t *ctx);

/* kc_propose.c */
int kc_propose_run(kc_app_t *app, kc_out_t *out);
int kc_propose_expire(kc_app_t *app, kc_out_t *out);
kc_status_t kc_propose_load(kc_app_t *app, const uint8_t *image, uint32_t n);
kc_status_t kc_propose_arm(kc_app_t *app, kc_out_t *out, uint32_t crc);
kc_status_t kc_propose_go(kc_app_t *app, kc_out_t *out, uint32_t crc);
kc_status_t kc_propose_reject(kc_app_t *app, kc_out_t *out, uint32_t crc);
void kc_propose_drop(kc_app_t *app, kc_out_t *out);
kc_status_t kc_propose_rollback(kc_app_t *app, kc_out_t *out, uint32_t crc);

/* kc_journal.c */
void kc_journal_store(kc_out_t *out, uint16_t kind, const uint8_t *data, uint32_t n);
/* Store the active correction and the one before it; n = 0 deletes one that does not exist any more. */
void kc_journal_kin(kc_app_t *app, kc_out_t *out);
kc_status_t kc_journal_load(kc_app_t *app, const uint8_t *data, uint32_t n);
void kc_journal_note(kc_app_t *app, kc_out_t *out);

/* kc_hk.c */
void kc_hk_run(kc_app_t *app, kc_out_t *out);

#endif
