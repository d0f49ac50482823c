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
static part_t part_of(const kc_scrub_t *s, const kc_active_t *a, const kc_est_t *est)
{
    uint32_t k = s->part;
    if (k == PART_OBS) {
        return (part_t){(const uint8_t *)est->obs, s->n_obs * (uint32_t)sizeof est->obs[0], s->obs_seal};
    }
    uint32_t crc = k == 0u ? a->kin_prev_crc : a->crc[k];
    const void *data = k == 0u ? &a->kin_prev : kc_tbl_active_ptr(a, (uint16_t)k);
    return (part_t){data, crc != 0u ? kc_tbl_active_bytes((uint16_t)k) : 0u, a->seal[k]};
}

/* Observations only come, one at a time; a calibration begins without any. */
static void follow_obs(kc_scrub_t *s, const kc_est_t *est)
{
    if (est->n_obs < s->n_obs) { s->n_obs = s->obs_seal = 0u; }
    for (; s->n_obs < est->n_obs; s->n_obs++) {
        s->obs_seal = kc_crc32(s->obs_seal, &est->obs[s->n_obs], (uint32_t)sizeof est->obs[0]);
    }
}

/* What has changed must not be used again. */
static kc_outcome_t found(kc_scrub_t *s, kc_active_t *a, uint32_t part, kc_events_t *ev)
{
    if (part == PART_OBS) {
        kc_event(ev, KC_EVT_MEMORY_OBSERVATIONS, -1, (double)s->n_obs, 0.0);
        s->n_obs = s->obs_seal = 0u; /* sealed anew: one event for one change */
    } else {
        uint32_t *crc = part == 0u ? &a->kin_prev_crc : &a->crc[part];
        int32_t kind = part == 0u ? (int32_t)KC_STORE_PREV : (int32_t)part;
        kc_event(ev, KC_EVT_MEMORY_TABLE, kind, (double)*crc, 0.0);
        *crc = 0u;
        s->lost |= 1u << part;
    }
    return kc_abort_for(KC_CAUSE_MEMORY);
}

kc_outcome_t kc_scrub_run(kc_scrub_t *s, kc_tables_t *tables, const kc_est_t *est, kc_events_t *ev)
{
    follow_obs(s, est);
    part_t p = part_of(s, &tables->active, est);
    if (s->at == 0u) {
        s->crc = 0u;
        s->seal = p.seal;
    }
    if (s->at < p.n) {
        uint32_t left = p.n - s->at, n = left < KC_SCRUB_BYTES ? left : KC_SCRUB_BYTES;
        s->crc = kc_crc32(s->crc, &p.data[s->at], n);
        s->at += n;
        if (s->at < p.n) { return kc_outcome(KC_OC_STAY); }
    }
    /* A part that was replaced on the way is looked at the next time round. */
    bool whole = p.n > 0u && s->seal == p.seal;
    bool changed = whole && s->crc != p.seal;
    uint32_t part = s->part;
    s->part = (part + 1u) % PART_N;
    s->at = 0u;
    return changed ? found(s, &tables->active, part, ev) : kc_outcome(KC_OC_STAY);
}
