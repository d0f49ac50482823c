/* kc_crc32 with tables of 8 KiB, eight bytes at a time, for what does not fly: a simulated flight spends a twentieth of
 * its time in CRCs of its memory. When it is loaded it is compared with kc_crc.c. */
#include "kc_crc.h"

uint32_t __real_kc_crc32(uint32_t crc, const void *data, uint32_t n);  // NOLINT: names of the linker's --wrap
uint32_t __wrap_kc_crc32(uint32_t crc, const void *data, uint32_t n);  // NOLINT

static uint32_t s_table[8][256];

static uint32_t word_at(const uint8_t *p)
{
    return (uint32_t)p[0] | ((uint32_t)p[1] << 8) | ((uint32_t)p[2] << 16) | ((uint32_t)p[3] << 24);
}

__attribute__((constructor)) static void make_table(void)
{
    for (uint32_t i = 0u; i < 256u; i++) {
        uint32_t c = i;
        for (uint32_t k = 0u; k < 8u; k++) { c = (c >> 1) ^ (0xEDB88320u & (0u - (c & 1u))); }
        s_table[0][i] = c;
    }
    for (uint32_t k = 1u; k < 8u; k++) {
        for (uint32_t i = 0u; i < 256u; i++) {
            uint32_t c = s_table[k - 1u][i];
            s_table[k][i] = (c >> 8) ^ s_table[0][c & 255u];
        }
    }
    const uint32_t n = sizeof s_table - 3u;
    if (__wrap_kc_crc32(7u, s_table, n) != __real_kc_crc32(7u, s_table, n)) { __builtin_trap(); }
}

uint32_t __wrap_kc_crc32(uint32_t crc, const void *data, uint32_t n)
{
    const uint8_t *p = data;
    uint32_t c = ~crc;
    for (; n >= 8u; n -= 8u, p += 8u) {
        const uint32_t lo = c ^ word_at(p), hi = word_at(p + 4u);
        c = s_table[7][lo & 255u] ^ s_table[6][lo >> 8 & 255u] ^ s_table[5][lo >> 16 & 255u] ^
            s_table[4][lo >> 24] ^ s_table[3][hi & 255u] ^ s_table[2][hi >> 8 & 255u] ^
            s_table[1][hi >> 16 & 255u] ^ s_table[0][hi >> 24];
    }
    for (; n > 0u; n--) { c = (c >> 8) ^ s_table[0][(c ^ *p++) & 255u]; }
    return ~c;
}
