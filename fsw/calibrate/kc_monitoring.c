#include "kc_monitoring.h"

#include <string.h>

#include "kc_libm.h"
#include "kc_observation.h"

#define FRESH_US 500000u /* oldest readings that an observation is compared with */
#define REPEAT_SIGMA 3.0 /* change of a bias that is reported again [sigma] */
#define ADD_COST 30000u  /* bound of the instructions of an observation, without the model */

bool kc_monitoring_wants(const kc_view_t *view)
{
    const uint32_t *crc = view->tables->crc;
    return view->place->state == KC_ST_IDLE && crc[KC_TBL_ARM] != 0u && crc[KC_TBL_CAMERA] != 0u &&
           crc[KC_TBL_TERMS] != 0u && crc[KC_TBL_CONFIG] != 0u;
}

void kc_monitoring_rest(kc_monitoring_t *monitoring, const kc_view_t *view)
{
    const kc_telemetry_t *t = view->telemetry;
    uint64_t now_us = view->clock->now_us;
    bool heard = t->has_arm && t->has_pantilt && now_us - t->arm_ok_us <= FRESH_US &&
                 now_us - t->pantilt_ok_us <= FRESH_US;
    bool resting = heard && kc_view_at_rest(view) && t->arm.fault_mask == 0;
    if (resting && !monitoring->resting) { monitoring->rest_us = now_us; }
    monitoring->resting = resting;
}

/* Observations with other tables, or from before a calibration, do not count. */
static bool changed(const kc_monitoring_t *monitoring, const kc_view_t *view)
{
    return monitoring->session != view->cal->session ||
           memcmp(monitoring->crc, view->tables->crc, sizeof monitoring->crc) != 0;
}

static void restart(kc_monitoring_t *monitoring, kc_monitor_t *monitor, const kc_view_t *view)
{
    const kc_active_t *a = view->tables;
    kc_monitor_init(monitor, &a->arm, a->config.sigma_pos_min_m, a->config.sigma_rot_min_rad);
    memset(&monitoring->reported, 0, sizeof monitoring->reported);
    memset(&monitoring->newest, 0, sizeof monitoring->newest);
    memset(&monitoring->suspects, 0, sizeof monitoring->suspects);
    monitoring->weigh = false;
    memcpy(monitoring->crc, a->crc, sizeof monitoring->crc);
    monitoring->session = view->cal->session;
}

/* Report each finding once, and again when other joints are suspected or the bias has changed. */
static void report(kc_monitoring_t *monitoring, kc_out_t *out)
{
    const kc_mon_verdict_t *v = &monitoring->newest, *last = &monitoring->reported;
    bool same = v->state == last->state && v->suspects == last->suspects && v->joint == last->joint &&
                kc_fabs(v->bias - last->bias) <= REPEAT_SIGMA * last->sigma;
    if (same || v->state == KC_MON_QUIET) { return; }
    if (v->state == KC_MON_NAMED) {
        kc_event(&out->events, KC_EVT_MON_SUSPECT, (int32_t)v->joint + 1, v->bias, (double)v->suspects);
    } else if (v->state == KC_MON_SEVERAL) {
        kc_event(&out->events, KC_EVT_MON_SEVERAL, (int32_t)v->joint + 1, (double)monitoring->suspects.joints,
                 (double)v->suspects);
    } else {
        kc_event(&out->events, KC_EVT_MON_UNEXPLAINED, -1, v->off_m, v->off_rad);
    }
    monitoring->reported = *v;
}

void kc_monitoring_observe(kc_monitoring_t *monitoring, kc_monitor_t *monitor, const kc_view_t *view,
                           const kc_detection_t *det, kc_work_t *work, kc_out_t *out)
{
    const kc_active_t *a = view->tables;
    kc_posture_t at = {&view->telemetry->arm, &view->telemetry->pantilt, (double)view->clock->now_us * 1e-6};
    uint64_t taken_us = kc_view_elapsed(view, det->t_us);
    kc_detection_t unflipped = *det;
    kc_obs_t obs;
    kc_eval_t eval;
    if (!monitoring->resting || taken_us < monitoring->rest_us + a->config.settle_us) {
        kc_event(&out->events, KC_EVT_MON_NOT_AT_REST, -1, (double)det->seq, 0.0);
        return;
    }
    if (changed(monitoring, view)) { restart(monitoring, monitor, view); }
    kc_observation_unflip(a, a->kin.value, &at, &unflipped);
    kc_observation(&a->camera, &unflipped, &at, &obs);
    kc_work_spend(work, kc_model_cost(&a->arm, &a->terms, a->kin.value, true) +
                            2u * kc_model_cost(&a->arm, &a->terms, a->kin.value, false) + ADD_COST);
    if (kc_monitor_add(monitor, &a->arm, &a->terms, a->kin.value, &obs, &eval) != KC_OK) { return; }
    monitoring->t_us = taken_us;
    monitoring->due = true;
}

/* The joints of the most probable set take the place of the one that the monitor found, if another explains more. */
static void conclude(kc_monitoring_t *monitoring)
{
    kc_mon_verdict_t *v = &monitoring->newest;
    const kc_suspects_t *s = &monitoring->suspects;
    *v = monitoring->found;
    if (s->joints == 0u) { return; }
    v->suspects = s->suspects;
    v->state = (s->joints & (s->joints - 1u)) != 0u ? KC_MON_SEVERAL : KC_MON_NAMED;
    if (monitoring->found.state == v->state && s->joints == 1u << v->joint) { return; }
    v->n_obs = s->n_obs;
    v->p_rest = s->p_rest;
    v->joint = 0u;
    for (uint32_t j = 1u; j < KC_JOINT_MAX; j++) {
        bool in = (s->joints >> j & 1u) != 0u, first = (s->joints >> v->joint & 1u) == 0u;
        if (in && (first || s->chance[j] > s->chance[v->joint])) { v->joint = j; }
    }
    v->bias = s->bias[v->joint];
    v->sigma = s->sigma[v->joint];
}

/* Something found is weighed before anybody hears of it. */
static void evaluate(kc_monitoring_t *monitoring, const kc_monitor_t *monitor, kc_out_t *out)
{
    monitoring->due = false;
    kc_monitor_evaluate(monitor, &monitoring->found);
    monitoring->weigh = monitoring->found.state != KC_MON_QUIET;
    if (monitoring->weigh) { return; }
    memset(&monitoring->suspects, 0, sizeof monitoring->suspects);
    monitoring->newest = monitoring->found;
    report(monitoring, out);
}

static void weigh(kc_monitoring_t *monitoring, const kc_monitor_t *monitor, kc_out_t *out)
{
    monitoring->weigh = false;
    kc_suspects_weigh(monitor, monitoring->found.n_obs, &monitoring->suspects);
    conclude(monitoring);
    report(monitoring, out);
}

void kc_monitoring_evaluate(kc_monitoring_t *monitoring, const kc_monitor_t *monitor, const kc_view_t *view,
                            kc_work_t *work, kc_out_t *out)
{
    if (!kc_monitoring_wants(view) || changed(monitoring, view)) {
        monitoring->due = false;
        monitoring->weigh = false;
    }
    if (monitoring->weigh) {
        if (kc_work_take(work, kc_suspects_cost(monitor))) { weigh(monitoring, monitor, out); }
        return;
    }
    if (monitoring->due && kc_work_take(work, kc_monitor_evaluate_cost(monitor))) {
        evaluate(monitoring, monitor, out);
    }
}

bool kc_monitoring_names(const kc_monitoring_t *monitoring, const kc_view_t *view)
{
    return !changed(monitoring, view) && monitoring->suspects.joints != 0u;
}
