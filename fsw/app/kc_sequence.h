/* The sequencer: runs the state, takes its outcome, and goes where the table of kc_states.h says. */
#ifndef KC_SEQUENCE_H
#define KC_SEQUENCE_H

#include "kc_app.h"
#include "kc_journal.h"

/* The edge's answer to the store requests of the last step. */
void kc_sequence_stored(kc_app_t *app, kc_work_t *work, const kc_in_t *in, kc_out_t *out);
/* A slice of the memory is compared with its CRC. */
void kc_sequence_scrub(kc_app_t *app, kc_work_t *work, kc_out_t *out);
/* The journal's record of this step. */
kc_journal_t kc_sequence_record(const kc_app_t *app);
/* Commands and chunks of one step. */
void kc_sequence_commands(kc_app_t *app, kc_work_t *work, const kc_in_t *in, kc_out_t *out);
/* Detections of one step: to the calibration, or to the monitor. */
void kc_sequence_detections(kc_app_t *app, kc_work_t *work, const kc_in_t *in, kc_out_t *out);
/* Faults, silence, budgets; then the work of the state, and of those that follow in the same step, as far as
 * `work` goes. */
void kc_sequence_run(kc_app_t *app, kc_work_t *work, kc_out_t *out);

#endif
