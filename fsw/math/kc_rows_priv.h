/* Sums of rows, inline: many independent sums side by side, so that none waits for another one. The order of the
 * operations of each is fixed. */
#ifndef KC_ROWS_PRIV_H
#define KC_ROWS_PRIV_H

#include <stdint.h>
#include <string.h>

/* Two numbers side by side, for CPUs that compute two at once; where the compiler takes them apart, the bits are the
 * same. */
typedef double kc_pair_t __attribute__((vector_size(16)));

static inline kc_pair_t kc_pair(const double *from)
{
    kc_pair_t p;
    memcpy(&p, from, sizeof p);
    return p;
}

/* y[k] -= c row[k], from <= k < to. */
static inline void kc_rows_take(double *y, const double *row, double c, uint32_t from, uint32_t to)
{
    for (uint32_t k = from; k < to; k++) { y[k] -= c * row[k]; }
}

/* The same for four rows, ld apart. */
static inline void kc_rows_take4(double *y, const double *rows, uint32_t ld, const double c[4], uint32_t from,
                                 uint32_t to)
{
    const double c0 = c[0], c1 = c[1], c2 = c[2], c3 = c[3];
    const double *r0 = rows, *r1 = &rows[ld], *r2 = &rows[2u * ld], *r3 = &rows[3u * ld];
    uint32_t k = from;
    for (; k + 2u <= to; k += 2u) {
        const kc_pair_t v = (kc_pair(&y[k]) - (c0 * kc_pair(&r0[k]) + c1 * kc_pair(&r1[k]))) -
                            (c2 * kc_pair(&r2[k]) + c3 * kc_pair(&r3[k]));
        memcpy(&y[k], &v, sizeof v);
    }
    if (k < to) { y[k] = (y[k] - (c0 * r0[k] + c1 * r1[k])) - (c2 * r2[k] + c3 * r3[k]); }
}

/* w <- U'^-1 w of four numbers, U with ones on its diagonal. */
static inline void kc_rows_forward4(const double *U, uint32_t ld, double *w)
{
    const double *r1 = &U[ld], *r2 = &r1[ld];
    w[1] -= w[0] * U[1];
    w[2] -= w[0] * U[2] + w[1] * r1[2];
    w[3] -= (w[0] * U[3] + w[1] * r1[3]) + w[2] * r2[3];
}

/* The same of its first m places. */
static inline void kc_rows_forward(const double *U, uint32_t ld, double *w, uint32_t m)
{
    uint32_t j = 0u;
    for (; j + 4u <= m; j += 4u) {
        kc_rows_forward4(&U[j * ld + j], ld, &w[j]);
        kc_rows_take4(w, &U[j * ld], ld, &w[j], j + 4u, m);
    }
    for (; j < m; j++) { kc_rows_take(w, &U[j * ld], w[j], j + 1u, m); }
}

/* w <- L'^-1 w for its first m places; inv_d: 1 / the diagonal of L. */
static inline void kc_rows_backward(const double *L, uint32_t ld, const double *inv_d, double *w, uint32_t m)
{
    uint32_t i = m;
    for (; i >= 4u; i -= 4u) {
        const uint32_t j = i - 4u;
        const double *r1 = &L[(j + 1u) * ld], *r2 = &r1[ld], *r3 = &r2[ld];
        w[j + 3u] *= inv_d[j + 3u];
        w[j + 2u] = (w[j + 2u] - w[j + 3u] * r3[j + 2u]) * inv_d[j + 2u];
        w[j + 1u] = (w[j + 1u] - (w[j + 3u] * r3[j + 1u] + w[j + 2u] * r2[j + 1u])) * inv_d[j + 1u];
        w[j] = (w[j] - ((w[j + 3u] * r3[j] + w[j + 2u] * r2[j]) + w[j + 1u] * r1[j])) * inv_d[j];
        kc_rows_take4(w, &L[j * ld], ld, &w[j], 0u, j);
    }
    for (uint32_t k = i; k-- > 0u;) {
        w[k] *= inv_d[k];
        kc_rows_take(w, &L[k * ld], w[k], 0u, k);
    }
}

#endif
