/* kc_monitor.c: which joint reads wrong. */
#include <math.h>
#include <string.h>

#include "given_dense.h"
#include "given_observations.h"
#include "given_small_arm.h"
#include "given_tables.h"
#include "kc_chi2.h"
#include "kc_monitor.h"
#include "kc_rng.h"
#include "unity.h"

static kc_arm_t s_arm;
static kc_terms_t s_terms;
static kc_monitor_t s_mon;
static kc_mon_verdict_t s_v;
static kc_obs_t s_obs;
static kc_eval_t s_work;
static double s_coef[KC_COEF_MAX];
static uint64_t s_rng;

void setUp(void)
{
    given_arm(&s_arm);
    given_terms(&s_terms);
    memset(s_coef, 0, sizeof s_coef);
    s_rng = 5u;
    kc_monitor_init(&s_mon, &s_arm, 2e-4, 5e-4);
}

/* n observations of an arm whose joint j stands `bias` beyond its reading. */
static void observations(uint32_t n, uint32_t j, double bias)
{
    double q[KC_JOINT_MAX] = {0.0}, at[KC_JOINT_MAX];
    for (uint32_t i = 0u; i < n; i++) {
        given_joints(&s_arm, &s_rng, q);
        memcpy(at, q, sizeof at);
        at[j] += bias;
        given_one_observation(&s_arm, &s_terms, s_coef, at, 1.0, &s_rng, &s_obs);
        memcpy(s_obs.ctx.q, q, sizeof q);
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_monitor_add(&s_mon, &s_arm, &s_terms, s_coef, &s_obs, &s_work));
    }
    kc_monitor_evaluate(&s_mon, &s_v);
}

void test_it_takes_less_than_8_kib(void) { TEST_ASSERT_TRUE(sizeof s_mon + sizeof s_v <= 8192u); }

void test_without_observations_it_is_quiet(void)
{
    kc_monitor_evaluate(&s_mon, &s_v);
    TEST_ASSERT_EQUAL_INT(KC_MON_QUIET, s_v.state);
    TEST_ASSERT_EQUAL_DOUBLE(1.0, s_v.p);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_v.off_m);
}

void test_a_healthy_arm_is_quiet(void)
{
    given_paper_errors(s_coef); /* known to the model, so no error */
    for (uint32_t i = 0u; i < 50u; i++) {
        observations(1u, 0u, 0.0);
        TEST_ASSERT_EQUAL_INT(KC_MON_QUIET, s_v.state);
    }
    TEST_ASSERT_EQUAL_UINT32(KC_MON_OBS_MAX, s_mon.n);
    TEST_ASSERT_TRUE(s_v.off_m > 0.0 && s_v.off_m < 5e-3);
}

void test_the_joint_that_reads_wrong_is_named_with_its_bias(void)
{
    for (uint32_t j = 0u; j < 7u; j++) {
        kc_monitor_init(&s_mon, &s_arm, 2e-4, 5e-4);
        observations(5u, j, 0.03);
        TEST_ASSERT_EQUAL_INT(KC_MON_NAMED, s_v.state);
        TEST_ASSERT_EQUAL_UINT32(j, s_v.joint);
        TEST_ASSERT_EQUAL_HEX32(1u << j, s_v.suspects);
        TEST_ASSERT_DOUBLE_WITHIN(4.0 * s_v.sigma, 0.03, s_v.bias);
        TEST_ASSERT_TRUE(s_v.p_rest > 1e-3);
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, kc_chi2_sf(s_v.rest, 6u * s_v.n_obs - 1u), s_v.p_rest);
        TEST_ASSERT_TRUE(s_v.rest > 5.0 && s_v.rest < 60.0); /* 29 expected */
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, s_v.bias / s_v.sigma, sqrt(s_v.stat));
        double p = 7.0 * 7.0 * kc_chi2_sf(s_v.stat, 1u); /* seven joints, onsets of 2 to 8 observations */
        TEST_ASSERT_DOUBLE_WITHIN(1e-9 * p, p, s_v.p);
    }
}

void test_a_large_bias_is_the_exact_turn(void)
{
    observations(4u, 1u, -0.9);
    TEST_ASSERT_EQUAL_INT(KC_MON_NAMED, s_v.state);
    TEST_ASSERT_EQUAL_UINT32(1u, s_v.joint);
    TEST_ASSERT_DOUBLE_WITHIN(4.0 * s_v.sigma, -0.9, s_v.bias);
}

void test_a_slip_after_many_good_observations_is_dated(void)
{
    observations(20u, 0u, 0.0);
    observations(3u, 3u, 0.05);
    TEST_ASSERT_EQUAL_INT(KC_MON_NAMED, s_v.state);
    TEST_ASSERT_EQUAL_UINT32(3u, s_v.joint);
    TEST_ASSERT_EQUAL_UINT32(3u, s_v.n_obs);
}

void test_one_observation_names_no_joint(void)
{
    observations(1u, 0u, 0.1);
    TEST_ASSERT_EQUAL_INT(KC_MON_QUIET, s_v.state);
    TEST_ASSERT_TRUE(s_v.off_rad > 0.05);
}

void test_one_outlier_among_good_observations_is_no_alarm(void)
{
    observations(4u, 0u, 0.0);
    observations(1u, 0u, 0.1);
    TEST_ASSERT_EQUAL_INT(KC_MON_QUIET, s_v.state);
    observations(1u, 0u, 0.0);
    TEST_ASSERT_EQUAL_INT(KC_MON_QUIET, s_v.state);
}

void test_what_no_joint_explains_is_said_after_three_observations(void)
{
    double q[KC_JOINT_MAX] = {0.0};
    for (uint32_t i = 0u; i < 3u; i++) {
        kc_monitor_evaluate(&s_mon, &s_v);
        TEST_ASSERT_EQUAL_INT(KC_MON_QUIET, s_v.state);
        given_joints(&s_arm, &s_rng, q);
        given_one_observation(&s_arm, &s_terms, s_coef, q, 1.0, &s_rng, &s_obs);
        s_obs.p_m[i] += 0.05;
        s_obs.p_m[2] += 0.05;
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_monitor_add(&s_mon, &s_arm, &s_terms, s_coef, &s_obs, &s_work));
    }
    kc_monitor_evaluate(&s_mon, &s_v);
    TEST_ASSERT_EQUAL_INT(KC_MON_UNEXPLAINED, s_v.state);
    TEST_ASSERT_EQUAL_UINT32(KC_MON_OBS_OFF, s_v.n_obs);
    TEST_ASSERT_TRUE(s_v.p < KC_MON_P);
    double most = 0.0; /* the likeliest of them, by its six residuals */
    for (uint32_t i = 0u; i < 3u; i++) {
        double chi2 = 0.0;
        for (uint32_t c = 0u; c < 6u; c++) {
            chi2 += pow(s_mon.obs[i].r[c] / (c < 3u ? OBS_POS_M : OBS_ROT_RAD), 2.0);
        }
        most = fmax(most, kc_chi2_sf(chi2, 6u));
    }
    TEST_ASSERT_DOUBLE_WITHIN(1e-6 * most, most, s_v.p);
}

/* Several at once are nothing that one explains; as many as are off in a row are counted. */
void test_what_is_unexplained_counts_the_observations_that_are_off_in_a_row(void)
{
    observations(4u, 0u, 0.0);
    for (uint32_t i = 0u; i < 4u; i++) { s_arm.joint[i].phi_rad += i % 2u == 0u ? 0.1 : -0.15; }
    observations(4u, 0u, 0.0);
    TEST_ASSERT_EQUAL_INT(KC_MON_QUIET, s_v.state); /* made by the same arm: healthy */
    for (uint32_t i = 0u; i < 5u; i++) {
        kc_mon_obs_t *k = &s_mon.obs[(s_mon.next + KC_MON_OBS_MAX - 1u - i) % KC_MON_OBS_MAX];
        for (uint32_t c = 0u; c < 3u; c++) { k->r[c] += i % 2u == c % 2u ? 0.2 : -0.3; }
        kc_monitor_evaluate(&s_mon, &s_v);
        TEST_ASSERT_EQUAL_INT(i < 2u ? KC_MON_QUIET : KC_MON_UNEXPLAINED, s_v.state);
        TEST_ASSERT_EQUAL_UINT32(i < 2u ? 0u : i + 1u, s_v.n_obs);
        TEST_ASSERT_EQUAL_PTR(k, kc_monitor_back(&s_mon, i));
    }
}

void test_joints_with_one_axis_are_all_suspect(void)
{
    double q[KC_JOINT_MAX] = {0.0}, at[KC_JOINT_MAX] = {0.0};
    at[2] = 0.05; /* stretched straight up, joints 1, 3, 5 and 7 turn about one line */
    for (uint32_t i = 0u; i < 3u; i++) {
        given_one_observation(&s_arm, &s_terms, s_coef, at, 1.0, &s_rng, &s_obs);
        memcpy(s_obs.ctx.q, q, sizeof q);
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_monitor_add(&s_mon, &s_arm, &s_terms, s_coef, &s_obs, &s_work));
    }
    kc_monitor_evaluate(&s_mon, &s_v);
    TEST_ASSERT_EQUAL_INT(KC_MON_NAMED, s_v.state);
    TEST_ASSERT_EQUAL_HEX32(0x55u, s_v.suspects);
}

void test_what_all_observations_share_does_not_average_out(void)
{
    observations(8u, 6u, 0.03);
    double sharp = s_v.sigma;
    kc_monitor_init(&s_mon, &s_arm, OBS_POS_M, OBS_ROT_RAD); /* nothing but floor */
    s_rng = 5u;
    observations(8u, 6u, 0.03);
    TEST_ASSERT_TRUE(s_v.state == KC_MON_QUIET || s_v.sigma > 2.0 * sharp);
}

void test_a_floor_stands_in_for_a_covariance_that_claims_too_much(void)
{
    double q[KC_JOINT_MAX] = {0.0};
    for (uint32_t i = 0u; i < 6u; i++) {
        given_joints(&s_arm, &s_rng, q);
        given_one_observation(&s_arm, &s_terms, s_coef, q, 0.05, &s_rng, &s_obs);
        for (uint32_t c = 0u; c < 6u; c++) { s_obs.cov[7u * c] = 1e-14; }
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_monitor_add(&s_mon, &s_arm, &s_terms, s_coef, &s_obs, &s_work));
    }
    kc_monitor_evaluate(&s_mon, &s_v);
    TEST_ASSERT_EQUAL_INT(KC_MON_QUIET, s_v.state);
}

void test_a_prismatic_joint_is_named_in_metres(void)
{
    given_small_arm(&s_arm);
    memset(&s_terms, 0, sizeof s_terms);
    uint32_t j = 0u;
    while (j < s_arm.n_joints && s_arm.joint[j].type != KC_PRISMATIC) { j++; }
    kc_monitor_init(&s_mon, &s_arm, 2e-4, 5e-4);
    observations(5u, j, 0.02);
    TEST_ASSERT_EQUAL_INT(KC_MON_NAMED, s_v.state);
    TEST_ASSERT_EQUAL_UINT32(j, s_v.joint);
    TEST_ASSERT_DOUBLE_WITHIN(4.0 * s_v.sigma, 0.02, s_v.bias);
    kc_monitor_init(&s_mon, &s_arm, 2e-4, 5e-4);
    observations(5u, j, 0.9); /* along a line, not on an arc */
    TEST_ASSERT_EQUAL_INT(KC_MON_NAMED, s_v.state);
    TEST_ASSERT_EQUAL_UINT32(j, s_v.joint);
    TEST_ASSERT_DOUBLE_WITHIN(4.0 * s_v.sigma, 0.9, s_v.bias);
}

/* Refused, and what was held stays. */
static void refused(kc_status_t st)
{
    static kc_monitor_t before;
    before = s_mon;
    TEST_ASSERT_EQUAL_INT(st, kc_monitor_add(&s_mon, &s_arm, &s_terms, s_coef, &s_obs, &s_work));
    TEST_ASSERT_EQUAL_MEMORY(&before, &s_mon, sizeof before);
}

void test_an_observation_without_orientation_or_noise_is_refused(void)
{
    observations(2u, 0u, 0.0);
    s_obs.has_rot = 0u;
    refused(KC_ERR_ARG);
    s_obs.has_rot = 1u;
    s_obs.p_m[1] = NAN;
    refused(KC_ERR_NUM);
    s_obs.p_m[1] = 0.0;
    s_obs.cov[1] = s_obs.cov[6] = 1.0;
    refused(KC_ERR_NUM);
}

/* ---- found missing by mutants ---- */

void test_every_prismatic_joint_is_known_as_one(void)
{
    s_arm.joint[2].type = KC_PRISMATIC;
    s_arm.joint[6].type = KC_PRISMATIC;
    kc_monitor_init(&s_mon, &s_arm, 2e-4, 5e-4);
    TEST_ASSERT_EQUAL_HEX32(1u << 2 | 1u << 6, s_mon.prismatic);
}

/* Terms can undo what a joint does. */
void test_a_joint_that_moves_nothing_is_never_suspected(void)
{
    observations(6u, 1u, 0.05);
    for (uint32_t i = 0u; i < KC_MON_OBS_MAX; i++) {
        memset(s_mon.obs[i].Jq[4], 0, sizeof s_mon.obs[i].Jq[4]);
    }
    kc_monitor_evaluate(&s_mon, &s_v);
    TEST_ASSERT_EQUAL_INT(KC_MON_NAMED, s_v.state);
    TEST_ASSERT_EQUAL_UINT32(1u, s_v.joint);
    TEST_ASSERT_EQUAL_HEX32(0u, s_v.suspects >> 4u & 1u);
    TEST_ASSERT_DOUBLE_WITHIN(0.01, 0.05, s_v.bias);
}

void test_a_joint_whose_effect_is_no_number_is_never_suspected(void)
{
    observations(6u, 1u, 0.05);
    for (uint32_t i = 0u; i < KC_MON_OBS_MAX; i++) { s_mon.obs[i].Jq[0][2] = s_mon.obs[i].Jq[4][1] = NAN; }
    kc_monitor_evaluate(&s_mon, &s_v);
    TEST_ASSERT_EQUAL_INT(KC_MON_NAMED, s_v.state);
    TEST_ASSERT_EQUAL_UINT32(1u, s_v.joint);
    TEST_ASSERT_EQUAL_HEX32(0u, s_v.suspects & 0x11u);
}

/* So small that a fit over one good observation more would leave noise as well. */
void test_a_small_slip_is_dated_where_it_explains_most(void)
{
    observations(3u, 6u, 0.05);
    double bias = 5.0 * sqrt(3.0) * s_v.sigma;
    for (uint64_t seed = 1u; seed < 6u; seed++) {
        kc_monitor_init(&s_mon, &s_arm, 2e-4, 5e-4);
        s_rng = seed;
        observations(5u, 6u, 0.0);
        TEST_ASSERT_EQUAL_INT(KC_MON_QUIET, s_v.state);
        observations(3u, 6u, bias);
        TEST_ASSERT_EQUAL_INT(KC_MON_NAMED, s_v.state);
        TEST_ASSERT_EQUAL_UINT32(6u, s_v.joint);
        TEST_ASSERT_UINT32_WITHIN(1u, 3u, s_v.n_obs);
        TEST_ASSERT_DOUBLE_WITHIN(4.0 * s_v.sigma, bias, s_v.bias);
    }
}

/* n observations in one posture, of whose variance a part f is shared: the variance of the mean is
 * (1 + (n - 1) f) / n of one. */
void test_the_shared_part_of_the_noise_stays_and_the_rest_averages_out(void)
{
    double q[KC_JOINT_MAX] = {0.3, 0.5, -0.4, 1.2, 0.2, -0.9, 0.1}, at[KC_JOINT_MAX], var[9] = {0.0};
    memcpy(at, q, sizeof at);
    at[3] += 0.05;
    kc_monitor_init(&s_mon, &s_arm, 0.6 * OBS_POS_M, 0.6 * OBS_ROT_RAD);
    given_one_observation(&s_arm, &s_terms, s_coef, at, 0.0, &s_rng, &s_obs);
    memcpy(s_obs.ctx.q, q, sizeof q);
    for (uint32_t n = 1u; n <= KC_MON_OBS_MAX; n++) {
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_monitor_add(&s_mon, &s_arm, &s_terms, s_coef, &s_obs, &s_work));
        kc_monitor_evaluate(&s_mon, &s_v);
        var[n] = s_v.sigma * s_v.sigma;
        if (n < 3u) { continue; }
        TEST_ASSERT_EQUAL_UINT32(3u, s_v.joint);
        TEST_ASSERT_EQUAL_UINT32(n, s_v.n_obs);
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, (1.0 + 0.36 * (n - 1u)) / n / (1.36 / 2.0), var[n] / var[2]);
    }
}

/* Without a floor: the information of n looks at a joint is n times the square of what it moves, in sigmas. */
void test_sigma_is_that_of_independent_observations_in_closed_form(void)
{
    double q[KC_JOINT_MAX] = {0.3, 0.5, -0.4, 1.2, 0.2, -0.9, 0.1}, at[KC_JOINT_MAX], info = 0.0;
    kc_ctx_t ctx;
    kc_loads_t loads;
    memcpy(at, q, sizeof at);
    at[3] += 0.3;
    kc_monitor_init(&s_mon, &s_arm, 0.0, 0.0);
    given_one_observation(&s_arm, &s_terms, s_coef, at, 0.0, &s_rng, &s_obs);
    memcpy(s_obs.ctx.q, q, sizeof q);
    for (uint32_t c = 0u; c < 6u; c++) { s_obs.cov[7u * c] *= 1.0 + (double)(c * c); }
    for (uint32_t n = 0u; n < 4u; n++) {
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_monitor_add(&s_mon, &s_arm, &s_terms, s_coef, &s_obs, &s_work));
    }
    ctx = s_obs.ctx;
    memcpy(ctx.q, at, sizeof at);
    kc_model_loads(&s_arm, &s_terms, s_coef, &ctx, &loads);
    kc_model_eval(&s_arm, &s_terms, s_coef, &ctx, &loads, false, &s_work);
    for (uint32_t c = 0u; c < 6u; c++) {
        info += 4.0 * s_work.Jq[3][c] * s_work.Jq[3][c] / s_obs.cov[7u * c];
    }
    kc_monitor_evaluate(&s_mon, &s_v);
    TEST_ASSERT_EQUAL_INT(KC_MON_NAMED, s_v.state);
    TEST_ASSERT_EQUAL_UINT32(3u, s_v.joint);
    TEST_ASSERT_EQUAL_UINT32(4u, s_v.n_obs);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.3, s_v.bias);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9 / sqrt(info), 1.0 / sqrt(info), s_v.sigma);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.0, s_v.rest);
}

void test_how_far_off_it_is_is_said_of_the_newest_observation(void)
{
    observations(3u, 0u, 0.0);
    s_obs.p_m[0] += 0.3;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_monitor_add(&s_mon, &s_arm, &s_terms, s_coef, &s_obs, &s_work));
    kc_monitor_evaluate(&s_mon, &s_v);
    TEST_ASSERT_DOUBLE_WITHIN(5e-3, 0.3, s_v.off_m);
    TEST_ASSERT_TRUE(s_v.off_rad < 0.05);
    observations(1u, 0u, 0.0);
    TEST_ASSERT_TRUE(s_v.off_m < 0.01);
}

void test_a_good_newest_observation_ends_what_is_unexplained(void)
{
    double q[KC_JOINT_MAX] = {0.0};
    for (uint32_t i = 0u; i < KC_MON_OBS_OFF; i++) {
        given_joints(&s_arm, &s_rng, q);
        given_one_observation(&s_arm, &s_terms, s_coef, q, 1.0, &s_rng, &s_obs);
        if (i + 1u < KC_MON_OBS_OFF) {
            s_obs.p_m[i] += 0.05;
            s_obs.p_m[2] += 0.05;
        }
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_monitor_add(&s_mon, &s_arm, &s_terms, s_coef, &s_obs, &s_work));
    }
    kc_monitor_evaluate(&s_mon, &s_v);
    TEST_ASSERT_EQUAL_INT(KC_MON_QUIET, s_v.state);
}

/* The first joint explains it almost as well as the fourth, which is named. */
void test_the_first_joint_can_be_a_suspect_beside_the_one_that_is_named(void)
{
    observations(6u, 3u, 0.05);
    for (uint32_t i = 0u; i < 6u; i++) {
        memcpy(s_mon.obs[i].Jq[0], s_mon.obs[i].Jq[3], sizeof s_mon.obs[i].Jq[0]);
        s_mon.obs[i].Jq[0][0] += i % 2u == 0u ? 2e-3 : -2e-3;
    }
    kc_monitor_evaluate(&s_mon, &s_v);
    TEST_ASSERT_EQUAL_INT(KC_MON_NAMED, s_v.state);
    TEST_ASSERT_EQUAL_HEX32(0x9u, s_v.suspects);
}

/* More noise than stated: a joint is named as long as a millionth of all noise leaves as much. Of 47 degrees of
 * freedom that is 108.177 (scipy.stats.chi2.isf(1e-6, 47)). */
void test_what_a_named_joint_leaves_may_be_as_rare_as_one_in_a_million(void)
{
    double q[KC_JOINT_MAX] = {0.0}, at[KC_JOINT_MAX], most = 0.0;
    for (double noise = 1.0; noise < 2.2; noise += 0.003) {
        setUp();
        for (uint32_t i = 0u; i < KC_MON_OBS_MAX; i++) {
            given_joints(&s_arm, &s_rng, q);
            memcpy(at, q, sizeof at);
            at[2] += 0.1;
            given_one_observation(&s_arm, &s_terms, s_coef, at, noise, &s_rng, &s_obs);
            memcpy(s_obs.ctx.q, q, sizeof q);
            (void)kc_monitor_add(&s_mon, &s_arm, &s_terms, s_coef, &s_obs, &s_work);
        }
        kc_monitor_evaluate(&s_mon, &s_v);
        if (s_v.state == KC_MON_NAMED && s_v.n_obs == 8u) { most = fmax(most, s_v.rest); }
    }
    TEST_ASSERT_TRUE(most > 107.0 && most <= 108.178);
}

/* The chance of the likeliest of three residuals in which one number alone is off; no joint can explain it. */
void test_every_number_of_a_residual_counts_in_what_is_unexplained(void)
{
    for (uint32_t c = 0u; c < 6u; c++) {
        setUp();
        observations(3u, 0u, 0.0);
        double most = 0.0;
        for (uint32_t i = 0u; i < 3u; i++) {
            kc_mon_obs_t *k = &s_mon.obs[i];
            double z = 7.0 + (double)((i + c) % 3u);
            memset(k->r, 0, sizeof k->r);
            memset(k->Jq, 0, sizeof k->Jq);
            k->r[c] = z * (c < 3u ? OBS_POS_M : OBS_ROT_RAD);
            most = fmax(most, kc_chi2_sf(z * z, 6u));
        }
        kc_monitor_evaluate(&s_mon, &s_v);
        TEST_ASSERT_EQUAL_INT(KC_MON_UNEXPLAINED, s_v.state);
        TEST_ASSERT_DOUBLE_WITHIN(1e-9 * most, most, s_v.p);
        TEST_ASSERT_DOUBLE_WITHIN(1e-15, c < 3u ? fabs(kc_monitor_back(&s_mon, 0u)->r[c]) : 0.0, s_v.off_m);
        TEST_ASSERT_DOUBLE_WITHIN(1e-15, c < 3u ? 0.0 : fabs(kc_monitor_back(&s_mon, 0u)->r[c]), s_v.off_rad);
    }
}

/* A covariance in which every error goes with every other. */
static void correlated(double cov[36])
{
    double A[36];
    for (uint32_t i = 0u; i < 36u; i++) {
        double off = 0.8 * kc_rng_uniform(&s_rng) - 0.4;
        A[i] = (i / 6u < 3u ? OBS_POS_M : OBS_ROT_RAD) * (i % 7u == 0u ? 1.0 + off : off);
    }
    for (uint32_t i = 0u; i < 36u; i++) {
        cov[i] = 0.0;
        for (uint32_t c = 0u; c < 6u; c++) { cov[i] += A[6u * (i / 6u) + c] * A[6u * (i % 6u) + c]; }
    }
}

/* Exact observations of correlated covariances. Of a joint that moves the tool by a, an error of the floor's size pulls
 * at the bias by C^-1 a; those of all observations act together. */
void test_sigma_is_that_of_least_squares_with_what_all_observations_share(void)
{
    for (uint32_t j = 0u; j < 7u; j++) {
        double all = 0.0, together = 0.0, squares = 0.0;
        setUp();
        s_rng = 30u + j;
        kc_monitor_init(&s_mon, &s_arm, 0.1 * (double)j * OBS_POS_M, 0.2 * OBS_ROT_RAD);
        for (uint32_t o = 0u; o < 4u; o++) {
            double q[KC_JOINT_MAX] = {0.0}, at[KC_JOINT_MAX], y[6], s2 = 0.0;
            kc_loads_t loads;
            kc_ctx_t ctx;
            given_joints(&s_arm, &s_rng, q);
            memcpy(at, q, sizeof at);
            at[j] += 0.25;
            given_one_observation(&s_arm, &s_terms, s_coef, at, 0.0, &s_rng, &s_obs);
            ctx = s_obs.ctx;
            memcpy(s_obs.ctx.q, q, sizeof q);
            correlated(s_obs.cov);
            TEST_ASSERT_EQUAL_INT(KC_OK, kc_monitor_add(&s_mon, &s_arm, &s_terms, s_coef, &s_obs, &s_work));
            kc_model_loads(&s_arm, &s_terms, s_coef, &ctx, &loads);
            kc_model_eval(&s_arm, &s_terms, s_coef, &ctx, &loads, false, &s_work);
            dense_solve6(s_obs.cov, s_work.Jq[j], y);
            for (uint32_t c = 0u; c < 6u; c++) {
                all += s_work.Jq[j][c] * y[c];
                s2 += y[c] * y[c] * s_mon.floor2[c];
            }
            together += sqrt(s2);
            squares += s2;
        }
        const double sigma = sqrt(all + together * together - squares) / all;
        kc_monitor_evaluate(&s_mon, &s_v);
        TEST_ASSERT_EQUAL_INT(KC_MON_NAMED, s_v.state);
        TEST_ASSERT_EQUAL_UINT32(j, s_v.joint);
        TEST_ASSERT_EQUAL_UINT32(4u, s_v.n_obs);
        TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.25, s_v.bias);
        TEST_ASSERT_DOUBLE_WITHIN(1e-6 * sigma, sigma, s_v.sigma);
        TEST_ASSERT_DOUBLE_WITHIN(1e-6 * pow(0.25 / sigma, 2.0), pow(0.25 / sigma, 2.0), s_v.stat);
    }
}
