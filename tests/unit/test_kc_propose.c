/* kc_propose.c: what a proposal states of an estimate, the camera chain in it, its verdict and the policy of CONFIG. */
#include "kc_propose.h"

#include <math.h>
#include <string.h>

#include "given_parts.h"
#include "kc_chi2.h"
#include "kc_rot.h"
#include "unity.h"

#define POSES 12u

static kc_evaluated_t s_evaluated;
static kc_evaluation_t s_evaluation;
static kc_review_t s_review;
static bool s_accepted;
static kc_outcome_t s_outcome;
static kc_config_t *s_config;
static kc_camera_t *s_camera;
static kc_est_t *const s_est = &parts.est;
static const kc_proposal_t *const s_p = &parts.out.proposal;

static void estimated(double phi_rad, double noise, double tilt_rad)
{
    s_est->n_obs = 0u;
    given_measured(POSES, phi_rad, noise, tilt_rad);
    parts.latest.status = kc_est_solve(s_est);
    TEST_ASSERT_EQUAL_INT(KC_OK, parts.latest.status);
}

/* Joint 7 is off by 10 mrad, the rest is right, and all is estimated. */
void setUp(void)
{
    given_parts();
    s_config = &parts.tables.active.config;
    s_camera = &parts.tables.active.camera;
    parts.cal.session = 3u;
    parts.cal.ended = KC_ENDED_POSES;
    parts.latest.pred = (kc_residual_t){1e-3, 2e-3};
    estimated(0.01, 0.1, 0.0);
}

/* Steps until there is a proposal. */
static uint32_t proposed_in(uint64_t work_of_step)
{
    uint32_t n = 0u;
    memset(&parts.out, 0, sizeof parts.out);
    s_accepted = true;
    kc_evaluation_begin(&s_evaluated, &s_evaluation, &parts.view);
    for (; n < 1000u && !parts.out.has_proposal; n++) {
        kc_work_t work = {work_of_step, 0u};
        s_outcome = kc_propose_run(&s_evaluated, &s_evaluation, &s_review, &parts.tables, &parts.view,
                                   &s_accepted, &work, &parts.out);
        TEST_ASSERT_TRUE(parts.out.has_proposal || s_outcome.id == KC_OC_STAY);
    }
    return n;
}

static void proposed(void) { (void)proposed_in(UINT64_MAX); }

static void given_camera_chain(void)
{
    s_camera->mast_sigma_m = s_camera->zero_sigma_rad = 0.002;
    s_camera->plate_sigma_m = 0.001;
    s_camera->drift_sigma_m_s = 1e-5;
}

/* ---- what it states ---- */

void test_a_proposal_is_the_table_that_its_crc_names(void)
{
    static kc_kin_t back;
    proposed();
    TEST_ASSERT_EQUAL_HEX32(s_p->crc, kc_tbl_image_crc(s_review.image, s_review.n));
    TEST_ASSERT_EQUAL_INT(KC_OK,
                          kc_tbl_decode(KC_TBL_KIN, s_review.image, s_review.n, &back, &parts.out.events));
    TEST_ASSERT_EQUAL_MEMORY(&back, &s_p->kin, sizeof back);
    TEST_ASSERT_EQUAL_UINT32(s_p->verdict, s_review.verdict);
    const uint32_t *crc = parts.tables.active.crc;
    const uint32_t got[] = {back.arm_crc, back.terms_crc, back.prev_crc,
                            back.session, back.n_poses,   back.n_coef};
    const uint32_t want[] = {crc[KC_TBL_ARM], crc[KC_TBL_TERMS], crc[KC_TBL_KIN], 3u, POSES, 28u};
    TEST_ASSERT_EQUAL_HEX32_ARRAY(want, got, 6u);
    TEST_ASSERT_EQUAL_UINT64(PARTS_NOW_US, back.made_us);
}

void test_a_proposal_states_the_fit_of_the_estimate(void)
{
    parts.latest.n_checked = 5u;
    s_config->stop_confidence = 0.9;
    s_est->n_outliers = 1u;
    s_est->outlier[2] = 1u;
    proposed();
    const double got[] = {
        s_p->fit_pos_m,  s_p->fit_rot_rad,    s_p->chi2,        s_p->noise_scale,  s_p->kkt,
        s_p->cond,       s_p->p_fit,          s_p->dof,         s_p->rank,         s_p->n_free,
        s_p->n_outliers, s_p->session,        s_p->n_poses,     s_p->ended,        s_p->n_checked,
        s_p->confidence, s_p->crc_kin_before, s_p->bound_pos_m, s_p->bound_rot_rad};
    const double want[] = {s_est->fit_pos_m,
                           s_est->fit_rot_rad,
                           s_est->chi2,
                           s_est->noise_scale,
                           s_est->kkt,
                           s_est->cond,
                           kc_chi2_sf(s_est->chi2, s_est->dof),
                           s_est->dof,
                           s_est->rank,
                           s_est->n_free,
                           1,
                           3,
                           POSES,
                           KC_ENDED_POSES,
                           5,
                           0.9,
                           PARTS_CRC + KC_TBL_KIN,
                           s_evaluated.bound.pos_m,
                           s_evaluated.bound.rot_rad};
    TEST_ASSERT_EQUAL_DOUBLE_ARRAY(want, got, sizeof want / sizeof want[0]);
    TEST_ASSERT_EQUAL_MEMORY(s_est->status, s_p->status, sizeof s_p->status);
    TEST_ASSERT_EQUAL_MEMORY(s_est->confounded, s_p->confounded, sizeof s_p->confounded);
    TEST_ASSERT_TRUE(s_p->fit_rot_rad > 0.0 && s_p->bound_pos_m > 0.0);
}

/* The nominal arm is in force: its residuals by forward kinematics alone, without the one that was rejected. */
void test_residuals_before_are_those_of_the_table_in_force_at_the_poses_that_were_kept(void)
{
    double pos2 = 0.0, rot2 = 0.0;
    s_est->outlier[2] = 1u;
    proposed();
    for (uint32_t i = 0u; i < POSES; i++) {
        const kc_obs_t *obs = &s_est->obs[i];
        kc_pose_t T;
        if (i == 2u) { continue; }
        kc_arm_fk(&parts.tables.active.arm, obs->ctx.q, &T);
        for (uint32_t k = 0u; k < 3u; k++) { pos2 += pow(obs->p_m[k] - T.p_m[k], 2.0); }
        double quat[4];
        kc_R_to_quat(T.R, quat);
        rot2 += pow(kc_quat_dist_rad(quat, obs->q_wxyz), 2.0);
    }
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, sqrt(pos2 / (POSES - 1.0)), s_p->before_pos_m);
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, sqrt(rot2 / (POSES - 1.0)), s_p->before_rot_rad);
    TEST_ASSERT_TRUE(s_p->before_rot_rad > 5.0 * s_p->fit_rot_rad);
    memset(s_est->outlier, 1, sizeof s_est->outlier);
    proposed();
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_p->before_pos_m + s_p->before_rot_rad);
    s_est->outlier[1] = 0u; /* one is enough */
    proposed();
    TEST_ASSERT_TRUE(s_p->before_pos_m > 0.0 && s_p->before_rot_rad > 0.0);
}

/* What the estimator minimised, summed anew; and what the estimate takes away of that of the table in force. */
void test_how_likely_no_change_is_follows_from_what_the_estimate_takes_away(void)
{
    estimated(0.0, 1.0, 0.0);
    proposed();
    double before = s_evaluated.chi2_before, gain = before - s_evaluated.chi2_after;
    TEST_ASSERT_DOUBLE_WITHIN(1e-6 * s_est->chi2, s_est->chi2, s_evaluated.chi2_after);
    TEST_ASSERT_TRUE(gain > 0.0);
    s_est->chi2 = gain / 28.0 * (double)s_est->dof;
    proposed();
    double scale = fmax(1.0, sqrt(gain / 28.0));
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, kc_chi2_sf(gain / (scale * scale), s_est->rank), s_p->p_no_change);
    TEST_ASSERT_TRUE(s_p->p_no_change > 1e-3 && s_p->p_no_change < 0.9999);
    memcpy(s_est->coef, parts.tables.active.kin.value, sizeof s_est->coef);
    proposed();
    TEST_ASSERT_EQUAL_DOUBLE(before, s_evaluated.chi2_after);
    TEST_ASSERT_EQUAL_DOUBLE(1.0, s_p->p_no_change);
}

/* As many rows as coefficients: nothing is left that could show a poor fit. */
void test_without_degrees_of_freedom_the_noise_is_as_stated(void)
{
    s_est->dof = 0u;
    proposed();
    TEST_ASSERT_EQUAL_DOUBLE(1.0, s_p->noise_scale);
    TEST_ASSERT_EQUAL_DOUBLE(1.0, s_p->p_fit);
}

static void expect_sigma_of_covariance(void)
{
    for (uint32_t i = 0u, k = 0u; i < 28u; k += 28u - i, i++) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, s_p->kin.sigma[i], sqrt(s_p->cov[k]));
    }
}

void test_residuals_larger_than_stated_scale_sigma_and_covariance_alike(void)
{
    s_est->chi2 = 9.0 * (double)s_est->dof;
    proposed();
    expect_sigma_of_covariance();
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 3.0 * s_est->sigma[24], s_p->kin.sigma[24]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 9.0 * s_est->cov[1], s_p->cov[1]);
    s_est->chi2 = 0.1 * (double)s_est->dof; /* smaller ones do not */
    proposed();
    TEST_ASSERT_EQUAL_DOUBLE(s_est->sigma[24], s_p->kin.sigma[24]);
}

void test_what_is_not_estimated_keeps_value_and_sigma_of_the_table_in_force(void)
{
    static const uint8_t kept[] = {KC_COEF_MASKED, KC_COEF_HELD};
    kc_kin_t *kin = &parts.tables.active.kin;
    for (uint32_t c = 0u; c < KC_COEF_MAX; c++) {
        kin->sigma[c] = 0.75;
    } /* more than there are coefficients */
    kin->value[28] = 0.25;
    for (uint32_t c = 0u; c < 2u; c++) {
        s_est->status[c] = kept[c];
        kin->value[c] = 0.25;
    }
    for (uint32_t solved = 2u; solved > 0u; solved--) {
        parts.latest.status = solved > 1u ? KC_OK : KC_ERR_NUM;
        proposed();
        for (uint32_t c = 0u; c < 3u; c++) {
            bool keeps = c < 2u || solved == 1u;
            TEST_ASSERT_EQUAL_DOUBLE(keeps ? kin->value[c] : s_est->coef[c], s_p->kin.value[c]);
            TEST_ASSERT_TRUE(keeps == (s_p->kin.sigma[c] > 0.5));
        }
        TEST_ASSERT_EQUAL_DOUBLE(0.0, s_p->kin.sigma[28] + s_p->kin.value[28]);
    }
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_p->cov[2u * 28u - 1u]);
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_POOR, s_p->verdict);
}

/* One observation or one candidate in a step that has room for no more, then the camera chain, four bounds, and the
 * proposal. */
void test_a_proposal_is_charged_observation_by_observation_and_candidate_by_candidate(void)
{
    s_est->outlier[2] = 1u;
    TEST_ASSERT_EQUAL_UINT32(POSES - 1u + 1u + 9u + 4u + 1u, proposed_in(1u));
    TEST_ASSERT_EQUAL_UINT32(1u, proposed_in(UINT64_MAX));
}

/* ---- the camera chain ---- */

void test_an_exact_camera_leaves_the_predicted_error_of_the_noise(void)
{
    proposed();
    const double pos[] = {s_p->pred_noise_pos_m, s_p->pred_camera_pos_m, s_p->pred_lander_pos_m};
    const double rot[] = {s_p->pred_noise_rot_rad, s_p->pred_camera_rot_rad, s_p->pred_lander_rot_rad};
    for (uint32_t i = 0u; i < 3u; i++) {
        TEST_ASSERT_EQUAL_DOUBLE(s_p->pred_pos_m, pos[i]);
        TEST_ASSERT_EQUAL_DOUBLE(s_p->pred_rot_rad, rot[i]);
    }
    TEST_ASSERT_TRUE(s_p->pred_pos_m > 0.0 && s_p->pred_rot_rad > 0.0);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_evaluated.chain.pos_m + s_evaluated.chain.rot_rad);
}

/* Against the camera, which is off with what it sees, an error of its place counts less than in the base frame. */
void test_the_predicted_error_is_that_of_the_frame_of_config(void)
{
    double bound_m[2];
    given_camera_chain();
    for (uint8_t frame = 0u; frame < 2u; frame++) {
        s_config->frame = frame;
        proposed();
        bool lander = frame == (uint8_t)KC_RIGHT_IN_LANDER;
        TEST_ASSERT_EQUAL_UINT8(frame, s_p->frame);
        TEST_ASSERT_EQUAL_DOUBLE(lander ? s_p->pred_lander_pos_m : s_p->pred_camera_pos_m, s_p->pred_pos_m);
        TEST_ASSERT_EQUAL_DOUBLE(lander ? s_p->pred_lander_rot_rad : s_p->pred_camera_rot_rad,
                                 s_p->pred_rot_rad);
        TEST_ASSERT_TRUE(s_p->pred_camera_pos_m > s_p->pred_noise_pos_m);
        TEST_ASSERT_TRUE(s_p->pred_lander_pos_m > 1.2 * s_p->pred_camera_pos_m);
        TEST_ASSERT_TRUE(s_p->pred_lander_rot_rad > s_p->pred_noise_rot_rad);
        bound_m[lander] = s_p->bound_pos_m;
    }
    TEST_ASSERT_TRUE(bound_m[1] > 1.1 * bound_m[0]);
}

/* It goes on until the last observation, whenever the others were made. */
void test_drift_counts_until_the_last_observation(void)
{
    s_camera->drift_sigma_m_s = 1e-6;
    proposed();
    const double at_once = s_p->pred_camera_pos_m;
    s_est->obs[POSES - 1u].ctx.t_s = 1000.0;
    proposed();
    TEST_ASSERT_TRUE(s_p->pred_camera_pos_m > 1.05 * at_once);
}

void test_sigma_and_covariance_hold_the_camera_chain(void)
{
    given_camera_chain();
    proposed();
    expect_sigma_of_covariance();
    TEST_ASSERT_TRUE(s_p->kin.sigma[24] > 1.05 * s_est->sigma[24]);
}

/* Residuals beyond the noise that the stated chain explains are neither noise nor a bad fit. */
void test_what_the_camera_chain_explains_is_not_counted_as_noise_too(void)
{
    s_config->est.outlier_p = 0.0;
    estimated(0.01, 1.0, 0.02);
    proposed();
    double p_exact = s_p->p_fit, noise_exact = s_p->noise_scale;
    TEST_ASSERT_TRUE(p_exact < 1e-4);
    given_camera_chain();
    s_camera->zero_sigma_rad = 0.02;
    proposed();
    TEST_ASSERT_TRUE(s_p->p_fit > 100.0 * p_exact);
    TEST_ASSERT_TRUE(s_p->noise_scale < 0.9 * noise_exact);
    TEST_ASSERT_TRUE(s_p->chi2 < s_est->chi2);
}

/* A healthy arm and a camera that is off: it goes where the camera says it is not, so in the camera's frame something
 * has to change. In the base frame nothing has to, if the camera may be that far off. */
void test_whether_a_change_is_needed_depends_on_the_frame(void)
{
    estimated(0.0, 0.5, 0.01);
    for (uint32_t i = 0u; i < 3u; i++) {
        s_config->frame = (uint8_t)(i == 0u ? KC_RIGHT_IN_CAMERA : KC_RIGHT_IN_LANDER);
        given_camera_chain();
        s_camera->zero_sigma_rad = i == 2u ? 1e-5 : 0.01; /* and not, if it may not */
        s_camera->mast_sigma_m = i == 2u ? 0.0 : 0.002;
        proposed();
        TEST_ASSERT_TRUE(i == 1u ? s_p->p_no_change > 0.01 : s_p->p_no_change < 1e-6);
    }
}

void test_without_a_solution_the_camera_chain_has_no_part(void)
{
    given_camera_chain();
    parts.latest.status = KC_ERR_NUM;
    proposed();
    TEST_ASSERT_EQUAL_DOUBLE(s_p->pred_noise_pos_m, s_p->pred_lander_pos_m);
    TEST_ASSERT_EQUAL_DOUBLE(1.0, s_p->p_no_change);
    TEST_ASSERT_EQUAL_DOUBLE(s_est->chi2, s_p->chi2);
}

/* Required position and rotation in parts of what the chain alone leaves; 0: none. */
void test_a_required_accuracy_that_the_camera_chain_keeps_away_is_reported(void)
{
    static const struct {
        double pos, rot;
        kc_ended_t ended;
        bool said[2];
    } cases[] = {
        {0.9, 0.9, KC_ENDED_POSES, {true, true}},      {1.1, 0.9, KC_ENDED_TIME, {false, true}},
        {0.9, 1.1, KC_ENDED_POSES, {true, false}},     {0.0, 0.0, KC_ENDED_POSES, {false, false}},
        {1.0, 1.0, KC_ENDED_POSES, {false, false}},    {0.9, 0.9, KC_ENDED_REQUIREMENT, {false, false}},
        {0.9, 0.9, KC_ENDED_NO_CHANGE, {false, false}}};
    given_camera_chain();
    proposed();
    const kc_residual_t chain = s_evaluated.chain;
    TEST_ASSERT_TRUE(chain.pos_m > 0.0 && chain.rot_rad > 0.0);
    for (uint32_t i = 0u; i < sizeof cases / sizeof cases[0]; i++) {
        const double left[] = {chain.pos_m, chain.rot_rad};
        const double stop[] = {cases[i].pos * chain.pos_m, cases[i].rot * chain.rot_rad};
        s_config->stop_pos_m = stop[0];
        s_config->stop_rot_rad = stop[1];
        parts.cal.ended = cases[i].ended;
        proposed();
        const kc_event_t *e = parts.out.events.e;
        for (int32_t k = 0; k < 2; k++) {
            if (!cases[i].said[k]) { continue; }
            TEST_ASSERT_EQUAL_UINT16(KC_EVT_CAL_CHAIN_LIMIT, e->id);
            TEST_ASSERT_EQUAL_INT(k, e->index);
            TEST_ASSERT_EQUAL_DOUBLE(left[k], e->got);
            TEST_ASSERT_EQUAL_DOUBLE(stop[k], e->want);
            e++;
        }
        TEST_ASSERT_EQUAL_PTR(&parts.out.events.e[parts.out.events.n], e);
    }
}

/* ---- verdict and policy ---- */

void test_the_verdict_says_what_is_next_and_an_event_what_it_rests_on(void)
{
    static const struct {
        double phi_rad, noise;
        kc_verdict_t verdict;
        kc_outcome_id_t outcome;
    } cases[] = {{0.01, 0.1, KC_VERDICT_CHANGE, KC_OC_STORE},
                 {0.0, 0.5, KC_VERDICT_NO_CHANGE, KC_OC_DONE},
                 {0.01, 9.0, KC_VERDICT_POOR, KC_OC_STORE}};
    s_config->est.outlier_p = 0.0;
    for (uint32_t i = 0u; i < 3u; i++) {
        estimated(cases[i].phi_rad, cases[i].noise, 0.0);
        proposed();
        TEST_ASSERT_EQUAL_INT(cases[i].verdict, s_p->verdict);
        TEST_ASSERT_EQUAL_INT(cases[i].outcome, s_outcome.id);
        TEST_ASSERT_FALSE(s_accepted);
        const double p_fit = s_p->p_fit, p_no_change = s_p->p_no_change, noise = s_p->noise_scale;
        if (i == 1u) { expect_event(KC_EVT_COR_NO_CHANGE, -1, p_no_change, 0.0); }
        if (i == 2u) { expect_event(KC_EVT_CAL_POOR, -1, p_fit, noise); }
        TEST_ASSERT_EQUAL_UINT32(0u, parts.out.events.n);
    }
    parts.latest.tested_early = true; /* half of the level is left */
    s_config->no_change_p = 0.9;
    estimated(0.0, 0.5, 0.0);
    proposed();
    TEST_ASSERT_EQUAL_INT(s_p->p_no_change > 0.45 ? KC_VERDICT_NO_CHANGE : KC_VERDICT_CHANGE, s_p->verdict);
}

void test_a_proposal_without_the_newest_pose_is_poor_and_says_that_the_arm_may_have_changed(void)
{
    estimated(0.01, 0.1, 0.0);
    parts.est.outlier[parts.est.n_obs - 1u] = 1u;
    proposed();
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_POOR, s_p->verdict);
    TEST_ASSERT_FALSE(s_accepted);
    TEST_ASSERT_EQUAL_UINT32(2u, parts.out.events.n);
    TEST_ASSERT_EQUAL_UINT16(KC_EVT_CAL_CHANGED, parts.out.events.e[0].id);
    TEST_ASSERT_EQUAL_INT((int32_t)s_p->n_poses, parts.out.events.e[0].index);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, fabs(parts.out.events.e[0].got) + fabs(parts.out.events.e[0].want));
    TEST_ASSERT_EQUAL_UINT16(KC_EVT_CAL_POOR, parts.out.events.e[1].id);
}

void test_coefficients_that_the_data_leave_open_are_named(void)
{
    parts.tables.active.terms.term[23].gain = parts.tables.active.terms.term[5].gain = 0.0;
    parts.tables.active.kin.value[23] = 0.125;
    estimated(0.01, 0.1, 0.0);
    proposed();
    const kc_event_t *e = parts.out.events.e;
    TEST_ASSERT_EQUAL_UINT32(3u, parts.out.events.n);
    TEST_ASSERT_EQUAL_UINT16(KC_EVT_CAL_RANK, e[0].id);
    TEST_ASSERT_EQUAL_INT32(-1, e[0].index);
    TEST_ASSERT_EQUAL_DOUBLE(26.0, e[0].got);
    TEST_ASSERT_EQUAL_DOUBLE(28.0, e[0].want);
    for (uint32_t i = 1u; i < 3u; i++) {
        TEST_ASSERT_EQUAL_UINT16(KC_EVT_CAL_HELD, e[i].id);
        TEST_ASSERT_EQUAL_INT(i == 1u ? 5 : 23, e[i].index);
        TEST_ASSERT_EQUAL_DOUBLE(i == 1u ? 0.0 : 0.125, e[i].got);
    }
}

/* Each rule by itself: test_kc_verdict.c. */
void test_a_small_well_determined_correction_is_accepted_and_what_breaks_a_rule_is_not(void)
{
    for (uint32_t rule = 0u; rule < 10u; rule++) {
        setUp();
        s_config->accept_on_board = 1u;
        s_config->accept_change_max_pos_m = s_config->accept_sigma_max_pos_m = 0.01;
        s_config->accept_p_fit_min = 1e-6;
        switch (rule) {
        case 1u: s_config->accept_on_board = 0u; break;
        case 2u: s_config->accept_change_max_pos_m = 1e-6; break;
        case 3u: s_config->accept_sigma_max_pos_m = 1e-9; break;
        case 4u: s_config->accept_p_fit_min = 1.1; break;
        case 5u: s_est->status[3] = (uint8_t)KC_COEF_AT_LOWER; break;
        case 6u: s_est->status[3] = (uint8_t)KC_COEF_AT_UPPER; break;
        case 7u: s_est->rank--; break;
        case 8u: s_est->opt.outlier_max = s_est->n_outliers = 1u; break;
        case 9u: parts.tables.active.terms.coef[24].ub = 0.005; break; /* it fits the tables no more */
        default: break;
        }
        proposed();
        TEST_ASSERT_EQUAL_INT(KC_VERDICT_CHANGE, s_p->verdict);
        TEST_ASSERT_EQUAL_INT(KC_OC_STORE, s_outcome.id);
        TEST_ASSERT_EQUAL_INT(rule == 0u, s_accepted);
    }
}
