/* The decoder that lcm-gen makes of every message of a fixed size: what it takes, its encoder writes as it was.
 * (image_t, the only other one, is the harness `detector`'s.)
 *
 * Input: a type, a length and bytes; the type's fingerprint is put before them, or not. */
#include <stdlib.h>
#include <string.h>

#include "fuzz.h"
#include "kcm.h"

#define BYTES_MAX (32u * 1024u)

#define CODEC(type)                                            \
    static int decode_##type(const void *from, int n, void *m) \
    {                                                          \
        MUST(sizeof(kcm_##type) <= BYTES_MAX);                 \
        return kcm_##type##_decode(from, 0, n, m);             \
    }                                                          \
    static int encode_##type(void *to, int n, const void *m) { return kcm_##type##_encode(to, 0, n, m); }
KCM_FIXED_LIST(CODEC)

#define ENTRY(type) {decode_##type, encode_##type},
static const struct {
    int (*decode)(const void *from, int n, void *m);
    int (*encode)(void *to, int n, const void *m);
} s_codec[] = {KCM_FIXED_LIST(ENTRY)};
#define TYPES (sizeof s_codec / sizeof s_codec[0])

int LLVMFuzzerInitialize(int *argc, char ***argv)
{
    (void)argc;
    (void)argv;
    return 0;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static _Alignas(16) uint8_t message[BYTES_MAX], bytes[BYTES_MAX], again[BYTES_MAX];
    fuzz_t f = {data, size};
    uint32_t type = fuzz_u8(&f) % TYPES;
    uint8_t how = fuzz_u8(&f);
    memset(message, 0, sizeof message);
    int whole = s_codec[type].encode(bytes, (int)sizeof bytes, message);
    MUST(whole > 8);
    uint32_t n = (how & 1u) != 0u ? fuzz_u16(&f) % ((uint32_t)whole + 1u) : (uint32_t)whole;
    for (uint32_t i = (how & 2u) != 0u ? 0u : 8u; i < n && f.left > 0u; i++) { bytes[i] = fuzz_u8(&f); }
    uint8_t *arrived = malloc(n + 1u); /* what reads or writes past an end is found */
    MUST(arrived != NULL);
    memcpy(&arrived[1], bytes, n);
    int used = s_codec[type].decode(&arrived[1], (int)n, message);
    MUST(used < 0 || used == whole);
    MUST(used >= 0 || n < (uint32_t)whole || (how & 2u) != 0u);
    if (used >= 0) {
        MUST(s_codec[type].encode(again, (int)sizeof again, message) == used);
        MUST(memcmp(again, &arrived[1], (size_t)used) == 0);
    }
    free(arrived);
    return 0;
}
