/* PROPOSE: the correction, its statistics, the verdict; acceptance on board by the policy of CONFIG. */
#ifndef KC_PROPOSE_H
#define KC_PROPOSE_H

#include "kc_app.h"
#include "kc_review.h"
#include "kc_view.h"

/* DONE: no change, or accepted on board and in force; REVIEW: it waits for the ground. */
kc_outcome_t kc_propose_run(kc_review_t *r, kc_tables_t *tables, kc_journal_images_t *images,
                            const kc_view_t *v, kc_out_t *out);

#endif
