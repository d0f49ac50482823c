/* kc_work.h, and what it is for: with everything at its limits, a calibration goes on from step to step and can be
 * stopped between two of them. tests/bench/wcet.py counts the instructions of these steps. */
#include <string.h>

#include "given_largest.h"
#include "given_world.h"
#include "kc_work.h"
#include "unity.h"

#define APP (&kc_app_instance)

/* ---- everything at its limits ---- */

static void begin(uint8_t acq)
{
    given_largest(acq);
    world_boot();
    world_tick();
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_START, acq, (int32_t)KC_MEAS_MAX, 3));
    given_poses(KC_MEAS_MAX - 2u);
}

static void until_working_in(kc_state_t state)
{
    TEST_ASSERT_TRUE(world_until(state, 20000u));
    world_tick();
    TEST_ASSERT_EQUAL_INT(state, kc_app_state(APP)); /* one step is not enough */
}

static const kc_state_t s_working[] = {KC_ST_MOVE,  KC_ST_UPDATE, KC_ST_REFINE,
                                       KC_ST_LEARN, KC_ST_REPORT, KC_ST_SELECT};

void test_an_abort_stops_between_the_steps_of_a_computation(void)
{
    for (uint32_t i = 0u; i < sizeof s_working / sizeof s_working[0]; i++) {
        begin(KC_ACQ_VOPT);
        bool later = s_working[i] == KC_ST_REFINE || s_working[i] == KC_ST_SELECT; /* they need an estimate */
        if (later) { TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_POSE, 20000u)); }
        until_working_in(s_working[i]);
        TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_ABORT, 0, 0, 0));
        TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
        TEST_ASSERT_EQUAL_UINT8(1u, world.out.has_arm_cmd);
        TEST_ASSERT_EQUAL_UINT8(1u, world.out.arm_cmd.hold);
        world_ticks(3u); /* and nothing goes on behind it */
        TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
        TEST_ASSERT_TRUE(world.arm_cmd.hold);
    }
}

void test_a_fault_of_the_arm_stops_a_computation_too(void)
{
    begin(KC_ACQ_RANDOM);
    until_working_in(KC_ST_UPDATE);
    world.fault = 1;
    world_tick();
    TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
}

void test_every_acquisition_goes_to_the_end(void)
{
    for (uint8_t acq = KC_ACQ_UCB; acq < KC_ACQ_COUNT; acq++) {
        begin(acq);
        for (uint32_t i = 0u; i < 20000u && world_calibrating(); i++) { world_tick(); }
        TEST_ASSERT_TRUE(world_stored(20u));
        TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
        TEST_ASSERT_EQUAL_UINT32(KC_MEAS_MAX, APP->plan.n_meas);
        TEST_ASSERT_EQUAL_UINT32(KC_COEF_MAX, world.proposal.rank);
        TEST_ASSERT_EQUAL_INT(acq, world.progress[1].acquisition);
    }
}

/* An estimate that was cut off leaves nothing behind: the next calibration is the one that would have been. */
void test_a_calibration_after_an_abort_is_that_of_a_fresh_start(void)
{
    kc_proposal_t fresh;
    for (uint32_t k = 0u; k < 2u; k++) {
        given_world();
        world.truth.joint[6].phi_rad = 0.2;
        world.kernel.choose = 1u;
        world.noise_m = world.noise_rad = 0.0;
        world_boot();
        world_tick();
        if (k == 1u) {
            (void)world_do(KC_CMD_START, -1, 0, 3);
            TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_POSE, 400u));
            TEST_ASSERT_TRUE(world_until(KC_ST_UPDATE, 400u));
            world_tick();
            (void)world_do(KC_CMD_ABORT, 0, 0, 0);
            memcpy(world.q_cmd, (double[KC_JOINT_MAX]){0}, sizeof world.q_cmd);
            world_ticks(40u);
        }
        (void)world_do(KC_CMD_START, -1, 0, 3);
        TEST_ASSERT_EQUAL_UINT32(0u, APP->est.n_free);
        for (uint32_t i = 0u; i < 4000u && world_calibrating(); i++) { world_tick(); }
        TEST_ASSERT_TRUE(world_stored(20u));
        TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
        if (k == 0u) { fresh = world.proposal; }
    }
    TEST_ASSERT_EQUAL_UINT32(fresh.rank, world.proposal.rank);
    TEST_ASSERT_EQUAL_UINT32(fresh.n_poses, world.proposal.n_poses);
    TEST_ASSERT_DOUBLE_WITHIN(1e-4, fresh.kin.value[24], world.proposal.kin.value[24]);
}

/* ---- tables ---- */

void test_a_step_has_time_for_one_large_table_only(void)
{
    given_largest(KC_ACQ_RANDOM);
    world_boot();
    world_tick();
    world_tick();
    APP->tables.staging.total = KC_IMAGE_MAX; /* what a large one is charged with; nothing is staged */
    (void)world_cmd(KC_CMD_TABLE_VALIDATE, KC_TBL_SPACE, 1, 0);
    (void)world_cmd(KC_CMD_TABLE_VALIDATE, KC_TBL_SPACE, 1, 0);
    world_tick();
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CMD_WORK));
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, world.ack.status);
    TEST_ASSERT_EQUAL_INT(KC_EVT_CMD_WORK, world.ack.event_id);
}
