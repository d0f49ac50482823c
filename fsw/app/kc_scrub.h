/* Memory is compared with its CRC while flight runs: active tables, the correction for rollback, and the
 * observations of the estimator. KC_SCRUB_BYTES of it a step, so that all of it is seen in about six seconds. */
#ifndef KC_SCRUB_H
#define KC_SCRUB_H

#include "kc_estimate.h"
#include "kc_states.h"
#include "kc_tables.h"

typedef struct {
    uint32_t part, at; /* where the next slice begins */
    uint32_t crc, seal; /* of the part up to there; its seal when it was begun */
    uint32_t n_obs, obs_seal; /* observations, and the CRC of them all */
    uint32_t lost;            /* bit per kind (bit 0: the correction for rollback) found changed */
} kc_scrub_t;

/* One slice. A part that has changed is in force no more (its CRC is 0 then) and named by an event; ABORT. */
kc_outcome_t kc_scrub_run(kc_scrub_t *scrub, kc_tables_t *tables, const kc_est_t *est, kc_events_t *ev);

#endif
