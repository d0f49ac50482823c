/* kc_observation.c: a detection as an observation in the base frame, and the planar flip. */
#include <string.h>

#include "given_tables.h"
#include "kc_observation.h"
#include "unity.h"

static kc_config_t s_config;

void setUp(void)
{
    given_config(&s_config);
    s_config.flip_rms_ratio = 2.0;
    s_config.flip_trust_rad = 0.5;
}

void test_the_second_pose_is_taken_if_it_is_about_as_good_and_nearer_to_the_prediction(void)
{
    TEST_ASSERT_TRUE(kc_observation_is_flipped(&s_config, 0.5, 1.0, 0.9, 0.5));
}

void test_a_second_pose_that_fits_the_image_worse_is_not_taken(void)
{
    TEST_ASSERT_FALSE(kc_observation_is_flipped(&s_config, 0.5, 1.01, 0.9, 0.1));
}

void test_a_second_pose_farther_from_the_prediction_is_not_taken(void)
{
    TEST_ASSERT_FALSE(kc_observation_is_flipped(&s_config, 0.5, 0.5, 0.2, 0.2));
    TEST_ASSERT_FALSE(kc_observation_is_flipped(&s_config, 0.5, 0.5, 0.2, 0.3));
}

void test_a_prediction_far_from_both_is_not_trusted(void)
{
    TEST_ASSERT_FALSE(kc_observation_is_flipped(&s_config, 0.5, 0.5, 0.9, 0.51));
}

/* ---- in the base frame ---- */

static kc_active_t s_tables;
static kc_detection_t s_det;
static kc_arm_state_t s_arm;
static kc_pantilt_state_t s_pantilt;
static kc_posture_t s_at;
static kc_obs_t s_obs;

static void given_detection(void)
{
    memset(&s_det, 0, sizeof s_det);
    given_arm(&s_tables.arm);
    given_camera(&s_tables.camera);
    given_terms(&s_tables.terms);
    s_tables.config = s_config;
    const double p[3] = {0.1, -0.2, 1.3}, q[4] = {0.8, 0.0, 0.6, 0.0};
    memcpy(s_det.p_cam_tool_m, p, sizeof p);
    memcpy(s_det.q_cam_tool_wxyz, q, sizeof q);
    s_det.n_tags = 1u;
    s_det.range_m = 1.4;
    s_det.incid_rad = 0.3;
    s_det.u_px = 959.5 + 139.7;
    s_det.v_px = 539.5 - 69.85;
    for (uint32_t i = 0u; i < 6u; i++) {
        for (uint32_t j = 0u; j < 6u; j++) { s_det.cov[6u * i + j] = 1e-6 * (double)(10u + i * j + i + j); }
    }
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) {
        s_arm.q[j] = 0.1 + (double)j;
        s_arm.dir[j] = j % 2u == 0u ? 1.0 : -1.0;
        s_arm.dq[j] = 0.01 * (double)j;
    }
    s_arm.g_m_s2[0] = 0.5;
    s_arm.g_m_s2[2] = -9.7;
    s_arm.temp_c = -20.0;
    s_arm.payload_kg = 2.5;
    s_pantilt.pan_rad = 0.4;
    s_pantilt.tilt_rad = 0.3;
    s_at = (kc_posture_t){.arm = &s_arm, .pantilt = &s_pantilt, .t_s = 77.0};
    kc_observation(&s_tables.camera, &s_det, &s_at, &s_obs);
}

void test_the_pose_is_the_cameras_times_what_it_sees(void)
{
    kc_pose_t cam, seen, want;
    double q[4];
    given_detection();
    kc_camera_pose(&s_tables.camera, 0.4, 0.3, &cam);
    kc_pose_from_quat(s_det.p_cam_tool_m, s_det.q_cam_tool_wxyz, &seen);
    kc_pose_mul(&cam, &seen, &want);
    kc_R_to_quat(want.R, q);
    for (uint32_t i = 0u; i < 3u; i++) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-15, want.p_m[i], s_obs.p_m[i]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-15, cam.p_m[i], s_obs.p_cam_m[i]);
    }
    for (uint32_t i = 0u; i < 4u; i++) { TEST_ASSERT_DOUBLE_WITHIN(1e-15, q[i], s_obs.q_wxyz[i]); }
    kc_R_to_quat(cam.R, q);
    for (uint32_t i = 0u; i < 4u; i++) { TEST_ASSERT_DOUBLE_WITHIN(1e-15, q[i], s_obs.q_cam_wxyz[i]); }
    TEST_ASSERT_TRUE(s_obs.has_rot == 1u && s_obs.has_cam == 1u);
}

/* diag(R, R) C diag(R, R)': every block, written out. */
void test_the_covariance_turns_with_the_camera(void)
{
    kc_pose_t cam;
    double B[36] = {0.0};
    given_detection();
    kc_camera_pose(&s_tables.camera, 0.4, 0.3, &cam);
    for (uint32_t i = 0u; i < 3u; i++) {
        for (uint32_t j = 0u; j < 3u; j++) { B[6u * i + j] = B[6u * (i + 3u) + j + 3u] = cam.R[3u * i + j]; }
    }
    for (uint32_t i = 0u; i < 6u; i++) {
        for (uint32_t j = 0u; j < 6u; j++) {
            double want = 0.0;
            for (uint32_t a = 0u; a < 6u; a++) {
                for (uint32_t b = 0u; b < 6u; b++) {
                    want += B[6u * i + a] * s_det.cov[6u * a + b] * B[6u * j + b];
                }
            }
            TEST_ASSERT_DOUBLE_WITHIN(1e-18, want, s_obs.cov[6u * i + j]);
        }
    }
}

void test_the_rest_is_what_arm_unit_and_image_say(void)
{
    given_detection();
    const kc_ctx_t *c = &s_obs.ctx;
    TEST_ASSERT_EQUAL_MEMORY(s_arm.q, c->q, sizeof c->q);
    TEST_ASSERT_EQUAL_MEMORY(s_arm.dir, c->dir, sizeof c->dir);
    TEST_ASSERT_EQUAL_MEMORY(s_arm.dq, c->qdot, sizeof c->qdot);
    TEST_ASSERT_EQUAL_MEMORY(s_arm.g_m_s2, c->g_m_s2, sizeof c->g_m_s2);
    TEST_ASSERT_EQUAL_MEMORY(s_det.p_cam_tool_m, c->p_cam_tool_m, sizeof c->p_cam_tool_m);
    const double want[] = {-20.0, 77.0, 2.5, 1.4, 0.3, 0.4, 0.3};
    const double got[] = {c->temp_c,    c->t_s,     c->payload_kg, c->range_m,
                          c->incid_rad, c->pan_rad, c->tilt_rad};
    for (uint32_t i = 0u; i < sizeof want / sizeof want[0]; i++) {
        TEST_ASSERT_EQUAL_DOUBLE(want[i], got[i]);
    }
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.1, c->u_norm);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, -0.05, c->v_norm);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, c->tag);
}

/* The tool as the model has it is the second solution: it becomes the first, whole, and the first one the second. */
void test_the_solutions_change_places_as_a_whole(void)
{
    const double zero[KC_COEF_MAX] = {0.0};
    kc_pose_t tool, cam;
    given_detection();
    kc_arm_fk(&s_tables.arm, s_arm.q, &tool);
    kc_camera_pose(&s_tables.camera, 0.4, 0.3, &cam);
    kc_pose_inv(&cam, &cam);
    kc_pose_mul(&cam, &tool, &tool);
    memcpy(s_det.p_alt_m, tool.p_m, sizeof s_det.p_alt_m);
    kc_R_to_quat(tool.R, s_det.q_alt_wxyz);
    s_det.rms_px = 0.5;
    s_det.rms_alt_px = 0.7;
    kc_detection_t det = s_det;
    kc_observation_unflip(&s_tables, zero, &s_at, &det);
    TEST_ASSERT_EQUAL_MEMORY(s_det.p_alt_m, det.p_cam_tool_m, sizeof det.p_alt_m);
    TEST_ASSERT_EQUAL_MEMORY(s_det.q_alt_wxyz, det.q_cam_tool_wxyz, sizeof det.q_alt_wxyz);
    TEST_ASSERT_EQUAL_MEMORY(s_det.p_cam_tool_m, det.p_alt_m, sizeof det.p_alt_m);
    TEST_ASSERT_EQUAL_MEMORY(s_det.q_cam_tool_wxyz, det.q_alt_wxyz, sizeof det.q_alt_wxyz);
    TEST_ASSERT_EQUAL_DOUBLE(0.7, det.rms_px);
    TEST_ASSERT_EQUAL_DOUBLE(0.5, det.rms_alt_px);
    kc_observation_unflip(&s_tables, zero, &s_at, &det); /* right now: it stays */
    TEST_ASSERT_EQUAL_DOUBLE(0.7, det.rms_px);
    det = s_det;
    det.n_tags = 0u; /* nothing was seen */
    kc_observation_unflip(&s_tables, zero, &s_at, &det);
    TEST_ASSERT_EQUAL_DOUBLE(0.5, det.rms_px);
}
