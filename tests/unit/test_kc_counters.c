/* kc_counters.c: counters of each key, and which key loses its place. */
#include <stddef.h>
#include <string.h>

#include "kc_counters.h"
#include "unity.h"

static kc_counters_t s_c;

void setUp(void) { memset(&s_c, 0, sizeof s_c); }

#define OTHER_A 1001u /* two keys of another holder, in every file: two places are left */
#define OTHER_B 1002u

/* A start with these keys at a time, 0: none. */
static void start(uint32_t a, uint32_t b, uint64_t clock_us)
{
    kc_keys_t keys = {.key = {{.id = OTHER_A}, {.id = OTHER_B}, {.id = a}, {.id = b}}};
    keys.n = a == 0u ? 0u : 3u + (b != 0u ? 1u : 0u);
    kc_counters_begin(&s_c, &keys);
    kc_counters_clock(&s_c, clock_us);
}

static void take(uint32_t key, uint64_t counter)
{
    const kc_auth_t a = {.key_id = key, .counter = counter};
    kc_counters_take(&s_c, &a, KC_SIGNED_CMD, 2);
}

static void expect(uint32_t key, uint64_t counter, uint64_t since_us)
{
    const kc_counted_t *k = kc_counters_of(&s_c, key);
    TEST_ASSERT_NOT_NULL(k);
    TEST_ASSERT_EQUAL_UINT64(counter, k->last[KC_SIGNED_CMD][1]);
    TEST_ASSERT_EQUAL_UINT64(since_us, k->since_us);
    TEST_ASSERT_EQUAL_UINT64(0u, k->last[KC_SIGNED_CMD][0]);
    TEST_ASSERT_EQUAL_UINT64(0u, k->last[KC_SIGNED_CHUNK][1]);
}

void test_two_keys_rotate_again_and_again_and_each_keeps_its_counters(void)
{
    start(1u, 0u, 10u);
    take(1u, 100u);
    for (uint32_t k = 1u; k < 9u; k++) {
        start(k, k + 1u, 100u * k);
        expect(k, 100u * k, k == 1u ? 10u : 100u * (k - 1u));
        expect(k + 1u, 0u, 100u * k);
        take(k + 1u, 100u * (k + 1u));
        start(k + 1u, 0u, 100u * k + 50u);
        expect(k + 1u, 100u * (k + 1u), 100u * k);
        TEST_ASSERT_NOT_NULL(kc_counters_of(&s_c, k)); /* until its place is needed */
    }
    TEST_ASSERT_NULL(kc_counters_of(&s_c, 1u));
    TEST_ASSERT_NULL(kc_counters_of(&s_c, 0u));
}

void test_a_start_without_keys_or_with_the_file_before_loses_nothing(void)
{
    start(1u, 0u, 10u);
    take(1u, 100u);
    start(0u, 0u, 20u);
    expect(1u, 100u, 10u);
    start(7u, 0u, 30u); /* a wrong file */
    expect(7u, 0u, 30u);
    start(1u, 0u, 40u);
    expect(1u, 100u, 10u);
}

void test_the_key_with_the_lowest_number_that_is_not_in_the_file_loses_its_place(void)
{
    start(5u, 3u, 10u);
    start(9u, 0u, 20u);
    TEST_ASSERT_NULL(kc_counters_of(&s_c, 3u));
    expect(5u, 0u, 10u);
    start(3u, 9u, 30u); /* it is in the file, though lower */
    expect(9u, 0u, 20u);
    expect(3u, 0u, 30u); /* it begins anew, and what was made before counts no more */
    start(3u, 11u, 40u);
    expect(3u, 0u, 30u);
    expect(11u, 0u, 40u);
}

/* Wherever in the file it stands. */
void test_a_key_in_the_file_keeps_its_place_though_it_is_the_lowest(void)
{
    kc_keys_t keys = {.n = KC_KEY_MAX, .key = {{.id = 1u}, {.id = 2u}, {.id = 3u}, {.id = 4u}}};
    for (uint32_t at = 0u; at < 2u; at++) {
        setUp();
        kc_counters_begin(&s_c, &keys);
        const kc_keys_t then = {.n = 2u, .key = {{.id = at == 0u ? 1u : 5u}, {.id = at == 0u ? 5u : 1u}}};
        kc_counters_begin(&s_c, &then);
        TEST_ASSERT_NOT_NULL(kc_counters_of(&s_c, 1u));
        TEST_ASSERT_NOT_NULL(kc_counters_of(&s_c, 5u));
        TEST_ASSERT_NULL(kc_counters_of(&s_c, 2u));
    }
}

void test_a_clock_that_ran_ahead_locks_nobody_out(void)
{
    start(1u, 0u, 1000u);
    kc_counters_clock(&s_c, 2000u);
    expect(1u, 0u, 1000u);
    kc_counters_clock(&s_c, 400u);
    expect(1u, 0u, 400u);
    kc_counters_clock(&s_c, 3000u);
    expect(1u, 0u, 400u);
}

void test_a_key_without_a_place_has_no_counters(void)
{
    start(1u, 0u, 10u);
    TEST_ASSERT_NULL(kc_counters_of(&s_c, 0u)); /* there is a free place */
    take(2u, 50u);
    take(0u, 50u);
    TEST_ASSERT_NULL(kc_counters_of(&s_c, 2u));
    expect(1u, 0u, 10u);
}
