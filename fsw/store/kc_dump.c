#include "kc_dump.h"

#include <string.h>

#define CHUNK_COST \
    (40u * KC_IMAGE_MAX) /* bound of the instructions: the whole image is made for each chunk */

static uint32_t crc_of(const kc_review_t *r, const kc_view_t *v, int32_t kind)
{
    return kind == (int32_t)KC_STORE_PROPOSAL ? r->crc : v->tables->crc[kind];
}

kc_answer_t kc_dump_begin(kc_dump_t *d, const kc_review_t *r, const kc_view_t *v, const kc_cmd_t *c,
                          kc_out_t *out)
{
    int32_t kind = c->arg_i[0];
    bool table = kind >= 1 && kind < (int32_t)KC_TBL_COUNT;
    if (!table && kind != (int32_t)KC_STORE_PROPOSAL) {
        return kc_answer_refuse(&out->events, KC_EVT_CMD_ARG, 0, (double)kind, (double)(KC_TBL_COUNT - 1),
                                KC_ERR_ARG);
    }
    if (crc_of(r, v, kind) == 0u) {
        return kc_answer_refuse(&out->events, KC_EVT_TBL_MISSING, kind, 0.0, 0.0, KC_ERR_STATE);
    }
    d->kind = (uint16_t)kind;
    d->at = 0u;
    return kc_answer_ok(KC_OC_STAY);
}

/* Bytes [at, at + chunk) of the dumped image; returns its whole size. */
static uint32_t bytes(const kc_dump_t *d, const kc_review_t *r, const kc_view_t *v, uint8_t *data)
{
    uint32_t total = r->n, left = total - d->at;
    if (d->kind == KC_STORE_PROPOSAL) {
        memcpy(data, &r->image[d->at], left < KC_CHUNK_BYTES ? left : KC_CHUNK_BYTES);
    } else {
        (void)kc_tbl_encode(d->kind, kc_tbl_active_ptr(v->tables, d->kind), d->at, data, KC_CHUNK_BYTES,
                            &total);
    }
    return total;
}

void kc_dump_run(kc_dump_t *d, const kc_review_t *r, const kc_view_t *v, kc_work_t *work, kc_out_t *out)
{
    kc_chunk_t *c = &out->table_down;
    if (d->kind == 0u || !kc_work_take(work, CHUNK_COST)) { return; }
    uint32_t crc = crc_of(r, v, (int32_t)d->kind);
    if (d->at == 0u) { d->crc = crc; }
    if (crc == 0u || crc != d->crc) {
        kc_event(&out->events, KC_EVT_TBL_MISSING, (int32_t)d->kind, 0.0, 0.0);
        d->kind = 0u;
        return;
    }
    out->has_table_down = 1u;
    c->kind = (int32_t)d->kind;
    c->total = bytes(d, r, v, c->data);
    c->offset = d->at;
    c->n = c->total - d->at < KC_CHUNK_BYTES ? c->total - d->at : KC_CHUNK_BYTES;
    d->at += c->n;
    if (d->at >= c->total) { d->kind = 0u; }
}
