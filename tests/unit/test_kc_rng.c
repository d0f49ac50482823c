/* kc_rng.c: published values, ranges, no bias. */
#include "kc_rng.h"
#include "unity.h"

void test_seed_1234567_gives_the_published_sequence(void)
{
    /* First outputs of splitmix64 for this seed, as published with the generator. */
    static const uint64_t want[5] = {6457827717110365317u, 3203168211198807973u, 9817491932198370423u,
                                     4593380528125082431u, 16408922859458223821u};
    uint64_t state = 1234567u;
    for (int i = 0; i < 5; i++) { TEST_ASSERT_EQUAL_UINT64(want[i], kc_rng_next(&state)); }
}

void test_the_state_is_all_there_is(void)
{
    uint64_t a = 42u, b;
    (void)kc_rng_next(&a);
    b = a;
    for (int i = 0; i < 10; i++) { TEST_ASSERT_EQUAL_UINT64(kc_rng_next(&a), kc_rng_next(&b)); }
}

void test_uniform_stays_in_its_interval_and_fills_it(void)
{
    uint64_t state = 7u;
    double sum = 0.0, least = 1.0, most = 0.0;
    for (int i = 0; i < 10000; i++) {
        const double u = kc_rng_uniform(&state);
        TEST_ASSERT_TRUE(u >= 0.0 && u < 1.0);
        sum += u;
        least = u < least ? u : least;
        most = u > most ? u : most;
    }
    TEST_ASSERT_DOUBLE_WITHIN(0.01, 0.5, sum / 10000.0);
    TEST_ASSERT_TRUE(least < 0.001 && most > 0.999);
}

void test_below_is_even_and_in_range(void)
{
    uint64_t state = 1u;
    uint32_t count[7] = {0};
    for (int i = 0; i < 70000; i++) {
        const uint32_t k = kc_rng_below(&state, 7u);
        TEST_ASSERT_TRUE(k < 7u);
        count[k]++;
    }
    for (int k = 0; k < 7; k++) { TEST_ASSERT_UINT32_WITHIN(500u, 10000u, count[k]); }
}

void test_below_rejects_draws_that_would_favour_small_numbers(void)
{
    /* n just above 2^31: nearly half of all draws lie above its one multiple. */
    const uint32_t n = 0x80000001u;
    uint64_t state = 5u, same = 5u;
    uint32_t refused = 0u;
    for (int i = 0; i < 1000; i++) {
        const uint32_t k = kc_rng_below(&state, n);
        TEST_ASSERT_TRUE(k < n);
        while ((uint32_t)(kc_rng_next(&same) >> 32) >= n) { refused++; }
        TEST_ASSERT_EQUAL_UINT64(same, state);
    }
    TEST_ASSERT_UINT32_WITHIN(150u, 1000u, refused);
}

void test_below_zero_or_one_is_zero(void)
{
    uint64_t state = 9u;
    TEST_ASSERT_EQUAL_UINT32(0u, kc_rng_below(&state, 0u));
    TEST_ASSERT_EQUAL_UINT64(9u, state);
    TEST_ASSERT_EQUAL_UINT32(0u, kc_rng_below(&state, 1u));
}
