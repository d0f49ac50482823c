/* kc_holder.c: whose a key is, and which of two steps it may take. Approvals by two persons: test_holder.c. */
#include "kc_holder.h"

#include "given_parts.h"
#include "unity.h"

static kc_config_t *s_config;

void setUp(void)
{
    given_parts();
    s_config = &parts.tables.active.config;
    s_config->go_by_other_key = 1u;
}

void test_keys_with_the_same_hundreds_are_one_holders(void)
{
    TEST_ASSERT_TRUE(kc_holder_same(1u, 99u));
    TEST_ASSERT_FALSE(kc_holder_same(99u, 100u));
    TEST_ASSERT_TRUE(kc_holder_same(101u, 199u));
    TEST_ASSERT_FALSE(kc_holder_same(1u, 2147483647u));
    kc_keys_t keys = {.n = 2u, .key = {{.id = 1u}, {.id = 2u}, {.id = 101u}}};
    TEST_ASSERT_FALSE(kc_holder_two(&keys)); /* the third is not in the file */
    keys.n = 3u;
    TEST_ASSERT_TRUE(kc_holder_two(&keys));
    keys.n = 0u;
    TEST_ASSERT_FALSE(kc_holder_two(&keys));
}

void test_two_holders_are_possible_with_keys_of_both_or_where_nobody_asks_for_them(void)
{
    kc_keys_t keys = {.n = 2u, .key = {{.id = 1u}, {.id = 101u}}};
    expect_taken(kc_holder_possible(s_config, &keys, &parts.out), KC_OC_STAY);
    keys.key[1].id = 2u;
    expect_refused(kc_holder_possible(s_config, &keys, &parts.out), KC_ERR_STATE, KC_EVT_KEYS_ONE_HOLDER, -1,
                   2.0, 0.0);
    s_config->go_by_other_key = 0u;
    expect_taken(kc_holder_possible(s_config, &keys, &parts.out), KC_OC_STAY);
}

void test_the_second_step_is_refused_to_the_holder_of_the_first(void)
{
    const kc_cmd_t cmd = {.opcode = KC_CMD_APPROVE_GO, .auth = {.key_id = 102u}};
    expect_taken(kc_holder_second(s_config, 1u, &cmd, &parts.out), KC_OC_STAY);
    expect_refused(kc_holder_second(s_config, 101u, &cmd, &parts.out), KC_ERR_AUTH, KC_EVT_CMD_SAME_KEY,
                   KC_CMD_APPROVE_GO, 102.0, 101.0);
    s_config->go_by_other_key = 0u;
    expect_taken(kc_holder_second(s_config, 101u, &cmd, &parts.out), KC_OC_STAY);
}
