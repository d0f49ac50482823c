/* SELECT: the next candidate, or the end of the calibration; budgets. */
#ifndef KC_SELECT_H
#define KC_SELECT_H

#include "kc_channels.h"
#include "kc_choice.h"
#include "kc_cmd.h"
#include "kc_view.h"

/* A new session. */
void kc_select_start(kc_cal_t *cal, kc_plan_t *plan, const kc_view_t *view, const kc_start_t *ask,
                     kc_out_t *out);
/* SELECT begins. */
void kc_select_begin(kc_arena_calibration_t *arena);
/* STAY: goes on in the next step. DONE: cal->candidate is chosen; FINISH; ABORT: nothing was measured that a proposal
 * could use, or too few local initial poses showed a tag. AGAIN: the observations so far cast doubt (kc_local.h); the
 * calibration begins again, without them, with all local initial poses in the order of the table (kc_plan_by_table). */
kc_outcome_t kc_select_run(kc_cal_t *cal, kc_plan_t *plan, kc_arena_calibration_t *arena, uint64_t *rng,
                           const kc_view_t *view, kc_work_t *work, kc_out_t *out);
/* Skip the current candidate. */
void kc_select_skip(kc_plan_t *plan, const kc_view_t *view, kc_out_t *out);
/* Count energy; FINISH when time or energy is used up, ABORT if too little was measured by then. */
kc_outcome_t kc_select_budget(kc_cal_t *cal, const kc_view_t *view, kc_out_t *out);

#endif
