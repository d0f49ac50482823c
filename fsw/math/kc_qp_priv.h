/* Parts of the QP, one job a file; nobody else includes this. */
#ifndef KC_QP_PRIV_H
#define KC_QP_PRIV_H

#include "kc_libm.h"
#include "kc_qp.h"

#define KC_QP_LD KC_COEF_MAX

/* -- kc_qp_kkt.c: where x stands -- */

/* grad = g + H x. */
void kc_qp_gradient(kc_qp_t *qp);
/* Keep variable i, or all, inside the box; on a bound it becomes fixed. */
void kc_qp_settle(kc_qp_t *qp, uint32_t i);
void kc_qp_settle_all(kc_qp_t *qp);
/* How far variable i is from the conditions: its gradient, unless a bound holds against it. */
static inline double kc_qp_violation(const kc_qp_t *qp, uint32_t i)
{
    const double g = qp->grad[i];
    if (g > 0.0 && qp->x[i] <= qp->lb[i]) { return 0.0; }
    if (g < 0.0 && qp->x[i] >= qp->ub[i]) { return 0.0; }
    return kc_fabs(g);
}
/* The worst of the free variables, or of all. */
double kc_qp_worst(const kc_qp_t *qp, bool all);
/* Is a gradient of this size rounding at x: 1e-14 of the largest sum of |terms| in a component? */
bool kc_qp_rounding(const kc_qp_t *qp, double gradient);
/* Does it count as zero: rounding, or what Newton's method could not improve on? */
bool kc_qp_negligible(const kc_qp_t *qp, double gradient);

/* -- kc_qp_factor.c: LDL' of the free block -- */

/* List the free variables in idx: those listed before keep their order, new ones follow. What this leaves of the
 * factor is kept: rows before the first change as they are, later ones up to that column. Then factor the rest.
 * strict: stop at the first variable that depends on those before it, and answer false; else its D is 0, and it
 * leaves no trace in later rows. */
bool kc_qp_factor(kc_qp_t *qp, bool strict);
/* Newton direction of the independent free variables; the dependent ones rest. */
void kc_qp_newton_direction(kc_qp_t *qp);
/* Downhill along the null direction of dependent variable k, a place in idx. */
void kc_qp_flat_direction(kc_qp_t *qp, uint32_t k);

/* -- the methods: one iteration; false where it cannot go on -- */

/* kc_qp_newton.c. False: the other method has to go on from x. */
bool kc_qp_newton_step(kc_qp_t *qp);
/* kc_qp_active.c. False: solved, or unbounded below (status). */
bool kc_qp_active_step(kc_qp_t *qp);

#endif
