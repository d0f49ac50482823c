/* Whether a message comes from a holder of a key, and was not sent before. */
#ifndef KC_AUTH_H
#define KC_AUTH_H

#include <stdint.h>

#include "kc_limits.h"

#define KC_KEY_BYTES 32u
#define KC_MAC_BYTES 16u

typedef struct {
    uint32_t id; /* not 0 */
    uint8_t secret[KC_KEY_BYTES];
} kc_key_t;

typedef struct {
    uint32_t n; /* 0: nothing that has to be signed is taken */
    kc_key_t key[KC_KEY_MAX];
} kc_keys_t;

/* What signs a message. */
typedef struct {
    uint32_t key_id; /* 0: not signed */
    uint64_t counter;
    uint8_t mac[KC_MAC_BYTES];
} kc_auth_t;

/* The bytes that a MAC is over: one part after the other. n_body may be 0. */
typedef struct {
    const uint8_t *head, *body;
    uint32_t n_head, n_body;
} kc_auth_text_t;

/* What a signature is held against. */
typedef struct {
    uint64_t last;     /* counter of the last message taken, of this key and sender on this channel */
    uint64_t since_us; /* nothing made before this is taken: counters of the key are known from then on */
    uint64_t clock_us; /* now */
    uint64_t age_max_us; /* how far the stamp may be from now, before or after; 0: not checked */
} kc_auth_known_t;

typedef enum {
    KC_AUTH_GOOD = 0,
    KC_AUTH_UNSIGNED,
    KC_AUTH_UNKNOWN_KEY,
    KC_AUTH_FORGED,
    KC_AUTH_REPLAYED,
    KC_AUTH_JUMPED, /* the counter is more than KC_AUTH_JUMP_MAX above the last */
    KC_AUTH_BEFORE, /* made before since_us */
    KC_AUTH_OLD     /* made too long before now, or after it */
} kc_auth_verdict_t;

/* The largest step of a counter: no single message can use up the numbers of its key. A sender that has lost its count
 * begins at the clock in us, which is below this until the year 2112. */
#define KC_AUTH_JUMP_MAX (1ull << 52)

/* MAC of a text: BLAKE2b with a key (RFC 7693), 16 bytes. */
void kc_auth_mac(const kc_key_t *key, const kc_auth_text_t *text, uint8_t mac[KC_MAC_BYTES]);
/* Counter and stamp alone: GOOD if a good MAC would be taken. */
kc_auth_verdict_t kc_auth_fresh(const kc_auth_known_t *known, uint64_t counter, uint64_t t_us);
/* The verdict on a message that was made at t_us. The comparison of the MAC takes the same time for every MAC. Counter
 * and stamp are looked at only behind a good MAC. */
kc_auth_verdict_t kc_auth_check(const kc_keys_t *keys, const kc_auth_t *auth, const kc_auth_known_t *known,
                                uint64_t t_us, const kc_auth_text_t *text);
/* A bound of the instructions of judging a text of n bytes. */
uint64_t kc_auth_cost(uint32_t n);

#endif
