/* Field-walking stream: one pass over the fields of a table sizes it, writes it, reads it or checks it.
 *
 * A layout function (kc_layout.c) names every field once, in order, with its number, limits and the
 * entry it belongs to; the mode of the walk decides what happens, so reader, writer and docs can't
 * disagree. All integers little-endian, floats as their IEEE 754 bits. Nothing outside the image is
 * ever read and nothing outside the window is ever written. */
#ifndef KC_CODEC_H
#define KC_CODEC_H

#include <stdbool.h>
#include <stdint.h>

#include "kc_events.h"

typedef enum {
    KC_WALK_SIZE = 0,  /* count bytes; CRC of them when want_crc */
    KC_WALK_WRITE = 1, /* write the bytes that fall into [from, from + cap) */
    KC_WALK_READ = 2,  /* read and check */
    KC_WALK_CHECK = 3  /* check the values in memory, no stream */
} kc_walk_mode_t;

/* Caller owns it; start from a zeroed struct and set mode and buffers. */
typedef struct {
    kc_walk_mode_t mode;
    uint8_t want_crc;
    uint8_t lost;    /* layout unknown from here on: a count was bad */
    uint8_t overrun; /* a read went past the end; the fields there are zero */
    uint32_t pos;    /* offset of the next byte in the stream */
    uint32_t crc;
    const uint8_t *in;
    uint32_t in_n;
    uint8_t *out;
    uint32_t from, cap;
    int32_t index;        /* entry being walked, -1 = none; set by the layout */
    uint32_t n_bad;       /* values refused so far */
    kc_event_id_t bad_id; /* first of them */
    int32_t bad_index;
    uint32_t bad_field;
    double bad_got;
} kc_walk_t;

/* Limits are inclusive. In KC_WALK_READ the value is stored even when it is refused. */
void kc_walk_u8(kc_walk_t *w, uint32_t field, uint8_t *v, uint8_t lo, uint8_t hi);
void kc_walk_u16(kc_walk_t *w, uint32_t field, uint16_t *v, uint16_t lo, uint16_t hi);
void kc_walk_u32(kc_walk_t *w, uint32_t field, uint32_t *v, uint32_t lo, uint32_t hi);
void kc_walk_i32(kc_walk_t *w, uint32_t field, int32_t *v, int32_t lo, int32_t hi);
void kc_walk_u64(kc_walk_t *w, uint32_t field, uint64_t *v, uint64_t lo, uint64_t hi);
/* Not finite: TBL_NOT_FINITE; outside: TBL_RANGE. */
void kc_walk_f32(kc_walk_t *w, uint32_t field, float *v, double lo, double hi);
void kc_walk_f64(kc_walk_t *w, uint32_t field, double *v, double lo, double hi);
void kc_walk_vec(kc_walk_t *w, uint32_t field, double *v, uint32_t n, double lo, double hi);
/* Unit quaternion (w, x, y, z), norm within 1e-6 of 1: TBL_NOT_UNIT, got = norm. */
void kc_walk_quat(kc_walk_t *w, uint32_t field, double q[4]);
void kc_walk_quatf(kc_walk_t *w, uint32_t field, float q[4]);
/* KC_NAME_LEN bytes: printable ASCII, at least one, then NUL to the end; got = the bad byte. */
void kc_walk_name(kc_walk_t *w, uint32_t field, char name[]);
void kc_walk_raw(kc_walk_t *w, uint8_t *bytes, uint32_t n);
/* A count that decides the layout: returns how many entries to walk, 0 if it is out of range (the walk
 * is lost then, in every mode, and what follows is neither read nor checked). */
uint32_t kc_walk_count(kc_walk_t *w, uint32_t field, uint32_t *v, uint32_t lo, uint32_t hi);
/* A rule between fields: when it does not hold, `got` of `field` is refused. */
void kc_walk_rule(kc_walk_t *w, uint32_t field, bool holds, double got);

#endif
