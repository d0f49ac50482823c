/* kc_move.c: verified paths, pan-tilt unit, rest; arm or pan-tilt unit that ignore commands. */
#include <math.h>
#include <string.h>

#include "given_world.h"
#include "kc_guard.h"
#include "unity.h"

#define APP (&kc_app_instance)

static double s_target[KC_JOINT_MAX];

void setUp(void)
{
    given_world();
    world.config.move_timeout_us = 5000000u;
}

static double distance(const double *a, const double *b)
{
    double d = 0.0;
    for (uint32_t j = 0u; j < 7u; j++) { d = fmax(d, fabs(a[j] - b[j])); }
    return d;
}

void test_the_arm_goes_over_seeds_of_verified_nodes_only(void)
{
    double q[KC_JOINT_MAX];
    world.truth.joint[6].phi_rad = 0.3;
    world_started();
    for (uint32_t i = 0u; i < 3000u && world_calibrating(); i++) {
        if (world.out.has_arm_cmd && kc_app_state(APP) == KC_ST_MOVE && APP->move.i_path < APP->move.n_path) {
            kc_path_joints(&kc_app_active(APP)->space, APP->move.path[APP->move.i_path], q);
            TEST_ASSERT_TRUE(distance(q, world.arm_cmd.q) < 1e-12);
        }
        world_tick();
    }
    TEST_ASSERT_TRUE(world.n_meas > 3u);
}

void test_every_command_at_a_candidate_stays_on_the_servo_bound(void)
{
    double seed[KC_JOINT_MAX];
    world.truth.joint[6].phi_rad = 0.6;
    world.config.servo.bound = 0.2;
    world_started();
    for (uint32_t i = 0u; i < 3000u && world_calibrating(); i++) {
        if (world.out.has_arm_cmd &&
            (kc_app_state(APP) == KC_ST_SERVO || APP->move.i_path == APP->move.n_path)) {
            kc_path_joints(&kc_app_active(APP)->space, KC_HUB_MAX + (uint32_t)APP->cal.candidate, seed);
            TEST_ASSERT_TRUE(distance(seed, world.arm_cmd.q) < 0.2 + 1e-9);
        }
        world_tick();
    }
    TEST_ASSERT_TRUE(world_events(KC_EVT_CAL_SERVO_LIMIT) > 0u); /* 0.6 rad are out of its reach */
    TEST_ASSERT_EQUAL_UINT32(6u, world.n_meas);                  /* measured beside the candidate */
}

void test_the_corrected_arm_needs_no_servo_step_in_the_end(void)
{
    world.truth.joint[6].phi_rad = 0.3;
    world.config.n_poses = 8u;
    world_calibrated();
    TEST_ASSERT_TRUE(world.progress[0].servo_steps > 0u);
    TEST_ASSERT_EQUAL_UINT32(0u, world.progress[7].servo_steps);
}

void test_an_arm_that_does_not_arrive_is_held_and_the_calibration_stopped(void)
{
    world.arm_frozen = true;
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_SAFE, 100u));
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_MOVE_TIMEOUT));
    TEST_ASSERT_EQUAL_DOUBLE((double)KC_CAUSE_ARM_LATE, world.last[KC_EVT_CAL_ABORTED].got);
    TEST_ASSERT_EQUAL_INT(1, world.arm_cmd.hold);
}

static void given_a_long_move(void)
{
    given_world();
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_MOVE, 200u));
    for (uint32_t j = 0u; j < world.arm.n_joints; j++) { s_target[j] = world.q_cmd[j]; }
}

static bool at_target(void)
{
    double far = 0.0;
    for (uint32_t j = 0u; j < world.arm.n_joints; j++) { far = fmax(far, fabs(world.q[j] - s_target[j])); }
    return far < 1e-6;
}

/* One packet of a lossy network, and the arm went on to the end of its move although flight was SAFE. */
void test_hold_is_sent_again_while_the_arm_goes_on_to_its_last_target(void)
{
    for (int lost = 1; lost <= 4; lost++) {
        given_a_long_move();
        world.arm_slow = true;
        world.arm_ignores = lost;
        TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_ABORT, 0, 0, 0));
        TEST_ASSERT_TRUE(world.arm_cmd.hold);
        int32_t seq = world.arm_cmd.seq;
        world_ticks(3u * (uint32_t)lost);
        TEST_ASSERT_EQUAL_INT(0, world.arm_ignores);
        TEST_ASSERT_TRUE(world.arm_cmd.hold);
        TEST_ASSERT_EQUAL_INT32(seq + lost, world.arm_cmd.seq);
        TEST_ASSERT_FALSE(at_target());
        world_ticks(60u); /* it obeys: no more of it */
        TEST_ASSERT_EQUAL_INT32(seq + lost, world.arm_cmd.seq);
        TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_ARM_NOT_HELD));
    }
}

/* The last run may have been ended in the middle of a move; its target is forgotten. */
void test_after_a_restart_hold_is_sent_again_while_the_arm_moves(void)
{
    given_a_long_move();
    world_ticks(2u);
    world.arm_slow = true;
    world.arm_ignores = 2;
    world_restart();
    world_tick();
    TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
    TEST_ASSERT_EQUAL_INT(1, world.arm_ignores);
    world_ticks(6u);
    TEST_ASSERT_EQUAL_INT(0, world.arm_ignores);
    TEST_ASSERT_TRUE(world.arm_cmd.hold);
    int32_t seq = world.arm_cmd.seq;
    world_ticks(60u);
    TEST_ASSERT_EQUAL_INT32(seq, world.arm_cmd.seq);
    TEST_ASSERT_FALSE(at_target());
}

/* ---- where it stands ---- */

void test_an_arm_carried_off_between_two_poses_ends_it(void)
{
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_UPDATE, 300u));
    for (uint32_t i = 0u; i < 3u; i++) {
        world.q[i] = world.q_cmd[i] = -1.9;
        world.q[6] = world.q_cmd[6] = 2.9;
    }
    TEST_ASSERT_TRUE(world_until(KC_ST_SAFE, 20u));
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_NO_PATH));
    TEST_ASSERT_EQUAL_DOUBLE((double)KC_CAUSE_NO_PATH, world.last[KC_EVT_CAL_ABORTED].got);
}

/* ---- the guard ---- */

/* A ball around where the candidate's seed puts the tool: only there. */
static uint32_t forbid_prior(uint32_t place)
{
    uint32_t cand = world.space.initial[place];
    kc_volume_t *v = &world.space.volume[world.space.n_volume++];
    *v = (kc_volume_t){KC_VOL_SPHERE, {0.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f}, 0.02f, 0u};
    memcpy(v->p_m, world.space.cand[cand].p_m, sizeof v->p_m);
    return cand;
}

void test_a_candidate_inside_a_volume_is_skipped_before_the_arm_moves(void)
{
    uint32_t cand = forbid_prior(0u);
    world_boot();
    world_tick();
    (void)world_do(KC_CMD_START, -1, 0, 3);
    for (uint32_t i = 0u; i < 400u && APP->plan.usable[cand]; i++) { world_tick(); }
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_GRD_VOLUME));
    TEST_ASSERT_EQUAL_INT(1, world.last[KC_EVT_GRD_VOLUME].index); /* the tool */
    TEST_ASSERT_EQUAL_DOUBLE(2.0, world.last[KC_EVT_GRD_VOLUME].want);
    TEST_ASSERT_TRUE(world.last[KC_EVT_GRD_VOLUME].got > -KC_GUARD_CLEAR_M); /* already too near */
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_CAND_SKIPPED));
    kc_path_joints(&kc_app_active(APP)->space, KC_HUB_MAX + cand, world.q_start);
    TEST_ASSERT_TRUE(distance(world.q_cmd, world.q_start) > 1e-3); /* it never was sent there */
    TEST_ASSERT_TRUE(world_until(KC_ST_REVIEW, 4000u) || kc_app_state(APP) == KC_ST_IDLE);
    TEST_ASSERT_EQUAL_UINT32(6u, world.n_meas); /* others were measured */
    for (uint32_t k = 0u; k < 6u; k++) { TEST_ASSERT_TRUE(world.meas[k].candidate != (int32_t)cand); }
}

/* ---- stops ---- */

/* Candidate 0, on hub 0, has four of them; the arm of the world is off, so that frames tell something. */
static void given_stops(uint32_t stops_max)
{
    static const uint8_t stop[KC_STOP_MAX] = {50u, 100u, 150u, 200u};
    setUp();
    world.truth.joint[6].phi_rad = 0.1;
    world.config.n_poses = 1u;
    world.config.stops_max = stops_max;
    world.space.n_stop = KC_STOP_MAX;
    memcpy(world.space.stop[0], stop, sizeof stop);
}

static void expect_stops(uint32_t n, const uint8_t *stop)
{
    double q[KC_JOINT_MAX];
    TEST_ASSERT_EQUAL_UINT32(n + 1u, world.n_meas);
    for (uint32_t i = 0u; i < n; i++) {
        const kc_meas_t *m = &world.meas[i];
        TEST_ASSERT_EQUAL_INT(KC_AT_STOP, m->taken_at);
        TEST_ASSERT_EQUAL_UINT32(1u, m->pose);
        TEST_ASSERT_EQUAL_UINT32(3u, m->n_frames);
        for (uint32_t j = 0u; j < 7u; j++) {
            q[j] = (double)stop[i] / 256.0 * (double)world.space.cand[0].q_seed[j]; /* hub 0 is at zero */
        }
        TEST_ASSERT_TRUE(distance(q, m->arm.q) < 1e-3);
    }
    TEST_ASSERT_EQUAL_INT(KC_AT_CANDIDATE, world.meas[n].taken_at);
    TEST_ASSERT_EQUAL_UINT32(1u, APP->plan.n_meas);
}

void test_the_arm_observes_at_stops_evenly_those_that_are_allowed(void)
{
    static const uint8_t want[][4] = {{0u}, {150u}, {100u, 200u}, {50u, 150u, 200u}, {50u, 100u, 150u, 200u}};
    for (uint32_t n = 0u; n <= KC_STOP_MAX; n++) {
        given_stops(n);
        world_calibrated();
        expect_stops(n, want[n]);
        TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_GRD_PATH));
    }
    given_stops(KC_STOP_MAX); /* the table has fewer */
    world.space.stop[0][1] = 0u;
    world.space.stop[0][2] = 0u;
    world.space.stop[0][3] = 0u;
    world_calibrated();
    expect_stops(1u, want[4]);
}

void test_the_pantilt_unit_follows_to_a_stop_and_goes_on_with_the_arm(void)
{
    kc_pose_t T;
    double pan = 0.0, tilt = 0.0, q[KC_JOINT_MAX] = {0.0};
    given_stops(1u);
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_MOVE, 50u)); /* to the stop already while the arm sets out */
    for (uint32_t j = 0u; j < 7u; j++) { q[j] = 150.0 / 256.0 * (double)world.space.cand[0].q_seed[j]; }
    kc_view_expect(&APP->view, q, &T);
    (void)kc_camera_aim(&world.camera, T.p_m, &pan, &tilt);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, pan, world.pan_cmd);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, tilt, world.tilt_cmd);
    TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 300u));
    kc_view_expect(&APP->view, world.q, &T);
    (void)kc_camera_aim(&world.camera, T.p_m, &pan, &tilt);
    TEST_ASSERT_DOUBLE_WITHIN(2e-3, pan, world.pan);
    TEST_ASSERT_DOUBLE_WITHIN(2e-3, tilt, world.tilt);
    TEST_ASSERT_TRUE(world_until(KC_ST_MOVE, 100u));
    kc_view_expect(&APP->view, APP->move.q_final, &T);
    (void)kc_camera_aim(&world.camera, T.p_m, &pan, &tilt);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, pan, world.pan_cmd);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, tilt, world.tilt_cmd);
    TEST_ASSERT_FALSE(kc_move_stopped(&APP->move));
}

static void hidden_at_stops(kc_detection_t *d)
{
    if (APP->observe.at_stop) { d->n_tags = 0u; }
}

static void uncertain_at_stops(kc_detection_t *d)
{
    if (APP->observe.at_stop) { d->cov[0] = 1.0; }
}

static void uncertain_in_measurements_at_stops(kc_detection_t *d)
{
    if (APP->observe.at_stop && kc_app_state(APP) == KC_ST_MEASURE) { d->cov[0] = 1.0; }
}

void test_a_stop_that_shows_nothing_is_left_and_costs_no_candidate(void)
{
    void (*spoil[])(kc_detection_t *) = {hidden_at_stops, uncertain_at_stops,
                                         uncertain_in_measurements_at_stops};
    for (uint32_t i = 0u; i < 3u; i++) {
        given_stops(2u);
        world.spoil = spoil[i];
        world_calibrated();
        expect_stops(0u, NULL);
        TEST_ASSERT_EQUAL_INT(0, world.meas[0].candidate);
        TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_CAL_CAND_SKIPPED));
        TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_CAL_TAGS_LOST));
    }
}

void test_an_arm_that_is_stopped_at_a_stop_goes_on_from_there(void)
{
    given_stops(1u);
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 300u));
    (void)world_cmd(KC_CMD_ABORT, 0, 0, 0);
    TEST_ASSERT_TRUE(world_until(KC_ST_SAFE, 20u));
    (void)world_cmd(KC_CMD_START, -1, 0, 0);
    for (uint32_t i = 0u; i < 2000u && kc_app_state(APP) != KC_ST_REVIEW; i++) { world_tick(); }
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_CAL_NO_PATH));
    TEST_ASSERT_EQUAL_UINT32(1u, world.n_proposal);
}

void test_a_move_that_the_guard_refuses_from_a_stop_costs_the_candidate(void)
{
    given_stops(1u);
    world.config.n_poses = 2u;
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 300u));
    world.q[2] += 0.1;
    world.q_cmd[2] += 0.1; /* somebody has moved the arm off the segment */
    TEST_ASSERT_TRUE(world_until_event(KC_EVT_GRD_PATH, 100u));
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_CAND_SKIPPED));
    TEST_ASSERT_EQUAL_INT(0, world.last[KC_EVT_CAL_CAND_SKIPPED].index);
}
