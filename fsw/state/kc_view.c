#include "kc_view.h"

#include <string.h>

#include "kc_libm.h"
#include "kc_path.h"
#include "kc_vec.h"

uint64_t kc_view_elapsed(const kc_view_t *view, uint64_t stamp_us)
{
    const kc_clock_t *c = view->clock;
    bool back = stamp_us < c->clock_us;
    uint64_t us = c->now_us + (stamp_us - c->clock_us); /* modulo 2^64 */
    if ((us < c->now_us) == back) { return us; }
    return back ? 0u : UINT64_MAX;
}

uint32_t kc_view_stride(const kc_view_t *view)
{
    return (view->tables->space.n_cand + KC_SPACE_SAMPLES - 1u) / KC_SPACE_SAMPLES;
}

uint64_t kc_view_in_state_us(const kc_view_t *view) { return view->clock->now_us - view->place->since_us; }

bool kc_view_at_rest(const kc_view_t *view)
{
    return !view->telemetry->arm.moving && !view->telemetry->pantilt.moving;
}

void kc_view_ctx(const kc_view_t *view, uint32_t cand, kc_ctx_t *ctx)
{
    const kc_arm_state_t *arm = &view->telemetry->arm;
    memset(ctx, 0, sizeof *ctx);
    kc_path_joints(&view->tables->space, KC_HUB_MAX + cand, ctx->q);
    kc_v3_copy(arm->g_m_s2, ctx->g_m_s2);
    ctx->temp_c = arm->temp_c;
    ctx->payload_kg = arm->payload_kg;
    ctx->t_s = (double)view->clock->now_us * 1e-6;
}

static void pose(const kc_fixed_t *fixed, const kc_ctx_t *ctx, kc_pose_t *T)
{
    kc_loads_t work;
    kc_eval_t eval;
    kc_fixed_eval(fixed, ctx, kc_fixed_needed_loads(fixed, ctx, &work), false, &eval);
    *T = eval.T;
}

void kc_view_expect(const kc_view_t *view, const double *q, kc_pose_t *T)
{
    kc_ctx_t ctx;
    kc_fixed_t fixed;
    kc_view_ctx(view, 0u, &ctx);
    memcpy(ctx.q, q, view->tables->arm.n_joints * sizeof *q);
    kc_model_fix(&view->tables->arm, &view->tables->terms, view->latest->coef, &fixed);
    pose(&fixed, &ctx, T);
}

void kc_view_pose(const kc_view_t *view, const kc_fixed_t *fixed, uint32_t cand, kc_pose_t *T)
{
    kc_ctx_t ctx;
    kc_view_ctx(view, cand, &ctx);
    pose(fixed, &ctx, T);
}

double kc_view_distance(const kc_view_t *view, const double *q)
{
    double worst = 0.0;
    for (uint32_t j = 0u; j < view->tables->arm.n_joints; j++) {
        worst = kc_max(worst, kc_fabs(view->telemetry->arm.q[j] - q[j]));
    }
    return worst;
}

void kc_view_seed(const kc_view_t *view, double *q)
{
    kc_path_joints(&view->tables->space, KC_HUB_MAX + (uint32_t)view->cal->candidate, q);
}

bool kc_view_local(const kc_view_t *view)
{
    return kc_space_local(&view->tables->space, (uint32_t)view->cal->candidate);
}
