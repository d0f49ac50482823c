#include "kc_pantilt.h"

#include "kc_input_fields.h"
#include "kc_libm.h"

#define ARRIVE_TOL_RAD 0.01 /* pan-tilt unit within this of its target has arrived */
#define AIM_PART 0.025      /* a tool this part of the view from the middle of the image needs no turn */
#define RESEND_US 1000000u  /* a command that did not make it move is sent again after this */

void kc_pantilt_turn(kc_pantilt_t *pantilt, const kc_view_t *view, kc_out_t *out, double pan_rad,
                     double tilt_rad)
{
    const kc_camera_t *c = &view->tables->camera;
    pantilt->pan_rad = kc_clamp(pan_rad, c->pan_min_rad, c->pan_max_rad);
    pantilt->tilt_rad = kc_clamp(tilt_rad, c->tilt_min_rad, c->tilt_max_rad);
    pantilt->sent_us = view->clock->now_us;
    out->has_pantilt_cmd = 1u;
    out->pantilt_cmd = (kc_pantilt_cmd_t){++pantilt->seq, pantilt->pan_rad, pantilt->tilt_rad};
}

/* Width of the view, or its height if that is less. */
static double view_rad(const kc_camera_t *c)
{
    return kc_min((double)c->width_px / c->fx_px, (double)c->height_px / c->fy_px);
}

void kc_pantilt_aim(kc_pantilt_t *pantilt, const kc_view_t *view, kc_out_t *out, const double *q,
                    const double off_m[3])
{
    double pan = 0.0, tilt = 0.0;
    kc_pose_t T;
    kc_view_expect(view, q, &T);
    for (uint32_t i = 0u; i < 3u; i++) { T.p_m[i] += off_m[i]; }
    (void)kc_camera_aim(&view->tables->camera, T.p_m, &pan, &tilt); /* cut off by a limit: best there is */
    const double off_rad = kc_max(kc_fabs(pan - pantilt->pan_rad), kc_fabs(tilt - pantilt->tilt_rad));
    if (off_rad > AIM_PART * view_rad(&view->tables->camera)) {
        kc_pantilt_turn(pantilt, view, out, pan, tilt);
    }
}

kc_outcome_t kc_pantilt_wait(kc_pantilt_t *pantilt, const kc_view_t *view, kc_out_t *out)
{
    const kc_pantilt_state_t *s = &view->telemetry->pantilt;
    uint64_t took = kc_view_in_state_us(view);
    double off = kc_max(kc_fabs(s->pan_rad - pantilt->pan_rad), kc_fabs(s->tilt_rad - pantilt->tilt_rad));
    if (!s->moving && off <= ARRIVE_TOL_RAD) { return kc_outcome(KC_OC_DONE); }
    if (took > view->tables->config.move_timeout_us) {
        kc_event(&out->events, KC_EVT_CAL_MOVE_TIMEOUT, KC_INPUT_PANTILT, (double)took, 0.0);
        return kc_abort_for(KC_CAUSE_PANTILT_LATE);
    }
    if (!s->moving && view->clock->now_us - pantilt->sent_us >= RESEND_US) {
        kc_pantilt_turn(pantilt, view, out, pantilt->pan_rad, pantilt->tilt_rad); /* the command was lost */
    }
    return kc_outcome(KC_OC_STAY);
}
