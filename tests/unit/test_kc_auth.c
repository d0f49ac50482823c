/* kc_auth.c: MAC and verdict. */
#include <string.h>

#include "kc_auth.h"
#include "unity.h"

static uint8_t s_head[128], s_body[1024];

/* MACs of Python's hashlib.blake2b, which shares no code with ours; tests/oracle/test_auth.py has more, and holds that
 * against RFC 7693. */
static const struct {
    uint32_t n_head, n_body;
    uint8_t mac[KC_MAC_BYTES];
} s_known[] = {
    {0u,
     0u,
     {0xe2, 0xb5, 0x40, 0x39, 0xff, 0x14, 0x26, 0x96, 0x13, 0x39, 0x62, 0x44, 0x0a, 0xcf, 0xb9, 0x45}},
    {3u,
     0u,
     {0xf8, 0x7d, 0x23, 0xd1, 0x7b, 0x8f, 0xcb, 0xc5, 0x13, 0x07, 0xfb, 0x88, 0xed, 0x06, 0x48, 0xab}},
    {104u,
     0u,
     {0x3f, 0xe4, 0x28, 0x61, 0x35, 0xff, 0xf1, 0xc1, 0x1e, 0xe7, 0x3c, 0xa3, 0x0e, 0xa1, 0xac, 0x3e}},
    {104u,
     24u,
     {0xfc, 0xc3, 0x36, 0x96, 0x7b, 0x77, 0x4e, 0x45, 0x00, 0x6b, 0x3b, 0xe9, 0x4a, 0xef, 0x4e, 0x68}},
    {56u,
     1024u,
     {0xee, 0x54, 0xa6, 0x3f, 0x41, 0xed, 0x88, 0xc7, 0x04, 0xf1, 0x84, 0xd4, 0x56, 0x51, 0xbe, 0x47}},
};

static kc_keys_t given_keys(void)
{
    kc_keys_t keys = {.n = 2u, .key = {{.id = 5u}, {.id = 9u}}};
    for (uint32_t i = 0u; i < KC_KEY_BYTES; i++) {
        keys.key[0].secret[i] = (uint8_t)(i + 1u);
        keys.key[1].secret[i] = (uint8_t)(i + 2u);
    }
    for (uint32_t i = 0u; i < sizeof s_head; i++) { s_head[i] = (uint8_t)(7u * i + 1u); }
    for (uint32_t i = 0u; i < sizeof s_body; i++) { s_body[i] = (uint8_t)(5u * i + 3u); }
    return keys;
}

static const kc_auth_text_t s_text = {s_head, s_body, 104u, 1024u};

static kc_auth_t given_signed(const kc_key_t *key, uint64_t counter)
{
    kc_auth_t a = {.key_id = key->id, .counter = counter};
    kc_auth_mac(key, &s_text, a.mac);
    return a;
}

/* With this counter taken last, and no bounds on the stamp. */
static kc_auth_verdict_t check(const kc_keys_t *keys, const kc_auth_t *a, uint64_t last,
                               const kc_auth_text_t *text)
{
    const kc_auth_known_t known = {.last = last, .clock_us = 1000u};
    return kc_auth_check(keys, a, &known, 0u, text);
}

void test_macs_are_those_of_another_implementation(void)
{
    const kc_keys_t keys = given_keys();
    uint8_t mac[KC_MAC_BYTES];
    for (uint32_t i = 0u; i < sizeof s_known / sizeof s_known[0]; i++) {
        const kc_auth_text_t text = {s_head, s_body, s_known[i].n_head, s_known[i].n_body};
        kc_auth_mac(&keys.key[0], &text, mac);
        TEST_ASSERT_EQUAL_MEMORY(s_known[i].mac, mac, sizeof mac);
    }
}

void test_either_key_is_good_with_a_higher_counter(void)
{
    const kc_keys_t keys = given_keys();
    for (uint32_t k = 0u; k < 2u; k++) {
        kc_auth_t a = given_signed(&keys.key[k], 8u);
        TEST_ASSERT_EQUAL_INT(KC_AUTH_GOOD, check(&keys, &a, 7u, &s_text));
        TEST_ASSERT_EQUAL_INT(KC_AUTH_REPLAYED, check(&keys, &a, 8u, &s_text));
        TEST_ASSERT_EQUAL_INT(KC_AUTH_REPLAYED, check(&keys, &a, UINT64_MAX, &s_text));
    }
}

void test_what_is_not_signed_or_with_an_unknown_key_has_a_verdict_of_its_own(void)
{
    kc_keys_t keys = given_keys();
    kc_auth_t a = given_signed(&keys.key[1], 8u);
    keys.n = 1u; /* the second is retired */
    TEST_ASSERT_EQUAL_INT(KC_AUTH_UNKNOWN_KEY, check(&keys, &a, 0u, &s_text));
    keys.n = 0u;
    a.key_id = keys.key[0].id;
    TEST_ASSERT_EQUAL_INT(KC_AUTH_UNKNOWN_KEY, check(&keys, &a, 0u, &s_text));
    a.key_id = 0u;
    TEST_ASSERT_EQUAL_INT(KC_AUTH_UNSIGNED, check(&keys, &a, 0u, &s_text));
}

void test_a_mac_of_another_key_and_one_with_any_bit_flipped_is_forged(void)
{
    const kc_keys_t keys = given_keys();
    kc_auth_t a = given_signed(&keys.key[1], 8u);
    a.key_id = keys.key[0].id;
    TEST_ASSERT_EQUAL_INT(KC_AUTH_FORGED, check(&keys, &a, 0u, &s_text));
    a = given_signed(&keys.key[0], 8u);
    for (uint32_t bit = 0u; bit < 8u * KC_MAC_BYTES; bit++) {
        a.mac[bit / 8u] ^= (uint8_t)(1u << bit % 8u);
        TEST_ASSERT_EQUAL_INT(KC_AUTH_FORGED, check(&keys, &a, 0u, &s_text));
        a.mac[bit / 8u] ^= (uint8_t)(1u << bit % 8u);
    }
    TEST_ASSERT_EQUAL_INT(KC_AUTH_GOOD, check(&keys, &a, 0u, &s_text));
}

void test_a_text_with_any_bit_flipped_or_cut_off_is_forged(void)
{
    const kc_keys_t keys = given_keys();
    kc_auth_t a = given_signed(&keys.key[0], 8u);
    for (uint32_t bit = 0u; bit < 8u * (s_text.n_head + s_text.n_body); bit++) {
        uint32_t at = bit / 8u;
        uint8_t *byte = at < s_text.n_head ? &s_head[at] : &s_body[at - s_text.n_head];
        *byte ^= (uint8_t)(1u << bit % 8u);
        TEST_ASSERT_EQUAL_INT(KC_AUTH_FORGED, check(&keys, &a, 0u, &s_text));
        *byte ^= (uint8_t)(1u << bit % 8u);
    }
    for (uint32_t n = 0u; n < s_text.n_body; n++) {
        const kc_auth_text_t less = {s_head, s_body, s_text.n_head, n};
        TEST_ASSERT_EQUAL_INT(KC_AUTH_FORGED, check(&keys, &a, 0u, &less));
    }
    TEST_ASSERT_EQUAL_INT(KC_AUTH_GOOD, check(&keys, &a, 0u, &s_text));
}

void test_counters_step_by_less_than_a_wild_one(void)
{
    const kc_auth_known_t known = {.last = 7u};
    TEST_ASSERT_EQUAL_INT(KC_AUTH_REPLAYED, kc_auth_fresh(&known, 7u, 0u));
    TEST_ASSERT_EQUAL_INT(KC_AUTH_GOOD, kc_auth_fresh(&known, 8u, 0u));
    TEST_ASSERT_EQUAL_INT(KC_AUTH_GOOD, kc_auth_fresh(&known, 7u + KC_AUTH_JUMP_MAX, 0u));
    TEST_ASSERT_EQUAL_INT(KC_AUTH_JUMPED, kc_auth_fresh(&known, 8u + KC_AUTH_JUMP_MAX, 0u));
    TEST_ASSERT_EQUAL_INT(KC_AUTH_JUMPED, kc_auth_fresh(&known, UINT64_MAX, 0u));
    /* a sender that lost its count begins at the clock: 2100 is within reach of none at all */
    TEST_ASSERT_TRUE(KC_AUTH_JUMP_MAX > 130ull * 365u * 86400u * 1000000u);
}

void test_a_stamp_counts_from_a_time_on_and_within_an_age_of_now(void)
{
    const kc_auth_known_t known = {.since_us = 500u, .clock_us = 1000u, .age_max_us = 300u};
    const kc_auth_known_t ageless = {.since_us = 500u, .clock_us = 1000u};
    TEST_ASSERT_EQUAL_INT(KC_AUTH_BEFORE, kc_auth_fresh(&known, 1u, 499u));
    TEST_ASSERT_EQUAL_INT(KC_AUTH_OLD, kc_auth_fresh(&known, 1u, 699u));
    TEST_ASSERT_EQUAL_INT(KC_AUTH_GOOD, kc_auth_fresh(&known, 1u, 700u));
    TEST_ASSERT_EQUAL_INT(KC_AUTH_GOOD, kc_auth_fresh(&known, 1u, 1300u));
    TEST_ASSERT_EQUAL_INT(KC_AUTH_OLD, kc_auth_fresh(&known, 1u, 1301u));
    TEST_ASSERT_EQUAL_INT(KC_AUTH_OLD, kc_auth_fresh(&known, 1u, UINT64_MAX));
    TEST_ASSERT_EQUAL_INT(KC_AUTH_BEFORE, kc_auth_fresh(&ageless, 1u, 499u));
    TEST_ASSERT_EQUAL_INT(KC_AUTH_GOOD, kc_auth_fresh(&ageless, 1u, 500u));
    TEST_ASSERT_EQUAL_INT(KC_AUTH_GOOD, kc_auth_fresh(&ageless, 1u, UINT64_MAX));
    TEST_ASSERT_EQUAL_INT(KC_AUTH_REPLAYED, kc_auth_fresh(&known, 0u, 1000u));
}

/* The stamp of a message without a good MAC says nothing. */
void test_counter_and_stamp_are_judged_behind_the_mac(void)
{
    const kc_keys_t keys = given_keys();
    const kc_auth_known_t known = {.since_us = 500u, .clock_us = 1000u, .age_max_us = 300u};
    kc_auth_t a = given_signed(&keys.key[0], 8u);
    TEST_ASSERT_EQUAL_INT(KC_AUTH_BEFORE, kc_auth_check(&keys, &a, &known, 0u, &s_text));
    TEST_ASSERT_EQUAL_INT(KC_AUTH_OLD, kc_auth_check(&keys, &a, &known, 2000u, &s_text));
    TEST_ASSERT_EQUAL_INT(KC_AUTH_GOOD, kc_auth_check(&keys, &a, &known, 1000u, &s_text));
    a.mac[3] ^= 1u;
    TEST_ASSERT_EQUAL_INT(KC_AUTH_FORGED, kc_auth_check(&keys, &a, &known, 0u, &s_text));
}

void test_longer_texts_cost_more(void)
{
    TEST_ASSERT_TRUE(kc_auth_cost(0u) > 0u);
    TEST_ASSERT_TRUE(kc_auth_cost(1128u) > 3u * kc_auth_cost(104u));
}
