/* kc_suspects.c: which joints are behind a finding, and how sure. Numbers against independent likelihoods are in
 * tests/oracle/test_suspects.py. */
#include <math.h>
#include <string.h>

#include "given_observations.h"
#include "given_small_arm.h"
#include "given_tables.h"
#include "kc_suspects.h"
#include "unity.h"

static kc_arm_t s_arm;
static kc_terms_t s_terms;
static kc_monitor_t s_mon;
static kc_suspects_t s_s;
static kc_obs_t s_obs;
static kc_eval_t s_work;
static double s_coef[KC_COEF_MAX], s_bias[KC_JOINT_MAX];
static uint64_t s_rng;

void setUp(void);
void setUp(void)
{
    given_arm(&s_arm);
    given_terms(&s_terms);
    memset(s_coef, 0, sizeof s_coef);
    memset(s_bias, 0, sizeof s_bias);
    s_rng = 5u;
    kc_monitor_init(&s_mon, &s_arm, 2e-4, 5e-4);
}

/* n observations of an arm whose joints stand s_bias beyond their readings. */
static void observe(uint32_t n, double noise)
{
    double q[KC_JOINT_MAX] = {0.0}, at[KC_JOINT_MAX];
    for (uint32_t i = 0u; i < n; i++) {
        given_joints(&s_arm, &s_rng, q);
        for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { at[j] = q[j] + s_bias[j]; }
        given_one_observation(&s_arm, &s_terms, s_coef, at, noise, &s_rng, &s_obs);
        memcpy(s_obs.ctx.q, q, sizeof q);
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_monitor_add(&s_mon, &s_arm, &s_terms, s_coef, &s_obs, &s_work));
    }
}

static void weigh(uint32_t n) { kc_suspects_weigh(&s_mon, n, &s_s); }

static void nothing_named(uint32_t n_obs)
{
    TEST_ASSERT_EQUAL_UINT32(n_obs, s_s.n_obs);
    TEST_ASSERT_EQUAL_HEX32(0u, s_s.joints);
    TEST_ASSERT_EQUAL_HEX32(0u, s_s.suspects);
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) {
        TEST_ASSERT_EQUAL_DOUBLE(0.0, s_s.chance[j]);
        TEST_ASSERT_EQUAL_DOUBLE(0.0, s_s.bias[j]);
    }
}

void test_fewer_than_two_observations_name_nothing(void)
{
    weigh(2u);
    nothing_named(0u);
    s_bias[0] = 0.1;
    observe(1u, 1.0);
    weigh(2u);
    nothing_named(1u);
    observe(1u, 1.0);
    weigh(1u);
    nothing_named(1u);
    weigh(2u);
    TEST_ASSERT_EQUAL_HEX32(1u, s_s.joints);
}

void test_at_most_six_observations_are_weighed(void)
{
    s_bias[2] = 0.05;
    observe(8u, 1.0);
    weigh(8u);
    TEST_ASSERT_EQUAL_UINT32(6u, s_s.n_obs);
    weigh(4u);
    TEST_ASSERT_EQUAL_UINT32(4u, s_s.n_obs);
}

/* Every pair of an arm with exact turns, without noise: both, and by exactly as much. */
void test_two_joints_are_named_with_their_biases(void)
{
    for (uint32_t a = 0u; a < 7u; a++) {
        for (uint32_t b = 0u; b < a; b++) {
            setUp();
            s_bias[a] = a == 6u ? 1.2 : 0.12;
            s_bias[b] = -0.09;
            observe(5u, 0.0);
            weigh(5u);
            TEST_ASSERT_EQUAL_HEX32(1u << a | 1u << b, s_s.joints);
            TEST_ASSERT_EQUAL_HEX32(1u << a | 1u << b, s_s.suspects);
            TEST_ASSERT_DOUBLE_WITHIN(2e-4, s_bias[a], s_s.bias[a]);
            TEST_ASSERT_DOUBLE_WITHIN(2e-4, s_bias[b], s_s.bias[b]);
            TEST_ASSERT_TRUE(s_s.sigma[a] > 1e-5 && s_s.sigma[a] < 1e-2);
            TEST_ASSERT_TRUE(s_s.chance[a] > 0.999 && s_s.chance[b] > 0.999 && s_s.p_rest > 0.99);
        }
    }
}

void test_biases_are_within_their_sigma(void)
{
    double sum2 = 0.0;
    for (uint32_t k = 0u; k < 60u; k++) {
        kc_monitor_init(&s_mon, &s_arm, 0.0, 0.0);
        s_bias[1] = 0.06;
        s_bias[4] = -0.05;
        observe(4u, 1.0);
        weigh(4u);
        TEST_ASSERT_EQUAL_HEX32(0x12u, s_s.joints);
        for (uint32_t j = 1u; j <= 4u; j += 3u) {
            sum2 += pow((s_s.bias[j] - s_bias[j]) / s_s.sigma[j], 2.0);
        }
    }
    TEST_ASSERT_DOUBLE_WITHIN(0.25, 1.0, sqrt(sum2 / 120.0));
}

void test_one_joint_is_not_made_two_by_noise(void)
{
    for (uint32_t j = 0u; j < 7u; j++) {
        setUp();
        s_bias[j] = 0.06;
        observe(4u, 1.0);
        weigh(4u);
        TEST_ASSERT_EQUAL_HEX32(1u << j, s_s.joints);
        TEST_ASSERT_TRUE(s_s.chance[j] > 0.99);
        double rest = 0.0;
        for (uint32_t i = 0u; i < 7u; i++) { rest += i == j ? 0.0 : s_s.chance[i]; }
        TEST_ASSERT_TRUE(rest > 0.0 && rest < 0.05);
    }
}

void test_joints_with_one_axis_share_the_chance(void)
{
    double q[KC_JOINT_MAX] = {0.0}, at[KC_JOINT_MAX] = {0.0}, sum = 0.0;
    at[2] = 0.05; /* stretched straight up, joints 1, 3, 5 and 7 turn about one line */
    for (uint32_t i = 0u; i < 3u; i++) {
        given_one_observation(&s_arm, &s_terms, s_coef, at, 1.0, &s_rng, &s_obs);
        memcpy(s_obs.ctx.q, q, sizeof q);
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_monitor_add(&s_mon, &s_arm, &s_terms, s_coef, &s_obs, &s_work));
    }
    weigh(3u);
    TEST_ASSERT_EQUAL_HEX32(0x55u, s_s.suspects);
    for (uint32_t j = 0u; j < 7u; j += 2u) {
        TEST_ASSERT_DOUBLE_WITHIN(0.1, 0.25, s_s.chance[j]);
        sum += s_s.chance[j];
    }
    TEST_ASSERT_DOUBLE_WITHIN(0.02, 1.0, sum);
}

void test_what_neither_one_nor_two_joints_explain_names_nothing(void)
{
    for (uint32_t j = 0u; j < 3u; j++) { s_bias[j + 1u] = 0.1; }
    observe(5u, 1.0);
    weigh(5u);
    nothing_named(5u);
}

/* Errors that all observations share may lie behind a difference of chi-square: it counts less, and a chance is nearer
 * to what is known without observations. */
void test_a_larger_floor_makes_it_less_certain(void)
{
    double sure[2];
    for (uint32_t k = 0u; k < 2u; k++) {
        setUp();
        kc_monitor_init(&s_mon, &s_arm, k == 0u ? 0.0 : OBS_POS_M, k == 0u ? 0.0 : OBS_ROT_RAD);
        s_bias[1] = 0.05;
        s_bias[4] = 0.012;
        observe(4u, 0.2);
        weigh(4u);
        sure[k] = s_s.chance[4] / (1.0 - s_s.chance[4]);
    }
    TEST_ASSERT_TRUE(sure[1] < 0.5 * sure[0]);
}

/* Neither alone nor with another: whatever its bias, the residuals stay the same. */
void test_a_joint_that_does_not_move_the_tool_has_no_chance(void)
{
    double sum = 0.0;
    observe(4u, 1.0);
    for (uint32_t i = 0u; i < 4u; i++) { memset(s_mon.obs[i].Jq[3], 0, sizeof s_mon.obs[i].Jq[3]); }
    weigh(4u);
    TEST_ASSERT_TRUE(s_s.joints != 0u && s_s.p_rest > KC_MON_P_REST); /* every set explains noise */
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_s.chance[3]);
    for (uint32_t j = 0u; j < 7u; j++) {
        TEST_ASSERT_TRUE(j == 3u || s_s.chance[j] > 0.0);
        sum += s_s.chance[j];
    }
    TEST_ASSERT_TRUE(sum >= 1.0 - 1e-12 && sum <= 2.0);
}

void test_a_prismatic_joint_is_named_in_metres(void)
{
    given_small_arm(&s_arm);
    memset(&s_terms, 0, sizeof s_terms);
    uint32_t p = 0u;
    while (s_arm.joint[p].type != KC_PRISMATIC) { p++; }
    for (uint32_t j = 0u; j < s_arm.n_joints; j++) {
        kc_monitor_init(&s_mon, &s_arm, 2e-4, 5e-4);
        memset(s_bias, 0, sizeof s_bias);
        s_bias[p] = 0.3;
        if (j != p) { s_bias[j] = -0.2; }
        observe(5u, 0.0);
        weigh(5u);
        TEST_ASSERT_EQUAL_HEX32(1u << p | 1u << j, s_s.joints);
        TEST_ASSERT_DOUBLE_WITHIN(1e-4, 0.3, s_s.bias[p]);
        if (j != p) { TEST_ASSERT_DOUBLE_WITHIN(1e-4, -0.2, s_s.bias[j]); }
    }
}

void test_the_cost_grows_with_observations_and_fits_into_a_step(void)
{
    TEST_ASSERT_TRUE(kc_suspects_cost(&s_mon) < 1000000u);
    observe(3u, 1.0);
    uint64_t three = kc_suspects_cost(&s_mon);
    observe(3u, 1.0);
    uint64_t six = kc_suspects_cost(&s_mon);
    observe(2u, 1.0);
    TEST_ASSERT_EQUAL_UINT64(six, kc_suspects_cost(&s_mon));
    TEST_ASSERT_TRUE(six > three + three / 2u);
    s_mon.n_joints = KC_JOINT_MAX;
    TEST_ASSERT_TRUE(kc_suspects_cost(&s_mon) < KC_STEP_WORK - 500000u);
}
