#include "kc_journal.h"

#include <stddef.h>
#include <string.h>

#include "kc_codec.h"
#include "kc_crc.h"
#include "kc_states.h"
#include "kc_verdict.h"

/* Layouts, the newest first; the length of a record says which one it has. */
typedef struct {
    uint32_t magic, bytes;
    uint32_t n_keys; /* with counters of their own; 0: they belong to no key */
} layout_t;
static const layout_t s_layout[] = {
    {0x354A434Bu, KC_JOURNAL_BYTES, KC_KEY_MAX}, /* "KCJ5", little-endian */
    {0x344A434Bu, 144u, 2u},                     /* "KCJ4" */
    {0x334A434Bu, 96u, 0u},                      /* "KCJ3" */
};
#define LAYOUT_N 3u
#define CRC_BYTES 4u

/* The most that one step asks for: what is left of one change (three deletions), all of the next (five), the
 * journal, and a proposal that ABORT drops. */
_Static_assert(KC_STORE_QUEUE_MAX >= 10u, "all requests of one step fit");

void kc_journal_store(kc_out_t *out, uint16_t kind, const uint8_t *data, uint32_t n)
{
    out->store[out->n_store++] = (kc_store_t){.kind = kind, .n = n, .data = data};
}

static uint32_t store_kin(kc_out_t *out, uint16_t kind, const kc_kin_t *kin, uint32_t crc, uint8_t *image)
{
    uint32_t n = 0u;
    if (crc == 0u) { return 0u; }
    (void)kc_tbl_encode(KC_TBL_KIN, kin, 0u, image, KC_KIN_IMAGE_MAX, &n);
    kc_journal_store(out, kind, image, n);
    return n;
}

void kc_journal_kin(kc_journal_images_t *images, const kc_active_t *active, kc_out_t *out)
{
    images->n_kin = store_kin(out, KC_TBL_KIN, &active->kin, active->crc[KC_TBL_KIN], images->kin);
    images->n_prev = store_kin(out, KC_STORE_PREV, &active->kin_prev, active->kin_prev_crc, images->prev);
}

static void walk_counted(kc_walk_t *walk, kc_counted_t *counted)
{
    for (uint32_t kind = 0u; kind < KC_SIGNED_COUNT; kind++) {
        for (uint32_t s = 0u; s < KC_SOURCE_MAX; s++) {
            kc_walk_u64(walk, 14u, &counted->last[kind][s], 0u, UINT64_MAX);
        }
    }
}

/* The record: magic, fields, zeros, CRC-32 of all before it. Counters that belong to no key are those of key 0. */
static void walk(kc_walk_t *w, kc_journal_t *record, const layout_t *layout)
{
    uint32_t magic = layout->magic;
    kc_walk_u32(w, 0u, &magic, layout->magic, layout->magic);
    kc_walk_u32(w, 1u, &record->state, 0u, (uint32_t)KC_ST_COUNT - 1u);
    kc_walk_u32(w, 2u, &record->session, 0u, UINT32_MAX);
    kc_walk_u32(w, 3u, &record->pose, 0u, KC_MEAS_MAX);
    kc_walk_u32(w, 4u, &record->boot_count, 0u, UINT32_MAX);
    kc_walk_u32(w, 5u, &record->kin_crc, 0u, UINT32_MAX);
    kc_walk_u32(w, 6u, &record->proposal_crc, 0u, UINT32_MAX);
    kc_walk_i32(w, 7u, &record->candidate, -1, (int32_t)KC_CAND_MAX);
    kc_walk_u16(w, 8u, &record->seg_from, 0u, UINT16_MAX);
    kc_walk_u16(w, 9u, &record->seg_to, 0u, UINT16_MAX);
    kc_walk_u64(w, 10u, &record->t_us, 0u, UINT64_MAX);
    kc_walk_u32(w, 11u, &record->prev_crc, 0u, UINT32_MAX);
    if (layout->n_keys == 0u) {
        walk_counted(w, &record->counters.key[0]);
        return;
    }
    for (uint32_t i = 0u; i < KC_KEY_MAX; i++) {
        if (i >= layout->n_keys) { continue; }
        kc_walk_u32(w, 12u, &record->counters.key[i].key_id, 0u, UINT32_MAX);
        kc_walk_u64(w, 13u, &record->counters.key[i].since_us, 0u, UINT64_MAX);
        walk_counted(w, &record->counters.key[i]);
    }
    kc_walk_u32(w, 15u, &record->proposal_verdict, 0u, (uint32_t)KC_VERDICT_POOR);
}

static uint32_t le32(const uint8_t *b)
{
    return (uint32_t)b[0] | (uint32_t)b[1] << 8 | (uint32_t)b[2] << 16 | (uint32_t)b[3] << 24;
}

/* NULL: no record has this length. */
static const layout_t *layout_of(uint32_t n)
{
    for (uint32_t i = 0u; i < LAYOUT_N; i++) {
        if (s_layout[i].bytes == n) { return &s_layout[i]; }
    }
    return NULL;
}

kc_status_t kc_journal_load(kc_journal_store_t *journal, const uint8_t *data, uint32_t n)
{
    if (journal->found.boot_count != 0u) { return KC_ERR_STATE; }
    const layout_t *layout = layout_of(n);
    if (layout == NULL) { return KC_ERR_FORMAT; }
    if (kc_crc32(0u, data, n - CRC_BYTES) != le32(&data[n - CRC_BYTES])) { return KC_ERR_CRC; }
    kc_journal_t found;
    memset(&found, 0, sizeof found);
    kc_walk_t w;
    memset(&w, 0, sizeof w);
    w.mode = KC_WALK_READ;
    w.in = data;
    w.in_n = n;
    w.index = -1;
    walk(&w, &found, layout);
    if (w.n_bad > 0u) { return KC_ERR_RANGE; }
    journal->found = found;
    return KC_OK;
}

static void write_record(kc_journal_store_t *journal)
{
    kc_walk_t w;
    memset(&w, 0, sizeof w);
    memset(journal->bytes, 0, sizeof journal->bytes);
    w.mode = KC_WALK_WRITE;
    w.out = journal->bytes;
    w.cap = KC_JOURNAL_BYTES;
    w.index = -1;
    walk(&w, &journal->last, &s_layout[0]);
    uint32_t crc = kc_crc32(0u, journal->bytes, KC_JOURNAL_BYTES - CRC_BYTES);
    for (uint32_t i = 0u; i < CRC_BYTES; i++) {
        journal->bytes[KC_JOURNAL_BYTES - CRC_BYTES + i] = (uint8_t)(crc >> (8u * i));
    }
}

static bool same_counters(const kc_journal_t *a, const kc_journal_t *b)
{
    bool same = true;
    for (uint32_t i = 0u; i < KC_KEY_MAX; i++) {
        const kc_counted_t *x = &a->counters.key[i], *y = &b->counters.key[i];
        same = same && x->key_id == y->key_id && x->since_us == y->since_us &&
               memcmp(x->last, y->last, sizeof x->last) == 0;
    }
    return same;
}

static bool same_names(const kc_journal_t *a, const kc_journal_t *b)
{
    return a->kin_crc == b->kin_crc && a->prev_crc == b->prev_crc && a->proposal_crc == b->proposal_crc;
}

static bool same(const kc_journal_t *a, const kc_journal_t *b)
{
    return same_counters(a, b) && same_names(a, b) && a->state == b->state && a->session == b->session &&
           a->pose == b->pose && a->boot_count == b->boot_count && a->candidate == b->candidate &&
           a->seg_from == b->seg_from && a->seg_to == b->seg_to;
}

void kc_journal_write(kc_journal_store_t *journal, const kc_journal_t *now, kc_out_t *out)
{
    journal->last = *now;
    journal->again = false;
    write_record(journal);
    kc_journal_store(out, KC_STORE_JOURNAL, journal->bytes, KC_JOURNAL_BYTES);
}

void kc_journal_again(kc_journal_store_t *journal, uint64_t due_us)
{
    journal->again = true;
    journal->due_us = due_us;
}

void kc_journal_note(kc_journal_store_t *journal, const kc_journal_t *now, uint64_t now_us, kc_out_t *out)
{
    bool due = journal->again && now_us >= journal->due_us;
    bool twice = !same_counters(now, &journal->last) || !same_names(now, &journal->last);
    if (due || !same(now, &journal->last)) { kc_journal_write(journal, now, out); }
    if (twice) { kc_journal_again(journal, 0u); }
}
