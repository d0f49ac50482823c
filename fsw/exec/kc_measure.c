/* MEASURE: several frames at rest become one measurement. */
#include <string.h>

#include "kc_app_priv.h"
#include "kc_libm.h"
#include "kc_vec.h"

void kc_measure_begin(kc_app_t *app)
{
    memset(&app->frames, 0, sizeof app->frames);
    kc_observe_begin(app);
}

/* Position and rotation vector (camera axes) of a frame against the first one. */
static void difference(const kc_frames_t *f, const kc_detection_t *det, double dp[3], double dw[3])
{
    kc_pose_t T;
    double r[6];
    kc_v3_copy(det->p_cam_tool_m, T.p_m);
    kc_quat_to_R(det->q_cam_tool_wxyz, T.R);
    kc_pose_residual(&T, &f->first, r);
    kc_v3_copy(r, dp);
    kc_v3_copy(&r[3], dw);
}

void kc_measure_jump(const kc_app_t *app, const kc_detection_t *det, double *pos_m, double *rot_rad)
{
    const kc_frames_t *f = &app->frames;
    double dp[3], dw[3];
    *pos_m = 0.0;
    *rot_rad = 0.0;
    if (app->state != KC_ST_MEASURE || f->n == 0u) { return; }
    difference(f, det, dp, dw);
    kc_v3_add_scaled(dp, -1.0 / (double)f->n, f->dp_m, dp);
    kc_v3_add_scaled(dw, -1.0 / (double)f->n, f->dw_rad, dw);
    *pos_m = kc_v3_norm(dp);
    *rot_rad = kc_v3_norm(dw);
}

static void add_scalars(kc_frames_t *f, const kc_app_t *app, const kc_detection_t *d)
{
    f->range_m += d->range_m;
    f->incid_rad += d->incid_rad;
    f->u_px += d->u_px;
    f->v_px += d->v_px;
    f->rms_px += d->rms_px;
    f->rms_alt_px += d->rms_alt_px;
    f->pan_rad += app->pantilt.pan_rad;
    f->tilt_rad += app->pantilt.tilt_rad;
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) {
        f->q[j] += app->arm.q[j];
        f->dq[j] += app->arm.dq[j];
    }
    for (uint32_t i = 0u; i < 8u * KC_TAG_MAX; i++) { f->corner_px[i] += d->corner_px[i]; }
    for (uint32_t i = 0u; i < 36u; i++) { f->cov[i] += d->cov[i]; }
}

static int same_tags(const kc_detection_t *a, const kc_detection_t *b)
{
    int same = a->n_tags == b->n_tags;
    for (uint32_t i = 0u; i < a->n_tags; i++) { same = same && a->tag_id[i] == b->tag_id[i]; }
    return same;
}

static void add_frame(kc_app_t *app)
{
    kc_frames_t *f = &app->frames;
    const kc_detection_t *d = &app->observe.det;
    double dp[3], dw[3];
    if (f->n == 0u) {
        f->det = *d;
        f->same_tags = 1u;
        kc_v3_copy(d->p_cam_tool_m, f->first.p_m);
        kc_quat_to_R(d->q_cam_tool_wxyz, f->first.R);
    }
    difference(f, d, dp, dw);
    kc_v3_add_scaled(f->dp_m, 1.0, dp, f->dp_m);
    kc_v3_add_scaled(f->dw_rad, 1.0, dw, f->dw_rad);
    f->same_tags = f->same_tags && same_tags(&f->det, d);
    add_scalars(f, app, d);
    f->n++;
}

/* Covariance of the mean of n frames whose errors are correlated by KC_FRAME_SHARED:
 * C (1 + (n - 1) shared) / n. What all poses share (lens, tag size) stays too: no variance goes below
 * its floor. */
static void mean_cov(const kc_frames_t *f, const kc_config_t *c, double cov[36])
{
    double n = (double)f->n;
    double share = (1.0 + (n - 1.0) * KC_FRAME_SHARED) / n;
    for (uint32_t i = 0u; i < 36u; i++) { cov[i] = f->cov[i] / n * share; }
    for (uint32_t i = 0u; i < 6u; i++) {
        double floor = i < 3u ? c->sigma_pos_min_m : c->sigma_rot_min_rad;
        cov[7u * i] = kc_max(cov[7u * i], floor * floor);
    }
}

static void mean_pose(const kc_frames_t *f, kc_detection_t *d)
{
    double n = (double)f->n, w[3], E[9], R[9];
    kc_v3_add_scaled(f->first.p_m, 1.0 / n, f->dp_m, d->p_cam_tool_m);
    for (uint32_t i = 0u; i < 3u; i++) { w[i] = f->dw_rad[i] / n; }
    kc_R_exp(w, E);
    kc_m3_mul(E, f->first.R, R);
    kc_R_to_quat(R, d->q_cam_tool_wxyz);
}

static void mean_detection(const kc_frames_t *f, const kc_config_t *c, kc_detection_t *d)
{
    double n = (double)f->n;
    *d = f->det; /* time, number, tags and the other solution are those of the first frame */
    mean_pose(f, d);
    mean_cov(f, c, d->cov);
    d->range_m = f->range_m / n;
    d->incid_rad = f->incid_rad / n;
    d->u_px = f->u_px / n;
    d->v_px = f->v_px / n;
    d->rms_px = f->rms_px / n;
    d->rms_alt_px = f->rms_alt_px / n;
    if (!f->same_tags) { return; }
    for (uint32_t i = 0u; i < 8u * KC_TAG_MAX; i++) { d->corner_px[i] = f->corner_px[i] / n; }
}

/* All frames are in: fill the message, hand the observation to the estimator. */
static int finish(kc_app_t *app, kc_out_t *out)
{
    const kc_frames_t *f = &app->frames;
    kc_meas_t *m = &out->meas;
    kc_pantilt_state_t pantilt = app->pantilt;
    double n = (double)f->n;
    m->pose = app->cal.n_meas + 1u;
    m->candidate = app->cal.candidate;
    m->replicate = app->cal.replicate;
    m->n_joints = app->tables.active.arm.n_joints;
    m->arm = app->arm;
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) {
        m->arm.q[j] = f->q[j] / n;
        m->arm.dq[j] = f->dq[j] / n;
    }
    mean_detection(f, &app->tables.active.config, &m->det);
    m->pan_rad = pantilt.pan_rad = f->pan_rad / n;
    m->tilt_rad = pantilt.tilt_rad = f->tilt_rad / n;
    m->n_frames = f->n;
    m->t_us = app->clock_us;
    m->session = app->session;
    memcpy(m->crc, app->tables.active.crc, sizeof m->crc);
    kc_observe_obs(app, m->det.p_cam_tool_m, m->det.q_cam_tool_wxyz, &m->det, &m->arm, &pantilt, &m->obs);
    if (kc_est_add(&app->est, &m->obs) != KC_OK) {
        kc_observe_skip(app, out);
        return 1;
    }
    out->has_meas = 1u;
    app->cal.cand_of[app->cal.n_meas++] = (uint16_t)app->cal.candidate;
    app->cal.usable[app->cal.candidate] = 0u;
    app->cal.n_local += kc_space_local(&app->tables.active.space, (uint32_t)app->cal.candidate) ? 1u : 0u;
    app->cal.range_m = kc_max(m->det.range_m, KC_RANGE_MIN_M);
    app->n_meas++;
    app->cal.up = KC_UP_ADD;
    kc_app_enter(app, KC_ST_UPDATE);
    return 0; /* the estimator gets a step of its own */
}

static int retry(kc_app_t *app, kc_out_t *out)
{
    if (app->observe.fails++ < app->tables.active.config.frame_retries) { return 0; }
    kc_observe_skip(app, out);
    return 1;
}

int kc_measure_run(kc_app_t *app, kc_out_t *out)
{
    if (app->arm.moving || app->pantilt.moving) { /* frames of one measurement are taken at one place */
        if (retry(app, out)) { return 1; }
        memset(&app->frames, 0, sizeof app->frames);
        app->observe.waiting = 0u;
        app->observe.got = 0u;
        kc_move_settle(app, KC_ST_MEASURE);
        return 0;
    }
    switch (kc_observe_poll(app, out)) {
    case KC_OBSERVE_DETECTED:
        add_frame(app);
        if (app->frames.n >= app->tables.active.config.frames_per_meas) { return finish(app, out); }
        (void)kc_observe_poll(app, out); /* request the next frame at once */
        return 0;
    case KC_OBSERVE_NO_TAGS: return retry(app, out);
    case KC_OBSERVE_UNCERTAIN: kc_observe_skip(app, out); return 1;
    case KC_OBSERVE_TIMEOUT: kc_app_abort(app, out, KC_CAUSE_CAMERA); return 0;
    default: return 0;
    }
}
