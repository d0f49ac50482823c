#include "kc_auth.h"

#include <stddef.h>

#include "monocypher.h"

#define BLOCK_BYTES 128u    /* of BLAKE2b; the key is a block of its own */
#define BLOCK_COST 6000u    /* instructions of a block, with what is done to fill it */

void kc_auth_mac(const kc_key_t *key, const kc_auth_text_t *text, uint8_t mac[KC_MAC_BYTES])
{
    crypto_blake2b_ctx ctx;
    crypto_blake2b_keyed_init(&ctx, KC_MAC_BYTES, key->secret, KC_KEY_BYTES);
    crypto_blake2b_update(&ctx, text->head, text->n_head);
    if (text->n_body > 0u) { crypto_blake2b_update(&ctx, text->body, text->n_body); }
    crypto_blake2b_final(&ctx, mac);
}

static const kc_key_t *find(const kc_keys_t *keys, uint32_t id)
{
    for (uint32_t i = 0u; i < KC_KEY_MAX; i++) {
        if (i < keys->n && keys->key[i].id == id) { return &keys->key[i]; }
    }
    return NULL;
}

kc_auth_verdict_t kc_auth_fresh(const kc_auth_known_t *known, uint64_t counter, uint64_t t_us)
{
    uint64_t now_us = known->clock_us, off_us = now_us > t_us ? now_us - t_us : t_us - now_us;
    if (counter <= known->last) { return KC_AUTH_REPLAYED; }
    if (counter - known->last > KC_AUTH_JUMP_MAX) { return KC_AUTH_JUMPED; }
    if (t_us < known->since_us) { return KC_AUTH_BEFORE; }
    return known->age_max_us > 0u && off_us > known->age_max_us ? KC_AUTH_OLD : KC_AUTH_GOOD;
}

kc_auth_verdict_t kc_auth_check(const kc_keys_t *keys, const kc_auth_t *auth, const kc_auth_known_t *known,
                                uint64_t t_us, const kc_auth_text_t *text)
{
    uint8_t mac[KC_MAC_BYTES];
    if (auth->key_id == 0u) { return KC_AUTH_UNSIGNED; }
    const kc_key_t *key = find(keys, auth->key_id);
    if (key == NULL) { return KC_AUTH_UNKNOWN_KEY; }
    kc_auth_mac(key, text, mac);
    if (crypto_verify16(mac, auth->mac) != 0) { return KC_AUTH_FORGED; }
    return kc_auth_fresh(known, auth->counter, t_us);
}

uint64_t kc_auth_cost(uint32_t n) { return BLOCK_COST * (2u + n / (uint64_t)BLOCK_BYTES); }
