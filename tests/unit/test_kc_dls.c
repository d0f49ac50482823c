/* kc_dls.c: the bounded damped step against closed forms. */
#include <math.h>
#include <string.h>

#include "given_tables.h"
#include "kc_dls.h"
#include "unity.h"

static const double s_wide[KC_JOINT_MAX] = {9, 9, 9, 9, 9, 9, 9, 9};
static const double s_neg[KC_JOINT_MAX] = {-9, -9, -9, -9, -9, -9, -9, -9};

void test_the_cost_counts_an_angle_as_arm_length_times_angle(void)
{
    const double e[6] = {3.0, 0.0, 4.0, 0.0, 10.0, 0.0};
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 25.0 + 9.0, kc_dls_cost(e));
}

void test_one_joint_gives_the_damped_quotient(void)
{
    /* d/dq |e - J q|^2 + l^2 q^2 = 0  ->  q = J e / (J^2 + l^2) */
    const double J[1][6] = {{2.0, 0, 0, 0, 0, 0}}, e[6] = {1.0, 0, 0, 0, 0, 0};
    double dq[1];
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_dls_step(J, 1u, e, 0.5, s_neg, s_wide, dq));
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, 2.0 / 4.25, dq[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, (1.0 - 4.0 / 4.25) * (1.0 - 4.0 / 4.25), kc_dls_predicted(J, 1u, e, dq));
}

void test_a_rotation_row_weighs_the_arm_length(void)
{
    /* rows: x and rz with one joint moving both by 1; e wants x = 1, rz = 0 */
    const double J[1][6] = {{1.0, 0, 0, 0, 0, 1.0}}, e[6] = {1.0, 0, 0, 0, 0, 0};
    double dq[1];
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_dls_step(J, 1u, e, 1e-9, s_neg, s_wide, dq));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 1.0 / (1.0 + KC_DLS_LEN_M * KC_DLS_LEN_M), dq[0]);
}

void test_a_joint_at_its_edge_leaves_the_rest_to_the_others(void)
{
    /* two joints move x alike: free, each does half; with joint 0 held at 0.1 the other does the rest */
    const double J[2][6] = {{1.0, 0, 0, 0, 0, 0}, {1.0, 0, 0, 0, 0, 0}}, e[6] = {1.0, 0, 0, 0, 0, 0};
    const double hi[2] = {0.1, 9.0}, lo[2] = {-9.0, -9.0};
    double dq[2];
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_dls_step(J, 2u, e, 1e-4, s_neg, s_wide, dq));
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.5, dq[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.5, dq[1]);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_dls_step(J, 2u, e, 1e-4, lo, hi, dq));
    TEST_ASSERT_EQUAL_DOUBLE(0.1, dq[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.9, dq[1]);
}

/* Of arrays for more joints. */
void test_a_step_changes_no_joint_that_the_arm_does_not_have(void)
{
    double J[KC_JOINT_MAX][6] = {{0.0}}, lo[KC_JOINT_MAX], hi[KC_JOINT_MAX];
    const double e[6] = {1.0, 0.5, -0.3, 0.0, 0.2, 0.1};
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) {
        J[j][j % 6u] = 1.0;
        J[j][(j + 1u) % 6u] = 0.3;
        lo[j] = -0.05;
        hi[j] = j % 2u == 0u ? 0.05 : 9.0;
    }
    for (uint32_t n = 1u; n < KC_JOINT_MAX; n++) {
        double dq[KC_JOINT_MAX];
        for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { dq[j] = 77.0; }
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_dls_step((const double(*)[6])J, n, e, 0.1, lo, hi, dq));
        kc_dls_limit(dq, n, 0.01);
        for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) {
            TEST_ASSERT_TRUE(j < n ? fabs(dq[j]) <= 0.01 : dq[j] == 77.0);
        }
    }
}

void test_all_joints_at_their_edges_is_an_answer_too(void)
{
    const double J[2][6] = {{1.0, 0, 0, 0, 0, 0}, {1.0, 0, 0, 0, 0, 0}}, e[6] = {-1.0, 0, 0, 0, 0, 0};
    const double hi[2] = {9.0, 9.0}, lo[2] = {-0.2, -0.1};
    double dq[2];
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_dls_step(J, 2u, e, 1e-4, lo, hi, dq));
    TEST_ASSERT_EQUAL_DOUBLE(-0.2, dq[0]);
    TEST_ASSERT_EQUAL_DOUBLE(-0.1, dq[1]);
}

void test_a_jacobian_that_is_not_finite_gives_no_step(void)
{
    const double J[1][6] = {{NAN, 0, 0, 0, 0, 0}}, e[6] = {1.0, 0, 0, 0, 0, 0};
    double dq[1] = {5.0};
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, kc_dls_step(J, 1u, e, 0.1, s_neg, s_wide, dq));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, dq[0]);
}

void test_an_error_that_is_not_finite_gives_no_step(void)
{
    const double J[1][6] = {{1.0, 0, 0, 0, 0, 0}}, e[6] = {1.0, 0, INFINITY, 0, 0, 0};
    double dq[1] = {5.0};
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, kc_dls_step(J, 1u, e, 0.1, s_neg, s_wide, dq));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, dq[0]);
}

void test_a_long_step_is_shortened_without_turning(void)
{
    double dq[3] = {0.3, -0.6, 0.0};
    kc_dls_limit(dq, 3u, 0.2);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.1, dq[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, -0.2, dq[1]);
    kc_dls_limit(dq, 3u, 0.2);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, -0.2, dq[1]);
}

void test_the_box_keeps_the_margin_and_lets_a_joint_only_back_in(void)
{
    kc_joint_t j;
    double lo, hi;
    memset(&j, 0, sizeof j);
    j.q_min = -1.0;
    j.q_max = 2.0;
    kc_dls_box(&j, 0.1, 0.5, &lo, &hi);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, -1.4, lo);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 1.4, hi);
    kc_dls_box(&j, 0.1, 2.5, &lo, &hi); /* outside: inward only, and not forced */
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, -3.4, lo);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, hi);
    kc_dls_box(&j, 0.1, -1.5, &lo, &hi);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, lo);
}

static void eval_at(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, const double *q,
                    kc_eval_t *ev)
{
    kc_fixed_t fixed;
    kc_model_fix(arm, terms, coef, &fixed);
    kc_dls_eval(&fixed, q, ev);
}

void test_the_joint_jacobian_is_the_derivative_of_the_pose(void)
{
    static kc_eval_t ev, plus, minus;
    kc_arm_t arm;
    kc_terms_t terms;
    double coef[KC_COEF_MAX] = {0.0}, q[KC_JOINT_MAX] = {0.3, -0.5, 0.2, 1.4, -1.0, 0.4, 0.6}, r[6];
    const double h = 1e-6;
    given_arm(&arm);
    given_terms(&terms);
    coef[24] = 1.3; /* J7.phi_rad */
    coef[11] = 0.15; /* J3.d_m */
    eval_at(&arm, &terms, coef, q, &ev);
    for (uint32_t j = 0u; j < 7u; j++) {
        q[j] += h;
        eval_at(&arm, &terms, coef, q, &plus);
        q[j] -= 2.0 * h;
        eval_at(&arm, &terms, coef, q, &minus);
        q[j] += h;
        kc_pose_residual(&plus.T, &minus.T, r);
        for (uint32_t k = 0u; k < 6u; k++) { TEST_ASSERT_DOUBLE_WITHIN(1e-8, r[k] / (2.0 * h), ev.Jq[j][k]); }
    }
}

/* A compliance: the pose that is searched for is that of the arm under its weight. */
void test_the_pose_is_that_of_the_arm_as_it_sags(void)
{
    static kc_eval_t ev, stiff;
    kc_arm_t arm;
    static kc_terms_t terms;
    double coef[KC_COEF_MAX] = {0.0}, q[KC_JOINT_MAX] = {0.3, -0.5, 0.2, 1.4, -1.0, 0.4, 0.6};
    kc_ctx_t ctx;
    kc_loads_t loads;
    given_arm(&arm);
    given_terms(&terms);
    eval_at(&arm, &terms, coef, q, &stiff);
    terms.coef[28] = (kc_coef_t){.name = "sag", .lb = -1.0, .ub = 1.0, .scale = 0.01, .enabled = 1u};
    terms.term[28] = (kc_term_t){.coef = 28u, .frame = 1u, .comp = KC_RZ, .gain = 1.0};
    terms.term[28].basis[0] = (kc_basis_t){KC_FN_LIN, KC_VAR_TAU, 2u, 0.0, 1.0};
    terms.n_coef = terms.n_term = 29u;
    coef[28] = 1e-3;
    memset(&ctx, 0, sizeof ctx);
    memcpy(ctx.q, q, sizeof q);
    ctx.g_m_s2[2] = -9.81;
    kc_model_loads(&arm, &terms, coef, &ctx, &loads);
    /* the joint turned by hand by what its torque makes of it */
    q[1] += 1e-3 * loads.tau[1];
    coef[28] = 0.0;
    eval_at(&arm, &terms, coef, q, &stiff);
    q[1] -= 1e-3 * loads.tau[1];
    coef[28] = 1e-3;
    eval_at(&arm, &terms, coef, q, &ev);
    TEST_ASSERT_TRUE(fabs(loads.tau[1]) > 1.0);
    for (uint32_t k = 0u; k < 3u; k++) { TEST_ASSERT_DOUBLE_WITHIN(1e-12, stiff.T.p_m[k], ev.T.p_m[k]); }
}
