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

void put(const Pair &p, double *to) { std::memcpy(to, &p, sizeof p); }

Pair floats(const float *from) { return Pair{double(from[0]), double(from[1])}; }

void add_floats(const Pair &p, float *to)
{
    to[0] += float(p[0]);
    to[1] += float(p[1]);
}

struct Six {
    Pair p[3];

    static Six of(const double *from) { return {{pair(from), pair(from + 2), pair(from + 4)}}; }
    void to(double *out) const
    {
        put(p[0], out);
        put(p[1], out + 2);
        put(p[2], out + 4);
    }
    void take(double c, const Six &b) { p[0] -= c * b.p[0], p[1] -= c * b.p[1], p[2] -= c * b.p[2]; }
    void add(double c, const Six &b) { p[0] += c * b.p[0], p[1] += c * b.p[1], p[2] += c * b.p[2]; }
    Pair parts(const Six &b) const { return p[0] * b.p[0] + p[1] * b.p[1] + p[2] * b.p[2]; }
    double dot(const Six &b) const
    {
        const Pair s = parts(b);
        return s[0] + s[1];
    }
    /* Its products with two others. */
    Pair dots(const Six &b, const Six &c) const
    {
        const Pair s = parts(b), t = parts(c);
        return Pair{s[0], t[0]} + Pair{s[1], t[1]};
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
 * r_i = A_i0 J_0 + ... + A_ii J_i / 2 it is the sum of J_i r_i' and its transpose, exactly symmetric. Two rows at a
 * time read J once; of an odd number, the first is alone. */
template <typename At>
void congruence(const double *A, uint32_t ld, uint32_t n, const double *J, At at, double *out)
{
    Six sum[6] = {}; /* row after row: two triangles */
    const uint32_t alone = n & 1u;
    if (alone != 0u) {
        Six r = {};
        r.add(0.5 * A[size_t(at(0u)) * ld + at(0u)], Six::of(J));
        for (uint32_t k = 0u; k < 6u; k++) { sum[k].add(J[k], r); }
    }
    for (uint32_t i = alone; i < n; i += 2u) {
        const double *a = A + size_t(at(i)) * ld, *b = A + size_t(at(i + 1u)) * ld, *own = J + 6u * i;
        Six r = {}, s = {};
        const double *to = J;
        for (uint32_t j = 0u; j < i; j++, to += 6) {
            const Six v = Six::of(to);
            r.add(a[at(j)], v);
            s.add(b[at(j)], v);
        }
        r.add(0.5 * a[at(i)], Six::of(own));
        s.add(b[at(i)], Six::of(own));
        s.add(0.5 * b[at(i + 1u)], Six::of(own + 6));
        for (uint32_t k = 0u; k < 6u; k++) {
            sum[k].add(own[k], r);
            sum[k].add(own[6u + k], s);
        }
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
        const uint32_t alone = (n - k) & 1u; /* two columns at a time; of an odd number, the first is alone */
        if (alone != 0u) {
            Six c = Six::of(cols + 6u * (k + 1u));
            const double s = h.beta * (h.v0 * u[k + 1u] + b.dot(c));
            u[k + 1u] -= s * h.v0;
            c.take(s, b);
            c.to(cols + 6u * (k + 1u));
        }
        double *col = cols + 6u * (k + 1u + alone);
        for (size_t j = k + 1u + alone; j <= n; j += 2u, col += 12) {
            Six c = Six::of(col), d = Six::of(col + 6);
            const Pair uj = pair(u + j), s = h.beta * (h.v0 * uj + b.dots(c, d));
            put(uj - s * h.v0, u + j);
            c.take(s[0], b);
            c.to(col);
            d.take(s[1], b);
            d.to(col + 6);
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
        const uint32_t alone = (i + 1u) & 1u; /* two places at a time; of an odd number, the first is alone */
        if (alone != 0u) { a[0] += b.dot(Six::of(J)); }
        const double *to = J + 6u * alone;
        for (size_t j = alone; j <= i; j += 2u, to += 12) {
            put(pair(a + j) + b.dots(Six::of(to), Six::of(to + 6)), a + j);
        }
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

void kc_la_add_mul_t(const double *C, uint32_t n, uint32_t m, const double *J, double *V)
{
    for (uint32_t k = 0u; k < m; k += 2u) { /* two rows at a time read J once */
        double *v = V + 6u * k;
        const double *c = C + k, *from = J;
        Six a = Six::of(v), b = Six::of(v + 6);
        for (uint32_t i = 0u; i < n; i++, c += m, from += 6) {
            const Six row = Six::of(from);
            a.add(c[0], row);
            b.add(c[1], row);
        }
        a.to(v);
        b.to(v + 6);
    }
}

void kc_la_add_grams(const double *J, uint32_t n, float *pos, float *rot)
{
    for (uint32_t i = 0u; i < n; i++) {
        const Six a = Six::of(J + 6u * i);
        const uint32_t alone = (i + 1u) & 1u; /* as in kc_la_rank_update */
        if (alone != 0u) {
            const Six b = Six::of(J);
            const Pair x = a.p[0] * b.p[0], y = a.p[1] * b.p[1], z = a.p[2] * b.p[2];
            pos[0] += float(x[0] + x[1] + y[0]);
            rot[0] += float(y[1] + z[0] + z[1]);
        }
        const double *to = J + 6u * alone;
        for (size_t j = alone; j <= i; j += 2u, to += 12) {
            const Six b = Six::of(to), c = Six::of(to + 6);
            const Pair x = a.p[0] * b.p[0], y = a.p[1] * b.p[1], z = a.p[2] * b.p[2];
            const Pair u = a.p[0] * c.p[0], v = a.p[1] * c.p[1], w = a.p[2] * c.p[2];
            add_floats(Pair{x[0], u[0]} + Pair{x[1], u[1]} + Pair{y[0], v[0]}, pos + j);
            add_floats(Pair{y[1], v[1]} + Pair{z[0], w[0]} + Pair{z[1], w[1]}, rot + j);
        }
        pos += i + 1u;
        rot += i + 1u;
    }
}

void kc_la_take_four(const double *l, uint32_t n, const float *v, uint32_t ld, double s[4])
{
    Pair a = pair(s), b = pair(s + 2);
    for (uint32_t j = 0u; j < n; j++, v += ld) {
        a -= l[j] * floats(v);
        b -= l[j] * floats(v + 2);
    }
    put(a, s);
    put(b, s + 2);
}

/* By Clenshaw: b_n = w_n + 2x b_{n+1} - b_{n+2}, the sum is b_0; two steps at a time, so that no b is moved. */
void kc_la_chebyshev(const double *w, uint32_t n, const double x2[4], double sum[4])
{
    const Pair x = pair(x2), y = pair(x2 + 2);
    Pair b1 = {}, b2 = {}, c1 = {}, c2 = {};
    size_t k = n;
    for (; k > 1u; k -= 2u) {
        b2 = w[k - 1u] + x * b1 - b2;
        c2 = w[k - 1u] + y * c1 - c2;
        b1 = w[k - 2u] + x * b2 - b1;
        c1 = w[k - 2u] + y * c2 - c1;
    }
    if (k == 1u) {
        b1 = w[0] + x * b1 - b2;
        c1 = w[0] + y * c1 - c2;
    }
    put(b1, sum);
    put(c1, sum + 2);
}
