/* kc_app.c: whole calibrations through the only door, through restarts and wrong clocks. What a start takes and a step
 * does: test_kc_app.c. */
#include <math.h>
#include <string.h>

#include "given_world.h"
#include "unity.h"

#define APP (&kc_app_instance)

void setUp(void) { given_world(); }

static void make_arm_wrong(void)
{
    world.truth.joint[1].alpha_rad += 0.05;
    world.truth.joint[2].a_m += 0.01;
    world.truth.joint[2].d_m += 0.02;
    world.truth.joint[6].phi_rad += 0.2;
}

/* ---- whole calibrations ---- */

void test_an_arm_with_dh_errors_is_calibrated_and_the_correction_waits_for_review(void)
{
    make_arm_wrong();
    world.config.n_poses = 8u;
    world_calibrated();
    TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(8u, world.n_meas);
    TEST_ASSERT_EQUAL_UINT32(8u, world.n_progress);
    TEST_ASSERT_EQUAL_UINT32(1u, world.n_proposal);
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_CHANGE, world.proposal.verdict);
    TEST_ASSERT_DOUBLE_WITHIN(0.005, 0.05, world.proposal.kin.value[5]);
    TEST_ASSERT_DOUBLE_WITHIN(0.003, 0.01, world.proposal.kin.value[10]);
    TEST_ASSERT_DOUBLE_WITHIN(0.003, 0.02, world.proposal.kin.value[11]);
    TEST_ASSERT_DOUBLE_WITHIN(0.005, 0.2, world.proposal.kin.value[24]);
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_COR_PROPOSED));
    TEST_ASSERT_TRUE(world.progress[7].res_pos_m < 0.1 * world.progress[0].res_pos_m);
    TEST_ASSERT_EQUAL_UINT32(28u, world.progress[7].n_free); /* as CONFIG requests */
    TEST_ASSERT_EQUAL_UINT32(0u, APP->input.n_rejected);
}

void test_a_healthy_arm_needs_no_change_and_says_so(void)
{
    world.config.n_poses = 8u;
    world_calibrated();
    TEST_ASSERT_EQUAL_INT(KC_ST_IDLE, kc_app_state(APP));
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_NO_CHANGE, world.proposal.verdict);
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_COR_NO_CHANGE));
    TEST_ASSERT_EQUAL_UINT32(0u, world.hk.proposal_crc);
}

void test_equal_inputs_give_equal_bytes_out(void)
{
    static kc_meas_t first[KC_MEAS_MAX];
    static kc_proposal_t proposal;
    make_arm_wrong();
    world_calibrated();
    memcpy(first, world.meas, sizeof first);
    proposal = world.proposal;
    given_world();
    make_arm_wrong();
    world_calibrated();
    TEST_ASSERT_EQUAL_MEMORY(first, world.meas, sizeof first);
    TEST_ASSERT_EQUAL_MEMORY(&proposal, &world.proposal, sizeof proposal);
}

/* ---- loading and booting ---- */

void test_killed_while_calibrating_it_comes_back_safe_and_says_what_it_was_doing(void)
{
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 200u));
    world_tick();
    world_restart();
    world_tick();
    TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_BOOT_INTERRUPTED));
    TEST_ASSERT_EQUAL_DOUBLE((double)KC_ST_MEASURE, world.last[KC_EVT_BOOT_INTERRUPTED].got);
    TEST_ASSERT_EQUAL_INT(KC_ST_MEASURE, world.hk.boot_state);
    TEST_ASSERT_EQUAL_INT(0, world.hk.boot_pose);
    TEST_ASSERT_EQUAL_UINT32(2u, world.hk.boot_count);
    TEST_ASSERT_EQUAL_INT(1, world.arm_cmd.hold);
    /* and once more: it is still SAFE, nothing new was lost */
    world_restart();
    world_tick();
    TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_BOOT_INTERRUPTED));
    TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, world.hk.boot_state);
}

void test_killed_in_mid_move_it_can_start_again_from_the_segment_it_stands_on(void)
{
    world_started();
    world_ticks(3u);
    TEST_ASSERT_EQUAL_INT(KC_ST_MOVE, kc_app_state(APP));
    world_restart();
    world_ticks(2u);
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_START, -1, 0, 3));
    TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 200u));
}

void test_a_proposal_survives_a_restart_and_can_be_approved_then(void)
{
    make_arm_wrong();
    world_calibrated();
    uint32_t crc = world.proposal.crc;
    world_restart();
    world_tick();
    TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_BOOT_REVIEW));
    TEST_ASSERT_EQUAL_UINT32(crc, world.hk.proposal_crc);
    (void)world_approve();
    TEST_ASSERT_EQUAL_UINT32(crc, world_kin_crc());
    world_restart();
    world_tick();
    TEST_ASSERT_EQUAL_UINT32(crc, world_kin_crc());
    TEST_ASSERT_EQUAL_INT(KC_ST_IDLE, kc_app_state(APP));
}

/* ---- steps ---- */

/* What the component's clock does while the arm's goes on: steps back, ahead for one tick, stands still, creeps. */
static void clock_goes_wrong(int how)
{
    if (how == 0) { world.skew_us = -60000000; }
    if (how == 1) { world.skew_us = world.skew_us == 0 ? 3600000000 : 0; }
    if (how == 2) { world.skew_us -= (int64_t)TICK_US; }
    if (how == 3) { world.skew_us -= (int64_t)TICK_US - 1; }
}

void test_a_fault_holds_the_arm_within_two_ticks_whatever_the_clock_does(void)
{
    for (int how = 0; how < 4; how++) {
        for (int later = 0; later < 15; later += 7) {
            given_world();
            world.now_us = 100000000u;
            world_started();
            world_ticks(3u);
            for (int i = 0; i < later; i++) {
                clock_goes_wrong(how);
                world_tick();
            }
            clock_goes_wrong(how);
            world.fault = 2;
            world_ticks(2u);
            TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
            TEST_ASSERT_EQUAL_INT(1, world.arm_cmd.hold);
            TEST_ASSERT_EQUAL_DOUBLE((double)KC_CAUSE_ARM_FAULT, world.last[KC_EVT_CAL_ABORTED].got);
        }
    }
}

void test_a_silent_arm_is_noticed_whatever_the_clock_does(void)
{
    for (int how = 0; how < 4; how++) {
        given_world();
        world.now_us = 100000000u;
        world_started();
        world_ticks(3u);
        world.arm_silent = true;
        for (uint32_t i = 0u; i < 22u; i++) {
            clock_goes_wrong(how);
            world_tick();
        }
        TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
        TEST_ASSERT_EQUAL_DOUBLE((double)KC_CAUSE_SILENT, world.last[KC_EVT_CAL_ABORTED].got);
    }
}

void test_after_a_wrong_hour_it_works_again_within_two_seconds(void)
{
    for (int both = 0; both < 2; both++) { /* the clock of all, or the component's alone */
        given_world();
        world.now_us = 100000000u;
        world_boot();
        world_ticks(3u);
        if (both) {
            world.now_us += 3600000000u;
        } else {
            world.skew_us = 3600000000;
        }
        world_tick();
        if (both) {
            world.now_us -= 3600000000u;
        } else {
            world.skew_us = 0;
        }
        uint32_t n_hk = world.n_hk;
        world_ticks(20u);
        TEST_ASSERT_TRUE(world.n_hk > n_hk);
        TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_START, -1, 0, 0));
    }
}

void test_a_calibration_goes_on_when_all_clocks_are_set_back(void)
{
    world.now_us = 100000000u;
    world_started();
    world_ticks(10u);
    world.now_us -= 60000000u;
    TEST_ASSERT_TRUE(world_until(KC_ST_REVIEW, 20000u) || kc_app_state(APP) == KC_ST_IDLE);
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_CAL_ABORTED));
}

void test_abort_holds_the_arm_and_goes_safe_from_every_state(void)
{
    static const kc_state_t states[] = {KC_ST_MOVE,    KC_ST_AIM,     KC_ST_SETTLE,
                                        KC_ST_OBSERVE, KC_ST_MEASURE, KC_ST_UPDATE};
    for (uint32_t i = 0u; i < sizeof states / sizeof states[0]; i++) {
        given_world();
        world_started();
        world.pantilt_frozen = states[i] == KC_ST_AIM;
        TEST_ASSERT_TRUE(world_until(states[i], 300u));
        TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_ABORT, 0, 0, 0));
        TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
        TEST_ASSERT_EQUAL_INT(1, world.arm_cmd.hold);
        TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_ABORTED));
        TEST_ASSERT_EQUAL_INT(states[i] == KC_ST_UPDATE, world.last[KC_EVT_CAL_ABORTED].index);
    }
    given_world();
    world_boot();
    world_tick();
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_ABORT, 0, 0, 0));
    TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
    TEST_ASSERT_EQUAL_INT(-1, world.last[KC_EVT_CAL_ABORTED].index);
}

/* ---- found missing by mutants ---- */

/* The arm may be on its way: without a journal nobody knows, and IDLE sent no hold. */
void test_killed_while_moving_and_with_the_journal_lost_the_arm_is_held(void)
{
    for (int lost = 0; lost < 2; lost++) {
        setUp();
        world_started();
        TEST_ASSERT_TRUE(world_until(KC_ST_MOVE, 300u));
        world_ticks(2u);
        for (uint32_t k = 0u; lost && k < 2u; k++) { world.store[KC_STORE_JOURNAL][k][20] ^= 1u; }
        world_restart();
        world_tick();
        TEST_ASSERT_EQUAL_UINT32(lost ? 1u : 0u, world_events(KC_EVT_BOOT_JOURNAL_LOST));
        TEST_ASSERT_EQUAL_INT(KC_ST_SAFE, kc_app_state(APP));
        TEST_ASSERT_TRUE(world.out.has_arm_cmd && world.arm_cmd.hold);
    }
}
