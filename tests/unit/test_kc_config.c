/* kc_config.c: every field of the CONFIG table has limits. */
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "given_tables.h"
#include "kc_layout.h"
#include "unity.h"

static kc_config_t s_c;
static int32_t s_index;
static double s_got;

void setUp(void)
{
    given_config(&s_c);
    s_index = -7;
    s_got = -7.0;
}

static void expect_refused(int32_t field, double got)
{
    kc_config_t before = s_c;
    TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, kc_config_validate(&s_c, &s_index, &s_got));
    TEST_ASSERT_EQUAL_INT32(field, s_index);
    TEST_ASSERT_EQUAL_DOUBLE(got, s_got);
    TEST_ASSERT_EQUAL_MEMORY(&before, &s_c, sizeof s_c);
}

void test_a_good_configuration_is_accepted(void)
{
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_config_validate(&s_c, &s_index, &s_got));
    TEST_ASSERT_EQUAL_INT32(-7, s_index);
}

/* Where the field of a number lies, and a value that no field of its type allows. */
typedef struct {
    int32_t field;
    size_t offset;
    char type; /* b u8, u u32, l u64, d double */
    double bad;
} spoil_t;
#define AT(member) offsetof(kc_config_t, member)
static const spoil_t s_spoil[] = {
    {1, AT(acquisition), 'b', 5.0},
    {2, AT(n_poses), 'u', 0.0},
    {2, AT(n_poses), 'u', 65.0},
    {3, AT(replicate_every), 'u', 65.0},
    {4, AT(beta_scale), 'd', -0.1},
    {5, AT(a1), 'd', 1.1},
    {6, AT(sp_floor_m), 'd', 0.0},
    {7, AT(sq_floor_rad), 'd', 0.0},
    {8, AT(vopt_len_m), 'd', 0.0},
    {9, AT(stop_pos_m), 'd', -1.0},
    {10, AT(stop_rot_rad), 'd', -1.0},
    {11, AT(frames_per_meas), 'u', 0.0},
    {11, AT(frames_per_meas), 'u', 17.0},
    {12, AT(frame_retries), 'u', 51.0},
    {13, AT(settle_us), 'l', 4e9},
    {14, AT(frame_timeout_us), 'l', 0.0},
    {15, AT(move_timeout_us), 'l', 0.0},
    {16, AT(frame_age_max_us), 'l', 0.0},
    {17, AT(search_steps), 'u', 50.0},
    {18, AT(search_step_rad), 'd', 1.7},
    {19, AT(jump_pos_m), 'd', 0.0},
    {20, AT(jump_rot_rad), 'd', 4.0},
    {21, AT(sigma_pos_max_m), 'd', 2.0},
    {22, AT(sigma_rot_max_rad), 'd', 4.0},
    {23, AT(sigma_pos_min_m), 'd', 0.0},
    {24, AT(sigma_rot_min_rad), 'd', 0.0},
    {25, AT(rms_max_px), 'd', 0.0},
    {26, AT(servo.gain), 'd', 1.1},
    {27, AT(servo.damping), 'd', 0.0},
    {28, AT(servo.step_max), 'd', 0.0},
    {29, AT(servo.bound), 'd', 0.0},
    {30, AT(servo.tol_pos_m), 'd', 0.0},
    {31, AT(servo.tol_rot_rad), 'd', 0.0},
    {32, AT(servo.margin), 'd', -0.1},
    {33, AT(servo_steps_max), 'u', 1001.0},
    {34, AT(speed_scale), 'd', 1.1},
    {35, AT(arrive_tol), 'd', 0.011},
    {36, AT(est.free_mask), 'l', 0.0},
    {37, AT(est.iter_max), 'u', 101.0},
    {38, AT(est.tol_step), 'd', 0.0},
    {39, AT(est.rank_tol), 'd', 0.0},
    {40, AT(est.outlier_p), 'd', 0.6},
    {41, AT(est.outlier_max), 'u', 65.0},
    {42, AT(est.use_prior), 'b', 2.0},
    {43, AT(accept_on_board), 'b', 2.0},
    {44, AT(accept_change_max_pos_m), 'd', -1.0},
    {45, AT(accept_sigma_max_pos_m), 'd', -1.0},
    {46, AT(accept_p_fit_min), 'd', 1.1},
    {47, AT(no_change_p), 'd', 0.0},
    {48, AT(budget_us), 'l', 4e13},
    {49, AT(approach_rad), 'd', 1.1},
    {50, AT(power_idle_w), 'd', -1.0},
    {51, AT(power_move_w), 'd', -1.0},
    {52, AT(energy_budget_j), 'd', -1.0},
    {53, AT(mismatch_pos_m), 'd', -1.0},
    {54, AT(mismatch_rot_rad), 'd', 4.5},
    {55, AT(flip_rms_ratio), 'd', 0.5},
    {56, AT(flip_trust_rad), 'd', 4.0},
    {57, AT(frame_shared), 'd', 1.1},
    {58, AT(search_safety), 'd', 0.5},
    {59, AT(poses_min), 'u', 0.0},
    {60, AT(tags_tried_min), 'u', 0.0},
    {61, AT(second_start_noise_scale), 'd', 0.5},
    {62, AT(mismatch_noise_scale), 'd', 0.5},
    {63, AT(mismatch_dof_min), 'u', 0.0},
    {64, AT(mismatch_outliers_min), 'u', 0.0},
    {65, AT(poor_noise_scale), 'd', 2e3},
    {66, AT(poor_noise_scale_unlikely), 'd', 0.5},
    {67, AT(poor_p_fit), 'd', 1.5},
    {68, AT(store_retries), 'u', 101.0},
    {69, AT(store_retry_us), 'l', 0.0},
    {70, AT(approval_timeout_us), 'l', 4e9},
    {72, AT(signed_age_max_us), 'l', 4e12},
    {73, AT(initial_design), 'b', 2.0},
    {74, AT(local_safe_m), 'd', 0.0},
    {75, AT(leave_safe_m), 'd', 0.0},
    {76, AT(doubt_p), 'd', 0.6},
    {77, AT(outside_factor), 'd', 1.0},
    {78, AT(power_min), 'd', 1.0},
    {79, AT(rate_measure), 'b', 1.0},
    {80, AT(rate_cost), 'b', 2.0},
    {81, AT(frame_s), 'd', -0.1},
    {82, AT(stop_confidence), 'd', 1.0},
    {83, AT(stop_checks), 'u', 65.0},
    {84, AT(extra_obs_max), 'u', 65.0},
    {85, AT(extra_pos_m), 'd', 0.0},
    {86, AT(extra_rot_rad), 'd', 0.0},
    {87, AT(stops_max), 'u', 5.0},
    {88, AT(rest_part), 'd', 0.0},
    {89, AT(no_change_power), 'd', 1.0},
    {90, AT(go_by_other_key), 'b', 2.0},
};

static void spoil(const spoil_t *s, double value)
{
    uint8_t *at = (uint8_t *)&s_c + s->offset;
    uint8_t b = (uint8_t)(s->type == 'b' ? value : 0.0);
    uint32_t u = (uint32_t)(s->type == 'u' ? value : 0.0);
    uint64_t l = (uint64_t)(s->type == 'l' ? value : 0.0);
    switch (s->type) {
    case 'b': memcpy(at, &b, sizeof b); break;
    case 'u': memcpy(at, &u, sizeof u); break;
    case 'l': memcpy(at, &l, sizeof l); break;
    default: memcpy(at, &value, sizeof value); break;
    }
}

void test_every_field_outside_its_limits_is_refused_by_number(void)
{
    for (size_t i = 0u; i < sizeof s_spoil / sizeof s_spoil[0]; i++) {
        setUp();
        spoil(&s_spoil[i], s_spoil[i].bad);
        expect_refused(s_spoil[i].field, s_spoil[i].bad);
    }
}

void test_nan_in_any_real_field_is_refused(void)
{
    for (size_t i = 0u; i < sizeof s_spoil / sizeof s_spoil[0]; i++) {
        if (s_spoil[i].type != 'd') { continue; }
        setUp();
        spoil(&s_spoil[i], NAN);
        TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, kc_config_validate(&s_c, &s_index, &s_got));
        TEST_ASSERT_EQUAL_INT32(s_spoil[i].field, s_index);
        TEST_ASSERT_TRUE(isnan(s_got));
    }
}

void test_a_probability_that_promises_less_than_chance_is_refused(void)
{
    static const struct {
        int32_t field;
        double *at;
    } half[] = {{82, &s_c.stop_confidence}, {89, &s_c.no_change_power}};
    for (size_t i = 0u; i < 2u; i++) {
        setUp();
        *half[i].at = 0.4999;
        expect_refused(half[i].field, 0.4999);
        *half[i].at = 1e-4;
        expect_refused(half[i].field, 1e-4);
        *half[i].at = 0.5;
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_config_validate(&s_c, &s_index, &s_got));
        *half[i].at = 0.0;
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_config_validate(&s_c, &s_index, &s_got));
    }
}

void test_a_noise_floor_above_its_ceiling_is_refused(void)
{
    s_c.sigma_pos_min_m = 2.0 * s_c.sigma_pos_max_m;
    expect_refused(23, s_c.sigma_pos_min_m);
    given_config(&s_c);
    s_c.sigma_rot_min_rad = 2.0 * s_c.sigma_rot_max_rad;
    expect_refused(24, s_c.sigma_rot_min_rad);
}

void test_an_age_that_no_command_keeps_is_refused(void)
{
    s_c.signed_age_max_us = 59999999u;
    expect_refused(72, 59999999.0);
    s_c.signed_age_max_us = 60000000u;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_config_validate(&s_c, &s_index, &s_got));
    s_c.signed_age_max_us = 0u; /* not checked */
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_config_validate(&s_c, &s_index, &s_got));
}

void test_moving_cannot_take_less_power_than_standing(void)
{
    s_c.power_idle_w = 20.0;
    s_c.power_move_w = 10.0;
    expect_refused(51, 10.0);
}

/* Values at the end that are standard are left out, so that images of before they were there keep their CRC. */
void test_an_image_ends_before_values_at_its_end_that_are_all_standard(void)
{
    static const struct {
        double rest_part, no_change_power;
        uint8_t go_by_other_key;
        uint32_t more; /* bytes */
    } cases[] = {{0.01, 0.99, 0u, 0u}, {0.02, 0.99, 0u, 17u}, {0.01, 0.5, 0u, 17u}, {0.01, 0.99, 1u, 17u}};
    static uint8_t image[KC_IMAGE_MAX];
    static kc_config_t back;
    static kc_events_t ev;
    uint32_t n_standard = 0u, n = 0u;
    for (uint32_t i = 0u; i < 4u; i++) {
        s_c.rest_part = cases[i].rest_part;
        s_c.no_change_power = cases[i].no_change_power;
        s_c.go_by_other_key = cases[i].go_by_other_key;
        n = given_image(KC_TBL_CONFIG, &s_c, image);
        if (i == 0u) { n_standard = n; }
        TEST_ASSERT_EQUAL_UINT32(n_standard + cases[i].more, n);
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_decode(KC_TBL_CONFIG, image, n, &back, &ev));
        TEST_ASSERT_EQUAL_MEMORY(&s_c, &back, sizeof back);
    }
    image[n - 1u] = 0u; /* it says standard values now, and would have another CRC than without them */
    given_resealed(image, n);
    TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, kc_tbl_decode(KC_TBL_CONFIG, image, n, &back, &ev));
    TEST_ASSERT_EQUAL_UINT32(KC_EVT_TBL_RANGE, ev.e[0].id);
}

/* ---- the end of the table: an image with standard values ends before ---- */

static uint8_t s_image[KC_IMAGE_MAX];

static kc_walk_t walked(kc_walk_mode_t mode, kc_config_t *c, uint32_t n)
{
    kc_walk_t w;
    memset(&w, 0, sizeof w);
    w.mode = mode;
    w.index = -1;
    if (mode == KC_WALK_WRITE) {
        w.out = s_image;
        w.cap = sizeof s_image;
    } else {
        w.in = s_image;
        w.in_n = n;
    }
    kc_config_walk(&w, c);
    return w;
}

void test_only_an_image_with_a_value_beside_the_standard_has_the_end(void)
{
    uint32_t n_short = 0u;
    for (uint32_t k = 0u; k < 8u; k++) {
        kc_config_t back;
        s_c.rest_part = (k & 1u) != 0u ? 0.02 : 0.01;
        s_c.no_change_power = (k & 2u) != 0u ? 0.9 : 0.99;
        s_c.go_by_other_key = (k & 4u) != 0u ? 1u : 0u;
        const uint32_t n = walked(KC_WALK_WRITE, &s_c, 0u).pos;
        if (k == 0u) { n_short = n; }
        TEST_ASSERT_EQUAL_UINT32(n_short + (k == 0u ? 0u : 17u), n);
        memset(&back, 0x11, sizeof back);
        const kc_walk_t w = walked(KC_WALK_READ, &back, n);
        TEST_ASSERT_EQUAL_UINT32(0u, w.n_bad);
        TEST_ASSERT_EQUAL_UINT32(n, w.pos);
        TEST_ASSERT_EQUAL_DOUBLE(s_c.rest_part, back.rest_part);
        TEST_ASSERT_EQUAL_DOUBLE(s_c.no_change_power, back.no_change_power);
        TEST_ASSERT_EQUAL_UINT8(s_c.go_by_other_key, back.go_by_other_key);
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_config_validate(&s_c, &s_index, &s_got));
    }
}

/* There would be two images of one table. */
void test_an_image_that_says_the_standard_at_its_end_is_refused(void)
{
    uint8_t standard[8]; /* rest_part as an image has it */
    s_c.rest_part = 0.01;
    s_c.no_change_power = 0.9;
    const uint32_t n = walked(KC_WALK_WRITE, &s_c, 0u).pos;
    memcpy(standard, &s_image[n - 17u], sizeof standard);
    s_c.rest_part = 0.02;
    s_c.no_change_power = 0.99;
    TEST_ASSERT_EQUAL_UINT32(n, walked(KC_WALK_WRITE, &s_c, 0u).pos);
    memcpy(&s_image[n - 17u], standard, sizeof standard);
    const kc_walk_t w = walked(KC_WALK_READ, &s_c, n);
    TEST_ASSERT_EQUAL_UINT32(1u, w.n_bad);
    TEST_ASSERT_EQUAL_UINT32(88u, w.bad_field);
    TEST_ASSERT_EQUAL_DOUBLE(0.01, w.bad_got);
}
