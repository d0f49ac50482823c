/* The parts of the component, and how they are put together. Each part changes only its own data; only the
 * sequencer (kc_sequence.c) and the entry (kc_app.c) see all of them. */
#ifndef KC_APP_PARTS_H
#define KC_APP_PARTS_H

#include "kc_app.h"
#include "kc_arena.h"
#include "kc_change.h"
#include "kc_cmd.h"
#include "kc_dump.h"
#include "kc_frames.h"
#include "kc_hk.h"
#include "kc_input.h"
#include "kc_journal.h"
#include "kc_monitoring.h"
#include "kc_move.h"
#include "kc_observe.h"
#include "kc_pantilt.h"
#include "kc_propose.h"
#include "kc_request.h"
#include "kc_rest.h"
#include "kc_review.h"
#include "kc_scrub.h"
#include "kc_update.h"
#include "kc_view.h"

struct kc_app {
    kc_view_t view; /* of the parts, for all of them */
    kc_arena_t arena;

    kc_tables_t tables;
    kc_clock_t clock;
    kc_place_t place;
    kc_input_t input;
    kc_cmd_log_t cmd_log;
    kc_dump_t dump;

    /* the calibration */
    kc_cal_t cal;
    kc_plan_t plan;
    kc_latest_t latest;
    kc_update_t update;
    kc_est_t est;
    kc_evaluated_t evaluated;
    uint64_t rng;

    /* the current candidate */
    kc_move_t move;
    kc_pantilt_t pantilt;
    kc_rest_t rest;
    kc_request_t request;
    kc_observe_t observe;
    double q_meas[KC_JOINT_MAX]; /* joints at the measurement, after the approach */
    kc_frames_t frames;

    kc_review_t review;
    kc_monitoring_t monitoring;
    kc_hk_state_t hk;

    kc_journal_store_t journal;
    kc_change_t change;
    kc_scrub_t scrub;
    kc_events_t boot_events;
    uint32_t boot_count, loaded; /* loaded: bit per kind of table */
    uint32_t n_other; /* boot: bytes of a correction that the journal does not name, in the arena */
    int32_t boot_state, boot_pose;
    bool kept; /* boot: the store holds what only an earlier run can have left */
    uint32_t n_rx_errors;
    bool stepped;
};
_Static_assert(sizeof(struct kc_app) <= 840u * 1024u, "memory budget of the component");

#endif
