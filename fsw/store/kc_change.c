#include "kc_change.h"

#include <string.h>

#include "kc_storing.h"

void kc_change_begin(kc_change_t *c, kc_change_kind_t kind, const kc_view_t *v, const kc_cmd_t *cmd)
{
    bool failing = c->failing;
    memset(c, 0, sizeof *c);
    c->failing = failing;
    c->kind = kind;
    c->safe = v->place->state == KC_ST_SAFE;
    c->by_command = cmd != NULL;
    if (cmd != NULL) { c->cmd = *cmd; }
}

/* ---- what is asked of the edge ---- */

/* The correction in force becomes the one for rollback, the image the one in force. Copies of what is in force
 * now are the newest first, so that none of the writes hits the last copy of it. */
static void replace_kin(const kc_change_parts_t *p, const uint8_t *image, uint32_t n, kc_journal_t *after,
                        kc_out_t *out)
{
    kc_journal_kin(p->images, &p->tables->active, out);
    if (p->images->n_kin > 0u) { kc_journal_store(out, KC_STORE_PREV, p->images->kin, p->images->n_kin); }
    kc_journal_store(out, KC_TBL_KIN, image, n);
    after->prev_crc = after->kin_crc;
    after->kin_crc = kc_tbl_image_crc(image, n);
}

static void roll_back(const kc_change_parts_t *p, kc_journal_t *after, kc_out_t *out)
{
    kc_journal_kin(p->images, &p->tables->active, out);
    kc_journal_store(out, KC_TBL_KIN, p->images->prev, p->images->n_prev);
    after->kin_crc = after->prev_crc;
    after->prev_crc = 0u;
}

static void forget_proposal(kc_journal_t *after)
{
    after->proposal_crc = 0u;
    after->proposal_verdict = (uint32_t)KC_VERDICT_NO_CHANGE;
}

/* Over the staged image, which is of no use any more. */
static void put_back(const kc_change_parts_t *p, kc_out_t *out)
{
    const kc_active_t *a = &p->tables->active;
    kc_staging_t *s = &p->tables->staging;
    uint32_t n = 0u;
    kc_status_t st = KC_OK;
    if (a->crc[s->kind] != 0u) {
        st = kc_tbl_encode(s->kind, kc_tbl_active_ptr(a, s->kind), 0u, s->image, KC_IMAGE_MAX, &n);
    }
    if (st == KC_OK) {
        kc_journal_store(out, s->kind, s->image, n);
    } /* else no answer comes: it has failed */
}

static void request(const kc_change_t *c, const kc_change_parts_t *p, kc_out_t *out)
{
    const kc_staging_t *s = &p->tables->staging;
    const kc_review_t *r = p->review;
    kc_journal_t after = p->now;
    after.state = (uint32_t)KC_ST_IDLE;
    switch (c->kind) {
    case KC_CHANGE_PROPOSE:
        kc_journal_store(out, KC_STORE_PROPOSAL, r->image, r->n);
        after.state = (uint32_t)KC_ST_REVIEW;
        after.proposal_crc = kc_tbl_image_crc(r->image, r->n);
        after.proposal_verdict = r->verdict;
        break;
    case KC_CHANGE_ROLLBACK: roll_back(p, &after, out); break;
    case KC_CHANGE_TABLE:
        if (c->safe) { after.state = (uint32_t)KC_ST_SAFE; }
        if (s->kind == KC_TBL_KIN) {
            replace_kin(p, s->image, s->n, &after, out);
            break;
        }
        /* The journal names no other tables. It has the counter of the command, and is stored before what that
         * does. */
        kc_journal_write(p->journal, &after, out);
        kc_journal_store(out, s->kind, s->image, s->n);
        return;
    case KC_CHANGE_PUT_BACK: put_back(p, out); return;
    case KC_CHANGE_REJECT: forget_proposal(&after); break;
    default: /* APPROVE, ACCEPT */
        replace_kin(p, r->image, r->n, &after, out);
        forget_proposal(&after);
        break;
    }
    kc_journal_write(p->journal, &after, out);
}

void kc_change_run(kc_change_t *c, const kc_change_parts_t *p, kc_out_t *out)
{
    if (p->view->clock->now_us < c->due_us) { return; }
    request(c, p, out);
    c->asked = true;
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

static kc_status_t roll_back_now(const kc_change_parts_t *p, kc_out_t *out)
{
    kc_status_t st = kc_tbl_rollback(p->tables, &out->events);
    if (st == KC_OK) { kc_journal_store(out, KC_STORE_PREV, p->images->prev, 0u); }
    return st;
}

static kc_status_t accept(const kc_change_t *c, const kc_change_parts_t *p, kc_out_t *out)
{
    kc_status_t st = kc_review_activate(p->review, p->tables, out);
    if (st == KC_OK && c->kind == KC_CHANGE_ACCEPT) {
        kc_event(&out->events, KC_EVT_COR_ON_BOARD, -1, (double)p->tables->active.crc[KC_TBL_KIN], 0.0);
    }
    return st;
}

/* Put in force what is stored; KC_ERR_* : it cannot be, and nothing has changed. */
static kc_status_t make(const kc_change_t *c, const kc_change_parts_t *p, kc_out_t *out)
{
    kc_journal_again(p->journal, 0u); /* a second copy of the record */
    switch (c->kind) {
    case KC_CHANGE_PROPOSE: kc_review_wait(p->review, out); return KC_OK;
    case KC_CHANGE_REJECT: kc_review_drop(p->review, out); return KC_OK;
    case KC_CHANGE_ROLLBACK: return roll_back_now(p, out);
    case KC_CHANGE_TABLE: return activate(p->tables, out);
    default: return accept(c, p, out); /* APPROVE, ACCEPT */
    }
}

static kc_outcome_t back(const kc_change_t *c) { return kc_outcome(c->safe ? KC_OC_SAFE : KC_OC_DONE); }

static kc_outcome_t made(const kc_change_t *c)
{
    switch (c->kind) {
    case KC_CHANGE_PROPOSE: return kc_outcome(KC_OC_REVIEW);
    case KC_CHANGE_TABLE: return back(c);
    default: return kc_outcome(KC_OC_DONE);
    }
}

/* Everything stays as it was. A new correction waits for the ground in any case. */
static kc_outcome_t refuse(kc_change_t *c, const kc_change_parts_t *p, kc_out_t *out)
{
    switch (c->kind) {
    case KC_CHANGE_ACCEPT:
        kc_change_begin(c, KC_CHANGE_PROPOSE, p->view, NULL);
        return kc_outcome(KC_OC_STAY);
    case KC_CHANGE_PROPOSE: kc_review_wait(p->review, out); return kc_outcome(KC_OC_REVIEW);
    case KC_CHANGE_APPROVE:
    case KC_CHANGE_REJECT: return kc_outcome(KC_OC_REVIEW);
    default: return back(c);
    }
}

static void answer(kc_change_t *c, kc_cmd_log_t *log, kc_status_t status, kc_event_id_t why, kc_out_t *out)
{
    kc_answer_t a = {status, status == KC_OK ? KC_EVT_NONE : why, kc_outcome(KC_OC_STAY)};
    if (c->by_command) { kc_cmd_answer(log, &c->cmd, &a, out); }
    c->by_command = false;
}

static void report(kc_change_t *c, kc_status_t st, int32_t kind, kc_out_t *out)
{
    if (st != KC_OK && !c->failing) { kc_event(&out->events, KC_EVT_STORE_FAIL, kind, (double)st, 0.0); }
    c->failing = st != KC_OK;
}

static uint64_t retry_us(const kc_change_parts_t *p) { return p->tables->active.config.store_retry_us; }

/* Refused for good. What was to be put back is off all the same: the command is answered by what began it. */
static kc_outcome_t give_up(kc_change_t *c, const kc_change_parts_t *p, kc_status_t st, kc_event_id_t why,
                            kc_out_t *out)
{
    bool putting_back = c->kind == KC_CHANGE_PUT_BACK;
    if (putting_back) { kc_tbl_discard(p->tables, &out->events); }
    answer(c, p->log, putting_back ? c->made : st, putting_back ? KC_EVT_CHANGE_FAILED : why, out);
    return refuse(c, p, out);
}

/* Everything is stored: put in force, and answered by how that went. */
static kc_outcome_t finish(kc_change_t *c, const kc_change_parts_t *p, kc_out_t *out)
{
    if (c->kind == KC_CHANGE_PUT_BACK) { return give_up(c, p, c->made, KC_EVT_CHANGE_FAILED, out); }
    kc_status_t st = make(c, p, out);
    if (st == KC_OK) {
        answer(c, p->log, st, KC_EVT_NONE, out);
        return made(c);
    }
    uint16_t kind = c->kind == KC_CHANGE_TABLE ? p->tables->staging.kind : (uint16_t)KC_TBL_KIN;
    kc_event(&out->events, KC_EVT_CHANGE_FAILED, (int32_t)kind, (double)st, 0.0);
    if (kind == KC_TBL_KIN) { return give_up(c, p, st, KC_EVT_CHANGE_FAILED, out); }
    c->kind = KC_CHANGE_PUT_BACK;
    c->made = st;
    c->tries = 0u;
    c->due_us = p->view->clock->now_us + 1u; /* this step has computed enough */
    return kc_outcome(KC_OC_STAY);
}

/* The next try, or the end, of a change that was asked for. */
static kc_outcome_t go_on(kc_change_t *c, const kc_change_parts_t *p, kc_status_t st, int32_t kind,
                          kc_out_t *out)
{
    kc_outcome_t oc = kc_outcome(KC_OC_STAY);
    c->tries++;
    kc_storing_t next = kc_storing_next(st, c->tries, p->tables->active.config.store_retries);
    if (next == KC_STORING_AGAIN) {
        c->due_us = p->view->clock->now_us + retry_us(p);
        return oc;
    }
    if (next == KC_STORING_REFUSE) {
        kc_event(&out->events, KC_EVT_STORE_REFUSED, kind, (double)st, (double)c->tries);
    }
    oc = next == KC_STORING_DONE ? finish(c, p, out) : give_up(c, p, st, KC_EVT_STORE_REFUSED, out);
    if (oc.id != KC_OC_STAY) { c->kind = KC_CHANGE_NONE; }
    return oc;
}

kc_outcome_t kc_change_stored(kc_change_t *c, const kc_change_parts_t *p, const kc_in_t *in, kc_out_t *out)
{
    bool asked = c->asked, answered = in->has_store_result != 0u;
    kc_status_t st = answered ? (kc_status_t)in->store_status : KC_ERR_STATE;
    if (!asked && !answered) { return kc_outcome(KC_OC_STAY); }
    c->asked = false;
    report(c, st, (int32_t)in->store_kind, out);
    if (st != KC_OK) { kc_journal_again(p->journal, p->view->clock->now_us + (asked ? 0u : retry_us(p))); }
    return asked ? go_on(c, p, st, (int32_t)in->store_kind, out) : kc_outcome(KC_OC_STAY);
}

/* What was asked in this very step is not done yet. A table's own image is withdrawn; of a correction the journal's record
 * of this step, which follows, names the former one. */
static void withdraw(const kc_change_parts_t *p, kc_out_t *out)
{
    uint32_t n = 0u;
    for (uint32_t i = 0u; i < out->n_store && i < KC_STORE_QUEUE_MAX; i++) {
        bool staged = out->store[i].n > 0u && out->store[i].data == p->tables->staging.image;
        if (!staged) { out->store[n++] = out->store[i]; }
    }
    out->n_store = n;
}

void kc_change_cancel(kc_change_t *c, const kc_change_parts_t *p, kc_out_t *out)
{
    bool putting_back = c->kind == KC_CHANGE_PUT_BACK;
    answer(c, p->log, KC_ERR_STATE, KC_EVT_CAL_ABORTED, out);
    if (!putting_back) {
        if (c->asked) { withdraw(p, out); }
        c->kind = KC_CHANGE_NONE;
        c->asked = false;
        return;
    }
    if (!c->asked) { put_back(p, out); }
    c->asked = true;
    c->safe = true;
    c->tries = p->tables->active.config.store_retries; /* the last try: nothing waits in SAFE */
}
