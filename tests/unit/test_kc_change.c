/* kc_change.c: what each change asks of the store, in which order, and what follows from its answer. Restarts:
 * test_change.c. Kills and real files: test_files.c. */
#include "kc_change.h"

#include <string.h>

#include "given_parts.h"
#include "given_tables.h"
#include "unity.h"

#define RETRIES 2u
#define RETRY_US 3000000u

/* Images that are stored, by their CRC. */
typedef enum { NONE, IN_FORCE, PREV, PROPOSED, STAGED, STAGED_KIN, IMAGES } image_t;

static uint32_t s_crc[IMAGES];
static kc_change_t s_change;
static kc_review_t s_review;
static kc_journal_store_t s_journal;
static kc_journal_images_t s_images;
static kc_cmd_log_t s_log;
static kc_tbl_scratch_t s_scratch;
static kc_change_parts_t s_parts;
static uint8_t s_staged[KC_IMAGE_MAX];
static const kc_cmd_t s_cmd = {.source = KC_SRC_GROUND, .seq = 5, .opcode = KC_CMD_REJECT};

static kc_active_t *active(void) { return &parts.tables.active; }

static void given_staged(uint16_t kind, const void *table)
{
    kc_staging_t *s = &parts.tables.staging;
    *s = (kc_staging_t){.state = KC_STAGE_VALID, .kind = kind, .image = s_staged};
    s->n = s->total = given_image(kind, table, s_staged);
    s_crc[kind == KC_TBL_KIN ? STAGED_KIN : STAGED] = kc_tbl_image_crc(s_staged, s->n);
}

static void given_staged_kin(void)
{
    kc_kin_t kin = s_review.kin;
    kin.session = 9u;
    given_staged(KC_TBL_KIN, &kin);
}

/* A correction in force, one before it, one that waits, and a CONFIG that is staged. */
void setUp(void)
{
    static uint8_t image[KC_IMAGE_MAX];
    kc_config_t config;
    kc_kin_t kin;
    given_parts();
    parts.tables.scratch = &s_scratch;
    active()->config.store_retries = RETRIES;
    active()->config.store_retry_us = RETRY_US;
    given_kin(&active()->kin_prev);
    active()->kin_prev.session = 1u;
    active()->kin.session = 2u;
    s_crc[PREV] = kc_tbl_image_crc(image, given_image(KC_TBL_KIN, &active()->kin_prev, image));
    s_crc[IN_FORCE] = kc_tbl_image_crc(image, given_image(KC_TBL_KIN, &active()->kin, image));
    active()->kin_prev_crc = s_crc[PREV];
    active()->crc[KC_TBL_KIN] = s_crc[IN_FORCE];
    given_kin(&kin);
    kin.value[24] = 0.1;
    kin.arm_crc = PARTS_CRC + KC_TBL_ARM;
    kin.terms_crc = PARTS_CRC + KC_TBL_TERMS;
    kin.prev_crc = s_crc[IN_FORCE];
    memset(&s_review, 0, sizeof s_review);
    s_crc[PROPOSED] = s_review.crc = kc_review_encode(&s_review, &kin, KC_VERDICT_POOR);
    config = active()->config;
    config.n_poses = 9u;
    given_staged(KC_TBL_CONFIG, &config);
    memset(&s_journal, 0, sizeof s_journal);
    memset(&s_images, 0x5a, sizeof s_images);
    memset(&s_log, 0, sizeof s_log);
    memset(&s_change, 0, sizeof s_change);
    s_parts = (kc_change_parts_t){&parts.view,
                                  &parts.tables,
                                  &s_review,
                                  &s_journal,
                                  &s_images,
                                  &s_log,
                                  {.state = KC_ST_STORE,
                                   .boot_count = 1u,
                                   .kin_crc = s_crc[IN_FORCE],
                                   .prev_crc = s_crc[PREV],
                                   .proposal_crc = s_crc[PROPOSED],
                                   .proposal_verdict = KC_VERDICT_POOR}};
}

static void run(void)
{
    memset(&parts.out, 0, sizeof parts.out);
    kc_change_run(&s_change, &s_parts, &parts.out);
}

static void asked(kc_change_kind_t kind, bool safe, bool by_command)
{
    parts.place.state = safe ? KC_ST_SAFE : KC_ST_IDLE;
    kc_change_begin(&s_change, kind, &parts.view, by_command ? &s_cmd : NULL);
    run();
}

static kc_outcome_id_t answered(kc_status_t status, uint16_t kind)
{
    static kc_in_t in;
    in.has_store_result = 1u;
    in.store_status = (int32_t)status;
    in.store_kind = kind;
    memset(&parts.out, 0, sizeof parts.out);
    return kc_change_stored(&s_change, &s_parts, &in, &parts.out).id;
}

static kc_outcome_id_t stored(void) { return answered(KC_OK, 0u); }

/* All tries of the store fail; the outcome of the last one. */
static kc_outcome_id_t refused(void)
{
    kc_outcome_id_t oc = KC_OC_STAY;
    for (uint32_t i = 0u; i <= RETRIES; i++) {
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, oc);
        parts.clock.now_us += i > 0u ? RETRY_US : 0u;
        run();
        oc = answered(KC_ERR_NUM, KC_STORE_PREV);
    }
    return oc;
}

static const kc_event_t *event(kc_event_id_t id)
{
    int at = event_at(&parts.out.events, (uint16_t)id);
    return at >= 0 ? &parts.out.events.e[at] : NULL;
}

static void expect_one(kc_event_id_t id, int32_t index, double got, double want)
{
    const kc_event_t *e = event(id);
    TEST_ASSERT_NOT_NULL(e);
    TEST_ASSERT_EQUAL_INT32(index, e->index);
    TEST_ASSERT_EQUAL_DOUBLE(got, e->got);
    TEST_ASSERT_EQUAL_DOUBLE(want, e->want);
}

/* Whether its command is answered, and so (OK: accepted). */
static void expect_answer(bool is_answered, kc_status_t status, kc_event_id_t why)
{
    TEST_ASSERT_EQUAL_UINT32(is_answered, parts.out.n_ack);
    if (!is_answered) { return; }
    const kc_ack_t want = {s_cmd.source, s_cmd.seq, s_cmd.opcode, (int32_t)status, (int32_t)why};
    TEST_ASSERT_EQUAL_MEMORY(&want, parts.out.ack, sizeof want);
}

static void expect_in_force(image_t kin, image_t prev, image_t proposed)
{
    TEST_ASSERT_EQUAL_HEX32(s_crc[kin], active()->crc[KC_TBL_KIN]);
    TEST_ASSERT_EQUAL_HEX32(s_crc[prev], active()->kin_prev_crc);
    TEST_ASSERT_EQUAL_HEX32(s_crc[proposed], s_review.crc);
}

/* ---- the changes ---- */

/* Requests in order, kind and image, the record among them; the correction in force, the one before and the one that
 * waits, as the record names them and as they are then; the outcome when it is made and when it is refused, in IDLE and
 * in SAFE. */
static const struct {
    kc_change_kind_t kind;
    struct {
        uint16_t kind;
        image_t image;
    } asked[5];
    image_t names[3];
    kc_outcome_id_t made[2], refused[2];
} s_cases[] = {
    {KC_CHANGE_PROPOSE,
     {{KC_STORE_PROPOSAL, PROPOSED}, {KC_STORE_JOURNAL, NONE}},
     {IN_FORCE, PREV, PROPOSED},
     {KC_OC_REVIEW, KC_OC_REVIEW},
     {KC_OC_REVIEW, KC_OC_REVIEW}},
    {KC_CHANGE_APPROVE,
     {{KC_TBL_KIN, IN_FORCE},
      {KC_STORE_PREV, PREV},
      {KC_STORE_PREV, IN_FORCE},
      {KC_TBL_KIN, PROPOSED},
      {KC_STORE_JOURNAL, NONE}},
     {PROPOSED, IN_FORCE, NONE},
     {KC_OC_DONE, KC_OC_DONE},
     {KC_OC_REVIEW, KC_OC_REVIEW}},
    {KC_CHANGE_REJECT,
     {{KC_STORE_JOURNAL, NONE}},
     {IN_FORCE, PREV, NONE},
     {KC_OC_DONE, KC_OC_DONE},
     {KC_OC_REVIEW, KC_OC_REVIEW}},
    {KC_CHANGE_ROLLBACK,
     {{KC_TBL_KIN, IN_FORCE}, {KC_STORE_PREV, PREV}, {KC_TBL_KIN, PREV}, {KC_STORE_JOURNAL, NONE}},
     {PREV, NONE, PROPOSED},
     {KC_OC_DONE, KC_OC_DONE},
     {KC_OC_DONE, KC_OC_SAFE}},
    {KC_CHANGE_TABLE, /* behind the counter of its command */
     {{KC_STORE_JOURNAL, NONE}, {KC_TBL_CONFIG, STAGED}},
     {IN_FORCE, PREV, PROPOSED},
     {KC_OC_DONE, KC_OC_SAFE},
     {KC_OC_DONE, KC_OC_SAFE}},
};
#define CASES (sizeof s_cases / sizeof s_cases[0])

static void expect_record(const kc_store_t *s, const image_t names[3], kc_state_t state)
{
    static kc_journal_store_t back;
    memset(&back, 0, sizeof back);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_journal_load(&back, s->data, s->n));
    TEST_ASSERT_EQUAL_UINT32(state, back.found.state);
    TEST_ASSERT_EQUAL_HEX32(s_crc[names[0]], back.found.kin_crc);
    TEST_ASSERT_EQUAL_HEX32(s_crc[names[1]], back.found.prev_crc);
    TEST_ASSERT_EQUAL_HEX32(s_crc[names[2]], back.found.proposal_crc);
    TEST_ASSERT_EQUAL_UINT32(names[2] != NONE ? KC_VERDICT_POOR : KC_VERDICT_NO_CHANGE,
                             back.found.proposal_verdict);
}

static void expect_asked(uint32_t c, bool safe)
{
    uint32_t n = 0u;
    kc_state_t state = s_cases[c].kind == KC_CHANGE_PROPOSE         ? KC_ST_REVIEW
                       : safe && s_cases[c].kind == KC_CHANGE_TABLE ? KC_ST_SAFE
                                                                    : KC_ST_IDLE;
    for (; n < 5u && s_cases[c].asked[n].kind != 0u; n++) {
        const kc_store_t *s = &parts.out.store[n];
        TEST_ASSERT_EQUAL_UINT16(s_cases[c].asked[n].kind, s->kind);
        if (s->kind == KC_STORE_JOURNAL) {
            expect_record(s, s_cases[c].names, state);
        } else {
            TEST_ASSERT_EQUAL_HEX32(s_crc[s_cases[c].asked[n].image], kc_tbl_image_crc(s->data, s->n));
        }
    }
    TEST_ASSERT_EQUAL_UINT32(n, parts.out.n_store);
}

/* What is in force is copied first, so that no write hits its last copy. */
void test_what_is_asked_for_in_which_order_and_what_is_in_force_when_it_is_stored(void)
{
    for (uint32_t i = 0u; i < 2u * CASES; i++) {
        const uint32_t c = i / 2u;
        const bool safe = i % 2u != 0u;
        setUp();
        asked(s_cases[c].kind, safe, true);
        expect_asked(c, safe);
        expect_in_force(IN_FORCE, PREV, PROPOSED);
        TEST_ASSERT_EQUAL_INT(s_cases[c].made[safe], stored());
        expect_answer(true, KC_OK, KC_EVT_NONE);
        expect_in_force(s_cases[c].names[0], s_cases[c].names[1], s_cases[c].names[2]);
        TEST_ASSERT_EQUAL_UINT32(s_cases[c].kind == KC_CHANGE_TABLE ? 9u : 6u, active()->config.n_poses);
        TEST_ASSERT_TRUE(s_journal.again && s_journal.due_us == 0u); /* a second copy of the record */
        TEST_ASSERT_EQUAL_INT(KC_CHANGE_NONE, s_change.kind);
    }
}

void test_what_the_store_refuses_stays_as_it_was_whatever_the_change(void)
{
    for (uint32_t i = 0u; i < 2u * CASES; i++) {
        const uint32_t c = i / 2u;
        const bool safe = i % 2u != 0u;
        setUp();
        asked(s_cases[c].kind, safe, true);
        TEST_ASSERT_EQUAL_INT(s_cases[c].refused[safe], refused());
        expect_answer(true, KC_ERR_NUM, KC_EVT_STORE_REFUSED);
        expect_one(KC_EVT_STORE_REFUSED, KC_STORE_PREV, KC_ERR_NUM, RETRIES + 1.0);
        expect_in_force(IN_FORCE, PREV, PROPOSED);
        TEST_ASSERT_EQUAL_UINT32(6u, active()->config.n_poses);
        TEST_ASSERT_EQUAL_INT(KC_STAGE_VALID, parts.tables.staging.state);
        TEST_ASSERT_TRUE(s_cases[c].kind != KC_CHANGE_PROPOSE || event(KC_EVT_COR_PROPOSED) != NULL);
    }
}

void test_a_correction_from_the_ground_replaces_the_one_in_force(void)
{
    for (uint32_t safe = 0u; safe < 2u; safe++) {
        setUp();
        given_staged_kin();
        asked(KC_CHANGE_TABLE, safe != 0u, true);
        TEST_ASSERT_EQUAL_UINT32(5u, parts.out.n_store);
        expect_record(&parts.out.store[4], (const image_t[]){STAGED_KIN, IN_FORCE, PROPOSED},
                      safe ? KC_ST_SAFE : KC_ST_IDLE);
        TEST_ASSERT_EQUAL_INT(safe ? KC_OC_SAFE : KC_OC_DONE, stored());
        expect_in_force(STAGED_KIN, IN_FORCE, PROPOSED);
    }
}

void test_where_there_is_no_correction_before_none_is_stored(void)
{
    active()->kin_prev_crc = s_parts.now.prev_crc = 0u;
    asked(KC_CHANGE_APPROVE, false, true);
    TEST_ASSERT_EQUAL_UINT32(4u, parts.out.n_store);
    TEST_ASSERT_EQUAL_UINT16(KC_STORE_PREV, parts.out.store[1].kind);
    TEST_ASSERT_EQUAL_HEX32(s_crc[IN_FORCE], kc_tbl_image_crc(parts.out.store[1].data, parts.out.store[1].n));
    active()->crc[KC_TBL_KIN] = 0u; /* nor one in force */
    run();
    TEST_ASSERT_EQUAL_UINT32(2u, parts.out.n_store);
}

void test_tables_and_copies_that_are_not_needed_any_more_are_deleted(void)
{
    kc_arm_t arm = active()->arm;
    arm.tool_xyz_m[2] += 0.01;
    given_staged(KC_TBL_ARM, &arm);
    asked(KC_CHANGE_TABLE, false, true);
    (void)stored();
    TEST_ASSERT_EQUAL_HEX32(0u, active()->crc[KC_TBL_SPACE]); /* it was for the arm before */
    TEST_ASSERT_EQUAL_UINT32(1u, parts.out.n_store);
    TEST_ASSERT_EQUAL_UINT16(KC_TBL_SPACE, parts.out.store[0].kind);
    TEST_ASSERT_EQUAL_UINT32(0u, parts.out.store[0].n);
    setUp();
    asked(KC_CHANGE_ROLLBACK, false, true);
    (void)stored();
    TEST_ASSERT_EQUAL_UINT32(1u, parts.out.n_store);
    TEST_ASSERT_EQUAL_UINT16(KC_STORE_PREV, parts.out.store[0].kind);
    TEST_ASSERT_EQUAL_UINT32(0u, parts.out.store[0].n);
}

void test_what_is_accepted_on_board_is_said_and_waits_for_the_ground_if_it_cannot_be_stored(void)
{
    asked(KC_CHANGE_ACCEPT, false, false);
    expect_asked(1u, false); /* as an approval */
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, stored());
    expect_one(KC_EVT_COR_ON_BOARD, -1, (double)s_crc[PROPOSED], 0.0);
    expect_answer(false, KC_OK, KC_EVT_NONE);
    for (uint32_t made = 0u; made < 2u; made++) { /* nor if it cannot be made */
        setUp();
        asked(KC_CHANGE_ACCEPT, false, false);
        if (made) {
            s_review.kin.terms_crc ^= 1u;
            TEST_ASSERT_EQUAL_INT(KC_OC_STAY, stored());
        } else {
            TEST_ASSERT_EQUAL_INT(KC_OC_STAY, refused());
        }
        TEST_ASSERT_NULL(event(KC_EVT_COR_ON_BOARD));
        run();
        expect_asked(0u, false);
        TEST_ASSERT_EQUAL_INT(KC_OC_REVIEW, stored());
        expect_in_force(IN_FORCE, PREV, PROPOSED);
    }
}

void test_an_approval_is_not_said_to_be_one_on_board(void)
{
    asked(KC_CHANGE_APPROVE, false, true);
    (void)stored();
    TEST_ASSERT_NULL(event(KC_EVT_COR_ON_BOARD));
}

/* ---- tries ---- */

void test_it_is_tried_again_after_the_time_of_config_and_a_failure_is_said_once(void)
{
    asked(KC_CHANGE_REJECT, false, true);
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, answered(KC_ERR_NUM, KC_STORE_JOURNAL));
    expect_event(KC_EVT_STORE_FAIL, (int32_t)KC_STORE_JOURNAL, KC_ERR_NUM, 0.0);
    TEST_ASSERT_TRUE(s_journal.again);
    TEST_ASSERT_EQUAL_UINT64(PARTS_NOW_US, s_journal.due_us);
    for (uint32_t late = 0u; late < 2u; late++) {
        parts.clock.now_us = PARTS_NOW_US + RETRY_US - 1u + late;
        run();
        TEST_ASSERT_EQUAL_UINT32(late, parts.out.n_store);
    }
    (void)answered(KC_ERR_NUM, KC_STORE_JOURNAL);
    TEST_ASSERT_EQUAL_UINT32(0u, parts.out.events.n);
    parts.clock.now_us += RETRY_US;
    run();
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, stored());
    asked(KC_CHANGE_REJECT, false, true);
    (void)answered(KC_ERR_NUM, KC_STORE_JOURNAL); /* after a success it is said again */
    TEST_ASSERT_NOT_NULL(event(KC_EVT_STORE_FAIL));
    asked(KC_CHANGE_REJECT, false, true); /* and not by another change */
    (void)answered(KC_ERR_NUM, KC_STORE_JOURNAL);
    TEST_ASSERT_NULL(event(KC_EVT_STORE_FAIL));
}

/* The journal is stored between changes too. */
void test_an_answer_that_no_change_waits_for_has_the_record_stored_again_later(void)
{
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, stored());
    TEST_ASSERT_FALSE(s_journal.again);
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, answered(KC_ERR_NUM, KC_STORE_JOURNAL));
    TEST_ASSERT_NOT_NULL(event(KC_EVT_STORE_FAIL));
    TEST_ASSERT_TRUE(s_journal.again);
    TEST_ASSERT_EQUAL_UINT64(PARTS_NOW_US + RETRY_US, s_journal.due_us);
}

void test_without_an_answer_of_the_edge_nothing_is_taken_for_stored(void)
{
    static const kc_in_t nothing;
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, kc_change_stored(&s_change, &s_parts, &nothing, &parts.out).id);
    TEST_ASSERT_EQUAL_UINT32(0u, parts.out.events.n);
    asked(KC_CHANGE_APPROVE, false, true);
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, kc_change_stored(&s_change, &s_parts, &nothing, &parts.out).id);
    expect_in_force(IN_FORCE, PREV, PROPOSED);
    expect_one(KC_EVT_STORE_FAIL, 0, KC_ERR_STATE, 0.0);
    TEST_ASSERT_EQUAL_UINT32(1u, s_change.tries);
}

/* ---- stored, and then it cannot be put in force: its copy in memory has changed meanwhile ---- */

void test_a_correction_that_cannot_be_made_is_refused_and_nothing_changes(void)
{
    static const kc_change_kind_t kinds[] = {KC_CHANGE_APPROVE, KC_CHANGE_ROLLBACK, KC_CHANGE_TABLE};
    for (uint32_t i = 0u; i < 3u; i++) {
        setUp();
        given_staged_kin();
        asked(kinds[i], false, true);
        s_review.kin.terms_crc ^= 1u;
        s_staged[40] ^= 1u;
        if (i == 1u) { active()->kin_prev_crc = 0u; }
        const kc_status_t st = i < 2u ? KC_ERR_STATE : KC_ERR_CRC;
        TEST_ASSERT_EQUAL_INT(i == 0u ? KC_OC_REVIEW : KC_OC_DONE, stored());
        expect_answer(true, st, KC_EVT_CHANGE_FAILED);
        expect_one(KC_EVT_CHANGE_FAILED, KC_TBL_KIN, (double)st, 0.0);
        expect_in_force(IN_FORCE, i == 1u ? NONE : PREV, PROPOSED);
        TEST_ASSERT_EQUAL_UINT32(0u, parts.out.n_store); /* no copy is deleted */
    }
}

/* A CONFIG is stored, and cannot be made. */
static void given_put_back(bool safe)
{
    asked(KC_CHANGE_TABLE, safe, true);
    s_staged[40] ^= 1u;
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, stored());
    expect_answer(false, KC_OK, KC_EVT_NONE);
    expect_one(KC_EVT_CHANGE_FAILED, KC_TBL_CONFIG, KC_ERR_CRC, 0.0);
    run();
    TEST_ASSERT_EQUAL_UINT32(0u, parts.out.n_store); /* that step has computed enough */
    parts.clock.now_us++;
}

static void expect_put_back(void)
{
    static uint8_t image[KC_IMAGE_MAX];
    const uint32_t n = given_image(KC_TBL_CONFIG, &active()->config, image);
    TEST_ASSERT_EQUAL_UINT32(1u, parts.out.n_store);
    TEST_ASSERT_EQUAL_UINT16(KC_TBL_CONFIG, parts.out.store[0].kind);
    TEST_ASSERT_EQUAL_UINT32(n, parts.out.store[0].n);
    TEST_ASSERT_EQUAL_MEMORY(image, parts.out.store[0].data, n);
}

/* The journal does not name it: the active one is stored over it before it is answered. */
void test_a_table_that_cannot_be_made_is_taken_out_of_the_store_before_it_is_answered(void)
{
    for (uint32_t safe = 0u; safe < 2u; safe++) {
        setUp();
        given_put_back(safe != 0u);
        run();
        expect_put_back();
        TEST_ASSERT_EQUAL_INT(safe ? KC_OC_SAFE : KC_OC_DONE, stored());
        expect_answer(true, KC_ERR_CRC, KC_EVT_CHANGE_FAILED);
        TEST_ASSERT_EQUAL_INT(KC_STAGE_NONE, parts.tables.staging.state);
        TEST_ASSERT_EQUAL_UINT32(6u, active()->config.n_poses);
    }
}

/* The answer stays that of the failure, and the store's is an event. */
void test_a_table_that_cannot_be_put_back_either_is_tried_as_often_as_any_change(void)
{
    given_put_back(false);
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, refused());
    expect_answer(true, KC_ERR_CRC, KC_EVT_CHANGE_FAILED);
    expect_one(KC_EVT_STORE_REFUSED, KC_STORE_PREV, KC_ERR_NUM, RETRIES + 1.0);
    TEST_ASSERT_EQUAL_INT(KC_STAGE_NONE, parts.tables.staging.state);
}

void test_a_table_that_replaces_none_is_deleted_and_one_that_is_damaged_itself_left_alone(void)
{
    given_put_back(false);
    active()->crc[KC_TBL_CONFIG] = 0u;
    run();
    TEST_ASSERT_EQUAL_UINT32(1u, parts.out.n_store);
    TEST_ASSERT_EQUAL_UINT32(0u, parts.out.store[0].n);
    setUp();
    given_staged(KC_TBL_KERNEL, &active()->kernel);
    asked(KC_CHANGE_TABLE, false, true);
    s_staged[40] ^= 1u;
    (void)stored();
    parts.clock.now_us++;
    active()->kernel.n_hyper = 10000u;
    run();
    TEST_ASSERT_EQUAL_UINT32(0u, parts.out.n_store);
}

/* ---- ABORT ---- */

static void cancelled(void) { kc_change_cancel(&s_change, &s_parts, &parts.out); }

void test_an_abort_refuses_the_command_and_withdraws_the_table_that_is_asked_for(void)
{
    asked(KC_CHANGE_TABLE, false, true);
    cancelled();
    expect_answer(true, KC_ERR_STATE, KC_EVT_CAL_ABORTED);
    TEST_ASSERT_EQUAL_UINT32(1u, parts.out.n_store);
    TEST_ASSERT_EQUAL_UINT16(KC_STORE_JOURNAL, parts.out.store[0].kind);
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, stored());
    TEST_ASSERT_EQUAL_UINT32(6u, active()->config.n_poses);
    TEST_ASSERT_EQUAL_UINT32(0u, parts.out.n_ack);
}

void test_between_two_tries_an_abort_withdraws_nothing_of_others(void)
{
    asked(KC_CHANGE_TABLE, false, true);
    (void)answered(KC_ERR_NUM, KC_TBL_CONFIG);
    kc_journal_store(&parts.out, KC_TBL_CONFIG, s_staged, 20u);
    cancelled();
    TEST_ASSERT_EQUAL_UINT32(1u, parts.out.n_store);
    TEST_ASSERT_EQUAL_INT(KC_CHANGE_NONE, s_change.kind);
}

void test_a_command_that_was_answered_is_not_answered_again_by_an_abort(void)
{
    asked(KC_CHANGE_REJECT, false, true);
    (void)stored();
    parts.out.n_ack = 0u;
    cancelled();
    expect_answer(false, KC_OK, KC_EVT_NONE);
}

/* In SAFE nothing waits: one try, and an event if it fails. */
void test_an_abort_puts_a_table_back_at_once_in_one_try(void)
{
    for (uint32_t i = 0u; i < 4u; i++) {
        const bool was_asked = i % 2u != 0u, fails = i >= 2u;
        setUp();
        given_put_back(false);
        if (was_asked) {
            run();
        } else {
            memset(&parts.out, 0, sizeof parts.out);
        }
        cancelled();
        expect_put_back();
        expect_answer(true, KC_ERR_STATE, KC_EVT_CAL_ABORTED);
        TEST_ASSERT_EQUAL_INT(KC_OC_SAFE, answered(fails ? KC_ERR_NUM : KC_OK, KC_TBL_CONFIG));
        TEST_ASSERT_EQUAL_INT(fails, event(KC_EVT_STORE_REFUSED) != NULL);
        TEST_ASSERT_EQUAL_INT(KC_STAGE_NONE, parts.tables.staging.state);
        expect_answer(false, KC_OK, KC_EVT_NONE);
    }
}
