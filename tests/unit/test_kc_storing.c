/* kc_storing.c: how often storing is tried, and which copy counts. */
#include "kc_storing.h"
#include "unity.h"

void setUp(void) {}

void test_what_is_stored_is_done_and_a_failure_is_tried_as_often_as_allowed(void)
{
    TEST_ASSERT_EQUAL_INT(KC_STORING_DONE, kc_storing_next(KC_OK, 1u, 0u));
    TEST_ASSERT_EQUAL_INT(KC_STORING_DONE, kc_storing_next(KC_OK, 9u, 2u));
    TEST_ASSERT_EQUAL_INT(KC_STORING_REFUSE, kc_storing_next(KC_ERR_NUM, 1u, 0u));
    TEST_ASSERT_EQUAL_INT(KC_STORING_AGAIN, kc_storing_next(KC_ERR_NUM, 2u, 2u));
    TEST_ASSERT_EQUAL_INT(KC_STORING_REFUSE, kc_storing_next(KC_ERR_CRC, 3u, 2u));
}

void test_only_what_the_journal_names_counts_if_there_is_a_journal(void)
{
    TEST_ASSERT_TRUE(kc_storing_counts(true, 5u, 5u));
    TEST_ASSERT_FALSE(kc_storing_counts(true, 5u, 6u));
    TEST_ASSERT_FALSE(kc_storing_counts(true, 0u, 6u));
    TEST_ASSERT_TRUE(kc_storing_counts(false, 5u, 6u));
}
