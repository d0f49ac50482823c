/* C face over Eigen: maps over the caller's memory and lazy products only, so no temporary is
 * larger than six numbers and no heap function is referenced. */
#include "kc_la.h"

#define EIGEN_NO_DEBUG
#include <Eigen/Core>

#include <cstring>

namespace {

using Eigen::Dynamic;
using Eigen::Index;
using Eigen::Map;
using Eigen::OuterStride;

template <typename M> using Strided = Map<M, Eigen::Unaligned, OuterStride<>>;
using Mat = Strided<Eigen::Matrix<double, Dynamic, Dynamic, Eigen::RowMajor>>;
using ConstMat = Strided<const Eigen::Matrix<double, Dynamic, Dynamic, Eigen::RowMajor>>;
using Vec = Map<Eigen::Matrix<double, Dynamic, 1>>;
using ConstVec = Map<const Eigen::Matrix<double, Dynamic, 1>>;

Mat mat(double *a, uint32_t rows, uint32_t cols, uint32_t ld)
{
    return Mat(a, Index(rows), Index(cols), OuterStride<>(Index(ld)));
}

ConstMat mat(const double *a, uint32_t rows, uint32_t cols, uint32_t ld)
{
    return ConstMat(a, Index(rows), Index(cols), OuterStride<>(Index(ld)));
}

/* A column whose norm^2 is below this counts as zero: where the numbers end, a reflection would divide by 0. */
constexpr double ZERO2 = 1e-290;

/* Householder vector (v0; b) for (alpha; b), |b|^2 = b2 > ZERO2: reflection I - beta v v' that
 * sends it to (r; 0). The sign of r is opposite to alpha's, so v0 does not cancel. */
struct Reflection {
    double r, v0, beta;
    Reflection(double alpha, double b2)
    {
        const double norm = std::sqrt(alpha * alpha + b2);
        r = alpha > 0.0 ? -norm : norm;
        v0 = alpha - r;
        beta = 2.0 / (v0 * v0 + b2);
    }
};

bool positive(double x) { return x > 0.0 && x <= std::numeric_limits<double>::max(); }

const double *packed_row(const double *L, uint32_t i) { return L + size_t(i) * (i + 1u) / 2u; }

/* Six numbers in pairs, for CPUs that compute two at once. Each operation is that of numbers one by one, in this order:
 * the bits are the same where the compiler takes the pairs apart. */
typedef double Pair __attribute__((vector_size(16)));

Pair pair(const double *from)
{
    Pair p;
    std::memcpy(&p, from, sizeof p);
    return p;
}

struct Six {
    Pair p[3];

    static Six of(const double *from) { return {{pair(from), pair(from + 2), pair(from + 4)}}; }
    void to(double *out) const
    {
        std::memcpy(out, &p[0], sizeof p[0]);
        std::memcpy(out + 2, &p[1], sizeof p[1]);
        std::memcpy(out + 4, &p[2], sizeof p[2]);
    }
    void take(double c, const Six &b) { p[0] -= c * b.p[0], p[1] -= c * b.p[1], p[2] -= c * b.p[2]; }
    void add(double c, const Six &b) { p[0] += c * b.p[0], p[1] += c * b.p[1], p[2] += c * b.p[2]; }
    double dot(const Six &b) const
    {
        const Pair s = p[0] * b.p[0] + p[1] * b.p[1] + p[2] * b.p[2];
        return s[0] + s[1];
    }
};

/* Norms^2 that differ by less than this part are equal: two names of one effect differ by rounding. */
constexpr double TIE = 1e-9;

/* Largest remaining column (norm^2 of rows k..n-1) for the pivoted QR; of equals the lowest index. */
uint32_t pivot_column(const Mat &R, uint32_t n, uint32_t k, const uint32_t *perm)
{
    uint32_t best = k;
    double best2 = R.col(Index(k)).tail(Index(n - k)).squaredNorm();
    for (uint32_t j = k + 1u; j < n; j++) {
        const double c2 = R.col(Index(j)).tail(Index(n - k)).squaredNorm();
        if (c2 > best2 * (1.0 + TIE) || (c2 >= best2 * (1.0 - TIE) && perm[j] < perm[best])) {
            best = j;
            best2 = c2;
        }
    }
    return best;
}

/* Reflect column k of R onto its diagonal and the columns right of it along. */
void reflect_column(Mat &R, uint32_t n, uint32_t k)
{
    const Index below = Index(n - k - 1u);
    auto b = R.col(Index(k)).tail(below);
    const double b2 = b.squaredNorm();
    if (!(b2 > ZERO2)) { return; }
    const Reflection h(R(k, k), b2);
    for (uint32_t j = k + 1u; j < n; j++) {
        auto c = R.col(Index(j)).tail(below);
        const double s = h.beta * (h.v0 * R(k, j) + b.dot(c));
        R(k, j) -= s * h.v0;
        c -= s * b;
    }
    R(k, k) = h.r;
    b.setZero();
}

/* J'AJ, place i of J belonging to row and column at(i) of A. Of half the products, since A is symmetric: with
 * r_i = A_i0 J_0 + ... + A_ii J_i / 2 it is the sum of J_i r_i' and its transpose, exactly symmetric. */
template <typename At>
void congruence(const double *A, uint32_t ld, uint32_t n, const double *J, At at, double *out)
{
    Six sum[6] = {}; /* row after row: two triangles */
    for (uint32_t i = 0u; i < n; i++) {
        const double *a = A + size_t(at(i)) * ld, *b = J + 6u * i;
        Six r = {};
        const double *to = J;
        for (uint32_t j = 0u; j < i; j++, to += 6) { r.add(a[at(j)], Six::of(to)); }
        r.add(0.5 * a[at(i)], Six::of(b));
        for (uint32_t k = 0u; k < 6u; k++) { sum[k].add(b[k], r); }
    }
    double half[36];
    std::memcpy(half, sum, sizeof half);
    for (uint32_t k = 0u; k < 6u; k++) {
        for (uint32_t l = 0u; l <= k; l++) {
            out[6u * k + l] = out[6u * l + k] = half[6u * k + l] + half[6u * l + k];
        }
    }
}

} /* namespace */

kc_status_t kc_la_chol(double *A, uint32_t n, uint32_t ld)
{
    Mat L = mat(A, n, n, ld);
    for (uint32_t j = 0u; j < n; j++) {
        const double d = L(j, j) - L.row(j).head(j).squaredNorm();
        if (!positive(d)) { return KC_ERR_NUM; }
        L(j, j) = std::sqrt(d);
        for (uint32_t i = j + 1u; i < n; i++) {
            L(i, j) = (L(i, j) - L.row(i).head(j).dot(L.row(j).head(j))) / L(j, j);
        }
    }
    return KC_OK;
}

void kc_la_solve_lower(const double *L, uint32_t n, uint32_t ld, double *x)
{
    const ConstMat M = mat(L, n, n, ld);
    Vec v(x, Index(n));
    for (uint32_t i = 0u; i < n; i++) {
        v(i) = (v(i) - M.row(i).head(i).transpose().dot(v.head(i))) / M(i, i);
    }
}

void kc_la_solve_lower_t(const double *L, uint32_t n, uint32_t ld, double *x)
{
    const ConstMat M = mat(L, n, n, ld);
    Vec v(x, Index(n));
    for (uint32_t i = n; i-- > 0u;) {
        v(i) /= M(i, i);
        v.head(i) -= v(i) * M.row(i).head(i).transpose();
    }
}

void kc_la_chol_solve(const double *L, uint32_t n, uint32_t ld, double *x)
{
    kc_la_solve_lower(L, n, ld, x);
    kc_la_solve_lower_t(L, n, ld, x);
}

void kc_la_chol_inverse(const double *L, uint32_t n, uint32_t ld, double *out, uint32_t ld_out)
{
    const ConstMat M = mat(L, n, n, ld);
    Mat C = mat(out, n, n, ld_out);
    /* Lower triangle of C = L^-1, column by column. */
    for (uint32_t j = 0u; j < n; j++) {
        C(j, j) = 1.0 / M(j, j);
        for (uint32_t i = j + 1u; i < n; i++) {
            const Index len = Index(i - j);
            C(i, j) = -M.row(i).segment(j, len).transpose().dot(C.col(j).segment(j, len)) / M(i, i);
        }
    }
    /* C = L^-T L^-1; row i of L^-1 is last used in row i, so this works in place. */
    for (uint32_t i = 0u; i < n; i++) {
        const Index len = Index(n - i);
        for (uint32_t j = 0u; j <= i; j++) { C(i, j) = C.col(i).tail(len).dot(C.col(j).tail(len)); }
    }
    for (uint32_t i = 0u; i < n; i++) {
        for (uint32_t j = 0u; j < i; j++) { C(j, i) = C(i, j); }
    }
}

kc_status_t kc_la_packed_append(double *L, uint32_t n, const double *k, double kd)
{
    Vec row(L + size_t(n) * (n + 1u) / 2u, Index(n) + 1);
    for (uint32_t i = 0u; i < n; i++) { row(i) = k[i]; }
    kc_la_packed_solve(L, n, row.data());
    const double d = kd - row.head(n).squaredNorm();
    if (!positive(d)) { return KC_ERR_NUM; }
    row(n) = std::sqrt(d);
    return KC_OK;
}

void kc_la_packed_solve(const double *L, uint32_t n, double *x)
{
    Vec v(x, Index(n));
    for (uint32_t i = 0u; i < n; i++) {
        const ConstVec row(packed_row(L, i), Index(i) + 1);
        v(i) = (v(i) - row.head(i).dot(v.head(i))) / row(i);
    }
}

void kc_la_packed_solve_t(const double *L, uint32_t n, double *x)
{
    Vec v(x, Index(n));
    for (uint32_t i = n; i-- > 0u;) {
        const ConstVec row(packed_row(L, i), Index(i) + 1);
        v(i) /= row(i);
        v.head(i) -= v(i) * row.head(i);
    }
}

double kc_la_fold(double *R, uint32_t n, uint32_t ld, double *cols)
{
    for (uint32_t k = 0u; k < n; k++) {
        double *u = R + size_t(k) * ld;
        const Six b = Six::of(cols + 6u * k);
        const double b2 = b.dot(b);
        if (b2 <= ZERO2) { continue; } /* NaN goes on, into the diagonal */
        const Reflection h(u[k], b2);
        u[k] = h.r;
        for (uint32_t j = k + 1u; j <= n; j++) {
            Six c = Six::of(cols + 6u * j);
            const double s = h.beta * (h.v0 * u[j] + b.dot(c));
            u[j] -= s * h.v0;
            c.take(s, b);
            c.to(cols + 6u * j);
        }
    }
    const Six rest = Six::of(cols + 6u * n);
    return rest.dot(rest);
}

void kc_la_take_columns(double *R, uint32_t n, uint32_t ld, const uint32_t *keep, uint32_t m)
{
    Mat U = mat(R, n, n + 1u, ld);
    for (uint32_t i = 0u; i < n; i++) {
        for (uint32_t k = 0u; k < m; k++) { U(i, k) = keep[k] >= i ? U(i, keep[k]) : 0.0; }
        U(i, m) = U(i, n);
    }
    for (uint32_t k = 0u; k < m; k++) { /* column k reaches down to row keep[k] */
        const Index below = Index(keep[k] - k);
        auto b = U.col(k).segment(k + 1u, below);
        const double b2 = below > 0 ? b.squaredNorm() : 0.0;
        if (!(b2 > ZERO2)) { continue; }
        const Reflection h(U(k, k), b2);
        for (uint32_t j = k + 1u; j <= m; j++) {
            auto c = U.col(j).segment(k + 1u, below);
            const double s = h.beta * (h.v0 * U(k, j) + b.dot(c));
            U(k, j) -= s * h.v0;
            c -= s * b;
        }
        U(k, k) = h.r;
    }
}

void kc_la_solve_upper(const double *R, uint32_t n, uint32_t ld, double *x)
{
    const ConstMat U = mat(R, n, n, ld);
    Vec v(x, Index(n));
    for (uint32_t i = n; i-- > 0u;) {
        const Index len = Index(n - i - 1u);
        v(i) = (v(i) - U.row(i).tail(len).transpose().dot(v.tail(len))) / U(i, i);
    }
}

void kc_la_solve_upper_t(const double *R, uint32_t n, uint32_t ld, double *rows)
{
    for (uint32_t i = 0u; i < n; i++) {
        const double *u = R + size_t(i) * ld;
        for (uint32_t k = 0u; k < 6u; k++) { rows[6u * i + k] /= u[i]; }
        const Six done = Six::of(rows + 6u * i);
        for (uint32_t j = i + 1u; j < n; j++) {
            Six v = Six::of(rows + 6u * j);
            v.take(u[j], done);
            v.to(rows + 6u * j);
        }
    }
}

void kc_la_upper_gram(const double *R, uint32_t ld, const uint32_t *at, uint32_t n, double *H, uint32_t ldh)
{
    for (uint32_t i = 0u; i < n; i++) {
        for (uint32_t j = 0u; j <= i; j++) {
            double s = 0.0;
            for (uint32_t k = 0u; k <= at[j]; k++) { s += R[k * ld + at[i]] * R[k * ld + at[j]]; }
            H[i * ldh + j] = H[j * ldh + i] = s;
        }
    }
}

void kc_la_upper_t_mul(const double *R, uint32_t n, uint32_t ld, const double *x, double *y)
{
    const ConstMat U = mat(R, n, n, ld);
    const ConstVec v(x, Index(n));
    for (uint32_t i = 0u; i < n; i++) { y[i] = U.col(i).head(i + 1u).dot(v.head(i + 1u)); }
}

kc_status_t kc_la_upper_cov(const double *R, uint32_t n, uint32_t ld, double *C, uint32_t ldc)
{
    const ConstMat U = mat(R, n, n, ld);
    Mat S = mat(C, n, n, ldc);
    for (uint32_t i = 0u; i < n; i++) {
        if (!positive(std::abs(U(i, i)))) { return KC_ERR_NUM; }
    }
    /* Upper triangle of S = R^-1, column by column from the diagonal up. */
    for (uint32_t j = 0u; j < n; j++) {
        S(j, j) = 1.0 / U(j, j);
        for (uint32_t i = j; i-- > 0u;) {
            const Index len = Index(j - i);
            S(i, j) = -U.row(i).segment(i + 1u, len).transpose().dot(S.col(j).segment(i + 1u, len)) / U(i, i);
        }
    }
    /* C = S S^T; element (i, j) of S is last used in element (i, j) of C. */
    for (uint32_t i = 0u; i < n; i++) {
        for (uint32_t j = i; j < n; j++) {
            const Index len = Index(n - j);
            S(i, j) = S.row(i).tail(len).dot(S.row(j).tail(len));
        }
    }
    for (uint32_t i = 0u; i < n; i++) {
        for (uint32_t j = 0u; j < i; j++) { S(i, j) = S(j, i); }
    }
    return KC_OK;
}

void kc_la_rank(double *R, uint32_t n, uint32_t ld, const double *scale, double tol, uint32_t *perm,
                double *pivot, uint32_t *rank)
{
    Mat U = mat(R, n, n, ld);
    for (uint32_t j = 0u; j < n; j++) {
        perm[j] = j;
        U.col(j).head(j + 1u) *= scale[j];
        U.col(j).tail(n - j - 1u).setZero();
    }
    for (uint32_t k = 0u; k < n; k++) {
        const uint32_t p = pivot_column(U, n, k, perm);
        if (p != k) {
            U.col(p).swap(U.col(k));
            const uint32_t t = perm[p];
            perm[p] = perm[k];
            perm[k] = t;
        }
        reflect_column(U, n, k);
        pivot[k] = std::abs(U(k, k));
    }
    uint32_t r = 0u;
    while (r < n && pivot[r] > tol * pivot[0]) { r++; }
    for (uint32_t j = r; j < n; j++) {
        for (uint32_t i = r; i-- > 0u;) {
            const Index len = Index(r - i - 1u);
            const double known = U.row(i).segment(i + 1u, len).transpose().dot(U.col(j).segment(i + 1u, len));
            U(i, j) = (U(i, j) - known) / U(i, i);
        }
    }
    *rank = r;
}

kc_status_t kc_la_whiten(const double cov[36], uint32_t m, double W[36])
{
    double L[36];
    Map<Eigen::Matrix<double, 6, 6, Eigen::RowMajor>> F(L), V(W);
    F = Map<const Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>(cov);
    V.setZero();
    if (m > 6u || kc_la_chol(L, m, 6u) != KC_OK) { return KC_ERR_NUM; }
    for (uint32_t j = 0u; j < m; j++) {
        V(j, j) = 1.0 / F(j, j);
        for (uint32_t i = j + 1u; i < m; i++) {
            const Index len = Index(i - j);
            V(i, j) = -F.row(i).segment(j, len).transpose().dot(V.col(j).segment(j, len)) / F(i, i);
        }
    }
    return KC_OK;
}

void kc_la_whiten_apply(const double W[36], const double *v, double *out)
{
    const double *w = W;
    const double a = v[0], b = v[1], c = v[2], d = v[3], e = v[4], f = v[5];
    out[5] = w[30] * a + w[31] * b + w[32] * c + w[33] * d + w[34] * e + w[35] * f;
    out[4] = w[24] * a + w[25] * b + w[26] * c + w[27] * d + w[28] * e;
    out[3] = w[18] * a + w[19] * b + w[20] * c + w[21] * d;
    out[2] = w[12] * a + w[13] * b + w[14] * c;
    out[1] = w[6] * a + w[7] * b;
    out[0] = w[0] * a;
}

void kc_la_rank_update(double *A, uint32_t n, uint32_t ld, const double *J)
{
    for (uint32_t i = 0u; i < n; i++) {
        const Six b = Six::of(J + 6u * i);
        double *a = A + size_t(i) * ld;
        for (uint32_t j = 0u; j <= i; j++) { a[j] += b.dot(Six::of(J + 6u * j)); }
    }
}

void kc_la_mirror(double *A, uint32_t n, uint32_t ld)
{
    Mat M = mat(A, n, n, ld);
    for (uint32_t i = 0u; i < n; i++) {
        for (uint32_t j = 0u; j < i; j++) { M(j, i) = M(i, j); }
    }
}

void kc_la_congruence(const double *A, uint32_t n, uint32_t ld, const double *J, double out[36])
{
    congruence(A, ld, n, J, [](uint32_t i) { return i; }, out);
}

void kc_la_congruence_at(const double *A, uint32_t ld, const uint32_t *idx, uint32_t n, const double *J,
                         double out[36])
{
    congruence(A, ld, n, J, [idx](uint32_t i) { return idx[i]; }, out);
}

void kc_la_mul(const double *A, uint32_t n, uint32_t ld, const double *J, uint32_t m, uint32_t ldj,
               double *out)
{
    mat(out, n, m, m).noalias() = mat(A, n, n, ld).lazyProduct(mat(J, n, m, ldj));
}
