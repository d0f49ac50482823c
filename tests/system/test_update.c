/* kc_update.c in whole calibrations: choice of candidates, ends, local initial poses. State by state: test_kc_update.c. */
#include <math.h>
#include <string.h>

#include "given_world.h"
#include "unity.h"

#define APP (&kc_app_instance)

void setUp(void)
{
    given_world();
    world.truth.joint[6].phi_rad = 0.2;
    world.truth.joint[2].d_m += 0.02;
}

static bool all_different(uint32_t n)
{
    for (uint32_t i = 0u; i < n; i++) {
        for (uint32_t j = 0u; j < i; j++) {
            if (world.meas[i].candidate == world.meas[j].candidate) { return false; }
        }
    }
    return true;
}

/* ---- choice ---- */

void test_initial_poses_come_first_then_the_acquisition_chooses(void)
{
    world_calibrated();
    for (int32_t k = 0; k < 3; k++) {
        TEST_ASSERT_EQUAL_INT(k, world.meas[k].candidate);
        TEST_ASSERT_EQUAL_INT(-1, world.progress[k].acquisition);
    }
    TEST_ASSERT_EQUAL_INT(KC_ACQ_UCB, world.progress[3].acquisition);
    TEST_ASSERT_TRUE(all_different(6u));
}

void test_every_acquisition_ends_in_a_good_correction(void)
{
    for (uint8_t acq = KC_ACQ_UCB; acq < KC_ACQ_COUNT; acq++) {
        setUp();
        world.config.acquisition = acq;
        world.config.n_poses = 8u;
        world_calibrated();
        TEST_ASSERT_EQUAL_INT(KC_VERDICT_CHANGE, world.proposal.verdict);
        TEST_ASSERT_EQUAL_INT(acq, world.progress[7].acquisition);
        TEST_ASSERT_DOUBLE_WITHIN(0.01, 0.2, world.proposal.kin.value[24]);
        TEST_ASSERT_TRUE(all_different(8u));
    }
}

void test_information_criteria_work_without_initial_poses_too(void)
{
    for (uint8_t acq = KC_ACQ_UCB; acq < KC_ACQ_COUNT; acq++) {
        setUp();
        world.space.n_initial = 0u;
        world.config.acquisition = acq;
        world_calibrated();
        TEST_ASSERT_EQUAL_UINT32(6u, world.n_meas);
        int first = acq >= KC_ACQ_DOPT ? (int)KC_ACQ_RANDOM
                                       : (int)acq; /* nothing is solved before the first pose */
        TEST_ASSERT_EQUAL_INT(first, world.progress[0].acquisition);
    }
}

void test_the_seed_of_start_decides_random_poses(void)
{
    int32_t first[6];
    int same = 0;
    for (int32_t seed = 1; seed <= 3; seed++) {
        setUp();
        world.space.n_initial = 0u;
        world_boot();
        world_tick();
        (void)world_do(KC_CMD_START, KC_ACQ_RANDOM, 6, seed == 3 ? 1 : seed);
        for (uint32_t i = 0u; i < 3000u && world_calibrating(); i++) { world_tick(); }
        for (uint32_t k = 0u; k < 6u; k++) {
            if (seed == 1) { first[k] = world.meas[k].candidate; }
            same += seed == 2 && first[k] == world.meas[k].candidate;
            if (seed == 3) { TEST_ASSERT_EQUAL_INT(first[k], world.meas[k].candidate); }
        }
    }
    TEST_ASSERT_TRUE(same < 6);
}

void test_replicates_measure_the_first_poses_again(void)
{
    world.config.replicate_every = 3u;
    world.config.n_poses = 8u;
    world_calibrated();
    TEST_ASSERT_EQUAL_INT(0, world.meas[3].candidate);
    TEST_ASSERT_EQUAL_INT(1, world.meas[3].replicate);
    TEST_ASSERT_EQUAL_INT(1, world.meas[6].candidate);
    TEST_ASSERT_EQUAL_INT(0, world.meas[2].replicate);
    TEST_ASSERT_EQUAL_INT(-1, world.progress[3].acquisition);
}

/* ---- nothing left ---- */

void test_without_any_usable_candidate_it_gives_up(void)
{
    world.hide = 100000;
    world.config.search_steps = 0u;
    world_calibrated();
    TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(24u, world_events(KC_EVT_CAL_CAND_SKIPPED));
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_NO_CANDIDATE));
    TEST_ASSERT_EQUAL_DOUBLE((double)KC_CAUSE_NO_CANDIDATE, world.last[KC_EVT_CAL_ABORTED].got);
}

void test_when_candidates_run_out_it_proposes_what_it_has(void)
{
    world.config.n_poses = 30u;
    world_calibrated();
    TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(24u, world.n_meas);
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_NO_CANDIDATE));
    TEST_ASSERT_EQUAL_INT(KC_ENDED_CANDIDATES, world.proposal.ended);
}

/* ---- budget and stop ---- */

void test_a_budget_used_up_while_moving_holds_the_arm_and_proposes(void)
{
    world.config.budget_us = 12000000u;
    world.config.n_poses = 30u;
    world_calibrated();
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_BUDGET));
    TEST_ASSERT_EQUAL_UINT32(1u, world.n_proposal);
    TEST_ASSERT_EQUAL_INT(KC_ENDED_TIME, world.proposal.ended);
    TEST_ASSERT_TRUE(world.n_meas > 0u && world.n_meas < 24u);
}

/* ---- energy ---- */

void test_energy_used_up_holds_the_arm_and_proposes(void)
{
    world.config.power_idle_w = 10.0;
    world.config.power_move_w = 70.0;
    world.config.energy_budget_j = 300.0;
    world.config.n_poses = 24u;
    world_calibrated();
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_ENERGY));
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_CAL_BUDGET));
    TEST_ASSERT_DOUBLE_WITHIN(7.1, 300.0, world.last[KC_EVT_CAL_ENERGY].got);
    TEST_ASSERT_EQUAL_DOUBLE(300.0, world.last[KC_EVT_CAL_ENERGY].want);
    TEST_ASSERT_EQUAL_UINT32(1u, world.n_proposal);
    TEST_ASSERT_EQUAL_INT(KC_ENDED_ENERGY, world.proposal.ended);
    TEST_ASSERT_TRUE(world.n_meas > 0u && world.n_meas < 24u);
}

/* ---- replicates ---- */

static uint32_t poses_until_certain(double pos_m, double rot_rad)
{
    setUp();
    world.config.n_poses = 24u;
    world.config.stop_pos_m = pos_m;
    world.config.stop_rot_rad = rot_rad;
    world_calibrated();
    return world.n_meas;
}

static void given_chain_of_plate(double plate_m, double stop_pos_m)
{
    setUp();
    world.camera.plate_sigma_m = plate_m;
    world.config.n_poses = 24u;
    world.config.stop_pos_m = stop_pos_m;
    world.config.stop_confidence = 0.9;
    world_calibrated();
}

/* Tags that may be 1 mm off along each axis: however many poses, it cannot be 1 mm. */
void test_the_camera_chain_counts_where_it_stops(void)
{
    given_chain_of_plate(0.0, 1e-3);
    TEST_ASSERT_EQUAL_INT(KC_ENDED_REQUIREMENT, world.proposal.ended);
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_CAL_CHAIN_LIMIT));
    given_chain_of_plate(1e-3, 1e-3);
    TEST_ASSERT_EQUAL_INT(KC_ENDED_POSES, world.proposal.ended);
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_CAL_CONVERGED));
    TEST_ASSERT_TRUE(world.proposal.pred_noise_pos_m < 5e-4);
    TEST_ASSERT_TRUE(world.proposal.bound_pos_m > 1e-3);
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_CHAIN_LIMIT)); /* said once */
    const kc_event_t *e = &world.last[KC_EVT_CAL_CHAIN_LIMIT];
    TEST_ASSERT_EQUAL_INT(0, e->index);
    TEST_ASSERT_TRUE(e->got > 1e-3 && e->got < 3e-3);
    TEST_ASSERT_EQUAL_DOUBLE(1e-3, e->want);
}

static void given_early_test(double phi_rad, double power)
{
    setUp();
    world.truth.joint[2].d_m = world.arm.joint[2].d_m;
    world.truth.joint[6].phi_rad = phi_rad;
    world.config.n_poses = 20u;
    world.config.stop_pos_m = 2e-3;
    world.config.stop_rot_rad = 0.01;
    world.config.stop_checks = 60u; /* the other end does not come */
    world.config.no_change_power = power;
    world_calibrated();
}

void test_a_right_arm_ends_it_as_soon_as_an_error_would_have_shown(void)
{
    given_early_test(0.0, 0.9);
    uint32_t n = world.n_meas;
    TEST_ASSERT_EQUAL_INT(KC_ENDED_NO_CHANGE, world.proposal.ended);
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_NO_CHANGE, world.proposal.verdict);
    TEST_ASSERT_TRUE(n < 14u);
    const kc_event_t *e = &world.last[KC_EVT_CAL_AGREES];
    TEST_ASSERT_EQUAL_INT((int32_t)n, e->index);
    TEST_ASSERT_EQUAL_DOUBLE(world.proposal.p_no_change, e->got);
    TEST_ASSERT_TRUE(e->want >= 0.9 && e->want <= 1.0);
    given_early_test(0.0, 0.0); /* never */
    TEST_ASSERT_EQUAL_UINT32(20u, world.n_meas);
    TEST_ASSERT_EQUAL_INT(KC_ENDED_POSES, world.proposal.ended);
}

/* It is tested_early at once; what is left of the level is for the end. */
void test_a_wrong_arm_is_looked_at_once_and_calibrated_on(void)
{
    given_early_test(0.02, 0.9);
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_DISAGREES));
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_CAL_AGREES));
    TEST_ASSERT_EQUAL_DOUBLE(0.5 * world.config.no_change_p, world.last[KC_EVT_CAL_DISAGREES].want);
    TEST_ASSERT_EQUAL_UINT32(20u, world.n_meas);
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_CHANGE, world.proposal.verdict);
    TEST_ASSERT_TRUE(APP->latest.tested_early);
}

/* The same requirement at a confidence, or with poses in a row that were predicted so well, takes more poses. */
void test_a_confidence_and_checks_take_more_poses(void)
{
    uint32_t rms = poses_until_certain(3.3e-4, 0.0);
    setUp();
    world.config.n_poses = 40u;
    world.config.stop_pos_m = 3.3e-4;
    world.config.stop_confidence = 0.9999;
    world_calibrated();
    TEST_ASSERT_TRUE(world.n_meas > rms && world.n_meas < 40u);
    TEST_ASSERT_TRUE(world.proposal.bound_pos_m > 1.2 * world.proposal.pred_pos_m);
    TEST_ASSERT_EQUAL_DOUBLE(world.proposal.bound_pos_m, world.last[KC_EVT_CAL_CONVERGED].got);
    TEST_ASSERT_EQUAL_DOUBLE(0.9999, world.proposal.confidence);
    TEST_ASSERT_TRUE(world.last[KC_EVT_CAL_CONVERGED].got <= 3.3e-4);
    setUp();
    world.config.n_poses = 40u;
    world.config.stop_pos_m = 3.3e-4;
    world.config.stop_checks = rms + 4u;
    world_calibrated();
    TEST_ASSERT_TRUE(world.n_meas > rms && world.n_meas < 40u);
    TEST_ASSERT_TRUE(APP->latest.n_checked >= rms + 4u);
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_CONVERGED));
}

/* ---- estimates ---- */

/* One frame of a late pose is far off although it claims to be good. */
static void one_bad_pose(kc_detection_t *d)
{
    if (APP->plan.n_meas == 9u && world_measuring()) { d->p_cam_tool_m[1] += 0.01; }
}

void test_an_outlier_is_reported_once_and_left_out(void)
{
    world.spoil = one_bad_pose;
    world.config.n_poses = 14u;
    world_calibrated();
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_OUTLIER));
    TEST_ASSERT_EQUAL_INT(10, world.last[KC_EVT_CAL_OUTLIER].index);
    TEST_ASSERT_EQUAL_UINT32(1u, world.proposal.n_outliers);
    TEST_ASSERT_DOUBLE_WITHIN(0.005, 0.2, world.proposal.kin.value[24]);
}

void test_a_gp_that_breaks_down_leaves_the_choice_to_chance(void)
{
    world_started();
    TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_POSE, 300u));
    APP->latest.gp_ok = false;
    for (uint32_t i = 0u; i < 3000u && world_calibrating(); i++) { world_tick(); }
    TEST_ASSERT_EQUAL_UINT32(6u, world.n_meas);
    TEST_ASSERT_EQUAL_INT(KC_ACQ_RANDOM, world.progress[5].acquisition);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, world.progress[5].gp_sigma);
}

/* ---- observations on the way ---- */

static void given_extra_observations(uint32_t n_poses)
{
    setUp();
    world.config.n_poses = n_poses;
    world.config.extra_obs_max = 1u;
    world.config.servo.tol_rot_rad = 0.01;
    world.config.extra_rot_rad = 0.008; /* less than the least servo step */
}

void test_extra_observations_are_in_the_estimate_but_no_poses(void)
{
    double dp[KC_MEAS_MAX], dr[KC_MEAS_MAX], y[KC_MEAS_MAX];
    given_extra_observations(6u);
    world_calibrated();
    const kc_plan_t *p = &APP->plan;
    TEST_ASSERT_EQUAL_UINT32(6u, p->n_meas);
    TEST_ASSERT_TRUE(world.n_meas > 6u);
    TEST_ASSERT_EQUAL_UINT32(world.n_meas, APP->est.n_obs);
    TEST_ASSERT_EQUAL_UINT32(6u, world.n_progress);
    TEST_ASSERT_EQUAL_UINT32(6u, world.proposal.n_poses);
    TEST_ASSERT_EQUAL_UINT32(6u * world.n_meas - world.proposal.rank, world.proposal.dof);
    TEST_ASSERT_EQUAL_UINT32(world.n_meas, world.hk.n_meas);
    for (uint32_t k = 0u; k < 6u; k++) {
        dp[k] = APP->latest.dp_m[p->obs_of[k]];
        dr[k] = APP->latest.dr_rad[p->obs_of[k]];
    }
    kc_acq_objective(dp, dr, 6u, world.config.a1, world.config.sp_floor_m, world.config.sq_floor_rad, y);
    TEST_ASSERT_EQUAL_DOUBLE_ARRAY(y, APP->latest.y, 6u);
    TEST_ASSERT_EQUAL_DOUBLE(APP->latest.f, world.progress[5].f);
}

/* What is stated about the estimate is computed from the observations that it has. */
void test_extra_observations_of_a_pose_that_is_not_measured_do_not_count(void)
{
    uint32_t used = 0u;
    given_extra_observations(24u);
    world.config.servo.tol_rot_rad = 5e-4; /* there is always a servo step */
    world.config.extra_pos_m = world.config.extra_rot_rad = 1e-6;
    world.config.budget_us = 1000000000u;
    world_started();
    for (uint32_t i = 0u; i < 5000u && (APP->plan.n_meas < 12u || APP->plan.n_obs == used); i++) {
        world_tick();
        used = APP->plan.n_meas > 0u ? APP->plan.obs_of[APP->plan.n_meas - 1u] + 1u : 0u;
    }
    TEST_ASSERT_TRUE(APP->est.n_obs > used); /* one on the way to the next pose */
    APP->tables.active.config.budget_us = 1u;
    world_seal(KC_TBL_CONFIG);
    for (uint32_t i = 0u; i < 50u && world.n_proposal == 0u; i++) { world_tick(); }
    TEST_ASSERT_EQUAL_INT(KC_ENDED_TIME, world.proposal.ended);
    TEST_ASSERT_EQUAL_UINT32(used, APP->est.n_obs);
    TEST_ASSERT_EQUAL_UINT32(used, APP->plan.n_obs);
    TEST_ASSERT_EQUAL_UINT32(6u * used - world.proposal.rank, world.proposal.dof);
    TEST_ASSERT_TRUE(world.proposal.pred_pos_m < 2e-3 && world.proposal.p_fit > 1e-6);
}

void test_the_gaussian_process_learns_from_poses_alone(void)
{
    given_extra_observations(6u);
    world_started();
    for (uint32_t k = 1u; k < 6u; k++) {
        TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_POSE, 600u));
        TEST_ASSERT_EQUAL_UINT32(k, APP->arena.calibration.gp.n);
    }
    TEST_ASSERT_TRUE(APP->est.n_obs > 5u);
    const kc_obs_t *newest = &APP->est.obs[APP->plan.obs_of[4]];
    TEST_ASSERT_EQUAL_MEMORY(newest->p_m, APP->arena.calibration.gp.x[4].p_m, sizeof newest->p_m);
}

/* ---- local initial poses ---- */

#define LOCAL(i) ((int32_t)(world.space.n_cand - n_local + (i))) /* of a space with n_local of them */

/* Errors within the bounds of the tables, so that nothing is a mismatch; an observation without tags costs
 * one frame. */
static void given_local_poses_ahead(uint32_t n, uint32_t n_reserve)
{
    setUp();
    world.config.search_steps = 0u;
    given_local_poses(n, n_reserve);
}

static double seed_dist(uint32_t i)
{
    double far = 0.0;
    const kc_cand_t *c = &world.space.cand[world.meas[i].candidate];
    for (uint32_t j = 0u; j < 7u; j++) {
        far = fmax(far, fabs(world.meas[i].arm.q[j] - (double)c->q_seed[j]));
    }
    return far;
}

static void expect_stopped(kc_cause_t cause, uint32_t n_meas)
{
    TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_ABORTED));
    TEST_ASSERT_EQUAL_DOUBLE((double)cause, world.last[KC_EVT_CAL_ABORTED].got);
    TEST_ASSERT_EQUAL_UINT32(n_meas, world.n_meas);
    TEST_ASSERT_EQUAL_UINT32(0u, world.n_proposal);
}

void test_local_initial_poses_lead_and_come_on_top_of_the_requested_poses(void)
{
    const uint32_t n_local = 9u;
    given_local_poses_ahead(n_local, 0u);
    world_calibrated();
    TEST_ASSERT_EQUAL_UINT32(15u, world.n_meas);
    TEST_ASSERT_TRUE(all_different(15u));
    for (uint32_t i = 0u; i < n_local; i++) {
        TEST_ASSERT_EQUAL_INT(LOCAL(i), world.meas[i].candidate);
        TEST_ASSERT_EQUAL_INT(-1, world.progress[i].acquisition);
        TEST_ASSERT_EQUAL_UINT32(15u, world.progress[i].n_goal);
    }
    for (int32_t i = 0; i < 3; i++) { TEST_ASSERT_EQUAL_INT(i, world.meas[n_local + (uint32_t)i].candidate); }
    TEST_ASSERT_EQUAL_INT(KC_ACQ_UCB, world.progress[12].acquisition);
    TEST_ASSERT_EQUAL_DOUBLE(6.0, world.last[KC_EVT_CAL_START].got);
    TEST_ASSERT_EQUAL_UINT32(9u, APP->plan.n_tried);
    TEST_ASSERT_EQUAL_UINT32(9u, APP->plan.n_local);
    TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(15u, world.proposal.n_poses);
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_CHANGE, world.proposal.verdict);
    TEST_ASSERT_DOUBLE_WITHIN(0.01, 0.2, world.proposal.kin.value[24]);
}

void test_local_initial_poses_are_measured_at_their_seed_without_servo_and_approach(void)
{
    given_local_poses_ahead(9u, 0u);
    world.config.approach_rad = 0.05;
    world_calibrated();
    for (uint32_t i = 0u; i < 9u; i++) {
        TEST_ASSERT_EQUAL_UINT32(0u, world.progress[i].servo_steps);
        TEST_ASSERT_TRUE(seed_dist(i) <= 1e-6);
    }
    TEST_ASSERT_TRUE(seed_dist(9u) > 0.05); /* others make up for the 0.2 rad of joint 7 */
}

static void expect_too_few_detections(double detected, double tried)
{
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_TAGS_NOT_DETECTED));
    TEST_ASSERT_EQUAL_INT(-1, world.last[KC_EVT_CAL_TAGS_NOT_DETECTED].index);
    TEST_ASSERT_EQUAL_DOUBLE(detected, world.last[KC_EVT_CAL_TAGS_NOT_DETECTED].got);
    TEST_ASSERT_EQUAL_DOUBLE(tried, world.last[KC_EVT_CAL_TAGS_NOT_DETECTED].want);
    expect_stopped(KC_CAUSE_TAGS_NOT_DETECTED, (uint32_t)detected);
    for (uint32_t j = 0u; j < 7u; j++) { /* it made no large move */
        TEST_ASSERT_TRUE(fabs(world.q[j] - world.q_start[j]) <= LOCAL_STEP_RAD + 1e-6);
    }
}

void test_six_local_initial_poses_without_a_tag_end_it(void)
{
    given_local_poses_ahead(8u, 2u);
    world.hide = 100000;
    world_calibrated();
    expect_too_few_detections(0.0, 6.0); /* two others were to come */
    given_local_poses_ahead(9u, 2u);
    world.hide = 5; /* the sixth shows one */
    world_calibrated();
    TEST_ASSERT_EQUAL_UINT32(9u, APP->plan.n_tried);
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_CAL_TAGS_NOT_DETECTED));
}

/* ---- model mismatch ---- */

/* Only the offset of joint 7 is requested, and it is 0.2 rad: what it explains is known. */
static void given_offset_within(double bound_rad)
{
    given_local_poses_ahead(9u, 0u);
    world.truth.joint[2].d_m = world.arm.joint[2].d_m;
    world.config.est.free_mask = 1ull << 24u;
    world.terms.coef[24].lb = -bound_rad;
    world.terms.coef[24].ub = bound_rad;
}

void test_a_local_initial_pose_off_by_more_than_any_correction_explains_ends_it(void)
{
    given_offset_within(0.12);
    world.config.mismatch_rot_rad = 0.06;
    world_calibrated();
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_MODEL_MISMATCH));
    TEST_ASSERT_EQUAL_INT(2, world.last[KC_EVT_CAL_MODEL_MISMATCH].index); /* measured again: the same */
    TEST_ASSERT_EQUAL_INT(world.meas[0].candidate, world.meas[1].candidate);
    TEST_ASSERT_DOUBLE_WITHIN(2e-3, 0.08, world.last[KC_EVT_CAL_MODEL_MISMATCH].want);
    expect_stopped(KC_CAUSE_MODEL_MISMATCH, 2u);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, APP->latest.coef[24]);
}

void test_with_all_errors_free_a_wrong_link_length_is_a_mismatch(void)
{
    given_local_poses_ahead(9u, 0u);
    world.truth.joint[2].d_m = world.arm.joint[2].d_m + 0.2;
    for (uint32_t c = 0u; c < 28u; c++) {
        world.terms.coef[c].lb *= 0.1;
        world.terms.coef[c].ub *= 0.1;
    }
    world.config.mismatch_pos_m = 0.02;
    world_calibrated();
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_MODEL_MISMATCH));
    TEST_ASSERT_EQUAL_UINT32(0u, APP->est.without); /* the estimate is that of all observations again */
    TEST_ASSERT_TRUE(APP->est.noise_scale > world.config.mismatch_noise_scale);
    expect_stopped(KC_CAUSE_MODEL_MISMATCH, (uint32_t)world.last[KC_EVT_CAL_MODEL_MISMATCH].index);
    TEST_ASSERT_TRUE(world.n_meas <= 18u);
}

static uint32_t s_bad_from, s_bad_to;

static void bad_poses(kc_detection_t *d)
{
    bool bad = APP->plan.n_meas >= s_bad_from && APP->plan.n_meas <= s_bad_to;
    if (bad && world_measuring()) { d->p_cam_tool_m[1] += 0.01; }
}

static void given_bad_poses(uint32_t from, uint32_t to)
{
    given_offset_within(1.5);
    s_bad_from = from;
    s_bad_to = to;
    world.spoil = bad_poses;
    world.config.mismatch_pos_m = 0.005;
}

/* Two measurements of a pose agree to within 4 mm. */
static void given_bad_detections(uint32_t from, uint32_t to)
{
    given_bad_poses(from, to);
    world.config.jump_pos_m = 0.004;
    world_calibrated();
}

static uint32_t times_measured(int32_t candidate)
{
    uint32_t n = 0u;
    for (uint32_t i = 0u; i < world.n_meas; i++) { n += world.meas[i].candidate == candidate ? 1u : 0u; }
    return n;
}

void test_a_single_bad_detection_at_any_local_initial_pose_is_left_out_and_its_pose_measured_again(void)
{
    for (uint32_t k = 0u; k < 9u; k++) {
        given_bad_detections(k, k);
        TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_CAL_MODEL_MISMATCH));
        TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
        TEST_ASSERT_EQUAL_UINT32(k + 1u, APP->est.without);
        TEST_ASSERT_EQUAL_UINT32(1u, world.proposal.n_outliers);
        TEST_ASSERT_EQUAL_UINT32(2u, times_measured(world.meas[k].candidate));
        TEST_ASSERT_DOUBLE_WITHIN(2e-3, 0.2, world.proposal.kin.value[24]);
    }
}

void test_two_bad_detections_among_the_local_initial_poses_end_it(void)
{
    given_bad_detections(4u, 5u); /* the second where the first is measured again */
    expect_stopped(KC_CAUSE_MODEL_MISMATCH, 6u);
    TEST_ASSERT_EQUAL_INT(6, world.last[KC_EVT_CAL_MODEL_MISMATCH].index);
    TEST_ASSERT_DOUBLE_WITHIN(1e-3, 0.01, world.last[KC_EVT_CAL_MODEL_MISMATCH].got);
}

/* ---- found missing by mutants ---- */

void test_without_a_solution_an_information_criterion_leaves_the_choice_to_chance(void)
{
    for (uint8_t acq = KC_ACQ_DOPT; acq < KC_ACQ_COUNT; acq++) {
        setUp();
        world.config.acquisition = acq;
        world_started();
        TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_POSE, 300u));
        APP->est.opt.iter_max = 0u; /* not allowed: the estimator refuses */
        for (uint32_t i = 0u; i < 3000u && world_calibrating(); i++) { world_tick(); }
        TEST_ASSERT_EQUAL_UINT32(6u, world.n_meas);
        TEST_ASSERT_EQUAL_INT(KC_ACQ_RANDOM, world.progress[5].acquisition);
    }
}

void test_where_no_candidate_is_left_an_information_criterion_ends_the_calibration(void)
{
    world.config.acquisition = KC_ACQ_DOPT;
    world_started();
    for (uint32_t i = 0u; i < 3u; i++) { TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_POSE, 300u)); }
    memset(APP->plan.usable, 0, sizeof APP->plan.usable);
    for (uint32_t i = 0u; i < 300u && world_calibrating(); i++) { world_tick(); }
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_NO_CANDIDATE));
    TEST_ASSERT_EQUAL_UINT32(3u, world.n_meas);
}
