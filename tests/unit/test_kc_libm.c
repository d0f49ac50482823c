/* kc_libm.h: the bits are those of musl 1.2.3 with every compiler and CPU (`make cross` runs this on others), and they are
 * near what the C library says. */
#include <math.h>
#include <string.h>

#include "kc_crc.h"
#include "kc_libm.h"
#include "unity.h"

#define PROBES 20000u

typedef double (*function_t)(double);

static double sin_of(double x) { return kc_sin(x); }
static double cos_of(double x) { return kc_cos(x); }
static double tan_of(double x) { return kc_tan(x); }
static double atan2_of(double x) { return kc_atan2(x, 1.0 - 0.7 * x); }
static double c_atan2_of(double x) { return atan2(x, 1.0 - 0.7 * x); }
static double lgamma_of(double x) { return kc_lgamma(x); }

/* lo .. hi: what is probed. crc: of all results, as little-endian numbers. ulp: how far the C library may be. */
typedef struct {
    const char *name;
    function_t ours, theirs;
    double lo, hi;
    uint32_t crc;
    double ulp;
} row_t;

static const row_t ROWS[] = {
    {"sin", sin_of, sin, -40.0, 40.0, 0x9193d404u, 2.0},
    {"sin of large numbers", sin_of, sin, 1e3, 1e6, 0x9949dfabu, 2.0},
    {"cos", cos_of, cos, -40.0, 40.0, 0x3fd42523u, 2.0},
    {"tan", tan_of, tan, -1.5, 1.5, 0xcf4acf42u, 2.0},
    {"acos", kc_acos, acos, -1.0, 1.0, 0x5160bf5au, 2.0},
    {"atan2", atan2_of, c_atan2_of, -50.0, 50.0, 0xcba49110u, 2.0},
    {"exp", kc_exp, exp, -745.0, 709.0, 0xb4fb04edu, 2.0},
    {"log", kc_log, log, 1e-9, 30.0, 0xfa4bf43au, 2.0},
    {"log1p", kc_log1p, log1p, -0.99, 30.0, 0x845ac546u, 2.0},
    {"tanh", kc_tanh, tanh, -9.0, 9.0, 0x0da5a024u, 4.0},
    {"lgamma", lgamma_of, lgamma, 0.1, 200.0, 0xccd0bd8cu, 8.0},
    {"floor", kc_floor, floor, -1e6, 1e6, 0xad7d6476u, 0.0},
};

/* Distance of two numbers in units of the last place of b. Near zeros of a function its absolute error counts. */
static double ulps(double a, double b)
{
    double scale = fabs(b) > 1e-3 ? fabs(b) : 1e-3;
    return fabs(a - b) / (scale * 0x1p-53);
}

static double probe(const row_t *row, uint32_t i)
{
    return row->lo + (row->hi - row->lo) * ((double)i + 0.5) / PROBES;
}

void test_bits_are_the_same_everywhere(void)
{
    for (size_t k = 0u; k < sizeof ROWS / sizeof ROWS[0]; k++) {
        uint32_t crc = 0u;
        for (uint32_t i = 0u; i < PROBES; i++) {
            double y = ROWS[k].ours(probe(&ROWS[k], i));
            uint64_t bits;
            uint8_t bytes[8];
            memcpy(&bits, &y, sizeof bits);
            for (uint32_t b = 0u; b < 8u; b++) { bytes[b] = (uint8_t)(bits >> (8u * b)); }
            crc = kc_crc32(crc, bytes, sizeof bytes);
        }
        TEST_ASSERT_EQUAL_HEX32_MESSAGE(ROWS[k].crc, crc, ROWS[k].name);
    }
}

void test_values_are_near_those_of_the_c_library(void)
{
    for (size_t k = 0u; k < sizeof ROWS / sizeof ROWS[0]; k++) {
        double worst = 0.0;
        for (uint32_t i = 0u; i < PROBES; i++) {
            double x = probe(&ROWS[k], i);
            worst = fmax(worst, ulps(ROWS[k].ours(x), ROWS[k].theirs(x)));
        }
        TEST_ASSERT_TRUE_MESSAGE(worst <= ROWS[k].ulp, ROWS[k].name);
    }
}

void test_zero_infinity_and_nan(void)
{
    TEST_ASSERT_EQUAL_DOUBLE(0.0, kc_sin(0.0));
    TEST_ASSERT_TRUE(isnan(kc_acos(1.0 + 0x1p-52)) && isnan(kc_log(-1.0)) && isnan(kc_log1p(-2.0)));
    TEST_ASSERT_TRUE(kc_log(0.0) < 0.0 && isinf(kc_log(0.0)) && isinf(kc_exp(800.0)));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, kc_exp(-KC_INF));
    TEST_ASSERT_EQUAL_DOUBLE(1.0, kc_tanh(KC_INF));
    TEST_ASSERT_TRUE(isnan(kc_exp(NAN)) && isnan(kc_atan2(NAN, 1.0)) && isnan(kc_lgamma(NAN)));
}

void test_angles_beyond_the_largest_count_as_the_largest(void)
{
    static const double beyond[] = {1000000.5, 1.7e6, 1e12, 1e300};
    for (uint32_t i = 0u; i < sizeof beyond / sizeof beyond[0]; i++) {
        TEST_ASSERT_EQUAL_DOUBLE(sin(1e6), kc_sin(beyond[i]));
        TEST_ASSERT_EQUAL_DOUBLE(-sin(1e6), kc_sin(-beyond[i]));
        TEST_ASSERT_EQUAL_DOUBLE(cos(1e6), kc_cos(beyond[i]));
        TEST_ASSERT_EQUAL_DOUBLE(tan(-1e6), kc_tan(-beyond[i]));
    }
    TEST_ASSERT_EQUAL_DOUBLE(sin(999999.5), kc_sin(999999.5));
    TEST_ASSERT_EQUAL_DOUBLE(cos(-999999.5), kc_cos(-999999.5));
    TEST_ASSERT_TRUE(isnan(kc_sin(NAN)) && isnan(kc_cos(NAN)) && isnan(kc_tan(NAN)));
}

static void assert_both(double x)
{
    double s = 9.0, c = 9.0;
    const double want_s = kc_sin(x), want_c = kc_cos(x);
    kc_sincos(x, &s, &c);
    TEST_ASSERT_EQUAL_MEMORY(&want_s, &s, sizeof s);
    TEST_ASSERT_EQUAL_MEMORY(&want_c, &c, sizeof c);
}

/* Beside every border of a quadrant, where the reduction begins, and at the ends of the numbers. */
void test_sine_and_cosine_at_once_have_the_bits_of_each(void)
{
    static const double at[] = {
        0x1p-1074, 0x1p-1022, 0x1p-30,  0x1p-27, 0x1p-26, 0.5,   0.7853984832763671875,
        1.5e-8,    1e5,       999999.5, 1e6,     1e300,   KC_INF};
    for (size_t k = 0u; k < sizeof at / sizeof at[0]; k++) {
        assert_both(at[k]);
        assert_both(-at[k]);
        assert_both(nextafter(at[k], k == 0u ? 1.0 : 0.0));
    }
    assert_both(0.0);
    for (int k = -40; k <= 40; k++) {
        const double border = (double)k * 0.25 * KC_PI;
        assert_both(border);
        assert_both(nextafter(border, KC_INF));
        assert_both(nextafter(border, -KC_INF));
    }
    for (size_t k = 0u; k < 3u; k++) { /* sin, sin of large numbers, cos */
        for (uint32_t i = 0u; i < PROBES; i++) { assert_both(probe(&ROWS[k], i)); }
    }
}

/* One angle in each quadrant, of known sine and cosine, and turns beyond it either side. */
void test_sine_and_cosine_at_once_are_those_of_known_angles(void)
{
    static const double unit[4][2] = {{0.5, 0.86602540378443865},
                                      {0.86602540378443865, -0.5},
                                      {-0.5, -0.86602540378443865},
                                      {-0.86602540378443865, 0.5}};
    double s, c;
    for (int turns = -3; turns <= 3; turns++) {
        for (int k = 0; k < 4; k++) { /* 30, 120, 210, 300 degrees */
            kc_sincos(KC_PI / 6.0 + 0.5 * KC_PI * k + 2.0 * KC_PI * turns, &s, &c);
            TEST_ASSERT_DOUBLE_WITHIN(1e-14, unit[k][0], s);
            TEST_ASSERT_DOUBLE_WITHIN(1e-14, unit[k][1], c);
        }
    }
    kc_sincos(-0.0, &s, &c);
    TEST_ASSERT_TRUE(s >= 0.0 && s <= 0.0);
    TEST_ASSERT_EQUAL_DOUBLE(1.0, c);
    kc_sincos(NAN, &s, &c);
    TEST_ASSERT_TRUE(isnan(s) && isnan(c));
}
