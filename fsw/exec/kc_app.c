#include <string.h>

#include "kc_app_priv.h"

kc_app_t kc_app_instance;

void kc_app_init(kc_app_t *app)
{
    memset(app, 0, sizeof *app);
    app->tables.scratch = &app->big.scratch;
    app->cal.candidate = -1;
    app->leg.seg_from = KC_NODE_NONE;
    app->leg.seg_to = KC_NODE_NONE;
    app->journal.candidate = -1;
    app->boot_state = -1;
    app->boot_pose = -1;
}

const kc_active_t *kc_app_active(const kc_app_t *app) { return &app->tables.active; }

kc_state_t kc_app_state(const kc_app_t *app) { return app->state; }

int kc_app_calibrating(const kc_app_t *app) { return app->state >= KC_ST_MOVE && app->state <= KC_ST_UPDATE; }

void kc_app_enter(kc_app_t *app, kc_state_t state)
{
    app->state = state;
    app->state_us = app->now_us;
    app->journal_due = 1u;
}

void kc_app_abort(kc_app_t *app, kc_out_t *out, kc_cause_t cause)
{
    int32_t pose = kc_app_calibrating(app) ? (int32_t)app->cal.n_meas : -1;
    kc_event(&out->events, KC_EVT_CAL_ABORTED, pose, (double)cause, 0.0);
    kc_move_hold(app, out);
    kc_propose_drop(app, out);
    app->observe.waiting = 0u;
    kc_app_enter(app, KC_ST_SAFE);
}

/* The correction for rollback. One that equals the active table remains when power is lost between the two
 * writes of an activation: then the older slot holds the right one. */
static kc_status_t load_prev(kc_app_t *app, const uint8_t *data, uint32_t n)
{
    kc_active_t *a = &app->tables.active;
    if (a->kin_prev_crc != 0u || kc_tbl_image_crc(data, n) == a->crc[KC_TBL_KIN]) { return KC_ERR_STATE; }
    return kc_tbl_load_prev(&app->tables, data, n, &app->boot_events);
}

static kc_status_t load_table(kc_app_t *app, uint16_t kind, const uint8_t *data, uint32_t n)
{
    uint32_t bit = 1u << kind;
    if ((app->loaded & bit) != 0u) { return KC_ERR_STATE; } /* a better one was loaded before */
    kc_status_t st = kc_tbl_load(&app->tables, kind, data, n, &app->boot_events);
    if (st == KC_OK) { app->loaded |= bit; }
    return st;
}

static kc_status_t load_any(kc_app_t *app, uint16_t kind, const uint8_t *data, uint32_t n)
{
    switch (kind) {
    case KC_STORE_JOURNAL: return kc_journal_load(app, data, n);
    case KC_STORE_PREV: return load_prev(app, data, n);
    case KC_STORE_PROPOSAL: return kc_propose_load(app, data, n);
    default: return kind < KC_TBL_COUNT ? load_table(app, kind, data, n) : KC_ERR_ARG;
    }
}

kc_status_t kc_app_load(kc_app_t *app, uint16_t kind, const uint8_t *data, uint32_t n)
{
    kc_status_t st = load_any(app, kind, data, n);
    if (st != KC_OK && st != KC_ERR_STATE) { /* STATE: not needed, or reported by TBL_DEPENDS */
        kc_event(&app->boot_events, KC_EVT_BOOT_SLOT_BAD, (int32_t)kind, (double)st, 0.0);
    }
    return st;
}

/* Compare the journal with what was found. */
static void boot_state(kc_app_t *app)
{
    const kc_journal_t *j = &app->journal;
    kc_events_t *ev = &app->boot_events;
    int lost = j->state >= KC_ST_MOVE && j->state <= KC_ST_UPDATE;
    if (app->proposal_crc != 0u) {
        kc_event(ev, KC_EVT_BOOT_REVIEW, -1, (double)app->proposal_crc, 0.0);
        app->state = KC_ST_REVIEW;
        lost = 0;
    } else if (j->state == KC_ST_REVIEW || j->state == KC_ST_ARMED) {
        /* approved, but stopped before the journal was written; or both copies are lost */
        if (j->proposal_crc == app->tables.active.crc[KC_TBL_KIN]) {
            kc_event(ev, KC_EVT_COR_ACTIVE, -1, (double)j->proposal_crc, 0.0);
        } else {
            lost = 1;
        }
    } else if (lost || j->state == KC_ST_SAFE) {
        app->state = KC_ST_SAFE;
    }
    if (lost) { kc_event(ev, KC_EVT_BOOT_INTERRUPTED, -1, (double)j->state, (double)j->pose); }
    if (j->state != KC_ST_IDLE) {
        app->boot_state = (int32_t)j->state;
        app->boot_pose = (int32_t)j->pose;
    }
}

void kc_app_boot(kc_app_t *app)
{
    app->boot_count = app->journal.boot_count + 1u;
    app->session = app->journal.session;
    app->leg.seg_from = app->journal.seg_from;
    app->leg.seg_to = app->journal.seg_to;
    kc_event(&app->boot_events, KC_EVT_BOOT, (int32_t)app->boot_count, 0.0, 0.0);
    for (uint16_t kind = 1u; kind < KC_TBL_COUNT; kind++) {
        if (app->tables.active.crc[kind] == 0u) {
            kc_event(&app->boot_events, KC_EVT_TBL_MISSING, (int32_t)kind, 0.0, 0.0);
        }
    }
    boot_state(app);
    /* Sequence numbers of outgoing messages are above those of the last run. */
    int32_t base = (int32_t)(app->boot_count % 20000u) * 100000;
    app->arm_seq = base;
    app->pantilt_seq = base;
    app->hk_seq = base;
    app->observe.frame_seq = base;
    app->journal_due = 1u;
}

uint64_t kc_app_elapsed(const kc_app_t *app, uint64_t stamp_us)
{
    if (stamp_us > app->clock_us) {
        uint64_t ahead = stamp_us - app->clock_us;
        return ahead > UINT64_MAX - app->now_us ? UINT64_MAX : app->now_us + ahead;
    }
    uint64_t age = app->clock_us - stamp_us;
    return age > app->now_us ? 0u : app->now_us - age;
}

/* Elapsed time goes on whatever the clock does: where that stands still or steps, a step of the process
 * counts as one tick, so that silence and time-outs are noticed. */
static void take_time(kc_app_t *app, uint64_t clock_us, kc_out_t *out)
{
    int back = clock_us < app->clock_us;
    uint64_t passed = back ? 0u : clock_us - app->clock_us;
    if (back || passed > KC_CLOCK_GAP_US) {
        kc_event(&out->events, KC_EVT_TIME_STEP, -1, (double)clock_us, (double)app->clock_us);
        passed = 0u;
    }
    app->now_us += passed > 0u ? passed : KC_TICK_US;
    app->clock_us = clock_us;
}

/* One state's work; 1 if another state may go on in the same step. */
static int run_state(kc_app_t *app, kc_out_t *out)
{
    switch (app->state) {
    case KC_ST_MOVE: return kc_move_run(app, out);
    case KC_ST_AIM: return kc_move_aim(app, out);
    case KC_ST_SETTLE: return kc_move_settled(app, out);
    case KC_ST_OBSERVE: return kc_observe_run(app, out);
    case KC_ST_SERVO: return kc_observe_servo(app, out);
    case KC_ST_SEARCH: return kc_observe_search(app, out);
    case KC_ST_MEASURE: return kc_measure_run(app, out);
    case KC_ST_UPDATE: return kc_update_run(app, out);
    case KC_ST_ARMED: return kc_propose_expire(app, out);
    default: return 0; /* IDLE, REVIEW and SAFE wait for commands */
    }
}

static void first_step(kc_app_t *app, uint64_t clock_us, kc_out_t *out)
{
    out->events = app->boot_events;
    app->stepped = 1u;
    app->now_us = clock_us;
    app->clock_us = clock_us;
    app->hk_us = clock_us;
    if (app->state == KC_ST_SAFE) { kc_move_hold(app, out); }
}

void kc_app_step(kc_app_t *app, uint64_t now_us, const kc_in_t *in, kc_out_t *out)
{
    memset(out, 0, sizeof *out);
    if (app->stepped) {
        take_time(app, now_us, out);
    } else {
        first_step(app, now_us, out);
    }
    kc_input_take(app, in, out);
    kc_cmd_take(app, in, out);
    kc_input_check_silence(app, out);
    kc_update_budget(app, out);
    for (uint32_t i = 0u; i < KC_CHAIN_MAX && run_state(app, out); i++) {}
    kc_cmd_dump(app, out);
    kc_journal_note(app, out);
    kc_hk_run(app, out);
}
