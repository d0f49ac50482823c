/* kc_observe.c: where each frame leads, call by call: servo, extra observations, seed, way back, search. */
#include "kc_observe.h"

#include <math.h>
#include <string.h>

#include "given_parts.h"
#include "kc_move.h"
#include "kc_rot.h"
#include "unity.h"

#define CAND 4u

static kc_observe_t s_observe;
static kc_request_t s_request;
static kc_pantilt_t s_pantilt;
static kc_arm_t s_true; /* the arm as it is */
static kc_config_t *s_config;
static kc_camera_t *s_camera;
static double s_seed[KC_JOINT_MAX];

/* A good arm at the seed of a candidate. */
void setUp(void)
{
    given_parts();
    s_config = &parts.tables.active.config;
    s_camera = &parts.tables.active.camera;
    s_true = parts.tables.active.arm;
    s_config->frame_retries = 0u;
    parts.cal.candidate = (int32_t)CAND;
    parts.plan.n_goal = 6u;
    parts.telemetry.arm.n_joints = 7u;
    kc_view_seed(&parts.view, s_seed);
    memcpy(parts.telemetry.arm.q, s_seed, sizeof s_seed);
    memset(&s_request, 0, sizeof s_request);
    kc_observe_begin(&s_observe);
}

/* OBSERVE with what came of its frame. */
static kc_outcome_id_t with(kc_frame_t frame)
{
    memset(&parts.out, 0, sizeof parts.out);
    s_request.frame = frame == KC_FRAME_TIMEOUT ? KC_FRAME_AWAITED : frame;
    s_request.asked_us = frame == KC_FRAME_TIMEOUT ? 0u : PARTS_NOW_US;
    kc_outcome_t oc = kc_observe_run(&s_observe, &s_request, &parts.view, &parts.out);
    TEST_ASSERT_TRUE(oc.id != KC_OC_ABORT || oc.cause == KC_CAUSE_CAMERA);
    return oc.id;
}

/* The frame shows the tool where the true arm has it, whose joint 7 is off by phi_rad. */
static kc_outcome_id_t shown(double phi_rad)
{
    s_true.joint[6].phi_rad = parts.tables.active.arm.joint[6].phi_rad + phi_rad;
    given_detection(&s_true, parts.telemetry.arm.q, 0.0, &s_request.det);
    return with(KC_FRAME_DETECTED);
}

static double turned_rad(const kc_pose_t *one, const kc_pose_t *two)
{
    double r[6];
    kc_pose_residual(one, two, r);
    return sqrt(r[3] * r[3] + r[4] * r[4] + r[5] * r[5]);
}

/* ---- frames ---- */

void test_what_comes_of_a_frame_at_a_candidate_in_a_search_and_at_a_stop(void)
{
    static const struct {
        kc_frame_t frame;
        kc_outcome_id_t here, search, at_stop;
    } cases[] = {{KC_FRAME_AWAITED, KC_OC_STAY, KC_OC_STAY, KC_OC_STAY},
                 {KC_FRAME_NO_TAGS, KC_OC_SEARCH, KC_OC_SEARCH, KC_OC_ONWARD},
                 {KC_FRAME_UNCERTAIN, KC_OC_SKIP, KC_OC_SEARCH, KC_OC_ONWARD},
                 {KC_FRAME_TIMEOUT, KC_OC_ABORT, KC_OC_ABORT, KC_OC_ABORT},
                 {KC_FRAME_DETECTED, KC_OC_SERVO, KC_OC_DONE, KC_OC_MEASURE}};
    for (uint32_t i = 0u; i < 5u; i++) {
        setUp();
        (void)shown(0.4);
        kc_observe_begin(&s_observe);
        TEST_ASSERT_EQUAL_INT(cases[i].here, with(cases[i].frame));
        s_request.frame = cases[i].frame == KC_FRAME_TIMEOUT ? KC_FRAME_AWAITED : cases[i].frame;
        kc_outcome_t oc = kc_observe_search(&s_observe, &s_request, &parts.view, &parts.out);
        TEST_ASSERT_EQUAL_INT(cases[i].search, oc.id);
        TEST_ASSERT_TRUE(oc.id != KC_OC_ABORT || oc.cause == KC_CAUSE_CAMERA);
        kc_observe_begin(&s_observe);
        kc_observe_at_stop(&s_observe, true);
        s_request.fails = 7u;
        TEST_ASSERT_EQUAL_INT(cases[i].at_stop, with(cases[i].frame));
        TEST_ASSERT_EQUAL_INT(cases[i].frame == KC_FRAME_DETECTED ? KC_AT_STOP : 0, s_observe.taken_at);
        if (cases[i].frame == KC_FRAME_DETECTED) { TEST_ASSERT_EQUAL_UINT32(0u, s_request.fails); }
        kc_observe_at_stop(&s_observe, false);
        TEST_ASSERT_EQUAL_INT(cases[i].here, with(cases[i].frame));
    }
}

void test_a_detection_in_the_search_counts_for_aiming_and_as_seen(void)
{
    (void)shown(0.0);
    kc_observe_begin(&s_observe);
    s_request.det.p_cam_tool_m[0] += 0.02;
    s_request.frame = KC_FRAME_DETECTED;
    (void)kc_observe_search(&s_observe, &s_request, &parts.view, &parts.out);
    TEST_ASSERT_TRUE(s_observe.tried.detected);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.02, fabs(s_observe.off_m[0]) + fabs(s_observe.off_m[1]));
    TEST_ASSERT_EQUAL_DOUBLE_ARRAY(s_seed, s_observe.q_detected, 7u);
}

/* Done or not; of others than DONE and SKIP, what it is. */
void test_a_measurement_before_the_candidate_is_of_use_but_not_needed(void)
{
    static const kc_outcome_id_t measured[] = {KC_OC_STAY, KC_OC_ABORT, KC_OC_DISTURBED, KC_OC_DONE,
                                               KC_OC_SKIP};
    for (uint32_t at = KC_AT_CANDIDATE; at <= KC_AT_STOP; at++) {
        s_observe.taken_at = (kc_taken_at_t)at;
        for (uint32_t i = 0u; i < 5u; i++) {
            kc_outcome_id_t earlier = at == KC_AT_STOP ? KC_OC_ONWARD : KC_OC_SERVO;
            TEST_ASSERT_EQUAL_INT(i < 3u || at == KC_AT_CANDIDATE ? measured[i] : earlier,
                                  kc_observe_measured(&s_observe, kc_outcome(measured[i])).id);
        }
    }
}

/* ---- servo ---- */

void test_where_the_tool_is_at_the_candidate_it_is_measured(void)
{
    for (uint32_t approach = 0u; approach < 2u; approach++) {
        s_config->approach_rad = 0.1 * approach;
        TEST_ASSERT_EQUAL_INT(approach ? KC_OC_APPROACH : KC_OC_MEASURE, shown(0.0));
        TEST_ASSERT_EQUAL_INT(KC_AT_CANDIDATE, s_observe.taken_at);
        TEST_ASSERT_EQUAL_UINT32(0u, parts.out.events.n + s_observe.servo_steps);
    }
}

void test_the_tool_is_measured_and_predicted_and_servo_steps_bring_it_to_the_candidate(void)
{
    kc_pose_t tool, goal;
    uint32_t steps = 0u;
    for (; steps < 20u && shown(0.4) == KC_OC_SERVO; steps++) {
        kc_arm_fk(&s_true, parts.telemetry.arm.q, &tool);
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.0, turned_rad(&tool, &s_observe.measured));
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.4, turned_rad(&tool, &s_observe.predicted));
        TEST_ASSERT_EQUAL_DOUBLE_ARRAY(parts.telemetry.arm.q, s_observe.q_detected, 7u);
        TEST_ASSERT_EQUAL_UINT32(steps + 1u, s_observe.servo_steps);
        TEST_ASSERT_FALSE(s_observe.tried.searched);
        TEST_ASSERT_EQUAL_DOUBLE(0.0, s_observe.q_servo[7]);
        memcpy(parts.telemetry.arm.q, s_observe.q_servo, sizeof s_observe.q_servo);
        s_observe.tried.searched = true;
        s_observe.q_servo[7] = 1.0; /* of an arm with more joints */
    }
    kc_move_goal(&parts.tables.active.space, CAND, &goal);
    TEST_ASSERT_TRUE(steps > 0u && steps < 8u);
    TEST_ASSERT_TRUE(turned_rad(&goal, &s_observe.measured) <= s_config->servo.tol_rot_rad);
    TEST_ASSERT_EQUAL_UINT32(0u, parts.out.events.n);
}

/* After so many steps, back where tags were detected, or where no step helps: an event says how far off. */
void test_where_the_servo_ends_the_pose_is_measured_beside_the_candidate(void)
{
    for (uint32_t why = 0u; why < 3u; why++) {
        setUp();
        s_config->servo_steps_max = 3u;
        s_observe.servo_steps = why == 0u ? 3u : 2u;
        s_observe.tried.retreated = why == 1u;
        if (why == 2u) { s_config->servo.bound = 0.0; }
        TEST_ASSERT_EQUAL_INT(KC_OC_MEASURE, shown(0.4));
        TEST_ASSERT_EQUAL_INT(KC_AT_CANDIDATE, s_observe.taken_at);
        kc_pose_t goal;
        double r[6];
        kc_move_goal(&parts.tables.active.space, CAND, &goal);
        kc_pose_residual(&goal, &s_observe.measured, r);
        double off_m = parts.out.events.e[0].want;
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2]), off_m);
        expect_event(KC_EVT_CAL_SERVO_LIMIT, (int32_t)CAND, why == 0u ? 3.0 : 2.0, off_m);
    }
}

void test_a_local_initial_pose_is_measured_where_it_is(void)
{
    parts.tables.active.space.cand[CAND].why |= KC_CAND_LOCAL;
    s_config->approach_rad = 0.1;
    TEST_ASSERT_EQUAL_INT(KC_OC_MEASURE, shown(0.4));
    TEST_ASSERT_EQUAL_UINT32(0u, parts.out.events.n);
}

/* ---- observations on the way ---- */

static void given_extra(uint32_t most)
{
    setUp();
    s_config->extra_obs_max = most;
    s_config->extra_pos_m = 10.0;
    s_config->extra_rot_rad = 0.1;
}

/* The goal is 0.4 rad away; the last extra observation was `last_rad` from here, if there was one. */
void test_it_observes_before_the_candidate_where_that_tells_something_new_and_there_is_room(void)
{
    static const struct {
        uint32_t most, n_extra, n_obs;
        double pos_m, rot_rad, last_rad;
        kc_outcome_id_t outcome;
    } cases[] = {
        {1u, 0u, 0u, 10.0, 0.1, 0.0, KC_OC_MEASURE},
        {0u, 0u, 0u, 10.0, 0.1, 0.0, KC_OC_SERVO},
        {1u, 0u, 0u, 10.0, 0.5, 0.0, KC_OC_SERVO},
        {2u, 1u, 0u, 10.0, 0.1, 0.11, KC_OC_MEASURE},
        {2u, 1u, 0u, 10.0, 0.1, 0.09, KC_OC_SERVO},
        {1u, 1u, 0u, 10.0, 0.1, 0.3, KC_OC_SERVO},
        {2u, 0u, 56u, 10.0, 0.1, 0.0, KC_OC_SERVO},
        {2u, 0u, 55u, 10.0, 0.1, 0.0, KC_OC_MEASURE},
        {1u, 0u, 0u, 0.0, 3.0, 0.0, KC_OC_MEASURE}, /* far in one of both is enough */
        {2u, 1u, 0u, 0.0, 3.0, 0.0, KC_OC_MEASURE},
        {2u, 1u, 0u, 10.0, 0.0, 0.0, KC_OC_MEASURE}, /* as far as asked */
    };
    for (uint32_t i = 0u; i < sizeof cases / sizeof cases[0]; i++) {
        given_extra(cases[i].most);
        (void)shown(0.4 + cases[i].last_rad);
        const kc_pose_t last = s_observe.measured;
        kc_observe_begin(&s_observe);
        s_observe.last_extra = last;
        s_observe.n_extra = cases[i].n_extra;
        s_observe.servo_steps = cases[i].n_extra;
        s_observe.extra_held = true;
        s_config->extra_pos_m = cases[i].pos_m;
        s_config->extra_rot_rad = cases[i].rot_rad;
        parts.plan.n_obs = cases[i].n_obs;
        s_request.fails = 7u;
        TEST_ASSERT_EQUAL_INT(cases[i].outcome, shown(0.4));
        TEST_ASSERT_EQUAL_UINT32(cases[i].n_extra + 1u, s_observe.servo_steps); /* the next step is decided */
        const bool also = cases[i].outcome == KC_OC_MEASURE;
        TEST_ASSERT_EQUAL_UINT32(cases[i].n_extra + also, s_observe.n_extra);
        if (!also) { continue; }
        TEST_ASSERT_EQUAL_UINT32(0u, s_request.fails);
        TEST_ASSERT_EQUAL_INT(cases[i].n_extra == 0u ? KC_AT_ARRIVAL : KC_AT_SERVO_STEP, s_observe.taken_at);
        TEST_ASSERT_FALSE(s_observe.extra_held);
        TEST_ASSERT_EQUAL_MEMORY(&s_observe.measured, &s_observe.last_extra, sizeof s_observe.measured);
    }
}

void test_a_pose_measured_where_the_last_extra_observation_was_takes_its_place(void)
{
    for (uint32_t i = 0u; i < 3u; i++) { /* there, elsewhere, and where it is not held */
        given_extra(1u);
        (void)shown(i == 1u ? 0.6 : 0.4);
        s_observe.extra_held = i < 2u;
        s_observe.tried.retreated = true;
        TEST_ASSERT_EQUAL_INT(KC_OC_MEASURE, shown(0.4));
        TEST_ASSERT_EQUAL_INT(i == 0u, s_observe.same_place);
    }
}

/* ---- no tags ---- */

void test_without_tags_it_goes_to_the_seed_searches_or_goes_back(void)
{
    const double far = s_config->servo.step_max + 0.01;
    parts.telemetry.arm.q[3] = s_seed[3] + far;
    s_observe.i_search = 5u;
    s_observe.tried.searched = true;
    TEST_ASSERT_EQUAL_INT(KC_OC_SEED, with(KC_FRAME_NO_TAGS));
    TEST_ASSERT_EQUAL_UINT32(0u, s_observe.i_search);
    TEST_ASSERT_FALSE(s_observe.tried.searched); /* there the unit may search again */
    TEST_ASSERT_EQUAL_INT(KC_OC_SEARCH, with(KC_FRAME_NO_TAGS));
    s_observe.i_search = 5u;
    TEST_ASSERT_EQUAL_INT(KC_OC_SKIP, with(KC_FRAME_NO_TAGS));
    expect_event(KC_EVT_CAL_TAGS_LOST, (int32_t)CAND, 0.0, 0.0);
    setUp();
    parts.telemetry.arm.q[3] = s_seed[3] + s_config->servo.step_max - 0.01; /* near the seed already */
    TEST_ASSERT_EQUAL_INT(KC_OC_SEARCH, with(KC_FRAME_NO_TAGS));
    setUp();
    (void)shown(0.4);
    s_observe.tried.searched = true;
    TEST_ASSERT_EQUAL_INT(KC_OC_RETREAT, with(KC_FRAME_NO_TAGS));
    TEST_ASSERT_TRUE(s_observe.tried.retreated && !s_observe.tried.searched && !s_observe.tried.seed);
    TEST_ASSERT_EQUAL_INT(KC_OC_SKIP, with(KC_FRAME_NO_TAGS));
}

/* ---- search ---- */

static kc_outcome_id_t turned(void)
{
    memset(&parts.out, 0, sizeof parts.out);
    return kc_observe_turn(&s_observe, &s_pantilt, &parts.view, &parts.out).id;
}

static void given_search(void)
{
    setUp();
    s_camera->pan_min_rad = s_camera->tilt_min_rad = -3.0;
    s_camera->pan_max_rad = s_camera->tilt_max_rad = 3.0;
    s_pantilt = (kc_pantilt_t){.pan_rad = 0.25, .tilt_rad = -0.25};
    kc_observe_aimed(&s_observe, &s_pantilt);
}

/* Around where the unit was aimed, by the spiral of kc_reach.h, a step of CONFIG apart. */
void test_the_search_goes_along_the_spiral_and_ends(void)
{
    given_search();
    for (uint32_t i = 1u; i <= s_config->search_steps; i++) {
        double x = 0.0, y = 0.0;
        kc_reach_spiral(i, &x, &y);
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, turned());
        TEST_ASSERT_TRUE(parts.out.has_pantilt_cmd);
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.25 + 0.25 * x, parts.out.pantilt_cmd.pan_rad);
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, -0.25 + 0.25 * y, parts.out.pantilt_cmd.tilt_rad);
    }
    TEST_ASSERT_EQUAL_INT(KC_OC_SKIP, turned());
    expect_event(KC_EVT_CAL_TAGS_LOST, (int32_t)CAND, (double)s_config->search_steps, 0.0);
}

void test_search_positions_beyond_a_limit_are_left_out(void)
{
    for (uint32_t which = 0u; which < 8u; which++) {
        const double by = which < 4u ? 0.01 : 0.25; /* beyond the middle, or at its neighbours */
        uint32_t n = 0u;
        given_search();
        switch (which % 4u) {
        case 0u: s_camera->pan_min_rad = 0.25 - by; break;
        case 1u: s_camera->pan_max_rad = 0.25 + by; break;
        case 2u: s_camera->tilt_min_rad = -0.25 - by; break;
        default: s_camera->tilt_max_rad = -0.25 + by; break;
        }
        for (; turned() == KC_OC_STAY; n++) {
            const kc_pantilt_cmd_t *c = &parts.out.pantilt_cmd;
            TEST_ASSERT_TRUE(c->pan_rad >= s_camera->pan_min_rad && c->pan_rad <= s_camera->pan_max_rad);
            TEST_ASSERT_TRUE(c->tilt_rad >= s_camera->tilt_min_rad && c->tilt_rad <= s_camera->tilt_max_rad);
        }
        TEST_ASSERT_EQUAL_UINT32(which < 4u ? 5u : 8u, n); /* of eight around the middle */
    }
}

/* As far as the newest residual is, seen from where the newest observation was taken. */
void test_once_the_model_is_known_good_it_does_not_search_for_hidden_tags(void)
{
    for (uint32_t i = 0u; i < 3u; i++) {
        static const double range_m[] = {2.0, 2.0, 0.2};
        given_search();
        parts.plan.n_meas = i == 0u ? 0u : 1u;
        parts.est.n_obs = 2u;
        parts.est.obs[1].ctx.range_m = range_m[i];
        parts.latest.res.pos_m = 0.1;
        TEST_ASSERT_EQUAL_INT(i == 1u ? KC_OC_SKIP : KC_OC_STAY, turned());
    }
}
