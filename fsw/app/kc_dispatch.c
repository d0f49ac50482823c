#include "kc_dispatch.h"

#include <stddef.h>

#include "kc_app_parts.h"
#include "kc_select.h"
#include "kc_signed.h"
#include "kc_suspicion.h"
#include "kc_update.h"

/* ---- the table ---- */

#define ANY_STATE ((1u << KC_ST_COUNT) - 1u)
#define IN_REVIEW (1u << KC_ST_REVIEW)
#define IN_ARMED (1u << KC_ST_ARMED)

typedef struct {
    kc_opcode_t opcode;
    kc_sender_t sender;       /* who may send it */
    uint32_t states;          /* in which it is taken, bit per state */
    bool table;               /* of a table: takes the time of a whole one */
    bool gives_way; /* to an ABORT that came with it: it moves the arm or changes what is in force */
    kc_change_kind_t changes; /* what is stored before it is answered; NONE: answered at once */
} command_t;

static const command_t s_command[] = {
    /* opcode, sender, states, table, gives_way, changes */
    {KC_CMD_NOOP, KC_SENDER_UNSIGNED, ANY_STATE, false, false, KC_CHANGE_NONE},
    {KC_CMD_START, KC_SENDER_SIGNED, KC_CMD_FREE, false, true, KC_CHANGE_NONE},
    {KC_CMD_ABORT, KC_SENDER_ANYBODY, ANY_STATE, false, false, KC_CHANGE_NONE},
    {KC_CMD_APPROVE_ARM, KC_SENDER_SIGNED, IN_REVIEW, false, true, KC_CHANGE_NONE},
    {KC_CMD_APPROVE_GO, KC_SENDER_SIGNED, IN_ARMED, false, true, KC_CHANGE_APPROVE},
    {KC_CMD_REJECT, KC_SENDER_SIGNED, IN_REVIEW | IN_ARMED, false, false, KC_CHANGE_REJECT},
    {KC_CMD_ROLLBACK, KC_SENDER_SIGNED, KC_CMD_FREE, false, true, KC_CHANGE_ROLLBACK},
    {KC_CMD_TABLE_VALIDATE, KC_SENDER_SIGNED, KC_CMD_FREE, true, false, KC_CHANGE_NONE},
    {KC_CMD_TABLE_ACTIVATE, KC_SENDER_SIGNED, KC_CMD_FREE, true, true, KC_CHANGE_TABLE},
    {KC_CMD_TABLE_DISCARD, KC_SENDER_SIGNED, KC_CMD_FREE, true, false, KC_CHANGE_NONE},
    {KC_CMD_TABLE_DUMP, KC_SENDER_SIGNED, ANY_STATE, false, false, KC_CHANGE_NONE},
};
#define COMMAND_N (sizeof s_command / sizeof s_command[0])
_Static_assert(KC_ST_COUNT < 32u, "a bit for each state");

/* What is not in the table. */
static const command_t s_unknown = {KC_CMD_NOOP, KC_SENDER_SIGNED, ANY_STATE, false, false, KC_CHANGE_NONE};

static const command_t *find(int32_t opcode)
{
    for (size_t i = 0u; i < COMMAND_N; i++) {
        if ((int32_t)s_command[i].opcode == opcode) { return &s_command[i]; }
    }
    return &s_unknown;
}

/* ---- check ---- */

/* A table is checked, decoded and compared as a whole: a step has time for a large one, or for several small. */
static kc_answer_t check(const kc_app_t *app, const command_t *row, const kc_cmd_t *cmd, kc_work_t *work,
                         kc_out_t *out)
{
    if (row->table && !kc_work_take(work, kc_tbl_cost(&app->tables))) {
        return kc_answer_refuse(&out->events, KC_EVT_CMD_WORK, cmd->opcode, 0.0, 0.0, KC_ERR_STATE);
    }
    if ((row->states >> app->place.state & 1u) != 0u) { return kc_answer_ok(KC_OC_STAY); }
    return row->table ? kc_cmd_busy(&app->view, out) : kc_cmd_not_now(&app->view, cmd, out);
}

/* ---- apply ---- */

/* The monitor names joints, and of the coefficients in mask some are offsets of their encoders. */
static bool suspected(const kc_app_t *app, uint64_t mask)
{
    const kc_monitoring_t *m = &app->monitoring;
    return kc_monitoring_names(m, &app->view) &&
           kc_suspicion_offsets(&app->tables.active, m->suspects.joints, mask) != 0u;
}

static kc_answer_t start(kc_app_t *app, const kc_cmd_t *cmd, kc_work_t *work, kc_out_t *out)
{
    const kc_view_t *v = &app->view;
    double dist = 0.0;
    kc_start_t ask;
    kc_answer_t answer = kc_cmd_start(v, cmd, &ask, out);
    if (answer.status != KC_OK) { return answer; }
    if (kc_move_node(&app->move, v, &dist) == KC_NODE_NONE) {
        return kc_answer_refuse(&out->events, KC_EVT_CAL_NO_PATH, -1, dist, 1.0, KC_ERR_PATH);
    }
    if (ask.suspects && !suspected(app, ask.free_mask)) {
        return kc_answer_refuse(&out->events, KC_EVT_CAL_NO_SUSPECTS, -1,
                                (double)app->monitoring.suspects.joints, 0.0, KC_ERR_STATE);
    }
    kc_tbl_discard(&app->tables, &out->events);
    kc_select_start(&app->cal, &app->plan, v, &ask, out);
    kc_update_start(&app->latest, &app->est, &app->arena.calibration, v, ask.free_mask);
    if (ask.suspects) { kc_suspicion_begin(&app->est, v, &app->monitoring.suspects, out); }
    kc_observe_begin(&app->observe);
    app->rng = ask.seed;
    kc_work_spend(work, kc_update_start_cost(v));
    return answer;
}

static kc_answer_t discard(kc_app_t *app, kc_out_t *out)
{
    kc_tbl_discard(&app->tables, &out->events);
    return kc_answer_ok(KC_OC_STAY);
}

static kc_answer_t apply(kc_app_t *app, kc_opcode_t opcode, const kc_cmd_t *cmd, kc_work_t *work,
                         kc_out_t *out)
{
    uint32_t crc = (uint32_t)cmd->arg_i[0];
    switch (opcode) {
    case KC_CMD_START: return start(app, cmd, work, out);
    case KC_CMD_ABORT: return kc_answer_ok(KC_OC_ABORT);
    case KC_CMD_APPROVE_ARM:
        return kc_review_arm(&app->review, &app->tables.active.config, &app->cmd_log.keys, cmd, out);
    case KC_CMD_APPROVE_GO: return kc_review_go(&app->review, &app->tables, cmd, out);
    case KC_CMD_REJECT: return kc_review_reject(&app->review, crc, out);
    case KC_CMD_ROLLBACK: return kc_review_rollback(&app->tables, crc, out);
    case KC_CMD_TABLE_VALIDATE: return kc_cmd_validate(&app->cmd_log, &app->tables, cmd, out);
    case KC_CMD_TABLE_ACTIVATE: return kc_cmd_activate(&app->cmd_log, &app->tables, cmd, out);
    case KC_CMD_TABLE_DISCARD: return discard(app, out);
    case KC_CMD_TABLE_DUMP: return kc_dump_begin(&app->dump, &app->review, &app->view, cmd, out);
    default: return kc_answer_ok(KC_OC_STAY); /* NOOP */
    }
}

/* ---- acknowledge ---- */

kc_outcome_t kc_dispatch(kc_app_t *app, const kc_cmd_t *cmd, bool aborted, kc_work_t *work, kc_out_t *out)
{
    const command_t *row = find(cmd->opcode);
    if (cmd->auth.key_id != 0u) { kc_work_spend(work, kc_auth_cost(KC_SIGNED_HEAD_MAX)); }
    kc_answer_t answer = kc_cmd_admit(&app->cmd_log, row->sender, &app->view, cmd, out);
    if (answer.status == KC_OK && row == &s_unknown) {
        answer = kc_answer_refuse(&out->events, KC_EVT_CMD_UNKNOWN, -1, (double)cmd->opcode, 0.0, KC_ERR_ARG);
    }
    if (answer.status == KC_OK && row->gives_way && aborted) {
        answer = kc_answer_refuse(&out->events, KC_EVT_CMD_ABORTED, cmd->opcode, 0.0, 0.0, KC_ERR_STATE);
    }
    if (answer.status == KC_OK) { answer = check(app, row, cmd, work, out); }
    if (answer.status == KC_OK) { answer = apply(app, row->opcode, cmd, work, out); }
    if (answer.outcome.id == KC_OC_STORE) {
        kc_change_begin(&app->change, row->changes, &app->view, cmd);
    } else {
        kc_cmd_answer(&app->cmd_log, cmd, &answer, out);
    }
    return answer.outcome;
}
