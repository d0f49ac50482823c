/* kc_answer.c: every refusal has its reason. */
#include <string.h>

#include "kc_answer.h"
#include "unity.h"

static kc_events_t s_ev;

void setUp(void) { memset(&s_ev, 0, sizeof s_ev); }

static void expect(kc_answer_t a, kc_status_t status, kc_event_id_t event, kc_outcome_id_t outcome)
{
    TEST_ASSERT_EQUAL_INT(status, a.status);
    TEST_ASSERT_EQUAL_INT(event, a.event);
    TEST_ASSERT_EQUAL_INT(outcome, a.outcome.id);
}

void test_what_is_done_has_an_outcome_and_no_reason(void)
{
    kc_event(&s_ev, KC_EVT_TBL_CRC, 1, 0.0, 0.0);
    expect(kc_answer_by(KC_OK, &s_ev, 0u, KC_OC_STORE), KC_OK, KC_EVT_NONE, KC_OC_STORE);
}

void test_the_reason_is_the_first_event_since_the_mark(void)
{
    kc_event(&s_ev, KC_EVT_BOOT, -1, 0.0, 0.0);
    kc_event(&s_ev, KC_EVT_TBL_CRC, 1, 0.0, 0.0);
    kc_event(&s_ev, KC_EVT_TBL_FORMAT, 1, 0.0, 0.0);
    expect(kc_answer_by(KC_ERR_CRC, &s_ev, 1u, KC_OC_STORE), KC_ERR_CRC, KC_EVT_TBL_CRC, KC_OC_STAY);
}

/* An event is recorded once a step, however often it occurs. */
void test_an_event_that_was_there_already_is_the_reason_too(void)
{
    kc_event(&s_ev, KC_EVT_TBL_CRC, 1, 0.0, 0.0);
    uint32_t mark = s_ev.n;
    kc_event(&s_ev, KC_EVT_TBL_CRC, 1, 0.0, 0.0);
    expect(kc_answer_by(KC_ERR_CRC, &s_ev, mark, KC_OC_STORE), KC_ERR_CRC, KC_EVT_TBL_CRC, KC_OC_STAY);
}

void test_a_refusal_without_any_event_says_so(void)
{
    expect(kc_answer_by(KC_ERR_ARG, &s_ev, 0u, KC_OC_STORE), KC_ERR_ARG, KC_EVT_NONE, KC_OC_STAY);
}
