#include "kc_bounds.h"

#include <string.h>

#include "kc_vec.h"

#define TAN2_MAX 33.62 /* tan^2 where kc_basis.c cuts its argument off, 1.4 */
#define ARG_MAX 1e12   /* kc_basis.c clips arguments there */
#define ROUNDING (1.0 + 1e-6) /* bounds that the ground computed in another order */

/* ---- what was verified ---- */

/* The frame of the arm that stands for one of tool, camera and measured pose. */
static uint32_t arm_frame(uint32_t frame, uint32_t n)
{
    if (frame == KC_FRAME_CAMERA) { return 0u; }
    return frame > n ? n : frame;
}

double kc_bounds_verified(const kc_space_t *space, uint32_t frame, uint32_t comp)
{
    const uint32_t n = space->n_joints, f = arm_frame(frame, n);
    const bool angle = comp >= KC_RX;
    const bool x = comp == KC_TX || comp == KC_RX, z = comp == KC_TZ || comp == KC_RZ;
    double after = 0.0, before = 0.0;
    if (f > 0u) { after = angle ? space->verified[f - 1u].alpha_rad : space->verified[f - 1u].a_m; }
    if (f < n) { before = angle ? space->verified[f].phi_rad : space->verified[f].d_m; }
    if (f == 0u || (z && f < n)) { return before; }
    if (f == n || x) { return after; }
    return kc_min(before, after);
}

/* ---- how large a basis can be ---- */

/* From the origin of frame i - 1 to that of frame i, at most. */
static double link_length(const kc_joint_t *k)
{
    double d = kc_fabs(k->d_m);
    if (k->type == KC_PRISMATIC) { d += kc_max(kc_fabs(k->q_min), kc_fabs(k->q_max)); }
    return kc_fabs(k->a_m) + d;
}

/* Of everything beyond frame i: mass, mass times distance, and the distance of the tool, at most. */
typedef struct {
    double mass_kg, moment_kg_m, tool_m;
} stretch_t;

static stretch_t stretched(const kc_arm_t *arm, uint32_t i)
{
    stretch_t b = {0.0, 0.0, 0.0};
    for (uint32_t j = i; j < arm->n_joints; j++) {
        const kc_joint_t *k = &arm->joint[j];
        b.tool_m += link_length(k);
        if (k->has_mass == 0u) { continue; }
        b.mass_kg += k->mass_kg;
        b.moment_kg_m += k->mass_kg * (b.tool_m + kc_v3_norm(k->com_m));
    }
    b.tool_m += kc_v3_norm(arm->tool_xyz_m);
    return b;
}

static double gravity(const kc_arm_t *arm) { return kc_v3_norm(arm->gravity_m_s2); }

/* Gravity moment about a link [N m], with a payload. */
static double moment(const kc_arm_t *arm, uint32_t link)
{
    const stretch_t b = stretched(arm, link);
    return gravity(arm) * (b.moment_kg_m + KC_BOUNDS_PAYLOAD_KG * b.tool_m);
}

/* Gravity torque about a joint, or force along it; of the payload alone or of all. */
static double torque(const kc_arm_t *arm, uint32_t joint, bool payload)
{
    const stretch_t b = stretched(arm, joint - 1u);
    const bool slides = arm->joint[joint - 1u].type == KC_PRISMATIC;
    const double own = slides ? b.mass_kg : b.moment_kg_m;
    const double load = KC_BOUNDS_PAYLOAD_KG * (slides ? 1.0 : b.tool_m);
    return gravity(arm) * (payload ? load : own + load);
}

/* Moment of 1 kg about a link: no body is farther than the tool. */
static double lever(const kc_arm_t *arm, uint32_t index)
{
    return gravity(arm) * stretched(arm, KC_LEVER_LINK(index)).tool_m;
}

static const kc_joint_t *joint_of(const kc_arm_t *arm, const kc_basis_t *b)
{
    return &arm->joint[b->index - 1u];
}

/* Values of a variable. */
typedef struct {
    double lo, hi;
} range_t;

static range_t between(double lo, double hi) { return (range_t){lo, hi}; }

static range_t within(double size) { return between(-size, size); }

/* Not known: no bound on it holds. */
static range_t unbounded(void) { return within(ARG_MAX); }

#define RANGE_(number, NAME, index, from, name, unit, meaning, range, value) \
    case KC_VAR_##NAME: return (range);

/* index as kc_terms_validate allows */
static range_t range_of(const kc_arm_t *arm, const kc_basis_t *b)
{
    switch ((kc_var_t)b->var) {
        KC_VAR_LIST(RANGE_) /* NOLINT(bugprone-branch-clone): several have the same range */
    default: return unbounded();
    }
}

static double basis_size(const kc_arm_t *arm, const kc_basis_t *basis)
{
    if (basis->var == KC_VAR_ONE) { return 1.0; }
    const range_t x = range_of(arm, basis);
    const double far = kc_max(kc_fabs(x.lo - basis->c0), kc_fabs(x.hi - basis->c0));
    const double z = kc_min(kc_fabs(basis->c1) * far, ARG_MAX);
    switch ((kc_fn_t)basis->fn) {
    case KC_FN_LIN:
    case KC_FN_ABS: return z;
    case KC_FN_SIN:
    case KC_FN_TANH: return kc_min(z, 1.0);
    case KC_FN_LN1P: return kc_log1p(z);
    case KC_FN_SQ: return z * z;
    case KC_FN_TAN2: return TAN2_MAX;
    default: return 1.0; /* cos, step, expn */
    }
}

double kc_bounds_size(const kc_arm_t *arm, const kc_term_t *t)
{
    return kc_fabs(t->gain) * basis_size(arm, &t->basis[0]) * basis_size(arm, &t->basis[1]);
}

/* ---- the check ---- */

static double bound_of(const kc_coef_t *c)
{
    return c->enabled != 0u ? kc_max(kc_fabs(c->lb), kc_fabs(c->ub)) : 0.0;
}

kc_status_t kc_bounds_check(const kc_space_t *space, const kc_arm_t *arm, const kc_terms_t *terms,
                            kc_bounds_bad_t *bad)
{
    double sum[KC_FRAME_COUNT][6];
    memset(sum, 0, sizeof sum);
    memset(bad, 0, sizeof *bad);
    for (uint32_t k = 0u; k < terms->n_term; k++) {
        const kc_term_t *term = &terms->term[k];
        double *here = &sum[term->frame][term->comp];
        const double verified = kc_bounds_verified(space, term->frame, term->comp);
        const double bound = bound_of(&terms->coef[term->coef]);
        if (bound == 0.0) { continue; }
        *here += bound * kc_bounds_size(arm, term);
        if (*here <= ROUNDING * KC_BOUNDS_EXCESS * verified) { continue; }
        *bad = (kc_bounds_bad_t){term->coef, term->frame, term->comp, *here, verified};
        return KC_ERR_RANGE;
    }
    return KC_OK;
}

uint64_t kc_bounds_cost(uint32_t n_term) { return 3000u + 2000u * (uint64_t)n_term; }
