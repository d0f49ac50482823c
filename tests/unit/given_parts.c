#include "given_parts.h"

#include <string.h>

#include "given_tables.h"
#include "unity.h"

parts_t parts;

void given_parts(void)
{
    kc_active_t *a = &parts.tables.active;
    memset(&parts, 0, sizeof parts);
    parts.view = (kc_view_t){.clock = &parts.clock,
                             .place = &parts.place,
                             .tables = a,
                             .telemetry = &parts.telemetry,
                             .cal = &parts.cal,
                             .plan = &parts.plan,
                             .learned = &parts.learned,
                             .est = &parts.est,
                             .servo_steps = &parts.servo_steps};
    given_arm(&a->arm);
    given_camera(&a->camera);
    given_terms(&a->terms);
    given_kin(&a->kin);
    given_kernel(&a->kernel);
    given_config(&a->config);
    for (uint32_t kind = 1u; kind < KC_TBL_COUNT; kind++) { a->crc[kind] = PARTS_CRC + kind; }
    given_space(&a->space, 9u, a->crc[KC_TBL_ARM]);
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
