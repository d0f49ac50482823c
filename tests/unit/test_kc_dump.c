/* kc_dump.c: what may be dumped, and the image that its chunks make. */
#include "kc_dump.h"

#include <string.h>

#include "given_parts.h"
#include "given_tables.h"
#include "unity.h"

static kc_dump_t s_dump;
static kc_review_t s_review;
static uint8_t s_image[KC_IMAGE_MAX];

void setUp(void)
{
    given_parts();
    memset(&s_dump, 0, sizeof s_dump);
    memset(&s_review, 0, sizeof s_review);
}

static kc_answer_t begin(uint32_t kind)
{
    const kc_cmd_t cmd = {.arg_i = {(int32_t)kind}};
    return kc_dump_begin(&s_dump, &s_review, &parts.view, &cmd, &parts.out);
}

static bool run(kc_work_t work)
{
    parts.out.has_table_down = 0u;
    memset(&parts.out.table_down, 0, sizeof parts.out.table_down);
    kc_dump_run(&s_dump, &s_review, &parts.view, &work, &parts.out);
    return parts.out.has_table_down != 0u;
}

/* All chunks of a kind in order, full but for the last, make this image. */
static void dumped(uint32_t kind, const uint8_t *image, uint32_t n)
{
    const kc_table_chunk_t *c = &parts.out.table_down;
    expect_taken(begin(kind), KC_OC_STAY);
    for (uint32_t at = 0u; at < n; at += KC_CHUNK_BYTES) {
        TEST_ASSERT_TRUE(run(kc_work_of_step()));
        TEST_ASSERT_EQUAL_UINT32(kind, c->kind);
        TEST_ASSERT_EQUAL_UINT32(n, c->total);
        TEST_ASSERT_EQUAL_UINT32(at, c->offset);
        TEST_ASSERT_EQUAL_UINT32(n - at < KC_CHUNK_BYTES ? n - at : KC_CHUNK_BYTES, c->n);
        TEST_ASSERT_EQUAL_MEMORY(&image[at], c->data, c->n);
        TEST_ASSERT_TRUE(c->n == KC_CHUNK_BYTES || c->data[c->n] == 0u); /* nothing from behind the image */
    }
    TEST_ASSERT_FALSE(run(kc_work_of_step()));
}

void test_every_table_comes_down_as_its_image(void)
{
    for (uint16_t kind = 1u; kind < KC_TBL_COUNT; kind++) {
        uint32_t n = given_image(kind, kc_tbl_active_ptr(&parts.tables.active, kind), s_image);
        dumped(kind, s_image, n);
    }
}

void test_a_proposal_comes_down_in_chunks_too(void)
{
    s_review.crc = 77u;
    for (uint32_t i = 0u; i < KC_KIN_IMAGE_MAX; i++) { s_review.image[i] = (uint8_t)(i * 7u); }
    for (s_review.n = KC_CHUNK_BYTES - 1u; s_review.n < KC_CHUNK_BYTES + 2u; s_review.n++) {
        dumped(KC_STORE_PROPOSAL, s_review.image, s_review.n);
    }
}

void test_what_there_is_not_is_refused(void)
{
    static const int32_t wrong[] = {-1, 0, KC_TBL_COUNT, KC_STORE_PREV, KC_STORE_JOURNAL, (1 << 16) + 1};
    for (uint32_t i = 0u; i < sizeof wrong / sizeof wrong[0]; i++) {
        expect_refused(begin((uint32_t)wrong[i]), KC_ERR_ARG, KC_EVT_CMD_ARG, 0, (double)wrong[i], 7.0);
    }
    expect_refused(begin(KC_STORE_PROPOSAL), KC_ERR_STATE, KC_EVT_TBL_MISSING, KC_STORE_PROPOSAL, 0.0, 0.0);
    parts.tables.active.crc[KC_TBL_ARM] = 0u;
    expect_refused(begin(KC_TBL_ARM), KC_ERR_STATE, KC_EVT_TBL_MISSING, KC_TBL_ARM, 0.0, 0.0);
    TEST_ASSERT_FALSE(run(kc_work_of_step()));
}

void test_a_dump_ends_when_its_table_is_another_one_or_gone(void)
{
    uint32_t *crc = &parts.tables.active.crc[KC_TBL_SPACE];
    for (uint32_t now = 0u; now < 2u; now++) {
        *crc = 5u;
        expect_taken(begin(KC_TBL_SPACE), KC_OC_STAY);
        TEST_ASSERT_TRUE(run(kc_work_of_step()));
        *crc = now;
        TEST_ASSERT_FALSE(run(kc_work_of_step()));
        expect_event(KC_EVT_TBL_MISSING, KC_TBL_SPACE, 0.0, 0.0);
        *crc = 5u;
        TEST_ASSERT_FALSE(run(kc_work_of_step()));
    }
}

void test_a_table_that_went_before_its_first_chunk_is_not_dumped(void)
{
    expect_taken(begin(KC_TBL_ARM), KC_OC_STAY);
    parts.tables.active.crc[KC_TBL_ARM] = 0u;
    TEST_ASSERT_FALSE(run(kc_work_of_step()));
    expect_event(KC_EVT_TBL_MISSING, KC_TBL_ARM, 0.0, 0.0);
}

void test_a_new_dump_replaces_the_one_under_way(void)
{
    uint32_t n = given_image(KC_TBL_ARM, &parts.tables.active.arm, s_image);
    expect_taken(begin(KC_TBL_SPACE), KC_OC_STAY);
    TEST_ASSERT_TRUE(run(kc_work_of_step()));
    dumped(KC_TBL_ARM, s_image, n);
}

void test_a_dump_waits_while_a_step_has_no_time_for_it(void)
{
    uint32_t n = given_image(KC_TBL_ARM, &parts.tables.active.arm, s_image);
    expect_taken(begin(KC_TBL_ARM), KC_OC_STAY);
    TEST_ASSERT_FALSE(run((kc_work_t){KC_STEP_WORK, KC_STEP_WORK - 1u}));
    TEST_ASSERT_EQUAL_UINT32(0u, s_dump.at);
    dumped(KC_TBL_ARM, s_image, n);
}
