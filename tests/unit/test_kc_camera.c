/* kc_camera.c: aiming, projection, which tags are in view, refused tables. */
#include <math.h>
#include <string.h>

#include "kc_camera.h"
#include "kc_libm.h"
#include "kc_rng.h"
#include "unity.h"

static kc_camera_t s_cam;

/* The mast of the physical layout: pan-tilt x forward, camera z along it, two tags left and right. */
static void given_camera(void)
{
    memset(&s_cam, 0, sizeof s_cam);
    s_cam.mast_xyz_m[0] = -0.35;
    s_cam.mast_xyz_m[1] = 0.45;
    s_cam.mast_xyz_m[2] = 1.25;
    s_cam.mast_quat_wxyz[0] = 1.0;
    s_cam.pantilt_xyz_m[0] = 0.05;
    s_cam.pantilt_xyz_m[2] = 0.03;
    s_cam.pantilt_quat_wxyz[0] = 0.5; /* columns -y, -z, x of the pan-tilt unit */
    s_cam.pantilt_quat_wxyz[1] = -0.5;
    s_cam.pantilt_quat_wxyz[2] = 0.5;
    s_cam.pantilt_quat_wxyz[3] = -0.5;
    s_cam.pan_min_rad = -1.6;
    s_cam.pan_max_rad = 1.6;
    s_cam.tilt_min_rad = -0.6;
    s_cam.tilt_max_rad = 1.4;
    s_cam.fx_px = s_cam.fy_px = 1397.0;
    s_cam.cx_px = 959.5;
    s_cam.cy_px = 539.5;
    s_cam.width_px = 1920u;
    s_cam.height_px = 1080u;
    s_cam.n_tags = 2u;
    for (uint32_t i = 0u; i < 2u; i++) {
        s_cam.tag[i].id = (int32_t)i;
        s_cam.tag[i].size_m = 0.06;
        s_cam.tag[i].xyz_m[0] = i == 0u ? 0.075 : -0.075;
        s_cam.tag[i].quat_wxyz[0] = kc_cos(0.5 * 0.436);
        s_cam.tag[i].quat_wxyz[2] = i == 0u ? -kc_sin(0.5 * 0.436) : kc_sin(0.5 * 0.436);
    }
}

void setUp(void) { given_camera(); }

static void in_camera(double pan, double tilt, const double p_base[3], double p_cam[3])
{
    kc_pose_t T;
    kc_camera_pose(&s_cam, pan, tilt, &T);
    kc_pose_inv(&T, &T);
    for (int i = 0; i < 3; i++) {
        p_cam[i] = T.p_m[i];
        for (int j = 0; j < 3; j++) { p_cam[i] += T.R[3 * i + j] * p_base[j]; }
    }
}

void test_at_rest_it_looks_forward_with_x_right_and_y_down(void)
{
    const double want[9] = {0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0};
    kc_pose_t T;
    kc_camera_pose(&s_cam, 0.0, 0.0, &T);
    for (int i = 0; i < 9; i++) { TEST_ASSERT_DOUBLE_WITHIN(1e-15, want[i], T.R[i]); }
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, -0.30, T.p_m[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.45, T.p_m[1]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 1.28, T.p_m[2]);
}

void test_positive_tilt_looks_down_and_positive_pan_left(void)
{
    kc_pose_t T;
    kc_camera_pose(&s_cam, 0.0, 0.5, &T);
    TEST_ASSERT_TRUE(T.R[8] < 0.0); /* z of the optical axis */
    kc_camera_pose(&s_cam, 0.5, 0.0, &T);
    TEST_ASSERT_TRUE(T.R[5] > 0.0); /* y of the optical axis */
}

void test_aiming_puts_the_point_in_the_image_centre(void)
{
    uint64_t rng = 1u;
    for (int k = 0; k < 200; k++) {
        double p[3], pan, tilt, c[3], uv[2];
        p[0] = 0.1 + kc_rng_uniform(&rng);
        p[1] = 1.4 * kc_rng_uniform(&rng) - 0.7;
        p[2] = 1.5 * kc_rng_uniform(&rng);
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_camera_aim(&s_cam, p, &pan, &tilt));
        in_camera(pan, tilt, p, c);
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_camera_project(&s_cam, c, uv));
        TEST_ASSERT_DOUBLE_WITHIN(1e-8, 959.5, uv[0]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-8, 539.5, uv[1]);
    }
}

void test_aiming_works_for_a_turned_mast_and_an_oblique_camera_mount(void)
{
    const double p[3] = {0.3, -0.9, 0.2};
    double pan, tilt, c[3];
    s_cam.mast_quat_wxyz[0] = 0.8;
    s_cam.mast_quat_wxyz[3] = -0.6;
    s_cam.pantilt_xyz_m[1] = 0.04;
    s_cam.pantilt_quat_wxyz[0] = 0.52;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_quat_normalize(s_cam.pantilt_quat_wxyz));
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_camera_aim(&s_cam, p, &pan, &tilt));
    in_camera(pan, tilt, p, c);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.0, c[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.0, c[1]);
    TEST_ASSERT_TRUE(c[2] > 0.5);
}

/* A camera beside the pan axis has to turn on a little beyond the direction of the point: past half a turn, which is the
 * same as coming from the other side. */
void test_panning_past_half_a_turn_comes_from_the_other_side(void)
{
    double pan, tilt, c[3];
    s_cam.pan_min_rad = -4.0;
    s_cam.pan_max_rad = 4.0;
    for (int side = -1; side <= 1; side += 2) {
        const double p[3] = {s_cam.mast_xyz_m[0] - 1.0, s_cam.mast_xyz_m[1] - 0.05 * side, 1.0};
        s_cam.pantilt_xyz_m[1] = 0.2 * side;
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_camera_aim(&s_cam, p, &pan, &tilt));
        TEST_ASSERT_TRUE(fabs(pan) <= KC_PI && pan * side > 2.9);
        in_camera(pan, tilt, p, c);
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.0, c[0]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.0, c[1]);
        TEST_ASSERT_TRUE(c[2] > 0.5);
    }
}

void test_limits_clip_the_angles_and_say_so(void)
{
    const double behind[3] = {-3.0, -0.5, 1.0}, above[3] = {0.5, 0.45, 5.0}, below[3] = {-0.34, 0.45, 0.0};
    double pan, tilt;
    TEST_ASSERT_EQUAL_INT(KC_ERR_REACH, kc_camera_aim(&s_cam, behind, &pan, &tilt));
    TEST_ASSERT_EQUAL_DOUBLE(-1.6, pan);
    TEST_ASSERT_EQUAL_INT(KC_ERR_REACH, kc_camera_aim(&s_cam, above, &pan, &tilt));
    TEST_ASSERT_EQUAL_DOUBLE(-0.6, tilt);
    TEST_ASSERT_EQUAL_INT(KC_ERR_REACH, kc_camera_aim(&s_cam, below, &pan, &tilt));
    TEST_ASSERT_EQUAL_DOUBLE(1.4, tilt);
}

void test_points_inside_the_pantilt_unit_cannot_be_aimed_at(void)
{
    double pan, tilt;
    TEST_ASSERT_EQUAL_INT(KC_ERR_REACH, kc_camera_aim(&s_cam, s_cam.mast_xyz_m, &pan, &tilt));
    TEST_ASSERT_TRUE(isfinite(pan) && isfinite(tilt));
    /* Between centre and lens: the axis passes at that distance only behind the lens. */
    const double inside[3] = {-0.31, 0.45, 1.25};
    TEST_ASSERT_EQUAL_INT(KC_ERR_REACH, kc_camera_aim(&s_cam, inside, &pan, &tilt));
    /* A camera that observations along y of the pan-tilt unit, which tilt does not move, cannot
     * observation straight up. */
    s_cam.pantilt_xyz_m[0] = s_cam.pantilt_xyz_m[2] = 0.0;
    s_cam.pantilt_quat_wxyz[0] = s_cam.pantilt_quat_wxyz[1] = kc_sqrt(0.5);
    s_cam.pantilt_quat_wxyz[2] = s_cam.pantilt_quat_wxyz[3] = 0.0;
    const double up[3] = {-0.35, 0.45, 3.0}, down[3] = {-0.35, 0.45, -3.0};
    TEST_ASSERT_EQUAL_INT(KC_ERR_REACH, kc_camera_aim(&s_cam, up, &pan, &tilt));
    TEST_ASSERT_EQUAL_INT(KC_ERR_REACH, kc_camera_aim(&s_cam, down, &pan, &tilt));
    TEST_ASSERT_TRUE(isfinite(pan) && isfinite(tilt));
}

void test_projection_is_a_pinhole(void)
{
    const double p[3] = {0.2, -0.1, 2.0};
    double uv[2];
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_camera_project(&s_cam, p, uv));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 959.5 + 139.7, uv[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 539.5 - 69.85, uv[1]);
}

void test_what_is_not_in_front_has_no_image(void)
{
    const double behind[3] = {0.0, 0.0, -1.0}, at[3] = {0.0, 0.0, 0.0}, nan[3] = {0.0, 0.0, NAN};
    double uv[2] = {7.0, 7.0};
    TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, kc_camera_project(&s_cam, behind, uv));
    TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, kc_camera_project(&s_cam, at, uv));
    TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, kc_camera_project(&s_cam, nan, uv));
    TEST_ASSERT_EQUAL_DOUBLE(7.0, uv[0]);
}

/* Tool in front of the camera, its tags facing it, turned about y. */
static kc_pose_t facing(double x, double y, double z, double turn_y)
{
    kc_pose_t T;
    kc_pose_identity(&T);
    T.p_m[0] = x;
    T.p_m[1] = y;
    T.p_m[2] = z;
    kc_pose_screw(&T, 1u, 0.0, turn_y);
    return T;
}

void test_both_tags_are_visible_square_on(void)
{
    const kc_pose_t T = facing(0.0, 0.0, 1.0, 0.0);
    TEST_ASSERT_EQUAL_UINT32(3u, kc_camera_visible(&s_cam, &T, 0.87));
}

void test_a_tag_that_is_too_oblique_is_not_counted(void)
{
    kc_pose_t T = facing(0.0, 0.0, 1.0, 0.5);
    TEST_ASSERT_EQUAL_UINT32(1u, kc_camera_visible(&s_cam, &T, 0.87));
    T = facing(0.0, 0.0, 1.0, -0.5);
    TEST_ASSERT_EQUAL_UINT32(2u, kc_camera_visible(&s_cam, &T, 0.87));
    T = facing(0.0, 0.0, 1.0, KC_PI);
    TEST_ASSERT_EQUAL_UINT32(0u, kc_camera_visible(&s_cam, &T, 0.87));
}

void test_every_edge_of_the_image_cuts_tags_off(void)
{
    /* Half the image is 0.687 m by 0.386 m at 1 m. */
    kc_pose_t T = facing(0.62, 0.0, 1.0, 0.0);
    TEST_ASSERT_EQUAL_UINT32(2u, kc_camera_visible(&s_cam, &T, 1.3));
    T = facing(-0.62, 0.0, 1.0, 0.0);
    TEST_ASSERT_EQUAL_UINT32(1u, kc_camera_visible(&s_cam, &T, 1.3));
    T = facing(0.0, 0.38, 1.0, 0.0);
    TEST_ASSERT_EQUAL_UINT32(0u, kc_camera_visible(&s_cam, &T, 1.3));
    T = facing(0.0, -0.38, 1.0, 0.0);
    TEST_ASSERT_EQUAL_UINT32(0u, kc_camera_visible(&s_cam, &T, 1.3));
    T = facing(0.0, 0.0, -1.0, KC_PI); /* behind the camera, facing it */
    TEST_ASSERT_EQUAL_UINT32(0u, kc_camera_visible(&s_cam, &T, 1.3));
}

void test_the_white_border_must_be_inside_too(void)
{
    /* A tag square on: black edge 0.03 m from the centre, white border 0.0375 m; the image ends at 0.3862
     * m. */
    s_cam.n_tags = 1u;
    s_cam.tag[0].quat_wxyz[0] = 1.0;
    s_cam.tag[0].quat_wxyz[2] = 0.0;
    kc_pose_t T = facing(0.0, 0.345, 1.0, 0.0);
    TEST_ASSERT_EQUAL_UINT32(1u, kc_camera_visible(&s_cam, &T, 1.3));
    T = facing(0.0, 0.352, 1.0, 0.0);
    TEST_ASSERT_EQUAL_UINT32(0u, kc_camera_visible(&s_cam, &T, 1.3));
}

/* Numbers without rounding: corners on the middle of the outermost pixels are inside. */
void test_the_outermost_pixels_belong_to_the_image(void)
{
    s_cam.n_tags = 1u;
    memset(&s_cam.tag[0], 0, sizeof s_cam.tag[0]);
    s_cam.tag[0].quat_wxyz[0] = 1.0;
    s_cam.tag[0].size_m = 0.05; /* 1/32 from its middle to the border's edge */
    s_cam.fx_px = s_cam.fy_px = 1024.0;
    s_cam.cx_px = s_cam.cy_px = 512.0;
    s_cam.width_px = s_cam.height_px = 1024u;
    const double at[2] = {-0.5 + 0.03125, 511.0 / 1024.0 - 0.03125}, out[2] = {-1e-6, 1e-6};
    for (uint32_t k = 0u; k < 4u; k++) {
        const double *x = k < 2u ? &at[k] : NULL, *y = k < 2u ? NULL : &at[k - 2u];
        kc_pose_t T = facing(x != NULL ? *x : 0.0, y != NULL ? *y : 0.0, 1.0, 0.0);
        TEST_ASSERT_EQUAL_UINT32(1u, kc_camera_visible(&s_cam, &T, 1.3));
        T.p_m[k / 2u] += out[k % 2u];
        TEST_ASSERT_EQUAL_UINT32(0u, kc_camera_visible(&s_cam, &T, 1.3));
    }
}

/* Turned by an eighth in its plane, a tag has a corner on each axis: at every edge one of them is the first to leave. */
void test_each_corner_of_a_tag_must_be_inside(void)
{
    const double reach = 0.0375 * kc_sqrt(2.0), edge[2] = {959.5 / 1397.0, 539.5 / 1397.0};
    s_cam.n_tags = 1u;
    memset(&s_cam.tag[0].xyz_m, 0, sizeof s_cam.tag[0].xyz_m);
    s_cam.tag[0].quat_wxyz[0] = kc_cos(0.125 * KC_PI);
    s_cam.tag[0].quat_wxyz[2] = 0.0;
    s_cam.tag[0].quat_wxyz[3] = kc_sin(0.125 * KC_PI);
    for (uint32_t axis = 0u; axis < 2u; axis++) {
        for (int side = -1; side <= 1; side += 2) {
            double at[2] = {0.0, 0.0};
            at[axis] = side * (edge[axis] - reach - 1e-4);
            kc_pose_t T = facing(at[0], at[1], 1.0, 0.0);
            TEST_ASSERT_EQUAL_UINT32(1u, kc_camera_visible(&s_cam, &T, 1.3));
            at[axis] = side * (edge[axis] - reach + 1e-4);
            T = facing(at[0], at[1], 1.0, 0.0);
            TEST_ASSERT_EQUAL_UINT32(0u, kc_camera_visible(&s_cam, &T, 1.3));
        }
    }
}

void test_a_good_camera_is_accepted(void)
{
    int32_t index = -9;
    double got = -9.0;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_camera_validate(&s_cam, &index, &got));
    TEST_ASSERT_EQUAL_INT32(-9, index);
    s_cam.n_tags = 1u; /* and at their limits */
    s_cam.width_px = 1u;
    s_cam.height_px = 65535u;
    s_cam.tag[0].id = 586;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_camera_validate(&s_cam, &index, &got));
    s_cam.n_tags = KC_TAG_MAX;
    s_cam.width_px = 65535u;
    s_cam.height_px = 1u;
    for (uint32_t i = 0u; i < KC_TAG_MAX; i++) {
        s_cam.tag[i] = s_cam.tag[0];
        s_cam.tag[i].id = (int32_t)i;
    }
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_camera_validate(&s_cam, &index, &got));
}

static void refused(int32_t index_want, double got_want)
{
    int32_t index = -9;
    double got = -9.0;
    TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, kc_camera_validate(&s_cam, &index, &got));
    TEST_ASSERT_EQUAL_INT32(index_want, index);
    TEST_ASSERT_EQUAL_DOUBLE(got_want, got);
    given_camera();
}

void test_a_camera_with_wrong_numbers_is_refused(void)
{
    s_cam.mast_quat_wxyz[0] = 2.0;
    refused(-1, 2.0);
    s_cam.pantilt_xyz_m[0] = NAN;
    refused(-1, NAN);
    s_cam.pan_min_rad = 1.6;
    refused(-1, 1.6);
    s_cam.pan_max_rad = NAN;
    refused(-1, NAN);
    s_cam.tilt_min_rad = s_cam.tilt_max_rad;
    refused(-1, 1.4);
    s_cam.pan_min_rad = -INFINITY;
    refused(-1, -INFINITY);
    s_cam.pan_max_rad = INFINITY;
    refused(-1, INFINITY);
    s_cam.tilt_min_rad = -INFINITY;
    refused(-1, -INFINITY);
    s_cam.tilt_max_rad = INFINITY;
    refused(-1, INFINITY);
    s_cam.tilt_min_rad = 2.0;
    refused(-1, 2.0);
    s_cam.fx_px = 0.0;
    refused(-1, 0.0);
    s_cam.fy_px = -1.0;
    refused(-1, -1.0);
    s_cam.cx_px = INFINITY;
    refused(-1, INFINITY);
    s_cam.cy_px = NAN;
    refused(-1, NAN);
    s_cam.width_px = 0u;
    refused(-1, 0.0);
    s_cam.width_px = 65536u;
    refused(-1, 65536.0);
    s_cam.height_px = 0u;
    refused(-1, 0.0);
    s_cam.height_px = 65536u;
    refused(-1, 65536.0);
}

void test_a_camera_with_wrong_tags_is_refused_by_number(void)
{
    s_cam.n_tags = 0u;
    refused(-1, 0.0);
    s_cam.n_tags = KC_TAG_MAX + 1u;
    refused(-1, 5.0);
    s_cam.tag[1].id = 587;
    refused(1, 587.0);
    s_cam.tag[0].id = -1;
    refused(0, -1.0);
    s_cam.tag[1].id = 0; /* the id of tag 0 */
    refused(1, 0.0);
    s_cam.tag[1].size_m = 0.0;
    refused(1, 0.0);
    s_cam.tag[0].xyz_m[2] = NAN;
    refused(0, NAN);
    s_cam.tag[0].quat_wxyz[0] = 0.0;
    refused(0, kc_sin(0.5 * 0.436));
}

/* ---- errors of the chain ---- */

static const double PAN = 0.4, TILT = 0.3, SINCE_S = 200.0;

static void given_sigmas(void)
{
    const double turned[4] = {0.8, 0.0, 0.0, 0.6};
    memcpy(s_cam.mast_quat_wxyz, turned, sizeof turned);
    s_cam.mast_sigma_m = 1e-3;
    s_cam.mast_sigma_rad = 2e-3;
    s_cam.zero_sigma_rad = 3e-3;
    s_cam.axis_sigma_rad = 4e-3;
    s_cam.tag_size_sigma = 5e-3;
    s_cam.plate_sigma_m = 6e-3;
    s_cam.plate_sigma_rad = 7e-3;
    s_cam.drift_sigma_m_s = 8e-6;
    s_cam.drift_sigma_rad_s = 9e-6;
}

static void given_tool(kc_pose_t *tool)
{
    const double xyz[3] = {0.6, -0.2, 0.3}, quat[4] = {0.36, 0.48, -0.64, 0.48};
    kc_pose_from_quat(xyz, quat, tool);
}

/* Camera whose chain is off by shift_m and turn_rad (each times x) of the mast, of pan and tilt, and of the axes. */
static void off(const double shift_m[3], const double turn_rad[3], const double zero[2], const double axis[3],
                kc_pose_t *C)
{
    kc_pose_t T, mount;
    kc_pose_from_quat(s_cam.mast_xyz_m, s_cam.mast_quat_wxyz, C);
    kc_pose_identity(&T);
    memcpy(T.p_m, shift_m, sizeof T.p_m);
    kc_R_exp(turn_rad, T.R);
    kc_pose_mul(C, &T, C);
    kc_pose_screw(C, 2u, 0.0, PAN + zero[0]);
    kc_pose_screw(C, 0u, 0.0, axis[0]);
    kc_pose_screw(C, 1u, 0.0, TILT + zero[1]);
    kc_pose_screw(C, 0u, 0.0, axis[1]);
    kc_pose_screw(C, 2u, 0.0, axis[2]);
    kc_pose_from_quat(s_cam.pantilt_xyz_m, s_cam.pantilt_quat_wxyz, &mount);
    kc_pose_mul(C, &mount, C);
}

/* How far the tool seems to move: against H, to second order. */
static void expect_moved(const kc_pose_t *seen, const kc_pose_t *tool, const double H[6])
{
    double r[6];
    kc_pose_residual(seen, tool, r);
    double size = 0.0;
    for (uint32_t i = 0u; i < 6u; i++) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-4, H[i], r[i]);
        size = fmax(size, fabs(H[i]));
    }
    TEST_ASSERT_TRUE(size > 5e-4);
}

static void expect_seen(const double shift_m[3], const double turn_rad[3], const double zero[2],
                        const double axis[3], const double H[6])
{
    kc_pose_t tool, nominal, C;
    given_tool(&tool);
    kc_camera_pose(&s_cam, PAN, TILT, &nominal);
    kc_pose_inv(&nominal, &nominal);
    kc_pose_mul(&nominal, &tool, &nominal); /* as the camera sees it */
    off(shift_m, turn_rad, zero, axis, &C);
    kc_pose_mul(&C, &nominal, &C);
    expect_moved(&C, &tool, H);
}

void test_errors_of_the_chain_move_the_tool_as_the_chain_itself_does(void)
{
    static double H[KC_CHAIN_COUNT][6];
    const double none[3] = {0.0, 0.0, 0.0};
    kc_pose_t tool;
    given_sigmas();
    given_tool(&tool);
    kc_camera_chain(&s_cam, PAN, TILT, &tool, SINCE_S, H);
    for (uint32_t a = 0u; a < 3u; a++) {
        double shift[3] = {0.0, 0.0, 0.0}, turn[3] = {0.0, 0.0, 0.0}, axis[3] = {0.0, 0.0, 0.0};
        shift[a] = 1e-3;
        turn[a] = 2e-3;
        axis[a] = 4e-3;
        expect_seen(shift, none, none, none, H[KC_CHAIN_MAST + a]);
        expect_seen(none, turn, none, none, H[KC_CHAIN_MAST + 3u + a]);
        expect_seen(none, none, none, axis, H[KC_CHAIN_AXIS + a]);
        shift[a] = 8e-6 * SINCE_S;
        turn[a] = 9e-6 * SINCE_S;
        expect_seen(shift, none, none, none, H[KC_CHAIN_DRIFT + a]);
        expect_seen(none, turn, none, none, H[KC_CHAIN_DRIFT + 3u + a]);
        double zero[2] = {a == 0u ? 3e-3 : 0.0, a == 1u ? 3e-3 : 0.0};
        if (a < 2u) { expect_seen(none, none, zero, none, H[KC_CHAIN_ZERO + a]); }
    }
}

void test_errors_of_the_tags_move_the_tool_in_its_own_frame_and_along_the_line_of_sight(void)
{
    static double H[KC_CHAIN_COUNT][6];
    kc_pose_t tool, C, T;
    given_sigmas();
    given_tool(&tool);
    for (uint32_t k = 0u; k < 6u; k++) { H[KC_CHAIN_SIZE][k] = 9.0; }
    kc_camera_chain(&s_cam, PAN, TILT, &tool, SINCE_S, H);
    for (uint32_t a = 0u; a < 3u; a++) {
        double w[3] = {0.0, 0.0, 0.0};
        kc_pose_identity(&T);
        T.p_m[a] = 6e-3;
        kc_pose_mul(&tool, &T, &T);
        expect_moved(&T, &tool, H[KC_CHAIN_PLATE + a]);
        kc_pose_identity(&T);
        w[a] = 7e-3;
        kc_R_exp(w, T.R);
        kc_pose_mul(&tool, &T, &T);
        expect_moved(&T, &tool, H[KC_CHAIN_PLATE + 3u + a]);
    }
    kc_camera_pose(&s_cam, PAN, TILT, &C);
    T = tool;
    for (uint32_t i = 0u; i < 3u; i++) { T.p_m[i] += 5e-3 * (tool.p_m[i] - C.p_m[i]); }
    expect_moved(&T, &tool, H[KC_CHAIN_SIZE]);
}

void test_an_exact_chain_moves_nothing(void)
{
    static double H[KC_CHAIN_COUNT][6];
    kc_pose_t tool;
    given_tool(&tool);
    kc_camera_chain(&s_cam, PAN, TILT, &tool, SINCE_S, H);
    for (uint32_t k = 0u; k < KC_CHAIN_COUNT; k++) {
        for (uint32_t i = 0u; i < 6u; i++) { TEST_ASSERT_EQUAL_DOUBLE(0.0, H[k][i]); }
    }
}

void test_a_sigma_of_the_chain_that_is_no_size_is_refused(void)
{
    double *sigma[] = {&s_cam.mast_sigma_m,    &s_cam.mast_sigma_rad,  &s_cam.zero_sigma_rad,
                       &s_cam.axis_sigma_rad,  &s_cam.tag_size_sigma,  &s_cam.plate_sigma_m,
                       &s_cam.plate_sigma_rad, &s_cam.drift_sigma_m_s, &s_cam.drift_sigma_rad_s};
    const double bad[] = {-1e-6, (double)NAN, (double)INFINITY};
    int32_t index;
    double got;
    for (uint32_t k = 0u; k < 9u; k++) {
        for (uint32_t b = 0u; b < 3u; b++) {
            given_camera();
            *sigma[k] = bad[b];
            TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, kc_camera_validate(&s_cam, &index, &got));
            TEST_ASSERT_EQUAL_INT(-1, index);
        }
        *sigma[k] = 0.1;
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_camera_validate(&s_cam, &index, &got));
    }
}

void test_no_two_tags_have_one_number(void)
{
    for (uint32_t a = 0u; a < KC_TAG_MAX; a++) {
        for (uint32_t b = 0u; b < KC_TAG_MAX; b++) {
            int32_t index = -9;
            double got = -9.0;
            given_camera();
            s_cam.n_tags = KC_TAG_MAX;
            for (uint32_t i = 0u; i < KC_TAG_MAX; i++) {
                s_cam.tag[i] = s_cam.tag[0];
                s_cam.tag[i].id = 10 + (int32_t)i;
            }
            s_cam.tag[b].id = s_cam.tag[a].id;
            TEST_ASSERT_EQUAL_INT(a == b ? KC_OK : KC_ERR_RANGE, kc_camera_validate(&s_cam, &index, &got));
            if (a != b) { TEST_ASSERT_EQUAL_INT32((int32_t)(a > b ? a : b), index); }
        }
    }
}
