/* kc_review.c: a correction that waits, step by step: who may approve it, with which answer and which event. */
#include "kc_review.h"

#include <string.h>

#include "given_parts.h"
#include "given_tables.h"
#include "unity.h"

#define COEF 24u

static kc_review_t s_review;
static kc_tbl_scratch_t s_scratch;
static kc_keys_t s_keys;
static kc_kin_t s_kin;
static uint32_t s_crc;

static kc_config_t *config(void) { return &parts.tables.active.config; }

static uint32_t *active(void) { return &parts.tables.active.crc[KC_TBL_KIN]; }

/* A correction of one coefficient waits. */
static void given_waiting(kc_verdict_t verdict)
{
    memset(&s_review, 0, sizeof s_review);
    s_crc = kc_review_encode(&s_review, &s_kin, verdict);
    kc_review_wait(&s_review, &parts.out);
    memset(&parts.out, 0, sizeof parts.out);
}

void setUp(void)
{
    given_parts();
    parts.tables.scratch = &s_scratch;
    s_keys = (kc_keys_t){.n = 2u, .key = {{.id = 1u}, {.id = 101u}}};
    given_kin(&s_kin);
    s_kin.value[COEF] = 0.1;
    s_kin.arm_crc = PARTS_CRC + KC_TBL_ARM;
    s_kin.terms_crc = PARTS_CRC + KC_TBL_TERMS;
    s_kin.prev_crc = PARTS_CRC + KC_TBL_KIN;
    s_kin.n_poses = 8u;
    given_waiting(KC_VERDICT_CHANGE);
}

static void expect_deleted(void)
{
    TEST_ASSERT_EQUAL_UINT32(0u, s_review.crc);
    TEST_ASSERT_EQUAL_UINT32(1u, parts.out.n_store);
    TEST_ASSERT_EQUAL_UINT16(KC_STORE_PROPOSAL, parts.out.store[0].kind);
    TEST_ASSERT_EQUAL_UINT32(0u, parts.out.store[0].n);
}

/* ---- waiting ---- */

void test_what_is_encoded_does_not_wait_yet(void)
{
    kc_kin_t back;
    memset(&s_review, 0, sizeof s_review);
    s_crc = kc_review_encode(&s_review, &s_kin, KC_VERDICT_POOR);
    TEST_ASSERT_EQUAL_UINT32(0u, s_review.crc);
    TEST_ASSERT_EQUAL_UINT32(KC_VERDICT_NO_CHANGE, kc_review_verdict(&s_review));
    kc_review_wait(&s_review, &parts.out);
    expect_event(KC_EVT_COR_PROPOSED, -1, (double)s_crc, 8.0);
    TEST_ASSERT_EQUAL_HEX32(s_crc, s_review.crc);
    TEST_ASSERT_EQUAL_UINT32(KC_VERDICT_POOR, kc_review_verdict(&s_review));
    TEST_ASSERT_EQUAL_INT(KC_OK,
                          kc_tbl_decode(KC_TBL_KIN, s_review.image, s_review.n, &back, &parts.out.events));
    TEST_ASSERT_EQUAL_MEMORY(&s_kin, &back, sizeof back);
    TEST_ASSERT_EQUAL_MEMORY(&s_kin, &s_review.kin, sizeof s_kin);
}

void test_what_is_dropped_is_deleted_with_an_event_and_nothing_only_once(void)
{
    kc_review_drop(&s_review, &parts.out);
    expect_deleted();
    expect_event(KC_EVT_COR_REJECTED, -1, (double)s_crc, 0.0);
    kc_review_drop(&s_review, &parts.out);
    TEST_ASSERT_EQUAL_UINT32(0u, parts.out.events.n + parts.out.n_store);
}

void test_what_is_activated_is_in_force_and_waits_no_more(void)
{
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_review_activate(&s_review, &parts.tables, &parts.out));
    TEST_ASSERT_EQUAL_HEX32(s_crc, *active());
    TEST_ASSERT_EQUAL_DOUBLE(0.1, parts.tables.active.kin.value[COEF]);
    TEST_ASSERT_EQUAL_HEX32(PARTS_CRC + KC_TBL_KIN, parts.tables.active.kin_prev_crc);
    expect_deleted();
    parts.out.events.e[0] = parts.out.events.e[--parts.out.events.n]; /* the other one is of the table */
    expect_event(KC_EVT_COR_ACTIVE, -1, (double)s_crc, 0.0);
}

void test_what_does_not_fit_the_tables_is_not_activated_and_waits_on(void)
{
    parts.tables.active.crc[KC_TBL_TERMS] = 3u;
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, kc_review_activate(&s_review, &parts.tables, &parts.out));
    TEST_ASSERT_EQUAL_HEX32(PARTS_CRC + KC_TBL_KIN, *active());
    TEST_ASSERT_EQUAL_HEX32(s_crc, s_review.crc);
    TEST_ASSERT_EQUAL_UINT32(0u, parts.out.n_store);
}

/* ---- the first step ---- */

static kc_answer_t arm(uint32_t crc, int32_t overrides)
{
    const kc_cmd_t cmd = {
        .opcode = KC_CMD_APPROVE_ARM, .arg_i = {(int32_t)crc, overrides}, .auth = {.key_id = 101u}};
    return kc_review_arm(&s_review, config(), &s_keys, &cmd, &parts.out);
}

void test_a_good_fit_is_armed_by_its_crc_and_an_override_overrides_nothing(void)
{
    for (int32_t overrides = KC_OVERRIDE_NONE; overrides <= KC_OVERRIDE_FIT; overrides++) {
        s_review.armed_key = 0u;
        expect_taken(arm(s_crc, overrides), KC_OC_ARM);
        expect_event(KC_EVT_COR_ARMED, -1, (double)s_crc, 0.0);
        TEST_ASSERT_EQUAL_UINT32(101u, s_review.armed_key);
    }
}

void test_another_crc_or_override_is_refused(void)
{
    static const int32_t wrong[] = {-1, 2, INT32_MIN, INT32_MAX};
    expect_refused(arm(5u, KC_OVERRIDE_FIT), KC_ERR_CRC, KC_EVT_CMD_CRC, -1, 5.0, (double)s_crc);
    for (uint32_t i = 0u; i < sizeof wrong / sizeof wrong[0]; i++) {
        expect_refused(arm(s_crc, wrong[i]), KC_ERR_ARG, KC_EVT_CMD_ARG, 1, (double)wrong[i], 1.0);
    }
    TEST_ASSERT_EQUAL_UINT32(0u, s_review.armed_key);
}

void test_another_verdict_or_none_takes_an_override(void)
{
    static const struct {
        kc_verdict_t verdict;
        kc_event_id_t why;
    } cases[] = {{KC_VERDICT_POOR, KC_EVT_COR_POOR}, {KC_VERDICT_NO_CHANGE, KC_EVT_COR_NO_VERDICT}};
    for (uint32_t i = 0u; i < 2u; i++) {
        given_waiting(cases[i].verdict);
        expect_refused(arm(s_crc, KC_OVERRIDE_NONE), KC_ERR_ARG, cases[i].why, -1, (double)s_crc, 0.0);
        TEST_ASSERT_EQUAL_UINT32(0u, s_review.armed_key);
        expect_taken(arm(s_crc, KC_OVERRIDE_FIT), KC_OC_ARM);
        TEST_ASSERT_EQUAL_UINT32(101u, s_review.armed_key);
        const kc_events_t *ev = &parts.out.events;
        TEST_ASSERT_EQUAL_UINT32(2u, ev->n);
        TEST_ASSERT_EQUAL_UINT16(KC_EVT_COR_ARMED, ev->e[1].id);
        parts.out.events.n = 1u;
        expect_event(KC_EVT_COR_OVERRIDE, -1, (double)s_crc, 0.0);
    }
}

void test_under_the_rule_of_two_the_first_step_says_who_may_take_the_second(void)
{
    config()->go_by_other_key = 1u;
    config()->approval_timeout_us = 7000000u;
    expect_taken(arm(s_crc, KC_OVERRIDE_NONE), KC_OC_ARM);
    parts.out.events.e[0] = parts.out.events.e[--parts.out.events.n]; /* behind COR_ARMED */
    expect_event(KC_EVT_COR_OTHER_KEY, -1, 101.0, 7e6);
    s_keys.n = 1u; /* nobody else is there */
    expect_refused(arm(s_crc, KC_OVERRIDE_NONE), KC_ERR_STATE, KC_EVT_KEYS_ONE_HOLDER, -1, 1.0, 0.0);
}

void test_an_approval_expires_when_its_time_is_over(void)
{
    kc_hk_t hk = {0};
    config()->approval_timeout_us = 7000000u;
    config()->go_by_other_key = 1u;
    s_review.armed_key = 101u;
    parts.place.state = KC_ST_ARMED;
    for (uint32_t over = 0u; over < 3u; over++) {
        parts.clock.now_us = parts.place.since_us + 6999999u + over;
        TEST_ASSERT_EQUAL_INT(over < 2u ? KC_OC_STAY : KC_OC_EXPIRE,
                              kc_review_armed(&s_review, &parts.view, &parts.out).id);
        kc_review_report(&s_review, &parts.view, &hk);
        TEST_ASSERT_EQUAL_UINT64(over == 0u ? 1u : 0u, hk.approval_left_us);
        TEST_ASSERT_EQUAL_UINT32(over == 0u ? 101u : 0u, hk.armed_key);
    }
    expect_event(KC_EVT_COR_EXPIRED, -1, (double)s_crc, 0.0);
    TEST_ASSERT_EQUAL_HEX32(s_crc, hk.proposal_crc);
    TEST_ASSERT_EQUAL_UINT32(KC_VERDICT_CHANGE, hk.proposal_verdict);
    TEST_ASSERT_EQUAL_UINT8(1u, hk.go_by_other_key);
    parts.place.state = KC_ST_REVIEW;
    parts.clock.now_us = parts.place.since_us;
    kc_review_report(&s_review, &parts.view, &hk);
    TEST_ASSERT_EQUAL_UINT64(0u, hk.approval_left_us);
}

/* ---- the second step, and the ways out ---- */

static kc_answer_t go(uint32_t crc)
{
    const kc_cmd_t cmd = {.opcode = KC_CMD_APPROVE_GO, .arg_i = {(int32_t)crc}, .auth = {.key_id = 1u}};
    return kc_review_go(&s_review, &parts.tables, &cmd, &parts.out);
}

void test_the_second_step_stores_what_its_crc_names(void)
{
    memset(&s_review.kin, 0, sizeof s_review.kin); /* the image alone counts */
    expect_taken(go(s_crc), KC_OC_STORE);
    TEST_ASSERT_EQUAL_MEMORY(&s_kin, &s_review.kin, sizeof s_kin);
    expect_refused(go(5u), KC_ERR_CRC, KC_EVT_CMD_CRC, -1, 5.0, (double)s_crc);
}

void test_the_second_step_may_need_another_holder(void)
{
    config()->go_by_other_key = 1u;
    s_review.armed_key = 2u;
    expect_refused(go(s_crc), KC_ERR_AUTH, KC_EVT_CMD_SAME_KEY, KC_CMD_APPROVE_GO, 1.0, 2.0);
    s_review.armed_key = 101u;
    expect_taken(go(s_crc), KC_OC_STORE);
}

void test_what_changed_in_memory_or_fits_no_more_is_not_stored(void)
{
    kc_event(&parts.out.events, KC_EVT_CMD_STATE, 0, 0.0, 0.0); /* of another command of this step */
    s_review.image[100] ^= 8u;
    kc_answer_t answer = go(s_crc);
    TEST_ASSERT_EQUAL_INT(KC_ERR_CRC, answer.status);
    TEST_ASSERT_EQUAL_INT(KC_EVT_TBL_CRC, answer.event);
    s_review.image[100] ^= 8u;
    parts.tables.active.crc[KC_TBL_TERMS] = 3u;
    answer = go(s_crc);
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, answer.status);
    TEST_ASSERT_EQUAL_INT(KC_EVT_TBL_DEPENDS, answer.event);
}

void test_a_rejection_names_what_waits(void)
{
    expect_taken(kc_review_reject(&s_review, s_crc, &parts.out), KC_OC_STORE);
    expect_refused(kc_review_reject(&s_review, 7u, &parts.out), KC_ERR_CRC, KC_EVT_CMD_CRC, -1, 7.0,
                   (double)s_crc);
}

void test_a_rollback_names_what_is_in_force_and_needs_the_one_before(void)
{
    const double in_force = (double)*active();
    expect_refused(kc_review_rollback(&parts.tables, 6u, &parts.out), KC_ERR_CRC, KC_EVT_CMD_CRC, -1, 6.0,
                   in_force);
    expect_refused(kc_review_rollback(&parts.tables, *active(), &parts.out), KC_ERR_STATE,
                   KC_EVT_COR_NO_PREVIOUS, -1, 0.0, 0.0);
    parts.tables.active.kin_prev_crc = 9u;
    expect_taken(kc_review_rollback(&parts.tables, *active(), &parts.out), KC_OC_STORE);
}

/* ---- boot ---- */

static kc_status_t loaded(uint32_t n)
{
    static uint8_t image[KC_IMAGE_MAX];
    static kc_review_t from;
    (void)kc_review_encode(&from, &s_kin, KC_VERDICT_CHANGE);
    memcpy(image, from.image, from.n);
    parts.out.events.n = 0u;
    return kc_review_load(&s_review, &parts.tables, KC_VERDICT_POOR, image, n > 0u ? n : from.n,
                          &parts.out.events);
}

void test_a_stored_proposal_waits_with_the_verdict_of_the_journal(void)
{
    memset(&s_review, 0, sizeof s_review);
    TEST_ASSERT_EQUAL_INT(KC_OK, loaded(0u));
    TEST_ASSERT_EQUAL_HEX32(s_crc, s_review.crc);
    TEST_ASSERT_EQUAL_UINT32(KC_VERDICT_POOR, kc_review_verdict(&s_review));
    TEST_ASSERT_EQUAL_HEX32(s_crc, kc_tbl_image_crc(s_review.image, s_review.n));
    expect_taken(go(s_crc), KC_OC_STORE);
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, loaded(0u)); /* one is enough */
}

void test_a_stored_proposal_of_other_tables_or_of_none_is_dropped(void)
{
    uint32_t *crc = parts.tables.active.crc;
    memset(&s_review, 0, sizeof s_review);
    *active() = s_crc; /* it is in force already */
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, loaded(0u));
    TEST_ASSERT_EQUAL_UINT32(0u, parts.out.events.n);
    *active() = 2u; /* another one is since */
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, loaded(0u));
    expect_event(KC_EVT_TBL_DEPENDS, KC_TBL_KIN, (double)s_kin.prev_crc, 2.0);
    *active() = s_kin.prev_crc;
    crc[KC_TBL_ARM] = 1u;
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, loaded(0u));
    crc[KC_TBL_ARM] = s_kin.arm_crc;
    TEST_ASSERT_EQUAL_INT(KC_ERR_FORMAT, loaded(s_review.n + 40u));
    TEST_ASSERT_EQUAL_UINT32(0u, s_review.crc);
}

void test_an_image_larger_than_its_room_is_not_looked_into(void)
{
    memset(&s_review, 0, sizeof s_review);
    for (uint32_t over = 0u; over < 2u; over++) {
        TEST_ASSERT_EQUAL_INT(KC_ERR_FORMAT, loaded(KC_KIN_IMAGE_MAX + over));
        TEST_ASSERT_EQUAL_UINT32(1u - over, parts.out.events.n);
    }
}
