/* kc_rest.c: how long everything has to stand still, and how long it may take. */
#include "kc_rest.h"

#include <string.h>

#include "given_tables.h"
#include "kc_input_fields.h"
#include "unity.h"

#define SETTLE_US 1000000u
#define MOVE_US 5000000u

static kc_active_t s_tables;
static kc_telemetry_t s_heard;
static kc_clock_t s_clock;
static kc_place_t s_place;
static const kc_view_t s_view = {
    .clock = &s_clock, .place = &s_place, .tables = &s_tables, .telemetry = &s_heard};
static kc_out_t s_out;
static kc_rest_t s_rest;

void setUp(void);
void setUp(void)
{
    s_tables.config.settle_us = SETTLE_US;
    s_tables.config.move_timeout_us = MOVE_US;
    memset(&s_heard, 0, sizeof s_heard);
    memset(&s_out, 0, sizeof s_out);
    s_rest = (kc_rest_t){true, 0u}; /* of the candidate before */
    s_place.since_us = 7000000u;
    kc_rest_begin(&s_rest);
}

/* So long after the state began, with what moves. */
static kc_outcome_t at(uint64_t us, uint8_t arm_moves, uint8_t pantilt_moves)
{
    s_clock.now_us = s_place.since_us + us;
    s_heard.arm.moving = arm_moves;
    s_heard.pantilt.moving = pantilt_moves;
    return kc_rest_run(&s_rest, &s_view, &s_out);
}

void test_it_is_done_when_all_has_stood_still_for_the_time_of_config(void)
{
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, at(0u, 0, 0).id);
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, at(SETTLE_US - 1u, 0, 0).id);
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, at(SETTLE_US, 0, 0).id);
}

void test_whatever_moves_begins_the_time_again(void)
{
    for (uint8_t arm = 0u; arm < 2u; arm++) {
        kc_rest_begin(&s_rest);
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, at(0u, 0, 0).id);
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, at(900000u, arm, !arm).id);
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, at(1500000u, 0, 0).id);
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, at(2499999u, 0, 0).id);
        TEST_ASSERT_EQUAL_INT(KC_OC_DONE, at(2500000u, 0, 0).id);
    }
}

void test_what_moves_too_long_is_named(void)
{
    static const int32_t input[] = {KC_INPUT_ARM, KC_INPUT_PANTILT};
    static const kc_cause_t cause[] = {KC_CAUSE_ARM_LATE, KC_CAUSE_PANTILT_LATE};
    for (uint8_t k = 0u; k < 2u; k++) {
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, at(SETTLE_US + MOVE_US, !k, k).id);
        TEST_ASSERT_EQUAL_UINT32(k, s_out.events.n);
        kc_outcome_t end = at(SETTLE_US + MOVE_US + 1u, !k, k);
        TEST_ASSERT_EQUAL_INT(KC_OC_ABORT, end.id);
        TEST_ASSERT_EQUAL_INT(cause[k], end.cause);
        TEST_ASSERT_EQUAL_UINT16(KC_EVT_CAL_MOVE_TIMEOUT, s_out.events.e[k].id);
        TEST_ASSERT_EQUAL_INT32(input[k], s_out.events.e[k].index);
        TEST_ASSERT_EQUAL_DOUBLE(SETTLE_US + MOVE_US + 1.0, s_out.events.e[k].got);
    }
}
