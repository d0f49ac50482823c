/* kc_status.c: every status has its own name. */
#include <string.h>

#include "kc_status.h"
#include "unity.h"

void test_every_status_has_a_name_of_its_own(void)
{
    for (int a = KC_ERR_AUTH; a <= KC_OK; a++) {
        const char *name = kc_status_name((kc_status_t)a);
        TEST_ASSERT_EQUAL_STRING_LEN("KC_", name, 3);
        TEST_ASSERT_NULL(strchr(name, '?'));
        for (int b = KC_ERR_AUTH; b < a; b++) {
            TEST_ASSERT_TRUE(strcmp(name, kc_status_name((kc_status_t)b)) != 0);
        }
    }
}

void test_an_unknown_status_is_called_so(void)
{
    int beyond = KC_ERR_AUTH - 1;
    kc_status_t st;
    memcpy(&st, &beyond, sizeof st);
    TEST_ASSERT_EQUAL_STRING("KC_ERR_?", kc_status_name(st));
}
