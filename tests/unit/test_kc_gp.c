/* kc_gp.c: incremental against direct; numbers against scikit-learn are in tests/oracle/test_gp.py. */
#include <math.h>
#include <string.h>

#include "given_tables.h"
#include "kc_gp.h"
#include "kc_rng.h"
#include "kc_rot.h"
#include "unity.h"

#define N_CAND 40u

static kc_kernel_t s_k;
static kc_gp_t s_gp, s_other;
static kc_point_t s_cand[KC_CAND_MAX];
static kc_point_t s_x[KC_MEAS_MAX + 1u];
static double s_y[KC_MEAS_MAX + 1u];

static void random_point(uint64_t *rng, kc_point_t *x)
{
    for (int i = 0; i < 4; i++) { x->q_wxyz[i] = kc_rng_uniform(rng) - 0.5; }
    for (int i = 0; i < 3; i++) { x->p_m[i] = kc_rng_uniform(rng); }
    (void)kc_quat_normalize(x->q_wxyz);
}

void setUp(void)
{
    uint64_t rng = 3u;
    given_kernel(&s_k);
    for (uint32_t i = 0u; i < KC_CAND_MAX; i++) { random_point(&rng, &s_cand[i]); }
    for (uint32_t i = 0u; i <= KC_MEAS_MAX; i++) {
        random_point(&rng, &s_x[i]);
        s_y[i] = -kc_rng_uniform(&rng);
    }
    memset(&s_gp, 0, sizeof s_gp);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_gp_init(&s_gp, &s_k, 0u, s_cand, N_CAND));
}

static void add(kc_gp_t *gp, uint32_t n)
{
    for (uint32_t i = 0u; i < n; i++) {
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_gp_add(gp, &s_x[i], s_y[i], s_cand));
    }
}

void test_empty_process_knows_nothing(void)
{
    double mean = 9.0;
    double var = 9.0;
    kc_gp_predict(&s_gp, &s_x[0], &mean, &var);
    TEST_ASSERT_DOUBLE_WITHIN(0.0, 0.0, mean);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 1.0, var);
    TEST_ASSERT_DOUBLE_WITHIN(0.0, 0.0, kc_gp_cand_mean(&s_gp, 3u));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 1.0, s_gp.var[3]);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_gp.var[N_CAND]); /* no candidate */
    TEST_ASSERT_DOUBLE_WITHIN(0.0, 0.0, kc_gp_log_marginal(&s_gp));
}

/* Four are taken at a time: the last ones may be no candidates. */
void test_any_number_of_candidates(void)
{
    add(&s_gp, 5u);
    for (uint32_t n = N_CAND - 3u; n < N_CAND; n++) {
        memset(&s_other, 0, sizeof s_other);
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_gp_init(&s_other, &s_k, 0u, s_cand, n));
        add(&s_other, 5u);
        TEST_ASSERT_EQUAL_MEMORY(s_gp.var, s_other.var, n * sizeof s_gp.var[0]);
        TEST_ASSERT_EQUAL_DOUBLE(0.0, s_other.var[n]);
        for (uint32_t i = 0u; i < 5u; i++) {
            TEST_ASSERT_EQUAL_MEMORY(s_gp.v[i], s_other.v[i], n * sizeof s_gp.v[0][0]);
            TEST_ASSERT_EQUAL_FLOAT(0.0f, s_other.v[i][n]);
        }
    }
}

void test_too_many_candidates_or_unknown_set_are_refused(void)
{
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_gp_init(&s_gp, &s_k, 1u, s_cand, KC_CAND_MAX));
    TEST_ASSERT_EQUAL_INT(KC_ERR_ARG, kc_gp_init(&s_gp, &s_k, 0u, s_cand, KC_CAND_MAX + 1u));
    TEST_ASSERT_EQUAL_INT(KC_ERR_ARG, kc_gp_init(&s_gp, &s_k, 2u, s_cand, N_CAND));
}

void test_cached_candidates_agree_with_the_direct_posterior(void)
{
    add(&s_gp, KC_MEAS_MAX);
    for (uint32_t c = 0u; c < N_CAND; c++) {
        double mean;
        double var;
        kc_gp_predict(&s_gp, &s_cand[c], &mean, &var);
        TEST_ASSERT_DOUBLE_WITHIN(1e-5, mean, kc_gp_cand_mean(&s_gp, c));
        TEST_ASSERT_DOUBLE_WITHIN(1e-5, var, s_gp.var[c]);
    }
}

void test_a_measured_point_is_known_to_the_noise(void)
{
    double mean;
    double var;
    s_k.sigma_eps = 1e-4;
    add(&s_gp, 5u);
    kc_gp_predict(&s_gp, &s_x[2], &mean, &var);
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, s_y[2], mean);
    TEST_ASSERT_DOUBLE_WITHIN(2e-8, 1e-8, var);
}

void test_changed_values_act_as_if_given_at_once(void)
{
    double changed[4] = {0.5, -2.0, 0.0, 1.0};
    add(&s_gp, 4u);
    kc_gp_set_y(&s_gp, changed);
    kc_gp_init(&s_other, &s_k, 0u, s_cand, N_CAND);
    for (uint32_t i = 0u; i < 4u; i++) { (void)kc_gp_add(&s_other, &s_x[i], changed[i], s_cand); }
    for (uint32_t i = 0u; i < 4u; i++) {
        TEST_ASSERT_DOUBLE_WITHIN(0.0, changed[i], s_gp.y[i]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, s_other.z[i], s_gp.z[i]);
    }
}

void test_full_process_refuses_and_stays(void)
{
    add(&s_gp, KC_MEAS_MAX);
    const double before = kc_gp_log_marginal(&s_gp);
    TEST_ASSERT_EQUAL_INT(KC_ERR_FULL, kc_gp_add(&s_gp, &s_x[KC_MEAS_MAX], 0.0, s_cand));
    TEST_ASSERT_EQUAL_UINT32(KC_MEAS_MAX, s_gp.n);
    TEST_ASSERT_DOUBLE_WITHIN(0.0, before, kc_gp_log_marginal(&s_gp));
}

void test_what_is_not_finite_or_breaks_the_factor_changes_nothing(void)
{
    add(&s_gp, 3u);
    memcpy(&s_other, &s_gp, sizeof s_gp);
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, kc_gp_add(&s_gp, &s_x[3], NAN, s_cand));
    s_k.sigma_eps = NAN;
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, kc_gp_add(&s_gp, &s_x[0], -0.1, s_cand));
    TEST_ASSERT_EQUAL_UINT32(3u, s_gp.n);
    TEST_ASSERT_EQUAL_MEMORY(s_other.var, s_gp.var, sizeof s_gp.var);
    TEST_ASSERT_EQUAL_MEMORY(s_other.L, s_gp.L, 6u * sizeof *s_gp.L);
    TEST_ASSERT_EQUAL_MEMORY(s_other.z, s_gp.z, 3u * sizeof *s_gp.z);
}

void test_log_marginal_of_one_point_is_the_normal_density(void)
{
    const double var = 1.0 + s_k.sigma_eps * s_k.sigma_eps;
    add(&s_gp, 1u);
    const double want = -0.5 * s_y[0] * s_y[0] / var - 0.5 * log(2.0 * 3.14159265358979323846 * var);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, want, kc_gp_log_marginal(&s_gp));
}

/* Values sampled far smoother in position than set 0 says: set 1 explains them better. */
static void given_smooth_values(void)
{
    s_k.hyper[1].beta_m = 20.0;
    for (uint32_t i = 0u; i < 30u; i++) {
        memcpy(s_x[i].q_wxyz, s_x[0].q_wxyz, sizeof s_x[i].q_wxyz);
        s_y[i] = -0.5 + 0.01 * s_x[i].p_m[0];
    }
}

void test_choose_takes_the_likelier_set_and_rebuilds_on_it(void)
{
    given_smooth_values();
    add(&s_gp, 30u);
    const double before = kc_gp_log_marginal(&s_gp);
    TEST_ASSERT_EQUAL_UINT32(1u, kc_gp_choose(&s_gp, s_cand));
    TEST_ASSERT_EQUAL_UINT32(1u, s_gp.hyper);
    TEST_ASSERT_TRUE(kc_gp_log_marginal(&s_gp) > before);
    kc_gp_init(&s_other, &s_k, 1u, s_cand, N_CAND);
    add(&s_other, 30u);
    TEST_ASSERT_EQUAL_MEMORY(s_other.L, s_gp.L, 465u * sizeof *s_gp.L);
    TEST_ASSERT_EQUAL_MEMORY(s_other.v, s_gp.v, sizeof s_gp.v);
    TEST_ASSERT_EQUAL_MEMORY(s_other.var, s_gp.var, N_CAND * sizeof *s_gp.var);
    TEST_ASSERT_EQUAL_MEMORY(s_other.z, s_gp.z, 30u * sizeof *s_gp.z);
}

/* The likeliest in the middle: a later set that is only better than the present one does not take its place. */
void test_choose_takes_the_likeliest_of_all_sets(void)
{
    given_smooth_values();
    s_k.n_hyper = 3u;
    s_k.hyper[2] = s_k.hyper[0];
    s_k.hyper[2].beta_m = 1.0;
    add(&s_gp, 30u);
    const double present = kc_gp_log_marginal(&s_gp);
    kc_gp_init(&s_other, &s_k, 2u, s_cand, N_CAND);
    add(&s_other, 30u);
    TEST_ASSERT_TRUE(kc_gp_log_marginal(&s_other) > present);
    TEST_ASSERT_EQUAL_UINT32(1u, kc_gp_choose(&s_gp, s_cand));
    TEST_ASSERT_TRUE(kc_gp_log_marginal(&s_gp) > kc_gp_log_marginal(&s_other));
}

void test_a_choice_in_parts_gives_the_same_bits(void)
{
    s_k.hyper[0].sigma_s = 1e-3;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_gp_init(&s_gp, &s_k, 0u, s_cand, N_CAND));
    add(&s_gp, 6u);
    s_other = s_gp;
    TEST_ASSERT_EQUAL_UINT32(1u, kc_gp_choose(&s_gp, s_cand));
    kc_gp_choose_begin(&s_other);
    uint32_t steps = 0u;
    for (bool over = false; !over; steps++) {
        kc_work_t work = {1u, 0u};
        over = kc_gp_choose_step(&s_other, s_cand, &work);
    }
    TEST_ASSERT_EQUAL_UINT32(2u + 1u + 6u + 0u, steps); /* two sets, the best, six rows */
    TEST_ASSERT_EQUAL_UINT32(1u, s_other.hyper);
    TEST_ASSERT_EQUAL_MEMORY(s_gp.L, s_other.L, sizeof s_gp.L);
    TEST_ASSERT_EQUAL_MEMORY(s_gp.var, s_other.var, sizeof s_gp.var);
    TEST_ASSERT_EQUAL_MEMORY(s_gp.v, s_other.v, sizeof s_gp.v);
}

void test_choose_keeps_the_present_set_to_the_bit_when_it_is_best(void)
{
    given_smooth_values();
    kc_gp_init(&s_gp, &s_k, 1u, s_cand, N_CAND);
    add(&s_gp, 30u);
    memcpy(&s_other, &s_gp, sizeof s_gp);
    TEST_ASSERT_EQUAL_UINT32(1u, kc_gp_choose(&s_gp, s_cand));
    TEST_ASSERT_EQUAL_MEMORY(s_other.L, s_gp.L, 465u * sizeof *s_gp.L);
    TEST_ASSERT_EQUAL_MEMORY(s_other.v, s_gp.v, sizeof s_gp.v);
}

void test_choose_passes_over_a_set_whose_factor_breaks_down(void)
{
    add(&s_gp, 4u);
    s_k.hyper[1].beta_m = NAN;
    TEST_ASSERT_EQUAL_UINT32(0u, kc_gp_choose(&s_gp, s_cand));
}
