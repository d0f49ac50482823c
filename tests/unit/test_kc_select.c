/* kc_select.c: what a session begins with, its budgets and its end. The choice of poses: test_select.c. */
#include "kc_select.h"

#include <math.h>
#include <string.h>

#include "given_parts.h"
#include "kc_cost.h"
#include "kc_move.h"
#include "unity.h"

static kc_config_t *s_config;
static kc_camera_t *s_camera;
static kc_arena_calibration_t s_arena;

void setUp(void)
{
    given_parts();
    s_config = &parts.tables.active.config;
    s_camera = &parts.tables.active.camera;
    parts.est.terms = &parts.tables.active.terms;
}

/* ---- START ---- */

static void start(void)
{
    const kc_start_t ask = {.acq = KC_ACQ_DOPT, .n_goal = 6u};
    kc_select_start(&parts.cal, &parts.plan, &parts.view, &ask, &parts.out);
    TEST_ASSERT_EQUAL_UINT16(KC_EVT_CAL_START, parts.out.events.e[0].id);
}

void test_a_session_begins_now_and_with_nothing_of_the_one_before(void)
{
    const kc_cal_t want = {.session = 8u,
                           .acq = KC_ACQ_DOPT,
                           .start_us = PARTS_NOW_US,
                           .energy_us = PARTS_NOW_US,
                           .candidate = -1};
    memset(&parts.cal, 0, sizeof parts.cal);
    parts.cal.session = 7u;
    parts.cal.energy_j = parts.cal.acq_value = 3.0;
    parts.cal.ended = KC_ENDED_TIME;
    start();
    TEST_ASSERT_EQUAL_MEMORY(&want, &parts.cal, sizeof want);
    TEST_ASSERT_EQUAL_UINT32(6u, parts.plan.n_goal);
    expect_event(KC_EVT_CAL_START, 8, 6.0, KC_ACQ_DOPT);
}

/* Position and rotation that are required, in thousandths, and what the camera chain leaves; 0: nothing is said. */
void test_a_requirement_that_the_camera_cannot_meet_is_reported(void)
{
    static const struct {
        double stop_m, stop_rad, confidence;
        uint8_t frame;
        double plate, mast, left_m, left_rad; /* the last two squared; of both kinds */
    } cases[] = {
        {1.0, 0.0, 0.0, KC_RIGHT_IN_CAMERA, 1.0, 0.0, 3.0, 0.0},
        {1.8, 1.8, 0.0, KC_RIGHT_IN_CAMERA, 1.0, 2.0, 0.0, 0.0},
        {1.8, 1.8, 0.0, KC_RIGHT_IN_LANDER, 1.0, 2.0, 15.0, 15.0}, /* the mast counts there */
        {0.0, 0.0, 0.0, KC_RIGHT_IN_CAMERA, 1.0, 0.0, 0.0, 0.0},
        {2.51, 2.49, 0.9, KC_RIGHT_IN_CAMERA, 1.0, 0.0, 0.0, 6.251388631170326},
        {2.49, 2.51, 0.9, KC_RIGHT_IN_CAMERA, 1.0, 0.0, 6.251388631170326, 0.0},
        /* two sizes, 3 and 12 squared: 3 x 225 / 153 degrees of freedom */
        {1.0, 9.0, 0.9, KC_RIGHT_IN_LANDER, 1.0, 2.0, 28.513633010805375, 0.0},
    };
    for (uint32_t i = 0u; i < sizeof cases / sizeof cases[0]; i++) {
        const double left[] = {cases[i].left_m, cases[i].left_rad};
        const kc_event_t *e = &parts.out.events.e[1]; /* behind CAL_START */
        memset(&parts.out, 0, sizeof parts.out);
        s_config->stop_pos_m = 1e-3 * cases[i].stop_m;
        s_config->stop_rot_rad = 1e-3 * cases[i].stop_rad;
        s_config->stop_confidence = cases[i].confidence;
        s_config->frame = cases[i].frame;
        s_camera->plate_sigma_m = s_camera->plate_sigma_rad = 1e-3 * cases[i].plate;
        s_camera->mast_sigma_m = s_camera->mast_sigma_rad = 1e-3 * cases[i].mast;
        start();
        for (int32_t k = 0; k < 2; k++) {
            if (left[k] <= 0.0) { continue; }
            TEST_ASSERT_EQUAL_UINT16(KC_EVT_CAL_UNREACHABLE, e->id);
            TEST_ASSERT_EQUAL_INT32(k, e->index);
            TEST_ASSERT_DOUBLE_WITHIN(1e-9, 1e-3 * sqrt(left[k]), e->got);
            TEST_ASSERT_EQUAL_DOUBLE(k == 0 ? s_config->stop_pos_m : s_config->stop_rot_rad, e->want);
            e++;
        }
        TEST_ASSERT_EQUAL_PTR(&parts.out.events.e[parts.out.events.n], e);
    }
}

/* ---- budgets ---- */

static kc_outcome_t after_s(double s, kc_state_t state)
{
    memset(&parts.out, 0, sizeof parts.out);
    parts.clock.now_us = PARTS_NOW_US + (uint64_t)(1e6 * s);
    parts.place.state = state;
    return kc_select_budget(&parts.cal, &parts.view, &parts.out);
}

static void given_session(void)
{
    setUp();
    start();
    s_config->power_idle_w = 10.0;
    s_config->power_move_w = 70.0;
    parts.plan.n_meas = 3u;
}

void test_energy_is_counted_by_what_moves_while_a_calibration_runs(void)
{
    given_session();
    (void)after_s(2.0, KC_ST_OBSERVE);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 20.0, parts.cal.energy_j);
    parts.telemetry.arm.moving = 1u;
    (void)after_s(3.0, KC_ST_UPDATE);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 90.0, parts.cal.energy_j);
    (void)after_s(5.0, KC_ST_REVIEW);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 90.0, parts.cal.energy_j);
}

void test_a_budget_that_is_used_up_ends_it_but_no_estimate(void)
{
    for (uint32_t energy = 0u; energy < 2u; energy++) {
        given_session();
        s_config->budget_us = energy ? 0u : 4000000u;
        s_config->energy_budget_j = energy ? 40.0 : 0.0;
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, after_s(4.0, KC_ST_MOVE).id);
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, after_s(5.0, KC_ST_UPDATE).id);
        TEST_ASSERT_EQUAL_INT(KC_OC_FINISH, after_s(5.0, KC_ST_MOVE).id);
        TEST_ASSERT_EQUAL_INT(energy ? KC_ENDED_ENERGY : KC_ENDED_TIME, parts.cal.ended);
        expect_event(energy ? KC_EVT_CAL_ENERGY : KC_EVT_CAL_BUDGET, -1, energy ? 50.0 : 5e6,
                     energy ? 40.0 : 4e6);
        parts.plan.n_meas = 0u; /* nothing that a proposal could use */
        kc_outcome_t oc = after_s(5.0, KC_ST_MOVE);
        TEST_ASSERT_EQUAL_INT(KC_OC_ABORT, oc.id);
        TEST_ASSERT_EQUAL_INT(KC_CAUSE_BUDGET, oc.cause);
    }
    given_session();
    s_config->budget_us = 0u;
    s_config->energy_budget_j = 0.5; /* any budget is one */
    TEST_ASSERT_EQUAL_INT(KC_OC_FINISH, after_s(4.0, KC_ST_MOVE).id);
}

/* ---- SELECT ---- */

static kc_outcome_t selected(void)
{
    kc_work_t work = kc_work_unlimited();
    uint64_t rng = 1u;
    kc_select_begin(&s_arena);
    return kc_select_run(&parts.cal, &parts.plan, &s_arena, &rng, &parts.view, &work, &parts.out);
}

void test_it_ends_for_the_reason_that_there_is(void)
{
    given_session();
    parts.plan.n_meas = 6u; /* all that were requested */
    TEST_ASSERT_EQUAL_INT(KC_OC_FINISH, selected().id);
    TEST_ASSERT_EQUAL_INT(KC_ENDED_POSES, parts.cal.ended);
    parts.plan.n_meas = 5u;
    parts.plan.n_obs = KC_MEAS_MAX; /* no more can be held */
    TEST_ASSERT_EQUAL_INT(KC_OC_FINISH, selected().id);
    TEST_ASSERT_EQUAL_INT(KC_ENDED_OBSERVATIONS, parts.cal.ended);
    parts.latest.ended = KC_ENDED_REQUIREMENT;
    TEST_ASSERT_EQUAL_INT(KC_OC_FINISH, selected().id);
    TEST_ASSERT_EQUAL_INT(KC_ENDED_REQUIREMENT, parts.cal.ended);
}

/* Two poses more tell a bad detection at the last pose from an arm that has changed. */
void test_a_last_pose_that_is_rejected_is_followed_by_two_more_at_most(void)
{
    given_session();
    parts.est.n_obs = 6u;
    parts.est.outlier[5] = 1u;
    for (uint32_t n = 6u; n < 8u; n++) {
        parts.plan.n_meas = n;
        parts.out.events.n = 0u;
        TEST_ASSERT_NOT_EQUAL(KC_OC_FINISH, selected().id);
        TEST_ASSERT_EQUAL_UINT16(KC_EVT_CAL_NEWEST_REJECTED, parts.out.events.e[0].id);
        TEST_ASSERT_EQUAL_INT((int32_t)n, parts.out.events.e[0].index);
    }
    parts.plan.n_meas = 8u;
    parts.out.events.n = 0u;
    TEST_ASSERT_EQUAL_INT(KC_OC_FINISH, selected().id);
    TEST_ASSERT_EQUAL_INT(KC_ENDED_POSES, parts.cal.ended);
    TEST_ASSERT_EQUAL_UINT32(0u, parts.out.events.n);
}

void test_another_end_is_not_put_off_by_a_rejected_pose(void)
{
    given_session();
    parts.est.n_obs = 6u;
    parts.est.outlier[5] = 1u;
    parts.plan.n_meas = 5u;
    parts.plan.n_obs = KC_MEAS_MAX;
    TEST_ASSERT_EQUAL_INT(KC_OC_FINISH, selected().id);
    TEST_ASSERT_EQUAL_INT(KC_ENDED_OBSERVATIONS, parts.cal.ended);
}

/* While only local initial poses were measured, the choice is among those of them that were not begun. */
void test_the_next_local_initial_pose_is_chosen_among_local_ones(void)
{
    kc_space_t *s = &parts.tables.active.space;
    given_session();
    given_measured(1u, 0.0, 0.0, 0.0); /* as predicted: no doubt */
    s->n_initial = 4u;
    for (uint32_t i = 0u; i < 4u; i++) {
        s->initial[i] = (uint16_t)(2u * i);
        s->cand[2u * i].why |= i < 3u ? KC_CAND_LOCAL : 0u;
    }
    parts.plan.by_information = true;
    parts.plan.begun = 1u;
    parts.plan.n_meas = parts.plan.n_local = 1u;
    memset(&s_arena, 0, sizeof s_arena);
    kc_work_t work = {1u, 0u};
    uint64_t rng = 1u;
    TEST_ASSERT_EQUAL_INT(
        KC_OC_STAY,
        kc_select_run(&parts.cal, &parts.plan, &s_arena, &rng, &parts.view, &work, &parts.out).id);
    TEST_ASSERT_TRUE(s_arena.choice.initial);
    TEST_ASSERT_EQUAL_DOUBLE(s_config->local_safe_m * s_config->local_safe_m, s_arena.acq.safe_m2);
    for (uint32_t c = 0u; c < 9u; c++) {
        TEST_ASSERT_EQUAL_UINT8(c == 2u || c == 4u ? 1u : 0u, s_arena.choice.eligible[c]);
    }
}

/* One candidate a step, in which no more fits; those that may be chosen are eight of nine. */
void test_joints_and_cost_are_predicted_for_every_candidate_that_may_be_chosen(void)
{
    given_session();
    parts.tables.active.space.n_initial = 0u;
    kc_plan_skipped(&parts.plan, 4u);
    parts.est.n_obs = 1u;
    memset(&s_arena, 0, sizeof s_arena);
    for (uint32_t i = 0u; i < 9u; i++) { /* the first plans */
        kc_work_t work = {1u, 0u};
        uint64_t rng = 1u;
        kc_outcome_t oc = kc_select_run(&parts.cal, &parts.plan, &s_arena, &rng, &parts.view, &work,
                                        &parts.out);
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, oc.id);
    }
    for (uint32_t c = 0u; c < 9u; c++) {
        double q[KC_JOINT_MAX] = {0.0};
        if (c != 4u) { (void)kc_move_joints(&parts.view, c, 8u, q); }
        for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) {
            TEST_ASSERT_EQUAL_FLOAT((float)q[j], s_arena.cand_q[c * KC_JOINT_MAX + j]);
        }
        TEST_ASSERT_EQUAL_FLOAT(c != 4u ? (float)kc_cost_candidate(&parts.view, c, q) : 0.0f,
                                s_arena.choice.cost[c]);
    }
}

void test_a_skipped_candidate_is_named_and_not_chosen_again(void)
{
    given_session();
    parts.cal.candidate = 4;
    memset(&parts.out, 0, sizeof parts.out);
    kc_select_skip(&parts.plan, &parts.view, &parts.out);
    expect_event(KC_EVT_CAL_CAND_SKIPPED, 4, 0.0, 0.0);
    TEST_ASSERT_EQUAL_UINT8(0u, parts.plan.usable[4]);
}
