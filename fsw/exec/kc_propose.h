/* PROPOSE: the correction, its statistics, the verdict; acceptance on board by the policy of CONFIG. */
#ifndef KC_PROPOSE_H
#define KC_PROPOSE_H

#include "kc_app.h"
#include "kc_review.h"
#include "kc_view.h"

/* DONE: no change; STORE: it is to be stored, and then put in force (*accepted) or reviewed by the ground. */
kc_outcome_t kc_propose_run(kc_review_t *r, const kc_tables_t *tables, const kc_view_t *v, bool *accepted,
                            kc_out_t *out);

#endif
