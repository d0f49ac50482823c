/* Inside of the component: its state and the functions that its files share. Nobody else includes this
 * but the unit tests of those files.
 *
 *   kc_app.c      the door: start, load, boot, one step
 *   kc_input.c    what comes from outside is checked here, or refused with an event
 *   kc_cmd.c      commands, acknowledgements, table chunks, dumps
 *   kc_move.c     MOVE, AIM, SETTLE: proven paths, head, waiting for rest
 *   kc_look.c     LOOK, SERVO, SEARCH: frames, planar flip, visual servo, spiral
 *   kc_approach.c the side from which every joint comes to a pose before it is measured
 *   kc_measure.c  MEASURE: frames averaged into one measurement
 *   kc_watch.c    IDLE: looks that nobody here asked for feed the miscalibration monitor
 *   kc_update.c   UPDATE: estimator, GP, choice of the next candidate
 *   kc_propose.c  proposal, verdict, approval, rollback
 *   kc_journal.c  what survives power loss
 *   kc_hk.c       housekeeping */
#ifndef KC_APP_PRIV_H
#define KC_APP_PRIV_H

#include "kc_app.h"
#include "kc_monitor.h"

#define KC_SILENT_US 2000000u       /* arm or head telemetry may be missing so long while it matters   */
#define KC_RESYNC_US 5000000u       /* refused as stale for so long: its sender was started again      */
#define KC_RESEND_US 1000000u       /* a command that the arm does not echo is sent again after this   */
#define KC_HK_PERIOD_US 1000000u
#define KC_ARMED_US 600000000u      /* APPROVE_GO must follow APPROVE_ARM within ten minutes           */
#define KC_HEAD_TOL_RAD 0.01        /* head that is so near has arrived                                */
#define KC_ECHO_TOL 1e-6            /* arm repeats its target: joint difference that is the same       */
#define KC_CHAIN_MAX 4u             /* states that one step may pass through                           */
#define KC_PRED_MAX 256u            /* candidates looked at for the predicted uncertainty              */
#define KC_RANGE_MIN_M 0.1          /* nearer than this the tool is not measured                      */
#define KC_FRAME_SHARED \
    0.25        /* share of a frame's error variance that every frame of a resting
                                       scene repeats (pixel phase, compression, half-hidden edges)    */
#define KC_FLIP_RMS_FACTOR 2.0      /* planar flip: second solution taken seriously up to this RMS     */
#define KC_FLIP_TRUST_RAD 0.5       /* and only if it is so near to the model's prediction             */
#define KC_POOR_NOISE_SCALE 3.0     /* noise so much larger than stated: the model does not fit        */
#define KC_POOR_NOISE_SCALE_P 2.0   /* and this, if the fit is as unlikely as ...                      */
#define KC_POOR_P_FIT 1e-9
#define KC_WATCH_FRESH_US 500000u   /* a look is only compared with readings no older than this        */
#define KC_WATCH_AGAIN 3.0          /* a finding is told again when its bias moved by so many sigma    */

/* Steps of UPDATE, one a tick, so that no tick has to do all the work. */
typedef enum {
    KC_UP_SELECT = 0,   /* choose the next candidate or finish             */
    KC_UP_ADD = 1,      /* residual before, observation in, first solution */
    KC_UP_WARM = 2,     /* second start, if the first fit is not good      */
    KC_UP_GP = 3,
    KC_UP_REPORT = 4,   /* predicted uncertainty, progress                 */
    KC_UP_PROPOSE = 5
} kc_up_t;

/* One calibration. */
typedef struct {
    uint32_t session, n_goal, n_meas, n_rejected;
    uint32_t n_own;                     /* asked for beside the first looks                  */
    kc_acq_t acq;
    uint64_t rng, free_mask, start_us;
    double coef[KC_COEF_MAX];           /* latest correction, used to aim and to judge f     */
    uint8_t usable[KC_CAND_MAX];
    uint16_t cand_of[KC_MEAS_MAX];      /* candidate of each measurement                     */
    uint8_t outlier_told[KC_MEAS_MAX];
    uint32_t i_prior;                   /* next prior pose                                   */
    uint32_t n_tried, n_first;          /* first looks begun; those that were measured       */
    uint32_t n_rep, rep_at;             /* replicates done; n_meas when the last was chosen  */
    int32_t candidate, replicate;       /* the one under way, -1 = none                      */
    uint32_t servo_steps;
    double acq_value;
    int32_t chosen_by;                  /* kc_acq_t; -1 = prior pose or replicate          */
    uint8_t gp_ok, stop, trusted;       /* trusted: the estimate told the newest pose better */
    kc_up_t up;
    kc_status_t est_status;
    double range_m;                     /* camera to tool, last measurement                  */
    double res_pos_m, res_rot_rad, f, gp_mean, gp_sigma, pred_pos_m, pred_rot_rad;
} kc_cal_t;

/* Arm under way: proven way points, then the corrected joints inside the leash. */
typedef struct {
    uint32_t node;                      /* where the arm stands or last stood                */
    uint16_t way[KC_PATH_MAX + 1u];
    uint32_t n_way, i_way;
    double q_target[KC_JOINT_MAX];      /* last arm command                                  */
    double q_final[KC_JOINT_MAX];       /* joints for the candidate, after the way points    */
    uint16_t seg_from, seg_to;          /* proven segment under way, kept through an abort   */
    uint64_t sent_us, start_us, rest_us;
    uint8_t resting;
    uint8_t approach;                   /* kc_approach.c: 0, 1 drawing back, 2 coming        */
    double q_meas[KC_JOINT_MAX];        /* joints to be measured at, from the side drawn     */
} kc_leg_t;

/* Head and frames. */
typedef struct {
    double pan_rad, tilt_rad;           /* last head command                                 */
    double base_pan_rad, base_tilt_rad; /* middle of the search                              */
    double off_m[3];                    /* seen minus predicted tool position, this candidate */
    uint64_t head_us, asked_us;
    uint8_t head_sent, waiting, got, unsure, after; /* after: state that follows SETTLE       */
    uint8_t searched, turning;          /* searched: since the arm last moved                */
    uint8_t seen_here, retreat;         /* tags seen at this candidate; going back to there  */
    uint8_t at_seed;                    /* the seed's own joints were tried                  */
    double q_seen[KC_JOINT_MAX];        /* joints at which they were last seen               */
    uint32_t fails, i_search;
    int32_t frame_seq;
    kc_detection_t det;
    kc_pose_t seen, predicted;          /* tool in base, camera corrections applied; model   */
    kc_servo_mem_t servo;               /* what the servo learned at this candidate          */
} kc_look_t;

/* Frames of the measurement under way. */
typedef struct {
    uint32_t n;
    kc_pose_t first;                    /* camera-to-tool of the first frame                 */
    double dp_m[3], dw_rad[3];          /* sums of differences to the first frame            */
    double cov[36], q[KC_JOINT_MAX], dq[KC_JOINT_MAX];
    double range_m, incid_rad, u_px, v_px, rms_px, rms_alt_px, pan_rad, tilt_rad;
    double corner_px[8u * KC_TAG_MAX];
    uint8_t same_tags;
    kc_detection_t det;                 /* of the first frame                                */
} kc_frames_t;

/* Normal operation. */
typedef struct {
    kc_monitor_t monitor;
    kc_mon_verdict_t told;              /* last finding that was told                        */
    kc_mon_verdict_t newest;            /* what the looks held say                           */
    uint32_t crc[KC_TBL_COUNT], session; /* tables and calibration that the looks belong to   */
    uint64_t rest_us, t_us;             /* arm and head stand since; newest look             */
    uint8_t resting;
} kc_watch_t;

/* What the journal keeps. */
typedef struct {
    uint32_t state, session, pose, boot_count, kin_crc, proposal_crc;
    int32_t candidate;
    uint16_t seg_from, seg_to;
    uint64_t t_us;
} kc_journal_t;

struct kc_app {
    kc_tables_t tables;
    union {
        kc_gp_t gp;                     /* while a calibration runs                          */
        kc_tbl_scratch_t scratch;       /* otherwise                                         */
    } big;
    kc_est_t est;
    kc_eval_t eval;
    kc_point_t cand_pt[KC_CAND_MAX];
    double y[KC_MEAS_MAX], dp_m[KC_MEAS_MAX], dr_rad[KC_MEAS_MAX];

    kc_state_t state, told_state;
    uint64_t now_us, state_us, hk_us;
    uint8_t stepped, journal_due;

    kc_arm_state_t arm;
    kc_pantilt_state_t head;
    uint8_t has_arm, has_head;
    uint64_t arm_ok_us, head_ok_us, arm_seen_us, head_seen_us;
    int32_t fault_told;

    kc_cal_t cal;
    double energy_j;                    /* used since START                                  */
    uint64_t energy_us;                 /* time up to which it is counted                    */
    kc_leg_t leg;
    kc_look_t look;
    kc_frames_t frames;
    kc_watch_t watch;

    kc_kin_t proposal_kin;
    uint8_t proposal_image[KC_KIN_IMAGE_MAX];
    uint32_t proposal_n, proposal_crc;  /* 0 = none waits                                    */
    uint8_t kin_image[KC_KIN_IMAGE_MAX], prev_image[KC_KIN_IMAGE_MAX];

    int32_t cmd_seq[KC_SOURCE_MAX];
    uint8_t cmd_seen[KC_SOURCE_MAX];
    kc_ack_t *ack;                      /* of the command being handled                      */

    uint16_t dump_kind;
    uint32_t dump_at, dump_crc;         /* kind 0 = no dump under way                        */
    uint32_t ev_mark;                   /* events before the command being handled           */

    int32_t arm_seq, head_seq, hk_seq;
    kc_events_t boot_events;
    kc_journal_t journal;
    uint8_t journal_bytes[KC_JOURNAL_BYTES];
    int32_t boot_state, boot_pose;
    uint32_t boot_count, session, loaded; /* loaded: bit per kind of table                   */

    uint32_t n_meas, n_rejected, n_cmd_ok, n_cmd_refused, n_events, n_dropped, n_rx_errors;
    int32_t last_event_id;
};
_Static_assert(sizeof(struct kc_app) <= 880u * 1024u, "memory budget of the component");

/* kc_app.c */
void kc_app_enter(kc_app_t *app, kc_state_t state);
int kc_app_calibrating(const kc_app_t *app);
/* Hold the arm, say why, go to SAFE. A correction that waits is dropped. */
void kc_app_abort(kc_app_t *app, kc_out_t *out, kc_cause_t cause);

/* kc_input.c */
void kc_input_take(kc_app_t *app, const kc_in_t *in, kc_out_t *out);
void kc_input_watch(kc_app_t *app, kc_out_t *out);

/* kc_cmd.c */
void kc_cmd_take(kc_app_t *app, const kc_in_t *in, kc_out_t *out);
void kc_cmd_dump(kc_app_t *app, kc_out_t *out);
/* Raise an event and, while a command is handled, make it the reason in its answer. */
kc_status_t kc_cmd_refuse(kc_app_t *app, kc_out_t *out, kc_event_id_t id, int32_t index, double got,
                          double want, kc_status_t st);

/* kc_move.c */
double kc_move_dist(const kc_app_t *app, const double *q);
void kc_move_hold(kc_app_t *app, kc_out_t *out);
/* The door for every arm command but hold: the guard looks at it (kc_guard.h), as a move along the proven
 * segment between two nodes, or within one node's box. 0: refused, with an event, and the candidate given up
 * (kc_look_skip). */
int kc_move_send(kc_app_t *app, kc_out_t *out, uint32_t from, uint32_t to, const double *q);
/* The same, within the box of the candidate under way. */
int kc_move_near(kc_app_t *app, kc_out_t *out, const double *q);
int kc_move_arrived(const kc_app_t *app);
int kc_move_late(kc_app_t *app, kc_out_t *out);
/* Wanted tool pose of a candidate. */
void kc_move_goal(const kc_app_t *app, uint32_t cand, kc_pose_t *T);
/* Joints that bring the corrected arm to the candidate, as far as the leash lets them. Not reaching it is
 * no error: the servo goes on from there, and a pose measured beside its candidate is still a pose. */
void kc_move_joints(kc_app_t *app, uint32_t cand, uint32_t iter_max, double *q);
/* Where the joints may go at a candidate: limits with margin, and the box around the seed proven safe. */
void kc_move_box(const kc_app_t *app, uint32_t cand, double *lo, double *hi);
/* Plan the way to the candidate (a replicate: over its hub, so that it is reached anew) and start;
 * KC_ERR_PATH: nothing done. */
kc_status_t kc_move_begin(kc_app_t *app, kc_out_t *out, uint32_t cand);
/* What each joint may be off its seed: as far as was proven, and no farther than CONFIG allows. */
void kc_move_leash(const kc_app_t *app, double *leash);
/* Node the arm stands at, inside its leash; KC_NODE_NONE otherwise. dist: from the nearest one, in leashes. */
uint32_t kc_move_node(const kc_app_t *app, double *dist);
void kc_move_head(kc_app_t *app, kc_out_t *out, double pan_rad, double tilt_rad);
int kc_move_head_there(const kc_app_t *app);
void kc_move_settle(kc_app_t *app, kc_state_t after);
int kc_move_run(kc_app_t *app, kc_out_t *out);
int kc_move_aim(kc_app_t *app, kc_out_t *out);
int kc_move_settled(kc_app_t *app, kc_out_t *out);

/* kc_look.c */
typedef enum {
    KC_LOOK_WAIT = 0,
    KC_LOOK_SEEN = 1,
    KC_LOOK_NONE = 2, /* a frame without tags           */
    KC_LOOK_UNSURE = 3, /* too uncertain, again and again */
    KC_LOOK_LATE = 4 /* no frame came                  */
} kc_look_result_t;
/* Planar flip: both solutions of a frame may be right. Puts the one first that the arm with coefficients
 * coef makes likely. */
void kc_look_unflip(kc_app_t *app, const double *coef, kc_detection_t *det);
kc_look_result_t kc_look_poll(kc_app_t *app, kc_out_t *out);
void kc_look_skip(kc_app_t *app, kc_out_t *out);
void kc_look_begin(kc_app_t *app);
void kc_look_obs(const kc_app_t *app, const double p_cam_m[3], const double q_cam[4],
                 const kc_detection_t *det, const kc_arm_state_t *arm, const kc_pantilt_state_t *head,
                 kc_obs_t *obs);
int kc_look_run(kc_app_t *app, kc_out_t *out);
int kc_look_servo(kc_app_t *app, kc_out_t *out);
int kc_look_search(kc_app_t *app, kc_out_t *out);

/* kc_approach.c */
/* Draw a side for every joint and draw back to it; 0 and nothing done if the table does not ask for it. */
int kc_approach_begin(kc_app_t *app, kc_out_t *out);
/* The arm has arrived; 1 if it did so for an approach, whose next part begins. */
int kc_approach_arrived(kc_app_t *app, kc_out_t *out);

/* kc_measure.c */
void kc_measure_begin(kc_app_t *app);
/* Distance of a frame to the frames before it; 0 without any. */
void kc_measure_jump(const kc_app_t *app, const kc_detection_t *det, double *pos_m, double *rot_rad);
int kc_measure_run(kc_app_t *app, kc_out_t *out);

/* kc_watch.c */
/* Whether a detection that no calibration waits for goes to the monitor. */
int kc_watch_wants(const kc_app_t *app);
/* Note since when arm and head stand, after every step's telemetry. */
void kc_watch_rest(kc_app_t *app);
/* A checked detection. Not compared, with an event, unless arm and head had settled when it was taken. */
void kc_watch_look(kc_app_t *app, kc_out_t *out, const kc_detection_t *d);

/* kc_update.c */
kc_status_t kc_update_start(kc_app_t *app, kc_out_t *out, kc_acq_t acq, uint32_t n_goal, uint32_t seed,
                            uint64_t free_mask);
int kc_update_run(kc_app_t *app, kc_out_t *out);
void kc_update_predict(kc_app_t *app);
/* Count energy; time or energy used up: stop moving and propose what there is. */
void kc_update_budget(kc_app_t *app, kc_out_t *out);
/* What the bases see at candidate c, standing still. */
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
/* The correction in force and the one before it; n = 0 for one that is gone. */
void kc_journal_kin(kc_app_t *app, kc_out_t *out);
kc_status_t kc_journal_load(kc_app_t *app, const uint8_t *data, uint32_t n);
void kc_journal_note(kc_app_t *app, kc_out_t *out);

/* kc_hk.c */
void kc_hk_run(kc_app_t *app, kc_out_t *out);

#endif
