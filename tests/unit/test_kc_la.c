/* kc_la.cpp: every routine against its defining equation, leading dimensions larger than n. */
#include <math.h>
#include <string.h>

#include "given_dense.h"
#include "kc_la.h"
#include "unity.h"

#define LD 13u
#define N 9u

static double s_A[LD * LD], s_B[LD * LD], s_C[LD * LD];
static uint64_t s_rng;

void setUp(void)
{
    s_rng = 3u;
    for (uint32_t i = 0u; i < LD * LD; i++) {
        s_A[i] = drawn(&s_rng);
        s_B[i] = s_C[i] = i < N * LD ? -777.0 : -888.0; /* what must not be touched */
    }
}

/* s_B <- A A' + 0.1, positive definite; the rest of s_B keeps its mark. */
static void given_definite(void)
{
    for (uint32_t i = 0u; i < N; i++) {
        for (uint32_t j = 0u; j < N; j++) {
            double s = (i == j) ? 0.1 : 0.0;
            for (uint32_t k = 0u; k < N; k++) { s += s_A[i * LD + k] * s_A[j * LD + k]; }
            s_B[i * LD + j] = s;
        }
    }
}

/* s_A: upper triangle kept, diagonal away from zero, marks below it. */
static void given_upper(uint32_t n)
{
    for (uint32_t i = 0u; i < n; i++) {
        s_A[i * LD + i] += s_A[i * LD + i] > 0.0 ? 1.0 : -1.0;
        for (uint32_t j = 0u; j < i; j++) { s_A[i * LD + j] = 555.0; }
    }
}

void test_cholesky_gives_back_the_matrix_and_leaves_the_upper_triangle(void)
{
    given_definite();
    memcpy(s_C, s_B, sizeof s_C);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_la_chol(s_C, N, LD));
    for (uint32_t i = 0u; i < N; i++) {
        for (uint32_t j = 0u; j <= i; j++) {
            double s = 0.0;
            for (uint32_t k = 0u; k <= j; k++) { s += s_C[i * LD + k] * s_C[j * LD + k]; }
            TEST_ASSERT_DOUBLE_WITHIN(1e-14, s_B[i * LD + j], s);
        }
        for (uint32_t j = i + 1u; j < N; j++) { TEST_ASSERT_EQUAL_DOUBLE(s_B[i * LD + j], s_C[i * LD + j]); }
        TEST_ASSERT_EQUAL_DOUBLE(-777.0, s_C[i * LD + N]);
        TEST_ASSERT_EQUAL_DOUBLE(-888.0, s_C[N * LD + i]);
    }
}

void test_cholesky_refuses_what_is_not_positive_definite(void)
{
    double indefinite[4] = {1.0, 0.0, 2.0, 1.0}, nan[4] = {1.0, 0.0, NAN, 1.0}, inf[1] = {INFINITY},
           zero[1] = {0.0};
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, kc_la_chol(indefinite, 2u, 2u));
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, kc_la_chol(nan, 2u, 2u));
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, kc_la_chol(inf, 1u, 1u));
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, kc_la_chol(zero, 1u, 1u));
}

void test_cholesky_solve_solves(void)
{
    double x[N], b[N];
    given_definite();
    memcpy(s_C, s_B, sizeof s_C);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_la_chol(s_C, N, LD));
    for (uint32_t i = 0u; i < N; i++) { x[i] = b[i] = drawn(&s_rng); }
    kc_la_chol_solve(s_C, N, LD, x);
    for (uint32_t i = 0u; i < N; i++) {
        double s = 0.0;
        for (uint32_t j = 0u; j < N; j++) { s += s_B[i * LD + j] * x[j]; }
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, b[i], s);
    }
}

static void assert_inverse(const double *A, const double *inv)
{
    for (uint32_t i = 0u; i < N; i++) {
        for (uint32_t j = 0u; j < N; j++) {
            double s = 0.0;
            for (uint32_t k = 0u; k < N; k++) { s += A[i * LD + k] * inv[k * LD + j]; }
            TEST_ASSERT_DOUBLE_WITHIN(1e-11, i == j ? 1.0 : 0.0, s);
            TEST_ASSERT_EQUAL_DOUBLE(inv[j * LD + i], inv[i * LD + j]);
        }
        TEST_ASSERT_EQUAL_DOUBLE(-777.0, inv[i * LD + N]);
        TEST_ASSERT_EQUAL_DOUBLE(-888.0, inv[N * LD + i]);
    }
}

void test_cholesky_inverse_inverts(void)
{
    static double L[LD * LD];
    given_definite();
    memcpy(L, s_B, sizeof L);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_la_chol(L, N, LD));
    kc_la_chol_inverse(L, N, LD, s_C, LD);
    assert_inverse(s_B, s_C);
}

void test_packed_rows_appended_one_by_one_are_the_cholesky_factor(void)
{
    double packed[N * (N + 1u) / 2u], x[N], y[N];
    given_definite();
    for (uint32_t i = 0u; i < N; i++) {
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_la_packed_append(packed, i, &s_B[i * LD], s_B[i * LD + i]));
    }
    memcpy(s_C, s_B, sizeof s_C);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_la_chol(s_C, N, LD));
    for (uint32_t i = 0u; i < N; i++) {
        for (uint32_t j = 0u; j <= i; j++) {
            TEST_ASSERT_DOUBLE_WITHIN(1e-14, s_C[i * LD + j], packed[i * (i + 1u) / 2u + j]);
        }
        x[i] = y[i] = drawn(&s_rng);
    }
    kc_la_packed_solve(packed, N, x);
    kc_la_solve_lower(s_C, N, LD, y);
    for (uint32_t i = 0u; i < N; i++) { TEST_ASSERT_DOUBLE_WITHIN(1e-12, y[i], x[i]); }
    kc_la_packed_solve_t(packed, N, x);
    kc_la_solve_lower_t(s_C, N, LD, y);
    for (uint32_t i = 0u; i < N; i++) { TEST_ASSERT_DOUBLE_WITHIN(1e-12, y[i], x[i]); }
}

void test_a_repeated_row_breaks_the_packed_factor_and_leaves_the_rest(void)
{
    double L[3] = {2.0, -1.0, -1.0};
    const double same[1] = {4.0};
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, kc_la_packed_append(L, 1u, same, 4.0));
    TEST_ASSERT_EQUAL_DOUBLE(2.0, L[0]);
}

/* R'R and R'z after folding rows = sums over the rows; |rest|^2 = what least squares leaves. */
void test_folding_rows_keeps_the_normal_equations(void)
{
    const uint32_t n = 5u, ld = 8u;
    double R[5 * 8] = {0.0}, M[36] = {0.0}, rest = 0.0;
    for (uint32_t i = 1u; i < n; i++) { R[i * ld] = 555.0; } /* below the diagonal: not read */
    for (uint32_t rows = 1u; rows <= 6u; rows++) {
        double blk[6][6]; /* column after column; rows that are missing are zero */
        for (uint32_t i = 0u; i <= n; i++) {
            for (uint32_t r = 0u; r < 6u; r++) { blk[i][r] = r < rows ? drawn(&s_rng) : 0.0; }
        }
        for (uint32_t r = 0u; r < rows; r++) {
            for (uint32_t i = 0u; i <= n; i++) {
                for (uint32_t j = 0u; j <= n; j++) { M[i * 6u + j] += blk[i][r] * blk[j][r]; }
            }
        }
        rest += kc_la_fold(R, n, ld, blk[0]);
    }
    for (uint32_t i = 0u; i <= n; i++) {
        for (uint32_t j = i; j <= n; j++) {
            double s = (i == n) ? rest : 0.0;
            for (uint32_t k = 0u; k < n && k <= i; k++) { s += R[k * ld + i] * R[k * ld + j]; }
            TEST_ASSERT_DOUBLE_WITHIN(1e-13, M[i * 6u + j], s);
        }
    }
    TEST_ASSERT_EQUAL_DOUBLE(555.0, R[4u * ld]);
}

/* As if only the columns that stay had been folded: the same normal equations, upper triangular. */
void test_taking_columns_forgets_the_others(void)
{
    static const uint32_t keep[][3] = {{1u, 3u, 4u}, {0u, 1u, 2u}, {2u, 3u, 4u}, {0u, 2u, 4u}};
    const uint32_t n = 5u, ld = 8u, m = 3u;
    for (uint32_t set = 0u; set < sizeof keep / sizeof keep[0]; set++) {
        double R[5 * 8] = {0.0}, before[5 * 8];
        for (uint32_t i = 0u; i < n; i++) {
            for (uint32_t j = 0u; j <= n; j++) { R[i * ld + j] = j >= i ? drawn(&s_rng) : 555.0; }
        }
        memcpy(before, R, sizeof R);
        kc_la_take_columns(R, n, ld, keep[set], m);
        for (uint32_t i = 0u; i < m; i++) {
            for (uint32_t j = i; j <= m; j++) {
                const uint32_t a = keep[set][i], b = j < m ? keep[set][j] : n;
                double want = 0.0, got = 0.0;
                for (uint32_t k = 0u; k <= a; k++) { want += before[k * ld + a] * before[k * ld + b]; }
                for (uint32_t k = 0u; k <= i; k++) { got += R[k * ld + i] * R[k * ld + j]; }
                TEST_ASSERT_DOUBLE_WITHIN(1e-13, want, got);
            }
        }
    }
}

void test_taking_all_columns_changes_nothing_and_taking_none_leaves_the_right_hand_side(void)
{
    double R[2 * 3] = {1.0, 2.0, 3.0, 0.0, 4.0, 5.0};
    const double want[6] = {1.0, 2.0, 3.0, 0.0, 4.0, 5.0};
    const uint32_t keep[2] = {0u, 1u};
    kc_la_take_columns(R, 2u, 3u, keep, 2u);
    TEST_ASSERT_EQUAL_MEMORY(want, R, sizeof want);
    kc_la_take_columns(R, 2u, 3u, keep, 0u);
    TEST_ASSERT_EQUAL_DOUBLE(3.0, R[0]);
}

void test_taking_a_column_of_zeros_changes_nothing(void)
{
    double R[2 * 3] = {0.0, 0.0, 3.0, 0.0, 0.0, 5.0};
    const uint32_t keep[1] = {1u};
    kc_la_take_columns(R, 2u, 3u, keep, 1u);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, R[0]);
    TEST_ASSERT_EQUAL_DOUBLE(3.0, R[1]);
}

void test_folding_zeros_changes_nothing(void)
{
    double R[2 * 3] = {1.0, 2.0, 3.0, 0.0, 4.0, 5.0}, blk[3 * 6] = {0.0};
    const double want[6] = {1.0, 2.0, 3.0, 0.0, 4.0, 5.0};
    TEST_ASSERT_EQUAL_DOUBLE(0.0, kc_la_fold(R, 2u, 3u, blk));
    TEST_ASSERT_EQUAL_MEMORY(want, R, sizeof want);
}

/* Rows of an effect that died away, exp(-355): its squares are where the numbers end. The other column is fitted as
 * if it were alone, 2 x = 2 and 1 x = 1, and the rank is that of the other. */
void test_a_column_that_is_almost_zero_spoils_nothing(void)
{
    static const double tiny[] = {1e-154, 3e-158, 1e-161, 5e-324};
    for (uint32_t i = 0u; i < sizeof tiny / sizeof tiny[0]; i++) {
        double R[2 * 3] = {0.0}, x[2] = {0.0, 0.0};
        double blk[3 * 6] = {[0] = tiny[i], [1] = -tiny[i], [6] = 2.0, [7] = 1.0, [12] = 2.0, [13] = 1.0};
        const double rest = kc_la_fold(R, 2u, 3u, blk);
        TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.0, rest);
        TEST_ASSERT_DOUBLE_WITHIN(1e-15, sqrt(5.0), fabs(R[4]));
        TEST_ASSERT_DOUBLE_WITHIN(1e-15, 1.0, R[5] / R[4]);
        uint32_t perm[2], rank;
        double pivot[2];
        x[0] = x[1] = 1.0;
        kc_la_rank(R, 2u, 3u, x, 1e-9, perm, pivot, &rank);
        TEST_ASSERT_EQUAL_UINT32(1u, rank);
        TEST_ASSERT_EQUAL_UINT32(1u, perm[0]);
    }
}

void test_upper_solves_and_products_undo_each_other(void)
{
    double x[N], y[N + 1u], z[N], side[6u * N + 1u];
    y[N] = side[6u * N] = 77.0;
    given_upper(N);
    for (uint32_t i = 0u; i < N; i++) { x[i] = drawn(&s_rng); }
    kc_la_upper_t_mul(s_A, N, LD, x, y);
    for (uint32_t i = 0u; i < 6u * N; i++) { side[i] = y[i / 6u] * (1.0 + (double)(i % 6u)); }
    kc_la_solve_upper_t(s_A, N, LD, side);
    for (uint32_t i = 0u; i < 6u * N; i++) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-10, x[i / 6u] * (1.0 + (double)(i % 6u)), side[i]);
    }
    TEST_ASSERT_EQUAL_DOUBLE(77.0, side[6u * N]);
    for (uint32_t i = 0u; i < N; i++) {
        z[i] = 0.0;
        for (uint32_t j = i; j < N; j++) { z[i] += s_A[i * LD + j] * x[j]; }
    }
    kc_la_solve_upper(s_A, N, LD, z);
    for (uint32_t i = 0u; i < N; i++) { TEST_ASSERT_DOUBLE_WITHIN(1e-11, x[i], z[i]); }
    TEST_ASSERT_EQUAL_DOUBLE(77.0, y[N]); /* N numbers */
}

void test_the_covariance_inverts_the_information(void)
{
    static double H[LD * LD];
    uint32_t all[N];
    given_upper(N);
    for (uint32_t i = 0u; i < N; i++) { all[i] = i; }
    for (uint32_t i = 0u; i < LD * LD; i++) { H[i] = 77.0; }
    kc_la_upper_gram(s_A, LD, all, N, H, LD);
    for (uint32_t i = 0u; i < LD; i++) { TEST_ASSERT_EQUAL_DOUBLE(77.0, H[N * LD + i]); }
    s_A[N * LD + N] = 0.0; /* not part of it */
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_la_upper_cov(s_A, N, LD, s_C, LD));
    assert_inverse(H, s_C);
}

void test_the_gram_matrix_of_some_columns(void)
{
    static double H[LD * LD];
    double some[9];
    const uint32_t at[3] = {0u, 2u, 5u};
    uint32_t all[N];
    given_upper(N);
    for (uint32_t i = 0u; i < N; i++) { all[i] = i; }
    kc_la_upper_gram(s_A, LD, all, N, H, LD);
    kc_la_upper_gram(s_A, LD, at, 3u, some, 3u);
    for (uint32_t i = 0u; i < 9u; i++) { TEST_ASSERT_EQUAL_DOUBLE(H[at[i / 3u] * LD + at[i % 3u]], some[i]); }
}

void test_no_covariance_of_a_singular_factor(void)
{
    double R[4] = {1.0, 2.0, 0.0, 0.0}, C[4];
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, kc_la_upper_cov(R, 2u, 2u, C, 2u));
    R[3] = NAN;
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, kc_la_upper_cov(R, 2u, 2u, C, 2u));
}

static double s_scale[LD], s_pivot[LD];
static uint32_t s_perm[LD], s_rank;

static void given_unit_scale(void)
{
    for (uint32_t i = 0u; i < LD; i++) { s_scale[i] = 1.0; }
}

void test_dependent_columns_are_named_with_their_coefficients(void)
{
    /* Columns: c0, c1, c2 = 2 c0 - 3 c1, c3 (upper triangular on purpose). */
    double R[16] = {9.0, 1.0, 15.0, 0.5, 0.0, 4.0, -12.0, 0.25, 0.0, 0.0, 0.0, 0.125, 0.0, 0.0, 0.0, 7.0};
    given_unit_scale();
    kc_la_rank(R, 4u, 4u, s_scale, 1e-10, s_perm, s_pivot, &s_rank);
    TEST_ASSERT_EQUAL_UINT32(3u, s_rank);
    TEST_ASSERT_TRUE(s_pivot[3] < 1e-14);
    /* Longest first: c2 (19.2), then two of the others; the last is the combination. */
    TEST_ASSERT_EQUAL_UINT32(2u, s_perm[0]);
    TEST_ASSERT_EQUAL_UINT32(1u, s_perm[3]);
    /* c1 = 2/3 c0 - 1/3 c2 */
    for (uint32_t i = 0u; i < 3u; i++) {
        const double want = s_perm[i] == 0u ? 2.0 / 3.0 : s_perm[i] == 2u ? -1.0 / 3.0 : 0.0;
        TEST_ASSERT_DOUBLE_WITHIN(1e-14, want, R[i * 4u + 3u]);
    }
}

/* Six columns, of which the third and the last are combinations of those before them: by the coefficients that are
 * returned, whichever were taken, each dependent column is the sum it is said to be. */
void test_several_dependent_columns_are_the_sums_that_are_returned(void)
{
    enum { n = 6, ld = 7 };
    double A[n * ld], R[n * ld];
    given_unit_scale();
    for (uint32_t i = 0u; i < n; i++) {
        s_scale[i] = 1.0 + 0.25 * (double)i;
        for (uint32_t j = 0u; j < n; j++) {
            A[i * ld + j] = j < i ? 0.0 : j == i ? 3.0 + (double)i : drawn(&s_rng);
        }
        A[i * ld + n] = 555.0;
    }
    for (uint32_t i = 0u; i < n; i++) {
        A[i * ld + 2u] = 0.5 * A[i * ld] - 0.3 * A[i * ld + 1u];
        A[i * ld + 5u] = 0.7 * A[i * ld] + 0.2 * A[i * ld + 1u] - 0.4 * A[i * ld + 3u] + 0.1 * A[i * ld + 4u];
    }
    memcpy(R, A, sizeof R);
    kc_la_rank(R, n, ld, s_scale, 1e-10, s_perm, s_pivot, &s_rank);
    TEST_ASSERT_EQUAL_UINT32(4u, s_rank);
    for (uint32_t j = s_rank; j < n; j++) {
        for (uint32_t row = 0u; row < n; row++) {
            double sum = 0.0;
            for (uint32_t i = 0u; i < s_rank; i++) {
                sum += R[i * ld + j] * A[row * ld + s_perm[i]] * s_scale[s_perm[i]];
            }
            TEST_ASSERT_DOUBLE_WITHIN(1e-13, A[row * ld + s_perm[j]] * s_scale[s_perm[j]], sum);
        }
    }
    for (uint32_t i = 0u; i < n; i++) { TEST_ASSERT_EQUAL_DOUBLE(555.0, R[i * ld + n]); }
}

void test_scales_decide_what_counts_as_dependent(void)
{
    double R[4] = {1.0, 0.0, 0.0, 1e-12};
    given_unit_scale();
    kc_la_rank(R, 2u, 2u, s_scale, 1e-10, s_perm, s_pivot, &s_rank);
    TEST_ASSERT_EQUAL_UINT32(1u, s_rank);
    R[0] = 1.0;
    R[1] = R[2] = 0.0;
    R[3] = 1e-12;
    s_scale[1] = 1e12;
    kc_la_rank(R, 2u, 2u, s_scale, 1e-10, s_perm, s_pivot, &s_rank);
    TEST_ASSERT_EQUAL_UINT32(2u, s_rank);
}

void test_equal_columns_keep_the_order_of_their_indices(void)
{
    double R[25] = {0.0};
    for (uint32_t i = 0u; i < 5u; i++) { R[6u * i] = (i == 3u) ? 2.0 : 1.0; }
    given_unit_scale();
    s_pivot[5] = 1e9; /* not one of them */
    kc_la_rank(R, 5u, 5u, s_scale, 1e-10, s_perm, s_pivot, &s_rank);
    const uint32_t want[5] = {3u, 0u, 1u, 2u, 4u};
    TEST_ASSERT_EQUAL_UINT32_ARRAY(want, s_perm, 5);
    TEST_ASSERT_EQUAL_UINT32(5u, s_rank);
}

void test_nothing_has_rank_zero(void)
{
    double R[4] = {0.0, 0.0, 555.0, 0.0};
    given_unit_scale();
    kc_la_rank(R, 2u, 2u, s_scale, 1e-10, s_perm, s_pivot, &s_rank);
    TEST_ASSERT_EQUAL_UINT32(0u, s_rank);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_pivot[0]);
}

void test_whitening_makes_the_covariance_the_identity(void)
{
    double cov[36] = {0.0}, W[36], v[6] = {0.0}, w[6];
    for (uint32_t i = 0u; i < 6u; i++) {
        for (uint32_t j = 0u; j < 6u; j++) {
            for (uint32_t k = 0u; k < 6u; k++) { cov[6u * i + j] += s_A[i * LD + k] * s_A[j * LD + k]; }
        }
        cov[7u * i] += 0.2;
    }
    for (uint32_t m = 1u; m <= 6u; m++) {
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_la_whiten(cov, m, W));
        for (uint32_t i = 0u; i < 36u; i++) {
            if (i % 6u > i / 6u || i / 6u >= m) { TEST_ASSERT_EQUAL_DOUBLE(0.0, W[i]); }
        }
        for (uint32_t i = 0u; i < m; i++) {
            for (uint32_t j = 0u; j < m; j++) { v[j] = cov[6u * i + j]; }
            kc_la_whiten_apply(W, v, v); /* in place: row i of cov W' */
            for (uint32_t k = 0u; k < m; k++) { s_C[i * LD + k] = v[k]; }
        }
        for (uint32_t k = 0u; k < m; k++) {
            for (uint32_t i = 0u; i < m; i++) { v[i] = s_C[i * LD + k]; }
            kc_la_whiten_apply(W, v, w);
            for (uint32_t i = 0u; i < m; i++) { TEST_ASSERT_DOUBLE_WITHIN(1e-12, i == k ? 1.0 : 0.0, w[i]); }
        }
    }
}

void test_whitening_refuses_a_covariance_that_is_none(void)
{
    double cov[36] = {0.0}, W[36];
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, kc_la_whiten(cov, 6u, W));
    for (uint32_t i = 0u; i < 6u; i++) { cov[7u * i] = 1.0; }
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_la_whiten(cov, 6u, W));
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, kc_la_whiten(cov, 7u, W));
    cov[7] = -1.0;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_la_whiten(cov, 1u, W)); /* only the leading block counts */
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, kc_la_whiten(cov, 2u, W));
}

void test_small_products_are_what_they_say(void)
{
    const uint32_t m = 4u, ldj = 6u, at[3] = {1u, 4u, 6u};
    double J[N * 6], part[3 * 6], C[36], P[36], out[N * 4];
    given_definite();
    for (uint32_t i = 0u; i < N * 6u; i++) { J[i] = drawn(&s_rng); }
    kc_la_mul(s_B, N, LD, J, m, ldj, out);
    memcpy(s_C, s_B, sizeof s_C);
    for (uint32_t i = 0u; i < N; i++) { /* the upper triangle is not read */
        for (uint32_t j = i + 1u; j < N; j++) { s_C[i * LD + j] = 555.0; }
    }
    kc_la_congruence(s_C, N, LD, J, C);
    for (uint32_t i = 0u; i < 18u; i++) { part[i] = J[6u * at[i / 6u] + i % 6u]; }
    kc_la_congruence_at(s_C, LD, at, 3u, part, P);
    kc_la_rank_update(s_C, N, LD, J);
    kc_la_mirror(s_C, N, LD);
    for (uint32_t i = 0u; i < N; i++) {
        for (uint32_t c = 0u; c < m; c++) {
            double s = 0.0;
            for (uint32_t k = 0u; k < N; k++) { s += s_B[i * LD + k] * J[k * ldj + c]; }
            TEST_ASSERT_DOUBLE_WITHIN(1e-13, s, out[i * m + c]);
        }
        for (uint32_t j = 0u; j < N; j++) {
            double s = s_B[i * LD + j];
            for (uint32_t c = 0u; c < 6u; c++) { s += J[i * ldj + c] * J[j * ldj + c]; }
            TEST_ASSERT_DOUBLE_WITHIN(1e-13, s, s_C[i * LD + j]);
        }
    }
    /* nothing beyond n x n */
    TEST_ASSERT_EQUAL_MEMORY(&s_B[N * LD], &s_C[N * LD], (LD - N) * LD * sizeof(double));
    for (uint32_t a = 0u; a < 6u; a++) {
        for (uint32_t b = 0u; b < 6u; b++) {
            double s = 0.0, p = 0.0;
            for (uint32_t k = 0u; k < N; k++) {
                for (uint32_t l = 0u; l < N; l++) { s += J[6u * k + a] * s_B[k * LD + l] * J[6u * l + b]; }
            }
            for (uint32_t k = 0u; k < 9u; k++) {
                const uint32_t i = at[k / 3u], j = at[k % 3u];
                p += J[6u * i + a] * s_B[i * LD + j] * J[6u * j + b];
            }
            TEST_ASSERT_DOUBLE_WITHIN(1e-12, s, C[a * 6u + b]);
            TEST_ASSERT_DOUBLE_WITHIN(1e-12, p, P[a * 6u + b]);
            TEST_ASSERT_EQUAL_MEMORY(&C[b * 6u + a], &C[a * 6u + b], sizeof(double)); /* to the bit */
        }
    }
}

void test_packed_solves_leave_what_is_behind_the_vector(void)
{
    const double L[6] = {2.0, 1.0, 4.0, 3.0, 5.0, 7.0};
    double x[3] = {4.0, 10.0, 99.0};
    kc_la_packed_solve(L, 2u, x);
    TEST_ASSERT_EQUAL_DOUBLE(2.0, x[0]);
    TEST_ASSERT_EQUAL_DOUBLE(2.0, x[1]);
    TEST_ASSERT_EQUAL_DOUBLE(99.0, x[2]);
    kc_la_packed_solve_t(L, 2u, x);
    TEST_ASSERT_EQUAL_DOUBLE(0.5, x[1]);
    TEST_ASSERT_EQUAL_DOUBLE(0.75, x[0]);
    TEST_ASSERT_EQUAL_DOUBLE(99.0, x[2]);
}

/* Two numbers in, two out; the third stays. L = [2 0; 1 4] and its transpose R. */
void test_solves_and_products_write_as_many_numbers_as_they_have(void)
{
    const double L[9] = {2.0, 0.0, 55.0, 1.0, 4.0, 55.0, 55.0, 55.0, 55.0};
    const double R[9] = {2.0, 1.0, 55.0, 0.0, 4.0, 55.0, 55.0, 55.0, 55.0};
    const double b[3] = {4.0, 10.0, 99.0};
    double x[4][3];
    for (uint32_t k = 0u; k < 4u; k++) { memcpy(x[k], b, sizeof b); }
    kc_la_solve_lower(L, 2u, 3u, x[0]);
    kc_la_solve_lower_t(L, 2u, 3u, x[1]);
    kc_la_chol_solve(L, 2u, 3u, x[2]);
    kc_la_solve_upper(R, 2u, 3u, x[3]);
    static const double want[4][3] = {
        {2.0, 2.0, 99.0}, {0.75, 2.5, 99.0}, {0.75, 0.5, 99.0}, {0.75, 2.5, 99.0}};
    for (uint32_t k = 0u; k < 4u; k++) { TEST_ASSERT_EQUAL_DOUBLE_ARRAY(want[k], x[k], 3); }
}

/* Odd and even numbers of rows, of which two are taken at a time. */
void test_congruences_of_any_size(void)
{
    const uint32_t at[N] = {0u, 1u, 2u, 3u, 4u, 5u, 6u, 7u, 8u};
    double J[N * 6], C[36], P[36];
    given_definite();
    for (uint32_t i = 0u; i < N * 6u; i++) { J[i] = drawn(&s_rng); }
    for (uint32_t n = 0u; n <= N; n++) {
        kc_la_congruence(s_B, n, LD, J, C);
        kc_la_congruence_at(s_B, LD, at, n, J, P);
        TEST_ASSERT_EQUAL_MEMORY(C, P, sizeof C);
        for (uint32_t a = 0u; a < 36u; a++) {
            double s = 0.0;
            for (uint32_t k = 0u; k < n; k++) {
                for (uint32_t l = 0u; l < n; l++) {
                    s += J[6u * k + a / 6u] * s_B[k * LD + l] * J[6u * l + a % 6u];
                }
            }
            TEST_ASSERT_DOUBLE_WITHIN(1e-12, s, C[a]);
        }
    }
}

/* Several at a time, and each with the bits of one at a time, in the order of the rows. */
void test_rows_added_to_rows(void)
{
    double J[N * 6], C[N * 4], V[5][6], want[5][6];
    for (uint32_t i = 0u; i < N * 6u; i++) { J[i] = drawn(&s_rng); }
    for (uint32_t i = 0u; i < N * 4u; i++) { C[i] = drawn(&s_rng); }
    for (uint32_t i = 0u; i < 30u; i++) { want[i / 6u][i % 6u] = V[i / 6u][i % 6u] = drawn(&s_rng); }
    for (uint32_t i = 0u; i < N; i++) {
        for (uint32_t k = 0u; k < 24u; k++) {
            want[k / 6u][k % 6u] += C[4u * i + k / 6u] * J[6u * i + k % 6u];
        }
    }
    kc_la_add_mul_t(C, N, 4u, J, V[0]);
    TEST_ASSERT_EQUAL_MEMORY(want, V, sizeof V);
}

void test_products_of_positions_and_of_rotations(void)
{
    float pos[46], rot[46], want_pos[46], want_rot[46];
    double J[N][6];
    for (uint32_t i = 0u; i < N * 6u; i++) { J[i / 6u][i % 6u] = drawn(&s_rng); }
    for (uint32_t i = 0u; i < 46u; i++) {
        want_pos[i] = pos[i] = (float)drawn(&s_rng);
        want_rot[i] = rot[i] = (float)drawn(&s_rng);
    }
    for (uint32_t i = 0u, k = 0u; i < N; i++) {
        for (uint32_t j = 0u; j <= i; j++, k++) {
            const double *x = J[i], *y = J[j];
            want_pos[k] += (float)(x[0] * y[0] + x[1] * y[1] + x[2] * y[2]);
            want_rot[k] += (float)(x[3] * y[3] + x[4] * y[4] + x[5] * y[5]);
        }
    }
    kc_la_add_grams(J[0], N, pos, rot);
    TEST_ASSERT_EQUAL_MEMORY(want_pos, pos, sizeof pos);
    TEST_ASSERT_EQUAL_MEMORY(want_rot, rot, sizeof rot);
}

void test_four_columns_at_once(void)
{
    double l[N], s[4], want[4];
    float v[N][7];
    for (uint32_t i = 0u; i < N * 7u; i++) { v[i / 7u][i % 7u] = (float)drawn(&s_rng); }
    for (uint32_t i = 0u; i < N; i++) { l[i] = drawn(&s_rng); }
    for (uint32_t n = 0u; n <= N; n++) {
        for (uint32_t k = 0u; k < 4u; k++) {
            want[k] = s[k] = drawn(&s_rng);
            for (uint32_t j = 0u; j < n; j++) { want[k] -= l[j] * (double)v[j][2u + k]; }
        }
        kc_la_take_four(l, n, &v[0][2], 7u, s);
        TEST_ASSERT_EQUAL_MEMORY(want, s, sizeof s);
    }
}

/* U_n(x): 1, 2x, and each from the two before. */
void test_chebyshev_series_at_four_places(void)
{
    const double x2[4] = {2.0, -1.7, 0.3, 0.0};
    double w[N], sum[4];
    for (uint32_t n = 0u; n <= N; n++) {
        for (uint32_t i = 0u; i < n; i++) { w[i] = drawn(&s_rng); }
        kc_la_chebyshev(w, n, x2, sum);
        for (uint32_t k = 0u; k < 4u; k++) {
            double s = 0.0, u = 1.0, before = 0.0;
            for (uint32_t i = 0u; i < n; i++) {
                const double after = x2[k] * u - before;
                s += w[i] * u;
                before = u;
                u = after;
            }
            TEST_ASSERT_DOUBLE_WITHIN(1e-13, s, sum[k]);
        }
    }
}

/* 3 and 4 make 5, and the sign of the diagonal turns: the sum that the reflection divides by has one sign. */
void test_a_fold_reflects_to_the_other_side(void)
{
    static const double top[] = {3.0, -3.0, 0.0}, want[] = {-5.0, 5.0, 4.0};
    for (uint32_t i = 0u; i < 3u; i++) {
        double R[2] = {top[i], 1.0}, blk[12] = {[0] = 4.0, [6] = 2.0};
        const double rest = kc_la_fold(R, 1u, 2u, blk);
        TEST_ASSERT_DOUBLE_WITHIN(1e-15, want[i], R[0]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-14, (top[i] * 1.0 + 4.0 * 2.0) / want[i], R[1]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-14, 5.0 - R[1] * R[1], rest);
    }
}

/* By kc_la.h: rows below 1e-145 count as zero. */
void test_where_a_column_begins_to_count(void)
{
    static const double size[] = {0.9e-145, 1.1e-145}, want[] = {0.0, 1.1e-145};
    for (uint32_t i = 0u; i < 2u; i++) {
        double R[2] = {0.0}, blk[12] = {[0] = size[i]};
        double U[4] = {0.5, 1.0, 0.0, size[i]}, scale[2] = {1.0, 1.0}, pivot[2];
        uint32_t perm[2], rank;
        (void)kc_la_fold(R, 1u, 2u, blk);
        TEST_ASSERT_DOUBLE_WITHIN(1e-160, want[i], fabs(R[0]));
        kc_la_rank(U, 2u, 2u, scale, 1e-9, perm, pivot, &rank); /* (1, size) before (0.5, 0) */
        TEST_ASSERT_EQUAL_UINT32(1u, perm[0]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-155, 0.5 * want[i], pivot[1]);
    }
}

void test_what_is_no_number_shows_on_the_diagonal(void)
{
    double R[2] = {1.0, 2.0}, blk[12] = {[0] = NAN, [6] = 1.0};
    (void)kc_la_fold(R, 1u, 2u, blk);
    TEST_ASSERT_TRUE(isnan(R[0]));
}

/* Columns on the diagonal of lengths that differ by so much of 1e-10: up to 5 they are equal, and the lowest index comes
 * first, also where one with a higher index stands before it. */
void test_columns_are_equal_to_five_in_ten_thousand_million(void)
{
    static const struct {
        double more;
        uint32_t first;
    } of[] = {{-6.0, 1u}, {-4.5, 0u}, {4.5, 0u}, {6.0, 0u}};
    for (uint32_t i = 0u; i < sizeof of / sizeof of[0]; i++) {
        double two[4] = {1.0 + 1e-10 * of[i].more, 0.0, 0.0, 1.0};
        double three[9] = {1.0 + 1e-10 * of[i].more, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 2.0};
        given_unit_scale();
        kc_la_rank(two, 2u, 2u, s_scale, 1e-9, s_perm, s_pivot, &s_rank);
        TEST_ASSERT_EQUAL_UINT32(of[i].first, s_perm[0]);
        kc_la_rank(three, 3u, 3u, s_scale, 1e-9, s_perm, s_pivot, &s_rank);
        TEST_ASSERT_EQUAL_UINT32(2u, s_perm[0]);
        TEST_ASSERT_EQUAL_UINT32(of[i].first, s_perm[1]);
    }
}

/* A pivot counts if it is more than tol of the first. */
void test_the_rank_is_cut_where_it_is_said(void)
{
    static const double last[] = {1.9e-3, 2.1e-3};
    for (uint32_t i = 0u; i < 2u; i++) {
        double R[9] = {2.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, last[i]};
        given_unit_scale();
        kc_la_rank(R, 3u, 3u, s_scale, 1e-3, s_perm, s_pivot, &s_rank);
        TEST_ASSERT_EQUAL_UINT32(2u + i, s_rank);
        TEST_ASSERT_EQUAL_DOUBLE(last[i], s_pivot[2]);
    }
}

/* What is left of a dependent column beyond those that count, here a thousandth of it, is in no coefficient. */
void test_a_coefficient_is_that_of_the_columns_that_count(void)
{
    double R[9] = {2.0, 1.0, 0.5, 0.0, 1.0, 0.3, 0.0, 0.0, 1.9e-3};
    given_unit_scale();
    kc_la_rank(R, 3u, 3u, s_scale, 1e-3, s_perm, s_pivot, &s_rank);
    TEST_ASSERT_EQUAL_UINT32(2u, s_rank);
    TEST_ASSERT_EQUAL_UINT32(2u, s_perm[2]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.1, R[0 * 3 + 2]); /* 0.1 (2, 0) + 0.3 (1, 1) = (0.5, 0.3) */
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.3, R[1 * 3 + 2]);
}
