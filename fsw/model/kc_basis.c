/* Bases: what a correction may depend on. */
#include "kc_terms.h"

#include "kc_vec.h"

typedef struct {
    uint8_t index, from;
} kind_t;

#define KIND_(number, NAME, index, from, name, unit, meaning, range, value) \
    [KC_VAR_##NAME] = {(uint8_t)KC_INDEX_##index, (uint8_t)KC_FROM_##from},
static const kind_t KIND[KC_VAR_COUNT] = {KC_VAR_LIST(KIND_)};

kc_var_index_t kc_var_index(uint32_t var)
{
    return var < (uint32_t)KC_VAR_COUNT ? (kc_var_index_t)KIND[var].index : KC_INDEX_NONE;
}

kc_var_from_t kc_var_from(uint32_t var)
{
    return var < (uint32_t)KC_VAR_COUNT ? (kc_var_from_t)KIND[var].from : KC_FROM_RECORD;
}

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

static double of_pnp(const kc_ctx_t *ctx, uint32_t comp, uint32_t column)
{
    return column <= KC_PNP_MAX ? ctx->pnp[comp][column] : 0.0;
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

#define VALUE_(number, NAME, index, from, name, unit, meaning, range, value) \
    case KC_VAR_##NAME: return (value);

static double variable(const kc_basis_t *b, const kc_ctx_t *ctx, const kc_loads_t *loads)
{
    switch ((kc_var_t)b->var) {
        KC_VAR_LIST(VALUE_)
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

bool kc_basis_needs_loads(const kc_basis_t *b) { return kc_var_from(b->var) == KC_FROM_LOADS; }
