/* Counters of the signed messages that were taken: of each key, for each sender and channel. They belong to the key, so
 * that a new key begins anew; and they are kept through restarts, so that nothing is taken twice.
 *
 * There is a place for each key that can be in force. At a start every key of the key file that has none gets one: a
 * free one, else that of a key which is not in the file, the one with the lowest number first. Keys that are not in the
 * file keep their places until then: a start without keys, or with the wrong file, loses nothing. */
#ifndef KC_COUNTERS_H
#define KC_COUNTERS_H

#include "kc_auth.h"
#include "kc_messages.h"

#define KC_SOURCE_MAX 2u /* sequence numbers are kept per source: kc_source_t */

/* What may come signed. Each has counters of its own, so that their order within a step does not matter. */
typedef enum { KC_SIGNED_CMD = 0, KC_SIGNED_CHUNK = 1 } kc_signed_kind_t;
#define KC_SIGNED_COUNT 2u

typedef struct {
    uint32_t key_id; /* 0: free, or counters of the former journal, which knew of no keys */
    uint64_t since_us; /* clock when the key got its place: what was made before is not taken */
    uint64_t last[KC_SIGNED_COUNT][KC_SOURCE_MAX]; /* counter of the last message taken */
} kc_counted_t;

typedef struct {
    kc_counted_t key[KC_KEY_MAX];
} kc_counters_t;

/* Start: a place for every key. since_us is UINT64_MAX until the clock is known. */
void kc_counters_begin(kc_counters_t *counters, const kc_keys_t *keys);
/* The clock of a step: since_us is never after it, so that a clock that ran ahead locks nobody out. */
void kc_counters_clock(kc_counters_t *counters, uint64_t clock_us);
/* The counters of a key; NULL if it has no place. */
const kc_counted_t *kc_counters_of(const kc_counters_t *counters, uint32_t key_id);
/* A message was taken. */
void kc_counters_take(kc_counters_t *counters, const kc_auth_t *auth, kc_signed_kind_t kind, int32_t source);

#endif
