/* Commands and their answers, table chunks, dumps. */
#include <string.h>

#include "kc_app_priv.h"

kc_status_t kc_cmd_refuse(kc_app_t *app, kc_out_t *out, kc_event_id_t id, int32_t index, double got,
                          double want, kc_status_t st)
{
    kc_event(&out->events, id, index, got, want);
    app->ack->event_id = (int32_t)id;
    return st;
}

/* Tables change only while nothing depends on them. */
static int tables_free(const kc_app_t *app) { return app->state == KC_ST_IDLE || app->state == KC_ST_SAFE; }

static kc_status_t not_now(kc_app_t *app, kc_out_t *out, const kc_cmd_t *c)
{
    return kc_cmd_refuse(app, out, KC_EVT_CMD_STATE, c->opcode, (double)app->state, 0.0, KC_ERR_STATE);
}

static kc_status_t bad_arg(kc_app_t *app, kc_out_t *out, int32_t index, double got, double most)
{
    return kc_cmd_refuse(app, out, KC_EVT_CMD_ARG, index, got, most, KC_ERR_ARG);
}

static kc_status_t busy(kc_app_t *app, kc_out_t *out)
{
    return kc_cmd_refuse(app, out, KC_EVT_TBL_BUSY, -1, (double)app->state, 0.0, KC_ERR_STATE);
}

/* ---- START ---- */

static kc_status_t start_tables(kc_app_t *app, kc_out_t *out)
{
    for (uint16_t kind = 1u; kind < KC_TBL_COUNT; kind++) {
        if (app->tables.active.crc[kind] == 0u) {
            return kc_cmd_refuse(app, out, KC_EVT_TBL_MISSING, kind, 0.0, 0.0, KC_ERR_STATE);
        }
    }
    return KC_OK;
}

/* Arm and pan-tilt unit send state and the arm has no fault. */
static kc_status_t start_alive(kc_app_t *app, kc_out_t *out)
{
    uint64_t ago[2] = {app->now_us - app->arm_ok_us, app->now_us - app->pantilt_ok_us};
    uint8_t known[2] = {app->has_arm, app->has_pantilt};
    for (int32_t i = 0; i < 2; i++) {
        if (known[i] && ago[i] <= KC_SILENT_US) { continue; }
        return kc_cmd_refuse(app, out, KC_EVT_IN_SILENT, KC_INPUT_ARM + i, (double)ago[i],
                             (double)KC_SILENT_US, KC_ERR_STATE);
    }
    if (app->arm.fault_mask == 0) { return KC_OK; }
    return kc_cmd_refuse(app, out, KC_EVT_ARM_FAULT, -1, (double)app->arm.fault_mask, 0.0, KC_ERR_STATE);
}

static uint64_t coefs(const kc_terms_t *t)
{
    uint64_t mask = 0u;
    for (uint32_t c = 0u; c < t->n_coef; c++) { mask |= t->coef[c].enabled ? (uint64_t)1u << c : 0u; }
    return mask;
}

static kc_status_t start(kc_app_t *app, kc_out_t *out, const kc_cmd_t *c)
{
    const kc_active_t *a = &app->tables.active;
    if (!tables_free(app)) { return not_now(app, out, c); }
    if (out->n_store > 0u) { return busy(app, out); } /* an image still has to be stored */
    kc_status_t st = start_tables(app, out);
    if (st == KC_OK) { st = start_alive(app, out); }
    if (st != KC_OK) { return st; }
    if (c->arg_i[0] < -1 || c->arg_i[0] > (int32_t)KC_ACQ_VOPT) {
        return bad_arg(app, out, 0, (double)c->arg_i[0], (double)KC_ACQ_VOPT);
    }
    if (c->arg_i[1] < 0 || c->arg_i[1] > (int32_t)KC_MEAS_MAX) {
        return bad_arg(app, out, 1, (double)c->arg_i[1], (double)KC_MEAS_MAX);
    }
    uint64_t can = coefs(&a->terms);
    uint64_t mask = c->arg_u64 != 0u ? c->arg_u64 : a->config.est.free_mask & can;
    if (mask == 0u || (mask & ~can) != 0u) { return bad_arg(app, out, 4, (double)mask, (double)can); }
    kc_acq_t acq = c->arg_i[0] < 0 ? (kc_acq_t)a->config.acquisition : (kc_acq_t)c->arg_i[0];
    uint32_t n = c->arg_i[1] == 0 ? a->config.n_poses : (uint32_t)c->arg_i[1];
    return kc_update_start(app, out, acq, n, (uint32_t)c->arg_i[2], mask);
}

/* ---- tables ---- */

/* Whether a command names a kind of table at all: the numbers of kinds have 16 bits, arguments 32. */
static int kind_ok(const kc_cmd_t *c) { return c->arg_i[0] >= 1 && c->arg_i[0] < (int32_t)KC_TBL_COUNT; }

static kc_status_t bad_kind(kc_app_t *app, kc_out_t *out, const kc_cmd_t *c)
{
    return bad_arg(app, out, 0, (double)c->arg_i[0], (double)(KC_TBL_COUNT - 1));
}

static kc_status_t validate(kc_app_t *app, kc_out_t *out, const kc_cmd_t *c)
{
    if (!tables_free(app)) { return busy(app, out); }
    if (!kind_ok(c)) { return bad_kind(app, out, c); }
    return kc_tbl_validate(&app->tables, (uint16_t)c->arg_i[0], (uint32_t)c->arg_i[1], &out->events);
}

/* Store what changed: the table itself, the correction if it went with it, and tables that were dropped. */
static void store_changes(kc_app_t *app, kc_out_t *out, uint16_t kind, uint32_t n,
                          const uint32_t before[KC_TBL_COUNT], uint32_t prev_before)
{
    const kc_active_t *a = &app->tables.active;
    if (kind != KC_TBL_KIN) { kc_journal_store(out, kind, app->tables.staging.image, n); }
    for (uint16_t k = 1u; k < KC_TBL_COUNT; k++) {
        if (before[k] != 0u && a->crc[k] == 0u) { kc_journal_store(out, k, app->tables.staging.image, 0u); }
    }
    if (kind == KC_TBL_KIN || a->crc[KC_TBL_KIN] != before[KC_TBL_KIN] || a->kin_prev_crc != prev_before) {
        kc_journal_kin(app, out);
    }
}

static kc_status_t activate(kc_app_t *app, kc_out_t *out, const kc_cmd_t *c)
{
    uint32_t before[KC_TBL_COUNT], prev = app->tables.active.kin_prev_crc;
    uint32_t n = app->tables.staging.total; /* its bytes stay in place until the next chunk */
    if (!tables_free(app)) { return busy(app, out); }
    if (!kind_ok(c)) { return bad_kind(app, out, c); }
    memcpy(before, app->tables.active.crc, sizeof before);
    kc_status_t st = kc_tbl_activate(&app->tables, (uint16_t)c->arg_i[0], (uint32_t)c->arg_i[1],
                                     &out->events);
    if (st != KC_OK) { return st; }
    store_changes(app, out, (uint16_t)c->arg_i[0], n, before, prev);
    app->journal_due = 1u;
    return KC_OK;
}

static kc_status_t discard(kc_app_t *app, kc_out_t *out)
{
    if (!tables_free(app)) { return busy(app, out); }
    kc_tbl_discard(&app->tables, &out->events);
    return KC_OK;
}

static kc_status_t dump(kc_app_t *app, kc_out_t *out, const kc_cmd_t *c)
{
    int32_t kind = c->arg_i[0];
    int table = kind_ok(c);
    if (!table && kind != (int32_t)KC_STORE_PROPOSAL) { return bad_kind(app, out, c); }
    if (table ? app->tables.active.crc[kind] == 0u : app->proposal_crc == 0u) {
        return kc_cmd_refuse(app, out, KC_EVT_TBL_MISSING, kind, 0.0, 0.0, KC_ERR_STATE);
    }
    app->dump_kind = (uint16_t)kind; /* a new dump replaces the current one */
    app->dump_at = 0u;
    return KC_OK;
}

/* Bytes [at, at + chunk) of the dumped image; returns its whole size. */
static uint32_t dump_bytes(kc_app_t *app, uint8_t *data)
{
    uint32_t total = app->proposal_n;
    if (app->dump_kind == KC_STORE_PROPOSAL) {
        uint32_t left = total - app->dump_at;
        memcpy(data, &app->proposal_image[app->dump_at], left < KC_CHUNK_BYTES ? left : KC_CHUNK_BYTES);
    } else {
        (void)kc_tbl_encode(app->dump_kind, kc_tbl_active_ptr(&app->tables.active, app->dump_kind),
                            app->dump_at, data, KC_CHUNK_BYTES, &total);
    }
    return total;
}

/* The table can be gone or another one before its dump ended: what began is not continued then. */
void kc_cmd_dump(kc_app_t *app, kc_out_t *out)
{
    uint16_t kind = app->dump_kind;
    if (kind == 0u) { return; }
    uint32_t crc = kind == KC_STORE_PROPOSAL ? app->proposal_crc : app->tables.active.crc[kind];
    if (app->dump_at == 0u) { app->dump_crc = crc; }
    if (crc == 0u || crc != app->dump_crc) {
        kc_event(&out->events, KC_EVT_TBL_MISSING, (int32_t)kind, 0.0, 0.0);
        app->dump_kind = 0u;
        return;
    }
    uint32_t total = dump_bytes(app, out->dump.data);
    out->has_dump = 1u;
    out->dump.kind = (int32_t)kind;
    out->dump.total = total;
    out->dump.offset = app->dump_at;
    out->dump.n = total - app->dump_at < KC_CHUNK_BYTES ? total - app->dump_at : KC_CHUNK_BYTES;
    app->dump_at += out->dump.n;
    if (app->dump_at >= total) { app->dump_kind = 0u; }
}

static void take_chunk(kc_app_t *app, kc_out_t *out, const kc_chunk_t *c)
{
    if (!tables_free(app)) {
        kc_event(&out->events, KC_EVT_TBL_BUSY, -1, (double)app->state, 0.0);
        return;
    }
    if (c->kind < 1 || c->kind >= (int32_t)KC_TBL_COUNT) {
        kc_event(&out->events, KC_EVT_TBL_FORMAT, 1, (double)c->kind, (double)(KC_TBL_COUNT - 1));
        return;
    }
    (void)kc_tbl_chunk(&app->tables, (uint16_t)c->kind, c->total, c->offset, c->data, c->n, &out->events);
}

/* ---- dispatch ---- */

static kc_status_t in_review(kc_app_t *app, kc_out_t *out, const kc_cmd_t *c)
{
    uint32_t crc = (uint32_t)c->arg_i[0];
    int waits = app->state == KC_ST_REVIEW, armed = app->state == KC_ST_ARMED;
    if (c->opcode == KC_CMD_APPROVE_ARM && waits) { return kc_propose_arm(app, out, crc); }
    if (c->opcode == KC_CMD_APPROVE_GO && armed) { return kc_propose_go(app, out, crc); }
    if (c->opcode == KC_CMD_REJECT && (waits || armed)) { return kc_propose_reject(app, out, crc); }
    return not_now(app, out, c);
}

static kc_status_t rollback(kc_app_t *app, kc_out_t *out, const kc_cmd_t *c)
{
    if (!tables_free(app)) { return not_now(app, out, c); }
    return kc_propose_rollback(app, out, (uint32_t)c->arg_i[0]);
}

static kc_status_t execute(kc_app_t *app, kc_out_t *out, const kc_cmd_t *c)
{
    switch (c->opcode) {
    case KC_CMD_NOOP: return KC_OK;
    case KC_CMD_START: return start(app, out, c);
    case KC_CMD_ABORT: kc_app_abort(app, out, KC_CAUSE_COMMAND); return KC_OK;
    case KC_CMD_APPROVE_ARM:
    case KC_CMD_APPROVE_GO:
    case KC_CMD_REJECT: return in_review(app, out, c);
    case KC_CMD_ROLLBACK: return rollback(app, out, c);
    case KC_CMD_TABLE_VALIDATE: return validate(app, out, c);
    case KC_CMD_TABLE_ACTIVATE: return activate(app, out, c);
    case KC_CMD_TABLE_DISCARD: return discard(app, out);
    case KC_CMD_TABLE_DUMP: return dump(app, out, c);
    default: return kc_cmd_refuse(app, out, KC_EVT_CMD_UNKNOWN, -1, (double)c->opcode, 0.0, KC_ERR_ARG);
    }
}

/* A number follows the last one of its source if it lies within the window after it; numbers wrap. After a
 * silence any number outside the window counts, so that neither a wild number nor a sender that was started
 * again locks its source out; a number within the window behind is a repetition for ever. */
static int follows(const kc_app_t *app, uint32_t s, int32_t seq)
{
    if (!app->cmd_seen[s]) { return 1; }
    uint32_t ahead = (uint32_t)seq - (uint32_t)app->cmd_seq[s];
    uint32_t behind = (uint32_t)app->cmd_seq[s] - (uint32_t)seq;
    if (ahead > 0u && ahead <= KC_CMD_WINDOW) { return 1; }
    return behind > KC_CMD_WINDOW && app->now_us - app->cmd_us[s] > KC_CMD_RESYNC_US;
}

/* Source and sequence first; a number that is refused for another reason is used up. ABORT needs no number:
 * executed twice it does what it does once. */
static kc_status_t admit(kc_app_t *app, kc_out_t *out, const kc_cmd_t *c)
{
    if (c->source < 1 || c->source > (int32_t)KC_SOURCE_MAX) {
        return kc_cmd_refuse(app, out, KC_EVT_CMD_SOURCE, -1, (double)c->source, 0.0, KC_ERR_ARG);
    }
    uint32_t s = (uint32_t)c->source - 1u;
    if (follows(app, s, c->seq)) {
        app->cmd_seen[s] = 1u;
        app->cmd_seq[s] = c->seq;
        app->cmd_us[s] = app->now_us;
    } else if (c->opcode != KC_CMD_ABORT) {
        return kc_cmd_refuse(app, out, KC_EVT_CMD_STALE, c->source, (double)c->seq, (double)app->cmd_seq[s],
                             KC_ERR_STALE);
    }
    return execute(app, out, c);
}

static void take_cmd(kc_app_t *app, kc_out_t *out, const kc_cmd_t *c)
{
    kc_ack_t *ack = &out->ack[out->n_ack++];
    ack->source = c->source;
    ack->seq = c->seq;
    ack->opcode = c->opcode;
    app->ack = ack;
    ack->status = (int32_t)admit(app, out, c);
    if (ack->status == (int32_t)KC_OK) {
        kc_event(&out->events, KC_EVT_CMD_ACCEPTED, c->seq, (double)c->opcode, 0.0);
        app->n_cmd_ok++;
        return;
    }
    app->n_cmd_refused++;
    if (ack->event_id == 0 &&
        out->events.n > 0u) { /* refused by the tables: their first word is the reason */
        ack->event_id =
            (int32_t)out->events.e[app->ev_mark < out->events.n ? app->ev_mark : out->events.n - 1u].id;
    }
}

void kc_cmd_take(kc_app_t *app, const kc_in_t *in, kc_out_t *out)
{
    for (uint32_t i = 0u; i < in->n_chunk && i < KC_CHUNK_QUEUE_MAX; i++) {
        take_chunk(app, out, &in->chunk[i]);
    }
    for (uint32_t i = 0u; i < in->n_cmd && i < KC_CMD_QUEUE_MAX; i++) {
        app->ev_mark = out->events.n;
        take_cmd(app, out, &in->cmd[i]);
    }
}
