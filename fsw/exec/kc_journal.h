/* What is kept through power loss. */
#ifndef KC_JOURNAL_H
#define KC_JOURNAL_H

#include "kc_app.h"

/* Content of the journal. */
typedef struct {
    uint32_t state, session, pose, boot_count, kin_crc, proposal_crc;
    int32_t candidate;
    uint16_t seg_from, seg_to;
    uint64_t t_us;
} kc_journal_t;

typedef struct {
    kc_journal_t found; /* at boot; boot_count 0: none */
    kc_journal_t last;  /* stored last */
    uint8_t bytes[KC_JOURNAL_BYTES];
} kc_journal_store_t;

/* Images of the corrections on their way to the store. */
typedef struct {
    uint8_t kin[KC_KIN_IMAGE_MAX], prev[KC_KIN_IMAGE_MAX];
} kc_journal_images_t;

/* Ask the edge to store data (until the next step it stays in place); n = 0 deletes. */
void kc_journal_store(kc_out_t *out, uint16_t kind, const uint8_t *data, uint32_t n);
/* Store the active correction and the one before it; one that does not exist any more is deleted. */
void kc_journal_kin(kc_journal_images_t *images, const kc_active_t *a, kc_out_t *out);
/* Boot: take a stored record. KC_ERR_STATE: a better one was taken before. */
kc_status_t kc_journal_load(kc_journal_store_t *j, const uint8_t *data, uint32_t n);
/* Store `now` if more than the time differs from what was stored last. */
void kc_journal_note(kc_journal_store_t *j, const kc_journal_t *now, kc_out_t *out);

#endif
