/* kc_frames.c: the mean of frames and its covariance, against numbers by hand. */
#include <math.h>
#include <string.h>

#include "given_tables.h"
#include "kc_frames.h"
#include "unity.h"

static kc_frames_t s_f;
static kc_config_t s_config;
static kc_detection_t s_d, s_mean;
static kc_arm_state_t s_arm;
static kc_pantilt_state_t s_pantilt;

void setUp(void)
{
    given_config(&s_config);
    s_config.sigma_pos_min_m = 1e-6;
    s_config.sigma_rot_min_rad = 1e-6;
    memset(&s_d, 0, sizeof s_d);
    memset(&s_arm, 0, sizeof s_arm);
    memset(&s_pantilt, 0, sizeof s_pantilt);
    kc_frames_clear(&s_f);
    s_d.q_cam_tool_wxyz[0] = 1.0;
    s_d.n_tags = 1u;
    s_d.tag_id[0] = 7;
    for (uint32_t i = 0u; i < 6u; i++) { s_d.cov[7u * i] = 4e-6; }
}

/* A frame at x, turned by angle about z. */
static void add(double x_m, double angle_rad)
{
    s_d.p_cam_tool_m[0] = x_m;
    s_d.q_cam_tool_wxyz[0] = cos(0.5 * angle_rad);
    s_d.q_cam_tool_wxyz[3] = sin(0.5 * angle_rad);
    s_d.corner_px[0] = 100.0 * x_m;
    s_arm.q[2] = 10.0 * x_m;
    s_pantilt.pan_rad = x_m;
    kc_frames_add(&s_f, &s_d, &s_arm, &s_pantilt);
}

static void mean(void) { kc_frames_mean(&s_f, &s_config, &s_mean, &s_arm, &s_pantilt); }

void test_the_mean_of_positions_turns_readings_and_corners(void)
{
    add(0.1, 0.2);
    add(0.3, 0.4);
    mean();
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.2, s_mean.p_cam_tool_m[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, sin(0.15), fabs(s_mean.q_cam_tool_wxyz[3]));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 2.0, s_arm.q[2]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.2, s_pantilt.pan_rad);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 20.0, s_mean.corner_px[0]);
}

void test_corners_of_different_tags_are_not_averaged(void)
{
    add(0.1, 0.0);
    s_d.tag_id[0] = 8;
    add(0.3, 0.0);
    mean();
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 10.0, s_mean.corner_px[0]);
    TEST_ASSERT_EQUAL_INT32(7, s_mean.tag_id[0]); /* those of the first frame */
}

void test_errors_that_frames_share_do_not_average_out(void)
{
    s_config.frame_shared = 0.25;
    for (uint32_t i = 0u; i < 3u; i++) { add(0.1, 0.0); }
    mean();
    TEST_ASSERT_DOUBLE_WITHIN(1e-18, 4e-6 * (1.0 + 2.0 * 0.25) / 3.0, s_mean.cov[0]);
    s_config.frame_shared = 1.0;
    mean();
    TEST_ASSERT_DOUBLE_WITHIN(1e-18, 4e-6, s_mean.cov[0]);
}

void test_no_variance_goes_below_its_floor(void)
{
    s_config.sigma_pos_min_m = 0.01;
    s_config.sigma_rot_min_rad = 0.02;
    add(0.1, 0.0);
    mean();
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 1e-4, s_mean.cov[7]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 4e-4, s_mean.cov[28]);
}

void test_a_jump_is_the_distance_from_the_mean_of_the_frames_before(void)
{
    double pos_m = 9.0, rot_rad = 9.0;
    kc_frames_jump(&s_f, &s_d, &pos_m, &rot_rad);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, pos_m); /* nothing to compare with */
    TEST_ASSERT_EQUAL_DOUBLE(0.0, rot_rad);
    add(0.1, 0.1);
    add(0.3, 0.3);
    s_d.p_cam_tool_m[0] = 0.5;
    kc_frames_jump(&s_f, &s_d, &pos_m, &rot_rad);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.3, pos_m);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.1, rot_rad);
}

/* Every number of three frames, a different one in each: k, 2 k and 6 k have the mean 3 k. */
void test_every_number_of_a_measurement_is_the_mean_of_its_frames(void)
{
    static const double times[3] = {1.0, 2.0, 6.0};
    for (uint32_t n = 0u; n < 3u; n++) {
        double *scalar[] = {&s_d.range_m, &s_d.incid_rad,  &s_d.u_px,          &s_d.v_px,
                            &s_d.rms_px,  &s_d.rms_alt_px, &s_pantilt.pan_rad, &s_pantilt.tilt_rad};
        for (uint32_t k = 0u; k < 8u; k++) { *scalar[k] = times[n] * (1.0 + (double)k); }
        for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) {
            s_arm.q[j] = times[n] * (10.0 + (double)j);
            s_arm.dq[j] = times[n] * (20.0 + (double)j);
        }
        for (uint32_t i = 0u; i < 8u * KC_TAG_MAX; i++) { s_d.corner_px[i] = times[n] * (100.0 + (double)i); }
        for (uint32_t i = 0u; i < 36u; i++) { s_d.cov[i] = times[n] * (200.0 + (double)i); }
        for (uint32_t i = 0u; i < 3u; i++) { s_d.p_cam_tool_m[i] = times[n] * (0.1 + (double)i); }
        kc_frames_add(&s_f, &s_d, &s_arm, &s_pantilt);
    }
    s_config.frame_shared = 1.0;
    mean();
    const double got[8] = {s_mean.range_m, s_mean.incid_rad,  s_mean.u_px,       s_mean.v_px,
                           s_mean.rms_px,  s_mean.rms_alt_px, s_pantilt.pan_rad, s_pantilt.tilt_rad};
    for (uint32_t k = 0u; k < 8u; k++) { TEST_ASSERT_DOUBLE_WITHIN(1e-12, 3.0 + 3.0 * (double)k, got[k]); }
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, 30.0 + 3.0 * (double)j, s_arm.q[j]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, 60.0 + 3.0 * (double)j, s_arm.dq[j]);
    }
    for (uint32_t i = 0u; i < 8u * KC_TAG_MAX; i++) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-10, 300.0 + 3.0 * (double)i, s_mean.corner_px[i]);
    }
    for (uint32_t i = 0u; i < 36u; i++) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-10, 600.0 + 3.0 * (double)i, s_mean.cov[i]);
    }
    for (uint32_t i = 0u; i < 3u; i++) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.3 + 3.0 * (double)i, s_mean.p_cam_tool_m[i]);
    }
}

void test_each_axis_has_the_floor_of_its_kind(void)
{
    s_config.sigma_pos_min_m = 0.01;
    s_config.sigma_rot_min_rad = 0.02;
    add(0.1, 0.0);
    mean();
    for (uint32_t i = 0u; i < 6u; i++) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-15, i < 3u ? 1e-4 : 4e-4, s_mean.cov[7u * i]);
    }
}

/* The same number of tags, the second one another; and one more. */
void test_any_other_tag_keeps_corners_from_being_averaged(void)
{
    s_d.n_tags = 2u;
    s_d.tag_id[1] = 3;
    add(0.1, 0.0);
    s_d.tag_id[1] = 4;
    add(0.3, 0.0);
    s_d.tag_id[1] = 3;
    add(0.5, 0.0); /* the first two again: still not */
    mean();
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 10.0, s_mean.corner_px[0]);
    kc_frames_clear(&s_f);
    add(0.1, 0.0);
    s_d.n_tags = 1u;
    add(0.3, 0.0);
    mean();
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 10.0, s_mean.corner_px[0]);
}

/* What an earlier detection left behind the tags of this one. */
void test_tags_beyond_their_number_are_not_compared(void)
{
    for (uint32_t n = 1u; n < KC_TAG_MAX; n++) {
        kc_frames_clear(&s_f);
        s_d.n_tags = n;
        for (int32_t i = 0; i < (int32_t)KC_TAG_MAX; i++) { s_d.tag_id[i] = i; }
        add(0.1, 0.0);
        for (uint32_t i = n; i < KC_TAG_MAX; i++) { s_d.tag_id[i] = 99; }
        add(0.3, 0.0);
        mean();
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, 20.0, s_mean.corner_px[0]);
    }
}

void test_turns_about_every_axis_are_averaged(void)
{
    for (uint32_t axis = 0u; axis < 3u; axis++) {
        kc_frames_clear(&s_f);
        for (uint32_t n = 1u; n <= 3u; n += 2u) {
            memset(s_d.q_cam_tool_wxyz, 0, sizeof s_d.q_cam_tool_wxyz);
            s_d.q_cam_tool_wxyz[0] = cos(0.05 * (double)n);
            s_d.q_cam_tool_wxyz[1u + axis] = sin(0.05 * (double)n);
            kc_frames_add(&s_f, &s_d, &s_arm, &s_pantilt);
        }
        mean();
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, sin(0.1), fabs(s_mean.q_cam_tool_wxyz[1u + axis]));
    }
}
