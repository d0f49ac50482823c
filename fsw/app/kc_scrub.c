#include "kc_scrub.h"

#include "kc_crc.h"
#include "kc_store.h"

/* Parts: 0 the correction for rollback, 1 to 7 the tables by kind, then the observations. */
#define PART_OBS ((uint32_t)KC_TBL_COUNT)
#define PART_N (PART_OBS + 1u)

typedef struct {
    const uint8_t *data;
    uint32_t n, seal;
} part_t;

/* n = 0: nothing is in force. */
static part_t part_of(const kc_scrub_t *scrub, const kc_active_t *active, const kc_est_t *est)
{
    uint32_t k = scrub->part;
    if (k == PART_OBS) {
        return (part_t){(const uint8_t *)est->obs, scrub->n_obs * (uint32_t)sizeof est->obs[0],
                        scrub->obs_seal};
    }
    uint32_t crc = k == 0u ? active->kin_prev_crc : active->crc[k];
    const void *data = k == 0u ? &active->kin_prev : kc_tbl_active_ptr(active, (uint16_t)k);
    return (part_t){data, crc != 0u ? kc_tbl_active_bytes((uint16_t)k) : 0u, active->seal[k]};
}

/* Observations only come, one at a time; a calibration begins without any. */
static void follow_obs(kc_scrub_t *scrub, const kc_est_t *est)
{
    if (est->n_obs < scrub->n_obs) { scrub->n_obs = scrub->obs_seal = 0u; }
    for (; scrub->n_obs < est->n_obs; scrub->n_obs++) {
        scrub->obs_seal = kc_crc32(scrub->obs_seal, &est->obs[scrub->n_obs], (uint32_t)sizeof est->obs[0]);
    }
}

/* What has changed must not be used again. */
static kc_outcome_t found(kc_scrub_t *scrub, kc_active_t *active, uint32_t part, kc_events_t *ev)
{
    if (part == PART_OBS) {
        kc_event(ev, KC_EVT_MEMORY_OBSERVATIONS, -1, (double)scrub->n_obs, 0.0);
        scrub->n_obs = scrub->obs_seal = 0u; /* sealed anew: one event for one change */
    } else {
        uint32_t *crc = part == 0u ? &active->kin_prev_crc : &active->crc[part];
        int32_t kind = part == 0u ? (int32_t)KC_STORE_PREV : (int32_t)part;
        kc_event(ev, KC_EVT_MEMORY_TABLE, kind, (double)*crc, 0.0);
        *crc = 0u;
        scrub->lost |= 1u << part;
    }
    return kc_abort_for(KC_CAUSE_MEMORY);
}

kc_outcome_t kc_scrub_run(kc_scrub_t *scrub, kc_tables_t *tables, const kc_est_t *est, kc_events_t *ev)
{
    follow_obs(scrub, est);
    part_t p = part_of(scrub, &tables->active, est);
    if (scrub->at == 0u) {
        scrub->crc = 0u;
        scrub->seal = p.seal;
    }
    if (scrub->at < p.n) {
        uint32_t left = p.n - scrub->at, n = left < KC_SCRUB_BYTES ? left : KC_SCRUB_BYTES;
        scrub->crc = kc_crc32(scrub->crc, &p.data[scrub->at], n);
        scrub->at += n;
        if (scrub->at < p.n) { return kc_outcome(KC_OC_STAY); }
    }
    /* A part that was replaced on the way is tested_early at the next time round. */
    bool whole = p.n > 0u && scrub->seal == p.seal;
    bool changed = whole && scrub->crc != p.seal;
    uint32_t part = scrub->part;
    scrub->part = (part + 1u) % PART_N;
    scrub->at = 0u;
    return changed ? found(scrub, &tables->active, part, ev) : kc_outcome(KC_OC_STAY);
}
