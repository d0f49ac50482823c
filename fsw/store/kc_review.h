/* A correction that waits for the ground: approval in two steps, rejection; activation and rollback.
 *
 * Only a correction with the verdict CHANGE is approved by its CRC alone. With another verdict, or none (it was lost
 * with the journal), the first step needs an override. That is an argument of the command, and so under its MAC. */
#ifndef KC_REVIEW_H
#define KC_REVIEW_H

#include "kc_answer.h"
#include "kc_channels.h"
#include "kc_holder.h"
#include "kc_journal.h"
#include "kc_verdict.h"
#include "kc_view.h"

/* arg_i[1] of APPROVE_ARM. FIT: although the fit is poor, or its verdict is not known. */
#define KC_OVERRIDE_NONE 0
#define KC_OVERRIDE_FIT 1

typedef struct {
    kc_kin_t kin;
    uint8_t image[KC_KIN_IMAGE_MAX];
    uint32_t n, crc;  /* crc 0: nothing waits */
    uint32_t verdict; /* kc_verdict_t of the correction; NO_CHANGE, which never waits: not known */
    uint32_t armed_key; /* ARMED: key of the first step. A restart disarms, so it is not kept through one */
} kc_review_t;

/* Encode a proposed correction; gives its CRC. Nothing waits yet. */
uint32_t kc_review_encode(kc_review_t *review, const kc_kin_t *kin, kc_verdict_t verdict);
/* The correction that was encoded waits for the ground from now on. */
void kc_review_wait(kc_review_t *review, kc_out_t *out);
/* Put the correction in force, the old one kept; nothing waits any more. Everything is stored already. KC_ERR_* as
 * kc_tbl_set_kin: it waits on, nothing changed. */
kc_status_t kc_review_activate(kc_review_t *review, kc_tables_t *tables, kc_out_t *out);
/* Forget it, with an event; nothing happens if none waits. */
void kc_review_drop(kc_review_t *review, kc_out_t *out);
/* ARMED: EXPIRE when the second step does not come. */
kc_outcome_t kc_review_armed(const kc_review_t *review, const kc_view_t *view, kc_out_t *out);

/* kc_verdict_t of what waits; NO_CHANGE: nothing does, or it is not known. */
static inline uint32_t kc_review_verdict(const kc_review_t *review)
{
    return review->crc != 0u ? review->verdict : (uint32_t)KC_VERDICT_NO_CHANGE;
}
/* Housekeeping: what waits, with its verdict, and the time left for the second step. */
void kc_review_report(const kc_review_t *review, const kc_view_t *view, kc_hk_t *hk);

/* Commands; crc is the one they name. STORE: nothing has changed yet, it is to be stored first.
 * An override other than KC_OVERRIDE_NONE, KC_OVERRIDE_FIT is refused (KC_ERR_ARG). Where CONFIG wants another holder for
 * the second step, and the keys of flight have one holder only, the first step is refused already. */
kc_answer_t kc_review_arm(kc_review_t *review, const kc_config_t *config, const kc_keys_t *keys,
                          const kc_cmd_t *cmd, kc_out_t *out);
/* The image is decoded again: what was approved is what its CRC names. */
kc_answer_t kc_review_go(kc_review_t *review, const kc_tables_t *tables, const kc_cmd_t *cmd, kc_out_t *out);
kc_answer_t kc_review_reject(const kc_review_t *review, uint32_t crc, kc_out_t *out);
kc_answer_t kc_review_rollback(const kc_tables_t *tables, uint32_t crc, kc_out_t *out);

/* Boot: a stored proposal is kept for review if it still belongs to the active tables. verdict: as the journal has
 * it. */
kc_status_t kc_review_load(kc_review_t *review, const kc_tables_t *tables, uint32_t verdict,
                           const uint8_t *image, uint32_t n, kc_events_t *ev);

#endif
