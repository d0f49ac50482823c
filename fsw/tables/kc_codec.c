#include "kc_codec.h"

#include <string.h>

#include "kc_crc.h"
#include "kc_libm.h"

#define UNIT_TOL 1e-6

/* Do the values at hand mean something? */
static bool checking(const kc_walk_t *w)
{
    if (w->lost || w->overrun) { return false; }
    return w->mode == KC_WALK_READ || w->mode == KC_WALK_CHECK;
}

static void refuse(kc_walk_t *w, kc_event_id_t id, uint32_t field, double got)
{
    if (w->n_bad++ > 0u) { return; }
    w->bad_id = id;
    w->bad_index = w->index;
    w->bad_field = field;
    w->bad_got = got;
}

void kc_walk_rule(kc_walk_t *w, uint32_t field, bool holds, double got)
{
    if (checking(w) && !holds) { refuse(w, KC_EVT_TBL_RANGE, field, got); }
}

static void write_window(const kc_walk_t *w, const uint8_t *bytes, uint32_t n)
{
    for (uint32_t i = 0u; i < n; i++) {
        uint32_t at = w->pos + i;
        if (at >= w->from && at - w->from < w->cap) { w->out[at - w->from] = bytes[i]; }
    }
}

void kc_walk_raw(kc_walk_t *w, uint8_t *bytes, uint32_t n)
{
    if (w->lost || w->mode == KC_WALK_CHECK) { return; }
    if (w->mode == KC_WALK_READ) {
        if (w->pos + n <= w->in_n) {
            memcpy(bytes, &w->in[w->pos], n);
        } else {
            memset(bytes, 0, n);
            w->overrun = 1u;
        }
    } else if (w->mode == KC_WALK_WRITE) {
        write_window(w, bytes, n);
    } else if (w->want_crc) {
        w->crc = kc_crc32(w->crc, bytes, n);
    }
    w->pos += n;
}

/* Little-endian integer of n bytes through the stream; returns what the table holds afterwards. */
static uint64_t walk_int(kc_walk_t *w, uint64_t v, uint32_t n)
{
    uint8_t b[8];
    for (uint32_t i = 0u; i < n; i++) { b[i] = (uint8_t)(v >> (8u * i)); }
    kc_walk_raw(w, b, n);
    v = 0u;
    for (uint32_t i = 0u; i < n; i++) { v |= (uint64_t)b[i] << (8u * i); }
    return v;
}

static uint64_t walk_uint(kc_walk_t *w, uint32_t field, uint64_t v, uint32_t n, uint64_t lo, uint64_t hi)
{
    v = walk_int(w, v, n);
    kc_walk_rule(w, field, v >= lo && v <= hi, (double)v);
    return v;
}

/* Tables being written are const: only a reading walk may store. */
static bool storing(const kc_walk_t *w) { return w->mode == KC_WALK_READ && !w->lost; }

void kc_walk_u8(kc_walk_t *w, uint32_t field, uint8_t *v, uint8_t lo, uint8_t hi)
{
    uint64_t x = walk_uint(w, field, *v, 1u, lo, hi);
    if (storing(w)) { *v = (uint8_t)x; }
}

void kc_walk_u16(kc_walk_t *w, uint32_t field, uint16_t *v, uint16_t lo, uint16_t hi)
{
    uint64_t x = walk_uint(w, field, *v, 2u, lo, hi);
    if (storing(w)) { *v = (uint16_t)x; }
}

void kc_walk_u32(kc_walk_t *w, uint32_t field, uint32_t *v, uint32_t lo, uint32_t hi)
{
    uint64_t x = walk_uint(w, field, *v, 4u, lo, hi);
    if (storing(w)) { *v = (uint32_t)x; }
}

void kc_walk_u64(kc_walk_t *w, uint32_t field, uint64_t *v, uint64_t lo, uint64_t hi)
{
    uint64_t x = walk_uint(w, field, *v, 8u, lo, hi);
    if (storing(w)) { *v = x; }
}

void kc_walk_i32(kc_walk_t *w, uint32_t field, int32_t *v, int32_t lo, int32_t hi)
{
    uint32_t bits;
    int32_t x;
    memcpy(&bits, v, sizeof bits);
    bits = (uint32_t)walk_int(w, bits, 4u);
    memcpy(&x, &bits, sizeof x); /* two's complement, as C23 and every compiler has it */
    kc_walk_rule(w, field, x >= lo && x <= hi, (double)x);
    if (storing(w)) { *v = x; }
}

static void check_real(kc_walk_t *w, uint32_t field, double v, double lo, double hi)
{
    if (!checking(w)) { return; }
    if (!kc_finite(v)) {
        refuse(w, KC_EVT_TBL_NOT_FINITE, field, v);
    } else if (v < lo || v > hi) {
        refuse(w, KC_EVT_TBL_RANGE, field, v);
    }
}

static double walk_f64(kc_walk_t *w, double *v)
{
    uint64_t bits;
    double x;
    memcpy(&bits, v, sizeof bits);
    bits = walk_int(w, bits, 8u);
    memcpy(&x, &bits, sizeof x);
    if (storing(w)) { *v = x; }
    return x;
}

static double walk_f32(kc_walk_t *w, float *v)
{
    uint32_t bits;
    float x;
    memcpy(&bits, v, sizeof bits);
    bits = (uint32_t)walk_int(w, bits, 4u);
    memcpy(&x, &bits, sizeof x);
    if (storing(w)) { *v = x; }
    return (double)x;
}

void kc_walk_f32(kc_walk_t *w, uint32_t field, float *v, double lo, double hi)
{
    double x = walk_f32(w, v);
    check_real(w, field, x, lo, hi);
}

void kc_walk_f64(kc_walk_t *w, uint32_t field, double *v, double lo, double hi)
{
    double x = walk_f64(w, v);
    check_real(w, field, x, lo, hi);
}

void kc_walk_vec(kc_walk_t *w, uint32_t field, double *v, uint32_t n, double lo, double hi)
{
    for (uint32_t i = 0u; i < n; i++) { kc_walk_f64(w, field, &v[i], lo, hi); }
}

static void check_quat(kc_walk_t *w, uint32_t field, const double q[4])
{
    double norm;
    if (!checking(w)) { return; }
    for (uint32_t i = 0u; i < 4u; i++) {
        if (!kc_finite(q[i])) {
            refuse(w, KC_EVT_TBL_NOT_FINITE, field, q[i]);
            return;
        }
    }
    norm = kc_sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (!(kc_fabs(norm - 1.0) <= UNIT_TOL)) { refuse(w, KC_EVT_TBL_NOT_UNIT, field, norm); }
}

void kc_walk_quat(kc_walk_t *w, uint32_t field, double q[4])
{
    double x[4];
    for (uint32_t i = 0u; i < 4u; i++) { x[i] = walk_f64(w, &q[i]); }
    check_quat(w, field, x);
}

void kc_walk_quatf(kc_walk_t *w, uint32_t field, float q[4])
{
    double x[4];
    for (uint32_t i = 0u; i < 4u; i++) { x[i] = walk_f32(w, &q[i]); }
    check_quat(w, field, x);
}

/* First byte that breaks the rule for names, or -1. */
static int bad_name_byte(const uint8_t b[KC_NAME_LEN])
{
    uint32_t len = 0u;
    while (len < KC_NAME_LEN && b[len] >= 0x20u && b[len] < 0x7fu) { len++; }
    if (len == 0u) { return b[0]; }
    if (len == KC_NAME_LEN) { return b[KC_NAME_LEN - 1u]; } /* no room for the NUL */
    for (uint32_t i = len; i < KC_NAME_LEN; i++) {
        if (b[i] != 0u) { return b[i]; }
    }
    return -1;
}

void kc_walk_name(kc_walk_t *w, uint32_t field, char name[])
{
    uint8_t b[KC_NAME_LEN];
    int bad;
    memcpy(b, name, KC_NAME_LEN);
    kc_walk_raw(w, b, KC_NAME_LEN);
    if (storing(w)) { memcpy(name, b, KC_NAME_LEN); }
    bad = bad_name_byte(b);
    kc_walk_rule(w, field, bad < 0, (double)bad);
}

uint32_t kc_walk_count(kc_walk_t *w, uint32_t field, uint32_t *v, uint32_t lo, uint32_t hi)
{
    uint32_t n = (uint32_t)walk_int(w, *v, 4u);
    if (w->lost || w->overrun) { return 0u; }
    if (storing(w)) { *v = n; }
    if (n >= lo && n <= hi) { return n; }
    refuse(w, KC_EVT_TBL_RANGE, field, (double)n);
    w->lost = 1u;
    return 0u;
}
