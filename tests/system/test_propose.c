/* kc_propose.c: verdict, review in two steps, acceptance on board, rollback; refusals with answer, event
 * and state. */
#include <math.h>
#include <string.h>

#include "given_tables.h"
#include "given_world.h"
#include "kc_chi2.h"
#include "kc_propose.h"
#include "kc_rot.h"
#include "unity.h"

#define APP (&kc_app_instance)

void setUp(void);
void setUp(void)
{
    given_world();
    world.config.n_poses = 8u;
    world.truth.joint[6].phi_rad = 0.1;
}

static uint32_t active_crc(void) { return kc_app_active(APP)->crc[KC_TBL_KIN]; }

/* ---- the proposal ---- */

void test_a_proposal_is_the_table_that_its_crc_names(void)
{
    static kc_kin_t kin;
    kc_events_t ev;
    memset(&ev, 0, sizeof ev);
    world_calibrated();
    const kc_proposal_t *p = &world.proposal;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_decode(KC_TBL_KIN, world.store[KC_STORE_PROPOSAL][0],
                                               world.stored[KC_STORE_PROPOSAL][0], &kin, &ev));
    TEST_ASSERT_EQUAL_UINT32(
        p->crc, kc_tbl_image_crc(world.store[KC_STORE_PROPOSAL][0], world.stored[KC_STORE_PROPOSAL][0]));
    TEST_ASSERT_EQUAL_MEMORY(&kin, &p->kin, sizeof kin);
    TEST_ASSERT_EQUAL_UINT32(active_crc(), p->kin.prev_crc);
    TEST_ASSERT_EQUAL_UINT32(kc_app_active(APP)->crc[KC_TBL_ARM], p->kin.arm_crc);
    TEST_ASSERT_EQUAL_UINT32(8u, p->kin.n_poses);
    TEST_ASSERT_EQUAL_UINT32(1u, p->kin.session);
}

void test_only_requested_coefficients_change(void)
{
    world.bias[2] = 0.0;
    world_boot();
    world_tick();
    world_cmd(KC_CMD_START, -1, 8, 1)->arg_u64 = 1ull << 24u; /* joint 7 only */
    for (uint32_t i = 0u; i < 3000u; i++) {
        world_tick();
        if (!world_calibrating()) { break; }
    }
    const kc_proposal_t *p = &world.proposal;
    for (uint32_t c = 0u; c < 28u; c++) {
        TEST_ASSERT_EQUAL_UINT8(c == 24u ? KC_COEF_ESTIMATED : KC_COEF_MASKED, p->status[c]);
        if (c != 24u) { TEST_ASSERT_EQUAL_DOUBLE(0.0, p->kin.value[c]); }
    }
    TEST_ASSERT_DOUBLE_WITHIN(1e-3, 0.1, p->kin.value[24]);
    TEST_ASSERT_EQUAL_UINT32(1u, p->rank);
}

void test_residuals_that_the_stated_noise_cannot_explain_make_the_fit_poor(void)
{
    given_overstated_detections();
    world_calibrated();
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_POOR, world.proposal.verdict);
    TEST_ASSERT_TRUE(world.proposal.noise_scale > world.config.poor_noise_scale);
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_POOR));
    TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP)); /* the ground decides */
    TEST_ASSERT_TRUE(world.proposal.kin.sigma[24] > 1e-4);
}

static int spoil_one;

static void overstated_and_one_far_off(kc_detection_t *d)
{
    overstate(d);
    if (spoil_one && APP->plan.n_meas == 15u && world_measuring()) { d->p_cam_tool_m[1] += 0.05; }
}

/* The nominal arm is in force: its residuals by forward kinematics alone. */
static double nominal_rms_m(uint32_t *n_kept, double *rot_rad)
{
    double sum = 0.0, rot = 0.0;
    *n_kept = 0u;
    for (uint32_t i = 0u; i < APP->est.n_obs; i++) {
        const kc_obs_t *obs = &APP->est.obs[i];
        kc_pose_t T;
        if (APP->est.outlier[i]) { continue; }
        kc_arm_fk(&world.arm, obs->ctx.q, &T);
        for (uint32_t k = 0u; k < 3u; k++) { sum += (obs->p_m[k] - T.p_m[k]) * (obs->p_m[k] - T.p_m[k]); }
        double quat[4], same = 0.0;
        kc_R_to_quat(T.R, quat);
        for (uint32_t k = 0u; k < 4u; k++) { same += quat[k] * obs->q_wxyz[k]; }
        rot += pow(2.0 * acos(fabs(same)), 2.0);
        (*n_kept)++;
    }
    *rot_rad = sqrt(rot / (double)*n_kept);
    return sqrt(sum / (double)*n_kept);
}

void test_residuals_before_are_those_of_the_table_in_force_at_the_poses_that_were_kept(void)
{
    uint32_t n_kept = 0u;
    double rot_rad = 0.0;
    spoil_one = 1;
    world.spoil = overstated_and_one_far_off;
    world.config.n_poses = 24u;
    world.config.est.outlier_max = 1u;
    world_calibrated();
    TEST_ASSERT_EQUAL_UINT32(1u, world.proposal.n_outliers);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, nominal_rms_m(&n_kept, &rot_rad), world.proposal.before_pos_m);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, rot_rad, world.proposal.before_rot_rad);
    TEST_ASSERT_EQUAL_UINT32(world.proposal.n_poses - 1u, n_kept);
    TEST_ASSERT_TRUE(world.proposal.before_pos_m > world.proposal.fit_pos_m);
}

/* What is left is unlikely though the worst are gone: the data disagree with the model, not with
 * themselves. */
void test_an_unlikely_fit_that_used_up_what_may_be_rejected_is_poor_with_less_noise(void)
{
    static const kc_verdict_t verdict[] = {KC_VERDICT_CHANGE, KC_VERDICT_POOR};
    for (spoil_one = 0; spoil_one < 2; spoil_one++) {
        setUp();
        world.spoil = overstated_and_one_far_off;
        world.noise_m = 2e-3;
        world.noise_rad = 8e-3;
        world.config.sigma_pos_min_m = 11e-4;
        world.config.sigma_rot_min_rad = 4.4e-3;
        world.config.frames_per_meas = 1u;
        world.config.n_poses = 24u;
        world.config.est.outlier_max = 1u;
        world.config.est.outlier_p = 1e-9;
        world_calibrated();
        TEST_ASSERT_TRUE(world.proposal.noise_scale < world.config.poor_noise_scale_unlikely);
        TEST_ASSERT_TRUE(world.proposal.p_fit < world.config.poor_p_fit);
        TEST_ASSERT_EQUAL_UINT32((uint32_t)spoil_one, world.proposal.n_outliers);
        TEST_ASSERT_EQUAL_INT(verdict[spoil_one], world.proposal.verdict);
    }
}

void test_coefficients_without_any_effect_are_held(void)
{
    for (uint32_t c = 0u; c < 28u; c++) { world.terms.term[c].gain = 0.0; }
    world_calibrated();
    TEST_ASSERT_EQUAL_UINT32(0u, world.proposal.rank);
    TEST_ASSERT_EQUAL_DOUBLE(1.0, world.proposal.p_no_change);
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_POOR, world.proposal.verdict);
}

/* ---- review ---- */

static void refused(int32_t opcode, uint32_t crc, int32_t status, uint16_t event)
{
    kc_state_t state = kc_app_state(APP);
    uint32_t active = active_crc(), waiting = APP->review.crc;
    TEST_ASSERT_EQUAL_INT(status, world_do(opcode, (int32_t)crc, 0, 0));
    TEST_ASSERT_EQUAL_INT(event, world.ack.event_id);
    TEST_ASSERT_TRUE(world_events(event) > 0u);
    TEST_ASSERT_EQUAL_INT(state, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(active, active_crc());
    TEST_ASSERT_EQUAL_UINT32(waiting, APP->review.crc);
}

void test_approval_takes_two_steps_bound_to_the_crc(void)
{
    world_calibrated();
    uint32_t crc = world.proposal.crc, before = active_crc();
    refused(KC_CMD_APPROVE_GO, crc, KC_ERR_STATE, KC_EVT_CMD_STATE);
    refused(KC_CMD_APPROVE_ARM, crc + 1u, KC_ERR_CRC, KC_EVT_CMD_CRC);
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_APPROVE_ARM, (int32_t)crc, 0, 0));
    TEST_ASSERT_EQUAL_INT(KC_ST_ARMED, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_COR_ARMED));
    refused(KC_CMD_APPROVE_ARM, crc, KC_ERR_STATE, KC_EVT_CMD_STATE);
    refused(KC_CMD_APPROVE_GO, crc + 1u, KC_ERR_CRC, KC_EVT_CMD_CRC);
    TEST_ASSERT_EQUAL_UINT32(before, active_crc());
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_APPROVE_GO, (int32_t)crc, 0, 0));
    TEST_ASSERT_EQUAL_INT(KC_ST_IDLE, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(crc, active_crc());
    TEST_ASSERT_EQUAL_UINT32(before, kc_app_active(APP)->kin_prev_crc);
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_COR_ACTIVE));
}

void test_a_corrected_arm_needs_no_change(void)
{
    world_calibrated();
    uint32_t crc = world.proposal.crc;
    (void)world_do(KC_CMD_APPROVE_ARM, (int32_t)crc, 0, 0);
    (void)world_do(KC_CMD_APPROVE_GO, (int32_t)crc, 0, 0);
    (void)world_do(KC_CMD_START, -1, 0, 5);
    for (uint32_t i = 0u; i < 3000u && world_calibrating(); i++) { world_tick(); }
    TEST_ASSERT_EQUAL_UINT32(2u, world.n_proposal);
    TEST_ASSERT_EQUAL_UINT32(2u, world.proposal.session);
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_NO_CHANGE, world.proposal.verdict);
    TEST_ASSERT_EQUAL_UINT32(crc, active_crc());
}

void test_a_rejected_proposal_is_gone(void)
{
    world_calibrated();
    uint32_t crc = world.proposal.crc, before = active_crc();
    refused(KC_CMD_REJECT, crc + 1u, KC_ERR_CRC, KC_EVT_CMD_CRC);
    (void)world_do(KC_CMD_APPROVE_ARM, (int32_t)crc, 0, 0); /* still possible when armed */
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_REJECT, (int32_t)crc, 0, 0));
    TEST_ASSERT_EQUAL_INT(KC_ST_IDLE, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_COR_REJECTED));
    TEST_ASSERT_EQUAL_UINT32(0u, world.stored[KC_STORE_PROPOSAL][0]);
    TEST_ASSERT_EQUAL_UINT32(before, active_crc());
    refused(KC_CMD_APPROVE_ARM, crc, KC_ERR_STATE, KC_EVT_CMD_STATE);
}

/* ---- a poor proposal ---- */

static uint32_t given_poor(void)
{
    given_overstated_detections();
    world_calibrated();
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_POOR, world.proposal.verdict);
    return world.proposal.crc;
}

static void expect_event(uint32_t id, int32_t index, double got, double want);

void test_a_poor_proposal_is_not_armed_without_an_override(void)
{
    uint32_t crc = given_poor();
    refused(KC_CMD_APPROVE_ARM, crc, KC_ERR_ARG, KC_EVT_COR_POOR);
    expect_event(KC_EVT_COR_POOR, -1, (double)crc, 0.0);
    refused(KC_CMD_APPROVE_GO, crc, KC_ERR_STATE, KC_EVT_CMD_STATE);
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_COR_ARMED));
    world_ticks(11u);
    TEST_ASSERT_EQUAL_UINT32(KC_VERDICT_POOR, world.hk.proposal_verdict);
    TEST_ASSERT_EQUAL_UINT64(0u, world.hk.approval_left_us);
}

void test_a_poor_proposal_is_approved_by_an_override_in_the_signed_command(void)
{
    uint32_t crc = given_poor();
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_APPROVE_ARM, (int32_t)crc, KC_OVERRIDE_FIT, 0));
    expect_event(KC_EVT_COR_OVERRIDE, -1, (double)crc, 0.0);
    expect_event(KC_EVT_COR_ARMED, -1, (double)crc, 0.0);
    TEST_ASSERT_EQUAL_INT(KC_ST_ARMED, kc_app_state(APP));
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_APPROVE_GO, (int32_t)crc, 0, 0));
    TEST_ASSERT_EQUAL_UINT32(crc, active_crc());
}

void test_an_override_that_is_put_into_a_command_after_it_was_signed_is_a_forgery(void)
{
    uint32_t crc = given_poor();
    kc_cmd_t *c = world_cmd(KC_CMD_APPROVE_ARM, (int32_t)crc, KC_OVERRIDE_NONE, 0);
    world_sign_cmd(c);
    c->arg_i[1] = KC_OVERRIDE_FIT;
    world.as_sent = true;
    world_tick();
    world.as_sent = false;
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CMD_FORGED));
    TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
}

void test_a_poor_proposal_is_poor_after_a_restart_too_and_armed_before_it_no_more(void)
{
    uint32_t crc = given_poor();
    (void)world_do(KC_CMD_APPROVE_ARM, (int32_t)crc, KC_OVERRIDE_FIT, 0);
    world_restart();
    world_tick();
    TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(KC_VERDICT_POOR, world.hk.proposal_verdict);
    refused(KC_CMD_APPROVE_GO, crc, KC_ERR_STATE, KC_EVT_CMD_STATE);
    refused(KC_CMD_APPROVE_ARM, crc, KC_ERR_ARG, KC_EVT_COR_POOR);
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_APPROVE_ARM, (int32_t)crc, KC_OVERRIDE_FIT, 0));
}

/* A good fit, but nobody knows that any more. */
void test_a_proposal_whose_verdict_was_lost_with_the_journal_needs_an_override(void)
{
    world_calibrated();
    uint32_t crc = world.proposal.crc;
    world.stored[KC_STORE_JOURNAL][0] = world.stored[KC_STORE_JOURNAL][1] = 0u;
    world_restart();
    world_tick();
    TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(0u, world.hk.proposal_verdict);
    refused(KC_CMD_APPROVE_ARM, crc, KC_ERR_ARG, KC_EVT_COR_NO_VERDICT);
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_COR_POOR));
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_APPROVE_ARM, (int32_t)crc, KC_OVERRIDE_FIT, 0));
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_COR_OVERRIDE));
}

/* ---- accepted on board ---- */

static void given_policy(void)
{
    setUp();
    world.truth.joint[6].phi_rad = 0.01;
    world.config.n_poses = 16u;
    world.config.accept_on_board = 1u;
    world.config.accept_change_max_pos_m = 0.01;
    world.config.accept_sigma_max_pos_m = 0.01;
    world.config.accept_p_fit_min = 1e-6;
}

void test_a_small_well_determined_correction_is_accepted_on_board(void)
{
    given_policy();
    world_calibrated();
    TEST_ASSERT_EQUAL_INT(KC_ST_IDLE, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(world.proposal.crc, active_crc());
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_COR_ON_BOARD));
    TEST_ASSERT_EQUAL_UINT32(world.proposal.crc,
                             kc_tbl_image_crc(world.store[KC_TBL_KIN][0], world.stored[KC_TBL_KIN][0]));
}

static void waits_for_the_ground(void)
{
    world_calibrated();
    TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_COR_ON_BOARD));
}

/* Which rule: test_kc_verdict.c. */
void test_what_the_policy_does_not_accept_waits_for_the_ground(void)
{
    for (uint32_t rule = 0u; rule < 3u; rule++) {
        given_policy();
        if (rule == 0u) { world.config.accept_change_max_pos_m = 1e-6; }
        if (rule == 1u) { world.config.accept_sigma_max_pos_m = 1e-9; }
        if (rule == 2u) { /* no floor that makes the noise better than it is */
            world.config.sigma_pos_min_m = world.config.sigma_rot_min_rad = 1e-6;
            world.config.accept_p_fit_min = 1.0;
        }
        waits_for_the_ground();
    }
}

void test_without_a_policy_everything_waits_for_the_ground(void)
{
    given_policy();
    world.config.accept_on_board = 0u;
    waits_for_the_ground();
}

void test_an_active_bound_waits_for_the_ground(void)
{
    for (int lower = 0; lower < 2; lower++) {
        given_policy();
        if (lower) {
            world.terms.term[24].gain = -1.0;
            world.terms.coef[24].lb = -0.009;
        } else {
            world.terms.coef[24].ub = 0.009; /* less than the error */
        }
        world.config.est.outlier_p = 0.0;
        waits_for_the_ground();
        TEST_ASSERT_EQUAL_UINT8(lower ? KC_COEF_AT_LOWER : KC_COEF_AT_UPPER, world.proposal.status[24]);
    }
}

void test_a_coefficient_left_undetermined_waits_for_the_ground(void)
{
    given_policy();
    world.terms.term[23].gain = 0.0; /* no effect at all */
    waits_for_the_ground();
    TEST_ASSERT_EQUAL_UINT8(KC_COEF_HELD, world.proposal.status[23]);
}

/* ---- rollback ---- */

void test_rollback_brings_the_table_before_back(void)
{
    world_calibrated();
    uint32_t crc = world.proposal.crc, before = active_crc();
    (void)world_do(KC_CMD_APPROVE_ARM, (int32_t)crc, 0, 0);
    (void)world_do(KC_CMD_APPROVE_GO, (int32_t)crc, 0, 0);
    refused(KC_CMD_ROLLBACK, before, KC_ERR_CRC, KC_EVT_CMD_CRC);
    (void)world_do(KC_CMD_ABORT, 0, 0, 0);
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_ROLLBACK, (int32_t)crc, 0, 0));
    TEST_ASSERT_EQUAL_INT(KC_ST_IDLE, kc_app_state(APP)); /* out of SAFE too */
    TEST_ASSERT_EQUAL_UINT32(before, active_crc());
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_COR_ROLLBACK));
    TEST_ASSERT_EQUAL_UINT32(0u, world.stored[KC_STORE_PREV][0]);
    refused(KC_CMD_ROLLBACK, before, KC_ERR_STATE, KC_EVT_COR_NO_PREVIOUS);
    world_restart();
    TEST_ASSERT_EQUAL_UINT32(before, active_crc());
}

/* ---- found missing by mutants ---- */

static void expect_event(uint32_t id, int32_t index, double got, double want)
{
    const kc_event_t *e = &world.last[id];
    TEST_ASSERT_TRUE(world_events(id) > 0u);
    TEST_ASSERT_EQUAL_INT(index, e->index);
    TEST_ASSERT_EQUAL_DOUBLE(got, e->got);
    TEST_ASSERT_EQUAL_DOUBLE(want, e->want);
}

void test_a_proposal_without_an_observation_that_counts_has_no_residual_before(void)
{
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_REPORT, 3000u));
    while (world_calibrating() && world.n_proposal == 0u) {
        if (APP->plan.n_meas == world.config.n_poses) {
            memset(APP->est.outlier, 1, sizeof APP->est.outlier);
        }
        world_tick();
    }
    TEST_ASSERT_EQUAL_UINT32(1u, world.n_proposal);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, world.proposal.before_pos_m);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, world.proposal.before_rot_rad);
}

void test_a_correction_that_does_not_fit_the_tables_waits_for_the_ground(void)
{
    given_policy();
    world_started();
    while (world_calibrating() && world.n_progress < world.config.n_poses) { world_tick(); }
    TEST_ASSERT_EQUAL_UINT32(0u, world.n_proposal); /* estimated, and not proposed yet */
    APP->tables.active.terms.coef[24].ub = 0.005; /* behind its back: it will propose 0.01 */
    world_seal(KC_TBL_TERMS);
    for (uint32_t i = 0u; i < 200u && world.n_proposal == 0u; i++) { world_tick(); }
    TEST_ASSERT_TRUE(world_stored(10u));
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_CHANGE, world.proposal.verdict);
    TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_COR_ON_BOARD));
}

/* What is proposed from the estimate as it stands after a calibration. */
static kc_evaluated_t s_evaluated;
static kc_out_t s_out;

static uint32_t steps_to_propose(uint64_t work_of_step)
{
    static kc_review_t review;
    bool accepted = false;
    uint32_t n = 0u;
    memset(&s_out, 0, sizeof s_out);
    kc_evaluation_begin(&s_evaluated, &APP->arena.proposal, &APP->view);
    for (; n < 1000u && !s_out.has_proposal; n++) {
        kc_work_t work = {work_of_step, 0u};
        (void)kc_propose_run(&s_evaluated, &APP->arena.proposal, &review, &APP->tables, &APP->view, &accepted,
                             &work, &s_out);
    }
    return n;
}

void test_a_proposal_states_the_fit_of_the_estimate(void)
{
    world_calibrated();
    const kc_est_t *e = &APP->est;
    TEST_ASSERT_EQUAL_UINT32(1u, steps_to_propose(UINT64_MAX));
    TEST_ASSERT_EQUAL_DOUBLE(e->fit_pos_m, s_out.proposal.fit_pos_m);
    TEST_ASSERT_EQUAL_DOUBLE(e->fit_rot_rad, s_out.proposal.fit_rot_rad);
    TEST_ASSERT_TRUE(e->fit_rot_rad > 0.0);
    /* what the estimator minimised, summed anew */
    TEST_ASSERT_DOUBLE_WITHIN(1e-6 * e->chi2, e->chi2, s_evaluated.chi2_after);
    TEST_ASSERT_TRUE(s_evaluated.chi2_before > s_evaluated.chi2_after);
    const kc_proposal_t *p = &s_out.proposal;
    TEST_ASSERT_EQUAL_DOUBLE(e->chi2, p->chi2);
    TEST_ASSERT_EQUAL_UINT32(e->dof, p->dof);
    TEST_ASSERT_EQUAL_DOUBLE(kc_chi2_sf(e->chi2, e->dof), p->p_fit);
    TEST_ASSERT_EQUAL_DOUBLE(e->noise_scale, p->noise_scale);
    TEST_ASSERT_EQUAL_DOUBLE(e->kkt, p->kkt);
    TEST_ASSERT_EQUAL_DOUBLE(e->cond, p->cond);
    TEST_ASSERT_EQUAL_UINT32(e->rank, p->rank);
    TEST_ASSERT_EQUAL_UINT32(e->n_free, p->n_free);
    TEST_ASSERT_EQUAL_UINT32(e->n_outliers, p->n_outliers);
    TEST_ASSERT_EQUAL_UINT32(1u, p->session);
    TEST_ASSERT_EQUAL_UINT32(8u, p->n_poses);
    TEST_ASSERT_EQUAL_DOUBLE(APP->learned.pred.pos_m, p->pred_pos_m);
    TEST_ASSERT_EQUAL_DOUBLE(APP->learned.pred.rot_rad, p->pred_rot_rad);
    TEST_ASSERT_EQUAL_HEX32(active_crc(), p->crc_kin_before);
    TEST_ASSERT_EQUAL_MEMORY(e->status, p->status, sizeof p->status);
    TEST_ASSERT_EQUAL_MEMORY(e->confounded, p->confounded, sizeof p->confounded);
}

/* Chi-square that the estimate takes away from the table in force: none if that is the estimate, and otherwise as
 * likely by chance as with a degree of freedom for each coefficient. */
void test_how_likely_no_change_is_follows_from_what_the_estimate_takes_away(void)
{
    world.truth.joint[6].phi_rad = 0.0;
    world.noise_m = 1e-3;
    world.noise_rad = 4e-3;
    world_calibrated();
    (void)steps_to_propose(UINT64_MAX);
    double before = s_evaluated.chi2_before, gain = before - s_evaluated.chi2_after;
    TEST_ASSERT_TRUE(gain > 0.0);
    APP->est.chi2 = gain / 28.0 * (double)APP->est.dof;
    (void)steps_to_propose(UINT64_MAX);
    double scale = fmax(1.0, sqrt(gain / 28.0));
    double p = kc_chi2_sf(gain / (scale * scale), APP->est.rank);
    TEST_ASSERT_TRUE(p > 0.01 && p < 0.9999);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, p, s_out.proposal.p_no_change);
    memcpy(APP->est.coef, APP->tables.active.kin.value, sizeof APP->est.coef);
    (void)steps_to_propose(UINT64_MAX);
    TEST_ASSERT_EQUAL_DOUBLE(before, s_evaluated.chi2_before);
    TEST_ASSERT_EQUAL_DOUBLE(before, s_evaluated.chi2_after);
    TEST_ASSERT_EQUAL_DOUBLE(1.0, s_out.proposal.p_no_change);
}

void test_residuals_larger_than_stated_scale_sigma_and_covariance_alike(void)
{
    world_calibrated();
    APP->est.chi2 = 9.0 * (double)APP->est.dof;
    (void)steps_to_propose(UINT64_MAX);
    const kc_proposal_t *p = &s_out.proposal;
    for (uint32_t i = 0u, k = 0u; i < 28u; k += 28u - i, i++) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, 3.0 * APP->est.sigma[i], p->kin.sigma[i]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, p->kin.sigma[i], sqrt(p->cov[k]));
    }
}

/* ---- the camera chain ---- */

static void given_chain(void)
{
    kc_camera_t *c = &APP->tables.active.camera;
    c->mast_sigma_m = 0.002;
    c->zero_sigma_rad = 0.002;
    c->plate_sigma_m = 0.001;
    c->drift_sigma_m_s = 1e-5;
}

void test_an_exact_camera_leaves_the_predicted_error_of_the_noise(void)
{
    world_calibrated();
    const kc_proposal_t *p = &world.proposal;
    TEST_ASSERT_EQUAL_UINT8(KC_RIGHT_IN_CAMERA, p->frame);
    TEST_ASSERT_EQUAL_DOUBLE(APP->learned.pred.pos_m, p->pred_pos_m);
    TEST_ASSERT_EQUAL_DOUBLE(p->pred_pos_m, p->pred_noise_pos_m);
    TEST_ASSERT_EQUAL_DOUBLE(p->pred_pos_m, p->pred_camera_pos_m);
    TEST_ASSERT_EQUAL_DOUBLE(p->pred_pos_m, p->pred_lander_pos_m);
    TEST_ASSERT_EQUAL_DOUBLE(p->pred_rot_rad, p->pred_noise_rot_rad);
    TEST_ASSERT_EQUAL_DOUBLE(p->pred_rot_rad, p->pred_camera_rot_rad);
    TEST_ASSERT_EQUAL_DOUBLE(p->pred_rot_rad, p->pred_lander_rot_rad);
}

/* Against the camera, which is off with what it sees, an error of its place counts less than in the base frame. */
void test_the_predicted_error_is_that_of_the_frame_of_config(void)
{
    world_calibrated();
    given_chain();
    for (uint8_t frame = 0u; frame < 2u; frame++) {
        APP->tables.active.config.frame = frame;
        (void)steps_to_propose(UINT64_MAX);
        const kc_proposal_t *p = &s_out.proposal;
        bool lander = frame == (uint8_t)KC_RIGHT_IN_LANDER;
        TEST_ASSERT_EQUAL_UINT8(frame, p->frame);
        TEST_ASSERT_EQUAL_DOUBLE(lander ? p->pred_lander_pos_m : p->pred_camera_pos_m, p->pred_pos_m);
        TEST_ASSERT_EQUAL_DOUBLE(lander ? p->pred_lander_rot_rad : p->pred_camera_rot_rad, p->pred_rot_rad);
        TEST_ASSERT_TRUE(p->pred_camera_pos_m > 2.0 * p->pred_noise_pos_m);
        TEST_ASSERT_TRUE(p->pred_lander_pos_m > 1.2 * p->pred_camera_pos_m);
        TEST_ASSERT_TRUE(p->pred_camera_rot_rad > p->pred_noise_rot_rad);
        TEST_ASSERT_TRUE(p->pred_lander_rot_rad > p->pred_noise_rot_rad);
    }
}

void test_sigma_and_covariance_hold_the_camera_chain(void)
{
    world_calibrated();
    double before = world.proposal.kin.sigma[24];
    given_chain();
    (void)steps_to_propose(UINT64_MAX);
    const kc_proposal_t *p = &s_out.proposal;
    for (uint32_t i = 0u, k = 0u; i < 28u; k += 28u - i, i++) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, p->kin.sigma[i], sqrt(p->cov[k]));
    }
    TEST_ASSERT_TRUE(p->kin.sigma[24] > 1.05 * before);
}

/* Residuals beyond the noise that the stated chain explains are neither noise nor a bad fit. */
void test_what_the_camera_chain_explains_is_not_counted_as_noise_too(void)
{
    world.tilt_bias_rad = 0.006;
    world.config.n_poses = 16u;
    world.config.est.outlier_p = 0.0;
    world_calibrated();
    double p_exact = world.proposal.p_fit, noise_exact = world.proposal.noise_scale;
    given_chain();
    (void)steps_to_propose(UINT64_MAX);
    TEST_ASSERT_TRUE(s_out.proposal.p_fit > 0.001);
    TEST_ASSERT_TRUE(p_exact < 1e-6);
    TEST_ASSERT_TRUE(s_out.proposal.noise_scale < 0.8 * noise_exact);
    TEST_ASSERT_TRUE(s_out.proposal.chi2 < APP->est.chi2);
}

/* A healthy arm and a camera that is off: it goes where the camera says it is not, so in the camera's frame
 * something has to change. In the base frame nothing has to, if the camera may be that far off. */
void test_whether_a_change_is_needed_depends_on_the_frame(void)
{
    world.truth.joint[6].phi_rad = 0.0;
    world.tilt_bias_rad = 0.003;
    world.config.n_poses = 16u;
    world_calibrated();
    given_chain();
    APP->tables.active.config.frame = (uint8_t)KC_RIGHT_IN_CAMERA;
    (void)steps_to_propose(UINT64_MAX);
    TEST_ASSERT_TRUE(s_out.proposal.p_no_change < 1e-6);
    APP->tables.active.config.frame = (uint8_t)KC_RIGHT_IN_LANDER;
    (void)steps_to_propose(UINT64_MAX);
    TEST_ASSERT_TRUE(s_out.proposal.p_no_change > 0.01);
    APP->tables.active.camera.zero_sigma_rad = 1e-5; /* and not, if it may not */
    APP->tables.active.camera.mast_sigma_m = 0.0;
    (void)steps_to_propose(UINT64_MAX);
    TEST_ASSERT_TRUE(s_out.proposal.p_no_change < 1e-6);
}

void test_without_a_solution_the_camera_chain_has_no_part(void)
{
    world_calibrated();
    given_chain();
    APP->learned.status = KC_ERR_NUM;
    (void)steps_to_propose(UINT64_MAX);
    const kc_proposal_t *p = &s_out.proposal;
    TEST_ASSERT_EQUAL_DOUBLE(p->pred_noise_pos_m, p->pred_lander_pos_m);
    TEST_ASSERT_EQUAL_DOUBLE(1.0, p->p_no_change);
    TEST_ASSERT_EQUAL_DOUBLE(APP->est.chi2, p->chi2);
}

/* Whether it says that the chain alone turns the tool by more than this. */
static bool chain_turns_more_than(double stop_rot_rad)
{
    APP->tables.active.config.stop_rot_rad = stop_rot_rad;
    (void)steps_to_propose(UINT64_MAX);
    const kc_event_t *e = s_out.events.e;
    if (s_out.events.n == 0u) { return false; }
    TEST_ASSERT_EQUAL_UINT32(1u, s_out.events.n);
    TEST_ASSERT_EQUAL_UINT16(KC_EVT_CAL_CHAIN_LIMIT, e->id);
    TEST_ASSERT_EQUAL_INT(1, e->index);
    TEST_ASSERT_EQUAL_DOUBLE(s_evaluated.chain.rot_rad, e->got);
    TEST_ASSERT_EQUAL_DOUBLE(stop_rot_rad, e->want);
    return true;
}

void test_a_required_rotation_that_the_camera_chain_keeps_away_is_reported(void)
{
    world_calibrated();
    given_chain();
    TEST_ASSERT_FALSE(chain_turns_more_than(0.0)); /* none is required */
    double rot_rad = s_evaluated.chain.rot_rad;
    TEST_ASSERT_TRUE(rot_rad > 0.0);
    TEST_ASSERT_TRUE(chain_turns_more_than(0.9 * rot_rad));
    TEST_ASSERT_FALSE(chain_turns_more_than(1.1 * rot_rad));
}

void test_what_is_not_estimated_keeps_value_and_sigma_of_the_table_in_force(void)
{
    static const uint8_t kept[] = {KC_COEF_MASKED, KC_COEF_HELD};
    world_calibrated();
    for (uint32_t c = 0u; c < 2u; c++) {
        APP->est.status[c] = kept[c];
        APP->tables.active.kin.value[c] = 0.25;
        APP->tables.active.kin.sigma[c] = 0.75;
    }
    (void)steps_to_propose(UINT64_MAX);
    for (uint32_t c = 0u; c < 2u; c++) {
        TEST_ASSERT_EQUAL_DOUBLE(0.25, s_out.proposal.kin.value[c]);
        TEST_ASSERT_EQUAL_DOUBLE(0.75, s_out.proposal.kin.sigma[c]);
    }
    TEST_ASSERT_EQUAL_DOUBLE(APP->est.coef[2], s_out.proposal.kin.value[2]);
}

/* One observation or one candidate in a step that has room for no more, then the proposal. */
void test_a_proposal_is_charged_observation_by_observation_and_candidate_by_candidate(void)
{
    world_calibrated();
    uint32_t kept = APP->est.n_obs - APP->est.n_outliers;
    /* and the camera chain, once, and four bounds */
    TEST_ASSERT_EQUAL_UINT32(kept + 1u + world.space.n_cand + 4u + 1u, steps_to_propose(1u));
}

void test_events_of_a_verdict_say_what_it_rests_on(void)
{
    world.truth.joint[6].phi_rad = 0.0;
    world_calibrated();
    expect_event(KC_EVT_COR_NO_CHANGE, -1, world.proposal.p_no_change, 0.0);
    setUp();
    world.config.n_poses = 2u;
    world_calibrated();
    const kc_proposal_t *p = &world.proposal;
    expect_event(KC_EVT_CAL_RANK, -1, (double)p->rank, (double)p->n_free);
    expect_event(KC_EVT_CAL_POOR, -1, p->p_fit, p->noise_scale);
    uint32_t last = 28u, held = 0u;
    for (uint32_t c = 0u; c < 28u; c++) {
        if (p->status[c] != (uint8_t)KC_COEF_HELD) { continue; }
        last = c;
        held++;
    }
    TEST_ASSERT_EQUAL_UINT32(held, world_events(KC_EVT_CAL_HELD));
    const kc_event_t *e = &world.last[KC_EVT_CAL_HELD];
    TEST_ASSERT_EQUAL_INT((int)last, e->index);
    TEST_ASSERT_EQUAL_DOUBLE(p->kin.value[last], e->got);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, e->want);
}

void test_a_correction_accepted_on_board_is_reported_with_its_crc(void)
{
    given_policy();
    world_calibrated();
    expect_event(KC_EVT_COR_ON_BOARD, -1, (double)active_crc(), 0.0);
    TEST_ASSERT_EQUAL_HEX32(world.proposal.crc, active_crc());
}
