/* kc_measure.c: what each frame of a measurement leads to, call by call, and what is measured. Means of frames:
 * test_kc_frames.c; the observation: test_kc_observation.c. */
#include "kc_measure.h"

#include <string.h>

#include "given_parts.h"
#include "unity.h"

#define FRAMES 3u
#define RETRIES 2u

static kc_frames_t s_frames;
static kc_request_t s_request;
static kc_detection_t s_det;

/* A frame is awaited. */
void setUp(void)
{
    given_parts();
    parts.tables.active.config.frames_per_meas = FRAMES;
    parts.tables.active.config.frame_retries = RETRIES;
    parts.est.terms = &parts.tables.active.terms;
    parts.est.arm = &parts.tables.active.arm;
    parts.telemetry.arm.n_joints = 7u;
    memset(&s_frames, 0, sizeof s_frames);
    memset(&s_request, 0, sizeof s_request);
    s_request.frame = KC_FRAME_AWAITED;
    s_request.asked_us = PARTS_NOW_US;
    s_det = (kc_detection_t){.n_tags = 1u, .q_cam_tool_wxyz = {1.0}, .q_alt_wxyz = {1.0}};
    s_det.p_cam_tool_m[2] = 1.0;
    for (uint32_t i = 0u; i < 6u; i++) { s_det.cov[7u * i] = 1e-6; }
}

static kc_outcome_id_t run(void)
{
    memset(&parts.out, 0, sizeof parts.out);
    kc_outcome_t oc = kc_measure_run(&s_frames, &s_request, &parts.est, KC_AT_SERVO_STEP, &parts.view,
                                     &parts.out);
    TEST_ASSERT_TRUE(oc.id != KC_OC_ABORT || oc.cause == KC_CAUSE_CAMERA);
    return oc.id;
}

/* With a frame that has come. */
static kc_outcome_id_t with(uint32_t n_tags, bool certain)
{
    s_det.n_tags = n_tags;
    kc_request_answer(&s_request, &s_det, certain);
    return run();
}

void test_so_many_frames_as_config_says_are_a_measurement(void)
{
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, run());
    for (uint32_t i = 1u; i < FRAMES; i++) {
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, with(1u, true));
        TEST_ASSERT_EQUAL_UINT32(i, s_frames.n);
        TEST_ASSERT_TRUE(parts.out.has_frame_request); /* at once */
    }
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, with(1u, true));
    TEST_ASSERT_FALSE(parts.out.has_frame_request);
    TEST_ASSERT_TRUE(parts.out.has_meas);
    TEST_ASSERT_EQUAL_UINT32(1u, parts.est.n_obs);
}

void test_frames_that_were_there_before_count(void)
{
    s_frames.n = FRAMES;
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, run());
    TEST_ASSERT_EQUAL_UINT32(FRAMES, parts.out.meas.n_frames);
}

void test_a_measurement_says_where_and_of_what_it_is(void)
{
    const kc_meas_t *m = &parts.out.meas;
    parts.plan.n_meas = 4u;
    parts.plan.n_obs = 6u;
    parts.cal.candidate = 5;
    parts.cal.replicate = 2;
    parts.cal.session = 9u;
    parts.clock.clock_us = 77u;
    s_frames.n = FRAMES - 1u;
    s_frames.pan_rad = 0.2 * (FRAMES - 1u);
    parts.telemetry.pantilt.pan_rad = 0.2;
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, with(1u, true));
    const uint32_t got[] = {m->pose,
                            m->observation,
                            (uint32_t)m->taken_at,
                            (uint32_t)m->candidate,
                            (uint32_t)m->replicate,
                            m->n_joints,
                            m->n_frames,
                            m->session,
                            (uint32_t)m->t_us};
    const uint32_t want[] = {5u, 7u, KC_AT_SERVO_STEP, 5u, 2u, 7u, FRAMES, 9u, 77u};
    TEST_ASSERT_EQUAL_UINT32_ARRAY(want, got, sizeof want / sizeof want[0]);
    TEST_ASSERT_EQUAL_MEMORY(parts.tables.active.crc, m->crc, sizeof m->crc);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.2, m->pan_rad);
    TEST_ASSERT_EQUAL_MEMORY(&m->obs, &parts.est.obs[0], sizeof m->obs);
    TEST_ASSERT_EQUAL_DOUBLE((double)PARTS_NOW_US * 1e-6, m->obs.ctx.t_s);
}

void test_frames_without_tags_are_taken_again_as_often_as_config_says(void)
{
    for (uint32_t i = 0u; i < RETRIES; i++) { TEST_ASSERT_EQUAL_INT(KC_OC_STAY, with(0u, true)); }
    TEST_ASSERT_EQUAL_INT(KC_OC_SKIP, with(0u, true));
}

void test_frames_that_stay_uncertain_skip_it_and_a_silent_camera_ends_all(void)
{
    for (uint32_t i = 0u; i < RETRIES; i++) { TEST_ASSERT_EQUAL_INT(KC_OC_STAY, with(1u, false)); }
    TEST_ASSERT_EQUAL_INT(KC_OC_SKIP, with(1u, false));
    s_request.frame = KC_FRAME_AWAITED;
    parts.clock.now_us += parts.tables.active.config.frame_timeout_us + 1u;
    TEST_ASSERT_EQUAL_INT(KC_OC_ABORT, run());
}

void test_whatever_moves_disturbs_it_as_often_as_config_says(void)
{
    for (uint32_t i = 0u; i <= RETRIES; i++) {
        parts.telemetry.arm.moving = i % 2u == 0u;
        parts.telemetry.pantilt.moving = i % 2u != 0u;
        TEST_ASSERT_EQUAL_INT(i < RETRIES ? KC_OC_DISTURBED : KC_OC_SKIP, with(1u, true));
        TEST_ASSERT_EQUAL_UINT32(0u, s_frames.n);
    }
}

void test_what_the_estimator_does_not_take_is_no_measurement(void)
{
    parts.est.n_obs = KC_MEAS_MAX;
    s_frames.n = FRAMES;
    TEST_ASSERT_EQUAL_INT(KC_OC_SKIP, run());
    TEST_ASSERT_FALSE(parts.out.has_meas);
}
