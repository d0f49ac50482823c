#include <string.h>

#include "kc_app_parts.h"
#include "kc_sequence.h"
#include "kc_storing.h"

#define TICK_US 100000u       /* what counts as elapsed where the clock stands still or steps */
#define CLOCK_GAP_US 2000000u /* a clock moved on by more was set; one behind by more is slow */

kc_app_t kc_app_instance;

/* ---- start ---- */

void kc_app_init(kc_app_t *app)
{
    memset(app, 0, sizeof *app);
    app->view = (kc_view_t){
        .clock = &app->clock,
        .place = &app->place,
        .tables = &app->tables.active,
        .telemetry = &app->input.telemetry,
        .cal = &app->cal,
        .plan = &app->plan,
        .latest = &app->latest,
        .est = &app->est,
        .servo_steps = &app->observe.servo_steps,
    };
    app->tables.scratch = &app->arena.idle.scratch;
    app->tables.staging.image = app->arena.idle.staged;
    app->cal.candidate = -1;
    app->move.seg_from = KC_NODE_NONE;
    app->move.seg_to = KC_NODE_NONE;
    app->journal.found.candidate = -1;
    app->boot_state = -1;
    app->boot_pose = -1;
}

void kc_app_keys(kc_app_t *app, const kc_keys_t *keys) { app->cmd_log.keys = *keys; }

const kc_active_t *kc_app_active(const kc_app_t *app) { return &app->tables.active; }

kc_state_t kc_app_state(const kc_app_t *app) { return app->place.state; }

bool kc_app_vouches_cmd(const kc_app_t *app, const kc_cmd_t *cmd, uint32_t *macs)
{
    return kc_cmd_vouches(&app->cmd_log, &app->view, cmd, macs);
}

bool kc_app_vouches_chunk(const kc_app_t *app, const kc_table_chunk_t *chunk, uint32_t *macs)
{
    return kc_cmd_vouches_chunk(&app->cmd_log, &app->view, chunk, macs);
}

/* Whether the journal knows what is in force. */
static bool journaled(const kc_app_t *app) { return app->journal.found.boot_count != 0u; }

/* One that equals the active table is of no use. Without a journal it is what remains when power is lost in
 * the middle of an activation: then the older slot holds the right one. */
static kc_status_t load_prev(kc_app_t *app, const uint8_t *data, uint32_t n)
{
    kc_active_t *a = &app->tables.active;
    uint32_t crc = kc_tbl_image_crc(data, n), named = app->journal.found.prev_crc;
    if (a->kin_prev_crc != 0u || crc == a->crc[KC_TBL_KIN]) { return KC_ERR_STATE; }
    if (!kc_storing_counts(journaled(app), named, crc)) { return KC_ERR_STATE; }
    return kc_tbl_load_prev(&app->tables, data, n, &app->boot_events);
}

static kc_status_t load_proposal(kc_app_t *app, const uint8_t *data, uint32_t n)
{
    uint32_t named = app->journal.found.proposal_crc, crc = kc_tbl_image_crc(data, n);
    if (!kc_storing_counts(journaled(app), named, crc)) { return KC_ERR_STATE; }
    uint32_t verdict = app->journal.found.proposal_verdict;
    return kc_review_load(&app->review, &app->tables, verdict, data, n, &app->boot_events);
}

static kc_status_t load_table(kc_app_t *app, uint16_t kind, const uint8_t *data, uint32_t n)
{
    uint32_t bit = 1u << kind;
    if ((app->loaded & bit) != 0u) { return KC_ERR_STATE; } /* a better one was loaded before */
    kc_status_t st = kc_tbl_load(&app->tables, kind, data, n, &app->boot_events);
    if (st == KC_OK) { app->loaded |= bit; }
    return st;
}

/* A correction that the journal does not name is kept, in case the right one is not found. */
static kc_status_t load_kin(kc_app_t *app, const uint8_t *data, uint32_t n)
{
    const kc_journal_t *j = &app->journal.found;
    uint32_t crc = kc_tbl_image_crc(data, n);
    bool named = kc_storing_counts(journaled(app) && j->kin_crc != 0u, j->kin_crc, crc);
    if (named || crc == 0u || n > KC_KIN_IMAGE_MAX) { return load_table(app, KC_TBL_KIN, data, n); }
    if (app->tables.active.crc[KC_TBL_KIN] != j->kin_crc && app->n_other == 0u) {
        memcpy(app->arena.idle.images.kin, data, n);
        app->n_other = n;
    }
    return KC_ERR_STATE;
}

/* All corrections were offered. */
static void settle_kin(kc_app_t *app)
{
    if (app->n_other > 0u && app->tables.active.crc[KC_TBL_KIN] != app->journal.found.kin_crc) {
        (void)load_table(app, KC_TBL_KIN, app->arena.idle.images.kin, app->n_other);
    }
    app->n_other = 0u;
}

static kc_status_t load_any(kc_app_t *app, uint16_t kind, const uint8_t *data, uint32_t n)
{
    if (kind == KC_TBL_KIN) { return load_kin(app, data, n); }
    if (kind > KC_TBL_KIN && kind != KC_STORE_JOURNAL) { settle_kin(app); }
    switch (kind) {
    case KC_STORE_JOURNAL: return kc_journal_load(&app->journal, data, n);
    case KC_STORE_PREV: return load_prev(app, data, n);
    case KC_STORE_PROPOSAL: return load_proposal(app, data, n);
    default: return kind < KC_TBL_COUNT ? load_table(app, kind, data, n) : KC_ERR_ARG;
    }
}

kc_status_t kc_app_load(kc_app_t *app, uint16_t kind, const uint8_t *data, uint32_t n)
{
    if (kind >= KC_TBL_COUNT) { app->kept = true; } /* only an earlier run leaves these */
    kc_status_t st = n > 0u ? load_any(app, kind, data, n) : KC_ERR_FORMAT; /* a copy that cannot be read */
    if (st != KC_OK && st != KC_ERR_STATE) { /* STATE: not needed, or reported by TBL_DEPENDS */
        kc_event(&app->boot_events, KC_EVT_BOOT_SLOT_BAD, (int32_t)kind, (double)st, 0.0);
    }
    return st;
}

uint8_t *kc_app_image_room(kc_app_t *app) { return app->tables.staging.image; }

/* Compare what the journal names with what was found. */
static void compare(const kc_app_t *app, kc_events_t *ev)
{
    const kc_journal_t *j = &app->journal.found;
    const kc_active_t *a = &app->tables.active;
    uint32_t kin = a->crc[KC_TBL_KIN];
    if (j->kin_crc != 0u && j->kin_crc != kin) {
        kc_event(ev, KC_EVT_BOOT_LOST, KC_TBL_KIN, (double)kin, (double)j->kin_crc);
    }
    if (j->prev_crc != 0u && j->prev_crc != a->kin_prev_crc && j->prev_crc != kin) {
        kc_event(ev, KC_EVT_BOOT_LOST, (int32_t)KC_STORE_PREV, (double)a->kin_prev_crc, (double)j->prev_crc);
    }
    if (j->proposal_crc != 0u && app->review.crc == 0u) {
        kc_event(ev, KC_EVT_BOOT_LOST, (int32_t)KC_STORE_PROPOSAL, 0.0, (double)j->proposal_crc);
    }
}

/* The state to begin in. */
static void boot_state(kc_app_t *app)
{
    const kc_journal_t *j = &app->journal.found;
    kc_events_t *ev = &app->boot_events;
    kc_state_t was = (kc_state_t)j->state;
    if (app->review.crc != 0u) {
        kc_event(ev, KC_EVT_BOOT_REVIEW, -1, (double)app->review.crc, 0.0);
        app->place.state = KC_ST_REVIEW;
    } else if (kc_states_calibrating(was) || was == KC_ST_SAFE || (app->kept && !journaled(app))) {
        app->place.state = KC_ST_SAFE; /* what it was doing may be lost with the journal: the arm is held */
    }
    if (kc_states_calibrating(was)) {
        kc_event(ev, KC_EVT_BOOT_INTERRUPTED, -1, (double)j->state, (double)j->pose);
    }
    if (was != KC_ST_IDLE) {
        app->boot_state = (int32_t)j->state;
        app->boot_pose = (int32_t)j->pose;
    }
}

/* Approvals may need two holders; the key file may have lost one since. */
static void check_holders(kc_app_t *app)
{
    const kc_keys_t *keys = &app->cmd_log.keys;
    if (app->tables.active.config.go_by_other_key == 0u || keys->n == 0u || kc_holder_two(keys)) { return; }
    kc_event(&app->boot_events, KC_EVT_KEYS_ONE_HOLDER, -1, (double)keys->n, 0.0);
}

void kc_app_boot(kc_app_t *app)
{
    const kc_journal_t *j = &app->journal.found;
    settle_kin(app);
    app->boot_count = j->boot_count + 1u;
    app->cal.session = j->session;
    app->cmd_log.counters = j->counters;
    kc_counters_begin(&app->cmd_log.counters, &app->cmd_log.keys);
    app->move.seg_from = j->seg_from;
    app->move.seg_to = j->seg_to;
    kc_event(&app->boot_events, KC_EVT_BOOT, (int32_t)app->boot_count, 0.0, 0.0);
    for (uint16_t kind = 1u; kind < KC_TBL_COUNT; kind++) {
        if (app->tables.active.crc[kind] == 0u) {
            kc_event(&app->boot_events, KC_EVT_TBL_MISSING, (int32_t)kind, 0.0, 0.0);
        }
    }
    if (app->cmd_log.keys.n == 0u) {
        kc_event(&app->boot_events, KC_EVT_BOOT_NO_KEYS, -1, 0.0, 0.0);
    } else if (!journaled(app)) {
        kc_event_id_t id = app->kept ? KC_EVT_BOOT_JOURNAL_LOST : KC_EVT_BOOT_NO_JOURNAL;
        kc_event(&app->boot_events, id, -1, 0.0, 0.0);
    }
    check_holders(app);
    compare(app, &app->boot_events);
    boot_state(app);
    /* Sequence numbers of outgoing messages are above those of the last run. */
    int32_t base = (int32_t)(app->boot_count % 20000u) * 100000;
    app->move.seq = base;
    app->pantilt.seq = base;
    app->hk.seq = base;
    kc_request_boot(&app->request, base);
}

/* ---- one step ---- */

/* A clock that advances, but hardly: once it is behind the steps by CLOCK_GAP_US, elapsed time makes up for it. */
static void keep_up(kc_clock_t *clock, uint64_t passed, kc_out_t *out)
{
    const uint64_t steps_us = clock->behind_us + TICK_US;
    clock->behind_us = steps_us > passed ? steps_us - passed : 0u;
    if (clock->behind_us <= CLOCK_GAP_US) { return; }
    kc_event(&out->events, KC_EVT_TIME_SLOW, -1, (double)clock->behind_us, 0.0);
    clock->now_us += clock->behind_us;
    clock->behind_us = 0u;
}

/* Elapsed time goes on whatever the clock does: where that stands still or steps, a step of the process
 * counts as one tick, so that silence and time-outs are noticed. */
static void take_time(kc_clock_t *clock, uint64_t clock_us, kc_out_t *out)
{
    bool back = clock_us < clock->clock_us;
    uint64_t passed = back ? 0u : clock_us - clock->clock_us;
    if (back || passed > CLOCK_GAP_US) {
        kc_event(&out->events, KC_EVT_TIME_STEP, -1, (double)clock_us, (double)clock->clock_us);
        passed = 0u;
    }
    passed = passed > 0u ? passed : TICK_US;
    clock->now_us += passed;
    keep_up(clock, passed, out);
    clock->clock_us = clock_us;
}

static void first_step(kc_app_t *app, uint64_t clock_us, kc_out_t *out)
{
    out->events = app->boot_events;
    app->stepped = true;
    app->clock = (kc_clock_t){clock_us, clock_us, 0u};
    app->hk.due_us = clock_us;
    if (app->place.state != KC_ST_SAFE) { return; }
    app->move.foreign = true; /* the arm may still follow the last run */
    kc_move_hold(&app->move, &app->view, out);
}

static void take_inputs(kc_app_t *app, kc_work_t *work, const kc_in_t *in, kc_out_t *out)
{
    app->n_rx_errors = in->n_rx_errors;
    kc_sequence_stored(app, work, in, out);
    kc_input_telemetry(&app->input, &app->view, in, out);
    kc_sequence_detections(app, work, in, out);
    kc_sequence_commands(app, work, in, out);
}

/* While a change is stored, the journal is part of it. */
static void note(kc_app_t *app, kc_out_t *out)
{
    if (app->place.state == KC_ST_STORE) { return; }
    kc_journal_t now = kc_sequence_record(app);
    kc_journal_note(&app->journal, &now, app->clock.now_us, out);
}

static void report_monitor(const kc_monitoring_t *monitoring, kc_hk_t *hk)
{
    const kc_mon_verdict_t *verdict = &monitoring->newest;
    bool named = verdict->state == KC_MON_NAMED || verdict->state == KC_MON_SEVERAL;
    hk->mon_state = (int32_t)verdict->state;
    hk->mon_joint = named ? (int32_t)verdict->joint + 1 : 0;
    hk->mon_suspects = verdict->suspects;
    hk->mon_n_obs = verdict->n_obs;
    hk->mon_bias = verdict->bias;
    hk->mon_sigma = verdict->sigma;
    hk->mon_p = verdict->p;
    memcpy(hk->mon_chance, monitoring->suspects.chance, sizeof hk->mon_chance);
}

static void report(const kc_app_t *app, kc_hk_t *hk)
{
    const kc_staging_t *s = &app->tables.staging;
    hk->state = (int32_t)app->place.state;
    hk->session = app->cal.session;
    hk->n_poses = app->plan.n_meas;
    hk->n_poses_goal = app->plan.n_goal;
    hk->candidate = app->cal.candidate;
    hk->servo_steps = app->observe.servo_steps;
    hk->n_rejected = app->input.n_rejected;
    hk->n_cmd_ok = app->cmd_log.n_ok;
    hk->n_cmd_refused = app->cmd_log.n_refused;
    hk->n_rx_errors = app->n_rx_errors;
    memcpy(hk->table_crc, app->tables.active.crc, sizeof hk->table_crc);
    hk->kin_prev_crc = app->tables.active.kin_prev_crc;
    hk->staged_state = (int32_t)s->state;
    hk->staged_kind = s->state == KC_STAGE_NONE ? 0 : (int32_t)s->kind;
    hk->staged_bytes = s->n;
    hk->boot_state = app->boot_state;
    hk->boot_pose = app->boot_pose;
    hk->boot_count = app->boot_count;
    hk->energy_j = app->cal.energy_j;
    report_monitor(&app->monitoring, hk);
    kc_review_report(&app->review, &app->view, hk);
}

void kc_app_step(kc_app_t *app, uint64_t now_us, const kc_in_t *in, kc_out_t *out)
{
    kc_work_t work = kc_work_of_step();
    memset(out, 0, sizeof *out);
    if (app->stepped) {
        take_time(&app->clock, now_us, out);
    } else {
        first_step(app, now_us, out);
    }
    kc_counters_clock(&app->cmd_log.counters, app->clock.clock_us);
    take_inputs(app, &work, in, out);
    kc_sequence_run(app, &work, out);
    kc_sequence_scrub(app, &work, out);
    kc_monitoring_evaluate(&app->monitoring, &app->arena.idle.monitor, &app->view, &work, out);
    kc_dump_run(&app->dump, &app->review, &app->view, &work, out);
    note(app, out);
    if (kc_hk_count(&app->hk, app->clock.now_us, out)) {
        out->has_hk = 1u;
        kc_hk_fill(&app->hk, &out->hk);
        report(app, &out->hk);
    }
}
