/* kc_crc32 with tables of 16 KiB, sixteen bytes at a time, for what does not fly: a simulated flight spends a twentieth
 * of its time in CRCs of its memory. When it is loaded it is compared with kc_crc.c. */
#include "kc_crc.h"

uint32_t __real_kc_crc32(uint32_t crc, const void *data, uint32_t n);  // NOLINT: names of the linker's --wrap
uint32_t __wrap_kc_crc32(uint32_t crc, const void *data, uint32_t n);  // NOLINT

#define AT_ONCE 16u

static uint32_t s_table[AT_ONCE][256];

static uint32_t word_at(const uint8_t *p)
{
    return (uint32_t)p[0] | ((uint32_t)p[1] << 8) | ((uint32_t)p[2] << 16) | ((uint32_t)p[3] << 24);
}

/* Of a word, with as many bytes of zeros after it as the tables say. */
static uint32_t crc_of(uint32_t word, uint32_t (*table)[256])
{
    return table[3][word & 255u] ^ table[2][word >> 8 & 255u] ^ table[1][word >> 16 & 255u] ^
           table[0][word >> 24];
}

__attribute__((constructor)) static void make_table(void)
{
    for (uint32_t i = 0u; i < 256u; i++) {
        uint32_t c = i;
        for (uint32_t k = 0u; k < 8u; k++) { c = (c >> 1) ^ (0xEDB88320u & (0u - (c & 1u))); }
        s_table[0][i] = c;
    }
    for (uint32_t k = 1u; k < AT_ONCE; k++) {
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
    for (; n >= AT_ONCE; n -= AT_ONCE, p += AT_ONCE) {
        c = crc_of(c ^ word_at(p), s_table + 12) ^ crc_of(word_at(p + 4), s_table + 8) ^
            crc_of(word_at(p + 8), s_table + 4) ^ crc_of(word_at(p + 12), s_table);
    }
    for (; n > 0u; n--) { c = (c >> 8) ^ s_table[0][(c ^ *p++) & 255u]; }
    return ~c;
}
