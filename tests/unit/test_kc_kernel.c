/* kc_kernel.c: contract and refusals; values against geometric_kernels are in tests/oracle/test_kernel.py. */
#include <math.h>
#include <string.h>

#include "given_tables.h"
#include "kc_kernel.h"
#include "kc_rot.h"
#include "unity.h"

static kc_kernel_t s_k;
static int32_t s_index;
static double s_got;

static const double ONE[4] = {1.0, 0.0, 0.0, 0.0};
static const double HALF_TURN[4] = {0.0, 0.0, 1.0, 0.0};

void setUp(void)
{
    given_kernel(&s_k);
    s_index = 99;
    s_got = 99.0;
}

/* A table of all degrees, as for the paper's argument. */
static void given_all_degrees(void)
{
    kc_hyper_t *h = &s_k.hyper[0];
    double sum = 0.0;
    s_k.arg = KC_KERNEL_PAPER;
    s_k.n_hyper = 1u;
    for (uint32_t n = 0u; n < h->n_w; n++) {
        h->w[n] = (double)(n + 1u) * exp(-0.245 * (double)(n * (n + 2u)));
        sum += h->w[n] * (double)(n + 1u);
    }
    for (uint32_t n = 0u; n < h->n_w; n++) { h->w[n] /= sum; }
}

static double by_sines(const kc_hyper_t *h, double t)
{
    double s = 0.0;
    for (uint32_t n = 0u; n < h->n_w; n++) { s += h->w[n] * sin((double)(n + 1u) * t) / sin(t); }
    return s;
}

static void assert_refused(int32_t index, double got)
{
    TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, kc_kernel_validate(&s_k, &s_index, &s_got));
    TEST_ASSERT_EQUAL_INT32(index, s_index);
    if (isnan(got)) {
        TEST_ASSERT_TRUE(isnan(s_got));
    } else {
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, got, s_got);
    }
}

void test_a_rotation_is_fully_correlated_with_itself_whatever_its_sign(void)
{
    const double minus[4] = {-1.0, 0.0, 0.0, 0.0};
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, 1.0, kc_kernel_rot(&s_k, 0u, ONE, ONE));
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, 1.0, kc_kernel_rot(&s_k, 0u, ONE, minus));
    const double longer[4] = {1.2, 0.0, 0.0, 0.0}; /* as by rounding, but more */
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, 1.0, kc_kernel_rot(&s_k, 0u, ONE, longer));
    given_all_degrees();
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, 1.0, kc_kernel_rot(&s_k, 0u, ONE, minus));
}

void test_half_turns_are_summed_without_dividing_by_zero(void)
{
    double so3 = 0.0;
    double paper = 0.0;
    for (uint32_t n = 0u; n < s_k.hyper[0].n_w; n += 2u) {
        so3 += s_k.hyper[0].w[n] * ((n % 4u == 0u) ? 1.0 : -1.0);
    }
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, so3, kc_kernel_rot(&s_k, 0u, ONE, HALF_TURN));
    given_all_degrees(); /* t = pi: U_n = (-1)^n (n + 1) */
    for (uint32_t n = 0u; n < s_k.hyper[0].n_w; n++) {
        paper += s_k.hyper[0].w[n] * (double)(n + 1u) * ((n % 2u == 0u) ? 1.0 : -1.0);
    }
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, paper, kc_kernel_rot(&s_k, 0u, ONE, HALF_TURN));
}

void test_clenshaw_gives_the_sum_of_sines_for_both_arguments(void)
{
    for (double a = 0.01; a < 3.1; a += 0.05) {
        const double q[4] = {cos(0.5 * a), sin(0.5 * a), 0.0, 0.0};
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, by_sines(&s_k.hyper[0], 0.5 * a), kc_kernel_rot(&s_k, 0u, ONE, q));
    }
    given_all_degrees();
    for (double a = 0.01; a < 3.1; a += 0.05) {
        const double q[4] = {cos(0.5 * a), 0.0, sin(0.5 * a), 0.0};
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, by_sines(&s_k.hyper[0], a), kc_kernel_rot(&s_k, 0u, ONE, q));
    }
}

void test_a_kernel_has_any_number_of_weights(void)
{
    const double angle = 0.7, q[4] = {cos(0.5 * angle), 0.0, 0.0, sin(0.5 * angle)};
    for (uint32_t n_w = 1u; n_w <= 6u; n_w++) {
        s_k.hyper[0].n_w = n_w;
        for (uint32_t n = 0u; n < n_w; n++) { s_k.hyper[0].w[n] = 1.0 / (double)(n + 2u); }
        TEST_ASSERT_DOUBLE_WITHIN(1e-14, by_sines(&s_k.hyper[0], 0.5 * angle),
                                  kc_kernel_rot(&s_k, 0u, ONE, q));
    }
}

/* The bits of one at a time: a factor and the cache of candidates go by both. */
void test_a_row_is_what_its_elements_are(void)
{
    static const kc_point_t x = {{0.9, 0.1, -0.3, 0.3}, {0.1, 0.2, 0.3}};
    kc_point_t at[9];
    double row[10];
    for (uint32_t i = 0u; i < 9u; i++) {
        const double a = 0.3 * (double)i;
        at[i] = (kc_point_t){{cos(a), 0.0, sin(a), 0.0}, {0.1 * a, 0.3, -0.2 * a}};
    }
    for (uint32_t n_w = 4u; n_w <= 5u; n_w++) {
        for (uint8_t arg = KC_KERNEL_SO3; arg <= KC_KERNEL_PAPER; arg++) {
            s_k.arg = arg;
            s_k.hyper[1].n_w = n_w;
            for (uint32_t n = 0u; n <= 9u; n++) {
                for (uint32_t i = 0u; i < 10u; i++) { row[i] = 77.0; }
                kc_kernel_row(&s_k, 1u, &x, at, n, row);
                for (uint32_t i = 0u; i < n; i++) {
                    const double want = kc_kernel_eval(&s_k, 1u, &x, &at[i]);
                    TEST_ASSERT_EQUAL_MEMORY(&want, &row[i], sizeof want);
                }
                TEST_ASSERT_EQUAL_DOUBLE(77.0, row[n]);
            }
        }
    }
}

void test_position_part_is_a_gaussian_and_both_multiply(void)
{
    const kc_point_t a = {{1.0, 0.0, 0.0, 0.0}, {0.1, 0.2, 0.3}};
    s_k.hyper[1].sigma_s = 3.0;
    for (uint32_t axis = 0u; axis < 3u; axis++) {
        kc_point_t b = {{0.8, 0.6, 0.0, 0.0}, {0.1, 0.2, 0.3}};
        b.p_m[axis] += 0.4;
        const double want = 9.0 * exp(-0.5 * 0.16 / 0.25) * kc_kernel_rot(&s_k, 1u, a.q_wxyz, b.q_wxyz);
        TEST_ASSERT_DOUBLE_WITHIN(1e-14, want, kc_kernel_eval(&s_k, 1u, &a, &b));
        TEST_ASSERT_DOUBLE_WITHIN(1e-15, want, kc_kernel_eval(&s_k, 1u, &b, &a));
    }
}

void test_good_tables_pass(void)
{
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_kernel_validate(&s_k, &s_index, &s_got));
    given_all_degrees();
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_kernel_validate(&s_k, &s_index, &s_got));
}

void test_unknown_argument_is_refused(void)
{
    s_k.arg = 2u;
    assert_refused(-1, 2.0);
}

void test_number_of_sets_is_checked(void)
{
    s_k.n_hyper = 0u;
    assert_refused(-1, 0.0);
    s_k.n_hyper = KC_HYPER_MAX + 1u;
    assert_refused(-1, (double)(KC_HYPER_MAX + 1u));
}

void test_noise_must_be_positive(void)
{
    s_k.sigma_eps = 0.0;
    assert_refused(-1, 0.0);
    s_k.sigma_eps = NAN;
    assert_refused(-1, NAN);
}

void test_choose_is_a_switch(void)
{
    s_k.choose = 2u;
    assert_refused(-1, 2.0);
}

void test_each_hyperparameter_is_checked_and_the_set_named(void)
{
    const kc_kernel_t good = s_k;
    s_k.hyper[1].sigma_s = 0.0;
    assert_refused(1, 0.0);
    s_k = good;
    s_k.hyper[1].beta_m = -0.1;
    assert_refused(1, -0.1);
    s_k = good;
    s_k.hyper[0].kappa = INFINITY;
    assert_refused(0, INFINITY);
    s_k = good;
    s_k.hyper[0].nu = -0.5;
    assert_refused(0, -0.5);
    s_k = good;
    s_k.hyper[0].trunc_err = 0.2;
    assert_refused(0, 0.2);
    s_k = good;
    s_k.hyper[0].n_w = 0u;
    assert_refused(0, 0.0);
    s_k.hyper[0].n_w = KC_SPECTRUM_MAX + 1u;
    assert_refused(0, (double)(KC_SPECTRUM_MAX + 1u));
}

void test_a_negative_weight_would_not_be_positive_definite(void)
{
    s_k.hyper[1].w[4] = -1e-6;
    assert_refused(1, -1e-6);
}

void test_an_odd_weight_is_no_function_of_rotations(void)
{
    s_k.hyper[0].w[3] = 1e-6;
    assert_refused(0, 1e-6);
}

void test_weights_must_sum_to_one(void)
{
    s_k.hyper[0].w[0] += 1e-6;
    assert_refused(0, 1.0 + 1e-6);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 1.0 + 1e-6, s_got);
}

void test_limits_are_inclusive_and_nothing_beyond_them_passes(void)
{
    kc_hyper_t *h = &s_k.hyper[1];
    const struct {
        double *field, lo, hi;
    } row[] = {{&h->sigma_s, 1e-6, 1e3}, {&h->beta_m, 1e-3, 1e3},   {&h->kappa, 1e-3, 1e3},
               {&h->nu, 0.0, 100.0},     {&h->trunc_err, 0.0, 0.1}, {&s_k.sigma_eps, 1e-9, 1e3}};
    for (uint32_t i = 0u; i < sizeof row / sizeof row[0]; i++) {
        const double old = *row[i].field, at[2] = {row[i].lo, row[i].hi};
        const double beyond[2] = {nextafter(row[i].lo, -INFINITY), nextafter(row[i].hi, INFINITY)};
        for (uint32_t side = 0u; side < 2u; side++) {
            *row[i].field = at[side];
            TEST_ASSERT_EQUAL_INT(KC_OK, kc_kernel_validate(&s_k, &s_index, &s_got));
            *row[i].field = beyond[side];
            TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, kc_kernel_validate(&s_k, &s_index, &s_got));
        }
        *row[i].field = old;
    }
}
