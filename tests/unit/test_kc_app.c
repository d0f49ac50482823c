/* kc_app.c: what is taken of what the store holds, the state to begin in, and what one step does with clock and
 * telemetry. Whole calibrations: test_app.c. */
#include "kc_app.h"

#include <string.h>

#include "given_parts.h"
#include "given_tables.h"
#include "kc_signed.h"
#include "unity.h"

#define APP (&kc_app_instance)
#define TICK_US 100000u

static uint8_t s_image[KC_IMAGE_MAX];
static kc_out_t s_out;
static kc_in_t s_in;

/* Corrections that differ, and what the journal names. */
enum { NONE, RIGHT, OTHER, OLDEST, KINS };
static uint32_t s_crc[KINS];
static kc_journal_t s_named;

void setUp(void)
{
    kc_app_init(APP);
    memset(&s_in, 0, sizeof s_in);
    s_named = (kc_journal_t){.boot_count = 4u, .candidate = -1, .session = 3u};
}

static uint32_t kin_image(uint32_t which)
{
    kc_kin_t kin;
    given_kin(&kin);
    kin.session = which;
    return given_image(KC_TBL_KIN, &kin, s_image);
}

static kc_status_t load_kin(uint16_t kind, uint32_t which)
{
    uint32_t n = kin_image(which);
    return kc_app_load(APP, kind, s_image, n);
}

static kc_status_t load_table(uint16_t kind, const void *table)
{
    uint32_t n = given_image(kind, table, s_image);
    return kc_app_load(APP, kind, s_image, n);
}

static void load_journal(void)
{
    static kc_journal_store_t j;
    kc_journal_write(&j, &s_named, &s_out);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_app_load(APP, KC_STORE_JOURNAL, j.bytes, KC_JOURNAL_BYTES));
}

/* The first tables, to which corrections belong. */
static void load_arm_and_terms(void)
{
    kc_arm_t arm;
    kc_terms_t terms;
    given_arm(&arm);
    given_terms(&terms);
    TEST_ASSERT_EQUAL_INT(KC_OK, load_table(KC_TBL_ARM, &arm));
    TEST_ASSERT_EQUAL_INT(KC_OK, load_table(KC_TBL_TERMS, &terms));
    for (uint32_t which = RIGHT; which < KINS; which++) {
        uint32_t n = kin_image(which);
        s_crc[which] = kc_tbl_image_crc(s_image, n);
    }
}

static const kc_active_t *active(void) { return kc_app_active(APP); }

static uint32_t in_force(void) { return active()->crc[KC_TBL_KIN]; }

static void step(uint64_t now_us)
{
    kc_app_step(APP, now_us, &s_in, &s_out);
    memset(&s_in, 0, sizeof s_in);
}

/* How often an event came out of the last step; the last one is in s_last. */
static kc_event_t s_last;
static uint32_t events(kc_event_id_t id)
{
    uint32_t n = 0u;
    for (uint32_t i = 0u; i < s_out.events.n; i++) {
        if (s_out.events.e[i].id != (uint16_t)id) { continue; }
        s_last = s_out.events.e[i];
        n++;
    }
    return n;
}

static void expect_came(kc_event_id_t id, int32_t index, double got, double want)
{
    TEST_ASSERT_EQUAL_UINT32(1u, events(id));
    TEST_ASSERT_EQUAL_INT32(index, s_last.index);
    TEST_ASSERT_EQUAL_DOUBLE(got, s_last.got);
    TEST_ASSERT_EQUAL_DOUBLE(want, s_last.want);
}

static void expect_none(kc_event_id_t id) { TEST_ASSERT_EQUAL_UINT32(0u, events(id)); }

static void booted(void)
{
    kc_app_boot(APP);
    step(1000000u);
}

/* ---- tables ---- */

void test_without_tables_it_boots_idle_and_names_what_is_missing(void)
{
    booted();
    TEST_ASSERT_EQUAL_INT(KC_ST_IDLE, kc_app_state(APP));
    TEST_ASSERT_EQUAL_UINT32(7u, events(KC_EVT_TBL_MISSING));
    TEST_ASSERT_EQUAL_INT32(KC_TBL_CONFIG, s_last.index);
    expect_came(KC_EVT_BOOT, 1, 0.0, 0.0);
    expect_came(KC_EVT_BOOT_NO_KEYS, -1, 0.0, 0.0);
    expect_none(KC_EVT_BOOT_NO_JOURNAL);
    TEST_ASSERT_FALSE(s_out.has_arm_cmd);
}

void test_the_first_good_image_of_a_kind_wins_and_bad_ones_are_reported(void)
{
    kc_arm_t arm;
    given_arm(&arm);
    uint32_t n = given_image(KC_TBL_ARM, &arm, s_image);
    s_image[40] ^= 1u;
    TEST_ASSERT_EQUAL_INT(KC_ERR_CRC, kc_app_load(APP, KC_TBL_ARM, s_image, n));
    s_image[40] ^= 1u;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_app_load(APP, KC_TBL_ARM, s_image, n));
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, kc_app_load(APP, KC_TBL_ARM, s_image, n));
    TEST_ASSERT_EQUAL_INT(KC_ERR_ARG, kc_app_load(APP, KC_TBL_COUNT, s_image, n));
    TEST_ASSERT_EQUAL_INT(KC_ERR_FORMAT, kc_app_load(APP, KC_TBL_CAMERA, s_image, 0u));
    booted();
    TEST_ASSERT_EQUAL_UINT32(3u, events(KC_EVT_BOOT_SLOT_BAD));
    TEST_ASSERT_EQUAL_INT32(KC_TBL_CAMERA, s_last.index);
    TEST_ASSERT_EQUAL_DOUBLE(KC_ERR_FORMAT, s_last.got);
    TEST_ASSERT_EQUAL_HEX32(kc_tbl_image_crc(s_image, n), active()->crc[KC_TBL_ARM]);
}

/* ---- corrections ---- */

/* Offered in this order, with a journal that names one of them, none, or no journal at all. */
void test_of_corrections_the_one_that_the_journal_names_is_taken_or_else_the_newest(void)
{
    static const struct {
        bool journal;
        uint32_t named, offered[3], taken, lost;
    } cases[] = {
        {true, RIGHT, {RIGHT, OTHER, NONE}, RIGHT, 0u},  {true, RIGHT, {OTHER, RIGHT, NONE}, RIGHT, 0u},
        {true, RIGHT, {OTHER, OLDEST, NONE}, OTHER, 1u}, {true, RIGHT, {OTHER, OLDEST, RIGHT}, RIGHT, 0u},
        {true, RIGHT, {NONE, NONE, NONE}, NONE, 1u},     {true, NONE, {OTHER, RIGHT, NONE}, OTHER, 0u},
        {false, NONE, {OTHER, RIGHT, NONE}, OTHER, 0u},
    };
    for (uint32_t i = 0u; i < 2u * sizeof cases / sizeof cases[0]; i++) {
        const uint32_t c = i / 2u;
        setUp();
        load_arm_and_terms();
        s_named.kin_crc = s_crc[cases[c].named];
        setUp(); /* the journal comes first */
        s_named.kin_crc = s_crc[cases[c].named];
        if (cases[c].journal) { load_journal(); }
        load_arm_and_terms();
        for (uint32_t k = 0u; k < 3u && cases[c].offered[k] != NONE; k++) {
            (void)load_kin(KC_TBL_KIN, cases[c].offered[k]);
        }
        if (i % 2u != 0u) { (void)load_kin(KC_STORE_PREV, OLDEST); } /* all corrections were offered */
        booted();
        const uint32_t n = kin_image(cases[c].taken),
                       taken = kc_tbl_image_crc(s_image, n); /* NONE: nominal */
        TEST_ASSERT_EQUAL_HEX32(taken, in_force());
        if (cases[c].lost) {
            expect_came(KC_EVT_BOOT_LOST, KC_TBL_KIN, (double)taken, (double)s_crc[RIGHT]);
        } else {
            expect_none(KC_EVT_BOOT_LOST);
        }
        expect_none(KC_EVT_BOOT_SLOT_BAD);
    }
}

void test_a_stored_correction_too_short_or_too_long_to_be_one_is_reported(void)
{
    s_named.kin_crc = 5u;
    load_journal();
    load_arm_and_terms();
    (void)kin_image(RIGHT);
    TEST_ASSERT_EQUAL_INT(KC_ERR_FORMAT, kc_app_load(APP, KC_TBL_KIN, s_image, 4u));
    TEST_ASSERT_EQUAL_INT(KC_ERR_FORMAT, kc_app_load(APP, KC_TBL_KIN, s_image, KC_KIN_IMAGE_MAX + 1u));
    booted();
    expect_came(KC_EVT_BOOT_SLOT_BAD, KC_TBL_KIN, KC_ERR_FORMAT, 0.0);
    TEST_ASSERT_EQUAL_UINT32(0u, active()->kin.session);
}

/* One equal to what is in force is left by an activation that was cut off: the older copy is the right one. */
void test_for_rollback_the_correction_is_taken_that_the_journal_names_or_else_the_first_that_is_another(void)
{
    static const struct {
        bool journal;
        uint32_t named, offered[2], taken;
    } cases[] = {{true, OTHER, {OTHER, OLDEST}, OTHER}, {true, OTHER, {OLDEST, OTHER}, OTHER},
                 {true, OTHER, {OLDEST, NONE}, NONE},   {true, NONE, {OTHER, NONE}, NONE},
                 {false, NONE, {RIGHT, OTHER}, OTHER},  {false, NONE, {OTHER, OLDEST}, OTHER},
                 {true, RIGHT, {OTHER, NONE}, NONE}};
    load_arm_and_terms();
    for (uint32_t i = 0u; i < sizeof cases / sizeof cases[0]; i++) {
        setUp();
        s_named.kin_crc = s_crc[RIGHT];
        s_named.prev_crc = s_crc[cases[i].named];
        if (cases[i].journal) { load_journal(); }
        load_arm_and_terms();
        TEST_ASSERT_EQUAL_INT(KC_OK, load_kin(KC_TBL_KIN, RIGHT));
        for (uint32_t k = 0u; k < 2u && cases[i].offered[k] != NONE; k++) {
            (void)load_kin(KC_STORE_PREV, cases[i].offered[k]);
        }
        booted();
        TEST_ASSERT_EQUAL_HEX32(s_crc[cases[i].taken], active()->kin_prev_crc);
        expect_none(KC_EVT_BOOT_SLOT_BAD);
        if (cases[i].named == OTHER && cases[i].taken == NONE) {
            expect_came(KC_EVT_BOOT_LOST, KC_STORE_PREV, 0.0, (double)s_crc[OTHER]);
        } else {
            expect_none(KC_EVT_BOOT_LOST); /* also where what is named is in force again */
        }
    }
}

static uint32_t proposal_image(void)
{
    kc_kin_t kin;
    given_kin(&kin);
    kin.session = OTHER;
    kin.arm_crc = active()->crc[KC_TBL_ARM];
    kin.terms_crc = active()->crc[KC_TBL_TERMS];
    kin.prev_crc = s_crc[RIGHT];
    return given_image(KC_TBL_KIN, &kin, s_image);
}

void test_a_stored_proposal_waits_if_the_journal_names_it(void)
{
    load_arm_and_terms();
    const uint32_t n = proposal_image(), crc = kc_tbl_image_crc(s_image, n);
    for (uint32_t i = 0u; i < 4u; i++) { /* named, another one, no journal, named and not there */
        setUp();
        s_named.kin_crc = s_crc[RIGHT];
        s_named.proposal_crc = i == 1u ? 5u : crc;
        s_named.proposal_verdict = KC_VERDICT_POOR;
        if (i != 2u) { load_journal(); }
        load_arm_and_terms();
        (void)load_kin(KC_TBL_KIN, RIGHT);
        (void)proposal_image();
        TEST_ASSERT_EQUAL_INT(i == 3u   ? KC_ERR_FORMAT
                              : i == 1u ? KC_ERR_STATE
                                        : KC_OK,
                              kc_app_load(APP, KC_STORE_PROPOSAL, s_image, i == 3u ? 0u : n));
        booted();
        const bool waits = i % 2u == 0u;
        TEST_ASSERT_EQUAL_INT(waits ? KC_ST_REVIEW : KC_ST_IDLE, kc_app_state(APP));
        TEST_ASSERT_EQUAL_HEX32(waits ? crc : 0u, s_out.hk.proposal_crc);
        TEST_ASSERT_EQUAL_UINT32(i == 0u ? KC_VERDICT_POOR : KC_VERDICT_NO_CHANGE, s_out.hk.proposal_verdict);
        if (waits) {
            expect_came(KC_EVT_BOOT_REVIEW, -1, (double)crc, 0.0);
        } else {
            expect_came(KC_EVT_BOOT_LOST, KC_STORE_PROPOSAL, 0.0, i == 1u ? 5.0 : (double)crc);
        }
    }
}

/* ---- the state to begin in ---- */

static void given_keys(uint32_t n)
{
    const kc_keys_t keys = {.n = n, .key = {{.id = 1u, .secret = {5u}}, {.id = 2u}, {.id = 101u}}};
    kc_app_keys(APP, &keys);
}

/* Where the arm may be on its way it is held. */
void test_what_the_last_run_did_decides_where_the_next_one_begins(void)
{
    static const struct {
        kc_state_t was, now;
        bool interrupted;
    } cases[] = {{KC_ST_IDLE, KC_ST_IDLE, false},   {KC_ST_SAFE, KC_ST_SAFE, false},
                 {KC_ST_REVIEW, KC_ST_IDLE, false}, {KC_ST_MOVE, KC_ST_SAFE, true},
                 {KC_ST_MEASURE, KC_ST_SAFE, true}, {KC_ST_PROPOSE, KC_ST_SAFE, true}};
    for (uint32_t i = 0u; i < sizeof cases / sizeof cases[0]; i++) {
        setUp();
        given_keys(1u);
        s_named.state = cases[i].was;
        s_named.pose = 2u;
        s_named.seg_from = 7u;
        s_named.seg_to = 8u;
        load_journal();
        booted();
        TEST_ASSERT_EQUAL_INT(cases[i].now, kc_app_state(APP));
        TEST_ASSERT_EQUAL_INT(cases[i].now == KC_ST_SAFE, s_out.has_arm_cmd && s_out.arm_cmd.hold);
        TEST_ASSERT_EQUAL_INT(cases[i].now == KC_ST_SAFE, APP->move.foreign);
        TEST_ASSERT_EQUAL_INT(cases[i].was == KC_ST_IDLE ? -1 : (int32_t)cases[i].was, s_out.hk.boot_state);
        TEST_ASSERT_EQUAL_INT(cases[i].was == KC_ST_IDLE ? -1 : 2, s_out.hk.boot_pose);
        TEST_ASSERT_EQUAL_UINT32(5u, s_out.hk.boot_count);
        TEST_ASSERT_EQUAL_UINT32(3u, s_out.hk.session);
        TEST_ASSERT_EQUAL_UINT16(7u, APP->move.seg_from);
        TEST_ASSERT_EQUAL_UINT16(8u, APP->move.seg_to);
        expect_none(KC_EVT_BOOT_NO_JOURNAL);
        expect_none(KC_EVT_BOOT_JOURNAL_LOST);
        if (cases[i].interrupted) {
            expect_came(KC_EVT_BOOT_INTERRUPTED, -1, (double)cases[i].was, 2.0);
        } else {
            expect_none(KC_EVT_BOOT_INTERRUPTED);
        }
    }
}

/* Nobody knows then what it was doing; without anything stored it is the first start of all. */
void test_where_the_journal_was_lost_the_arm_is_held(void)
{
    for (uint32_t lost = 0u; lost < 2u; lost++) {
        setUp();
        given_keys(1u);
        if (lost) { (void)kc_app_load(APP, KC_STORE_JOURNAL, s_image, 20u); }
        booted();
        TEST_ASSERT_EQUAL_INT(lost ? KC_ST_SAFE : KC_ST_IDLE, kc_app_state(APP));
        expect_came(lost ? KC_EVT_BOOT_JOURNAL_LOST : KC_EVT_BOOT_NO_JOURNAL, -1, 0.0, 0.0);
    }
}

void test_one_holder_is_reported_where_config_wants_two(void)
{
    static const struct {
        uint8_t rule;
        uint32_t n_keys, events;
    } cases[] = {{0u, 2u, 0u}, {1u, 0u, 0u}, {1u, 2u, 1u}, {1u, 3u, 0u}};
    for (uint32_t i = 0u; i < 4u; i++) {
        kc_config_t config;
        setUp();
        given_keys(cases[i].n_keys);
        given_config(&config);
        config.go_by_other_key = cases[i].rule;
        TEST_ASSERT_EQUAL_INT(KC_OK, load_table(KC_TBL_CONFIG, &config));
        booted();
        if (cases[i].events) {
            expect_came(KC_EVT_KEYS_ONE_HOLDER, -1, 2.0, 0.0);
        } else {
            expect_none(KC_EVT_KEYS_ONE_HOLDER);
        }
    }
}

/* A receiver takes what has a larger number than before: a process that starts anew goes on above all that it sent. */
void test_numbers_begin_above_those_of_all_runs_before(void)
{
    static const uint32_t boots[] = {1u, 2u, 19999u, 20000u, 20001u};
    for (uint32_t i = 0u; i < 5u; i++) {
        setUp();
        s_named.boot_count = boots[i] - 1u;
        if (i > 0u) { load_journal(); }
        kc_app_boot(APP);
        const int32_t base = (int32_t)(boots[i] % 20000u) * 100000;
        const int32_t seq[] = {APP->move.seq, APP->pantilt.seq, APP->hk.seq, APP->request.seq};
        for (uint32_t k = 0u; k < 4u; k++) { TEST_ASSERT_EQUAL_INT32(base, seq[k]); }
    }
}

/* ---- keys ---- */

void test_what_a_holder_of_a_key_signed_is_vouched_for_until_the_macs_are_used_up(void)
{
    uint8_t head[KC_SIGNED_HEAD_MAX];
    static kc_table_chunk_t chunk;
    kc_cmd_t cmd = {.t_us = 1000000u, .source = KC_SRC_GROUND, .opcode = KC_CMD_NOOP};
    uint32_t macs = 1u;
    given_keys(1u);
    s_named.counters.key[0] = (kc_counted_t){.key_id = 1u, .last = {{6u, 6u}, {6u, 6u}}};
    load_journal();
    booted();
    chunk =
        (kc_table_chunk_t){.t_us = 1000000u, .source = KC_SRC_GROUND, .auth = {.key_id = 1u, .counter = 7u}};
    kc_auth_text_t text = kc_signed_chunk(&chunk, head);
    kc_auth_mac(&APP->cmd_log.keys.key[0], &text, chunk.auth.mac);
    for (uint32_t counter = 6u; counter < 8u; counter++) { /* 6 was taken before the start */
        given_signature(&cmd, &APP->cmd_log.keys.key[0], counter);
        TEST_ASSERT_EQUAL_INT(counter == 7u, kc_app_vouches_cmd(APP, &cmd, &macs));
    }
    TEST_ASSERT_FALSE(kc_app_vouches_chunk(APP, &chunk, &macs));
    macs = 1u;
    TEST_ASSERT_TRUE(kc_app_vouches_chunk(APP, &chunk, &macs));
    TEST_ASSERT_EQUAL_UINT32(0u, macs);
}

/* ---- steps ---- */

/* By the clock; by a tick where it stands still, steps back or steps ahead, which is an event. */
void test_elapsed_time_goes_on_whatever_the_clock_does(void)
{
    static const struct {
        int64_t by_us;
        uint64_t elapsed_us;
        bool stepped;
    } cases[] = {{100000, 100000u, false}, {30000, 30000u, false},         {2000000, 2000000u, false},
                 {2000001, TICK_US, true}, {3600000000000, TICK_US, true}, {0, TICK_US, false},
                 {-1, TICK_US, true},      {-60000000, TICK_US, true}};
    uint64_t clock_us = 100000000u, elapsed_us = clock_us;
    kc_app_boot(APP);
    step(clock_us);
    expect_none(KC_EVT_TIME_STEP);
    for (uint32_t i = 0u; i < sizeof cases / sizeof cases[0]; i++) {
        const uint64_t before = clock_us;
        clock_us = (uint64_t)((int64_t)clock_us + cases[i].by_us);
        elapsed_us += cases[i].elapsed_us;
        step(clock_us);
        TEST_ASSERT_EQUAL_UINT64(elapsed_us, APP->clock.now_us);
        TEST_ASSERT_EQUAL_UINT64(clock_us, APP->clock.clock_us);
        if (cases[i].stepped) {
            expect_came(KC_EVT_TIME_STEP, -1, (double)clock_us, (double)before);
        } else {
            expect_none(KC_EVT_TIME_STEP);
        }
    }
}

/* A clock that creeps is found out after two seconds of steps, and elapsed time is that of the steps. */
void test_elapsed_time_keeps_up_with_the_steps_where_the_clock_is_slow(void)
{
    static const uint64_t by_us[] = {1u, 10000u, 50000u, 99000u};
    for (uint32_t k = 0u; k < sizeof by_us / sizeof by_us[0]; k++) {
        const uint64_t behind_us = TICK_US - by_us[k];
        const uint32_t late = (uint32_t)(2000000u / behind_us) + 1u;
        uint64_t clock_us = 100000000u;
        setUp();
        kc_app_boot(APP);
        step(clock_us);
        for (uint32_t round = 1u; round < 3u; round++) {
            for (uint32_t i = 1u; i < late; i++) {
                step(clock_us += by_us[k]);
                expect_none(KC_EVT_TIME_SLOW);
            }
            if (round == 1u) { TEST_ASSERT_EQUAL_UINT64(clock_us, APP->clock.now_us); }
            step(clock_us += by_us[k]);
            expect_came(KC_EVT_TIME_SLOW, -1, (double)(late * behind_us), 0.0);
            TEST_ASSERT_EQUAL_UINT64(100000000u + (uint64_t)round * late * TICK_US, APP->clock.now_us);
            TEST_ASSERT_EQUAL_UINT64(clock_us, APP->clock.clock_us);
        }
    }
}

/* Steps that come late and are made up for, as after a pause of the process, are no slow clock. */
void test_steps_that_catch_up_are_no_slow_clock(void)
{
    uint64_t clock_us = 100000000u;
    kc_app_boot(APP);
    step(clock_us);
    for (uint32_t round = 0u; round < 10u; round++) {
        step(clock_us += 1000000u);
        for (uint32_t i = 0u; i < 9u; i++) {
            step(clock_us += i == 0u ? 0u : 1u);
            expect_none(KC_EVT_TIME_SLOW);
        }
    }
}

void test_housekeeping_comes_with_the_first_step_and_then_once_a_second(void)
{
    uint32_t n = 0u;
    kc_app_boot(APP);
    for (uint64_t i = 0u; i < 51u; i++) {
        step(1000000u + i * TICK_US);
        n += s_out.has_hk;
        TEST_ASSERT_EQUAL_INT(i % 10u == 0u, s_out.has_hk);
    }
    TEST_ASSERT_EQUAL_UINT32(6u, n);
    TEST_ASSERT_EQUAL_INT(100000 + 6, s_out.hk.seq);
}

void test_housekeeping_says_how_things_stand_in_every_part(void)
{
    given_app();
    APP->hk.seq = 4;
    APP->cal.session = 12u;
    APP->cal.candidate = 13;
    APP->cal.energy_j = 14.5;
    APP->plan.n_meas = 15u;
    APP->plan.n_goal = 16u;
    APP->observe.servo_steps = 17u;
    APP->input.n_rejected = 18u;
    APP->cmd_log.n_ok = 19u;
    APP->cmd_log.n_refused = 20u;
    APP->boot_state = 21;
    APP->boot_pose = 22;
    APP->boot_count = 23u;
    APP->tables.active.kin_prev_crc = 24u;
    APP->review.crc = 25u;
    APP->tables.staging.state = KC_STAGE_LOADING;
    APP->tables.staging.kind = KC_TBL_SPACE;
    APP->tables.staging.n = 26u;
    s_in.n_rx_errors = 27u;
    APP->stepped = true;
    step(PARTS_NOW_US + TICK_US);
    const kc_hk_t *h = &s_out.hk;
    const double got[] = {h->seq,           h->state,        h->session,     h->candidate,    h->energy_j,
                          h->n_poses,       h->n_poses_goal, h->servo_steps, h->n_rejected,   h->n_cmd_ok,
                          h->n_cmd_refused, h->boot_state,   h->boot_pose,   h->boot_count,   h->kin_prev_crc,
                          h->proposal_crc,  h->staged_state, h->staged_kind, h->staged_bytes, h->n_rx_errors};
    const double want[] = {
        5,  KC_ST_IDLE,       12,           13, 14.5, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24,
        25, KC_STAGE_LOADING, KC_TBL_SPACE, 26, 27};
    TEST_ASSERT_EQUAL_DOUBLE_ARRAY(want, got, sizeof want / sizeof want[0]);
    TEST_ASSERT_EQUAL_MEMORY(active()->crc, h->table_crc, sizeof h->table_crc);
    APP->tables.staging.state = KC_STAGE_NONE;
    step(PARTS_NOW_US + 11u * TICK_US);
    TEST_ASSERT_EQUAL_INT(0, h->staged_kind);
}

void test_housekeeping_says_what_the_monitor_found(void)
{
    static const kc_mon_state_t states[] = {KC_MON_NAMED, KC_MON_SEVERAL, KC_MON_QUIET};
    for (uint32_t i = 0u; i < 3u; i++) {
        given_app();
        APP->monitoring.newest = (kc_mon_verdict_t){.state = states[i],
                                                    .joint = 4u,
                                                    .suspects = 0x11u,
                                                    .n_obs = 9u,
                                                    .bias = 0.1,
                                                    .sigma = 0.2,
                                                    .p = 0.3};
        APP->monitoring.suspects.chance[4] = 0.7;
        step(PARTS_NOW_US);
        const kc_hk_t *h = &s_out.hk;
        const double got[] = {h->mon_state, h->mon_joint, h->mon_suspects, h->mon_n_obs,
                              h->mon_bias,  h->mon_sigma, h->mon_p,        h->mon_chance[4]};
        const double want[] = {states[i], i < 2u ? 5 : 0, 0x11, 9, 0.1, 0.2, 0.3, 0.7};
        TEST_ASSERT_EQUAL_DOUBLE_ARRAY(want, got, 8u);
    }
}

/* The record, when something has changed; while a change is stored, it is part of that. */
void test_the_journal_is_stored_with_the_step_that_changes_something_and_not_in_a_change(void)
{
    for (uint32_t changing = 0u; changing < 2u; changing++) {
        given_app();
        APP->stepped = true;
        APP->place.state = changing ? KC_ST_STORE : KC_ST_SAFE;
        APP->change.due_us = UINT64_MAX;
        step(PARTS_NOW_US + TICK_US);
        TEST_ASSERT_EQUAL_UINT32(1u - changing, s_out.n_store);
        if (changing) { continue; }
        TEST_ASSERT_EQUAL_UINT16(KC_STORE_JOURNAL, s_out.store[0].kind);
        TEST_ASSERT_EQUAL_UINT32(KC_ST_SAFE, APP->journal.last.state);
    }
}

void test_the_room_for_images_is_that_of_what_is_staged(void)
{
    TEST_ASSERT_EQUAL_PTR(APP->arena.idle.staged, kc_app_image_room(APP));
    TEST_ASSERT_EQUAL_PTR(APP->arena.idle.staged, APP->tables.staging.image);
}
