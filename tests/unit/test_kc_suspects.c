/* kc_suspects.c: which joints are behind a finding, and how sure. Numbers against independent likelihoods are in
 * tests/oracle/test_suspects.py. */
#include <math.h>
#include <string.h>

#include "given_dense.h"
#include "given_observations.h"
#include "given_small_arm.h"
#include "given_tables.h"
#include "kc_chi2.h"
#include "kc_la.h"
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
static double s_coarser; /* sigmas: times those of observations */

void setUp(void)
{
    given_arm(&s_arm);
    given_terms(&s_terms);
    memset(s_coef, 0, sizeof s_coef);
    memset(s_bias, 0, sizeof s_bias);
    s_rng = 5u;
    s_coarser = 1.0;
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

/* ---- by dense algebra ---- */

/* A covariance A A' in which every error goes with every other, of about these sigmas. */
static void drawn_cov(double A[36], double cov[36])
{
    for (uint32_t i = 0u; i < 36u; i++) {
        A[i] = s_coarser * (i / 6u < 3u ? OBS_POS_M : OBS_ROT_RAD) *
               ((i % 7u == 0u ? 1.0 : 0.0) + 0.4 * drawn(&s_rng));
    }
    for (uint32_t i = 0u; i < 36u; i++) { cov[i] = dense_dot(&A[6u * (i / 6u)], &A[6u * (i % 6u)], 6u); }
}

/* Sums over n observations of covariance cov: what biases that move the tool by rows a[o][j] do to the residuals r. */
#define N_DENSE 5u
typedef struct {
    double a[N_DENSE][KC_JOINT_MAX][6], r[N_DENSE][6], cov[N_DENSE][36], floor2[6];
} dense_t;
static dense_t s_d;

/* Information of the biases of joints i and j together, by C^-1. */
static double info(uint32_t i, uint32_t j)
{
    double y[6], s = 0.0;
    for (uint32_t o = 0u; o < N_DENSE; o++) {
        dense_solve6(s_d.cov[o], s_d.a[o][j], y);
        s += dense_dot(s_d.a[o][i], y, 6u);
    }
    return s;
}

/* Variance of the gradient: an error of the floor's size in each observation pulls by y = C^-1 a; those of all
 * observations act together. */
static double var_of(uint32_t j)
{
    double together = 0.0, squares = 0.0;
    for (uint32_t o = 0u; o < N_DENSE; o++) {
        double y[6], s2 = 0.0;
        dense_solve6(s_d.cov[o], s_d.a[o][j], y);
        for (uint32_t c = 0u; c < 6u; c++) { s2 += y[c] * y[c] * s_d.floor2[c]; }
        together += sqrt(s2);
        squares += s2;
    }
    return info(j, j) + together * together - squares;
}

static double gradient(uint32_t j)
{
    double y[6], s = 0.0;
    for (uint32_t o = 0u; o < N_DENSE; o++) {
        dense_solve6(s_d.cov[o], s_d.r[o], y);
        s += dense_dot(s_d.a[o][j], y, 6u);
    }
    return s;
}

static void given_floor(double part)
{
    kc_monitor_init(&s_mon, &s_arm, part * s_coarser * OBS_POS_M, part * s_coarser * OBS_ROT_RAD);
    memcpy(s_d.floor2, s_mon.floor2, sizeof s_d.floor2);
}

/* Exact observations of an arm whose joints stand s_bias beyond their readings; rows where they stand. */
static void observe_exactly(void)
{
    for (uint32_t o = 0u; o < N_DENSE; o++) {
        double q[KC_JOINT_MAX] = {0.0}, at[KC_JOINT_MAX], A[36];
        kc_loads_t loads;
        kc_ctx_t ctx;
        given_joints(&s_arm, &s_rng, q);
        for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { at[j] = q[j] + s_bias[j]; }
        given_one_observation(&s_arm, &s_terms, s_coef, at, 0.0, &s_rng, &s_obs);
        drawn_cov(A, s_obs.cov);
        memcpy(s_d.cov[o], s_obs.cov, sizeof s_obs.cov);
        ctx = s_obs.ctx;
        memcpy(s_obs.ctx.q, q, sizeof q);
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_monitor_add(&s_mon, &s_arm, &s_terms, s_coef, &s_obs, &s_work));
        kc_model_loads(&s_arm, &s_terms, s_coef, &ctx, &loads);
        kc_model_eval(&s_arm, &s_terms, s_coef, &ctx, &loads, false, &s_work);
        memcpy(s_d.a[o], s_work.Jq, sizeof s_work.Jq);
    }
}

void test_sigmas_are_those_of_least_squares_with_what_all_observations_share(void)
{
    for (uint32_t k = 0u; k < 28u; k++) {
        const uint32_t a = k % 7u, b = (a + 1u + k / 3u % 6u) % 7u;
        const bool two = k / 7u % 2u == 0u;
        setUp();
        s_coarser = k < 14u ? 1.0 : 20.0;
        given_floor(0.15 * (double)(k % 4u));
        s_bias[a] = 0.3;
        s_bias[b] = two ? -0.2 : 0.0;
        s_rng = 20u + k;
        observe_exactly();
        weigh(N_DENSE);
        TEST_ASSERT_EQUAL_HEX32(1u << a | (two ? 1u << b : 0u), s_s.joints);
        const double kept = two ? 1.0 - info(a, b) * info(a, b) / (info(a, a) * info(b, b)) : 1.0;
        for (uint32_t j = 0u; j < 7u; j++) {
            const bool named = j == a || (two && j == b);
            const double sigma = named ? sqrt(var_of(j) / kept) / info(j, j) : 0.0;
            TEST_ASSERT_DOUBLE_WITHIN(1e-5 * sigma, sigma, s_s.sigma[j]);
            TEST_ASSERT_DOUBLE_WITHIN(2e-6, named ? s_bias[j] : 0.0, s_s.bias[j]);
        }
    }
}

/* Sliding joints, so that all is linear; residuals that no set explains alone. */
static void given_sliders(uint32_t n_joints)
{
    s_mon.n_joints = n_joints;
    s_mon.prismatic = (1u << n_joints) - 1u;
    memset(&s_d.a, 0, sizeof s_d.a);
    for (uint32_t o = 0u; o < N_DENSE; o++) {
        kc_mon_obs_t *k = &s_mon.obs[s_mon.next];
        double A[36], u[6];
        drawn_cov(A, s_d.cov[o]);
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_la_whiten(s_d.cov[o], 6u, k->W));
        for (uint32_t c = 0u; c < 6u; c++) { u[c] = drawn(&s_rng); }
        for (uint32_t c = 0u; c < 6u; c++) { s_d.r[o][c] = dense_dot(&A[6u * c], u, 6u); }
        for (uint32_t j = 0u; j < n_joints; j++) {
            for (uint32_t c = 0u; c < 3u; c++) { s_d.a[o][j][c] = drawn(&s_rng); }
        }
        for (uint32_t c = 0u; c < 3u; c++) {
            s_d.r[o][c] += 0.0006 * s_d.a[o][0][c] - 0.0006 * s_d.a[o][1][c];
        }
        memcpy(k->r, s_d.r[o], sizeof k->r);
        memcpy(k->Jq, s_d.a[o], sizeof k->Jq);
        s_mon.next = (s_mon.next + 1u) % KC_MON_OBS_MAX;
        s_mon.n++;
    }
}

/* Weight of every set as kc_suspects.h says, from normal equations. */
static double dense_chances(uint32_t n_joints, double *chance)
{
    double log_w[KC_JOINT_MAX][KC_JOINT_MAX], trusted = 1.0, sum = 0.0, chi2 = 0.0, y[6];
    bool plausible[KC_JOINT_MAX][KC_JOINT_MAX];
    for (uint32_t o = 0u; o < N_DENSE; o++) {
        dense_solve6(s_d.cov[o], s_d.r[o], y);
        chi2 += dense_dot(s_d.r[o], y, 6u);
    }
    for (uint32_t pass = 0u; pass < 2u; pass++) {
        for (uint32_t j = 0u; j < n_joints; j++) {
            for (uint32_t i = 0u; i <= j; i++) {
                const double n = i == j ? 1.0 : 2.0, a = info(j, j), b = info(i, i), ab = info(i, j);
                const double g = gradient(j), h = gradient(i), det = i == j ? a : a * b - ab * ab;
                const double gain = i == j ? g * g / a : (b * g * g - 2.0 * ab * g * h + a * h * h) / det;
                plausible[j][i] = kc_chi2_sf(chi2 - gain, 6u * N_DENSE - (i == j ? 1u : 2u)) >= KC_MON_P_REST;
                if (pass == 0u && plausible[j][i]) {
                    trusted = fmin(trusted, fmin(a / var_of(j), b / var_of(i)));
                }
                log_w[j][i] = -0.5 * trusted * (chi2 - gain) + (n - 1.0) * log(KC_SUSPECT_ODDS) +
                              n * log(sqrt(2.0 * 3.14159265358979323846) / (2.0 * KC_SUSPECT_BIAS)) -
                              0.5 * log(pow(trusted, n) * det);
            }
        }
    }
    memset(chance, 0, KC_JOINT_MAX * sizeof *chance);
    for (uint32_t j = 0u; j < n_joints; j++) {
        for (uint32_t i = 0u; i <= j; i++) {
            double w = plausible[j][i] ? exp(log_w[j][i] - log_w[0][0]) : 0.0;
            sum += w;
            chance[j] += w;
            chance[i] += i == j ? 0.0 : w;
        }
    }
    for (uint32_t j = 0u; j < n_joints; j++) { chance[j] /= sum; }
    return trusted;
}

void test_chances_are_those_of_the_integrated_likelihoods(void)
{
    uint32_t n_open = 0u;
    for (uint32_t k = 0u; k < 40u; k++) {
        double chance[KC_JOINT_MAX];
        const uint32_t n_joints = 2u + k % 4u;
        setUp();
        given_floor(k % 2u == 0u ? 0.0 : 0.2);
        s_rng = 100u + k;
        given_sliders(n_joints);
        weigh(N_DENSE);
        double trusted = dense_chances(n_joints, chance);
        TEST_ASSERT_TRUE(k % 2u == 0u ? trusted == 1.0 : trusted < 0.9);
        uint32_t suspects = 0u;
        for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) {
            TEST_ASSERT_DOUBLE_WITHIN(1e-7, j < n_joints ? chance[j] : 0.0, s_s.chance[j]);
            n_open += s_s.chance[j] > 0.02 && s_s.chance[j] < 0.98;
            suspects |= (j < n_joints && chance[j] >= KC_SUSPECT_MIN ? 1u : 0u) << j;
        }
        TEST_ASSERT_EQUAL_HEX32(suspects, s_s.suspects);
    }
    TEST_ASSERT_TRUE(n_open > 40u);
}

/* A bias is sought up to 1.6 m or rad. */
void test_a_bias_ends_at_its_limit(void)
{
    for (int32_t sign = -1; sign < 2; sign += 2) {
        setUp();
        given_floor(0.0);
        given_sliders(1u);
        for (uint32_t o = 0u; o < N_DENSE; o++) {
            kc_mon_obs_t *k = &s_mon.obs[o];
            for (uint32_t c = 0u; c < 6u; c++) { k->r[c] = 1.6001 * sign * k->Jq[0][c]; }
        }
        weigh(N_DENSE);
        TEST_ASSERT_EQUAL_HEX32(1u, s_s.joints);
        TEST_ASSERT_EQUAL_DOUBLE(sign * KC_SUSPECT_BIAS, s_s.bias[0]);
    }
}
