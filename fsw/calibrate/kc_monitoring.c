#include "kc_monitoring.h"

#include <string.h>

#include "kc_libm.h"
#include "kc_observation.h"

#define FRESH_US 500000u /* oldest readings that an observation is compared with */
#define REPEAT_SIGMA 3.0 /* change of a bias that is reported again [sigma] */
#define ADD_COST 30000u  /* bound of the instructions of an observation, without the model */

bool kc_monitoring_wants(const kc_view_t *v)
{
    const uint32_t *crc = v->tables->crc;
    return v->place->state == KC_ST_IDLE && crc[KC_TBL_ARM] != 0u && crc[KC_TBL_CAMERA] != 0u &&
           crc[KC_TBL_TERMS] != 0u && crc[KC_TBL_CONFIG] != 0u;
}

void kc_monitoring_rest(kc_monitoring_t *w, const kc_view_t *v)
{
    const kc_telemetry_t *t = v->telemetry;
    uint64_t now_us = v->clock->now_us;
    bool heard = t->has_arm && t->has_pantilt && now_us - t->arm_ok_us <= FRESH_US &&
                 now_us - t->pantilt_ok_us <= FRESH_US;
    bool resting = heard && kc_view_at_rest(v) && t->arm.fault_mask == 0;
    if (resting && !w->resting) { w->rest_us = now_us; }
    w->resting = resting;
}

/* Observations with other tables, or from before a calibration, do not count. */
static bool changed(const kc_monitoring_t *w, const kc_view_t *v)
{
    return w->session != v->cal->session || memcmp(w->crc, v->tables->crc, sizeof w->crc) != 0;
}

static void restart(kc_monitoring_t *w, kc_monitor_t *monitor, const kc_view_t *v)
{
    const kc_active_t *a = v->tables;
    kc_monitor_init(monitor, &a->arm, a->config.sigma_pos_min_m, a->config.sigma_rot_min_rad);
    memset(&w->reported, 0, sizeof w->reported);
    memset(&w->newest, 0, sizeof w->newest);
    memcpy(w->crc, a->crc, sizeof w->crc);
    w->session = v->cal->session;
}

/* Report each finding once, and again when other joints are suspected or the bias has changed. */
static void report(kc_monitoring_t *w, kc_out_t *out)
{
    const kc_mon_verdict_t *v = &w->newest, *last = &w->reported;
    bool same = v->state == last->state && v->suspects == last->suspects && v->joint == last->joint &&
                kc_fabs(v->bias - last->bias) <= REPEAT_SIGMA * last->sigma;
    if (same || v->state == KC_MON_QUIET) { return; }
    if (v->state == KC_MON_NAMED) {
        kc_event(&out->events, KC_EVT_MON_SUSPECT, (int32_t)v->joint + 1, v->bias, (double)v->suspects);
    } else {
        kc_event(&out->events, KC_EVT_MON_UNEXPLAINED, -1, v->off_m, v->off_rad);
    }
    w->reported = *v;
}

void kc_monitoring_observe(kc_monitoring_t *w, kc_monitor_t *monitor, const kc_view_t *v,
                           const kc_detection_t *d, kc_work_t *work, kc_out_t *out)
{
    const kc_active_t *a = v->tables;
    kc_posture_t at = {&v->telemetry->arm, &v->telemetry->pantilt, (double)v->clock->now_us * 1e-6};
    uint64_t taken_us = kc_view_elapsed(v, d->t_us);
    kc_detection_t det = *d;
    kc_obs_t obs;
    kc_eval_t eval;
    if (!w->resting || taken_us < w->rest_us + a->config.settle_us) {
        kc_event(&out->events, KC_EVT_MON_NOT_AT_REST, -1, (double)d->seq, 0.0);
        return;
    }
    if (changed(w, v)) { restart(w, monitor, v); }
    kc_observation_unflip(a, a->kin.value, &at, &det);
    kc_observation(&a->camera, &det, &at, &obs);
    kc_work_spend(work, kc_model_cost(&a->arm, &a->terms, 0) + ADD_COST);
    if (kc_monitor_add(monitor, &a->arm, &a->terms, a->kin.value, &obs, &eval) != KC_OK) { return; }
    w->t_us = taken_us;
    w->due = true;
}

void kc_monitoring_evaluate(kc_monitoring_t *w, const kc_monitor_t *monitor, const kc_view_t *v,
                            kc_work_t *work, kc_out_t *out)
{
    if (!kc_monitoring_wants(v) || changed(w, v)) { w->due = false; }
    if (!w->due || !kc_work_take(work, kc_monitor_evaluate_cost(monitor))) { return; }
    w->due = false;
    kc_monitor_evaluate(monitor, &w->newest);
    report(w, out);
}
