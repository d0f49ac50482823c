/* kc_measure.c: frames averaged, covariance, what breaks a measurement off. */
#include <math.h>
#include <string.h>

#include "given_world.h"
#include "kc_vec.h"
#include "unity.h"

#define APP (&kc_app_instance)

static uint32_t s_n;

void setUp(void)
{
    given_world();
    s_n = 0u;
}

void test_a_frame_of_an_arm_that_moved_is_not_part_of_a_measurement(void)
{
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_OBSERVE, 300u));
    world.arm_vibrates = 3;
    TEST_ASSERT_TRUE(world_until(KC_ST_REST, 3u));
    TEST_ASSERT_EQUAL_UINT32(0u, APP->frames.n);
    TEST_ASSERT_TRUE(world_until(KC_ST_UPDATE, 600u));
    TEST_ASSERT_EQUAL_UINT32(3u, world.meas[0].n_frames);
    TEST_ASSERT_TRUE(world.n_frames > 3u);
}

/* Arm, or pan-tilt unit, moves once while the frame is awaited, and is at rest when it comes. */
void test_a_frame_during_which_something_moved_is_not_part_of_a_measurement(void)
{
    for (uint32_t who = 0u; who < 2u; who++) {
        given_world();
        world_started();
        TEST_ASSERT_TRUE(world_until(KC_ST_OBSERVE, 300u));
        for (uint32_t i = 0u; i < 2u && !world.requested; i++) { world_tick(); }
        TEST_ASSERT_TRUE(world.requested);
        world.requested = false; /* the answer takes two ticks longer */
        world.arm_vibrates = who == 0u ? 1 : 0;
        world.pantilt_vibrates = who == 1u ? 1 : 0;
        world_ticks(2u);
        TEST_ASSERT_EQUAL_INT(KC_ST_OBSERVE, kc_app_state(APP));
        TEST_ASSERT_TRUE(kc_view_at_rest(&APP->view));
        world.requested = true;
        TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 3u));
        TEST_ASSERT_EQUAL_UINT32(0u, APP->frames.n);
        TEST_ASSERT_TRUE(world_until(KC_ST_UPDATE, 600u));
        TEST_ASSERT_EQUAL_UINT32(3u, world.meas[0].n_frames);
        TEST_ASSERT_EQUAL_UINT32(4u, world.n_frames);
    }
}

static void unlike_the_first(kc_detection_t *d)
{
    if (s_n++ == 0u) { d->p_cam_tool_m[0] += 0.05; }
}

/* The frame of OBSERVE is off by far: what follows does not agree with it, and no mean of both is measured. */
void test_a_wrong_first_frame_is_not_averaged_with_good_ones(void)
{
    world.spoil = unlike_the_first;
    world.config.servo.tol_pos_m = 0.1; /* so that it is measured there at once */
    world_started();
    TEST_ASSERT_TRUE(world_until_event(KC_EVT_DET_JUMP, 300u));
    TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_CAND_SKIPPED, 300u));
    TEST_ASSERT_EQUAL_UINT32(0u, world.n_meas);
}
