/* kc_suspicion.c: the prior that the monitor's suspects give, and when it is dropped. Calibrations with it:
 * test_suspicion.c. */
#include "kc_suspicion.h"

#include <math.h>
#include <string.h>

#include "given_parts.h"
#include "unity.h"

#define PHI(j) (4u * (j)) /* coefficient: offset of joint j, from 0 */

static kc_active_t *s_tables;
static kc_suspects_t s_suspects;

void setUp(void)
{
    given_parts();
    s_tables = &parts.tables.active;
    s_suspects = (kc_suspects_t){.joints = 8u, .suspects = 12u};
    parts.est.opt = s_tables->config.est;
}

void test_the_offset_of_a_joint_is_what_moves_the_tool_as_the_joint_does(void)
{
    kc_active_t *a = s_tables;
    const uint64_t all = ~(uint64_t)0u;
    TEST_ASSERT_EQUAL_UINT64(0u, kc_suspicion_offsets(a, 0u, all));
    TEST_ASSERT_EQUAL_UINT64(1u, kc_suspicion_offsets(a, 1u, all));
    TEST_ASSERT_EQUAL_UINT64(1ull << 8 | 1ull << 24, kc_suspicion_offsets(a, 0x44u, all));
    TEST_ASSERT_EQUAL_UINT64(1ull << 24, kc_suspicion_offsets(a, 0x44u, ~(1ull << 8)));
    TEST_ASSERT_EQUAL_UINT64(0u, kc_suspicion_offsets(a, 0x80u, all)); /* the arm has no eighth joint */
    a->arm.joint[2].type = KC_PRISMATIC; /* it moves along its axis: the fourth coefficient, tz */
    TEST_ASSERT_EQUAL_UINT64(1ull << 11, kc_suspicion_offsets(a, 0x4u, all));
    for (uint32_t i = 0u; i < a->terms.n_term; i++) { a->terms.term[i].basis[i % 2u].var = KC_VAR_Q; }
    TEST_ASSERT_EQUAL_UINT64(0u, kc_suspicion_offsets(a, 0x7fu, all)); /* gains are no offsets */
}

void test_the_prior_is_the_mixture_of_the_bounds_and_of_what_is_known(void)
{
    const double chance[KC_JOINT_MAX] = {0.5, 0.25, 1.0, 0.75, 0.0, 0.0, 0.0, 0.0};
    kc_active_t *a = s_tables;
    kc_est_t *e = &parts.est;
    memcpy(s_suspects.chance, chance, sizeof chance);
    a->config.rest_part = 0.02;
    a->kin.sigma[5] = 0.05 * a->terms.coef[5].scale; /* known worse than that from the last calibration */
    a->kin.sigma[6] = 1e3; /* no worse than its bounds */
    e->prior_sigma[28] = -1.0; /* there is no such coefficient */
    kc_suspicion_begin(e, &parts.view, &s_suspects, &parts.out);
    expect_event(KC_EVT_CAL_SUSPECTS, -1, 8.0, 12.0);
    TEST_ASSERT_EQUAL_UINT8(1u, e->by_prior);
    TEST_ASSERT_EQUAL_PTR(a->kin.value, e->prior_mean);
    TEST_ASSERT_EQUAL_DOUBLE(-1.0, e->prior_sigma[28]);
    for (uint32_t c = 0u; c < 28u; c++) {
        const kc_coef_t *k = &a->terms.coef[c];
        double narrow = 0.02 * k->scale, wide = (k->ub - k->lb) / sqrt(12.0),
               p = c % 4u == 0u ? chance[c / 4u] : 0.0;
        if (c == 5u) { narrow = 0.05 * k->scale; }
        if (c == 6u) { narrow = wide; }
        double want = sqrt(p * wide * wide + (1.0 - p) * narrow * narrow);
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, want, e->prior_sigma[c]);
        TEST_ASSERT_TRUE(e->prior_sigma[c] <= wide * (1.0 + 1e-12));
    }
}

void test_a_coefficient_with_a_prior_of_its_own_is_never_less_certain_than_that(void)
{
    kc_active_t *a = s_tables;
    s_suspects.chance[3] = 1.0;
    a->terms.coef[PHI(3u)].prior_sigma = 0.02;
    s_suspects.chance[2] = 1.0;
    a->terms.coef[1].prior_sigma = 1e-5;
    kc_est_t *e = &parts.est;
    e->opt.use_prior = 1u;
    kc_suspicion_begin(e, &parts.view, &s_suspects, &parts.out);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.02, e->prior_sigma[PHI(3u)]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 1e-5, e->prior_sigma[1]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, kc_est_bound_sigma(&a->terms.coef[PHI(2u)]), e->prior_sigma[PHI(2u)]);
    e->opt.use_prior = 0u; /* what is not used does not count */
    kc_suspicion_begin(e, &parts.view, &s_suspects, &parts.out);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, kc_est_bound_sigma(&a->terms.coef[PHI(3u)]), e->prior_sigma[PHI(3u)]);
}

void test_a_suspicion_is_dropped_where_the_observations_cast_doubt_on_it(void)
{
    kc_est_t *e = &parts.est;
    e->n_obs = 3u; /* 18 rows */
    parts.plan.n_meas = 3u;
    for (uint8_t by_prior = 0u; by_prior < 2u; by_prior++) {
        e->by_prior = by_prior;
        e->cost = 18.0;
        TEST_ASSERT_FALSE(kc_suspicion_fails(e, &parts.view, &parts.out));
        TEST_ASSERT_EQUAL_UINT8(by_prior, e->by_prior);
        e->cost = 300.0;
        TEST_ASSERT_TRUE((by_prior != 0u) == kc_suspicion_fails(e, &parts.view, &parts.out));
        TEST_ASSERT_EQUAL_UINT8(0u, e->by_prior);
    }
    double p = parts.out.events.e[0].got;
    TEST_ASSERT_TRUE(p > 0.0 && p < s_tables->config.doubt_p);
    expect_event(KC_EVT_CAL_SUSPECTS_DROPPED, 3, p, s_tables->config.doubt_p);
}
