/* kc_measure.c: frames averaged, covariance, what breaks a measurement off. */
#include <math.h>
#include <string.h>

#include "given_world.h"
#include "kc_vec.h"
#include "unity.h"

#define APP (&kc_app_instance)

static kc_detection_t s_seen[32];
static uint32_t s_n;

static void record(kc_detection_t *d)
{
    if (world_measuring() && s_n < 32u) { s_seen[s_n++] = *d; }
}

void setUp(void);
void setUp(void)
{
    given_world();
    s_n = 0u;
}

static void measured(void)
{
    world.spoil = record;
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_UPDATE, 600u));
    TEST_ASSERT_EQUAL_UINT32(1u, world.n_meas);
}

void test_a_measurement_is_the_mean_of_its_frames(void)
{
    double p[3] = {0.0}, dw[3], mean[3] = {0.0}, Rm[9], R[9], E[9];
    world.noise_m = 2e-3;
    world.noise_rad = 5e-3;
    measured();
    const kc_meas_t *m = &world.meas[0];
    TEST_ASSERT_EQUAL_UINT32(3u, m->n_frames);
    TEST_ASSERT_EQUAL_UINT32(3u, s_n);
    kc_quat_to_R(m->det.q_cam_tool_wxyz, Rm);
    for (uint32_t k = 0u; k < 3u; k++) {
        kc_v3_add_scaled(p, 1.0 / 3.0, s_seen[k].p_cam_tool_m, p);
        kc_quat_to_R(s_seen[k].q_cam_tool_wxyz, R);
        for (uint32_t i = 0u; i < 3u; i++) { /* E = R Rm^T */
            for (uint32_t j = 0u; j < 3u; j++) {
                E[3u * i + j] = R[3u * i] * Rm[3u * j] + R[3u * i + 1u] * Rm[3u * j + 1u] +
                                R[3u * i + 2u] * Rm[3u * j + 2u];
            }
        }
        kc_R_log(E, dw);
        kc_v3_add_scaled(mean, 1.0 / 3.0, dw, mean);
    }
    for (uint32_t i = 0u; i < 3u; i++) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, p[i], m->det.p_cam_tool_m[i]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-6, 0.0, mean[i]); /* differences to the mean rotation cancel */
    }
}

void test_it_is_given_in_the_base_frame_with_its_camera_and_readings(void)
{
    kc_pose_t T_cam, T, T_true;
    measured();
    const kc_meas_t *m = &world.meas[0];
    kc_camera_pose(&world.camera, m->pan_rad, m->tilt_rad, &T_cam);
    kc_v3_copy(m->det.p_cam_tool_m, T.p_m);
    kc_quat_to_R(m->det.q_cam_tool_wxyz, T.R);
    kc_pose_mul(&T_cam, &T, &T);
    kc_arm_fk(&world.truth, m->arm.q, &T_true);
    for (uint32_t i = 0u; i < 3u; i++) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, T.p_m[i], m->obs.p_m[i]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-3, T_true.p_m[i], m->obs.p_m[i]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, T_cam.p_m[i], m->obs.p_cam_m[i]);
    }
    TEST_ASSERT_EQUAL_MEMORY(kc_app_active(APP)->crc, m->crc, sizeof m->crc);
    TEST_ASSERT_EQUAL_INT(0, m->candidate);
    TEST_ASSERT_EQUAL_UINT32(1u, m->session);
    TEST_ASSERT_EQUAL_DOUBLE(20.0, m->obs.ctx.temp_c);
    TEST_ASSERT_EQUAL_DOUBLE(-9.81, m->obs.ctx.g_m_s2[2]);
}

void test_averaging_lowers_the_covariance_down_to_the_floor(void)
{
    world.noise_m = 1.2e-3;   /* half of 1.44e-6 is above the floor of (0.2 mm)^2 */
    world.noise_rad = 1e-4;   /* half of 1e-8 is below that of (1 mrad)^2                */
    measured();
    const double *c = world.meas[0].obs.cov;
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 1.44e-6 * (1.0 + 2.0 * 0.25) / 3.0, c[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 1e-6, c[21]);
}

static void lopsided(kc_detection_t *d)
{
    d->cov[0] = 9e-6;
    d->cov[1] = d->cov[6] = 1e-6;
    d->cov[4] = d->cov[24] = 5e-8;
}

void test_the_covariance_turns_with_the_camera(void)
{
    kc_pose_t T;
    double C[36], want;
    world.noise_m = 1e-3;
    world.spoil = lopsided;
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_UPDATE, 600u));
    const kc_meas_t *m = &world.meas[0];
    memcpy(C, m->det.cov, sizeof C);
    kc_camera_pose(&world.camera, m->pan_rad, m->tilt_rad, &T);
    for (uint32_t i = 0u; i < 6u; i++) {
        for (uint32_t j = 0u; j < 6u; j++) {
            want = 0.0;
            for (uint32_t a = 0u; a < 6u; a++) {
                for (uint32_t b = 0u; b < 6u; b++) {
                    double ra = a / 3u == i / 3u ? T.R[3u * (i % 3u) + a % 3u] : 0.0;
                    double rb = b / 3u == j / 3u ? T.R[3u * (j % 3u) + b % 3u] : 0.0;
                    want += ra * C[6u * a + b] * rb;
                }
            }
            TEST_ASSERT_DOUBLE_WITHIN(1e-15, want, m->obs.cov[6u * i + j]);
        }
    }
}

static void fewer_tags(kc_detection_t *d)
{
    d->corner_px[3] = 100.0 + (double)s_n;
    if (!world_measuring()) { return; }
    if (s_n++ == 1u) {
        d->n_tags = 1u;
        d->tag_id[1] = -1;
    }
}

void test_the_frame_that_showed_the_tags_is_the_first_of_the_measurement(void)
{
    for (uint32_t n = 1u; n < 4u; n++) {
        given_world();
        world.config.frames_per_meas = n;
        world_started();
        TEST_ASSERT_TRUE(world_until(KC_ST_UPDATE, 600u));
        TEST_ASSERT_EQUAL_UINT32(n, world.meas[0].n_frames);
        TEST_ASSERT_EQUAL_UINT32(n, world.n_frames);
    }
}

void test_a_frame_of_an_arm_that_moved_is_not_part_of_a_measurement(void)
{
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_OBSERVE, 300u));
    world.arm_vibrates = 3;
    TEST_ASSERT_TRUE(world_until(KC_ST_REST, 3u));
    TEST_ASSERT_EQUAL_UINT32(0u, APP->frames.n);
    TEST_ASSERT_TRUE(world_until(KC_ST_UPDATE, 600u));
    TEST_ASSERT_EQUAL_UINT32(3u, world.meas[0].n_frames);
    TEST_ASSERT_TRUE(world.n_frames > 3u);
}

/* Arm, or pan-tilt unit, moves once while the frame is awaited, and is at rest when it comes. */
void test_a_frame_during_which_something_moved_is_not_part_of_a_measurement(void)
{
    for (uint32_t who = 0u; who < 2u; who++) {
        given_world();
        world_started();
        TEST_ASSERT_TRUE(world_until(KC_ST_OBSERVE, 300u));
        for (uint32_t i = 0u; i < 2u && !world.requested; i++) { world_tick(); }
        TEST_ASSERT_TRUE(world.requested);
        world.requested = false; /* the answer takes two ticks longer */
        world.arm_vibrates = who == 0u ? 1 : 0;
        world.pantilt_vibrates = who == 1u ? 1 : 0;
        world_ticks(2u);
        TEST_ASSERT_EQUAL_INT(KC_ST_OBSERVE, kc_app_state(APP));
        TEST_ASSERT_TRUE(kc_view_at_rest(&APP->view));
        world.requested = true;
        TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 3u));
        TEST_ASSERT_EQUAL_UINT32(0u, APP->frames.n);
        TEST_ASSERT_TRUE(world_until(KC_ST_UPDATE, 600u));
        TEST_ASSERT_EQUAL_UINT32(3u, world.meas[0].n_frames);
        TEST_ASSERT_EQUAL_UINT32(4u, world.n_frames);
    }
}

static void unlike_the_first(kc_detection_t *d)
{
    if (s_n++ == 0u) { d->p_cam_tool_m[0] += 0.05; }
}

/* The frame of OBSERVE is off by far: what follows does not agree with it, and no mean of both is measured. */
void test_a_wrong_first_frame_is_not_averaged_with_good_ones(void)
{
    world.spoil = unlike_the_first;
    world.config.servo.tol_pos_m = 0.1; /* so that it is measured there at once */
    world_started();
    TEST_ASSERT_TRUE(world_until_event(KC_EVT_DET_JUMP, 300u));
    TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_CAND_SKIPPED, 300u));
    TEST_ASSERT_EQUAL_UINT32(0u, world.n_meas);
}

void test_corners_are_averaged_only_over_frames_with_the_same_tags(void)
{
    world.spoil = fewer_tags;
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_UPDATE, 600u));
    TEST_ASSERT_EQUAL_DOUBLE(100.0, world.meas[0].det.corner_px[3]); /* those of the first frame */
    given_world();
    s_n = 10u;
    world.spoil = fewer_tags;
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_UPDATE, 600u));
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 111.0, world.meas[0].det.corner_px[3]);
}

void test_a_frame_without_tags_in_between_is_taken_again(void)
{
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 300u));
    world.hide = 2;
    TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_POSE, 100u));
    TEST_ASSERT_EQUAL_UINT32(3u, world.meas[0].n_frames);
}

void test_tags_that_stay_away_break_the_measurement_off(void)
{
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 300u));
    world.hide = 4;
    TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_CAND_SKIPPED, 100u));
    TEST_ASSERT_EQUAL_UINT32(0u, world.n_meas);
}

static void jumpy(kc_detection_t *d)
{
    if (kc_app_state(APP) == KC_ST_MEASURE && s_n++ > 0u) { d->p_cam_tool_m[0] += 0.05; }
}

void test_frames_that_keep_jumping_break_the_measurement_off(void)
{
    world.spoil = jumpy;
    world_started();
    TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_CAND_SKIPPED, 300u));
    TEST_ASSERT_EQUAL_UINT32(3u, world_events(KC_EVT_DET_JUMP));
    TEST_ASSERT_EQUAL_UINT32(0u, world.n_meas);
}

void test_a_vibration_restarts_the_measurement_once_all_is_at_rest(void)
{
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 300u));
    world_tick();
    world.arm_vibrates = 3;
    world_ticks(2u);
    TEST_ASSERT_EQUAL_INT(KC_ST_REST, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(0u, APP->frames.n);
    TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_POSE, 100u));
    TEST_ASSERT_EQUAL_UINT32(3u, world.meas[0].n_frames);
}

void test_a_place_that_keeps_shaking_is_skipped(void)
{
    world_started();
    for (uint32_t i = 0u; i < 3u; i++) {
        TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 300u));
        world.pantilt_vibrates = 2;
        world_ticks(2u);
    }
    TEST_ASSERT_TRUE(world_events(KC_EVT_CAL_CAND_SKIPPED) == 1u);
}

void test_a_measurement_that_the_estimator_does_not_take_is_skipped(void)
{
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_MEASURE, 300u));
    APP->est.n_obs = KC_MEAS_MAX; /* full */
    TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_CAND_SKIPPED, 100u));
    TEST_ASSERT_EQUAL_UINT32(0u, world.n_meas);
    TEST_ASSERT_EQUAL_UINT32(0u, APP->plan.n_meas);
}
