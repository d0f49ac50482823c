/* The CONFIG table: how a calibration is run. Plain data, every field validated. */
#ifndef KC_CONFIG_H
#define KC_CONFIG_H

#include <stdint.h>

#include "kc_codec.h"
#include "kc_estimate.h"
#include "kc_servo.h"

/* Where a correction has to be right. camera: the tool goes where the camera sees its target, so an error of the
 * camera's place counts as far as arm and camera disagree. lander: to places of the base frame that the camera is
 * not asked for, and it counts in full (METHOD.md 6.1). */
typedef enum { KC_RIGHT_IN_CAMERA = 0, KC_RIGHT_IN_LANDER = 1 } kc_right_in_t;

/* How the initial poses are chosen: in the order of SPACE, all of them; or by information, as many as are needed. */
typedef enum { KC_INITIAL_TABLE = 0, KC_INITIAL_INFORMATION = 1 } kc_initial_t;

/* What `rate` counts as the cost of a pose. */
typedef enum { KC_COST_TIME = 0, KC_COST_ENERGY = 1 } kc_cost_t;

typedef struct {
    /* design */
    uint8_t acquisition; /* kc_acq_t */
    uint32_t n_poses; /* poses of a calibration, 1..KC_MEAS_MAX */
    uint32_t replicate_every; /* poses between two replicates, 0: none */
    double beta_scale, a1; /* eq. 7 scale; position weight of eq. 6 */
    double sp_floor_m, sq_floor_rad;
    double vopt_len_m;
    double stop_pos_m, stop_rot_rad; /* required accuracy over the search space: stop there, 0 = off */
    /* observing */
    uint32_t frames_per_meas; /* 1..16 */
    uint32_t frame_retries;
    uint64_t settle_us, frame_timeout_us, move_timeout_us, frame_age_max_us;
    uint32_t search_steps; /* pan-tilt search positions around the expected place, 0..49 */
    double search_step_rad;
    double jump_pos_m, jump_rot_rad; /* largest difference between frames of a measurement */
    double sigma_pos_max_m, sigma_rot_max_rad; /* refuse a detection that is less certain */
    double sigma_pos_min_m, sigma_rot_min_rad; /* floor of the stated sigma */
    double rms_max_px;
    /* moving */
    kc_servo_opt_t servo;
    uint32_t servo_steps_max;
    double speed_scale;
    double arrive_tol; /* joint distance that counts as arrived [rad or m] */
    double approach_rad; /* length of the approach, the last motion before a measurement, from a
                                     random side of every joint [rad or m]; 0: no approach */
    /* estimating */
    kc_est_opt_t est;
    /* policy: which corrections may be accepted on board without the ground */
    uint8_t accept_on_board;
    double accept_change_max_pos_m; /* RMS change of predicted pose over the search space */
    double accept_sigma_max_pos_m;
    double accept_p_fit_min;
    uint8_t frame; /* kc_right_in_t: where a correction has to be right */
    double no_change_p; /* no change is proposed above this probability */
    uint64_t budget_us; /* 0 = none */
    double power_idle_w, power_move_w; /* power at rest, and while arm or pan-tilt unit move */
    double energy_budget_j; /* 0 = none */
    /* model mismatch: largest residual of an observation with the best correction inside its bounds. Above
     * it the arm is not one that the paths were verified for; 0: not checked */
    double mismatch_pos_m, mismatch_rot_rad;
    /* thresholds of decisions (fsw/decide) */
    double flip_rms_ratio; /* planar flip: largest RMS of the second pose over that of the first */
    double flip_trust_rad; /* and its largest angle to the prediction */
    double frame_shared; /* share of the error variance that the frames of a measurement have in common */
    double search_safety; /* factor of the last residual up to which the next pose may be off */
    uint32_t poses_min; /* fewest poses besides the local initial poses */
    uint32_t tags_tried_min; /* local initial poses after which a tag must have been detected */
    double second_start_noise_scale; /* a fit with a larger noise scale gets a second start */
    double mismatch_noise_scale; /* noise scale of local initial poses that is a mismatch ... */
    uint32_t mismatch_dof_min; /* ... with at least these degrees of freedom */
    uint32_t mismatch_outliers_min; /* this many outliers among them are not bad detections */
    double poor_noise_scale; /* noise this many times as stated: the fit is poor */
    double poor_noise_scale_unlikely; /* and this many times, if the fit is less likely than ... */
    double poor_p_fit;
    uint32_t store_retries; /* what could not be stored is tried this many times more */
    uint64_t store_retry_us; /* from a failure to the next try */
    uint64_t approval_timeout_us; /* APPROVE_GO must follow APPROVE_ARM in this time */
    uint64_t signed_age_max_us; /* largest difference between the stamp of a signed message and the clock */
    /* initial design (fsw/decide/kc_local.h) */
    uint8_t initial_design; /* kc_initial_t */
    double local_safe_m, leave_safe_m;
    double doubt_p;
    double outside_factor;
    double power_min;
    /* acquisition `rate` */
    uint8_t rate_measure; /* kc_acq_t: dopt or vopt */
    uint8_t rate_cost; /* kc_cost_t */
    double frame_s; /* time from a frame's request to its detection */
    /* stop */
    double stop_confidence; /* that the error is within stop_pos_m and stop_rot_rad; 0: their RMS */
    uint32_t stop_checks; /* so many poses in a row have to be as predicted, before they are used */
    /* observing on the way to a candidate, where the arm rests with tags in view before a servo step */
    uint32_t extra_obs_max; /* most such observations for each candidate, 0: none */
    /* least distance of the tool from the candidate, and from the last of them: one of the two is enough */
    double extra_pos_m, extra_rot_rad;
    uint32_t stops_max; /* most stops on the way to each candidate, of those that SPACE has, 0: none */
    double
        no_change_power; /* with a required accuracy: the table in force is tested, and a right one ends the
                               calibration, once an error that large would show with this probability; 0: never */
} kc_config_t;

/* Layout and limits of every field, over the stream of kc_codec.h. */
void kc_config_walk(kc_walk_t *w, kc_config_t *c);

/* KC_ERR_RANGE: first problem, *index = field number of docs/TABLES.md, *got = the value. c unchanged. */
kc_status_t kc_config_validate(const kc_config_t *c, int32_t *index, double *got);

#endif
