/* kc_view.c: stamps of the mission clock as elapsed time, also where they do not fit. */
#include <stdint.h>

#include "kc_view.h"
#include "unity.h"

static uint64_t elapsed(uint64_t now_us, uint64_t clock_us, uint64_t stamp_us)
{
    kc_clock_t clock = {.now_us = now_us, .clock_us = clock_us};
    kc_view_t view = {.clock = &clock};
    return kc_view_elapsed(&view, stamp_us);
}

void test_a_stamp_is_as_far_from_now_as_from_the_clock(void)
{
    TEST_ASSERT_EQUAL_UINT64(1000u, elapsed(1000u, 5000000u, 5000000u));
    TEST_ASSERT_EQUAL_UINT64(900u, elapsed(1000u, 5000000u, 4999900u));
    TEST_ASSERT_EQUAL_UINT64(1100u, elapsed(1000u, 5000000u, 5000100u));
}

void test_a_stamp_before_the_start_is_as_old_as_the_start(void)
{
    TEST_ASSERT_EQUAL_UINT64(0u, elapsed(1000u, 5000000u, 4999000u));
    TEST_ASSERT_EQUAL_UINT64(0u, elapsed(1000u, 5000000u, 1u));
}

void test_a_stamp_beyond_all_time_does_not_come_round_to_the_start(void)
{
    TEST_ASSERT_EQUAL_UINT64(UINT64_MAX, elapsed(1000u, 1u, UINT64_MAX));
    TEST_ASSERT_EQUAL_UINT64(UINT64_MAX, elapsed(1000u, 1u, UINT64_MAX - 999u));
}
