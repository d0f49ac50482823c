/* kc_arm.c: the DH product written out, and every refused table. Agreement with others: tests/oracle. */
#include <math.h>
#include <string.h>

#include "given_small_arm.h"
#include "kc_libm.h"
#include "unity.h"

static kc_arm_t s_arm;

void setUp(void) { given_small_arm(&s_arm); }

/* Rz(phi) Tz(d) Tx(a) Rx(alpha), multiplied out by hand. */
static kc_pose_t dh(double phi, double d, double a, double alpha)
{
    const double c = kc_cos(phi), s = kc_sin(phi), ca = kc_cos(alpha), sa = kc_sin(alpha);
    const kc_pose_t T = {{a * c, a * s, d}, {c, -s * ca, s * sa, s, c * ca, -c * sa, 0.0, sa, ca}};
    return T;
}

void test_forward_kinematics_is_the_product_of_eq_2(void)
{
    const double q[3] = {0.7, -0.3, 1.1};
    kc_pose_t want, T, got;
    kc_pose_from_quat(s_arm.base_xyz_m, s_arm.base_quat_wxyz, &want);
    for (int j = 0; j < 3; j++) {
        const kc_joint_t *joint = &s_arm.joint[j];
        T = j == 1 ? dh(joint->phi_rad, joint->d_m + q[j], joint->a_m, joint->alpha_rad)
                   : dh(joint->phi_rad + q[j], joint->d_m, joint->a_m, joint->alpha_rad);
        kc_pose_mul(&want, &T, &want);
    }
    kc_pose_from_quat(s_arm.tool_xyz_m, s_arm.tool_quat_wxyz, &T);
    kc_pose_mul(&want, &T, &want);
    kc_arm_fk(&s_arm, q, &got);
    for (int i = 0; i < 3; i++) { TEST_ASSERT_DOUBLE_WITHIN(1e-15, want.p_m[i], got.p_m[i]); }
    for (int i = 0; i < 9; i++) { TEST_ASSERT_DOUBLE_WITHIN(1e-15, want.R[i], got.R[i]); }
}

void test_the_kinematics_crc_follows_joints_and_links_only(void)
{
    const uint32_t crc = kc_arm_kinematics_crc(&s_arm);
    TEST_ASSERT_TRUE(0u != crc);
    s_arm.joint[0].q_max += 0.1;
    s_arm.joint[1].mass_kg += 1.0;
    s_arm.tool_xyz_m[2] += 0.1;
    s_arm.joint[2].alpha_rad += 1e-9; /* as people round */
    TEST_ASSERT_EQUAL_HEX32(crc, kc_arm_kinematics_crc(&s_arm));
    for (uint32_t j = 0u; j < s_arm.n_joints; j++) {
        kc_arm_t other = s_arm;
        other.joint[j].phi_rad += 1e-5;
        TEST_ASSERT_TRUE(crc != kc_arm_kinematics_crc(&other));
        other = s_arm;
        other.joint[j].alpha_rad -= 1e-5;
        TEST_ASSERT_TRUE(crc != kc_arm_kinematics_crc(&other));
        other = s_arm;
        other.joint[j].a_m += 1e-5;
        TEST_ASSERT_TRUE(crc != kc_arm_kinematics_crc(&other));
        other = s_arm;
        other.joint[j].d_m -= 1e-5;
        TEST_ASSERT_TRUE(crc != kc_arm_kinematics_crc(&other));
        other = s_arm;
        other.joint[j].type = other.joint[j].type == KC_REVOLUTE ? KC_PRISMATIC : KC_REVOLUTE;
        TEST_ASSERT_TRUE(crc != kc_arm_kinematics_crc(&other));
    }
    s_arm.n_joints--;
    TEST_ASSERT_TRUE(crc != kc_arm_kinematics_crc(&s_arm));
}

void test_a_good_arm_is_accepted(void)
{
    int32_t index = -9;
    double got = -9.0;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_arm_validate(&s_arm, &index, &got));
    TEST_ASSERT_EQUAL_INT32(-9, index);
}

static void refused(int32_t index_want, double got_want)
{
    int32_t index = -9;
    double got = -9.0;
    TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, kc_arm_validate(&s_arm, &index, &got));
    TEST_ASSERT_EQUAL_INT32(index_want, index);
    TEST_ASSERT_EQUAL_DOUBLE(got_want, got);
    given_small_arm(&s_arm);
}

void test_wrong_counts_and_names_are_refused(void)
{
    s_arm.n_joints = 0u;
    refused(-1, 0.0);
    s_arm.n_joints = KC_JOINT_MAX + 1u;
    refused(-1, 9.0);
    memset(s_arm.name, 0, sizeof s_arm.name);
    refused(-1, 0.0);
}

/* Each joint is checked, as many as there may be, and none beyond them. */
void test_as_many_joints_as_there_may_be_are_checked(void)
{
    const kc_joint_t good = s_arm.joint[0];
    int32_t index = -9;
    double got = 0.0;
    for (uint32_t n = 1u; n <= KC_JOINT_MAX; n++) {
        for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { s_arm.joint[j] = good; }
        s_arm.n_joints = n;
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_arm_validate(&s_arm, &index, &got));
        for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) {
            s_arm.joint[j].speed_max = -1.0;
            TEST_ASSERT_EQUAL_INT(j < n ? KC_ERR_RANGE : KC_OK, kc_arm_validate(&s_arm, &index, &got));
            if (j < n) { TEST_ASSERT_EQUAL_INT32((int32_t)j, index); }
            s_arm.joint[j] = good;
        }
    }
}

void test_wrong_frames_and_gravity_are_refused(void)
{
    s_arm.base_quat_wxyz[0] = 0.9;
    refused(-1, kc_sqrt(0.81 + 0.36));
    s_arm.tool_xyz_m[1] = NAN;
    refused(-1, NAN);
    s_arm.gravity_m_s2[0] = INFINITY;
    refused(-1, INFINITY);
}

void test_wrong_joints_are_refused_by_number(void)
{
    s_arm.joint[1].type = 2u;
    refused(1, 2.0);
    s_arm.joint[0].has_mass = 3u;
    refused(0, 3.0);
    s_arm.joint[2].phi_rad = NAN;
    refused(2, NAN);
    s_arm.joint[2].alpha_rad = INFINITY;
    refused(2, INFINITY);
    s_arm.joint[2].a_m = NAN;
    refused(2, NAN);
    s_arm.joint[2].d_m = NAN;
    refused(2, NAN);
    s_arm.joint[0].q_min = 2.0;
    refused(0, 2.0);
    s_arm.joint[0].q_max = INFINITY;
    refused(0, INFINITY);
    s_arm.joint[0].q_min = -INFINITY;
    refused(0, -INFINITY);
    s_arm.joint[1].speed_max = 0.0;
    refused(1, 0.0);
    s_arm.joint[1].mass_kg = -1.0;
    refused(1, -1.0);
    s_arm.joint[1].com_m[2] = NAN;
    refused(1, NAN);
    s_arm.joint[1].gear_ratio = -2.0;
    refused(1, -2.0);
}

/* Its last number was chosen for this: the CRC of all of them is 0, which stands for any arm. */
void test_the_crc_of_an_arm_is_never_that_of_any_arm(void)
{
    memset(&s_arm.joint[0], 0, sizeof s_arm.joint[0]);
    s_arm.n_joints = 1u;
    s_arm.joint[0].a_m = 0.001;
    s_arm.joint[0].d_m = -1863.346618;
    TEST_ASSERT_EQUAL_UINT32(1u, kc_arm_kinematics_crc(&s_arm));
}

/* Rounded to the nearest 1e-6: half a step to each side is the same arm. */
void test_the_crc_is_that_of_numbers_rounded_to_the_nearest_millionth(void)
{
    s_arm.joint[0].a_m = 0.25;
    const uint32_t crc = kc_arm_kinematics_crc(&s_arm);
    s_arm.joint[0].a_m = 0.2500004;
    TEST_ASSERT_EQUAL_HEX32(crc, kc_arm_kinematics_crc(&s_arm));
    s_arm.joint[0].a_m = 0.2499996;
    TEST_ASSERT_EQUAL_HEX32(crc, kc_arm_kinematics_crc(&s_arm));
    s_arm.joint[0].a_m = 0.2500006;
    const uint32_t next = kc_arm_kinematics_crc(&s_arm);
    TEST_ASSERT_TRUE(crc != next);
    s_arm.joint[0].a_m = 0.250001;
    TEST_ASSERT_EQUAL_HEX32(next, kc_arm_kinematics_crc(&s_arm));
}
