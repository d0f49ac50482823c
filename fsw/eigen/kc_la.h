/* Linear algebra for the flight core: a C face over Eigen, in place on the caller's memory.
 *
 * Matrices are row-major with a leading dimension ld (distance between rows, >= columns).
 * n is at most KC_COEF_MAX unless said otherwise. Nothing allocates; a call uses at most 2 KiB of
 * stack. The order of every sum is fixed, so equal inputs give equal bits. */
#ifndef KC_LA_H
#define KC_LA_H

#include <stdint.h>

#include "kc_limits.h"
#include "kc_status.h"

#ifdef __cplusplus
extern "C" {
#endif

/* ---- Cholesky, A = L L^T, L in the lower triangle of A (upper triangle not read or written) ---- */

/* KC_ERR_NUM when A is not positive definite or not finite: A is spoiled then. O(n^3/3). */
kc_status_t kc_la_chol(double *A, uint32_t n, uint32_t ld);
/* x <- L^-1 x, x <- L^-T x, x <- (L L^T)^-1 x. */
void kc_la_solve_lower(const double *L, uint32_t n, uint32_t ld, double *x);
void kc_la_solve_lower_t(const double *L, uint32_t n, uint32_t ld, double *x);
void kc_la_chol_solve(const double *L, uint32_t n, uint32_t ld, double *x);
/* out <- (L L^T)^-1, full and symmetric; out may not alias L. O(n^3). */
void kc_la_chol_inverse(const double *L, uint32_t n, uint32_t ld, double *out, uint32_t ld_out);

/* ---- Packed lower triangle, row i at L[i (i+1)/2], any n: grown by one row at a time ---- */

/* Append row n: k = the new row of A without its diagonal (n values), kd = the diagonal.
 * KC_ERR_NUM, L unchanged in its first n rows, if the factor breaks down. O(n^2). */
kc_status_t kc_la_packed_append(double *L, uint32_t n, const double *k, double kd);
void kc_la_packed_solve(const double *L, uint32_t n, double *x);   /* x <- L^-1 x */
void kc_la_packed_solve_t(const double *L, uint32_t n, double *x); /* x <- L^-T x */

/* ---- Square-root information: R upper triangular n x n, right-hand side in column n (ld > n) ---- */

/* Fold six whitened rows [J | r], column after column: cols[6 j + k], n + 1 of them, spoiled, into [R | z] by
 * Householder reflections: R'R + J'J and R'z + J'r are kept. Rows that are missing are zero. Below the diagonal R is
 * neither read nor written; start from zeros. A column below 1e-145 counts as zero. Returns the part of |r|^2 that no
 * coefficient can explain. O(n^2). */
double kc_la_fold(double *R, uint32_t n, uint32_t ld, double *cols);
/* [R | z] becomes that of its m columns keep[0] < keep[1] < ..., as if the others had never been folded. O(n^2) for each
 * column that goes. */
void kc_la_take_columns(double *R, uint32_t n, uint32_t ld, const uint32_t *keep, uint32_t m);
/* x <- R^-1 x; X <- R^-T X of six right-hand sides side by side: rows[6 i + k]. No diagonal element may be zero. */
void kc_la_solve_upper(const double *R, uint32_t n, uint32_t ld, double *x);
void kc_la_solve_upper_t(const double *R, uint32_t n, uint32_t ld, double *rows);
/* H (n x n) <- rows and columns at[0] < at[1] < ... of R^T R, full and symmetric; y <- R^T x (y may not alias x). */
void kc_la_upper_gram(const double *R, uint32_t ld, const uint32_t *at, uint32_t n, double *H, uint32_t ldh);
void kc_la_upper_t_mul(const double *R, uint32_t n, uint32_t ld, const double *x, double *y);
/* C <- (R^T R)^-1, full and symmetric; C may not alias R. KC_ERR_NUM, C not valid, if a diagonal
 * element is zero or not finite. O(n^3). */
kc_status_t kc_la_upper_cov(const double *R, uint32_t n, uint32_t ld, double *C, uint32_t ldc);

/* Rank of R diag(scale), R upper triangular, by QR with column pivoting (Businger and Golub), in
 * place; below the diagonal R is taken as zero and overwritten, column n and on are left alone.
 *   perm[k]   column at place k, most independent first
 *   pivot[k]  |diagonal| at place k, not increasing but for rounding
 *   rank      pivots above tol * pivot[0] (0 if all are zero)
 * On return, for place j >= rank and i < rank, R[i ld + j] is the coefficient of column perm[i] in
 * column perm[j], in scaled units: R s e_perm[j] ~ sum_i R[i ld + j] R s e_perm[i].
 * Columns of equal norm (to 5e-10): the lowest index first. O(n^3). */
void kc_la_rank(double *R, uint32_t n, uint32_t ld, const double *scale, double tol, uint32_t *perm,
                double *pivot, uint32_t *rank);

/* ---- Small products ---- */

/* W <- L^-1 (m x m lower, ld 6, rest zero) of the leading m x m of cov = L L^T, m <= 6: W cov W^T = I.
 * KC_ERR_NUM, W not valid, if that is not positive definite. */
kc_status_t kc_la_whiten(const double cov[36], uint32_t m, double W[36]);
/* out <- W v, six numbers; out may alias v. */
void kc_la_whiten_apply(const double W[36], const double *v, double *out);
/* A += J J^T, lower triangle of A n x n, J n rows of six. */
void kc_la_rank_update(double *A, uint32_t n, uint32_t ld, const double *J);
/* The upper triangle of A as its lower one. */
void kc_la_mirror(double *A, uint32_t n, uint32_t ld);
/* out (6 x 6) <- J^T A J, A symmetric n x n of which the lower triangle is read, J n rows of six. Any n. */
void kc_la_congruence(const double *A, uint32_t n, uint32_t ld, const double *J, double out[36]);
/* The same for rows and columns idx[0] < idx[1] < ... of a larger A; the others of J would be multiplied by zeros. */
void kc_la_congruence_at(const double *A, uint32_t ld, const uint32_t *idx, uint32_t n, const double *J,
                         double out[36]);
/* out (n x m, ld m) <- A J, A n x n. Any n. */
void kc_la_mul(const double *A, uint32_t n, uint32_t ld, const double *J, uint32_t m, uint32_t ldj,
               double *out);

/* V += C^T J, C n x m, m even, J n and V m rows of six. Any n. */
void kc_la_add_mul_t(const double *C, uint32_t n, uint32_t m, const double *J, double *V);
/* Lower triangle of J J^T, row after row, of the first and the last three of each row of J apart: added to pos and rot,
 * each element rounded to a float. Any n. */
void kc_la_add_grams(const double *J, uint32_t n, float *pos, float *rot);

/* s[k] -= l_0 v[k] + l_1 v[ld + k] + ..., one after the other, n of them: four columns of v at once. Any n. */
void kc_la_take_four(const double *l, uint32_t n, const float *v, uint32_t ld, double s[4]);

/* ---- Chebyshev series ---- */

/* sum[k] <- w_0 U_0(x) + ... + w_n-1 U_n-1(x) with 2 x = x2[k], U of the second kind: four places at once. Any n. */
void kc_la_chebyshev(const double *w, uint32_t n, const double x2[4], double sum[4]);

#ifdef __cplusplus
}
#endif

#endif
