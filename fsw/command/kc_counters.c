#include "kc_counters.h"

#include <stdbool.h>
#include <stddef.h>
#include <string.h>

static kc_counted_t *find(kc_counters_t *counters, uint32_t key_id)
{
    for (uint32_t i = 0u; i < KC_KEY_MAX; i++) {
        if (counters->key[i].key_id == key_id) { return &counters->key[i]; }
    }
    return NULL;
}

const kc_counted_t *kc_counters_of(const kc_counters_t *counters, uint32_t key_id)
{
    for (uint32_t i = 0u; i < KC_KEY_MAX; i++) {
        if (counters->key[i].key_id == key_id && key_id != 0u) { return &counters->key[i]; }
    }
    return NULL;
}

static bool in_file(const kc_keys_t *keys, uint32_t key_id)
{
    for (uint32_t i = 0u; i < KC_KEY_MAX; i++) {
        if (i < keys->n && keys->key[i].id == key_id) { return true; }
    }
    return false;
}

/* Of those whose key is not in the file, the one with the lowest number; a free one has 0. There is one: a key without
 * a place is in the file, and as many places as keys. */
static kc_counted_t *place(kc_counters_t *counters, const kc_keys_t *keys)
{
    kc_counted_t *best = &counters->key[0];
    for (uint32_t i = 1u; i < KC_KEY_MAX; i++) {
        kc_counted_t *k = &counters->key[i];
        if (in_file(keys, k->key_id)) { continue; }
        if (in_file(keys, best->key_id) || k->key_id < best->key_id) { best = k; }
    }
    return best;
}

void kc_counters_begin(kc_counters_t *counters, const kc_keys_t *keys)
{
    const kc_counted_t *free = find(counters, 0u);
    kc_counted_t former = {0};
    if (free != NULL) { former = *free; }
    for (uint32_t i = 0u; i < KC_KEY_MAX; i++) {
        if (i >= keys->n || find(counters, keys->key[i].id) != NULL) { continue; }
        kc_counted_t *k = place(counters, keys);
        *k = former; /* zeros, but for the first start after a former journal */
        k->key_id = keys->key[i].id;
        k->since_us = UINT64_MAX;
    }
    kc_counted_t *left = find(counters, 0u);
    if (keys->n > 0u && left != NULL) { memset(left, 0, sizeof *left); }
}

void kc_counters_clock(kc_counters_t *counters, uint64_t clock_us)
{
    for (uint32_t i = 0u; i < KC_KEY_MAX; i++) {
        if (counters->key[i].since_us > clock_us) { counters->key[i].since_us = clock_us; }
    }
}

void kc_counters_take(kc_counters_t *counters, const kc_auth_t *auth, kc_signed_kind_t kind, int32_t source)
{
    kc_counted_t *k = find(counters, auth->key_id);
    if (k != NULL) { k->last[kind][source - 1] = auth->counter; }
}
