#include <string.h>

#include "kc_app_priv.h"

static void monitor(const kc_mon_verdict_t *v, kc_hk_t *hk)
{
    hk->mon_state = (int32_t)v->state;
    hk->mon_joint = v->state == KC_MON_NAMED ? (int32_t)v->joint + 1 : 0;
    hk->mon_suspects = v->suspects;
    hk->mon_n_obs = v->n_obs;
    hk->mon_bias = v->bias;
    hk->mon_sigma = v->sigma;
    hk->mon_p = v->p;
}

static void fill(kc_app_t *app, kc_hk_t *hk)
{
    const kc_active_t *a = &app->tables.active;
    hk->seq = ++app->hk_seq;
    hk->state = (int32_t)app->state;
    hk->session = app->session;
    hk->n_poses = app->cal.n_meas;
    hk->n_poses_goal = app->cal.n_goal;
    hk->candidate = app->cal.candidate;
    hk->servo_steps = app->cal.servo_steps;
    hk->n_meas = app->n_meas;
    hk->n_rejected = app->n_rejected;
    hk->n_cmd_ok = app->n_cmd_ok;
    hk->n_cmd_refused = app->n_cmd_refused;
    hk->n_events = app->n_events;
    hk->n_events_dropped = app->n_dropped;
    hk->last_event_id = app->last_event_id;
    hk->n_rx_errors = app->n_rx_errors;
    memcpy(hk->crc, a->crc, sizeof hk->crc);
    hk->staged_state = (int32_t)app->tables.staging.state;
    hk->staged_kind = hk->staged_state == (int32_t)KC_STAGE_NONE ? 0 : (int32_t)app->tables.staging.kind;
    hk->staged_bytes = app->tables.staging.n;
    hk->boot_state = app->boot_state;
    hk->boot_pose = app->boot_pose;
    hk->boot_count = app->boot_count;
    hk->proposal_crc = app->proposal_crc;
    hk->energy_j = app->energy_j;
    monitor(&app->monitoring.newest, hk);
}

void kc_hk_run(kc_app_t *app, kc_out_t *out)
{
    app->n_events += out->events.n;
    app->n_dropped += out->events.dropped;
    if (out->events.n > 0u) { app->last_event_id = (int32_t)out->events.e[out->events.n - 1u].id; }
    if (app->now_us < app->hk_us) { return; }
    app->hk_us = app->now_us + KC_HK_PERIOD_US;
    out->has_hk = 1u;
    fill(app, &out->hk);
}
