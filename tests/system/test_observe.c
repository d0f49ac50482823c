/* kc_observe.c in whole calibrations: silence, the planar flip, servo, going back, observations on the way. Frame by
 * frame: test_kc_observe.c. */
#include <math.h>
#include <string.h>

#include "given_world.h"
#include "unity.h"

#define APP (&kc_app_instance)

void setUp(void) { given_world(); }

/* ---- frames ---- */

void test_a_camera_that_stays_silent_ends_it(void)
{
    const kc_state_t states[] = {KC_ST_OBSERVE, KC_ST_SEARCH, KC_ST_MEASURE};
    for (uint32_t i = 0u; i < 3u; i++) {
        given_world();
        world.hide = states[i] == KC_ST_SEARCH ? 1 : 0;
        world_started();
        TEST_ASSERT_TRUE(world_until(states[i], 300u));
        world.camera_silent = true;
        TEST_ASSERT_TRUE(world_until(KC_ST_SAFE, 100u));
        TEST_ASSERT_EQUAL_UINT32(3u, world_events(KC_EVT_CAL_FRAME_TIMEOUT)); /* two retries */
        TEST_ASSERT_EQUAL_DOUBLE((double)KC_CAUSE_CAMERA, world.last[KC_EVT_CAL_ABORTED].got);
    }
}

/* ---- planar flip ---- */

static double s_rms_alt = 0.35, s_turn = 0.8;
static bool s_true_is_second;

/* The other solution is turned about the camera's x axis; the right one may stand in second place. */
static void flip(kc_detection_t *d)
{
    double q[4];
    const double turn[4] = {cos(0.5 * s_turn), sin(0.5 * s_turn), 0.0, 0.0};
    if (d->n_tags == 0u) { return; }
    kc_quat_mul(turn, d->q_cam_tool_wxyz, q);
    memcpy(d->q_alt_wxyz, q, sizeof q);
    d->rms_alt_px = s_rms_alt;
    if (!s_true_is_second) { return; }
    memcpy(d->q_alt_wxyz, d->q_cam_tool_wxyz, sizeof q);
    memcpy(d->q_cam_tool_wxyz, q, sizeof q);
}

static double rotation_residual(double rms_alt, double turn, bool true_is_second, double arm_off)
{
    given_world();
    s_rms_alt = rms_alt;
    s_turn = turn;
    s_true_is_second = true_is_second;
    world.spoil = flip;
    world.truth.joint[6].phi_rad = arm_off;
    world.config.servo_steps_max = 0u;
    world_started();
    (void)world_until_event(KC_EVT_CAL_POSE, 300u);
    return world.progress[0].res_rot_rad;
}

void test_of_two_solutions_that_fit_the_one_the_model_expects_is_taken(void)
{
    TEST_ASSERT_DOUBLE_WITHIN(0.01, 0.0, rotation_residual(0.35, 0.8, false, 0.0));
    TEST_ASSERT_DOUBLE_WITHIN(0.01, 0.0, rotation_residual(0.35, 0.8, true, 0.0));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.35, world.meas[0].det.rms_px);
}

/* ---- servo ---- */

void test_when_a_step_hides_the_tags_it_returns_to_the_last_detection(void)
{
    world.truth.joint[6].phi_rad = 0.4;
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_SERVO, 300u));
    double there[KC_JOINT_MAX];
    memcpy(there, world.q, sizeof there);
    memcpy(world.q_start, world.q, sizeof there);
    world.hide_beyond = 0.05; /* whatever the servo does from here, the tags are out of sight */
    TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 300u));
    for (uint32_t j = 0u; j < 7u; j++) { TEST_ASSERT_DOUBLE_WITHIN(1e-9, there[j], world.q[j]); }
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_SERVO_LIMIT));
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_CAL_CAND_SKIPPED));
}

void test_when_the_corrected_joints_show_nothing_the_seed_is_tried(void)
{
    double seed[KC_JOINT_MAX];
    world_started();
    TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_POSE, 300u));
    APP->latest.coef[24] = 0.9; /* a correction that is wrong: joint 7 would go far from the seed */
    APP->latest.res.pos_m = 0.0;
    world_tick();
    TEST_ASSERT_EQUAL_INT(1, APP->cal.candidate);
    kc_path_joints(&kc_app_active(APP)->space, KC_HUB_MAX + 1u, seed);
    memcpy(world.q_start, seed, sizeof seed);
    world.hide_beyond = 0.3; /* in view only near the seed */
    world.config.servo_steps_max = 0u;
    TEST_ASSERT_TRUE(world_until(KC_ST_SEED, 300u));
    TEST_ASSERT_TRUE(fabs(world.q[6] - seed[6]) > 0.5);
    for (uint32_t j = 0u; j < 7u; j++) { TEST_ASSERT_EQUAL_DOUBLE(seed[j], world.arm_cmd.q[j]); }
    TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 300u));
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_CAL_CAND_SKIPPED));
}

/* ---- search ---- */

void test_tags_out_of_view_are_found_by_turning_the_pantilt_unit(void)
{
    world.truth.joint[0].phi_rad = 0.35; /* the tool is some 20 degrees from where it is expected */
    world.view_rad = 0.17;
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_SEARCH, 300u));
    TEST_ASSERT_TRUE(world_until(KC_ST_AIM, 300u) || kc_app_state(APP) == KC_ST_SETTLE);
    TEST_ASSERT_TRUE(APP->observe.i_search > 0u);
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_CAL_TAGS_LOST));
    TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 600u));
}

/* Two retries of CONFIG for the observation, and two more for the measurement. */
void test_a_measurement_has_all_its_retries(void)
{
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_OBSERVE, 300u));
    world.camera_silent = true;
    for (uint32_t i = 0u; i < 2u; i++) { TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_FRAME_TIMEOUT, 50u)); }
    world.camera_silent = false;
    TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 50u));
    world.camera_silent = true;
    for (uint32_t i = 0u; i < 2u; i++) {
        TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_FRAME_TIMEOUT, 50u));
        TEST_ASSERT_EQUAL_INT(KC_ST_MEASURE, kc_app_state(APP));
    }
    TEST_ASSERT_TRUE(world_until(KC_ST_SAFE, 50u));
    TEST_ASSERT_EQUAL_UINT32(5u, world_events(KC_EVT_CAL_FRAME_TIMEOUT));
}

void test_a_pantilt_unit_that_stops_in_the_search_ends_it(void)
{
    world.config.move_timeout_us = 5000000u;
    world.hide = 1000;
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_SEARCH, 300u));
    world.pantilt_frozen = true;
    TEST_ASSERT_TRUE(world_until(KC_ST_SAFE, 300u));
    TEST_ASSERT_EQUAL_DOUBLE((double)KC_CAUSE_PANTILT_LATE, world.last[KC_EVT_CAL_ABORTED].got);
}

/* ---- observations on the way ---- */

static void given_a_turned_tool(void)
{
    given_world();
    world.truth.joint[6].phi_rad = 0.4;
    world.config.extra_obs_max = 1u;
}

static void measured_once(void)
{
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_UPDATE, 600u));
    TEST_ASSERT_EQUAL_UINT32(1u, APP->plan.n_meas);
    TEST_ASSERT_EQUAL_UINT32(world.n_meas, APP->plan.n_obs);
    TEST_ASSERT_EQUAL_UINT32(world.n_meas, APP->est.n_obs);
    TEST_ASSERT_EQUAL_INT(KC_AT_CANDIDATE, world.meas[world.n_meas - 1u].taken_at);
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_CAL_CAND_SKIPPED));
}

static double tool_turn(const kc_meas_t *a, const kc_meas_t *b)
{
    return kc_quat_dist_rad(a->obs.q_wxyz, b->obs.q_wxyz);
}

void test_where_the_arm_arrives_it_observes_before_the_servo_moves(void)
{
    given_a_turned_tool();
    double seed[KC_JOINT_MAX];
    measured_once();
    TEST_ASSERT_EQUAL_UINT32(2u, world.n_meas);
    const kc_meas_t *m = &world.meas[0];
    kc_path_joints(&kc_app_active(APP)->space, KC_HUB_MAX, seed);
    for (uint32_t j = 0u; j < 7u; j++) { TEST_ASSERT_DOUBLE_WITHIN(1e-3, seed[j], m->arm.q[j]); }
    TEST_ASSERT_EQUAL_INT(KC_AT_ARRIVAL, m->taken_at);
    TEST_ASSERT_EQUAL_UINT32(3u, m->n_frames);
    for (uint32_t i = 0u; i < 2u; i++) {
        TEST_ASSERT_EQUAL_UINT32(1u, world.meas[i].pose);
        TEST_ASSERT_EQUAL_UINT32(i + 1u, world.meas[i].observation);
        TEST_ASSERT_EQUAL_INT(0, world.meas[i].candidate);
    }
    TEST_ASSERT_DOUBLE_WITHIN(0.05, 0.4, tool_turn(m, &world.meas[1]));
}

static bool s_uncertain_once;

static void uncertain_at_first(kc_detection_t *d)
{
    if (kc_app_state(APP) == KC_ST_MEASURE && APP->observe.taken_at == KC_AT_ARRIVAL) {
        d->cov[0] = 1.0;
        s_uncertain_once = true;
    }
}

void test_an_arrival_that_cannot_be_measured_costs_no_candidate(void)
{
    given_a_turned_tool();
    s_uncertain_once = false;
    world.spoil = uncertain_at_first;
    measured_once();
    TEST_ASSERT_TRUE(s_uncertain_once);
    TEST_ASSERT_EQUAL_UINT32(1u, world.n_meas);
    TEST_ASSERT_EQUAL_UINT32(1u, world.meas[0].observation);
}

void test_an_arm_that_moves_while_it_observes_on_arrival_is_observed_again_there(void)
{
    given_a_turned_tool();
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 300u));
    world.arm_vibrates = 2;
    TEST_ASSERT_TRUE(world_until(KC_ST_REST, 10u));
    TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 100u));
    TEST_ASSERT_EQUAL_INT(KC_AT_ARRIVAL, APP->observe.taken_at);
    TEST_ASSERT_TRUE(world_until(KC_ST_SERVO, 100u));
    TEST_ASSERT_EQUAL_UINT32(1u, world.n_meas);
}

void test_a_pose_that_is_measured_where_an_extra_observation_was_takes_its_place(void)
{
    given_a_turned_tool();
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_SERVO, 300u));
    TEST_ASSERT_EQUAL_UINT32(1u, APP->est.n_obs);
    memcpy(world.q_start, world.q, sizeof world.q_start);
    world.hide_beyond = 0.05; /* whatever the servo does from here, the tags are out of sight */
    TEST_ASSERT_TRUE(world_until(KC_ST_RETREAT, 300u));
    TEST_ASSERT_EQUAL_UINT32(1u, APP->est.n_obs);
    TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 300u));
    TEST_ASSERT_EQUAL_UINT32(0u, APP->est.n_obs);
    TEST_ASSERT_TRUE(world_until(KC_ST_UPDATE, 300u));
    TEST_ASSERT_EQUAL_UINT32(1u, APP->est.n_obs);
    TEST_ASSERT_EQUAL_UINT32(1u, APP->plan.n_obs);
    TEST_ASSERT_EQUAL_UINT32(2u, world.n_meas);
    for (uint32_t i = 0u; i < 2u; i++) { TEST_ASSERT_EQUAL_UINT32(1u, world.meas[i].observation); }
    TEST_ASSERT_EQUAL_INT(KC_AT_CANDIDATE, world.meas[1].taken_at);
    TEST_ASSERT_EQUAL_UINT8(KC_AT_CANDIDATE, APP->plan.taken_at[0]);
    world_ticks(50u);
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_MEMORY_OBSERVATIONS));
}

/* The extra observation there failed: then the one before it is not touched. */
void test_a_pose_that_is_measured_where_an_extra_observation_failed_takes_no_place(void)
{
    given_a_turned_tool();
    world.spoil = uncertain_at_first;
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_SERVO, 300u));
    memcpy(world.q_start, world.q, sizeof world.q_start);
    world.hide_beyond = 0.05;
    TEST_ASSERT_TRUE(world_until(KC_ST_UPDATE, 300u));
    TEST_ASSERT_EQUAL_UINT32(1u, APP->est.n_obs);
    TEST_ASSERT_EQUAL_UINT32(1u, APP->plan.n_obs);
    TEST_ASSERT_EQUAL_UINT32(1u, world.n_meas);
}
