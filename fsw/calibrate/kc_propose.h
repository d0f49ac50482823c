/* PROPOSE: the correction, its statistics, the verdict; acceptance on board by the policy of CONFIG. */
#ifndef KC_PROPOSE_H
#define KC_PROPOSE_H

#include "kc_channels.h"
#include "kc_evaluation.h"
#include "kc_review.h"
#include "kc_view.h"

/* evaluated, evaluation: from kc_evaluation_begin on; memory of kc_arena.h.
 * STAY: goes on in the next step. DONE: no change; STORE: it is to be stored, and then put in force (*accepted) or
 * reviewed by the ground. */
kc_outcome_t kc_propose_run(kc_evaluated_t *evaluated, kc_evaluation_t *evaluation, kc_review_t *review,
                            const kc_tables_t *tables, const kc_view_t *view, bool *accepted, kc_work_t *work,
                            kc_out_t *out);

#endif
