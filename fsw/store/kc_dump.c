#include "kc_dump.h"

#include <string.h>

#define CHUNK_COST \
    (40u * KC_IMAGE_MAX) /* bound of the instructions: the whole image is made for each chunk */

static uint32_t crc_of(const kc_review_t *review, const kc_view_t *view, int32_t kind)
{
    return kind == (int32_t)KC_STORE_PROPOSAL ? review->crc : view->tables->crc[kind];
}

kc_answer_t kc_dump_begin(kc_dump_t *dump, const kc_review_t *review, const kc_view_t *view,
                          const kc_cmd_t *cmd, kc_out_t *out)
{
    int32_t kind = cmd->arg_i[0];
    bool table = kind >= 1 && kind < (int32_t)KC_TBL_COUNT;
    if (!table && kind != (int32_t)KC_STORE_PROPOSAL) {
        return kc_answer_refuse(&out->events, KC_EVT_CMD_ARG, 0, (double)kind, (double)(KC_TBL_COUNT - 1),
                                KC_ERR_ARG);
    }
    if (crc_of(review, view, kind) == 0u) {
        return kc_answer_refuse(&out->events, KC_EVT_TBL_MISSING, kind, 0.0, 0.0, KC_ERR_STATE);
    }
    dump->kind = (uint16_t)kind;
    dump->at = 0u;
    return kc_answer_ok(KC_OC_STAY);
}

/* Bytes [at, at + chunk) of the dumped image; returns its whole size. */
static uint32_t bytes(const kc_dump_t *dump, const kc_review_t *review, const kc_view_t *view, uint8_t *data)
{
    uint32_t total = review->n, left = total - dump->at;
    if (dump->kind == KC_STORE_PROPOSAL) {
        memcpy(data, &review->image[dump->at], left < KC_CHUNK_BYTES ? left : KC_CHUNK_BYTES);
    } else {
        (void)kc_tbl_encode(dump->kind, kc_tbl_active_ptr(view->tables, dump->kind), dump->at, data,
                            KC_CHUNK_BYTES, &total);
    }
    return total;
}

void kc_dump_run(kc_dump_t *dump, const kc_review_t *review, const kc_view_t *view, kc_work_t *work,
                 kc_out_t *out)
{
    kc_table_chunk_t *c = &out->table_down;
    if (dump->kind == 0u || !kc_work_take(work, CHUNK_COST)) { return; }
    uint32_t crc = crc_of(review, view, (int32_t)dump->kind);
    if (dump->at == 0u) { dump->crc = crc; }
    if (crc == 0u || crc != dump->crc) {
        kc_event(&out->events, KC_EVT_TBL_MISSING, (int32_t)dump->kind, 0.0, 0.0);
        dump->kind = 0u;
        return;
    }
    out->has_table_down = 1u;
    c->kind = (int32_t)dump->kind;
    c->total = bytes(dump, review, view, c->data);
    c->offset = dump->at;
    c->n = c->total - dump->at < KC_CHUNK_BYTES ? c->total - dump->at : KC_CHUNK_BYTES;
    dump->at += c->n;
    if (dump->at >= c->total) { dump->kind = 0u; }
}
