/* What is kept through power loss. */
#ifndef KC_JOURNAL_H
#define KC_JOURNAL_H

#include <stdbool.h>

#include "kc_channels.h"
#include "kc_counters.h"

/* Content of the journal. The three CRCs name what is in force: the correction, the one for rollback and the one
 * that waits for review (0: none). So one write puts a change in force that takes several files. */
typedef struct {
    uint32_t state, session, pose, boot_count, kin_crc, prev_crc, proposal_crc;
    uint32_t proposal_verdict; /* kc_verdict_t of what waits; 0: nothing, or not known (records of before) */
    int32_t candidate;
    uint16_t seg_from, seg_to;
    uint64_t t_us;
    kc_counters_t counters;
} kc_journal_t;

typedef struct {
    kc_journal_t found; /* at boot; boot_count 0: none */
    kc_journal_t last; /* handed to the store last */
    bool again; /* and to be stored once more, from due_us on */
    uint64_t due_us; /* elapsed time */
    uint8_t bytes[KC_JOURNAL_BYTES];
} kc_journal_store_t;

/* Images of the corrections on their way to the store. */
typedef struct {
    uint8_t kin[KC_KIN_IMAGE_MAX], prev[KC_KIN_IMAGE_MAX];
    uint32_t n_kin, n_prev; /* 0: there is none */
} kc_journal_images_t;

/* Ask the edge to store data (until the next step it stays in place); n = 0 deletes. At most
 * KC_STORE_QUEUE_MAX requests fit in a step; the edge does them in order. */
void kc_journal_store(kc_out_t *out, uint16_t kind, const uint8_t *data, uint32_t n);
/* Store the correction in force and the one for rollback, so that their newest copies are these. */
void kc_journal_kin(kc_journal_images_t *images, const kc_active_t *active, kc_out_t *out);
/* Boot: take a stored record. KC_ERR_STATE: a better one was taken before. */
kc_status_t kc_journal_load(kc_journal_store_t *journal, const uint8_t *data, uint32_t n);
/* Store `now`. */
void kc_journal_write(kc_journal_store_t *journal, const kc_journal_t *now, kc_out_t *out);
/* Store it once more from due_us on, since it could not be stored, or to have a second copy. */
void kc_journal_again(kc_journal_store_t *journal, uint64_t due_us);
/* Store `now` if more than the time differs from what was stored last, or if it has to be stored again. New
 * counters, and other names of what is in force, are stored twice, so that the older copy of the record has them too. */
void kc_journal_note(kc_journal_store_t *journal, const kc_journal_t *now, uint64_t now_us, kc_out_t *out);

#endif
