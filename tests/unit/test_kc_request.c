/* kc_request.c: when a frame is asked for, and what polling gives, call by call. */
#include "kc_request.h"

#include <string.h>

#include "given_parts.h"
#include "unity.h"

#define SEQ 40
#define RETRIES 2u

static kc_request_t s_request;

void setUp(void)
{
    given_parts();
    parts.tables.active.config.frame_retries = RETRIES;
    memset(&s_request, 0xff, sizeof s_request);
    kc_request_boot(&s_request, SEQ);
    kc_request_begin(&s_request);
}

/* What polling gives, and the number of the frame it asks for (0: none). */
static void polled(kc_frame_t frame, int32_t asked)
{
    TEST_ASSERT_EQUAL_INT(frame, kc_request_poll(&s_request, &parts.view, &parts.out));
    TEST_ASSERT_EQUAL_INT(asked != 0, parts.out.has_frame_request);
    TEST_ASSERT_EQUAL_INT32(asked, parts.out.frame_request.seq);
    parts.out.has_frame_request = 0u;
    parts.out.frame_request.seq = 0;
}

static void came(uint32_t n_tags, bool certain)
{
    const kc_detection_t det = {.n_tags = n_tags, .seq = 7};
    kc_request_answer(&s_request, &det, certain);
    TEST_ASSERT_EQUAL_MEMORY(&det, &s_request.det, sizeof det);
}

void test_a_frame_is_asked_for_once_with_the_next_number(void)
{
    polled(KC_FRAME_NONE, SEQ + 1);
    TEST_ASSERT_EQUAL_UINT64(PARTS_NOW_US, s_request.asked_us);
    polled(KC_FRAME_NONE, 0);
}

void test_what_came_is_given_once_and_then_the_next_frame_is_asked_for(void)
{
    polled(KC_FRAME_NONE, SEQ + 1);
    came(2u, true);
    polled(KC_FRAME_DETECTED, 0);
    polled(KC_FRAME_NONE, SEQ + 2);
    came(0u, true);
    polled(KC_FRAME_NO_TAGS, 0);
    polled(KC_FRAME_NONE, SEQ + 3);
    came(0u, false);
    polled(KC_FRAME_NO_TAGS, 0);
}

void test_an_uncertain_frame_is_asked_for_again_as_often_as_config_says(void)
{
    for (int32_t time = 0; time < 2; time++) { /* all retries again after a new beginning */
        kc_request_begin(&s_request);
        polled(KC_FRAME_NONE, SEQ + 3 * time + 1);
        for (int32_t i = 2; i < 4; i++) {
            came(1u, false);
            polled(KC_FRAME_NONE, SEQ + 3 * time + i);
        }
        came(1u, false);
        polled(KC_FRAME_UNCERTAIN, 0);
    }
    polled(KC_FRAME_NONE, SEQ + 7);
}

void test_a_frame_that_does_not_come_in_time_is_asked_for_again(void)
{
    const uint64_t timeout_us = parts.tables.active.config.frame_timeout_us;
    polled(KC_FRAME_NONE, SEQ + 1);
    for (int32_t i = 1; i <= 3; i++) {
        parts.clock.now_us += timeout_us;
        polled(KC_FRAME_NONE, 0);
        parts.clock.now_us++;
        polled(i < 3 ? KC_FRAME_NONE : KC_FRAME_TIMEOUT, i < 3 ? SEQ + 1 + i : 0);
        expect_event(KC_EVT_CAL_FRAME_TIMEOUT, -1, (double)timeout_us + 1.0, 0.0);
    }
}

void test_what_is_dropped_is_asked_for_anew_and_fails_stay_counted(void)
{
    polled(KC_FRAME_NONE, SEQ + 1);
    for (uint32_t i = 0u; i < RETRIES; i++) { TEST_ASSERT_TRUE(kc_request_retry(&s_request, &parts.view)); }
    kc_request_drop(&s_request);
    polled(KC_FRAME_NONE, SEQ + 2);
    TEST_ASSERT_FALSE(kc_request_retry(&s_request, &parts.view));
}

void test_a_move_during_a_frame_is_remembered_until_the_next_one(void)
{
    for (uint8_t arm = 0u; arm < 2u; arm++) {
        polled(KC_FRAME_NONE, SEQ + 1 + arm);
        polled(KC_FRAME_NONE, 0);
        TEST_ASSERT_FALSE(s_request.moved);
        parts.telemetry.arm.moving = arm;
        parts.telemetry.pantilt.moving = !arm;
        polled(KC_FRAME_NONE, 0);
        parts.telemetry.arm.moving = parts.telemetry.pantilt.moving = 0u;
        came(1u, true);
        polled(KC_FRAME_DETECTED, 0);
        TEST_ASSERT_TRUE(s_request.moved);
    }
}
