/* kc_events.c: recording and the dictionary. */
#include <stdbool.h>
#include <string.h>

#include "kc_events.h"
#include "unity.h"

static kc_events_t s_q;

void setUp(void) { memset(&s_q, 0, sizeof s_q); }

void test_an_event_is_recorded_with_its_severity_and_values(void)
{
    kc_event(&s_q, KC_EVT_TBL_CRC, 3, 12.0, 13.0);
    TEST_ASSERT_EQUAL_UINT32(1u, s_q.n);
    TEST_ASSERT_EQUAL_UINT16(KC_EVT_TBL_CRC, s_q.e[0].id);
    TEST_ASSERT_EQUAL_UINT8(KC_SEV_ERROR, s_q.e[0].severity);
    TEST_ASSERT_EQUAL_INT32(3, s_q.e[0].index);
    TEST_ASSERT_EQUAL_DOUBLE(12.0, s_q.e[0].got);
    TEST_ASSERT_EQUAL_DOUBLE(13.0, s_q.e[0].want);
}

void test_a_repeat_of_id_and_index_is_recorded_once(void)
{
    kc_event(&s_q, KC_EVT_IN_STALE, 1, 5.0, 6.0);
    kc_event(&s_q, KC_EVT_IN_STALE, 1, 7.0, 8.0);
    TEST_ASSERT_EQUAL_UINT32(1u, s_q.n);
    TEST_ASSERT_EQUAL_DOUBLE(5.0, s_q.e[0].got);
    TEST_ASSERT_EQUAL_UINT32(0u, s_q.dropped);
}

void test_another_index_is_another_event(void)
{
    kc_event(&s_q, KC_EVT_IN_STALE, 1, 5.0, 6.0);
    kc_event(&s_q, KC_EVT_IN_STALE, 2, 5.0, 6.0);
    kc_event(&s_q, KC_EVT_IN_RANGE, 1, 5.0, 6.0);
    TEST_ASSERT_EQUAL_UINT32(3u, s_q.n);
}

void test_events_beyond_the_capacity_are_counted_as_dropped(void)
{
    for (int32_t i = 0; i < (int32_t)KC_EVENTS_MAX + 3; i++) { kc_event(&s_q, KC_EVT_CAL_HELD, i, 0.0, 0.0); }
    TEST_ASSERT_EQUAL_UINT32(KC_EVENTS_MAX, s_q.n);
    TEST_ASSERT_EQUAL_UINT32(3u, s_q.dropped);
    /* a repeat of a recorded one is no loss */
    kc_event(&s_q, KC_EVT_CAL_HELD, 0, 0.0, 0.0);
    TEST_ASSERT_EQUAL_UINT32(3u, s_q.dropped);
}

void test_the_dictionary_knows_name_text_and_severity(void)
{
    TEST_ASSERT_EQUAL_STRING("TBL_STAGED", kc_event_name(KC_EVT_TBL_STAGED));
    TEST_ASSERT_EQUAL_STRING("{index:store} staged, {got:count} bytes", kc_event_text(KC_EVT_TBL_STAGED));
    TEST_ASSERT_EQUAL_STRING("Next: TABLE_VALIDATE, then TABLE_ACTIVATE.",
                             kc_event_action(KC_EVT_TBL_STAGED));
    TEST_ASSERT_EQUAL_INT(KC_SEV_INFO, kc_event_severity(KC_EVT_TBL_STAGED));
}

void test_an_unknown_id_is_named_unknown_and_counts_as_an_error(void)
{
    TEST_ASSERT_EQUAL_STRING("UNKNOWN", kc_event_name(9999u));
    TEST_ASSERT_EQUAL_STRING("", kc_event_text(9999u));
    TEST_ASSERT_EQUAL_STRING("", kc_event_action(9999u));
    TEST_ASSERT_EQUAL_INT(KC_SEV_ERROR, kc_event_severity(9999u));
}

#define ID_(id, name, sev, text, action) (id),
void test_ids_rise_so_that_none_is_used_twice(void)
{
    static const uint16_t ids[] = {KC_EVENT_LIST(ID_)};
    for (size_t i = 1u; i < sizeof ids / sizeof ids[0]; i++) {
        TEST_ASSERT_GREATER_THAN_UINT16(ids[i - 1u], ids[i]);
    }
    for (size_t i = 0u; i < sizeof ids / sizeof ids[0]; i++) { /* and each is found */
        TEST_ASSERT_TRUE(strcmp("UNKNOWN", kc_event_name(ids[i])) != 0);
        TEST_ASSERT_TRUE(kc_event_text(ids[i])[0] != '\0');
    }
}

#define TYPE_(type, how) type,
static bool known_type(const char *type, size_t n)
{
    static const char *const types[] = {KC_EVENT_TYPE_LIST(TYPE_)};
    for (size_t i = 0u; i < sizeof types / sizeof types[0]; i++) {
        if (strlen(types[i]) == n && strncmp(types[i], type, n) == 0) { return true; }
    }
    return false;
}

/* The placeholder that begins at p, up to its closing brace: {index:type}, {got:type} or {want:type}. */
static bool known_placeholder(const char *p)
{
    static const char *const fields[] = {"{index:", "{got:", "{want:"};
    const char *end = strchr(p, '}');
    for (size_t i = 0u; end != NULL && i < sizeof fields / sizeof fields[0]; i++) {
        const char *type = p + strlen(fields[i]);
        if (strncmp(p, fields[i], strlen(fields[i])) == 0) { return known_type(type, (size_t)(end - type)); }
    }
    return false;
}

#define TEXT_(id, name, sev, text, action) text,
void test_every_placeholder_names_a_value_and_a_known_type(void)
{
    static const char *const texts[] = {KC_EVENT_LIST(TEXT_)};
    for (size_t i = 0u; i < sizeof texts / sizeof texts[0]; i++) {
        for (const char *p = strchr(texts[i], '{'); p != NULL; p = strchr(p + 1, '{')) {
            TEST_ASSERT_TRUE_MESSAGE(known_placeholder(p), texts[i]);
        }
    }
}

#define ACTION_(id, name, sev, text, action) {KC_SEV_##sev, action},
void test_every_warning_and_error_says_what_to_do_next(void)
{
    static const struct {
        int severity;
        const char *action;
    } rows[] = {KC_EVENT_LIST(ACTION_)};
    for (size_t i = 0u; i < sizeof rows / sizeof rows[0]; i++) {
        if (rows[i].severity >= KC_SEV_WARN) { TEST_ASSERT_NOT_EQUAL(0, strlen(rows[i].action)); }
    }
}

#define CAUSE_(number, name, text) (number),
void test_causes_count_up_from_zero_and_have_a_text(void)
{
    static const int32_t causes[] = {KC_CAUSE_LIST(CAUSE_)};
    for (int32_t i = 0; i < (int32_t)KC_CAUSE_COUNT; i++) {
        TEST_ASSERT_EQUAL_INT32(i, causes[i]);
        TEST_ASSERT_NOT_EQUAL(0, strlen(kc_cause_text(i)));
    }
    TEST_ASSERT_EQUAL_STRING("", kc_cause_text(-1));
    TEST_ASSERT_EQUAL_STRING("", kc_cause_text((int32_t)KC_CAUSE_COUNT));
}
