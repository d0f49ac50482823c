/* kc_cmd.c: what START and the commands of tables need, and what they ask for. Who is admitted: test_cmd.c,
 * test_signed.c. */
#include "kc_cmd.h"

#include <string.h>

#include "given_parts.h"
#include "given_tables.h"
#include "kc_input_fields.h"
#include "unity.h"

#define ALL ((1ull << 28) - 1u) /* coefficients */

static kc_cmd_t s_cmd;
static kc_start_t s_ask;
static kc_cmd_log_t s_log;
static kc_tbl_scratch_t s_scratch;

void setUp(void)
{
    given_parts();
    parts.telemetry.has_arm = parts.telemetry.has_pantilt = true;
    parts.telemetry.arm_ok_us = parts.telemetry.pantilt_ok_us = PARTS_NOW_US;
    parts.tables.scratch = &s_scratch;
    s_cmd = (kc_cmd_t){.opcode = KC_CMD_START, .arg_i = {-1, 0, 7, 0}};
}

static kc_answer_t start(void) { return kc_cmd_start(&parts.view, &s_cmd, &s_ask, &parts.out); }

static void expect_asked(kc_acq_t acq, uint32_t n_goal, uint64_t mask, bool suspects)
{
    expect_taken(start(), KC_OC_START);
    TEST_ASSERT_EQUAL_INT(acq, s_ask.acq);
    TEST_ASSERT_EQUAL_UINT32(n_goal, s_ask.n_goal);
    TEST_ASSERT_EQUAL_UINT64(mask, s_ask.free_mask);
    TEST_ASSERT_EQUAL_UINT32(7u, s_ask.seed);
    TEST_ASSERT_EQUAL_INT(suspects, s_ask.suspects);
}

void test_without_arguments_start_takes_those_of_config(void)
{
    parts.tables.active.config.acquisition = KC_ACQ_DOPT;
    parts.tables.active.config.n_poses = 9u;
    parts.tables.active.config.est.free_mask = 0xf0u;
    expect_asked(KC_ACQ_DOPT, 9u, 0xf0u, false);
}

void test_the_last_arguments_of_each_range_are_taken(void)
{
    parts.tables.active.config.acquisition = KC_ACQ_COUNT - 2;
    s_cmd.arg_i[0] = KC_ACQ_COUNT - 1;
    s_cmd.arg_i[1] = KC_MEAS_MAX;
    s_cmd.arg_i[3] = 1;
    s_cmd.arg_u64 = ALL;
    expect_asked((kc_acq_t)(KC_ACQ_COUNT - 1), KC_MEAS_MAX, ALL, true);
    s_cmd.arg_i[0] = 0;
    s_cmd.arg_i[1] = 1;
    expect_asked((kc_acq_t)0, 1u, ALL, true);
}

void test_a_refused_argument_is_named_with_what_came_and_the_most_there_may_be(void)
{
    static const struct {
        int32_t index, got;
        double want;
    } cases[] = {{0, -2, 4.0}, {0, 5, 4.0}, {1, -1, 64.0}, {1, 65, 64.0}, {3, -1, 1.0}, {3, 2, 1.0}};
    for (uint32_t i = 0u; i < sizeof cases / sizeof cases[0]; i++) {
        setUp();
        s_cmd.arg_i[cases[i].index] = cases[i].got;
        expect_refused(start(), KC_ERR_ARG, KC_EVT_CMD_ARG, cases[i].index, cases[i].got, cases[i].want);
    }
    setUp();
    s_cmd.arg_u64 = 3ull << 27; /* the last coefficient, and one that there is not */
    expect_refused(start(), KC_ERR_ARG, KC_EVT_CMD_ARG, 4, (double)(3ull << 27), (double)ALL);
    s_cmd.arg_u64 = 0u;
    for (uint32_t c = 0u; c < 28u; c++) { parts.tables.active.terms.coef[c].enabled = 0u; }
    TEST_ASSERT_EQUAL_INT(KC_EVT_CMD_ARG, start().event); /* nothing to estimate */
}

void test_start_names_the_first_table_that_is_missing(void)
{
    for (int32_t kind = KC_TBL_COUNT - 1; kind > 0; kind--) {
        parts.tables.active.crc[kind] = 0u;
        expect_refused(start(), KC_ERR_STATE, KC_EVT_TBL_MISSING, kind, 0.0, 0.0);
    }
}

void test_start_needs_arm_and_pantilt_that_were_heard_two_seconds_ago_at_most(void)
{
    uint64_t *ok_us[] = {&parts.telemetry.arm_ok_us, &parts.telemetry.pantilt_ok_us};
    bool *has[] = {&parts.telemetry.has_arm, &parts.telemetry.has_pantilt};
    for (int32_t who = 0; who < 2; who++) {
        setUp();
        *ok_us[who] -= KC_SILENT_US;
        expect_taken(start(), KC_OC_START);
        *ok_us[who] -= 1u;
        expect_refused(start(), KC_ERR_STATE, KC_EVT_IN_SILENT, (int32_t)KC_INPUT_ARM + who,
                       KC_SILENT_US + 1.0, KC_SILENT_US);
        *ok_us[who] = PARTS_NOW_US;
        *has[who] = false;
        expect_refused(start(), KC_ERR_STATE, KC_EVT_IN_SILENT, (int32_t)KC_INPUT_ARM + who, -1.0,
                       KC_SILENT_US);
    }
}

void test_start_is_refused_while_the_arm_reports_a_fault(void)
{
    parts.telemetry.arm.fault_mask = 6;
    expect_refused(start(), KC_ERR_STATE, KC_EVT_ARM_FAULT, -1, 6.0, 0.0);
}

void test_commands_of_tables_name_a_kind_that_there_is(void)
{
    for (int32_t kind = -1; kind <= KC_TBL_COUNT; kind++) {
        s_cmd = (kc_cmd_t){.arg_i = {kind < 0 ? (1 << 16) + 1 : kind, 5}}; /* kinds have 16 bits */
        for (uint32_t i = 0u; i < 2u; i++) {
            kc_answer_t answer = i == 0u ? kc_cmd_validate(&s_log, &parts.tables, &s_cmd, &parts.out)
                                         : kc_cmd_activate(&s_log, &parts.tables, &s_cmd, &parts.out);
            if (kind < 1 || kind == KC_TBL_COUNT) {
                expect_refused(answer, KC_ERR_ARG, KC_EVT_CMD_ARG, 0, s_cmd.arg_i[0], KC_TBL_COUNT - 1);
            } else {
                TEST_ASSERT_EQUAL_INT(KC_EVT_TBL_NOT_READY, answer.event); /* nothing is staged */
                parts.out.events.n = 0u;
            }
        }
    }
}

void test_what_is_refused_in_a_state_is_reported_with_it(void)
{
    parts.place.state = KC_ST_REVIEW;
    expect_refused(kc_cmd_not_now(&parts.view, &s_cmd, &parts.out), KC_ERR_STATE, KC_EVT_CMD_STATE,
                   KC_CMD_START, (double)KC_ST_REVIEW, 0.0);
    expect_refused(kc_cmd_busy(&parts.view, &parts.out), KC_ERR_STATE, KC_EVT_TBL_BUSY, -1,
                   (double)KC_ST_REVIEW, 0.0);
}

/* One holder alone could end the rule of two, or uplink a correction past the review. 1 and 2 are the keys of one. */
void test_tables_that_could_undo_the_rule_of_two_take_two_holders(void)
{
    static const struct {
        uint16_t kind;
        uint8_t rule, new_rule; /* of CONFIG in force and staged */
        uint32_t n_keys, validates, activates;
        kc_event_id_t validation, activation; /* why it is refused; NONE: it is not */
    } cases[] = {
        {KC_TBL_CONFIG, 0u, 1u, 2u, 1u, 1u, KC_EVT_KEYS_ONE_HOLDER, KC_EVT_KEYS_ONE_HOLDER},
        {KC_TBL_CONFIG, 0u, 1u, 3u, 1u, 1u, KC_EVT_NONE, KC_EVT_NONE}, /* it takes one to bring it in */
        {KC_TBL_CONFIG, 1u, 0u, 3u, 101u, 101u, KC_EVT_NONE, KC_EVT_CMD_SAME_KEY},
        {KC_TBL_CONFIG, 1u, 0u, 3u, 101u, 2u, KC_EVT_NONE, KC_EVT_NONE},
        {KC_TBL_CONFIG, 1u, 0u, 2u, 1u, 1u, KC_EVT_NONE, KC_EVT_NONE}, /* the only one left may end it */
        {KC_TBL_KIN, 1u, 1u, 3u, 1u, 2u, KC_EVT_NONE, KC_EVT_CMD_SAME_KEY},
        {KC_TBL_KIN, 1u, 1u, 3u, 1u, 101u, KC_EVT_NONE, KC_EVT_NONE},
        {KC_TBL_CAMERA, 1u, 1u, 3u, 1u, 1u, KC_EVT_NONE, KC_EVT_NONE},
    };
    static uint8_t image[KC_IMAGE_MAX];
    for (uint32_t i = 0u; i < sizeof cases / sizeof cases[0]; i++) {
        kc_active_t *a = &parts.tables.active;
        setUp();
        a->config.go_by_other_key = cases[i].new_rule;
        const uint32_t n = given_image(cases[i].kind, kc_tbl_active_ptr(a, cases[i].kind), image);
        a->config.go_by_other_key = cases[i].rule;
        parts.tables.staging = (kc_staging_t){KC_STAGE_COMPLETE, cases[i].kind, n, n, image};
        s_log.keys = (kc_keys_t){.n = cases[i].n_keys, .key = {{.id = 1u}, {.id = 2u}, {.id = 101u}}};
        s_cmd = (kc_cmd_t){.arg_i = {cases[i].kind, (int32_t)kc_tbl_image_crc(image, n)}};
        s_cmd.auth.key_id = cases[i].validates;
        TEST_ASSERT_EQUAL_INT(cases[i].validation,
                              kc_cmd_validate(&s_log, &parts.tables, &s_cmd, &parts.out).event);
        s_cmd.auth.key_id = cases[i].activates;
        kc_answer_t answer = kc_cmd_activate(&s_log, &parts.tables, &s_cmd, &parts.out);
        TEST_ASSERT_EQUAL_INT(cases[i].activation, answer.event);
        TEST_ASSERT_EQUAL_INT(answer.event == KC_EVT_NONE ? KC_OC_STORE : KC_OC_STAY, answer.outcome.id);
    }
}
