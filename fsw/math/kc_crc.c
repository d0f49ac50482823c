#include "kc_crc.h"

/* Remainders of the 16 half bytes, polynomial 0xEDB88320 (reflected). */
static const uint32_t s_half[16] = {
    0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u, 0x4DB26158u, 0x5005713Cu,
    0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu, 0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu,
};

uint32_t kc_crc32(uint32_t crc, const void *data, uint32_t n)
{
    const uint8_t *p = (const uint8_t *)data;
    uint32_t c = ~crc;
    for (uint32_t i = 0u; i < n; i++) {
        c ^= p[i];
        c = (c >> 4) ^ s_half[c & 15u];
        c = (c >> 4) ^ s_half[c & 15u];
    }
    return ~c;
}
