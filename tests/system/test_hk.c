/* kc_hk.c: housekeeping once a second, with the true counters. */
#include <string.h>

#include "given_world.h"
#include "unity.h"

#define APP (&kc_app_instance)

void setUp(void);
void setUp(void) { given_world(); }

void test_housekeeping_comes_with_the_first_step_and_then_once_a_second(void)
{
    world_boot();
    world_tick();
    TEST_ASSERT_EQUAL_UINT32(1u, world.n_hk);
    world_ticks(50u);
    TEST_ASSERT_EQUAL_UINT32(6u, world.n_hk);
    TEST_ASSERT_EQUAL_INT(100000 + 6, world.hk.seq);
}

void test_it_reports_state_tables_and_counters(void)
{
    world_boot();
    world_tick();
    (void)world_do(KC_CMD_NOOP, 0, 0, 0);
    (void)world_do(99, 0, 0, 0);
    world.in.n_rx_errors = 7u;
    world_tick();
    world.in.n_rx_errors = 7u;
    for (uint32_t i = 0u; i < 10u; i++) {
        world.in.n_rx_errors = 7u;
        world_tick();
    }
    TEST_ASSERT_EQUAL_INT(KC_ST_IDLE, world.hk.state);
    TEST_ASSERT_EQUAL_UINT32(1u, world.hk.n_cmd_ok);
    TEST_ASSERT_EQUAL_UINT32(1u, world.hk.n_cmd_refused);
    TEST_ASSERT_EQUAL_UINT32(7u, world.hk.n_rx_errors);
    TEST_ASSERT_EQUAL_INT(KC_EVT_CMD_UNKNOWN, world.hk.last_event_id);
    TEST_ASSERT_EQUAL_UINT32(0u, world.hk.n_events_dropped);
    TEST_ASSERT_EQUAL_MEMORY(kc_app_active(APP)->crc, world.hk.table_crc, sizeof world.hk.table_crc);
    TEST_ASSERT_EQUAL_INT(-1, world.hk.boot_state);
    TEST_ASSERT_EQUAL_INT(0, world.hk.staged_kind);
}

void test_it_reports_the_staged_table(void)
{
    world_boot();
    world_tick();
    world.in.n_chunk = 1u;
    world.in.chunk[0].kind = KC_TBL_SPACE;
    world.in.chunk[0].total = 3000u;
    world.in.chunk[0].n = 1000u;
    world_ticks(11u);
    TEST_ASSERT_EQUAL_INT(KC_TBL_SPACE, world.hk.staged_kind);
    TEST_ASSERT_EQUAL_UINT32(1000u, world.hk.staged_bytes);
    TEST_ASSERT_EQUAL_INT(KC_STAGE_LOADING, world.hk.staged_state);
}

void test_it_follows_a_calibration(void)
{
    world.truth.joint[6].phi_rad = 0.1;
    world_calibrated();
    world_ticks(11u);
    TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, world.hk.state);
    TEST_ASSERT_EQUAL_UINT32(6u, world.hk.n_poses);
    TEST_ASSERT_EQUAL_UINT32(6u, world.hk.n_poses_goal);
    TEST_ASSERT_EQUAL_UINT32(6u, world.hk.n_meas);
    TEST_ASSERT_EQUAL_UINT32(1u, world.hk.session);
    TEST_ASSERT_EQUAL_UINT32(world.proposal.crc, world.hk.proposal_crc);
}

void test_counts_of_the_parts_are_in_the_next_report(void)
{
    given_world();
    world_boot();
    world_tick();
    APP->observe.servo_steps = 7u;
    APP->input.n_rejected = 3u;
    APP->cmd_log.n_ok = 5u;
    APP->cmd_log.n_refused = 2u;
    APP->plan.n_goal = 11u;
    uint32_t n = world.n_hk;
    for (uint32_t i = 0u; i < 600u && world.n_hk == n; i++) { world_tick(); }
    TEST_ASSERT_EQUAL_UINT32(n + 1u, world.n_hk);
    TEST_ASSERT_EQUAL_UINT32(7u, world.hk.servo_steps);
    TEST_ASSERT_EQUAL_UINT32(3u, world.hk.n_rejected);
    TEST_ASSERT_EQUAL_UINT32(5u, world.hk.n_cmd_ok);
    TEST_ASSERT_EQUAL_UINT32(2u, world.hk.n_cmd_refused);
    TEST_ASSERT_EQUAL_UINT32(11u, world.hk.n_poses_goal);
}
