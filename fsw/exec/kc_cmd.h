/* Commands: whether one is admitted, its arguments, its answer; tables. */
#ifndef KC_CMD_H
#define KC_CMD_H

#include <stdbool.h>

#include "kc_answer.h"
#include "kc_app.h"
#include "kc_select.h"
#include "kc_view.h"

typedef struct {
    int32_t seq[KC_SOURCE_MAX]; /* last number taken */
    bool seen[KC_SOURCE_MAX];
    uint64_t us[KC_SOURCE_MAX]; /* elapsed time of the last number taken */
    uint32_t n_ok, n_refused;
} kc_cmd_log_t;

/* Source and sequence; a number that is refused for another reason is used up. ABORT needs no number: executed
 * twice it does what it does once. */
kc_answer_t kc_cmd_admit(kc_cmd_log_t *log, const kc_view_t *v, const kc_cmd_t *c, kc_out_t *out);
/* Answer a command, and count it. */
void kc_cmd_answer(kc_cmd_log_t *log, const kc_cmd_t *c, const kc_answer_t *answer, kc_out_t *out);
/* The command is not for this state. */
kc_answer_t kc_cmd_not_now(const kc_view_t *v, const kc_cmd_t *c, kc_out_t *out);
/* Tables change, and calibrations start, only while nothing depends on the tables. */
bool kc_cmd_tables_free(const kc_view_t *v);

/* START: may it, and what does it ask for? */
kc_answer_t kc_cmd_start(const kc_view_t *v, const kc_cmd_t *c, kc_start_t *ask, kc_out_t *out);
/* TABLE_VALIDATE, TABLE_DISCARD; TABLE_ACTIVATE: STORE, it becomes active when it is stored. */
kc_answer_t kc_cmd_table(kc_tables_t *tables, const kc_view_t *v, const kc_cmd_t *c, kc_out_t *out);
void kc_cmd_chunk(kc_tables_t *tables, const kc_view_t *v, const kc_chunk_t *c, kc_out_t *out);

#endif
