/* kc_codec.c: the field-walking stream by itself, against bytes written by hand. */
#include <math.h>
#include <string.h>

#include "kc_codec.h"
#include "unity.h"

static kc_walk_t s_w;
static uint8_t s_buf[64];

void setUp(void)
{
    memset(&s_w, 0, sizeof s_w);
    memset(s_buf, 0, sizeof s_buf);
    s_w.index = -1;
}

static void given_writing(uint32_t from, uint32_t cap)
{
    s_w.mode = KC_WALK_WRITE;
    s_w.out = s_buf;
    s_w.from = from;
    s_w.cap = cap;
}

static void given_reading(const uint8_t *bytes, uint32_t n)
{
    s_w.mode = KC_WALK_READ;
    s_w.in = bytes;
    s_w.in_n = n;
}

static void expect_refused(kc_event_id_t id, uint32_t field, double got)
{
    TEST_ASSERT_EQUAL_UINT32(1u, s_w.n_bad);
    TEST_ASSERT_EQUAL_UINT16(id, s_w.bad_id);
    TEST_ASSERT_EQUAL_UINT32(field, s_w.bad_field);
    TEST_ASSERT_EQUAL_DOUBLE(got, s_w.bad_got);
}

void test_integers_are_little_endian(void)
{
    static const uint8_t want[] = {0x12, 0x34, 0x12, 0x78, 0x56, 0x34, 0x12, 0xfe, 0xff, 0xff,
                                   0xff, 8,    7,    6,    5,    4,    3,    2,    1};
    uint8_t a = 0x12;
    uint16_t b = 0x1234;
    uint32_t c = 0x12345678;
    int32_t d = -2;
    uint64_t e = 0x0102030405060708;
    given_writing(0u, sizeof s_buf);
    kc_walk_u8(&s_w, 1u, &a, 0u, 255u);
    kc_walk_u16(&s_w, 2u, &b, 0u, 65535u);
    kc_walk_u32(&s_w, 3u, &c, 0u, UINT32_MAX);
    kc_walk_i32(&s_w, 4u, &d, -5, 5);
    kc_walk_u64(&s_w, 5u, &e, 0u, UINT64_MAX);
    TEST_ASSERT_EQUAL_UINT32(sizeof want, s_w.pos);
    TEST_ASSERT_EQUAL_HEX8_ARRAY(want, s_buf, sizeof want);
}

void test_integers_are_read_back(void)
{
    static const uint8_t in[] = {0x12, 0x34, 0x12, 0x78, 0x56, 0x34, 0x12, 0xfe, 0xff, 0xff,
                                 0xff, 8,    7,    6,    5,    4,    3,    2,    1};
    uint8_t a = 0;
    uint16_t b = 0;
    uint32_t c = 0;
    int32_t d = 0;
    uint64_t e = 0;
    given_reading(in, sizeof in);
    kc_walk_u8(&s_w, 1u, &a, 0u, 255u);
    kc_walk_u16(&s_w, 2u, &b, 0u, 65535u);
    kc_walk_u32(&s_w, 3u, &c, 0u, UINT32_MAX);
    kc_walk_i32(&s_w, 4u, &d, -5, 5);
    kc_walk_u64(&s_w, 5u, &e, 0u, UINT64_MAX);
    TEST_ASSERT_EQUAL_HEX8(0x12, a);
    TEST_ASSERT_EQUAL_HEX16(0x1234, b);
    TEST_ASSERT_EQUAL_HEX32(0x12345678, c);
    TEST_ASSERT_EQUAL_INT32(-2, d);
    TEST_ASSERT_EQUAL_HEX64(0x0102030405060708, e);
    TEST_ASSERT_EQUAL_UINT32(0u, s_w.n_bad);
}

void test_reals_are_stored_as_their_ieee_bits(void)
{
    static const uint8_t want[] = {0, 0, 0, 0, 0, 0, 0xf8, 0x3f, 0, 0, 0x20, 0xc0};
    double x = 1.5, x_back = 0.0;
    float y = -2.5f, y_back = 0.0f;
    given_writing(0u, sizeof s_buf);
    kc_walk_f64(&s_w, 1u, &x, -9.0, 9.0);
    kc_walk_f32(&s_w, 2u, &y, -9.0, 9.0);
    TEST_ASSERT_EQUAL_HEX8_ARRAY(want, s_buf, sizeof want);
    setUp();
    given_reading(want, sizeof want);
    kc_walk_f64(&s_w, 1u, &x_back, -9.0, 9.0);
    kc_walk_f32(&s_w, 2u, &y_back, -9.0, 9.0);
    TEST_ASSERT_EQUAL_DOUBLE(1.5, x_back);
    TEST_ASSERT_EQUAL_FLOAT(-2.5f, y_back);
}

void test_only_the_window_is_written(void)
{
    uint32_t v[4] = {0x03020100, 0x07060504, 0x0b0a0908, 0x0f0e0d0c};
    memset(s_buf, 0xee, sizeof s_buf);
    given_writing(6u, 3u);
    for (uint32_t i = 0u; i < 4u; i++) { kc_walk_u32(&s_w, 1u, &v[i], 0u, UINT32_MAX); }
    TEST_ASSERT_EQUAL_UINT32(16u, s_w.pos);
    TEST_ASSERT_EQUAL_HEX8(6u, s_buf[0]);
    TEST_ASSERT_EQUAL_HEX8(8u, s_buf[2]);
    TEST_ASSERT_EACH_EQUAL_HEX8(0xee, &s_buf[3], sizeof s_buf - 3u);
}

void test_sizing_counts_bytes_and_takes_the_crc(void)
{
    uint8_t v[9] = {'1', '2', '3', '4', '5', '6', '7', '8', '9'};
    s_w.want_crc = 1u;
    for (uint32_t i = 0u; i < 9u; i++) { kc_walk_u8(&s_w, 1u, &v[i], 0u, 255u); }
    TEST_ASSERT_EQUAL_UINT32(9u, s_w.pos);
    TEST_ASSERT_EQUAL_HEX32(0xCBF43926u, s_w.crc); /* check value of CRC-32 IEEE */
}

void test_sizing_without_crc_leaves_it_zero(void)
{
    uint8_t v = 7u;
    kc_walk_u8(&s_w, 1u, &v, 0u, 255u);
    TEST_ASSERT_EQUAL_HEX32(0u, s_w.crc);
}

void test_writing_and_sizing_do_not_check_values(void)
{
    double x = NAN;
    uint8_t v = 200u;
    kc_walk_f64(&s_w, 1u, &x, 0.0, 1.0);
    kc_walk_u8(&s_w, 1u, &v, 0u, 1u);
    given_writing(0u, sizeof s_buf);
    kc_walk_f64(&s_w, 1u, &x, 0.0, 1.0);
    TEST_ASSERT_EQUAL_UINT32(0u, s_w.n_bad);
}

void test_a_value_below_its_limit_is_refused(void)
{
    static const uint8_t in[] = {2};
    uint8_t v = 0u;
    given_reading(in, sizeof in);
    kc_walk_u8(&s_w, 7u, &v, 3u, 9u);
    expect_refused(KC_EVT_TBL_RANGE, 7u, 2.0);
}

void test_a_value_above_its_limit_is_refused(void)
{
    int32_t v = 6, u = -6, lo = -5, hi = 5;
    s_w.mode = KC_WALK_CHECK;
    kc_walk_i32(&s_w, 8u, &lo, -5, 5);
    kc_walk_i32(&s_w, 8u, &hi, -5, 5);
    TEST_ASSERT_EQUAL_UINT32(0u, s_w.n_bad);
    kc_walk_i32(&s_w, 8u, &v, -5, 5);
    expect_refused(KC_EVT_TBL_RANGE, 8u, 6.0);
    kc_walk_i32(&s_w, 8u, &u, -5, 5);
    TEST_ASSERT_EQUAL_UINT32(2u, s_w.n_bad);
    TEST_ASSERT_EQUAL_DOUBLE(6.0, s_w.bad_got); /* the first one stays the one reported */
}

void test_reals_outside_their_limits_are_refused(void)
{
    double lo = -1.5, hi = 1.5;
    s_w.mode = KC_WALK_CHECK;
    kc_walk_f64(&s_w, 3u, &lo, -1.0, 1.0);
    expect_refused(KC_EVT_TBL_RANGE, 3u, -1.5);
    kc_walk_f64(&s_w, 3u, &hi, -1.0, 1.0);
    TEST_ASSERT_EQUAL_UINT32(2u, s_w.n_bad);
}

void test_nan_is_named_as_not_finite(void)
{
    double x = NAN;
    s_w.mode = KC_WALK_CHECK;
    s_w.index = 4;
    kc_walk_vec(&s_w, 3u, &x, 1u, -1.0, 1.0);
    TEST_ASSERT_EQUAL_UINT16(KC_EVT_TBL_NOT_FINITE, s_w.bad_id);
    TEST_ASSERT_EQUAL_INT32(4, s_w.bad_index);
    TEST_ASSERT_TRUE(isnan(s_w.bad_got));
}

void test_infinity_is_named_as_not_finite(void)
{
    float x = INFINITY;
    s_w.mode = KC_WALK_CHECK;
    kc_walk_f32(&s_w, 3u, &x, -1.0, 1.0);
    TEST_ASSERT_EQUAL_UINT16(KC_EVT_TBL_NOT_FINITE, s_w.bad_id);
    TEST_ASSERT_TRUE(isinf(s_w.bad_got));
}

void test_a_unit_quaternion_is_accepted_within_a_millionth(void)
{
    double q[4] = {1.0 + 9e-7, 0.0, 0.0, 0.0}, shorter[4] = {0.0, 0.0, 1.0 - 9e-7, 0.0};
    float f[4] = {0.5f, 0.5f, -0.5f, 0.5f};
    s_w.mode = KC_WALK_CHECK;
    kc_walk_quat(&s_w, 1u, q);
    kc_walk_quat(&s_w, 1u, shorter);
    kc_walk_quatf(&s_w, 1u, f);
    TEST_ASSERT_EQUAL_UINT32(0u, s_w.n_bad);
}

void test_a_quaternion_off_the_unit_norm_is_refused(void)
{
    for (double norm = 1.0 - 2e-6; norm < 1.0 + 3e-6; norm += 4e-6) {
        double q[4] = {0.0, norm, 0.0, 0.0};
        setUp();
        s_w.mode = KC_WALK_CHECK;
        kc_walk_quat(&s_w, 5u, q);
        expect_refused(KC_EVT_TBL_NOT_UNIT, 5u, norm);
    }
}

void test_a_quaternion_with_nan_is_refused_once(void)
{
    float f[4] = {0.5f, NAN, NAN, 0.5f};
    s_w.mode = KC_WALK_CHECK;
    kc_walk_quatf(&s_w, 5u, f);
    TEST_ASSERT_EQUAL_UINT32(1u, s_w.n_bad);
    TEST_ASSERT_EQUAL_UINT16(KC_EVT_TBL_NOT_FINITE, s_w.bad_id);
}

void test_quaternions_are_not_checked_while_writing(void)
{
    double q[4] = {3.0, 0.0, 0.0, 0.0};
    given_writing(0u, sizeof s_buf);
    kc_walk_quat(&s_w, 5u, q);
    TEST_ASSERT_EQUAL_UINT32(0u, s_w.n_bad);
    TEST_ASSERT_EQUAL_UINT32(32u, s_w.pos);
}

static void check_name(const char *bytes, uint32_t n)
{
    char name[KC_NAME_LEN] = {0};
    memcpy(name, bytes, n);
    s_w.mode = KC_WALK_CHECK;
    kc_walk_name(&s_w, 2u, name);
}

void test_a_printable_name_padded_with_nul_is_accepted(void)
{
    check_name("J4.a_m ~", 8u);
    TEST_ASSERT_EQUAL_UINT32(0u, s_w.n_bad);
}

void test_an_empty_name_is_refused(void)
{
    check_name("", 0u);
    expect_refused(KC_EVT_TBL_RANGE, 2u, 0.0);
}

void test_a_name_without_room_for_nul_is_refused(void)
{
    check_name("abcdefghijklmnopqrstuvwx", KC_NAME_LEN);
    expect_refused(KC_EVT_TBL_RANGE, 2u, (double)'x');
}

void test_a_name_with_an_unprintable_byte_is_refused(void)
{
    check_name("J4\n", 3u);
    expect_refused(KC_EVT_TBL_RANGE, 2u, 10.0);
}

void test_a_name_with_a_byte_above_ascii_is_refused(void)
{
    check_name("J\x80", 2u);
    expect_refused(KC_EVT_TBL_RANGE, 2u, 128.0);
}

void test_a_name_with_something_after_its_nul_is_refused(void)
{
    check_name("J4\0x", 4u);
    expect_refused(KC_EVT_TBL_RANGE, 2u, (double)'x');
}

void test_names_are_read_and_written_whole(void)
{
    char name[KC_NAME_LEN] = "tool", back[KC_NAME_LEN] = {0};
    given_writing(0u, sizeof s_buf);
    kc_walk_name(&s_w, 1u, name);
    TEST_ASSERT_EQUAL_UINT32(KC_NAME_LEN, s_w.pos);
    setUp();
    given_reading((const uint8_t *)name, KC_NAME_LEN);
    kc_walk_name(&s_w, 1u, back);
    TEST_ASSERT_EQUAL_STRING("tool", back);
}

void test_reading_past_the_end_gives_zero_and_says_so(void)
{
    static const uint8_t in[] = {1, 2, 3};
    uint32_t v = 99u;
    uint16_t more = 99u;
    given_reading(in, sizeof in);
    kc_walk_u32(&s_w, 1u, &v, 5u, 9u);
    TEST_ASSERT_EQUAL_UINT32(0u, v);
    TEST_ASSERT_TRUE(s_w.overrun);
    TEST_ASSERT_EQUAL_UINT32(0u, s_w.n_bad); /* zero was never sent, so it is not refused */
    kc_walk_u16(&s_w, 1u, &more, 5u, 9u);
    TEST_ASSERT_EQUAL_UINT32(6u, s_w.pos);   /* what the table would have needed */
    TEST_ASSERT_EQUAL_UINT32(0u, kc_walk_count(&s_w, 1u, &v, 0u, 9u));
}

void test_a_count_in_range_says_how_many_to_walk(void)
{
    static const uint8_t in[] = {3, 0, 0, 0};
    uint32_t v = 0u;
    given_reading(in, sizeof in);
    TEST_ASSERT_EQUAL_UINT32(3u, kc_walk_count(&s_w, 1u, &v, 1u, 8u));
    TEST_ASSERT_EQUAL_UINT32(3u, v);
    setUp();
    TEST_ASSERT_EQUAL_UINT32(3u, kc_walk_count(&s_w, 1u, &v, 1u, 8u));
}

void test_a_bad_count_ends_the_walk_in_every_mode(void)
{
    static const uint8_t in[] = {9, 0, 0, 0, 7, 7};
    static const kc_walk_mode_t modes[] = {KC_WALK_SIZE, KC_WALK_WRITE, KC_WALK_READ, KC_WALK_CHECK};
    for (uint32_t m = 0u; m < 4u; m++) {
        uint32_t v = 9u, pos;
        uint16_t after = 5u;
        setUp();
        given_writing(0u, sizeof s_buf);
        given_reading(in, sizeof in);
        s_w.mode = modes[m];
        TEST_ASSERT_EQUAL_UINT32(0u, kc_walk_count(&s_w, 6u, &v, 1u, 8u));
        expect_refused(KC_EVT_TBL_RANGE, 6u, 9.0);
        pos = s_w.pos;
        kc_walk_u16(&s_w, 7u, &after, 0u, 1u);
        kc_walk_rule(&s_w, 7u, false, 1.0);
        TEST_ASSERT_EQUAL_UINT32(pos, s_w.pos);
        TEST_ASSERT_EQUAL_UINT16(5u, after);
        TEST_ASSERT_EQUAL_UINT32(1u, s_w.n_bad);
    }
}

void test_a_count_below_its_least_is_refused(void)
{
    uint32_t v = 0u;
    s_w.mode = KC_WALK_CHECK;
    TEST_ASSERT_EQUAL_UINT32(0u, kc_walk_count(&s_w, 6u, &v, 1u, 8u));
    expect_refused(KC_EVT_TBL_RANGE, 6u, 0.0);
}

void test_a_rule_between_fields_is_checked_only_where_values_are(void)
{
    kc_walk_rule(&s_w, 3u, false, 1.0);
    TEST_ASSERT_EQUAL_UINT32(0u, s_w.n_bad);
    s_w.mode = KC_WALK_CHECK;
    kc_walk_rule(&s_w, 3u, true, 1.0);
    TEST_ASSERT_EQUAL_UINT32(0u, s_w.n_bad);
    kc_walk_rule(&s_w, 3u, false, 1.0);
    expect_refused(KC_EVT_TBL_RANGE, 3u, 1.0);
}
