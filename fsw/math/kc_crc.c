#include "kc_crc.h"

uint32_t kc_crc32(uint32_t crc, const void *data, uint32_t n)
{
    const uint8_t *p = (const uint8_t *)data;
    uint32_t c = ~crc;
    for (uint32_t i = 0u; i < n; i++) {
        c ^= p[i];
        for (int bit = 0; bit < 8; bit++) { c = (c >> 1) ^ (0xEDB88320u & (0u - (c & 1u))); }
    }
    return ~c;
}
