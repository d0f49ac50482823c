/* kc_monitoring.c: when the monitor listens, and since when everything is at rest. What it finds: test_monitoring.c. */
#include "kc_monitoring.h"

#include "given_parts.h"
#include "unity.h"

#define FRESH_US 500000u

static kc_monitoring_t s_monitoring;

void setUp(void);
void setUp(void)
{
    given_parts();
    s_monitoring.resting = false;
    s_monitoring.rest_us = 1u;
    parts.telemetry.has_arm = parts.telemetry.has_pantilt = true;
    parts.telemetry.arm_ok_us = parts.telemetry.pantilt_ok_us = PARTS_NOW_US - FRESH_US;
}

static bool rests(void)
{
    kc_monitoring_rest(&s_monitoring, &parts.view);
    return s_monitoring.resting;
}

void test_it_is_at_rest_from_the_first_step_on_in_which_all_stand_still(void)
{
    TEST_ASSERT_TRUE(rests());
    TEST_ASSERT_EQUAL_UINT64(PARTS_NOW_US, s_monitoring.rest_us);
    parts.clock.now_us++;
    parts.telemetry.arm_ok_us = parts.telemetry.pantilt_ok_us = parts.clock.now_us;
    TEST_ASSERT_TRUE(rests());
    TEST_ASSERT_EQUAL_UINT64(PARTS_NOW_US, s_monitoring.rest_us);
}

void test_it_is_not_at_rest_where_something_moves_is_silent_or_faulty(void)
{
    for (uint32_t i = 0u; i < 7u; i++) {
        kc_telemetry_t *t = &parts.telemetry;
        setUp();
        switch (i) {
        case 0u: t->arm.moving = 1u; break;
        case 1u: t->pantilt.moving = 1u; break;
        case 2u: t->arm.fault_mask = 4; break;
        case 3u: t->has_arm = false; break;
        case 4u: t->has_pantilt = false; break;
        case 5u: t->arm_ok_us--; break;
        default: t->pantilt_ok_us--; break;
        }
        TEST_ASSERT_FALSE(rests());
        TEST_ASSERT_EQUAL_UINT64(1u, s_monitoring.rest_us);
    }
}
