#include "given_parts.h"

#include <string.h>

#include "given_observations.h"
#include "given_tables.h"
#include "kc_crc.h"
#include "kc_observation.h"
#include "kc_signed.h"
#include "kc_vec.h"
#include "unity.h"

parts_t parts;

void given_seal(kc_active_t *a, uint16_t kind)
{
    const void *at = kind == 0u ? &a->kin_prev : kc_tbl_active_ptr(a, kind);
    a->seal[kind] = kc_crc32(0u, at, kc_tbl_active_bytes(kind));
}

static void given_active(kc_active_t *a)
{
    given_arm(&a->arm);
    given_camera(&a->camera);
    given_terms(&a->terms);
    given_kin(&a->kin);
    given_kernel(&a->kernel);
    given_config(&a->config);
    for (uint32_t kind = 1u; kind < KC_TBL_COUNT; kind++) { a->crc[kind] = PARTS_CRC + kind; }
    given_space(&a->space, 9u, a->crc[KC_TBL_ARM]);
    for (uint16_t kind = 0u; kind < KC_TBL_COUNT; kind++) { given_seal(a, kind); }
}

void given_app(void)
{
    kc_app_t *app = &kc_app_instance;
    kc_app_init(app);
    given_active(&app->tables.active);
    app->clock = (kc_clock_t){PARTS_NOW_US, PARTS_NOW_US, 0u};
    app->place.since_us = PARTS_NOW_US;
    app->input.telemetry.has_arm = app->input.telemetry.has_pantilt = true;
    app->input.telemetry.arm_ok_us = app->input.telemetry.pantilt_ok_us = PARTS_NOW_US;
}

void given_signature(kc_cmd_t *cmd, const kc_key_t *key, uint64_t counter)
{
    uint8_t head[KC_SIGNED_HEAD_MAX];
    cmd->auth.key_id = key->id;
    cmd->auth.counter = counter;
    kc_auth_text_t text = kc_signed_cmd(cmd, head);
    kc_auth_mac(key, &text, cmd->auth.mac);
}

void given_parts(void)
{
    memset(&parts, 0, sizeof parts);
    parts.view = (kc_view_t){.clock = &parts.clock,
                             .place = &parts.place,
                             .tables = &parts.tables.active,
                             .telemetry = &parts.telemetry,
                             .cal = &parts.cal,
                             .plan = &parts.plan,
                             .latest = &parts.latest,
                             .est = &parts.est,
                             .servo_steps = &parts.servo_steps};
    given_active(&parts.tables.active);
    parts.clock.now_us = parts.clock.clock_us = parts.place.since_us = PARTS_NOW_US;
    parts.cal.candidate = -1;
}

void given_detection(const kc_arm_t *arm, const double *q, double tilt_rad, kc_detection_t *det)
{
    kc_pose_t tool, T;
    kc_arm_fk(arm, q, &tool);
    kc_camera_pose(&parts.tables.active.camera, 0.0, tilt_rad, &T);
    kc_pose_inv(&T, &T);
    kc_pose_mul(&T, &tool, &T);
    memcpy(det->p_cam_tool_m, T.p_m, sizeof T.p_m);
    kc_R_to_quat(T.R, det->q_cam_tool_wxyz);
    det->range_m = kc_v3_norm(T.p_m);
    for (uint32_t i = 0u; i < 6u; i++) {
        det->cov[7u * i] = i < 3u ? OBS_POS_M * OBS_POS_M : OBS_ROT_RAD * OBS_ROT_RAD;
    }
}

void given_measured(uint32_t n, double phi_rad, double noise, double tilt_rad)
{
    const kc_active_t *a = &parts.tables.active;
    const kc_pantilt_state_t pantilt = {0};
    kc_arm_t arm = a->arm;
    uint64_t rng = 7u;
    arm.joint[6].phi_rad += phi_rad;
    parts.est.arm = &a->arm;
    parts.est.terms = &a->terms;
    parts.est.opt = a->config.est;
    for (uint32_t i = 0u; i < n; i++) {
        kc_arm_state_t at = {.n_joints = 7u};
        kc_detection_t det = {0};
        kc_obs_t obs;
        double w[3], R[9], E[9];
        given_joints(&arm, &rng, at.q);
        given_detection(&arm, at.q, tilt_rad, &det);
        for (uint32_t k = 0u; k < 3u; k++) {
            det.p_cam_tool_m[k] += noise * OBS_POS_M * given_noise(&rng);
            w[k] = noise * OBS_ROT_RAD * given_noise(&rng);
        }
        kc_R_exp(w, E);
        kc_quat_to_R(det.q_cam_tool_wxyz, R);
        kc_m3_mul(E, R, R);
        kc_R_to_quat(R, det.q_cam_tool_wxyz);
        kc_observation(&a->camera, &det, &(kc_posture_t){&at, &pantilt, 0.0}, &obs);
        (void)kc_est_add(&parts.est, &obs);
        parts.plan.obs_of[i] = (uint8_t)i;
        parts.plan.pose_of[i] = (uint8_t)(i + 1u);
    }
    parts.plan.n_meas = parts.plan.n_obs = parts.plan.n_goal = n;
}

void expect_event(kc_event_id_t id, int32_t index, double got, double want)
{
    const kc_event_t *e = parts.out.events.e;
    TEST_ASSERT_EQUAL_UINT32(1u, parts.out.events.n);
    TEST_ASSERT_EQUAL_UINT16(id, e->id);
    TEST_ASSERT_EQUAL_INT32(index, e->index);
    TEST_ASSERT_EQUAL_DOUBLE(got, e->got);
    TEST_ASSERT_EQUAL_DOUBLE(want, e->want);
    memset(&parts.out, 0, sizeof parts.out);
}

void expect_refused(kc_answer_t answer, kc_status_t status, kc_event_id_t id, int32_t index, double got,
                    double want)
{
    TEST_ASSERT_EQUAL_INT(status, answer.status);
    TEST_ASSERT_EQUAL_INT(id, answer.event);
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, answer.outcome.id);
    expect_event(id, index, got, want);
}

void expect_taken(kc_answer_t answer, kc_outcome_id_t outcome)
{
    TEST_ASSERT_EQUAL_INT(KC_OK, answer.status);
    TEST_ASSERT_EQUAL_INT(KC_EVT_NONE, answer.event);
    TEST_ASSERT_EQUAL_INT(outcome, answer.outcome.id);
}
