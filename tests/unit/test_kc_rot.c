/* kc_rot.c: half turns, tiny turns, aliasing. Agreement with scipy and mpmath: tests/oracle. */
#include <math.h>
#include <string.h>

#include "given_dense.h"
#include "kc_libm.h"
#include "kc_rot.h"
#include "unity.h"

static kc_pose_t some_pose(double x, double wx, double wy, double wz)
{
    const double w[3] = {wx, wy, wz};
    kc_pose_t T = {{x, 2.0 * x, -x}, {0.0}};
    kc_R_exp(w, T.R);
    return T;
}

void test_the_identity_changes_nothing(void)
{
    const kc_pose_t A = some_pose(1.0, 0.1, 0.2, 0.3);
    kc_pose_t I, out;
    kc_pose_identity(&I);
    kc_pose_mul(&A, &I, &out);
    expect_doubles(A.p_m, out.p_m, 12, 0.0);
    kc_pose_mul(&I, &A, &out);
    expect_doubles(A.p_m, out.p_m, 12, 0.0);
}

void test_a_pose_times_its_inverse_is_the_identity(void)
{
    const kc_pose_t A = some_pose(1.0, 0.4, -1.2, 2.0);
    kc_pose_t I, inv, out;
    kc_pose_identity(&I);
    kc_pose_inv(&A, &inv);
    kc_pose_mul(&A, &inv, &out);
    expect_doubles(I.p_m, out.p_m, 12, 1e-15);
}

void test_outputs_may_alias_inputs(void)
{
    const kc_pose_t A = some_pose(1.0, 0.4, -1.2, 2.0), B = some_pose(-0.5, 1.0, 0.0, 0.3);
    kc_pose_t want, X = A;
    kc_pose_mul(&A, &B, &want);
    kc_pose_mul(&X, &B, &X);
    expect_doubles(want.p_m, X.p_m, 12, 0.0);
    X = B;
    kc_pose_mul(&A, &X, &X);
    expect_doubles(want.p_m, X.p_m, 12, 0.0);
    kc_pose_inv(&A, &want);
    X = A;
    kc_pose_inv(&X, &X);
    expect_doubles(want.p_m, X.p_m, 12, 0.0);
    const double a[4] = {0.5, 0.5, 0.5, 0.5}, b[4] = {0.6, 0.8, 0.0, 0.0};
    double q[4], r[4] = {0.5, 0.5, 0.5, 0.5};
    kc_quat_mul(a, b, q);
    kc_quat_mul(r, b, r);
    expect_doubles(q, r, 4, 0.0);
}

void test_a_screw_turns_about_and_moves_along_its_own_axis(void)
{
    for (uint32_t axis = 0u; axis < 3u; axis++) {
        const kc_pose_t A = some_pose(0.7, 0.3, 0.9, -0.4);
        kc_pose_t S, want, got = A;
        double w[3] = {0.0, 0.0, 0.0};
        kc_pose_identity(&S);
        w[axis] = 0.8;
        kc_R_exp(w, S.R);
        S.p_m[axis] = 0.25;
        kc_pose_mul(&A, &S, &want);
        kc_pose_screw(&got, axis, 0.25, 0.8);
        expect_doubles(want.p_m, got.p_m, 12, 1e-15);
    }
}

void test_a_pose_from_a_table_has_its_origin_and_rotation(void)
{
    const double xyz[3] = {1.0, 2.0, 3.0}, q[4] = {kc_sqrt(0.5), 0.0, 0.0, kc_sqrt(0.5)};
    const double want[12] = {1.0, 2.0, 3.0, 0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0};
    kc_pose_t T;
    kc_pose_from_quat(xyz, q, &T);
    expect_doubles(want, T.p_m, 12, 1e-15);
}

void test_distance_is_exact_near_zero_and_at_a_half_turn(void)
{
    const double one[4] = {1.0, 0.0, 0.0, 0.0}, near[4] = {1.0, 0.0, 1e-10, 0.0};
    const double minus[4] = {-1.0, 0.0, -1e-10, 0.0}, half[4] = {0.0, 0.0, 1.0, 0.0};
    TEST_ASSERT_EQUAL_DOUBLE(0.0, kc_quat_dist_rad(one, one));
    TEST_ASSERT_DOUBLE_WITHIN(1e-24, 2e-10, kc_quat_dist_rad(one, near));
    TEST_ASSERT_DOUBLE_WITHIN(1e-24, 2e-10, kc_quat_dist_rad(one, minus));
    TEST_ASSERT_EQUAL_DOUBLE(KC_PI, kc_quat_dist_rad(one, half));
}

void test_normalize_refuses_what_has_no_direction_and_leaves_it(void)
{
    double zero[4] = {0.0, 1e-13, 0.0, 0.0}, nan[4] = {1.0, NAN, 0.0, 0.0},
           inf[4] = {INFINITY, 0.0, 0.0, 0.0};
    double good[4] = {3.0, 0.0, -4.0, 0.0};
    const double want[4] = {0.6, 0.0, -0.8, 0.0};
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, kc_quat_normalize(zero));
    TEST_ASSERT_EQUAL_DOUBLE(1e-13, zero[1]);
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, kc_quat_normalize(nan));
    TEST_ASSERT_EQUAL_DOUBLE(1.0, nan[0]);
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, kc_quat_normalize(inf));
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_quat_normalize(good));
    expect_doubles(want, good, 4, 1e-16);
}

void test_half_turns_about_the_axes_are_exact(void)
{
    for (int axis = 0; axis < 3; axis++) {
        double R[9] = {-1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0}, want[4] = {0.0, 0.0, 0.0, 0.0}, q[4];
        R[4 * axis] = 1.0;
        want[axis + 1] = 1.0;
        kc_R_to_quat(R, q);
        expect_doubles(want, q, 4, 0.0);
        for (int i = 0; i < 4; i++) { TEST_ASSERT_FALSE(signbit(q[i])); }
    }
}

void test_oblique_half_turns_have_w_zero_and_one_sign(void)
{
    /* 2 a a' - 1 for a = (-1, 1, 0) / sqrt 2: the quaternion is -a, first non-zero positive. */
    const double R[9] = {0.0, -1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, -1.0};
    const double want[4] = {0.0, kc_sqrt(0.5), -kc_sqrt(0.5), 0.0};
    double q[4], w[3];
    kc_R_to_quat(R, q);
    expect_doubles(want, q, 4, 2e-16);
    kc_R_log(R, w);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, KC_PI, kc_sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]));
}

void test_every_largest_component_comes_back(void)
{
    static const double q[4][4] = {
        {0.9, 0.3, -0.3, 0.1}, {0.1, 0.9, 0.3, -0.3}, {0.1, -0.3, 0.9, 0.3}, {0.1, 0.3, 0.3, -0.9}};
    for (int k = 0; k < 4; k++) {
        double u[4], R[9], back[4];
        memcpy(u, q[k], sizeof u);
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_quat_normalize(u));
        kc_quat_to_R(u, R);
        kc_R_to_quat(R, back);
        expect_doubles(u, back, 4, 1e-15);
    }
}

void test_exp_and_log_undo_each_other_for_tiny_and_large_turns(void)
{
    static const double size[8] = {0.0, 1e-12, 1e-5, 1.9e-4, 2.1e-4, 1e-3, 1.0, 3.14};
    for (int k = 0; k < 8; k++) {
        const double w[3] = {0.6 * size[k], -0.64 * size[k], 0.48 * size[k]};
        double R[9], back[3];
        kc_R_exp(w, R);
        kc_R_log(R, back);
        expect_doubles(w, back, 3, 4e-15);
    }
}

void test_the_residual_is_measured_minus_model(void)
{
    const kc_pose_t model = some_pose(0.5, 0.3, -0.2, 1.0);
    const double w[3] = {0.01, 0.02, -0.03}, want[6] = {0.1, 0.2, 0.3, 0.01, 0.02, -0.03};
    kc_pose_t turn = {{0.0, 0.0, 0.0}, {0.0}}, meas;
    double r[6];
    kc_R_exp(w, turn.R);
    kc_pose_mul(&turn, &model, &meas); /* the base-frame turn on the left */
    for (int i = 0; i < 3; i++) { meas.p_m[i] = model.p_m[i] + want[i]; }
    kc_pose_residual(&meas, &model, r);
    expect_doubles(want, r, 6, 1e-15);
}

/* 2 a a' - 1 for a = (0.6, -0.8, 0), whose largest part is negative: still the first non-zero one is positive. */
void test_a_half_turn_whose_largest_part_is_negative_has_the_same_sign_rule(void)
{
    const double R[9] = {-0.28, -0.96, 0.0, -0.96, 0.28, 0.0, 0.0, 0.0, -1.0};
    const double want[4] = {0.0, 0.6, -0.8, 0.0};
    double q[4];
    kc_R_to_quat(R, q);
    expect_doubles(want, q, 4, 2e-16);
}

void test_the_product_of_quaternions_is_that_of_their_rotations(void)
{
    double a[4] = {0.5, -0.3, 0.7, 0.2}, b[5] = {-0.4, 0.6, 0.1, 0.9, 7.0}, ab[4], A[9], B[9],
           want[9] = {0.0}, got[9];
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_quat_normalize(a));
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_quat_normalize(b));
    TEST_ASSERT_EQUAL_DOUBLE(7.0, b[4]); /* four numbers */
    kc_quat_mul(a, b, ab);
    kc_quat_to_R(a, A);
    kc_quat_to_R(b, B);
    kc_quat_to_R(ab, got);
    for (int i = 0; i < 9; i++) {
        for (int k = 0; k < 3; k++) { want[i] += A[3 * (i / 3) + k] * B[3 * k + i % 3]; }
    }
    expect_doubles(want, got, 9, 1e-15);
}

/* Rodrigues: R = 1 + sin t [a] + (1 - cos t) [a]^2, on both sides of where the series takes over. */
void test_exp_is_the_formula_of_rodrigues(void)
{
    const double a[3] = {0.48, -0.64, 0.6}, size[4] = {1.9e-4, 2.1e-4, 0.7, 3.0};
    const double K[9] = {0.0, -0.6, -0.64, 0.6, 0.0, -0.48, 0.64, 0.48, 0.0};
    for (int n = 0; n < 4; n++) {
        const double t = size[n], w[3] = {a[0] * t, a[1] * t, a[2] * t};
        double R[9];
        kc_R_exp(w, R);
        for (int i = 0; i < 9; i++) {
            double K2 = 0.0;
            for (int k = 0; k < 3; k++) { K2 += K[3 * (i / 3) + k] * K[3 * k + i % 3]; }
            const double half = sin(0.5 * t);
            TEST_ASSERT_DOUBLE_WITHIN(
                1e-15, (i % 4 == 0 ? 1.0 : 0.0) + sin(t) * K[i] + 2.0 * half * half * K2, R[i]);
        }
    }
}

void test_the_distance_is_the_angle_between(void)
{
    const double a[4] = {cos(0.2), 0.0, sin(0.2), 0.0}, b[4] = {cos(0.75), 0.0, sin(0.75), 0.0};
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 1.1, kc_quat_dist_rad(a, b));
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 1.1, kc_quat_dist_rad(b, a));
}

/* 1 + 2 cos t is the trace of the rotation that leads from one to the other. */
void test_the_distance_is_that_of_the_rotations(void)
{
    double a[4] = {0.5, -0.3, 0.7, 0.2}, b[4] = {-0.4, 0.6, 0.1, 0.9}, A[9], B[9], trace = 0.0;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_quat_normalize(a));
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_quat_normalize(b));
    kc_quat_to_R(a, A);
    kc_quat_to_R(b, B);
    for (int i = 0; i < 9; i++) { trace += A[i] * B[i]; }
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, acos(0.5 * (trace - 1.0)), kc_quat_dist_rad(a, b));
}

/* The same bits for the same rotation: no zero has a sign. */
void test_zeros_of_a_quaternion_are_positive(void)
{
    static const double half[][4] = {{0.0, -0.6, 0.8, 0.0}, {0.0, 0.6, -0.8, 0.0}, {0.0, -0.6, 0.0, 0.8},
                                     {0.0, 0.0, -0.6, 0.8}, {0.8, -0.6, 0.0, 0.0}, {1.0, 0.0, 0.0, 0.0},
                                     {0.0, 0.0, 0.0, -1.0}, {0.0, -1.0, 0.0, 0.0}};
    for (uint32_t i = 0u; i < sizeof half / sizeof half[0]; i++) {
        double R[9], q[4];
        kc_quat_to_R(half[i], R);
        kc_R_to_quat(R, q);
        for (uint32_t k = 0u; k < 4u; k++) {
            TEST_ASSERT_DOUBLE_WITHIN(1e-15, fabs(half[i][k]), fabs(q[k]));
            TEST_ASSERT_FALSE(q[k] == 0.0 && signbit(q[k]));
        }
    }
}
