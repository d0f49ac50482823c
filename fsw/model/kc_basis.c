/* Bases: what a correction may depend on. */
#include "kc_terms.h"

#include "kc_vec.h"

/* Arguments are clipped here, so that no basis can overflow. */
#define ARG_MAX 1e12
/* tan^2 of the incidence angle is cut off here, at about 80 degrees: tags are not detected beyond. */
#define TAN_ARG_MAX 1.4

static double of_joint(const double *v, uint32_t index)
{
    return index >= 1u && index <= KC_JOINT_MAX ? v[index - 1u] : 0.0;
}

static double of_moment(const kc_loads_t *loads, uint32_t link, uint32_t axis)
{
    return link <= KC_JOINT_MAX ? loads->moment[link][axis] : 0.0;
}

static double of_pnp(const kc_ctx_t *ctx, uint32_t var, uint32_t column)
{
    return column <= KC_PNP_MAX ? ctx->pnp[var - KC_VAR_PNP_TX][column] : 0.0;
}

static double of_move(const kc_ctx_t *ctx, uint32_t joint)
{
    return joint <= KC_MOVE_MAX ? ctx->move[joint] : 0.0;
}

/* Component of gravity in the frame of a link. */
static double of_gravity(const kc_loads_t *loads, uint32_t link, uint32_t axis)
{
    return link <= KC_JOINT_MAX ? loads->g_link_m_s2[link][axis] : 0.0;
}

/* Moment of 1 kg at a body about axis c of a link's frame: c . (r x g) = r . (g x c). */
static double of_lever(const kc_loads_t *loads, uint32_t index, uint32_t axis)
{
    const uint32_t link = KC_LEVER_LINK(index);
    const uint32_t body = KC_LEVER_BODY(index) == KC_LEVER_TOOL ? KC_FRAME_TOOL : KC_LEVER_BODY(index);
    double r[3];
    if (link > KC_JOINT_MAX || KC_LEVER_BODY(index) > KC_JOINT_MAX) { return 0.0; }
    kc_v3_sub(loads->origin_m[body], loads->origin_m[link], r);
    return kc_v3_dot(r, loads->g_cross_m_s2[link][axis]);
}

static double variable(const kc_basis_t *b, const kc_ctx_t *ctx, const kc_loads_t *loads)
{
    switch ((kc_var_t)b->var) {
    case KC_VAR_Q: return of_joint(ctx->q, b->index);
    case KC_VAR_TAU: return of_joint(loads->tau, b->index);
    case KC_VAR_MX: return of_moment(loads, b->index, 0u);
    case KC_VAR_MY: return of_moment(loads, b->index, 1u);
    case KC_VAR_MZ: return of_moment(loads, b->index, 2u);
    case KC_VAR_DIR: return of_joint(ctx->dir, b->index);
    case KC_VAR_TEMP: return ctx->temp_c;
    case KC_VAR_T: return ctx->t_s;
    case KC_VAR_PAYLOAD: return ctx->payload_kg;
    case KC_VAR_RANGE: return ctx->range_m;
    case KC_VAR_INCID: return ctx->incid_rad;
    case KC_VAR_U: return ctx->u_norm;
    case KC_VAR_V: return ctx->v_norm;
    case KC_VAR_R2: return ctx->u_norm * ctx->u_norm + ctx->v_norm * ctx->v_norm;
    case KC_VAR_PAN: return ctx->pan_rad;
    case KC_VAR_TILT: return ctx->tilt_rad;
    case KC_VAR_QDOT: return of_joint(ctx->qdot, b->index);
    case KC_VAR_TAU_PAYLOAD: return of_joint(loads->tau_payload, b->index);
    case KC_VAR_XCAM: return ctx->p_cam_tool_m[0];
    case KC_VAR_YCAM: return ctx->p_cam_tool_m[1];
    case KC_VAR_ZCAM: return ctx->p_cam_tool_m[2];
    case KC_VAR_TAG: return ctx->tag;
    case KC_VAR_GX: return of_gravity(loads, b->index, 0u);
    case KC_VAR_GY: return of_gravity(loads, b->index, 1u);
    case KC_VAR_GZ: return of_gravity(loads, b->index, 2u);
    case KC_VAR_LEVX: return of_lever(loads, b->index, 0u);
    case KC_VAR_LEVY: return of_lever(loads, b->index, 1u);
    case KC_VAR_LEVZ: return of_lever(loads, b->index, 2u);
    case KC_VAR_PNP_TX:
    case KC_VAR_PNP_TY:
    case KC_VAR_PNP_TZ:
    case KC_VAR_PNP_RX:
    case KC_VAR_PNP_RY:
    case KC_VAR_PNP_RZ: return of_pnp(ctx, b->var, b->index);
    case KC_VAR_MOVE: return of_move(ctx, b->index);
    default: return 0.0; /* validated tables hold nothing else */
    }
}

static double tan_squared(double z)
{
    const double t = kc_tan(kc_clamp(z, -TAN_ARG_MAX, TAN_ARG_MAX));
    return t * t;
}

double kc_basis_eval(const kc_basis_t *b, const kc_ctx_t *ctx, const kc_loads_t *loads)
{
    if (b->var == KC_VAR_ONE) { return 1.0; }
    const double z = kc_clamp(b->c1 * (variable(b, ctx, loads) - b->c0), -ARG_MAX, ARG_MAX);
    switch ((kc_fn_t)b->fn) {
    case KC_FN_LIN: return z;
    case KC_FN_SIN: return kc_sin(z);
    case KC_FN_COS: return kc_cos(z);
    case KC_FN_TANH: return kc_tanh(z);
    case KC_FN_LN1P: return kc_log1p(kc_max(z, 0.0));
    case KC_FN_EXPN: return kc_exp(-kc_max(z, 0.0));
    case KC_FN_STEP: return z >= 0.0 ? 1.0 : 0.0;
    case KC_FN_SQ: return z * z;
    case KC_FN_TAN2: return tan_squared(z);
    case KC_FN_ABS: return kc_fabs(z);
    default: return 0.0; /* validated tables hold nothing else */
    }
}

bool kc_basis_needs_loads(const kc_basis_t *b)
{
    return b->var == KC_VAR_TAU || b->var == KC_VAR_MX || b->var == KC_VAR_MY || b->var == KC_VAR_MZ ||
           b->var == KC_VAR_TAU_PAYLOAD || (b->var >= KC_VAR_GX && b->var <= KC_VAR_LEVZ);
}
