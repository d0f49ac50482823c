/* PROPOSE: the correction, its statistics, the verdict; acceptance on board by the policy of CONFIG. */
#ifndef KC_PROPOSE_H
#define KC_PROPOSE_H

#include "kc_channels.h"
#include "kc_consider.h"
#include "kc_review.h"
#include "kc_verdict.h"
#include "kc_view.h"

/* Sums over observations and candidates; where they stand between two steps. */
typedef struct {
    uint32_t i_obs, i_cand; /* next ones */
    uint32_t n;             /* inliers summed */
    bool considered;        /* the sums over observations are evaluated */
    double pos2, rot2;      /* squared residuals with the table in force [m^2], [rad^2] */
    double chi2_before, chi2_after;
    double change2; /* squared changes of the tool position [m^2] */
    double camera_pos2, camera_rot2, lander_pos2, lander_rot2; /* squared errors by the camera chain */
    double chi2;          /* of the data, what the camera chain explains taken off */
    kc_verdict_fit_t fit; /* the same */
} kc_proposing_t;

/* PROPOSE begins. */
void kc_propose_begin(kc_proposing_t *proposing, kc_consider_t *chain);
/* chain: what the camera chain does to the estimate, memory of kc_arena.h.
 * STAY: goes on in the next step. DONE: no change; STORE: it is to be stored, and then put in force (*accepted) or
 * reviewed by the ground. */
kc_outcome_t kc_propose_run(kc_proposing_t *proposing, kc_consider_t *chain, kc_review_t *review,
                            const kc_tables_t *tables, const kc_view_t *view, bool *accepted, kc_work_t *work,
                            kc_out_t *out);

#endif
