#include "kc_config.h"

#include <string.h>

#include "kc_acquire.h"

#define S_US 1000000ull
#define HOUR_US (3600ull * S_US)
#define ARRIVE_MAX 0.01 /* what is verified is verified for an arm that is where it was sent */
#define TINY 1e-12 /* stands for "above zero" */

static void walk_design(kc_walk_t *w, kc_config_t *c)
{
    kc_walk_u8(w, 1u, &c->acquisition, KC_ACQ_UCB, KC_ACQ_COUNT - 1u); /* kc_acq_t */
    kc_walk_u32(w, 2u, &c->n_poses, 1u, KC_MEAS_MAX);
    kc_walk_u32(w, 3u, &c->replicate_every, 0u, KC_MEAS_MAX);
    kc_walk_f64(w, 4u, &c->beta_scale, 0.0, 1e3);
    kc_walk_f64(w, 5u, &c->a1, 0.0, 1.0);
    kc_walk_f64(w, 6u, &c->sp_floor_m, TINY, 1.0);
    kc_walk_f64(w, 7u, &c->sq_floor_rad, TINY, 3.2);
    kc_walk_f64(w, 8u, &c->vopt_len_m, 1e-6, 1e3);
    kc_walk_f64(w, 9u, &c->stop_pos_m, 0.0, 1.0); /* 0 = off */
    kc_walk_f64(w, 10u, &c->stop_rot_rad, 0.0, 3.2); /* 0 = off */
}

static void walk_observing(kc_walk_t *w, kc_config_t *c)
{
    kc_walk_u32(w, 11u, &c->frames_per_meas, 1u, 16u);
    kc_walk_u32(w, 12u, &c->frame_retries, 0u, 50u);
    kc_walk_u64(w, 13u, &c->settle_us, 0u, HOUR_US);
    kc_walk_u64(w, 14u, &c->frame_timeout_us, 1000u, HOUR_US);
    kc_walk_u64(w, 15u, &c->move_timeout_us, 1000u, HOUR_US);
    kc_walk_u64(w, 16u, &c->frame_age_max_us, 1000u, HOUR_US);
    kc_walk_u32(w, 17u, &c->search_steps, 0u, 49u);
    kc_walk_f64(w, 18u, &c->search_step_rad, 0.0, 1.6);
    kc_walk_f64(w, 19u, &c->jump_pos_m, TINY, 10.0);
    kc_walk_f64(w, 20u, &c->jump_rot_rad, TINY, 3.2);
    kc_walk_f64(w, 21u, &c->sigma_pos_max_m, TINY, 1.0);
    kc_walk_f64(w, 22u, &c->sigma_rot_max_rad, TINY, 3.2);
    kc_walk_f64(w, 23u, &c->sigma_pos_min_m, TINY, 1.0); /* not above sigma_pos_max_m */
    kc_walk_rule(w, 23u, c->sigma_pos_min_m <= c->sigma_pos_max_m, c->sigma_pos_min_m);
    kc_walk_f64(w, 24u, &c->sigma_rot_min_rad, TINY, 3.2); /* not above sigma_rot_max_rad */
    kc_walk_rule(w, 24u, c->sigma_rot_min_rad <= c->sigma_rot_max_rad, c->sigma_rot_min_rad);
    kc_walk_f64(w, 25u, &c->rms_max_px, TINY, 1e3);
}

static void walk_moving(kc_walk_t *w, kc_config_t *c)
{
    kc_walk_f64(w, 26u, &c->servo.gain, TINY, 1.0);
    kc_walk_f64(w, 27u, &c->servo.damping, TINY, 10.0);
    kc_walk_f64(w, 28u, &c->servo.step_max, TINY, 3.2);
    kc_walk_f64(w, 29u, &c->servo.bound, TINY, 10.0);
    kc_walk_f64(w, 30u, &c->servo.tol_pos_m, TINY, 1.0);
    kc_walk_f64(w, 31u, &c->servo.tol_rot_rad, TINY, 3.2);
    kc_walk_f64(w, 32u, &c->servo.margin, 0.0, 1.0);
    kc_walk_u32(w, 33u, &c->servo_steps_max, 0u, 1000u);
    kc_walk_f64(w, 34u, &c->speed_scale, 1e-3, 1.0);
    /* rad or m; twice as much beside a segment, or beyond a bound, counts as on the verified path */
    kc_walk_f64(w, 35u, &c->arrive_tol, 1e-9, ARRIVE_MAX);
}

static void walk_estimating(kc_walk_t *w, kc_config_t *c)
{
    kc_walk_u64(w, 36u, &c->est.free_mask, 1u, UINT64_MAX); /* bit per coefficient */
    kc_walk_u32(w, 37u, &c->est.iter_max, 1u, 100u);
    kc_walk_f64(w, 38u, &c->est.tol_step, 1e-15, 1.0);
    kc_walk_f64(w, 39u, &c->est.rank_tol, 1e-15, 1.0);
    kc_walk_f64(w, 40u, &c->est.outlier_p, 0.0, 0.5); /* 0 = off */
    kc_walk_u32(w, 41u, &c->est.outlier_max, 0u, KC_MEAS_MAX);
    kc_walk_u8(w, 42u, &c->est.use_prior, 0u, 1u);
}

static void walk_policy(kc_walk_t *w, kc_config_t *c)
{
    kc_walk_u8(w, 43u, &c->accept_on_board, 0u, 1u);
    kc_walk_f64(w, 44u, &c->accept_change_max_pos_m, 0.0, 10.0);
    kc_walk_f64(w, 45u, &c->accept_sigma_max_pos_m, 0.0, 10.0);
    kc_walk_f64(w, 46u, &c->accept_p_fit_min, 0.0, 1.0);
    /* with 0 no arm would need a change, with 1 every arm */
    kc_walk_f64(w, 47u, &c->no_change_p, TINY, 0.5);
    kc_walk_u64(w, 48u, &c->budget_us, 0u, 1000u * HOUR_US); /* 0 = none */
    kc_walk_f64(w, 49u, &c->approach_rad, 0.0, 1.0); /* rad or m; 0 = off */
    kc_walk_f64(w, 50u, &c->power_idle_w, 0.0, 1e5);
    /* arm or pan-tilt unit moving; at least power_idle_w */
    kc_walk_f64(w, 51u, &c->power_move_w, 0.0, 1e5);
    kc_walk_rule(w, 51u, c->power_move_w >= c->power_idle_w, c->power_move_w);
    kc_walk_f64(w, 52u, &c->energy_budget_j, 0.0, 1e12); /* 0 = none */
    /* an observation farther off the best correction within its bounds ends the calibration; 0 = not
     * checked */
    kc_walk_f64(w, 53u, &c->mismatch_pos_m, 0.0, 10.0);
    kc_walk_f64(w, 54u, &c->mismatch_rot_rad, 0.0, 4.0); /* the same in angle; 0 = not checked */
}

static void walk_decisions(kc_walk_t *w, kc_config_t *c)
{
    kc_walk_f64(w, 55u, &c->flip_rms_ratio, 1.0, 100.0);
    kc_walk_f64(w, 56u, &c->flip_trust_rad, 0.0, 3.2);
    kc_walk_f64(w, 57u, &c->frame_shared, 0.0, 1.0);
    kc_walk_f64(w, 58u, &c->search_safety, 1.0, 100.0);
    kc_walk_u32(w, 59u, &c->poses_min, 1u, KC_MEAS_MAX);
    kc_walk_u32(w, 60u, &c->tags_tried_min, 1u, KC_INITIAL_MAX);
    kc_walk_f64(w, 61u, &c->second_start_noise_scale, 1.0, 1e3);
    kc_walk_f64(w, 62u, &c->mismatch_noise_scale, 1.0, 1e3);
    kc_walk_u32(w, 63u, &c->mismatch_dof_min, 1u, 6u * KC_MEAS_MAX);
    kc_walk_u32(w, 64u, &c->mismatch_outliers_min, 1u, KC_MEAS_MAX);
    kc_walk_f64(w, 65u, &c->poor_noise_scale, 1.0, 1e3);
    kc_walk_f64(w, 66u, &c->poor_noise_scale_unlikely, 1.0, 1e3); /* not above poor_noise_scale */
    kc_walk_rule(w, 66u, c->poor_noise_scale_unlikely <= c->poor_noise_scale, c->poor_noise_scale_unlikely);
    kc_walk_f64(w, 67u, &c->poor_p_fit, 0.0, 1.0);
    kc_walk_u32(w, 68u, &c->store_retries, 0u, 100u);
    kc_walk_u64(w, 69u, &c->store_retry_us, 1000u, HOUR_US);
    kc_walk_u64(w, 70u, &c->approval_timeout_us, 1000000u, HOUR_US);
    kc_walk_u8(w, 71u, &c->frame, KC_RIGHT_IN_CAMERA, KC_RIGHT_IN_LANDER); /* kc_right_in_t */
    /* 0 = not checked; else at least a minute, so that no table locks the ground out */
    kc_walk_u64(w, 72u, &c->signed_age_max_us, 0u, 1000u * HOUR_US);
    kc_walk_rule(w, 72u, c->signed_age_max_us == 0u || c->signed_age_max_us >= 60u * S_US,
                 (double)c->signed_age_max_us);
}

/* A probability below one half would promise less than chance. */
static bool none_or_half(double p) { return p <= 0.0 || p >= 0.5; }

static void walk_poses(kc_walk_t *w, kc_config_t *c)
{
    kc_walk_u8(w, 73u, &c->initial_design, KC_INITIAL_TABLE, KC_INITIAL_INFORMATION); /* kc_initial_t */
    /* largest sigma of the tool's position at a local initial pose that may be chosen ... */
    kc_walk_f64(w, 74u, &c->local_safe_m, TINY, 10.0);
    /* ... and at a pose that the arm may leave the park pose for */
    kc_walk_f64(w, 75u, &c->leave_safe_m, TINY, 10.0);
    kc_walk_f64(w, 76u, &c->doubt_p, 0.0, 0.5); /* less likely observations ask for all local initial poses */
    /* an arm outside: errors this many times as large */
    kc_walk_f64(w, 77u, &c->outside_factor, 1.001, 100.0);
    kc_walk_f64(w, 78u, &c->power_min, 0.0, 0.999999); /* least probability that it casts doubt */
    kc_walk_u8(w, 79u, &c->rate_measure, KC_ACQ_DOPT, KC_ACQ_VOPT); /* kc_acq_t */
    kc_walk_u8(w, 80u, &c->rate_cost, KC_COST_TIME, KC_COST_ENERGY); /* kc_cost_t */
    kc_walk_f64(w, 81u, &c->frame_s, 0.0, 3600.0);
    kc_walk_f64(w, 82u, &c->stop_confidence, 0.0, 0.9999); /* 0 = RMS; else at least 0.5 */
    kc_walk_rule(w, 82u, none_or_half(c->stop_confidence), c->stop_confidence);
    kc_walk_u32(w, 83u, &c->stop_checks, 0u, KC_MEAS_MAX); /* 0 = not checked */
}

static void walk_extra(kc_walk_t *w, kc_config_t *c)
{
    kc_walk_u32(w, 84u, &c->extra_obs_max, 0u, KC_MEAS_MAX); /* 0 = off */
    kc_walk_f64(w, 85u, &c->extra_pos_m, TINY, 10.0);
    kc_walk_f64(w, 86u, &c->extra_rot_rad, TINY, 3.2);
    kc_walk_u32(w, 87u, &c->stops_max, 0u, KC_STOP_MAX); /* 0 = off */
}

/* Standard values of what was added last: an image with all of them ends before, as all images did before there was
 * any of it. So those stay valid, with the same CRC, and this is the end of the table. */
#define REST_PART 0.01
#define NO_CHANGE_POWER 0.99

static bool standard(const kc_config_t *c)
{
    return c->rest_part == REST_PART && c->no_change_power == NO_CHANGE_POWER && c->go_by_other_key == 0u;
}

static void walk_added(kc_walk_t *w, kc_config_t *c)
{
    if (w->mode == KC_WALK_READ && w->pos >= w->in_n) {
        c->rest_part = REST_PART;
        c->no_change_power = NO_CHANGE_POWER;
        c->go_by_other_key = 0u;
        return;
    }
    if (w->mode != KC_WALK_READ && standard(c)) { return; }
    /* least sigma of what the monitor does not suspect, part of the coefficient's scale */
    kc_walk_f64(w, 88u, &c->rest_part, 1e-6, 10.0);
    /* power of the early test of the table in force; 0 = none before the end, else at least 0.5 */
    kc_walk_f64(w, 89u, &c->no_change_power, 0.0, 0.9999);
    kc_walk_rule(w, 89u, none_or_half(c->no_change_power), c->no_change_power);
    kc_walk_u8(w, 90u, &c->go_by_other_key, 0u, 1u); /* an image with 0.01, 0.99, 0 ends before these three */
    kc_walk_rule(w, 88u, w->mode != KC_WALK_READ || !standard(c), c->rest_part);
}

void kc_config_walk(kc_walk_t *w, kc_config_t *c)
{
    walk_design(w, c);
    walk_observing(w, c);
    walk_moving(w, c);
    walk_estimating(w, c);
    walk_policy(w, c);
    walk_decisions(w, c);
    walk_poses(w, c);
    walk_extra(w, c);
    walk_added(w, c); /* the last: an image may end before it */
}

kc_status_t kc_config_validate(const kc_config_t *c, int32_t *index, double *got)
{
    kc_walk_t w;
    memset(&w, 0, sizeof w);
    w.mode = KC_WALK_CHECK;
    w.index = -1;
    kc_config_walk(&w, (kc_config_t *)c); /* a checking walk stores nothing */
    if (w.n_bad == 0u) { return KC_OK; }
    *index = (int32_t)w.bad_field;
    *got = w.bad_got;
    return KC_ERR_RANGE;
}
