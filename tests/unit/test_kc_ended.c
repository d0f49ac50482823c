/* kc_ended.c: every reason has its words. */
#include <string.h>

#include "kc_ended.h"
#include "unity.h"

void setUp(void) {}

void test_every_reason_has_words_of_its_own(void)
{
    for (int32_t a = 1; a < (int32_t)KC_ENDED_COUNT; a++) {
        TEST_ASSERT_TRUE(strlen(kc_ended_text(a)) > 10u);
        for (int32_t b = 1; b < a; b++) { TEST_ASSERT_TRUE(strcmp(kc_ended_text(a), kc_ended_text(b)) != 0); }
    }
    TEST_ASSERT_EQUAL_STRING("the time budget is used up", kc_ended_text(KC_ENDED_TIME));
}

void test_other_numbers_have_none(void)
{
    TEST_ASSERT_EQUAL_STRING("", kc_ended_text(KC_ENDED_NOT));
    TEST_ASSERT_EQUAL_STRING("", kc_ended_text(-1));
    TEST_ASSERT_EQUAL_STRING("", kc_ended_text((int32_t)KC_ENDED_COUNT));
}
