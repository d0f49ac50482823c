/* kc_crc.c: the check value of the CRC catalogue, continuation, sensitivity. */
#include "kc_crc.h"
#include "unity.h"

void test_the_catalogue_check_value_comes_out(void)
{
    TEST_ASSERT_EQUAL_HEX32(0xCBF43926u, kc_crc32(0u, "123456789", 9u));
}

void test_nothing_has_the_crc_it_started_from(void)
{
    TEST_ASSERT_EQUAL_HEX32(0u, kc_crc32(0u, "", 0u));
    TEST_ASSERT_EQUAL_HEX32(0x12345678u, kc_crc32(0x12345678u, "", 0u));
}

void test_parts_continue_to_the_crc_of_the_whole(void)
{
    for (uint32_t cut = 0u; cut <= 9u; cut++) {
        const char *text = "123456789";
        const uint32_t first = kc_crc32(0u, text, cut);
        TEST_ASSERT_EQUAL_HEX32(0xCBF43926u, kc_crc32(first, text + cut, 9u - cut));
    }
}

/* By definition: bit by bit, no table. */
static uint32_t divided(const uint8_t *data, uint32_t n)
{
    uint32_t c = ~0u;
    for (uint32_t i = 0u; i < 8u * n; i++) {
        const uint32_t bit = (c ^ ((uint32_t)data[i / 8u] >> (i % 8u))) & 1u;
        c = (c >> 1) ^ (bit != 0u ? 0xEDB88320u : 0u);
    }
    return ~c;
}

void test_it_is_the_remainder_of_the_polynomial_at_every_length_and_alignment(void)
{
    uint8_t data[600];
    uint32_t word = 1u;
    for (uint32_t i = 0u; i < sizeof data; i++) {
        word = 1664525u * word + 1013904223u;
        data[i] = (uint8_t)(word >> 24);
    }
    for (uint32_t from = 0u; from < 4u; from++) {
        for (uint32_t n = 0u; n <= 16u; n++) {
            TEST_ASSERT_EQUAL_HEX32(divided(&data[from], n), kc_crc32(0u, &data[from], n));
        }
        TEST_ASSERT_EQUAL_HEX32(divided(&data[from], sizeof data - 4u),
                                kc_crc32(0u, &data[from], (uint32_t)sizeof data - 4u));
    }
}

void test_every_single_bit_matters(void)
{
    uint8_t data[32] = {0};
    const uint32_t clean = kc_crc32(0u, data, sizeof data);
    for (uint32_t bit = 0u; bit < 8u * sizeof data; bit++) {
        data[bit / 8u] ^= (uint8_t)(1u << (bit % 8u));
        TEST_ASSERT_NOT_EQUAL(clean, kc_crc32(0u, data, sizeof data));
        data[bit / 8u] ^= (uint8_t)(1u << (bit % 8u));
    }
}
