/* kc_signed.c: which bytes of a message are signed. Messages of strangers: test_signed.c. */
#include "kc_signed.h"

#include "unity.h"

static kc_table_chunk_t s_chunk;

void test_a_command_is_laid_out_field_by_field_in_little_endian(void)
{
    static const uint8_t expected[] = {
        'K',  'i',  'n',  'C',  'a',  'l',  ' ',  'c',  'o', 'm', 'm', 'a',
        'n',  'd',  ' ',  '1', /* label */
        0x04, 0x03, 0x02, 0x01,                                                         /* key */
        0x18, 0x17, 0x16, 0x15, 0x14, 0x13, 0x12, 0x11,                                 /* counter */
        0x28, 0x27, 0x26, 0x25, 0x24, 0x23, 0x22, 0x21,                                 /* t_us */
        2,    0,    0,    0,    0xfe, 0xff, 0xff, 0xff, 1,   0,   0,   0, /* source, seq, opcode */
        1,    0,    0,    0,    2,    0,    0,    0,    3,   0,   0,   0,
        0xff, 0xff, 0xff, 0xff, /* arg_i */
        8,    7,    6,    5,    4,    3,    2,    1, /* arg_u64 */
        0,    0,    0,    0,    0,    0,    0xf8, 0x3f, 0,   0,   0,   0,
        0,    0,    0,    0x80, /* arg_d: 1.5, -0.0 */
        0,    0,    0,    0,    0,    0,    0,    0xc0, 0,   0,   0,   0,
        0,    0,    0,    0, /* -2, 0 */
    };
    uint8_t head[KC_SIGNED_HEAD_MAX];
    const kc_cmd_t c = {
        .t_us = 0x2122232425262728u,
        .seq = -2,
        .source = 2,
        .opcode = 1,
        .arg_i = {1, 2, 3, -1},
        .arg_u64 = 0x0102030405060708u,
        .arg_d = {1.5, -0.0, -2.0, 0.0},
        .auth = {.key_id = 0x01020304u, .counter = 0x1112131415161718u},
    };
    kc_auth_text_t text = kc_signed_cmd(&c, head);
    TEST_ASSERT_EQUAL_UINT32(sizeof expected, text.n_head);
    TEST_ASSERT_EQUAL_UINT32(KC_SIGNED_HEAD_MAX, text.n_head);
    TEST_ASSERT_EQUAL_UINT32(0u, text.n_body);
    TEST_ASSERT_EQUAL_MEMORY(expected, text.head, sizeof expected);
}

void test_a_chunk_is_laid_out_with_all_its_bytes(void)
{
    static const uint8_t expected[] = {
        'K', 'i', 'n', 'C', 'a', 'l', ' ', 'c', 'h', 'u', 'n', 'k', ' ', '1', 0, 0, /* label */
        4,   0,   0,   0,   5,   0,   0,   0,   0,   0,   0,   0,   6,   0,   0, 0,
        0,   0,   0,   0, /* key, counter, t_us */
        2,   0,   0,   0,   7,   0,   0,   0,   8,   0,   0,   0,   9,   0,   0, 0,
        10,  0,   0,   0, /* source to n */
    };
    uint8_t head[KC_SIGNED_HEAD_MAX];
    s_chunk = (kc_table_chunk_t){.t_us = 6u, .source = 2, .kind = 7, .total = 8u, .offset = 9u, .n = 10u};
    s_chunk.auth = (kc_auth_t){.key_id = 4u, .counter = 5u};
    kc_auth_text_t text = kc_signed_chunk(&s_chunk, head);
    TEST_ASSERT_EQUAL_UINT32(sizeof expected, text.n_head);
    TEST_ASSERT_EQUAL_MEMORY(expected, text.head, sizeof expected);
    TEST_ASSERT_EQUAL_PTR(s_chunk.data, text.body);
    TEST_ASSERT_EQUAL_UINT32(KC_CHUNK_BYTES, text.n_body); /* also those beyond n */
}
