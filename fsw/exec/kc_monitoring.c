/* Normal operation: detections outside calibrations feed the miscalibration monitor. */
#include <string.h>

#include "kc_app_priv.h"
#include "kc_libm.h"

int kc_monitoring_wants(const kc_app_t *app)
{
    const uint32_t *crc = app->tables.active.crc;
    return app->state == KC_ST_IDLE && !app->observe.waiting && crc[KC_TBL_ARM] != 0u &&
           crc[KC_TBL_CAMERA] != 0u && crc[KC_TBL_TERMS] != 0u && crc[KC_TBL_CONFIG] != 0u;
}

void kc_monitoring_rest(kc_app_t *app)
{
    int heard = app->has_arm && app->has_pantilt && app->now_us - app->arm_ok_us <= KC_MONITORING_FRESH_US &&
                app->now_us - app->pantilt_ok_us <= KC_MONITORING_FRESH_US;
    if (!heard || app->arm.moving || app->pantilt.moving || app->arm.fault_mask != 0) {
        app->monitoring.resting = 0u;
    } else if (!app->monitoring.resting) {
        app->monitoring.resting = 1u;
        app->monitoring.rest_us = app->now_us;
    }
}

/* Observations with other tables, or from before a calibration, do not count. */
static void restart_if_changed(kc_app_t *app)
{
    kc_monitoring_t *w = &app->monitoring;
    const kc_active_t *a = &app->tables.active;
    if (w->session == app->session && memcmp(w->crc, a->crc, sizeof w->crc) == 0) { return; }
    kc_monitor_init(&w->monitor, &a->arm, a->config.sigma_pos_min_m, a->config.sigma_rot_min_rad);
    memset(&w->reported, 0, sizeof w->reported);
    memset(&w->newest, 0, sizeof w->newest);
    memcpy(w->crc, a->crc, sizeof w->crc);
    w->session = app->session;
}

/* Report each finding once, and again when other joints are suspected or the bias has changed. */
static void report(kc_app_t *app, kc_out_t *out, const kc_mon_verdict_t *v)
{
    kc_mon_verdict_t *t = &app->monitoring.reported;
    int same = v->state == t->state && v->suspects == t->suspects && v->joint == t->joint &&
               kc_fabs(v->bias - t->bias) <= KC_MONITORING_REPEAT_SIGMA * t->sigma;
    if (same || v->state == KC_MON_QUIET) { return; }
    if (v->state == KC_MON_NAMED) {
        kc_event(&out->events, KC_EVT_MON_SUSPECT, (int32_t)v->joint + 1, v->bias, (double)v->suspects);
    } else {
        kc_event(&out->events, KC_EVT_MON_UNEXPLAINED, -1, v->off_m, v->off_rad);
    }
    *t = *v;
}

void kc_monitoring_observe(kc_app_t *app, kc_out_t *out, const kc_detection_t *d)
{
    const kc_active_t *a = &app->tables.active;
    kc_monitoring_t *w = &app->monitoring;
    if (!w->resting || kc_app_elapsed(app, d->t_us) < w->rest_us + a->config.settle_us) {
        kc_event(&out->events, KC_EVT_MON_NOT_AT_REST, -1, (double)d->seq, 0.0);
        return;
    }
    restart_if_changed(app);
    kc_detection_t det = *d;
    kc_obs_t obs;
    kc_observe_unflip(app, a->kin.value, &det);
    kc_observe_obs(app, det.p_cam_tool_m, det.q_cam_tool_wxyz, &det, &app->arm, &app->pantilt, &obs);
    if (kc_monitor_add(&w->monitor, &a->arm, &a->terms, a->kin.value, &obs, &app->eval) != KC_OK) { return; }
    w->t_us = kc_app_elapsed(app, d->t_us);
    kc_monitor_evaluate(&w->monitor, &w->newest);
    report(app, out, &w->newest);
}
