/* kc_ident.c: coefficients that the data cannot determine are named and held. */
#include <math.h>
#include <string.h>

#include "given_observations.h"
#include "given_tables.h"
#include "kc_est_priv.h"
#include "unity.h"

static kc_arm_t s_arm;
static kc_terms_t s_terms;
static kc_est_t s_est;
static double s_truth[KC_COEF_MAX];

void setUp(void)
{
    given_arm(&s_arm);
    given_terms(&s_terms);
    given_paper_errors(s_truth);
}

static uint32_t count(uint8_t status)
{
    uint32_t n = 0u;
    for (uint32_t c = 0u; c < s_terms.n_coef; c++) { n += s_est.status[c] == status; }
    return n;
}

static uint32_t add_coef(uint8_t frame, uint8_t comp, uint8_t var)
{
    const uint32_t c = s_terms.n_coef++;
    kc_term_t *t = &s_terms.term[s_terms.n_term++];
    memset(&s_terms.coef[c], 0, sizeof s_terms.coef[c]);
    memset(t, 0, sizeof *t);
    s_terms.coef[c].lb = -1.0;
    s_terms.coef[c].ub = 1.0;
    s_terms.coef[c].scale = 0.1;
    s_terms.coef[c].enabled = 1u;
    t->coef = (uint16_t)c;
    t->frame = frame;
    t->comp = comp;
    t->gain = 1.0;
    t->basis[0].var = var;
    t->basis[0].c1 = t->basis[1].c1 = 1.0;
    return c;
}

static void assert_held_at_start(void)
{
    for (uint32_t c = 0u; c < s_terms.n_coef; c++) {
        if (s_est.status[c] != KC_COEF_HELD) { continue; }
        TEST_ASSERT_DOUBLE_WITHIN(0.0, s_est.start[c], s_est.coef[c]);
        TEST_ASSERT_DOUBLE_WITHIN(0.0, 0.0, s_est.sigma[c]);
    }
}

/* No tool offset, position only: rank 24 (method, section 1). */
void test_position_only_leaves_four_undetermined_and_names_their_company(void)
{
    s_arm.tool_xyz_m[2] = 0.0;
    given_session(&s_est, &s_arm, &s_terms, s_truth, 30u, 1.0);
    for (uint32_t i = 0u; i < 30u; i++) { s_est.obs[i].has_rot = 0u; }
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT32(24u, s_est.rank);
    TEST_ASSERT_EQUAL_UINT32(4u, count(KC_COEF_HELD));
    assert_held_at_start();
    for (uint32_t c = 0u; c < 28u; c++) {
        TEST_ASSERT_EQUAL_UINT64(0u, s_est.confounded[c] & ((uint64_t)1u << c)); /* others, not itself */
    }
    TEST_ASSERT_TRUE(s_est.fit_pos_m < 2.0 * OBS_POS_M);
}

void test_too_few_poses_determine_as_many_as_there_are_rows(void)
{
    given_session(&s_est, &s_arm, &s_terms, s_truth, 3u, 1.0);
    (void)kc_est_solve(&s_est);
    TEST_ASSERT_EQUAL_UINT32(18u, s_est.rank);
    TEST_ASSERT_EQUAL_UINT32(10u, count(KC_COEF_HELD));
    assert_held_at_start();
    for (uint32_t c = 0u; c < 28u; c++) {
        if (s_est.status[c] == KC_COEF_HELD) { TEST_ASSERT_TRUE(s_est.confounded[c] != 0u); }
    }
}

void test_two_names_for_one_effect_are_confounded_with_each_other_only(void)
{
    const uint32_t other = add_coef(0u, KC_RZ, KC_VAR_ONE); /* base turn = J1.phi */
    s_terms.coef[other].scale = s_terms.coef[0].scale;
    given_session(&s_est, &s_arm, &s_terms, s_truth, 12u, 1.0);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT32(28u, s_est.rank);
    TEST_ASSERT_EQUAL_UINT32(29u, s_est.n_free);
    TEST_ASSERT_EQUAL_UINT64((uint64_t)1u << other, s_est.confounded[0]);
    TEST_ASSERT_EQUAL_UINT64((uint64_t)1u, s_est.confounded[other]);
    TEST_ASSERT_EQUAL_UINT8(KC_COEF_ESTIMATED, s_est.status[0]); /* equal columns: the first is kept */
    TEST_ASSERT_EQUAL_UINT8(KC_COEF_HELD, s_est.status[other]);
    TEST_ASSERT_DOUBLE_WITHIN(4.0 * s_est.sigma[24], 1.3, s_est.coef[24]);
}

void test_no_effect_at_all_is_held_without_company(void)
{
    const uint32_t idle = add_coef(0u, KC_TX, KC_VAR_PAYLOAD); /* nothing was carried */
    given_session(&s_est, &s_arm, &s_terms, s_truth, 12u, 1.0);
    s_est.start[idle] = 0.3;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT8(KC_COEF_HELD, s_est.status[idle]);
    TEST_ASSERT_EQUAL_UINT64(0u, s_est.confounded[idle]);
    TEST_ASSERT_DOUBLE_WITHIN(0.0, 0.3, s_est.coef[idle]);
}

void test_masking_one_of_two_confounded_coefficients_frees_the_other(void)
{
    const uint32_t other = add_coef(0u, KC_RZ, KC_VAR_ONE);
    given_session(&s_est, &s_arm, &s_terms, s_truth, 12u, 1.0);
    s_est.opt.free_mask = ~(uint64_t)1u;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT8(KC_COEF_MASKED, s_est.status[0]);
    TEST_ASSERT_EQUAL_UINT8(KC_COEF_ESTIMATED, s_est.status[other]);
    TEST_ASSERT_EQUAL_UINT64(0u, s_est.confounded[other]);
}

void test_nothing_determined_is_reported_and_start_kept(void)
{
    given_session(&s_est, &s_arm, &s_terms, s_truth, 5u, 1.0);
    const uint32_t idle = add_coef(0u, KC_TX, KC_VAR_PAYLOAD);
    s_est.opt.free_mask = (uint64_t)1u << idle;
    s_est.start[idle] = 0.2;
    for (uint32_t k = 0u; k < KC_COEF_MAX * KC_COEF_MAX; k++) { s_est.cov[k] = 5.0; }
    TEST_ASSERT_EQUAL_INT(KC_ERR_RANK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT32(0u, s_est.rank);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_est.cond);
    TEST_ASSERT_EQUAL_UINT8(KC_COEF_HELD, s_est.status[idle]);
    TEST_ASSERT_DOUBLE_WITHIN(0.0, 0.2, s_est.coef[idle]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, s_est.before_pos_m, s_est.fit_pos_m);
    TEST_ASSERT_EQUAL_UINT32(30u, s_est.dof);
    for (uint32_t k = 0u; k < KC_COEF_MAX * KC_COEF_MAX; k++) { TEST_ASSERT_EQUAL_DOUBLE(0.0, s_est.cov[k]); }
}

void test_without_requested_coefficients_nothing_changes(void)
{
    given_session(&s_est, &s_arm, &s_terms, s_truth, 5u, 1.0);
    s_est.opt.free_mask = 0u;
    TEST_ASSERT_EQUAL_INT(KC_ERR_RANK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT32(0u, s_est.n_free);
    TEST_ASSERT_EQUAL_UINT32(28u, count(KC_COEF_MASKED));
}

/* Position only: a turn about the tool's axis moves nothing until tx says that the tool is off the axis. */
void test_rank_is_decided_again_at_the_solution(void)
{
    uint64_t rng = 5u;
    double truth[KC_COEF_MAX] = {0.0};
    double q[KC_JOINT_MAX];
    kc_obs_t obs;
    memset(&s_terms, 0, sizeof s_terms);
    (void)add_coef(7u, KC_RZ, KC_VAR_ONE);
    (void)add_coef(KC_FRAME_TOOL, KC_TX, KC_VAR_ONE);
    truth[0] = 0.3;
    truth[1] = 0.05;
    given_session(&s_est, &s_arm, &s_terms, truth, 0u, 0.0);
    for (int i = 0; i < 10; i++) {
        given_joints(&s_arm, &rng, q);
        given_one_observation(&s_arm, &s_terms, truth, q, 0.0, &rng, &obs);
        obs.has_rot = 0u;
        (void)kc_est_add(&s_est, &obs);
    }
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT32(2u, s_est.rank);
    TEST_ASSERT_DOUBLE_WITHIN(1e-8, 0.3, s_est.coef[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-8, 0.05, s_est.coef[1]);
}

/* Two columns over their sigmas, (a, 0) and (3, 4). The longer one comes first; 0.8 a of the other is perpendicular
 * to it, and a coefficient counts if that is more than 1. */
void test_what_the_data_leave_less_certain_than_its_scale_is_not_determined(void)
{
    static double F[KC_COEF_MAX * KC_COEF_MAX];
    static const double a[] = {1.1, 1.2, 1.3, 4.0}; /* 0.88, 0.96, 1.04, 3.2 */
    for (uint32_t i = 0u; i < sizeof a / sizeof a[0]; i++) {
        for (uint32_t swapped = 0u; swapped < 2u; swapped++) {
            given_session(&s_est, &s_arm, &s_terms, s_truth, 0u, 0.0);
            s_est.n_column = 2u;
            s_est.column[0] = 5u;
            s_est.column[1] = 9u;
            s_terms.coef[5].scale = 0.5;
            s_terms.coef[9].scale = 0.25;
            s_est.R[0] = (swapped != 0u ? 5.0 : a[i]) / 0.5; /* (5, 0) and (0.6 a, 0.8 a) are the same */
            s_est.R[1] = (swapped != 0u ? 0.6 * a[i] : 3.0) / 0.25;
            s_est.R[KC_COEF_MAX + 2u] = (swapped != 0u ? 0.8 * a[i] : 4.0) / 0.25;
            TEST_ASSERT_EQUAL_UINT32(0.8 * a[i] > 1.0 ? 2u : 1u, kc_est_rank(&s_est, F));
            TEST_ASSERT_DOUBLE_WITHIN(1e-12, 5.0, s_est.pivot[0]);
            TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.8 * a[i], s_est.pivot[1]);
        }
    }
}

/* ---- nothing held ---- */

void test_with_nothing_held_all_are_estimated_with_the_weak_prior(void)
{
    given_session(&s_est, &s_arm, &s_terms, s_truth, 3u, 1.0);
    s_est.hold_none = 1u;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT32(18u, s_est.rank);
    TEST_ASSERT_EQUAL_UINT32(28u, s_est.n_free);
    TEST_ASSERT_EQUAL_UINT32(28u, s_est.n_idx);
    TEST_ASSERT_EQUAL_UINT32(28u, count(KC_COEF_ESTIMATED));
    TEST_ASSERT_EQUAL_UINT8(1u, s_est.weak);
    TEST_ASSERT_TRUE(s_est.fit_pos_m < s_est.before_pos_m);
    for (uint32_t c = 0u; c < 28u; c++) {
        TEST_ASSERT_EQUAL_UINT64(0u, s_est.confounded[c]);
        TEST_ASSERT_TRUE(s_est.sigma[c] > 0.0);
        TEST_ASSERT_TRUE(s_est.sigma[c] <= KC_EST_WEAK_SIGMA * s_terms.coef[c].scale);
    }
}

void test_with_nothing_held_two_names_for_one_effect_share_it(void)
{
    const uint32_t other = add_coef(0u, KC_RZ, KC_VAR_ONE);
    memset(s_truth, 0, sizeof s_truth);
    s_truth[0] = 0.1;
    given_session(&s_est, &s_arm, &s_terms, s_truth, 5u, 0.0);
    s_terms.coef[0].scale = s_terms.coef[other].scale;
    s_est.opt.free_mask = 1u | (uint64_t)1u << other;
    s_est.hold_none = 1u;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT32(1u, s_est.rank);
    TEST_ASSERT_DOUBLE_WITHIN(1e-3, 0.05, s_est.coef[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, s_est.coef[0], s_est.coef[other]);
}

void test_with_nothing_held_the_weak_prior_stays_however_many_observations_there_are(void)
{
    given_session(&s_est, &s_arm, &s_terms, s_truth, 30u, 1.0);
    s_est.hold_none = 1u;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT8(1u, s_est.weak);
    s_est.hold_none = 0u;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT8(0u, s_est.weak);
}

/* All frames coincide. Where frame 1 is turned by a quarter, x of frame 2 is y of the base; at the solution it is x
 * of the base. So the rank is the same at both places, and the set chosen at the start is none at the solution. */
static uint32_t s_base_x, s_base_y, s_turn, s_moved_x;

static void given_a_set_that_is_dependent_at_the_solution(void)
{
    const double q[KC_JOINT_MAX] = {0.0};
    uint64_t rng = 1u;
    kc_obs_t obs;
    memset(s_arm.joint, 0, sizeof s_arm.joint);
    memset(s_arm.base_xyz_m, 0, sizeof s_arm.base_xyz_m);
    memset(s_arm.tool_xyz_m, 0, sizeof s_arm.tool_xyz_m);
    s_terms.n_coef = s_terms.n_term = 0u;
    s_base_x = add_coef(0u, KC_TX, KC_VAR_ONE);
    s_base_y = add_coef(0u, KC_TY, KC_VAR_ONE);
    s_turn = add_coef(1u, KC_RZ, KC_VAR_ONE);
    s_moved_x = add_coef(2u, KC_TX, KC_VAR_ONE);
    s_terms.coef[s_turn].lb = -2.0;
    s_terms.coef[s_turn].ub = 2.0;
    s_terms.coef[s_moved_x].scale = 0.2; /* so that it is chosen, and s_base_y is not */
    memset(s_truth, 0, sizeof s_truth);
    s_truth[s_base_x] = 0.03;
    s_truth[s_base_y] = 0.01;
    given_session(&s_est, &s_arm, &s_terms, s_truth, 0u, 0.0);
    for (uint32_t i = 0u; i < 4u; i++) {
        given_one_observation(&s_arm, &s_terms, s_truth, q, 0.0, &rng, &obs);
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_add(&s_est, &obs));
    }
    s_est.start[s_turn] = 1.5707963267948966;
}

void test_a_set_that_is_no_longer_independent_at_the_solution_is_chosen_anew(void)
{
    given_a_set_that_is_dependent_at_the_solution();
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    TEST_ASSERT_EQUAL_UINT32(3u, s_est.rank);
    TEST_ASSERT_EQUAL_UINT8(KC_COEF_ESTIMATED, s_est.status[s_turn]);
    TEST_ASSERT_EQUAL_UINT8(KC_COEF_ESTIMATED, s_est.status[s_base_y]);
    TEST_ASSERT_EQUAL_UINT32(1u, count(KC_COEF_HELD));
    TEST_ASSERT_TRUE((s_est.confounded[s_base_x] >> s_moved_x & 1u) != 0u);
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, 0.01, s_est.coef[s_base_y]);
    assert_held_at_start();
}

void test_after_as_many_choices_as_there_may_be_the_last_one_stands(void)
{
    kc_work_t one = {1u, 0u}, all = kc_work_unlimited();
    given_a_set_that_is_dependent_at_the_solution();
    kc_est_begin(&s_est);
    for (uint32_t i = 0u; i < 100u && s_est.job.n_fits == 0u; i++) {
        one.used = 0u;
        (void)kc_est_step(&s_est, &one);
    }
    s_est.job.n_fits = KC_EST_PASSES;
    TEST_ASSERT_TRUE(kc_est_step(&s_est, &all));
    TEST_ASSERT_EQUAL_UINT8(KC_COEF_HELD, s_est.status[s_base_y]);
    TEST_ASSERT_EQUAL_UINT32(1u, count(KC_COEF_HELD));
    assert_held_at_start();
}

/* What an earlier choice found is forgotten. */
void test_what_is_determined_is_confounded_with_nothing_any_more(void)
{
    const uint64_t all = ((uint64_t)1u << 28u) - 1u;
    given_session(&s_est, &s_arm, &s_terms, s_truth, 15u, 1.0);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_est_solve(&s_est));
    memset(s_est.confounded, 0xff, sizeof s_est.confounded);
    memset(s_est.status, 0xff, sizeof s_est.status);
    kc_est_identify(&s_est, all & ~(uint64_t)8u);
    for (uint32_t c = 0u; c < 28u; c++) {
        TEST_ASSERT_EQUAL_UINT64(0u, s_est.confounded[c]);
        TEST_ASSERT_EQUAL_UINT8(c == 3u ? KC_COEF_MASKED : KC_COEF_ESTIMATED, s_est.status[c]);
    }
    TEST_ASSERT_EQUAL_UINT32(27u, s_est.n_idx);
}

/* What stands behind the coefficients of TERMS. */
void test_coefficients_that_terms_do_not_have_are_left_alone(void)
{
    for (uint32_t n = 20u; n <= 28u; n += 8u) {
        given_session(&s_est, &s_arm, &s_terms, s_truth, 12u, 1.0);
        s_terms.n_coef = s_terms.n_term = n;
        for (uint32_t c = n; c < KC_COEF_MAX; c++) {
            s_est.coef[c] = 77.0;
            s_est.start[c] = 55.0;
        }
        (void)kc_est_solve(&s_est);
        for (uint32_t c = n; c < KC_COEF_MAX; c++) {
            TEST_ASSERT_EQUAL_DOUBLE(77.0, s_est.coef[c]);
            TEST_ASSERT_EQUAL_DOUBLE(55.0, s_est.start[c]);
            TEST_ASSERT_EQUAL_UINT8(KC_COEF_MASKED, s_est.status[c]);
            TEST_ASSERT_EQUAL_DOUBLE(0.0, s_est.sigma[c]);
            TEST_ASSERT_EQUAL_UINT64(0u, s_est.confounded[c]);
        }
        given_terms(&s_terms);
    }
}

/* R is `by` times these numbers, of coefficients that are in units of their scale. */
static void identify_by_hand(uint32_t n, const uint8_t *column, const double R[4][4], double by)
{
    memset(&s_est, 0, sizeof s_est);
    s_est.terms = &s_terms;
    s_est.opt.rank_tol = 1e-4;
    s_est.n_column = n;
    uint64_t requested = 0u;
    for (uint32_t i = 0u; i < n; i++) {
        requested |= (uint64_t)1u << column[i];
        s_terms.coef[column[i]].scale = 0.01 * (i + 1.0);
        s_est.column[i] = column[i];
        for (uint32_t k = 0u; k <= i; k++) {
            s_est.R[k * KC_EST_LD + i] = by * R[k][i] / s_terms.coef[column[i]].scale;
        }
    }
    kc_est_identify(&s_est, requested);
}

/* With less the coefficient is known worse than its scale. */
void test_a_coefficient_is_estimated_from_an_information_of_one_on(void)
{
    static const double one[4][4] = {{1.0}};
    const uint8_t column = 3u;
    for (uint32_t k = 0u; k < 2u; k++) {
        identify_by_hand(1u, &column, one, k == 0u ? 0.999 : 1.001);
        TEST_ASSERT_EQUAL_UINT32(k, s_est.rank);
        TEST_ASSERT_EQUAL_UINT8(k == 0u ? KC_COEF_HELD : KC_COEF_ESTIMATED, s_est.status[3]);
    }
}

/* By hand: a, b, c, and d = x b + y c + part a, or the first three in another order; q and s are cosine and sine. The
 * largest of |x|, 0.99 and the 1 of d itself is what the part has to exceed a thousandth of. */
void test_parts_of_a_null_direction_count_by_the_largest(void)
{
    static const uint8_t column[4] = {1u, 4u, 5u, 7u};
    static const struct {
        uint32_t b; /* place of b: 0, and a is last, or 1 */
        double towards; /* d goes along b or against it: x is 0.01 or -1.63 */
        double part;
        bool member;
    } cases[] = {{0u, -1.0, 1.5e-3, false}, {0u, -1.0, 1.8e-3, true},  {1u, -1.0, -1.5e-3, false},
                 {1u, -1.0, -1.8e-3, true}, {0u, 1.0, -0.9e-3, false}, {1u, 1.0, 1.2e-3, true}};
    const double q = 0.9, s = sqrt(1.0 - q * q);
    for (uint32_t k = 0u; k < sizeof cases / sizeof cases[0]; k++) {
        const uint32_t b = cases[k].b, c = b + 1u, a = b == 0u ? 2u : 0u;
        const double size = b == 0u ? 0.3 : 4.0;
        uint64_t want = (uint64_t)1u << column[b] | (uint64_t)1u << column[c];
        double R[4][4] = {{0.0}};
        R[a][a] = size;
        R[b][b] = 1.1;
        R[b][c] = q;
        R[c][c] = 1.01 * s;
        R[a][3] = size * cases[k].part;
        R[b][3] = cases[k].towards * q;
        R[c][3] = s;
        identify_by_hand(4u, column, (const double(*)[4])R, 1e4);
        if (cases[k].member) { want |= (uint64_t)1u << column[a]; }
        TEST_ASSERT_EQUAL_UINT32(3u, s_est.rank);
        TEST_ASSERT_EQUAL_UINT8(KC_COEF_HELD, s_est.status[7]);
        TEST_ASSERT_EQUAL_HEX64(want, s_est.confounded[7]);
        for (uint32_t i = 0u; i < 3u; i++) {
            const uint64_t in = want >> column[i] & 1u;
            const uint64_t others = (want | 0x80u) & ~((uint64_t)1u << column[i]);
            TEST_ASSERT_EQUAL_HEX64(in * others, s_est.confounded[column[i]]);
        }
    }
}
