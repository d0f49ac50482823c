/* kc_move.c: verified paths, pan-tilt unit, rest; arm or pan-tilt unit that ignore commands. */
#include <math.h>
#include <string.h>

#include "given_world.h"
#include "kc_guard.h"
#include "unity.h"

#define APP (&kc_app_instance)

static double s_target[KC_JOINT_MAX];

void setUp(void);
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

/* Hub 1 is on the way to candidate 1. */
void test_a_way_point_is_passed_by_an_arm_that_vibrates_and_a_candidate_is_not(void)
{
    world_started();
    TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_POSE, 300u));
    TEST_ASSERT_TRUE(world_until(KC_ST_MOVE, 300u));
    TEST_ASSERT_TRUE(APP->move.n_path > 1u);
    world.arm_vibrates = 40;
    for (uint32_t i = 0u; i < 40u; i++) {
        world_tick();
        TEST_ASSERT_EQUAL_INT(KC_ST_MOVE, kc_app_state(APP));
    }
    TEST_ASSERT_EQUAL_UINT32(APP->move.n_path, APP->move.i_path);
    TEST_ASSERT_TRUE(distance(world.q, APP->move.q_final) < 1e-9);
    TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_POSE, 100u));
}

/* Where the arm says it is, moving, in a message of its own; true if the way point was passed. */
static bool passed(double off, uint64_t t_us)
{
    kc_arm_state_t *arm = &APP->input.telemetry.arm;
    kc_work_t work = kc_work_of_step();
    memcpy(arm->q, APP->move.q_target, sizeof arm->q);
    memcpy(arm->q_cmd, APP->move.q_target, sizeof arm->q_cmd);
    arm->q[0] += off;
    arm->moving = 1u;
    arm->t_us = t_us;
    memset(&world.out, 0, sizeof world.out);
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, kc_move_run(&APP->move, &APP->view, &work, &world.out).id);
    return APP->move.i_path > 0u;
}

void test_an_arm_that_runs_through_a_way_point_is_not_sent_on(void)
{
    world_started();
    TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_POSE, 300u));
    TEST_ASSERT_TRUE(world_until(KC_ST_MOVE, 300u));
    TEST_ASSERT_TRUE(APP->move.n_path > 1u && APP->move.i_path == 0u && !APP->move.checking);
    const double tol = kc_app_active(APP)->config.arrive_tol;
    const uint64_t t = world.now_us;
    TEST_ASSERT_FALSE(passed(0.0, t + 1u));
    TEST_ASSERT_FALSE(passed(0.0, t + 1u)); /* the same message */
    TEST_ASSERT_FALSE(passed(2.0 * tol, t + 2u)); /* it has run through */
    TEST_ASSERT_FALSE(passed(0.5 * tol, t + 3u)); /* and comes back */
    TEST_ASSERT_TRUE(passed(-0.5 * tol, t + 4u));
    TEST_ASSERT_EQUAL_UINT64(0u, APP->move.near_us); /* of the next target nothing is known yet */
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

void test_an_arm_command_that_got_lost_is_sent_again(void)
{
    world_boot();
    world_tick();
    world.arm_ignores = 1;
    (void)world_do(KC_CMD_START, -1, 0, 1);
    int32_t seq = world.arm_cmd.seq;
    world_ticks(12u);
    TEST_ASSERT_EQUAL_INT(seq + 1, world.arm_cmd.seq); /* once, after a second */
    TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 200u));
}

void test_the_arm_moves_as_fast_as_config_says_and_is_held_at_full_speed(void)
{
    world.config.speed_scale = 0.5;
    world_started();
    TEST_ASSERT_EQUAL_INT(0, world.arm_cmd.hold);
    TEST_ASSERT_EQUAL_DOUBLE(0.5, world.arm_cmd.speed_scale);
    (void)world_do(KC_CMD_ABORT, 0, 0, 0);
    TEST_ASSERT_EQUAL_INT(1, world.arm_cmd.hold);
    TEST_ASSERT_EQUAL_DOUBLE(1.0, world.arm_cmd.speed_scale);
}

void test_a_servo_step_that_is_not_done_in_time_ends_it(void)
{
    world.truth.joint[6].phi_rad = 0.3;
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_SERVO, 200u));
    world.arm_frozen = true;
    TEST_ASSERT_TRUE(world_until(KC_ST_SAFE, 100u));
    TEST_ASSERT_EQUAL_DOUBLE((double)KC_CAUSE_ARM_LATE, world.last[KC_EVT_CAL_ABORTED].got);
}

void test_a_pantilt_unit_that_does_not_arrive_ends_it(void)
{
    world.pantilt_frozen = true;
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_SAFE, 300u));
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_MOVE_TIMEOUT));
    TEST_ASSERT_EQUAL_INT(KC_INPUT_PANTILT, world.last[KC_EVT_CAL_MOVE_TIMEOUT].index);
    TEST_ASSERT_EQUAL_DOUBLE((double)KC_CAUSE_PANTILT_LATE, world.last[KC_EVT_CAL_ABORTED].got);
}

void test_a_pantilt_unit_command_that_got_lost_is_sent_again(void)
{
    world.pantilt_ignores = 2; /* the current one and the one on arrival */
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 300u));
    TEST_ASSERT_EQUAL_UINT32(3u, world.n_pantilt_cmd);
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

void test_an_arm_that_does_not_obey_hold_is_reported(void)
{
    given_a_long_move();
    world.arm_slow = true;
    world.arm_ignores = 100;
    (void)world_do(KC_CMD_ABORT, 0, 0, 0);
    int32_t seq = world.arm_cmd.seq;
    world_ticks(29u);
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_ARM_NOT_HELD));
    world_ticks(60u);
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_ARM_NOT_HELD));
    TEST_ASSERT_EQUAL_DOUBLE(3e6, world.last[KC_EVT_ARM_NOT_HELD].got);
    TEST_ASSERT_EQUAL_INT32(seq + 10, world.arm_cmd.seq);
}

/* After an abort somebody else may move the arm: that is not flight's move. */
void test_an_arm_that_somebody_else_moves_is_not_held_again(void)
{
    for (int moved = 0; moved < 2; moved++) {
        given_world();
        if (moved) {
            given_a_long_move();
        } else {
            world_boot(); /* flight has not moved it yet, and knows no target */
            world_ticks(2u);
        }
        (void)world_do(KC_CMD_ABORT, 0, 0, 0);
        world.arm_slow = true;
        int32_t seq = world.arm_cmd.seq;
        for (uint32_t j = 0u; j < world.arm.n_joints; j++) {
            world.q_cmd[j] = moved ? s_target[j] + 0.3 : 0.0;
        }
        world.q_cmd[0] = moved ? world.q_cmd[0] : 0.0;
        world.q[0] += 0.5;
        world_ticks(40u);
        TEST_ASSERT_EQUAL_INT32(seq, world.arm_cmd.seq);
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

/* Someone stops the arm by its controller, without a word to flight: it was sent off again a second later. */
void test_a_move_that_somebody_else_has_stopped_is_not_sent_again(void)
{
    given_a_long_move();
    world.arm_slow = true;
    world_ticks(3u);
    int32_t seq = world.arm_cmd.seq;
    memcpy(world.q_cmd, world.q, sizeof world.q_cmd);
    uint32_t n = 0u;
    for (; n < 4000u && world_calibrating(); n++) {
        TEST_ASSERT_EQUAL_INT32(seq, world.arm_cmd.seq);
        world_tick();
    }
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_MOVE_TIMEOUT));
    TEST_ASSERT_TRUE(world.arm_cmd.hold);
    TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
}

void test_it_waits_until_everything_is_at_rest(void)
{
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_SETTLE, 200u));
    world.arm_vibrates = 7;
    world_ticks(7u);
    TEST_ASSERT_EQUAL_INT(KC_ST_SETTLE, kc_app_state(APP));
    world.pantilt_vibrates = 3;
    world_ticks(3u);
    TEST_ASSERT_EQUAL_INT(KC_ST_SETTLE, kc_app_state(APP));
    TEST_ASSERT_TRUE(world_until(KC_ST_OBSERVE, 3u));
}

void test_what_never_comes_to_rest_ends_it(void)
{
    for (int who = 0; who < 2; who++) {
        given_world();
        world.config.move_timeout_us = 5000000u;
        world_started();
        TEST_ASSERT_TRUE(world_until(KC_ST_SETTLE, 200u));
        world.arm_vibrates = who == 0 ? 1000 : 0;
        world.pantilt_vibrates = who == 1 ? 1000 : 0;
        TEST_ASSERT_TRUE(world_until(KC_ST_SAFE, 100u));
        TEST_ASSERT_EQUAL_DOUBLE(who == 0 ? (double)KC_CAUSE_ARM_LATE : (double)KC_CAUSE_PANTILT_LATE,
                                 world.last[KC_EVT_CAL_ABORTED].got);
    }
}

/* ---- where it stands ---- */

void test_it_is_at_a_node_within_its_bound_and_goes_to_its_seed_first(void)
{
    double dist = 0.0, seed[KC_JOINT_MAX];
    kc_path_joints(&world.space, KC_HUB_MAX + 5u, seed);
    memcpy(world.q, seed, sizeof seed);
    world.q[0] += 0.2; /* 0.2 rad beside candidate 5 */
    memcpy(world.q_cmd, world.q, sizeof world.q);
    world_boot();
    world_tick();
    TEST_ASSERT_EQUAL_UINT32(KC_HUB_MAX + 5u, kc_move_node(&APP->move, &APP->view, &dist));
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.2 / (1.5 + world.config.arrive_tol), dist); /* in bounds */
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_START, -1, 0, 1));
    TEST_ASSERT_EQUAL_DOUBLE_ARRAY(seed, world.arm_cmd.q, world.arm.n_joints);
    TEST_ASSERT_EQUAL_UINT16(KC_HUB_MAX + 5u, APP->move.path[0]);
}

void test_outside_the_hub_bound_it_is_at_no_node_even_within_the_servo_bound(void)
{
    double dist = 0.0;
    world.config.servo.bound = 0.1; /* candidates are far from here */
    world.q[1] = world.q_cmd[1] = 0.06;
    world_boot();
    world_tick();
    TEST_ASSERT_EQUAL_UINT32(KC_NODE_NONE, kc_move_node(&APP->move, &APP->view, &dist));
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.06 / KC_HUB_BOUND, dist);
    TEST_ASSERT_NOT_EQUAL(KC_OK, world_do(KC_CMD_START, -1, 0, 1));
}

/* With 1 rad, which CONFIG took, an arm anywhere near the park pose was at it, and START moved it on a straight line that
 * nobody had verified, to a local initial pose even without a check of its clearance. */
void test_no_config_lets_an_arm_beside_its_paths_start(void)
{
    static const double tol[] = {1e-3, 0.01, 0.02, 0.1, 1.0};
    for (uint32_t i = 0u; i < sizeof tol / sizeof tol[0]; i++) {
        for (uint32_t k = 0u; k < 2u; k++) {
            setUp();
            world.config.servo.bound = 0.05;
            world.config.arrive_tol = tol[i];
            world.q[1] = world.q_cmd[1] = 0.08; /* beside the park pose */
            if (k == 1u) { world.q[0] = world.q_cmd[0] = 0.25; /* or beside a segment */ }
            world_boot();
            world_ticks(2u);
            TEST_ASSERT_NOT_EQUAL(KC_OK, world_do(KC_CMD_START, -1, 0, 1));
            TEST_ASSERT_EQUAL_INT(tol[i] > 0.01 ? KC_EVT_TBL_MISSING : KC_EVT_CAL_NO_PATH,
                                  world.ack.event_id);
            TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_CAL_START));
        }
    }
}

void test_on_no_segment_it_stands_nowhere(void)
{
    double dist = 0.0;
    world.config.servo.bound = 0.05;
    world_boot();
    world_tick();
    APP->input.telemetry.arm.q[0] = 0.25; /* half way from hub 0 to hub 1, but for joint 4 */
    APP->move.seg_from = 0u;
    APP->move.seg_to = 1u;
    TEST_ASSERT_EQUAL_UINT32(KC_NODE_NONE, kc_move_node(&APP->move, &APP->view, &dist));
    APP->input.telemetry.arm.q[3] = 0.5;
    TEST_ASSERT_EQUAL_UINT32(1u, kc_move_node(&APP->move, &APP->view, &dist));
    /* Forgotten or unusable: the table still knows the segment, and leads to its lower end. */
    APP->move.seg_to = KC_HUB_MAX + 1000u; /* a candidate that there is not */
    TEST_ASSERT_EQUAL_UINT32(0u, kc_move_node(&APP->move, &APP->view, &dist));
    APP->move.seg_to = 0u; /* no length */
    TEST_ASSERT_EQUAL_UINT32(0u, kc_move_node(&APP->move, &APP->view, &dist));
    APP->move.seg_from = 7u; /* a hub that there is not */
    TEST_ASSERT_EQUAL_UINT32(0u, kc_move_node(&APP->move, &APP->view, &dist));
}

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

void test_a_candidate_without_a_verified_path_is_skipped(void)
{
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_UPDATE, 300u));
    /* tables are validated, so this takes a change behind their back */
    memset(APP->tables.active.space.hub_edge, 0, sizeof APP->tables.active.space.hub_edge);
    memset(APP->tables.active.space.edge, 0, sizeof APP->tables.active.space.edge);
    TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_NO_PATH, 20u));
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_CAND_SKIPPED));
    TEST_ASSERT_TRUE(world_calibrating());
}

void test_the_pantilt_unit_is_never_sent_beyond_its_limits(void)
{
    world_boot();
    world_tick();
    memset(&world.out, 0, sizeof world.out);
    kc_pantilt_turn(&APP->pantilt, &APP->view, &world.out, 3.0, -3.0);
    TEST_ASSERT_EQUAL_DOUBLE(1.6, world.out.pantilt_cmd.pan_rad);
    TEST_ASSERT_EQUAL_DOUBLE(-0.6, world.out.pantilt_cmd.tilt_rad);
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

void test_a_candidate_in_self_collision_is_skipped_before_the_arm_moves(void)
{
    uint32_t cand = world.space.initial[0];
    world.space.n_body =
        4u; /* tool and a ball about joint 4 that reaches it at the candidate, not at the hub */
    world.space.body[2] = (kc_body_t){4u, {0.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f}, 0.01f, 0u};
    world.space.body[3] = (kc_body_t){0u, {0.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f}, 0.45f, 4u};
    world_boot();
    world_tick();
    (void)world_do(KC_CMD_START, -1, 0, 3);
    for (uint32_t i = 0u; i < 400u && APP->plan.usable[cand]; i++) { world_tick(); }
    TEST_ASSERT_TRUE(world_events(KC_EVT_GRD_SELF) >= 1u);
    TEST_ASSERT_EQUAL_INT(3, world.last[KC_EVT_GRD_SELF].index);
    TEST_ASSERT_EQUAL_DOUBLE(2.0, world.last[KC_EVT_GRD_SELF].want);
    TEST_ASSERT_TRUE(world.last[KC_EVT_GRD_SELF].got > -KC_GUARD_CLEAR_M);
    TEST_ASSERT_EQUAL_UINT32(world_events(KC_EVT_GRD_SELF), world_events(KC_EVT_CAL_CAND_SKIPPED));
    TEST_ASSERT_EQUAL_UINT32(0u, world.n_meas);
    kc_path_joints(&kc_app_active(APP)->space, KC_HUB_MAX + cand, world.q_start);
    TEST_ASSERT_TRUE(distance(world.q_cmd, world.q_start) > 1e-3); /* it never was sent there */
}

void test_a_hub_too_near_to_a_limit_is_refused_with_its_joint(void)
{
    world.space.hub_q[0][3] = (float)world.arm.joint[3].q_max - 0.001f;
    world.config.servo.margin = 0.05;
    memset(world.space.edge, 0, sizeof world.space.edge);
    for (uint32_t j = 0u; j < 7u; j++) { world.q[j] = world.q_cmd[j] = (double)world.space.hub_q[1][j]; }
    world_started();
    for (uint32_t i = 0u; i < 4000u && world_calibrating(); i++) { world_tick(); }
    TEST_ASSERT_TRUE(world_events(KC_EVT_GRD_LIMIT) > 0u);
    TEST_ASSERT_EQUAL_INT(4, world.last[KC_EVT_GRD_LIMIT].index);
    TEST_ASSERT_DOUBLE_WITHIN(2e-6, world.arm.joint[3].q_max - 0.05, world.last[KC_EVT_GRD_LIMIT].want);
    TEST_ASSERT_DOUBLE_WITHIN(2e-6, (double)world.space.hub_q[0][3], world.last[KC_EVT_GRD_LIMIT].got);
}

/* Commands that the component should never send. */
static void refused_path(uint32_t from, uint32_t to, double off)
{
    double q[KC_JOINT_MAX];
    int32_t seq = APP->move.seq;
    memset(&world.out, 0, sizeof world.out);
    kc_path_joints(&kc_app_active(APP)->space, to, q);
    q[0] += q[0] > 0.0 ? -off : off;
    kc_work_t work = kc_work_of_step();
    /* a check of another move that was broken off, and had found nothing */
    APP->move.checking = true;
    APP->move.check = (kc_guard_job_t){.verdict = KC_GUARD_OK, .over = true};
    kc_outcome_t oc = kc_move_send(&APP->move, &APP->view, &work, &world.out, from, to, q);
    TEST_ASSERT_EQUAL_INT(KC_OC_SKIP, oc.id);
    TEST_ASSERT_EQUAL_INT(seq, APP->move.seq);
    TEST_ASSERT_EQUAL_UINT32(0u, world.out.has_arm_cmd);
    TEST_ASSERT_EQUAL_UINT32(1u, world.out.events.n);
    TEST_ASSERT_EQUAL_INT(KC_EVT_GRD_PATH, world.out.events.e[0].id);
    if (from == to) {
        TEST_ASSERT_EQUAL_INT(KC_OC_SKIP, kc_move_near(&APP->move, &APP->view, &work, &world.out, q).id);
    }
}

void test_what_is_not_verified_is_not_sent(void)
{
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 300u));
    uint32_t at = KC_HUB_MAX + (uint32_t)APP->cal.candidate;
    refused_path(at, at, 1.6); /* beyond the box of 1.5 */
    refused_path(at, 1u - kc_app_active(APP)->space.cand[APP->cal.candidate].hub, 0.0); /* not its hub */
    refused_path(at, at, 1.6);
}

void test_a_refused_waypoint_skips_the_candidate(void)
{
    world_started();
    TEST_ASSERT_EQUAL_INT(KC_ST_MOVE, kc_app_state(APP));
    APP->tables.active.config.servo.margin = 10.0; /* no joint has that margin */
    world_seal(KC_TBL_CONFIG);
    TEST_ASSERT_TRUE(world_until(KC_ST_SELECT, 300u));
    TEST_ASSERT_TRUE(world_events(KC_EVT_GRD_LIMIT) >= 1u); /* others are tried */
    TEST_ASSERT_TRUE(world_events(KC_EVT_CAL_CAND_SKIPPED) >= 1u);
    TEST_ASSERT_EQUAL_UINT32(0u, world.n_meas);
}

/* Somebody moves the arm out of the candidate's box while a frame is waited for. */
static void pushed_while_looking(void)
{
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_OBSERVE, 300u));
    world.q[0] += 1.8;
    world.q_cmd[0] += 1.8;
}

/* Any next move begins where nothing is verified: nothing is sent, the candidate is skipped. */
static void expect_nothing_sent(void)
{
    int32_t seq = APP->move.seq;
    for (uint32_t i = 0u; i < 300u && world_events(KC_EVT_GRD_PATH) == 0u; i++) {
        TEST_ASSERT_EQUAL_INT(seq, APP->move.seq);
        world_tick();
    }
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_GRD_PATH));
    TEST_ASSERT_EQUAL_INT(1, world.last[KC_EVT_GRD_PATH].index);
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_CAND_SKIPPED));
    TEST_ASSERT_EQUAL_UINT32(0u, world.n_meas);
}

void test_a_servo_step_from_outside_the_box_is_refused(void)
{
    pushed_while_looking();
    expect_nothing_sent();
}

void test_a_move_to_the_seed_from_outside_the_bound_is_refused(void)
{
    world.hide = 1000;
    pushed_while_looking();
    expect_nothing_sent();
}

void test_a_move_back_from_outside_the_bound_is_refused(void)
{
    world.truth.joint[6].phi_rad = 0.6;
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_SERVO, 300u));
    TEST_ASSERT_TRUE(world_until(KC_ST_OBSERVE, 300u));
    world.hide = 1000;
    world.q[0] += 1.8;
    world.q_cmd[0] += 1.8;
    expect_nothing_sent();
}

void test_an_approach_from_outside_the_box_is_refused(void)
{
    world.config.approach_rad = 0.05;
    world.config.servo.tol_pos_m = 1.0; /* near enough wherever it stands */
    world.config.servo.tol_rot_rad = 3.2;
    pushed_while_looking();
    expect_nothing_sent();
}

void test_a_replicate_without_a_verified_path_to_its_hub_is_skipped(void)
{
    world.space.n_initial = 2u;
    world.config.replicate_every = 2u;
    world_started();
    TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_POSE, 300u));
    TEST_ASSERT_TRUE(world_until(KC_ST_UPDATE, 300u)); /* the second; it hangs on the other hub */
    memset(APP->tables.active.space.hub_edge, 0, sizeof APP->tables.active.space.hub_edge);
    memset(APP->tables.active.space.edge, 0, sizeof APP->tables.active.space.edge);
    world_seal(KC_TBL_SPACE);
    TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_NO_PATH, 20u));
    TEST_ASSERT_EQUAL_INT(1, APP->cal.replicate);
    TEST_ASSERT_EQUAL_INT(0, world.last[KC_EVT_CAL_NO_PATH].index);
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_CAND_SKIPPED));
    TEST_ASSERT_TRUE(world_calibrating());
}

/* ---- each joint by itself ---- */

static uint32_t s_joint;
static bool s_echo; /* or the reading */

static void off(kc_in_t *in)
{
    if (in->has_arm == 0u) { return; }
    (s_echo ? in->arm.q_cmd : in->arm.q)[s_joint] += 0.01;
}

/* An arm that echoes another target, or stands beside its own, in any one joint has not arrived. */
void test_every_joint_has_to_echo_and_to_arrive(void)
{
    for (uint32_t i = 0u; i < 14u; i++) {
        setUp();
        s_joint = i % 7u;
        s_echo = i < 7u;
        world_started();
        TEST_ASSERT_EQUAL_INT(KC_ST_MOVE, kc_app_state(APP));
        world.spoil_in = off;
        TEST_ASSERT_FALSE(world_until(KC_ST_AIM, 200u));
        TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_MOVE_TIMEOUT));
    }
}

/* To where the tool is expected, shifted along one axis. */
void test_the_pantilt_unit_is_aimed_at_the_shifted_tool(void)
{
    static kc_out_t out;
    world_started();
    for (uint32_t axis = 0u; axis < 3u; axis++) {
        kc_pose_t T;
        double off_m[3] = {0.0}, pan = 0.0, tilt = 0.0, pan0 = 0.0, tilt0 = 0.0;
        const kc_camera_t *c = &kc_app_active(APP)->camera;
        off_m[axis] = 0.05;
        kc_view_expect(&APP->view, world.q, &T);
        (void)kc_camera_aim(c, T.p_m, &pan0, &tilt0);
        T.p_m[axis] += 0.05;
        (void)kc_camera_aim(c, T.p_m, &pan, &tilt);
        TEST_ASSERT_TRUE(fabs(pan - pan0) + fabs(tilt - tilt0) > 1e-3);
        APP->pantilt.pan_rad = 1.0; /* so that it turns */
        kc_pantilt_aim(&APP->pantilt, &APP->view, &out, world.q, off_m);
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, pan, out.pantilt_cmd.pan_rad);
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, tilt, out.pantilt_cmd.tilt_rad);
    }
}

void test_a_tool_near_the_middle_of_the_image_needs_no_turn(void)
{
    static kc_out_t out;
    static const double none[3] = {0.0},
                        off[][2] = {{0.0, 0.0}, {0.99, 0.0}, {0.0, -0.99}, {1.01, 0.0}, {0.0, -1.01}};
    kc_pose_t T;
    double pan = 0.0, tilt = 0.0;
    world_started();
    kc_view_expect(&APP->view, world.q, &T);
    (void)kc_camera_aim(&kc_app_active(APP)->camera, T.p_m, &pan, &tilt);
    kc_camera_t *c = &APP->tables.active.camera;
    for (uint32_t i = 0u; i < 15u; i++) { /* 1/40 of the view: of its height, of its width, of a long lens */
        const uint32_t width = i < 5u ? 1920u : 540u;
        const double f = i < 10u ? 1397.0 : 13970.0, most = (i < 5u ? 1080.0 : 540.0) / f / 40.0;
        c->width_px = width;
        c->fx_px = c->fy_px = f;
        memset(&out, 0, sizeof out);
        APP->pantilt.pan_rad = pan + most * off[i % 5u][0];
        APP->pantilt.tilt_rad = tilt + most * off[i % 5u][1];
        kc_pantilt_aim(&APP->pantilt, &APP->view, &out, world.q, none);
        TEST_ASSERT_EQUAL_UINT8(i % 5u < 3u ? 0u : 1u, out.has_pantilt_cmd);
    }
}

/* With as many joints and terms as there may be, each with two functions and loads, the move is a unit of one step. */
void test_the_joints_of_a_move_are_charged_with_less_than_a_step(void)
{
    world_started();
    kc_active_t *a = &APP->tables.active;
    a->arm.n_joints = KC_JOINT_MAX;
    a->terms.n_term = KC_TERM_MAX;
    for (uint32_t k = 0u; k < KC_TERM_MAX; k++) {
        a->terms.term[k] = (kc_term_t){.gain = 1.0};
        a->terms.term[k].basis[0] = (kc_basis_t){.fn = KC_FN_SIN, .var = KC_VAR_TAU, .index = 1u, .c1 = 1.0};
        a->terms.term[k].basis[1] = a->terms.term[k].basis[0];
    }
    a->terms.coef[0].enabled = 1u;
    const uint64_t cost = kc_move_begin_cost(&APP->view);
    TEST_ASSERT_TRUE(cost > KC_STEP_WORK / 2u && cost <= KC_STEP_WORK);
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

void test_without_room_for_observations_the_arm_does_not_stop(void)
{
    given_stops(4u);
    world.config.n_poses = 8u;
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 300u));
    TEST_ASSERT_TRUE(APP->observe.at_stop);
    APP->plan.n_goal = KC_MEAS_MAX;
    TEST_ASSERT_TRUE(world_until(KC_ST_UPDATE, 600u));
    TEST_ASSERT_EQUAL_UINT32(2u, world.n_meas);
}

/* Candidate 2 has a direct segment from candidate 0: there the stops of its hub's segment are not. */
void test_stops_belong_to_the_segment_from_the_hub(void)
{
    given_stops(4u);
    world.config.n_poses = 3u;
    memset(world.space.stop[0], 0, sizeof world.space.stop[0]);
    world.space.initial[1] = 2u;
    world.space.initial[2] = 1u;
    world.space.stop[2][0] = 100u;
    world_calibrated();
    TEST_ASSERT_EQUAL_UINT32(3u, world.n_meas);
    TEST_ASSERT_EQUAL_INT(2, world.meas[1].candidate);
}

void test_an_arm_beside_its_hub_goes_there_first_and_stops_then(void)
{
    static const uint8_t want[] = {150u};
    given_stops(1u);
    world.q[2] = world.q_cmd[2] = 0.03;
    world_calibrated();
    expect_stops(1u, want);
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_GRD_PATH));
}

void test_a_replicate_repeats_the_pose_without_its_stops(void)
{
    given_stops(1u);
    world.config.n_poses = 4u;
    world.config.replicate_every = 3u;
    world_calibrated();
    TEST_ASSERT_EQUAL_INT(1, world.meas[4].replicate);
    TEST_ASSERT_EQUAL_INT(0, world.meas[4].candidate);
    TEST_ASSERT_EQUAL_UINT32(5u, world.n_meas); /* one stop, at the first time */
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
