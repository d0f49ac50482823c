/* Deterministic box-constrained convex QP (eq. 11), up to KC_COEF_MAX variables. */
#ifndef KC_QP_H
#define KC_QP_H

#include <stdbool.h>
#include <stdint.h>

#include "kc_limits.h"
#include "kc_status.h"

typedef enum { KC_QP_FREE = 0, KC_QP_AT_LOWER = 1, KC_QP_AT_UPPER = 2 } kc_qp_active_t;

/* Caller owns it; about 70 KiB of work space lives inside, none on the stack. */
typedef struct {
    /* in: minimise 1/2 x'Hx + g'x subject to lb <= x <= ub */
    uint32_t n;
    double H[KC_COEF_MAX * KC_COEF_MAX]; /* row-major, leading dimension KC_COEF_MAX;
                                            symmetric positive semidefinite */
    double g[KC_COEF_MAX];
    double lb[KC_COEF_MAX]; /* -HUGE_VAL allowed */
    double ub[KC_COEF_MAX]; /* +HUGE_VAL allowed */
    /* in and out: start (clipped into the box), then the solution */
    double x[KC_COEF_MAX];
    /* out */
    uint8_t active[KC_COEF_MAX]; /* kc_qp_active_t */
    double kkt;                  /* largest |projected gradient|, scaled by
                                    max(1, |g|_inf) */
    uint32_t iters;
    kc_status_t status; /* of kc_qp_solve */
    /* work */
    double g_max, H_max; /* largest |g|, largest |H| on the diagonal */
    double floor_g;      /* gradient that Newton's method could not improve on, because of rounding */
    uint32_t newton; /* iterations of projected Newton that are left; then the active-set method goes on */
    bool at_minimum; /* x is the minimum over the free variables, and all of grad is that at x */
    uint32_t m, rows; /* free variables, listed in idx; rows of their factor: none or all of them */
    uint32_t idx[KC_COEF_MAX];
    double L[KC_COEF_MAX * KC_COEF_MAX]; /* LDL' of their block of H: L D up to the diagonal, L' above it */
    double inv_d[KC_COEF_MAX]; /* 1 / D; 0: depends on those before it */
    double grad[KC_COEF_MAX];
    double d[KC_COEF_MAX]; /* direction of the free variables, in the order of idx */
    double q[KC_COEF_MAX]; /* H times it */
    double until[KC_COEF_MAX]; /* how far along it each may go */
} kc_qp_t;

/* Iterations allowed per variable; random problems need 3 to 8 in all, nearly singular ones about half a one a
 * variable, singular ones one to four. */
#define KC_QP_ITER_PER_VAR 20u

/* Solve. KC_OK: kkt <= 1e-9, or 1e-14 of the largest sum of |terms| in a gradient component, where
 * double precision ends (H x large against g). KC_ERR_ARG: n = 0 or too large, lb > ub, or something
 * not finite: x unchanged. KC_ERR_ITER: KC_QP_ITER_PER_VAR * n iterations done, x is feasible and the
 * best so far. KC_ERR_NUM: unbounded below (singular H, infinite bounds) or beyond all numbers, x feasible.
 * O(iterations * n^3); same bits for the same input. */
kc_status_t kc_qp_solve(kc_qp_t *qp);

/* The same in parts: begin, then iterate until it answers false; qp->status is what kc_qp_solve returns. */
void kc_qp_begin(kc_qp_t *qp);
bool kc_qp_iterate(kc_qp_t *qp);
/* Bound of the instructions of one iteration with n variables. */
uint64_t kc_qp_cost(uint32_t n);

#endif
