/* The store protocol: what a step asks the edge to keep, and the sizes of it. The answer comes with the next step
 * (kc_channels.h). */
#ifndef KC_STORE_H
#define KC_STORE_H

#include <stdint.h>

/* What the edge must keep through power loss: done in order, up to the first failure, each one read back. Each
 * kind has two slots; the edge writes the older one (write new file, sync, rename) and numbers it, or nothing if
 * the newest holds the same already. A write that failed leaves the newest slot as it was. kind 1..7: a table image; KC_STORE_PROPOSAL: the KIN
 * image that waits for review; KC_STORE_PREV: the KIN image for rollback; KC_STORE_JOURNAL: a
 * kc_journal_t record. n = 0: delete. */
#define KC_STORE_PROPOSAL 16u
#define KC_STORE_PREV 17u
#define KC_STORE_JOURNAL 18u
#define KC_STORE_QUEUE_MAX 10u
#define KC_JOURNAL_BYTES 232u
#define KC_KIN_IMAGE_MAX 1280u
typedef struct {
    uint16_t kind;
    uint32_t n;
    const uint8_t *data; /* valid until the next step */
} kc_store_t;

#endif
