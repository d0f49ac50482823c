#include "given_parts.h"

#include <string.h>

#include "given_tables.h"
#include "kc_crc.h"
#include "kc_signed.h"
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
    app->clock = (kc_clock_t){PARTS_NOW_US, PARTS_NOW_US};
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
                             .learned = &parts.learned,
                             .est = &parts.est,
                             .servo_steps = &parts.servo_steps};
    given_active(&parts.tables.active);
    parts.clock.now_us = parts.clock.clock_us = parts.place.since_us = PARTS_NOW_US;
    parts.cal.candidate = -1;
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
