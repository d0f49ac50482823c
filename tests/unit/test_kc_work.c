/* kc_work.h: what a step may still compute. */
#include "kc_work.h"

#include "unity.h"

void test_a_unit_that_does_not_fit_waits(void)
{
    kc_work_t w = {100u, 0u};
    TEST_ASSERT_TRUE(kc_work_take(&w, 60u));
    TEST_ASSERT_FALSE(kc_work_take(&w, 41u));
    TEST_ASSERT_TRUE(kc_work_take(&w, 40u));
    TEST_ASSERT_FALSE(kc_work_take(&w, 1u));
}

void test_a_unit_larger_than_a_step_is_done_alone(void)
{
    kc_work_t w = {100u, 0u};
    TEST_ASSERT_TRUE(kc_work_take(&w, 101u));
    TEST_ASSERT_FALSE(kc_work_take(&w, 1u));
    w = (kc_work_t){100u, 0u};
    kc_work_spend(&w, 1u);
    TEST_ASSERT_FALSE(kc_work_take(&w, 100u));
}

void test_what_was_not_used_is_given_back(void)
{
    kc_work_t w = {100u, 0u};
    (void)kc_work_take(&w, 90u);
    kc_work_return(&w, 50u);
    TEST_ASSERT_TRUE(kc_work_take(&w, 60u));
}
