#include "kc_terms.h"

#include <string.h>

#include "kc_check.h"
#include "kc_libm.h"

/* Typical sizes of a DH error, used for column scaling only. */
#define DH_SCALE_RAD 0.02
#define DH_SCALE_M 0.01

/* Joints whose number is one digit of a name. */
#define DH_JOINT_MAX (KC_JOINT_MAX < 9u ? KC_JOINT_MAX : 9u)

/* A body beyond a link that has a joint at its end. */
static bool lever_ok(uint32_t link, uint32_t body, uint32_t n_joints)
{
    return link < n_joints && (body == KC_LEVER_TOOL || (body > link && body <= n_joints));
}

/* Counted from 1. */
static bool one_of(uint32_t index, uint32_t n) { return index >= 1u && index <= n; }

/* Of what the ground alone evaluates: in flight none. */
static const uint32_t LAST[] = {[KC_INDEX_COLUMN] = KC_PNP_MAX, [KC_INDEX_MOVE] = KC_MOVE_MAX};

static bool index_ok(uint32_t var, uint32_t index, uint32_t n_joints)
{
    const kc_var_index_t kind = kc_var_index(var);
    switch (kind) {
    case KC_INDEX_JOINT: return one_of(index, n_joints);
    case KC_INDEX_LINK: return index <= n_joints;
    case KC_INDEX_LEVER: return lever_ok(KC_LEVER_LINK(index), KC_LEVER_BODY(index), n_joints);
    case KC_INDEX_COLUMN:
    case KC_INDEX_MOVE: return one_of(index, LAST[kind]);
    default: return index == 0u;
    }
}

static void check_basis(kc_check_t *c, const kc_basis_t *b, uint32_t n_joints, int32_t at)
{
    kc_check(c, b->fn < KC_FN_COUNT, at, b->fn);
    kc_check(c, b->var < KC_VAR_COUNT, at, b->var);
    kc_check(c, index_ok(b->var, b->index, n_joints), at, b->index);
    kc_check_finite(c, &b->c0, 1u, at);
    kc_check_finite(c, &b->c1, 1u, at);
    if (b->var != KC_VAR_ONE && (b->fn == KC_FN_SIN || b->fn == KC_FN_COS)) {
        kc_check(c, kc_fabs(b->c0 * b->c1) <= KC_ANGLE_MAX, at, b->c1);
    }
}

static void check_term(kc_check_t *c, const kc_terms_t *t, uint32_t k, uint32_t n_joints)
{
    const kc_term_t *term = &t->term[k];
    const int32_t at = KC_TERMS_INDEX_TERM + (int32_t)k;
    const bool special = term->frame >= KC_FRAME_TOOL && term->frame < KC_FRAME_COUNT;
    kc_check(c, term->coef < t->n_coef, at, term->coef);
    kc_check(c, term->frame <= n_joints || special, at, term->frame);
    kc_check(c, term->comp <= KC_RZ, at, term->comp);
    kc_check_finite(c, &term->gain, 1u, at);
    check_basis(c, &term->basis[0], n_joints, at);
    check_basis(c, &term->basis[1], n_joints, at);
}

static void check_coef(kc_check_t *c, const kc_coef_t *coef, int32_t at)
{
    kc_check(c, kc_name_ok(coef->name), at, 0.0);
    kc_check_finite(c, &coef->lb, 1u, at);
    kc_check_finite(c, &coef->ub, 1u, at);
    kc_check(c, coef->lb <= coef->ub, at, coef->lb);
    kc_check_not_negative(c, coef->prior_sigma, at);
    kc_check_positive(c, coef->scale, at);
    kc_check(c, coef->enabled <= 1u, at, coef->enabled);
}

kc_status_t kc_terms_validate(const kc_terms_t *t, uint32_t n_joints, int32_t *index, double *got)
{
    kc_check_t c = kc_check_start();
    kc_check(&c, n_joints >= 1u && n_joints <= KC_JOINT_MAX, -1, n_joints);
    kc_check(&c, t->n_coef <= KC_COEF_MAX, -1, t->n_coef);
    kc_check(&c, t->n_term <= KC_TERM_MAX, -1, t->n_term);
    if (c.st == KC_OK) {
        for (uint32_t k = 0u; k < t->n_coef; k++) { check_coef(&c, &t->coef[k], (int32_t)k); }
        for (uint32_t k = 0u; k < t->n_term; k++) { check_term(&c, t, k, n_joints); }
    }
    return kc_check_end(&c, index, got);
}

/* One of the four errors of a joint: what it is called and where it acts (kc_terms.h). */
typedef struct {
    const char *suffix;
    double scale;
    uint8_t frame_back; /* 1: at frame i-1, 0: at frame i */
    uint8_t comp;
} dh_error_t;

static const dh_error_t DH_ERROR[4] = {
    {".phi_rad", DH_SCALE_RAD, 1u, KC_RZ},
    {".alpha_rad", DH_SCALE_RAD, 0u, KC_RX},
    {".a_m", DH_SCALE_M, 0u, KC_TX},
    {".d_m", DH_SCALE_M, 1u, KC_TZ},
};

static void add_dh_error(kc_terms_t *t, uint32_t joint, const dh_error_t *e, double bound)
{
    kc_coef_t *coef = &t->coef[t->n_coef];
    kc_term_t *term = &t->term[t->n_term];
    memset(coef, 0, sizeof *coef);
    memset(term, 0, sizeof *term);
    coef->name[0] = 'J';
    coef->name[1] = (char)('0' + joint); /* 1 .. DH_JOINT_MAX */
    memcpy(coef->name + 2, e->suffix, strlen(e->suffix));
    coef->lb = -bound;
    coef->ub = bound;
    coef->scale = e->scale;
    coef->enabled = 1u;
    term->coef = (uint16_t)t->n_coef;
    term->frame = (uint8_t)(joint - e->frame_back);
    term->comp = e->comp;
    term->gain = 1.0; /* both bases zeroed: KC_VAR_ONE */
    t->n_coef++;
    t->n_term++;
}

kc_status_t kc_terms_add_dh(kc_terms_t *t, uint32_t n_joints, const double bound[4])
{
    if (n_joints > DH_JOINT_MAX || t->n_coef + 4u * n_joints > KC_COEF_MAX ||
        t->n_term + 4u * n_joints > KC_TERM_MAX) {
        return KC_ERR_FULL;
    }
    for (uint32_t j = 1u; j <= n_joints; j++) {
        for (uint32_t e = 0u; e < 4u; e++) { add_dh_error(t, j, &DH_ERROR[e], bound[e]); }
    }
    return KC_OK;
}
