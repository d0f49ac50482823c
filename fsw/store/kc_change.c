#include "kc_change.h"

#include <string.h>

#include "kc_storing.h"

void kc_change_begin(kc_change_t *change, kc_change_kind_t kind, const kc_view_t *view, const kc_cmd_t *cmd)
{
    bool failing = change->failing;
    memset(change, 0, sizeof *change);
    change->failing = failing;
    change->kind = kind;
    change->safe = view->place->state == KC_ST_SAFE;
    change->by_command = cmd != NULL;
    if (cmd != NULL) { change->cmd = *cmd; }
}

/* ---- what is asked of the edge ---- */

/* The correction in force becomes the one for rollback, the image the one in force. Copies of what is in force
 * now are the newest first, so that none of the writes hits the last copy of it. */
static void replace_kin(const kc_change_parts_t *parts, const uint8_t *image, uint32_t n, kc_journal_t *after,
                        kc_out_t *out)
{
    kc_journal_kin(parts->images, &parts->tables->active, out);
    if (parts->images->n_kin > 0u) {
        kc_journal_store(out, KC_STORE_PREV, parts->images->kin, parts->images->n_kin);
    }
    kc_journal_store(out, KC_TBL_KIN, image, n);
    after->prev_crc = after->kin_crc;
    after->kin_crc = kc_tbl_image_crc(image, n);
}

static void roll_back(const kc_change_parts_t *parts, kc_journal_t *after, kc_out_t *out)
{
    kc_journal_kin(parts->images, &parts->tables->active, out);
    kc_journal_store(out, KC_TBL_KIN, parts->images->prev, parts->images->n_prev);
    after->kin_crc = after->prev_crc;
    after->prev_crc = 0u;
}

static void forget_proposal(kc_journal_t *after)
{
    after->proposal_crc = 0u;
    after->proposal_verdict = (uint32_t)KC_VERDICT_NO_CHANGE;
}

/* Over the staged image, which is of no use any more. */
static void put_back(const kc_change_parts_t *parts, kc_out_t *out)
{
    const kc_active_t *a = &parts->tables->active;
    kc_staging_t *s = &parts->tables->staging;
    uint32_t n = 0u;
    kc_status_t st = KC_OK;
    if (a->crc[s->kind] != 0u) {
        st = kc_tbl_encode(s->kind, kc_tbl_active_ptr(a, s->kind), 0u, s->image, KC_IMAGE_MAX, &n);
    }
    if (st == KC_OK) {
        kc_journal_store(out, s->kind, s->image, n);
    } /* else no answer comes: it has failed */
}

static void request(const kc_change_t *change, const kc_change_parts_t *parts, kc_out_t *out)
{
    const kc_staging_t *s = &parts->tables->staging;
    const kc_review_t *r = parts->review;
    kc_journal_t after = parts->now;
    after.state = (uint32_t)KC_ST_IDLE;
    switch (change->kind) {
    case KC_CHANGE_PROPOSE:
        kc_journal_store(out, KC_STORE_PROPOSAL, r->image, r->n);
        after.state = (uint32_t)KC_ST_REVIEW;
        after.proposal_crc = kc_tbl_image_crc(r->image, r->n);
        after.proposal_verdict = r->verdict;
        break;
    case KC_CHANGE_ROLLBACK: roll_back(parts, &after, out); break;
    case KC_CHANGE_TABLE:
        if (change->safe) { after.state = (uint32_t)KC_ST_SAFE; }
        if (s->kind == KC_TBL_KIN) {
            replace_kin(parts, s->image, s->n, &after, out);
            break;
        }
        /* The journal names no other tables. It has the counter of the command, and is stored before what that
         * does. */
        kc_journal_write(parts->journal, &after, out);
        kc_journal_store(out, s->kind, s->image, s->n);
        return;
    case KC_CHANGE_PUT_BACK: put_back(parts, out); return;
    case KC_CHANGE_REJECT: forget_proposal(&after); break;
    default: /* APPROVE, ACCEPT */
        replace_kin(parts, r->image, r->n, &after, out);
        forget_proposal(&after);
        break;
    }
    kc_journal_write(parts->journal, &after, out);
}

void kc_change_run(kc_change_t *change, const kc_change_parts_t *parts, kc_out_t *out)
{
    if (parts->view->clock->now_us < change->due_us) { return; }
    request(change, parts, out);
    change->asked = true;
}

/* ---- the edge has answered ---- */

/* Tables that were dropped with it are deleted; should that fail, the next start refuses them. */
static kc_status_t activate(kc_tables_t *tables, kc_out_t *out)
{
    kc_active_t *a = &tables->active;
    const kc_staging_t *s = &tables->staging;
    uint32_t before[KC_TBL_COUNT];
    memcpy(before, a->crc, sizeof before);
    kc_status_t st = kc_tbl_activate(tables, s->kind, kc_tbl_image_crc(s->image, s->n), &out->events);
    for (uint16_t k = 1u; k < KC_TBL_COUNT; k++) {
        if (before[k] != 0u && a->crc[k] == 0u) { kc_journal_store(out, k, s->image, 0u); }
    }
    return st;
}

static kc_status_t roll_back_now(const kc_change_parts_t *parts, kc_out_t *out)
{
    kc_status_t st = kc_tbl_rollback(parts->tables, &out->events);
    if (st == KC_OK) { kc_journal_store(out, KC_STORE_PREV, parts->images->prev, 0u); }
    return st;
}

static kc_status_t accept(const kc_change_t *change, const kc_change_parts_t *parts, kc_out_t *out)
{
    kc_status_t st = kc_review_activate(parts->review, parts->tables, out);
    if (st == KC_OK && change->kind == KC_CHANGE_ACCEPT) {
        kc_event(&out->events, KC_EVT_COR_ON_BOARD, -1, (double)parts->tables->active.crc[KC_TBL_KIN], 0.0);
    }
    return st;
}

/* Put in force what is stored; KC_ERR_* : it cannot be, and nothing has changed. */
static kc_status_t make(const kc_change_t *change, const kc_change_parts_t *parts, kc_out_t *out)
{
    kc_journal_again(parts->journal, 0u); /* a second copy of the record */
    switch (change->kind) {
    case KC_CHANGE_PROPOSE: kc_review_wait(parts->review, out); return KC_OK;
    case KC_CHANGE_REJECT: kc_review_drop(parts->review, out); return KC_OK;
    case KC_CHANGE_ROLLBACK: return roll_back_now(parts, out);
    case KC_CHANGE_TABLE: return activate(parts->tables, out);
    default: return accept(change, parts, out); /* APPROVE, ACCEPT */
    }
}

static kc_outcome_t back(const kc_change_t *change)
{
    return kc_outcome(change->safe ? KC_OC_SAFE : KC_OC_DONE);
}

static kc_outcome_t made(const kc_change_t *change)
{
    switch (change->kind) {
    case KC_CHANGE_PROPOSE: return kc_outcome(KC_OC_REVIEW);
    case KC_CHANGE_TABLE: return back(change);
    default: return kc_outcome(KC_OC_DONE);
    }
}

/* Everything stays as it was. A new correction waits for the ground in any case. */
static kc_outcome_t refuse(kc_change_t *change, const kc_change_parts_t *parts, kc_out_t *out)
{
    switch (change->kind) {
    case KC_CHANGE_ACCEPT:
        kc_change_begin(change, KC_CHANGE_PROPOSE, parts->view, NULL);
        return kc_outcome(KC_OC_STAY);
    case KC_CHANGE_PROPOSE: kc_review_wait(parts->review, out); return kc_outcome(KC_OC_REVIEW);
    case KC_CHANGE_APPROVE:
    case KC_CHANGE_REJECT: return kc_outcome(KC_OC_REVIEW);
    default: return back(change);
    }
}

static void answer(kc_change_t *change, kc_cmd_log_t *log, kc_status_t status, kc_event_id_t why,
                   kc_out_t *out)
{
    kc_answer_t a = {status, status == KC_OK ? KC_EVT_NONE : why, kc_outcome(KC_OC_STAY)};
    if (change->by_command) { kc_cmd_answer(log, &change->cmd, &a, out); }
    change->by_command = false;
}

static void report(kc_change_t *change, kc_status_t st, int32_t kind, kc_out_t *out)
{
    if (st != KC_OK && !change->failing) { kc_event(&out->events, KC_EVT_STORE_FAIL, kind, (double)st, 0.0); }
    change->failing = st != KC_OK;
}

static uint64_t retry_us(const kc_change_parts_t *parts)
{
    return parts->tables->active.config.store_retry_us;
}

/* Refused for good. What was to be put back is off all the same: the command is answered by what began it. */
static kc_outcome_t give_up(kc_change_t *change, const kc_change_parts_t *parts, kc_status_t st,
                            kc_event_id_t why, kc_out_t *out)
{
    bool putting_back = change->kind == KC_CHANGE_PUT_BACK;
    if (putting_back) { kc_tbl_discard(parts->tables, &out->events); }
    answer(change, parts->log, putting_back ? change->made : st, putting_back ? KC_EVT_CHANGE_FAILED : why,
           out);
    return refuse(change, parts, out);
}

/* Everything is stored: put in force, and answered by how that went. */
static kc_outcome_t finish(kc_change_t *change, const kc_change_parts_t *parts, kc_out_t *out)
{
    if (change->kind == KC_CHANGE_PUT_BACK) {
        return give_up(change, parts, change->made, KC_EVT_CHANGE_FAILED, out);
    }
    kc_status_t st = make(change, parts, out);
    if (st == KC_OK) {
        answer(change, parts->log, st, KC_EVT_NONE, out);
        return made(change);
    }
    uint16_t kind = change->kind == KC_CHANGE_TABLE ? parts->tables->staging.kind : (uint16_t)KC_TBL_KIN;
    kc_event(&out->events, KC_EVT_CHANGE_FAILED, (int32_t)kind, (double)st, 0.0);
    if (kind == KC_TBL_KIN) { return give_up(change, parts, st, KC_EVT_CHANGE_FAILED, out); }
    change->kind = KC_CHANGE_PUT_BACK;
    change->made = st;
    change->tries = 0u;
    change->due_us = parts->view->clock->now_us + 1u; /* this step has computed enough */
    return kc_outcome(KC_OC_STAY);
}

/* The next try, or the end, of a change that was asked for. */
static kc_outcome_t go_on(kc_change_t *change, const kc_change_parts_t *parts, kc_status_t st, int32_t kind,
                          kc_out_t *out)
{
    kc_outcome_t oc = kc_outcome(KC_OC_STAY);
    change->tries++;
    kc_storing_t next = kc_storing_next(st, change->tries, parts->tables->active.config.store_retries);
    if (next == KC_STORING_AGAIN) {
        change->due_us = parts->view->clock->now_us + retry_us(parts);
        return oc;
    }
    if (next == KC_STORING_REFUSE) {
        kc_event(&out->events, KC_EVT_STORE_REFUSED, kind, (double)st, (double)change->tries);
    }
    oc = next == KC_STORING_DONE ? finish(change, parts, out)
                                 : give_up(change, parts, st, KC_EVT_STORE_REFUSED, out);
    if (oc.id != KC_OC_STAY) { change->kind = KC_CHANGE_NONE; }
    return oc;
}

kc_outcome_t kc_change_stored(kc_change_t *change, const kc_change_parts_t *parts, const kc_in_t *in,
                              kc_out_t *out)
{
    bool asked = change->asked, answered = in->has_store_result != 0u;
    kc_status_t st = answered ? (kc_status_t)in->store_status : KC_ERR_STATE;
    if (!asked && !answered) { return kc_outcome(KC_OC_STAY); }
    change->asked = false;
    report(change, st, (int32_t)in->store_kind, out);
    if (st != KC_OK) {
        kc_journal_again(parts->journal, parts->view->clock->now_us + (asked ? 0u : retry_us(parts)));
    }
    return asked ? go_on(change, parts, st, (int32_t)in->store_kind, out) : kc_outcome(KC_OC_STAY);
}

/* What was asked in this very step is not done yet. A table's own image is withdrawn; of a correction the journal's record
 * of this step, which follows, names the former one. */
static void withdraw(const kc_change_parts_t *parts, kc_out_t *out)
{
    uint32_t kept = 0u;
    for (uint32_t i = 0u; i < out->n_store; i++) {
        if (out->store[i].data != parts->tables->staging.image) { out->store[kept++] = out->store[i]; }
    }
    out->n_store = kept;
}

void kc_change_cancel(kc_change_t *change, const kc_change_parts_t *parts, kc_out_t *out)
{
    bool putting_back = change->kind == KC_CHANGE_PUT_BACK;
    answer(change, parts->log, KC_ERR_STATE, KC_EVT_CAL_ABORTED, out);
    if (!putting_back) {
        if (change->asked) { withdraw(parts, out); }
        change->kind = KC_CHANGE_NONE;
        change->asked = false;
        return;
    }
    if (!change->asked) { put_back(parts, out); }
    change->asked = true;
    change->safe = true;
    change->tries = parts->tables->active.config.store_retries; /* the last try: nothing waits in SAFE */
}
