#include "kc_cmd.h"

#include <stddef.h>
#include <string.h>

#include "kc_holder.h"
#include "kc_input_fields.h"
#include "kc_signed.h"

#define WINDOW 1000000u     /* how far a command's number may be ahead of the last one */
#define RESYNC_US 10000000u /* a source silent for longer may begin anew outside that window */

/* ---- admission and answer ---- */

/* A number follows the last one of its source if it lies within the window after it; numbers wrap. After a
 * silence any number outside the window counts, so that neither a wild number nor a sender that was started
 * again locks its source out; a number within the window behind is a repetition for ever. */
static bool follows(const kc_cmd_log_t *log, const kc_view_t *view, uint32_t s, int32_t seq)
{
    if (!log->seen[s]) { return true; }
    uint32_t ahead = (uint32_t)seq - (uint32_t)log->seq[s];
    uint32_t behind = (uint32_t)log->seq[s] - (uint32_t)seq;
    if (ahead > 0u && ahead <= WINDOW) { return true; }
    return behind > WINDOW && view->clock->now_us - log->us[s] > RESYNC_US;
}

static kc_answer_t unknown_source(int32_t source, kc_out_t *out)
{
    return kc_answer_refuse(&out->events, KC_EVT_CMD_SOURCE, -1, (double)source, 0.0, KC_ERR_ARG);
}

static bool known_source(int32_t source) { return source >= 1 && source <= (int32_t)KC_SOURCE_MAX; }

static kc_auth_known_t known(const kc_cmd_log_t *log, const kc_view_t *view, kc_signed_kind_t kind,
                             int32_t source, uint32_t key_id)
{
    const kc_counted_t *k = kc_counters_of(&log->counters, key_id);
    return (kc_auth_known_t){
        .last = k != NULL ? k->last[kind][source - 1] : 0u,
        .since_us = k != NULL ? k->since_us : 0u,
        .clock_us = view->clock->clock_us,
        .age_max_us = view->tables->config.signed_age_max_us,
    };
}

static kc_answer_t refuse_stamp(const kc_auth_known_t *known, kc_auth_verdict_t why, int32_t source,
                                uint64_t t_us, kc_out_t *out)
{
    if (why == KC_AUTH_BEFORE) {
        return kc_answer_refuse(&out->events, KC_EVT_CMD_BEFORE, source, (double)t_us,
                                (double)known->since_us, KC_ERR_STALE);
    }
    double ago_us = (double)known->clock_us - (double)t_us;
    return kc_answer_refuse(&out->events, KC_EVT_CMD_OLD, source, ago_us, (double)known->age_max_us,
                            KC_ERR_STALE);
}

/* By MAC, counter and stamp; one that is taken uses its counter up, and one that is refused for its stamp too. */
static kc_answer_t by_signature(kc_cmd_log_t *log, const kc_view_t *view, kc_signed_kind_t kind,
                                int32_t source, const kc_auth_t *auth, uint64_t t_us,
                                const kc_auth_text_t *text, kc_out_t *out)
{
    const kc_auth_known_t k = known(log, view, kind, source, auth->key_id);
    double key = (double)auth->key_id, counter = (double)auth->counter;
    kc_auth_verdict_t verdict = kc_auth_check(&log->keys, auth, &k, t_us, text);
    switch (verdict) {
    case KC_AUTH_GOOD: kc_counters_take(&log->counters, auth, kind, source); return kc_answer_ok(KC_OC_STAY);
    case KC_AUTH_UNSIGNED:
        return kc_answer_refuse(&out->events, KC_EVT_CMD_UNSIGNED, source, 0.0, 0.0, KC_ERR_AUTH);
    case KC_AUTH_UNKNOWN_KEY:
        return kc_answer_refuse(&out->events, KC_EVT_CMD_KEY, source, key, 0.0, KC_ERR_AUTH);
    case KC_AUTH_REPLAYED:
        return kc_answer_refuse(&out->events, KC_EVT_CMD_REPLAYED, source, counter, (double)k.last,
                                KC_ERR_STALE);
    case KC_AUTH_JUMPED:
        return kc_answer_refuse(&out->events, KC_EVT_CMD_COUNTER, source, counter,
                                (double)k.last + (double)KC_AUTH_JUMP_MAX, KC_ERR_RANGE);
    case KC_AUTH_BEFORE:
    case KC_AUTH_OLD:
        kc_counters_take(&log->counters, auth, kind, source);
        return refuse_stamp(&k, verdict, source, t_us, out);
    default: return kc_answer_refuse(&out->events, KC_EVT_CMD_FORGED, source, key, 0.0, KC_ERR_AUTH);
    }
}

/* Whether the signature would be taken. The MAC is computed last, and only if the rest is good. */
static bool vouches(const kc_cmd_log_t *log, const kc_auth_known_t *known, const kc_auth_t *auth,
                    uint64_t t_us, const kc_auth_text_t *text, uint32_t *macs)
{
    if (*macs == 0u || kc_counters_of(&log->counters, auth->key_id) == NULL) { return false; }
    if (kc_auth_fresh(known, auth->counter, t_us) != KC_AUTH_GOOD) { return false; }
    (*macs)--;
    return kc_auth_check(&log->keys, auth, known, t_us, text) == KC_AUTH_GOOD;
}

bool kc_cmd_vouches(const kc_cmd_log_t *log, const kc_view_t *view, const kc_cmd_t *cmd, uint32_t *macs)
{
    uint8_t head[KC_SIGNED_HEAD_MAX];
    if (!known_source(cmd->source)) { return false; }
    const kc_auth_known_t k = known(log, view, KC_SIGNED_CMD, cmd->source, cmd->auth.key_id);
    const kc_auth_text_t text = kc_signed_cmd(cmd, head);
    return vouches(log, &k, &cmd->auth, cmd->t_us, &text, macs);
}

bool kc_cmd_vouches_chunk(const kc_cmd_log_t *log, const kc_view_t *view, const kc_table_chunk_t *chunk,
                          uint32_t *macs)
{
    uint8_t head[KC_SIGNED_HEAD_MAX];
    if (!known_source(chunk->source)) { return false; }
    const kc_auth_known_t k = known(log, view, KC_SIGNED_CHUNK, chunk->source, chunk->auth.key_id);
    const kc_auth_text_t text = kc_signed_chunk(chunk, head);
    return vouches(log, &k, &chunk->auth, chunk->t_us, &text, macs);
}

static kc_answer_t by_number(kc_cmd_log_t *log, const kc_view_t *view, const kc_cmd_t *cmd, kc_out_t *out)
{
    uint32_t s = (uint32_t)cmd->source - 1u;
    if (!follows(log, view, s, cmd->seq)) {
        return kc_answer_refuse(&out->events, KC_EVT_CMD_STALE, cmd->source, (double)cmd->seq,
                                (double)log->seq[s], KC_ERR_STALE);
    }
    log->seen[s] = true;
    log->seq[s] = cmd->seq;
    log->us[s] = view->clock->now_us;
    return kc_answer_ok(KC_OC_STAY);
}

kc_answer_t kc_cmd_admit(kc_cmd_log_t *log, kc_sender_t sender, const kc_view_t *view, const kc_cmd_t *cmd,
                         kc_out_t *out)
{
    uint8_t head[KC_SIGNED_HEAD_MAX];
    if (sender == KC_SENDER_ANYBODY) { return kc_answer_ok(KC_OC_STAY); }
    if (!known_source(cmd->source)) { return unknown_source(cmd->source, out); }
    if (cmd->auth.key_id == 0u && sender == KC_SENDER_UNSIGNED) { return by_number(log, view, cmd, out); }
    kc_auth_text_t text = kc_signed_cmd(cmd, head);
    return by_signature(log, view, KC_SIGNED_CMD, cmd->source, &cmd->auth, cmd->t_us, &text, out);
}

void kc_cmd_answer(kc_cmd_log_t *log, const kc_cmd_t *cmd, const kc_answer_t *answer, kc_out_t *out)
{
    out->ack[out->n_ack++] = (kc_ack_t){cmd->source, cmd->seq, cmd->opcode, (int32_t)answer->status,
                                        (int32_t)answer->event};
    if (answer->status == KC_OK) {
        kc_event(&out->events, KC_EVT_CMD_ACCEPTED, cmd->seq, (double)cmd->opcode, 0.0);
        log->n_ok++;
    } else {
        log->n_refused++;
    }
}

kc_answer_t kc_cmd_not_now(const kc_view_t *view, const kc_cmd_t *cmd, kc_out_t *out)
{
    return kc_answer_refuse(&out->events, KC_EVT_CMD_STATE, cmd->opcode, (double)view->place->state, 0.0,
                            KC_ERR_STATE);
}

kc_answer_t kc_cmd_busy(const kc_view_t *view, kc_out_t *out)
{
    return kc_answer_refuse(&out->events, KC_EVT_TBL_BUSY, -1, (double)view->place->state, 0.0, KC_ERR_STATE);
}

static kc_answer_t bad_arg(kc_out_t *out, int32_t index, double got, double most)
{
    return kc_answer_refuse(&out->events, KC_EVT_CMD_ARG, index, got, most, KC_ERR_ARG);
}

/* ---- START ---- */

static kc_answer_t all_tables(const kc_view_t *view, kc_out_t *out)
{
    for (uint16_t kind = 1u; kind < KC_TBL_COUNT; kind++) {
        if (view->tables->crc[kind] != 0u) { continue; }
        return kc_answer_refuse(&out->events, KC_EVT_TBL_MISSING, kind, 0.0, 0.0, KC_ERR_STATE);
    }
    return kc_answer_ok(KC_OC_STAY);
}

/* Arm and pan-tilt unit send state and the arm has no fault. */
static kc_answer_t alive(const kc_view_t *view, kc_out_t *out)
{
    const kc_telemetry_t *t = view->telemetry;
    uint64_t now_us = view->clock->now_us, ago[2] = {now_us - t->arm_ok_us, now_us - t->pantilt_ok_us};
    bool known[2] = {t->has_arm, t->has_pantilt};
    for (int32_t i = 0; i < 2; i++) {
        if (known[i] && ago[i] <= KC_SILENT_US) { continue; }
        double heard = known[i] ? (double)ago[i] : -1.0;
        return kc_answer_refuse(&out->events, KC_EVT_IN_SILENT, (int32_t)KC_INPUT_ARM + i, heard,
                                (double)KC_SILENT_US, KC_ERR_STATE);
    }
    if (t->arm.fault_mask == 0) { return kc_answer_ok(KC_OC_STAY); }
    return kc_answer_refuse(&out->events, KC_EVT_ARM_FAULT, -1, (double)t->arm.fault_mask, 0.0, KC_ERR_STATE);
}

static uint64_t coefs(const kc_terms_t *terms)
{
    uint64_t mask = 0u;
    for (uint32_t c = 0u; c < terms->n_coef; c++) { mask |= terms->coef[c].enabled ? (uint64_t)1u << c : 0u; }
    return mask;
}

static kc_answer_t start_args(const kc_active_t *active, const kc_cmd_t *cmd, kc_start_t *ask, kc_out_t *out)
{
    uint64_t can = coefs(&active->terms);
    uint64_t mask = cmd->arg_u64 != 0u ? cmd->arg_u64 : active->config.est.free_mask & can;
    if (cmd->arg_i[0] < -1 || cmd->arg_i[0] > (int32_t)KC_ACQ_COUNT - 1) {
        return bad_arg(out, 0, (double)cmd->arg_i[0], (double)KC_ACQ_COUNT - 1);
    }
    if (cmd->arg_i[1] < 0 || cmd->arg_i[1] > (int32_t)KC_MEAS_MAX) {
        return bad_arg(out, 1, (double)cmd->arg_i[1], (double)KC_MEAS_MAX);
    }
    if (cmd->arg_i[3] < 0 || cmd->arg_i[3] > 1) { return bad_arg(out, 3, (double)cmd->arg_i[3], 1.0); }
    if (mask == 0u || (mask & ~can) != 0u) { return bad_arg(out, 4, (double)mask, (double)can); }
    *ask = (kc_start_t){
        .acq = cmd->arg_i[0] < 0 ? (kc_acq_t)active->config.acquisition : (kc_acq_t)cmd->arg_i[0],
        .n_goal = cmd->arg_i[1] == 0 ? active->config.n_poses : (uint32_t)cmd->arg_i[1],
        .seed = (uint32_t)cmd->arg_i[2],
        .free_mask = mask,
        .suspects = cmd->arg_i[3] != 0,
    };
    return kc_answer_ok(KC_OC_START);
}

kc_answer_t kc_cmd_start(const kc_view_t *view, const kc_cmd_t *cmd, kc_start_t *ask, kc_out_t *out)
{
    kc_answer_t answer = all_tables(view, out);
    if (answer.status == KC_OK) { answer = alive(view, out); }
    return answer.status == KC_OK ? start_args(view->tables, cmd, ask, out) : answer;
}

/* ---- tables ---- */

/* Kind of table that a command names; 0: there is none of that number (of which kinds have 16 bits, arguments 32). */
static uint16_t kind_of(const kc_cmd_t *cmd)
{
    return cmd->arg_i[0] >= 1 && cmd->arg_i[0] < (int32_t)KC_TBL_COUNT ? (uint16_t)cmd->arg_i[0] : 0u;
}

static kc_answer_t bad_kind(const kc_cmd_t *cmd, kc_out_t *out)
{
    return bad_arg(out, 0, (double)cmd->arg_i[0], (double)(KC_TBL_COUNT - 1));
}

/* Whether the staged table, decoded, goes with the keys. */
static kc_answer_t check_holders(const kc_cmd_log_t *log, const kc_tables_t *tables, uint16_t kind,
                                 kc_out_t *out)
{
    if (kind != (uint16_t)KC_TBL_CONFIG) { return kc_answer_ok(KC_OC_STAY); }
    return kc_holder_possible(&tables->scratch->config, &log->keys, out);
}

kc_answer_t kc_cmd_validate(kc_cmd_log_t *log, kc_tables_t *tables, const kc_cmd_t *cmd, kc_out_t *out)
{
    uint32_t mark = out->events.n;
    uint16_t kind = kind_of(cmd);
    if (kind == 0u) { return bad_kind(cmd, out); }
    kc_status_t st = kc_tbl_validate(tables, kind, (uint32_t)cmd->arg_i[1], &out->events);
    if (st != KC_OK) { return kc_answer_by(st, &out->events, mark, KC_OC_STAY); }
    log->validated_key = cmd->auth.key_id;
    return check_holders(log, tables, kind, out);
}

/* By whom a table may be put in force. With one holder left the rule cannot be met, and not be ended either. */
static kc_answer_t check_second(const kc_cmd_log_t *log, const kc_tables_t *tables, uint16_t kind,
                                const kc_cmd_t *cmd, kc_out_t *out)
{
    bool two = kind == (uint16_t)KC_TBL_KIN || kind == (uint16_t)KC_TBL_CONFIG;
    if (!two || !kc_holder_two(&log->keys)) { return kc_answer_ok(KC_OC_STAY); }
    return kc_holder_second(&tables->active.config, log->validated_key, cmd, out);
}

kc_answer_t kc_cmd_activate(const kc_cmd_log_t *log, kc_tables_t *tables, const kc_cmd_t *cmd, kc_out_t *out)
{
    uint32_t mark = out->events.n;
    uint16_t kind = kind_of(cmd);
    if (kind == 0u) { return bad_kind(cmd, out); }
    kc_status_t st = kc_tbl_ready(tables, kind, (uint32_t)cmd->arg_i[1], &out->events);
    if (st != KC_OK) { return kc_answer_by(st, &out->events, mark, KC_OC_STAY); }
    kc_answer_t answer = check_holders(log, tables, kind, out);
    if (answer.status == KC_OK) { answer = check_second(log, tables, kind, cmd, out); }
    return answer.status == KC_OK ? kc_answer_ok(KC_OC_STORE) : answer;
}

static bool admit_chunk(kc_cmd_log_t *log, const kc_view_t *view, const kc_table_chunk_t *chunk,
                        kc_out_t *out)
{
    uint8_t head[KC_SIGNED_HEAD_MAX];
    if (!known_source(chunk->source)) { return unknown_source(chunk->source, out).status == KC_OK; }
    kc_auth_text_t text = kc_signed_chunk(chunk, head);
    kc_answer_t answer = by_signature(log, view, KC_SIGNED_CHUNK, chunk->source, &chunk->auth, chunk->t_us,
                                      &text, out);
    return answer.status == KC_OK;
}

void kc_cmd_chunk(kc_cmd_log_t *log, kc_tables_t *tables, const kc_view_t *view,
                  const kc_table_chunk_t *chunk, kc_out_t *out)
{
    if (!admit_chunk(log, view, chunk, out)) { return; }
    if ((KC_CMD_FREE >> view->place->state & 1u) == 0u) {
        (void)kc_cmd_busy(view, out);
    } else if (chunk->kind < 1 || chunk->kind >= (int32_t)KC_TBL_COUNT) {
        kc_event(&out->events, KC_EVT_TBL_FORMAT, 1, (double)chunk->kind, (double)(KC_TBL_COUNT - 1));
    } else {
        (void)kc_tbl_chunk(tables, (uint16_t)chunk->kind, chunk->total, chunk->offset, chunk->data, chunk->n,
                           &out->events);
    }
}
