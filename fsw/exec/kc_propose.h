/* PROPOSE: the correction, its statistics, the verdict; acceptance on board by the policy of CONFIG. */
#ifndef KC_PROPOSE_H
#define KC_PROPOSE_H

#include "kc_app.h"
#include "kc_review.h"
#include "kc_view.h"

/* Sums over observations and candidates; where they stand between two steps. */
typedef struct {
    uint32_t i_obs, i_cand; /* next ones */
    uint32_t n;             /* inliers summed */
    double pos2, rot2;      /* squared residuals with the table in force [m^2], [rad^2] */
    double chi2_before, chi2_after;
    double change2; /* squared changes of the tool position [m^2] */
} kc_proposing_t;

/* PROPOSE begins. */
void kc_propose_begin(kc_proposing_t *j);
/* STAY: goes on in the next step. DONE: no change; STORE: it is to be stored, and then put in force (*accepted) or
 * reviewed by the ground. */
kc_outcome_t kc_propose_run(kc_proposing_t *j, kc_review_t *r, const kc_tables_t *tables, const kc_view_t *v,
                            bool *accepted, kc_work_t *work, kc_out_t *out);

#endif
