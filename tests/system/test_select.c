/* kc_select.c, kc_cost.c: the initial design by information, when the arm leaves the park pose, gain for its cost. */
#include <math.h>
#include <string.h>

#include "given_world.h"
#include "kc_cost.h"
#include "kc_guard.h"
#include "kc_select.h"
#include "unity.h"

#define APP (&kc_app_instance)
#define N_LOCAL 9u
#define FIRST_LOCAL ((int32_t)(world.space.n_cand - N_LOCAL))
enum { INFORMATION = 3, CLEARANCE = 4 }; /* parts of a choice, as in kc_select.c */
#define ANY 10.0 /* m: every pose is safe */

/* Errors within the bounds of the tables; local initial poses, chosen by information. */
static void given_informed(uint8_t acq, double local_safe_m, double leave_safe_m, double power_min)
{
    given_world();
    world.truth.joint[6].phi_rad = 0.2;
    world.truth.joint[2].d_m += 0.02;
    world.config.search_steps = 0u;
    given_local_poses(N_LOCAL, 0u);
    world.config.acquisition = acq;
    world.config.initial_design = KC_INITIAL_INFORMATION;
    world.config.local_safe_m = local_safe_m;
    world.config.leave_safe_m = leave_safe_m;
    world.config.power_min = power_min;
}

void setUp(void) { given_informed(KC_ACQ_DOPT, ANY, ANY, 0.0); }

static bool is_local(uint32_t i) { return world.meas[i].candidate >= FIRST_LOCAL; }

static uint32_t locals(void)
{
    uint32_t n = 0u;
    while (n < world.n_meas && is_local(n)) { n++; }
    for (uint32_t i = n; i < world.n_meas; i++) { TEST_ASSERT_FALSE(is_local(i)); }
    return n;
}

static bool in_table_order(uint32_t n)
{
    bool order = true;
    for (uint32_t i = 0u; i < n; i++) {
        order = order && world.meas[i].candidate == FIRST_LOCAL + (int32_t)i;
    }
    return order;
}

/* ---- the end of the local initial poses ---- */

void test_an_arm_with_nothing_to_wait_for_leaves_after_the_first_pose(void)
{
    world_calibrated();
    TEST_ASSERT_EQUAL_UINT32(1u, locals());
    TEST_ASSERT_EQUAL_UINT32(7u, world.n_meas); /* six requested, and one local initial pose */
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_LEAVES_PARK));
    TEST_ASSERT_EQUAL_INT(1, world.last[KC_EVT_CAL_LEAVES_PARK].index);
    TEST_ASSERT_EQUAL_INT(-1, world.progress[0].acquisition);
    for (uint32_t i = 1u; i < 7u; i++) { TEST_ASSERT_EQUAL_INT(KC_ACQ_DOPT, world.progress[i].acquisition); }
    TEST_ASSERT_EQUAL_UINT32(6u, world.progress[0].n_goal - 1u);
    TEST_ASSERT_DOUBLE_WITHIN(0.01, 0.2, world.proposal.kin.value[24]);
}

void test_the_arm_stays_until_the_test_of_its_bounds_has_its_power(void)
{
    double power = 0.0;
    given_informed(KC_ACQ_DOPT, ANY, ANY, 0.9);
    world_calibrated();
    uint32_t n = locals();
    TEST_ASSERT_TRUE(n > 1u && n < N_LOCAL);
    TEST_ASSERT_EQUAL_INT((int)n, world.last[KC_EVT_CAL_LEAVES_PARK].index);
    power = world.last[KC_EVT_CAL_LEAVES_PARK].got;
    TEST_ASSERT_TRUE(power >= 0.9);
    given_informed(KC_ACQ_DOPT, ANY, ANY, power - 1e-9); /* as much as that is enough */
    world_calibrated();
    TEST_ASSERT_EQUAL_UINT32(n, locals());
    given_informed(KC_ACQ_DOPT, ANY, ANY, power + 1e-9);
    world_calibrated();
    TEST_ASSERT_TRUE(locals() > n);
}

void test_the_arm_stays_until_a_pose_is_predicted_safe(void)
{
    double sigma_m = 0.0;
    given_informed(KC_ACQ_DOPT, ANY, 0.06, 0.0);
    world_calibrated();
    uint32_t n = locals();
    TEST_ASSERT_TRUE(n > 1u && n < N_LOCAL);
    sigma_m = world.last[KC_EVT_CAL_LEAVES_PARK].want;
    TEST_ASSERT_TRUE(sigma_m > 0.0 && sigma_m <= 0.06);
}

/* Ground this far below the lowest candidate's tool; nothing else can touch. */
static void given_ground(double below_m)
{
    kc_space_t *s = &world.space;
    double lowest_m = (double)INFINITY;
    for (uint32_t c = 0u; c < s->n_cand; c++) { lowest_m = fmin(lowest_m, (double)s->cand[c].p_m[2]); }
    s->n_body = s->n_volume = 1u;
    s->body[0] = (kc_body_t){0u, {0.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f}, 0.01f, 0u};
    s->volume[0] = (kc_volume_t){
        KC_VOL_BELOW, {0.0f, 0.0f, (float)(lowest_m - below_m - 0.01)}, {0.0f, 0.0f, 0.0f}, 0.0f, 0u};
}

void test_the_arm_stays_until_it_stands_clear_where_it_goes(void)
{
    uint32_t n[2];
    for (uint32_t i = 0u; i < 2u; i++) {
        given_informed(KC_ACQ_DOPT, ANY, ANY, 0.0);
        given_ground(i == 0u ? 3.0 : 0.02);
        world_calibrated();
        n[i] = locals();
        TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_LEAVES_PARK));
        TEST_ASSERT_EQUAL_UINT32(n[i] + 6u, world.n_meas);
    }
    TEST_ASSERT_EQUAL_UINT32(1u, n[0]);
    TEST_ASSERT_TRUE(n[1] > 1u && n[1] < N_LOCAL);
}

void test_where_nothing_is_safe_all_local_poses_are_measured_and_then_the_table_goes_on(void)
{
    given_informed(KC_ACQ_DOPT, ANY, 1e-9, 0.0);
    world_calibrated();
    TEST_ASSERT_EQUAL_UINT32(N_LOCAL, locals());
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_CAL_LEAVES_PARK));
    for (int32_t i = 0; i < 3; i++) { TEST_ASSERT_EQUAL_INT(i, world.meas[N_LOCAL + (uint32_t)i].candidate); }
    TEST_ASSERT_EQUAL_UINT32(N_LOCAL + 6u, world.n_meas);
}

/* ---- which local initial pose ---- */

void test_local_poses_are_taken_by_their_gain(void)
{
    given_informed(KC_ACQ_RATE, ANY, 1e-9, 0.0);
    world_calibrated();
    TEST_ASSERT_EQUAL_INT(FIRST_LOCAL, world.meas[0].candidate); /* the arm is there */
    TEST_ASSERT_FALSE(in_table_order(N_LOCAL));
    for (uint32_t i = 2u; i < N_LOCAL - 1u; i++) {
        TEST_ASSERT_EQUAL_INT(-1, world.progress[i].acquisition);
        TEST_ASSERT_TRUE(world.progress[i].acquisition_value > 0.0);
        TEST_ASSERT_TRUE(world.progress[i].acquisition_value < world.progress[i - 1u].acquisition_value);
    }
}

void test_local_poses_that_are_not_predicted_safe_are_taken_in_their_order(void)
{
    given_informed(KC_ACQ_DOPT, 1e-9, 1e-9, 0.0);
    world_calibrated();
    TEST_ASSERT_TRUE(in_table_order(N_LOCAL));
}

void test_an_unsafe_local_pose_waits_until_it_is_safe(void)
{
    given_informed(KC_ACQ_DOPT, ANY, 1e-9, 0.0);
    world_calibrated();
    int32_t free = world.meas[1].candidate;
    given_informed(KC_ACQ_DOPT, 0.02, 1e-9, 0.0);
    world_calibrated();
    TEST_ASSERT_TRUE(free != world.meas[1].candidate);
    TEST_ASSERT_EQUAL_UINT32(N_LOCAL, locals());
}

/* ---- doubt ---- */

/* Detections that contradict each other, from pose to pose. */
static void disagree(kc_detection_t *d)
{
    if (kc_app_state(APP) == KC_ST_MEASURE) {
        d->p_cam_tool_m[1] += APP->plan.n_meas % 2u == 0u ? 0.01 : -0.01;
    }
}

/* What was measured before the doubt is measured again: as if the initial poses had been those of the table. */
void test_doubt_begins_again_with_all_local_poses_in_their_order(void)
{
    world.config.power_min = 0.95;
    world.spoil = disagree;
    world_calibrated();
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_DOUBT));
    const uint32_t n = (uint32_t)world.last[KC_EVT_CAL_DOUBT].index;
    TEST_ASSERT_TRUE(n > 1u && n < N_LOCAL);
    TEST_ASSERT_EQUAL_UINT32(n + N_LOCAL, locals());
    for (uint32_t i = 0u; i < N_LOCAL; i++) {
        TEST_ASSERT_EQUAL_INT(FIRST_LOCAL + (int32_t)i, world.meas[n + i].candidate);
        TEST_ASSERT_EQUAL_UINT32(i + 1u, world.meas[n + i].pose);
    }
    TEST_ASSERT_EQUAL_UINT32(world.n_meas - n, APP->est.n_obs);
    TEST_ASSERT_TRUE(world.last[KC_EVT_CAL_DOUBT].got < 0.01);
    TEST_ASSERT_EQUAL_DOUBLE(0.01, world.last[KC_EVT_CAL_DOUBT].want);
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_CAL_LEAVES_PARK));
}

void test_without_a_solution_the_table_decides(void)
{
    world_started();
    for (uint32_t i = 0u; i < 4000u && world_calibrating(); i++) {
        APP->est.opt.iter_max = 0u; /* not allowed: the estimator refuses */
        world_tick();
    }
    TEST_ASSERT_EQUAL_INT(FIRST_LOCAL, world.meas[0].candidate);
    for (uint32_t i = 0u; i < N_LOCAL; i++) {
        TEST_ASSERT_EQUAL_INT(FIRST_LOCAL + (int32_t)i, world.meas[1u + i].candidate);
    }
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_DOUBT));
}

void test_where_no_gain_can_be_computed_the_table_decides(void)
{
    world_started();
    for (uint32_t i = 0u; i < N_LOCAL; i++) {
        TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_POSE, 400u));
        APP->est.coef[2] = (double)NAN;
        TEST_ASSERT_TRUE(world_until(KC_ST_MOVE, 400u));
    }
    TEST_ASSERT_EQUAL_UINT32(N_LOCAL, APP->plan.n_tried);
    TEST_ASSERT_TRUE(in_table_order(N_LOCAL));
}

/* ---- other acquisitions ---- */

void test_other_acquisitions_go_on_with_the_initial_poses_of_the_table(void)
{
    for (uint8_t acq = KC_ACQ_UCB; acq <= KC_ACQ_RANDOM; acq++) {
        given_informed(acq, ANY, ANY, 0.0);
        world_calibrated();
        TEST_ASSERT_EQUAL_UINT32(1u, locals());
        for (int32_t i = 0; i < 3; i++) {
            TEST_ASSERT_EQUAL_INT(i, world.meas[1 + i].candidate);
            TEST_ASSERT_EQUAL_INT(-1, world.progress[1 + i].acquisition);
        }
        TEST_ASSERT_EQUAL_INT(acq, world.progress[4].acquisition);
        TEST_ASSERT_EQUAL_UINT32(7u, world.n_meas);
    }
}

void test_without_further_initial_poses_they_measure_all_local_ones_first(void)
{
    given_informed(KC_ACQ_UCB, ANY, ANY, 0.0);
    world.space.n_initial = N_LOCAL;
    world_calibrated();
    TEST_ASSERT_EQUAL_UINT32(N_LOCAL, locals());
    TEST_ASSERT_EQUAL_INT(KC_ACQ_UCB, world.progress[N_LOCAL].acquisition);
}

void test_everything_is_estimated_until_a_proposal_is_possible(void)
{
    world_started();
    for (uint32_t n = 1u; n <= 5u; n++) {
        TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_POSE, 400u));
        TEST_ASSERT_EQUAL_INT(n < 4u, APP->est.hold_none); /* one local initial pose, and three others */
        TEST_ASSERT_EQUAL_INT(1, APP->est.by_bounds);
    }
}

void test_the_order_of_the_table_needs_no_prior_by_bounds(void)
{
    world.config.initial_design = KC_INITIAL_TABLE;
    world_calibrated();
    TEST_ASSERT_EQUAL_INT(0, APP->est.by_bounds);
    TEST_ASSERT_EQUAL_UINT32(N_LOCAL, locals());
    TEST_ASSERT_TRUE(in_table_order(N_LOCAL));
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_CAL_LEAVES_PARK));
}

void test_a_choice_in_parts_is_the_same_choice(void)
{
    kc_out_t out;
    given_informed(KC_ACQ_DOPT, ANY, 1e-9, 0.0);
    world_started();
    TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_POSE, 400u));
    TEST_ASSERT_TRUE(world_until(KC_ST_MOVE, 400u));
    int32_t whole = APP->cal.candidate;
    given_informed(KC_ACQ_DOPT, ANY, 1e-9, 0.0);
    world_started();
    TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_POSE, 400u));
    memset(&out, 0, sizeof out);
    kc_select_begin(&APP->arena.calibration);
    kc_outcome_t oc = kc_outcome(KC_OC_STAY);
    uint32_t steps = 0u;
    for (; oc.id == KC_OC_STAY && steps < 5000u; steps++) {
        kc_work_t work = {1u, 0u}; /* one unit a step */
        oc = kc_select_run(&APP->cal, &APP->plan, &APP->arena.calibration, &APP->rng, &APP->view, &work,
                           &out);
    }
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, oc.id);
    TEST_ASSERT_TRUE(steps > 10u);
    TEST_ASSERT_EQUAL_INT(whole, APP->cal.candidate);
}

static kc_outcome_t select_run(void)
{
    static kc_out_t out;
    kc_work_t work = kc_work_unlimited();
    memset(&out, 0, sizeof out);
    return kc_select_run(&APP->cal, &APP->plan, &APP->arena.calibration, &APP->rng, &APP->view, &work, &out);
}

/* The choice by the bounds has ended in this part like this, for candidate 5; by the suspects only 7 may be chosen. */
static void chosen_by_the_bounds(uint32_t part, kc_status_t status, bool safe)
{
    kc_arena_calibration_t *arena = &APP->arena.calibration;
    memset(&arena->choice, 0, sizeof arena->choice);
    arena->choice.part = part;
    arena->choice.initial = part == CLEARANCE;
    arena->choice.eligible[7] = 1u;
    kc_acq_begin(&(kc_acq_ask_t){.kind = KC_ACQ_COUNT}, &APP->est, &arena->acq);
    arena->acq.status = status;
    arena->acq.safe = safe;
    arena->acq.best = 5u;
    APP->cal.chosen_by = -1;
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, select_run().id);
}

/* Nor about the pose that the arm leaves the park pose for: its clearance was checked. */
void test_suspects_are_asked_only_about_what_is_safe_by_the_bounds(void)
{
    static const struct {
        uint32_t part;
        kc_status_t status;
        bool safe;
        int32_t candidate, chosen_by; /* candidate -1: by chance */
    } cases[] = {{CLEARANCE, KC_OK, true, 5, KC_ACQ_DOPT},
                 {INFORMATION, KC_OK, true, 7, KC_ACQ_DOPT},
                 {INFORMATION, KC_OK, false, 5, KC_ACQ_DOPT}, /* nothing is safe: the most certain one */
                 {INFORMATION, KC_ERR_NUM, true, -1, KC_ACQ_RANDOM}}; /* not all of them were evaluated */
    world_started();
    TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_POSE, 400u));
    APP->est.by_prior = 1u;
    APP->est.prior_mean = APP->tables.active.kin.value;
    for (uint32_t c = 0u; c < KC_COEF_MAX; c++) { APP->est.prior_sigma[c] = 0.01; }
    for (uint32_t i = 0u; i < 4u; i++) {
        chosen_by_the_bounds(cases[i].part, cases[i].status, cases[i].safe);
        if (cases[i].candidate >= 0) { TEST_ASSERT_EQUAL_INT(cases[i].candidate, APP->cal.candidate); }
        TEST_ASSERT_EQUAL_INT(cases[i].chosen_by, APP->cal.chosen_by);
    }
}

/* ---- gain for its cost ---- */

void test_rate_ends_in_a_good_correction_by_every_measure_and_cost(void)
{
    for (uint32_t k = 0u; k < 4u; k++) {
        given_informed(KC_ACQ_RATE, 0.02, ANY, 0.9);
        world.config.rate_measure = k % 2u == 0u ? KC_ACQ_DOPT : KC_ACQ_VOPT;
        world.config.rate_cost = k < 2u ? KC_COST_TIME : KC_COST_ENERGY;
        world.config.power_idle_w = 15.0;
        world.config.power_move_w = 60.0;
        world.config.n_poses = 8u;
        world_calibrated();
        TEST_ASSERT_EQUAL_INT(KC_ACQ_RATE, world.progress[world.n_meas - 1u].acquisition);
        TEST_ASSERT_EQUAL_INT(KC_VERDICT_CHANGE, world.proposal.verdict);
        TEST_ASSERT_DOUBLE_WITHIN(0.01, 0.2, world.proposal.kin.value[24]);
    }
}
