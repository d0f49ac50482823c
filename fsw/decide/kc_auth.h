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

typedef enum {
    KC_AUTH_GOOD = 0,
    KC_AUTH_UNSIGNED,
    KC_AUTH_UNKNOWN_KEY,
    KC_AUTH_FORGED,
    KC_AUTH_REPLAYED
} kc_auth_verdict_t;

/* MAC of a text: BLAKE2b with a key (RFC 7693), 16 bytes. */
void kc_auth_mac(const kc_key_t *key, const kc_auth_text_t *text, uint8_t mac[KC_MAC_BYTES]);
/* last: counter of the last message taken, of this sender on this channel. The comparison of the MAC takes the same
 * time for every MAC. A counter is looked at only behind a good MAC. */
kc_auth_verdict_t kc_auth_check(const kc_keys_t *keys, const kc_auth_t *auth, uint64_t last,
                                const kc_auth_text_t *text);
/* A bound of the instructions of judging a text of n bytes. */
uint64_t kc_auth_cost(uint32_t n);

#endif
