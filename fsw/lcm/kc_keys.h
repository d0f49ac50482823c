/* The key file: whose signed commands are taken. Text, made by `kincal key new`:
 *
 *   kincal-keys 1
 *   ID SECRET     one line a key, at most KC_KEY_MAX; ID a decimal number from 1 to 2^31 - 1, SECRET 64 hexadecimal digits
 *
 * Who signs does so with the first key. */
#ifndef KC_KEYS_H
#define KC_KEYS_H

#include <stdbool.h>

#include "kc_auth.h"

/* false with the reason on stderr and no keys: the file cannot be read, belongs to somebody else, can be read or
 * written by others, or is not as above. */
bool kc_keys_read(const char *path, kc_keys_t *keys);

#endif
