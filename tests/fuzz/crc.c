/* kc_crc32, eight bytes at a time; at the first call compared with kc_crc.c. */
#include <stdlib.h>
#include <string.h>

#include "kc_crc.h"

uint32_t __real_kc_crc32(uint32_t crc, const void *data, uint32_t n);  // NOLINT: names of the linker's --wrap
uint32_t __wrap_kc_crc32(uint32_t crc, const void *data, uint32_t n);  // NOLINT

static uint32_t s_table[8][256];

static void make_table(void)
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
    if (__wrap_kc_crc32(7u, s_table, n) != __real_kc_crc32(7u, s_table, n)) { abort(); }
}

uint32_t __wrap_kc_crc32(uint32_t crc, const void *data, uint32_t n)
{
    const uint8_t *p = data;
    uint32_t c = ~crc;
    if (s_table[0][1] == 0u) { make_table(); }
    for (; n >= 8u; n -= 8u, p += 8u) {
        uint32_t lo, hi;
        memcpy(&lo, p, 4u); /* little-endian, as x86-64 is */
        memcpy(&hi, p + 4u, 4u);
        lo ^= c;
        c = s_table[7][lo & 255u] ^ s_table[6][lo >> 8 & 255u] ^ s_table[5][lo >> 16 & 255u] ^
            s_table[4][lo >> 24] ^ s_table[3][hi & 255u] ^ s_table[2][hi >> 8 & 255u] ^
            s_table[1][hi >> 16 & 255u] ^ s_table[0][hi >> 24];
    }
    for (; n > 0u; n--) { c = (c >> 8) ^ s_table[0][(c ^ *p++) & 255u]; }
    return ~c;
}
