/* kc_check.c: first problem wins; every kind of check, on both sides. */
#include <math.h>
#include <string.h>

#include "kc_check.h"
#include "kc_limits.h"
#include "unity.h"

static kc_check_t s_c;
static int32_t s_index;
static double s_got;

void setUp(void)
{
    s_c = kc_check_start();
    s_index = -99;
    s_got = -99.0;
}

static void assert_failed(int32_t index, double got)
{
    TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, kc_check_end(&s_c, &s_index, &s_got));
    TEST_ASSERT_EQUAL_INT32(index, s_index);
    TEST_ASSERT_EQUAL_DOUBLE(got, s_got);
    s_c = kc_check_start();
}

static void assert_passed(void)
{
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_check_end(&s_c, &s_index, &s_got));
    TEST_ASSERT_EQUAL_INT32(-99, s_index);
    TEST_ASSERT_EQUAL_DOUBLE(-99.0, s_got);
}

void test_only_the_first_problem_is_kept(void)
{
    kc_check(&s_c, true, 1, 1.0);
    kc_check(&s_c, false, 2, 2.0);
    kc_check(&s_c, false, 3, 3.0);
    assert_failed(2, 2.0);
}

void test_without_a_problem_nothing_is_written(void)
{
    kc_check(&s_c, true, 1, 1.0);
    assert_passed();
}

void test_finite_numbers_pass_and_nan_and_infinity_do_not(void)
{
    const double good[3] = {0.0, -1e300, 3.0}, nan_at_1[2] = {0.0, NAN}, inf_at_0[1] = {INFINITY};
    kc_check_finite(&s_c, good, 3u, 4);
    assert_passed();
    kc_check_finite(&s_c, nan_at_1, 2u, 5);
    assert_failed(5, NAN);
    kc_check_finite(&s_c, inf_at_0, 1u, 6);
    assert_failed(6, INFINITY);
}

void test_positive_means_finite_and_above_zero(void)
{
    kc_check_positive(&s_c, 1e-300, 1);
    assert_passed();
    kc_check_positive(&s_c, 0.0, 1);
    assert_failed(1, 0.0);
    kc_check_positive(&s_c, INFINITY, 2);
    assert_failed(2, INFINITY);
}

void test_not_negative_allows_zero(void)
{
    kc_check_not_negative(&s_c, 0.0, 1);
    assert_passed();
    kc_check_not_negative(&s_c, -1e-9, 1);
    assert_failed(1, -1e-9);
    kc_check_not_negative(&s_c, NAN, 2);
    assert_failed(2, NAN);
}

void test_a_frame_needs_a_finite_origin_and_a_unit_quaternion(void)
{
    const double p[3] = {1.0, 2.0, 3.0}, q[4] = {0.6, 0.0, -0.8, 0.0};
    const double p_bad[3] = {0.0, INFINITY, 0.0}, q_long[4] = {1.0 + 2e-6, 0.0, 0.0, 0.0};
    const double q_nan[4] = {1.0, NAN, 0.0, 0.0};
    kc_check_frame(&s_c, p, q, 7);
    assert_passed();
    kc_check_frame(&s_c, p_bad, q, 7);
    assert_failed(7, INFINITY);
    kc_check_frame(&s_c, p, q_long, 8);
    assert_failed(8, 1.0 + 2e-6);
    kc_check_frame(&s_c, p, q_nan, 9);
    assert_failed(9, NAN);
}

void test_names_are_printable_terminated_and_padded(void)
{
    char name[KC_NAME_LEN] = "J4.a_m";
    TEST_ASSERT_TRUE(kc_name_ok(name));
    name[KC_NAME_LEN - 1u] = 'x';
    TEST_ASSERT_FALSE(kc_name_ok(name)); /* not padded with NUL */
    memset(name, 'x', sizeof name);
    TEST_ASSERT_FALSE(kc_name_ok(name)); /* not terminated */
    name[KC_NAME_LEN - 1u] = '\0';
    TEST_ASSERT_TRUE(kc_name_ok(name)); /* longest */
    memset(name, 0, sizeof name);
    TEST_ASSERT_FALSE(kc_name_ok(name)); /* empty */
    name[0] = '\n';
    TEST_ASSERT_FALSE(kc_name_ok(name));
    name[0] = '\x7f';
    TEST_ASSERT_FALSE(kc_name_ok(name));
}

void test_a_quaternion_may_be_neither_longer_nor_shorter(void)
{
    const double xyz[3] = {1.0, 2.0, 3.0};
    for (int side = -1; side <= 1; side += 2) {
        setUp();
        double quat[4] = {0.0, 1.0 + side * 0.9e-6, 0.0, 0.0};
        kc_check_frame(&s_c, xyz, quat, 4);
        assert_passed();
        quat[1] = 1.0 + side * 1.1e-6;
        kc_check_frame(&s_c, xyz, quat, 4);
        assert_failed(4, quat[1]);
    }
}

void test_every_number_of_a_frame_is_checked(void)
{
    for (uint32_t k = 0u; k < 7u; k++) {
        double xyz[3] = {1.0, 2.0, 3.0}, quat[4] = {0.5, 0.5, 0.5, 0.5};
        *(k < 3u ? &xyz[k] : &quat[k - 3u]) = NAN;
        kc_check_frame(&s_c, xyz, quat, 4);
        assert_failed(4, NAN);
    }
}

void test_a_name_may_have_spaces_and_every_printable_character(void)
{
    char name[KC_NAME_LEN] = "a b ~!";
    TEST_ASSERT_TRUE(kc_name_ok(name));
    name[1] = '\x1f';
    TEST_ASSERT_FALSE(kc_name_ok(name));
    name[1] = '\x7f';
    TEST_ASSERT_FALSE(kc_name_ok(name));
}
