/* kc_view.c: stamps of the mission clock as elapsed time, also where they do not fit; what is read of the arm, and where
 * its tool is expected. */
#include <stdint.h>
#include <string.h>

#include "given_parts.h"
#include "kc_model.h"
#include "kc_path.h"
#include "kc_view.h"
#include "unity.h"

void setUp(void) { given_parts(); }

/* The oracle has 128 bits; the numbers are those around which 64 bits come to their ends. */
void test_a_stamp_is_as_far_from_now_as_from_the_clock_and_no_end_of_time_is_passed(void)
{
    __extension__ typedef __int128 wide_t;
    static const uint64_t half = (uint64_t)1u << 63u, all = UINT64_MAX;
    const uint64_t us[] = {0u, 1u, 2u, 999u, 4999000u, 5000000u, half - 1u, half, all - 999u, all - 1u, all};
    enum { N = sizeof us / sizeof us[0] };
    for (uint32_t i = 0u; i < N * N * N; i++) {
        kc_clock_t clock = {.now_us = us[i % N], .clock_us = us[i / N % N]};
        kc_view_t view = {.clock = &clock};
        uint64_t stamp = us[i / N / N];
        wide_t want = (wide_t)clock.now_us + (wide_t)stamp - (wide_t)clock.clock_us;
        want = want < 0 ? 0 : want > all ? all : want;
        TEST_ASSERT_EQUAL_UINT64((uint64_t)want, kc_view_elapsed(&view, stamp));
    }
}

void test_time_in_a_state_counts_from_its_beginning(void)
{
    TEST_ASSERT_EQUAL_UINT64(0u, kc_view_in_state_us(&parts.view));
    parts.clock.now_us += 1234u;
    parts.clock.clock_us += 99u;
    TEST_ASSERT_EQUAL_UINT64(1234u, kc_view_in_state_us(&parts.view));
}

/* At most 256 candidates stand for the space, and as many as there are if they are fewer. */
void test_the_stride_is_the_least_that_leaves_no_more_than_the_samples(void)
{
    static const uint32_t cases[][2] = {{1u, 1u},   {2u, 1u},   {255u, 1u}, {256u, 1u}, {257u, 2u},
                                        {512u, 2u}, {513u, 3u}, {768u, 3u}, {1024u, 4u}};
    for (uint32_t i = 0u; i < sizeof cases / sizeof cases[0]; i++) {
        parts.tables.active.space.n_cand = cases[i][0];
        TEST_ASSERT_EQUAL_UINT32(cases[i][1], kc_view_stride(&parts.view));
    }
}

void test_it_is_at_rest_only_if_neither_the_arm_nor_the_pantilt_unit_moves(void)
{
    for (uint8_t k = 0u; k < 4u; k++) {
        parts.telemetry.arm.moving = k & 1u;
        parts.telemetry.pantilt.moving = k >> 1u;
        TEST_ASSERT_EQUAL_INT(k == 0u, kc_view_at_rest(&parts.view));
    }
}

/* ---- variables of the bases, and the tool ---- */

static kc_arm_t *arm_table(void) { return &parts.tables.active.arm; }

/* Telemetry with a number of its own in every field that is read. */
static void given_telemetry(void)
{
    kc_arm_state_t *a = &parts.telemetry.arm;
    for (uint32_t i = 0u; i < 3u; i++) { a->g_m_s2[i] = -1.0 - (double)i; }
    for (uint32_t j = 0u; j < 7u; j++) { a->q[j] = 0.1 * (double)(j + 1u); }
    a->temp_c = 31.0;
    a->payload_kg = 2.5;
    parts.clock.now_us = 123456789u;
}

void test_variables_are_the_seed_and_the_newest_telemetry_and_nothing_else(void)
{
    for (uint32_t cand = 0u; cand < 9u; cand++) {
        kc_ctx_t want, got;
        given_telemetry();
        memset(&want, 0, sizeof want);
        memset(&got, 0xff, sizeof got);
        for (uint32_t j = 0u; j < 7u; j++) {
            want.q[j] = (double)parts.tables.active.space.cand[cand].q_seed[j];
        }
        for (uint32_t i = 0u; i < 3u; i++) { want.g_m_s2[i] = -1.0 - (double)i; }
        want.temp_c = 31.0;
        want.payload_kg = 2.5;
        want.t_s = 123.456789;
        kc_view_ctx(&parts.view, cand, &got);
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, want.t_s, got.t_s);
        got.t_s = want.t_s;
        TEST_ASSERT_EQUAL_MEMORY(&want, &got, sizeof want);
    }
}

static void expect_pose(const double *q, const kc_pose_t *got)
{
    kc_pose_t want;
    kc_arm_fk(arm_table(), q, &want);
    for (uint32_t i = 0u; i < 3u; i++) { TEST_ASSERT_DOUBLE_WITHIN(1e-9, want.p_m[i], got->p_m[i]); }
    for (uint32_t i = 0u; i < 9u; i++) { TEST_ASSERT_DOUBLE_WITHIN(1e-9, want.R[i], got->R[i]); }
}

/* Errors of the angles are as joints that stand elsewhere; joints are given, or those of a candidate. */
void test_the_tool_is_expected_where_the_corrected_arm_has_it(void)
{
    double coef[KC_COEF_MAX] = {0.0}, q[KC_JOINT_MAX], at[KC_JOINT_MAX];
    kc_pose_t T;
    kc_fixed_t fixed;
    for (uint32_t k = 0u; k < 18u; k++) {
        given_telemetry();
        memset(&T, 0, sizeof T);
        kc_path_joints(&parts.tables.active.space, KC_HUB_MAX + k % 9u, q);
        for (uint32_t j = 0u; j < 7u; j++) {
            coef[4u * j] = k < 9u ? 0.0 : 0.02 * (double)j - 0.05;
            at[j] = q[j] + coef[4u * j];
        }
        kc_model_fix(arm_table(), &parts.tables.active.terms, coef, &fixed);
        kc_view_pose(&parts.view, &fixed, k % 9u, &T);
        expect_pose(at, &T);
        for (uint32_t j = 0u; j < 7u; j++) {
            q[j] += 0.1;
            at[j] += 0.1;
        }
        memcpy(parts.latest.coef, coef, sizeof coef);
        kc_view_expect(&parts.view, q, &T);
        expect_pose(at, &T);
    }
}

/* One coefficient turns joint 2 by its gravity torque, that of the payload included. */
void test_an_arm_that_sags_is_expected_where_it_sags_to(void)
{
    double coef[KC_COEF_MAX] = {0.0}, q[KC_JOINT_MAX];
    kc_terms_t *t = &parts.tables.active.terms;
    kc_loads_t loads;
    kc_ctx_t ctx;
    kc_pose_t T;
    kc_fixed_t fixed;
    t->term[4].basis[0] = (kc_basis_t){.fn = KC_FN_LIN, .var = KC_VAR_TAU, .index = 2u, .c1 = 1.0};
    coef[4] = 2e-3;
    kc_model_fix(arm_table(), t, coef, &fixed);
    for (uint32_t cand = 0u; cand < 9u; cand++) {
        given_telemetry();
        memset(&ctx, 0, sizeof ctx);
        kc_path_joints(&parts.tables.active.space, KC_HUB_MAX + cand, q);
        memcpy(ctx.q, q, sizeof ctx.q);
        for (uint32_t i = 0u; i < 3u; i++) { ctx.g_m_s2[i] = -1.0 - (double)i; }
        ctx.payload_kg = 2.5;
        kc_model_loads(arm_table(), t, coef, &ctx, &loads);
        q[1] += coef[4] * loads.tau[1];
        kc_view_pose(&parts.view, &fixed, cand, &T);
        expect_pose(q, &T);
        memcpy(parts.latest.coef, coef, sizeof coef);
        memset(&T, 0, sizeof T);
        kc_view_expect(&parts.view, ctx.q, &T);
        expect_pose(q, &T);
    }
}

/* ---- where the arm stands ---- */

void test_the_distance_is_that_of_the_joint_that_is_farthest_off(void)
{
    for (uint32_t k = 0u; k < 14u; k++) {
        double q[KC_JOINT_MAX];
        given_telemetry();
        parts.telemetry.arm.q[7] = 9.0; /* not of this arm */
        memcpy(q, parts.telemetry.arm.q, sizeof q);
        q[7] = -9.0;
        TEST_ASSERT_EQUAL_DOUBLE(0.0, kc_view_distance(&parts.view, q));
        q[(k + 3u) % 7u] += 0.01;
        q[k % 7u] += k < 7u ? 0.3 : -0.3;
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.3, kc_view_distance(&parts.view, q));
    }
}

void test_the_seed_is_that_of_the_current_candidate_and_so_is_whether_it_is_local(void)
{
    for (int32_t cand = 0; cand < 9; cand++) {
        kc_cand_t *c = &parts.tables.active.space.cand[cand];
        double q[KC_JOINT_MAX] = {0.0};
        parts.cal.candidate = cand;
        kc_view_seed(&parts.view, q);
        for (uint32_t j = 0u; j < 7u; j++) { TEST_ASSERT_EQUAL_DOUBLE((double)c->q_seed[j], q[j]); }
        TEST_ASSERT_FALSE(kc_view_local(&parts.view));
        c->why |= KC_CAND_LOCAL;
        TEST_ASSERT_TRUE(kc_view_local(&parts.view));
    }
}
