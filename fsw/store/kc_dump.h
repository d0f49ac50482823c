/* TABLE_DUMP: an active table, or the proposal that waits, one chunk a step. */
#ifndef KC_DUMP_H
#define KC_DUMP_H

#include "kc_answer.h"
#include "kc_channels.h"
#include "kc_review.h"
#include "kc_view.h"

typedef struct {
    uint16_t kind; /* 0: no dump */
    uint32_t at, crc;
} kc_dump_t;

/* The command. A new dump replaces the current one. */
kc_answer_t kc_dump_begin(kc_dump_t *dump, const kc_review_t *review, const kc_view_t *view,
                          const kc_cmd_t *cmd, kc_out_t *out);
/* Next chunk. The table can be gone or another one before its dump ended: what began is not continued then. */
void kc_dump_run(kc_dump_t *dump, const kc_review_t *review, const kc_view_t *view, kc_work_t *work,
                 kc_out_t *out);

#endif
