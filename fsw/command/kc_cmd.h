/* Commands: whether one is admitted, its arguments, its answer; tables. */
#ifndef KC_CMD_H
#define KC_CMD_H

#include <stdbool.h>

#include "kc_answer.h"
#include "kc_channels.h"
#include "kc_counters.h"
#include "kc_view.h"

typedef struct {
    kc_keys_t keys;
    kc_counters_t counters;
    int32_t seq[KC_SOURCE_MAX]; /* last number taken of a command without a signature */
    bool seen[KC_SOURCE_MAX];
    uint64_t us[KC_SOURCE_MAX]; /* elapsed time of the last number taken */
    uint32_t n_ok, n_refused;
    uint32_t validated_key; /* of the last TABLE_VALIDATE that was taken */
} kc_cmd_log_t;

/* Who may send a command. ANYBODY: only ABORT, which only stops, and executed twice does what it does once. */
typedef enum {
    KC_SENDER_SIGNED, /* holders of a key */
    KC_SENDER_UNSIGNED, /* known sources, also without a signature */
    KC_SENDER_ANYBODY
} kc_sender_t;

/* States in which tables change and calibrations start, bit per state: nothing depends on the tables. */
#define KC_CMD_FREE (1u << KC_ST_IDLE | 1u << KC_ST_SAFE)

/* A signed command: MAC, counter and stamp. One without a signature, if that is enough: source and sequence. A counter or
 * number that is refused for another reason is used up. */
kc_answer_t kc_cmd_admit(kc_cmd_log_t *log, kc_sender_t sender, const kc_view_t *view, const kc_cmd_t *cmd,
                         kc_out_t *out);
/* As kc_app_vouches_cmd and kc_app_vouches_chunk. */
bool kc_cmd_vouches(const kc_cmd_log_t *log, const kc_view_t *view, const kc_cmd_t *cmd, uint32_t *macs);
bool kc_cmd_vouches_chunk(const kc_cmd_log_t *log, const kc_view_t *view, const kc_table_chunk_t *chunk,
                          uint32_t *macs);
/* Answer a command, and count it. */
void kc_cmd_answer(kc_cmd_log_t *log, const kc_cmd_t *cmd, const kc_answer_t *answer, kc_out_t *out);
/* The command is not for this state; tables do not change in this state. */
kc_answer_t kc_cmd_not_now(const kc_view_t *view, const kc_cmd_t *cmd, kc_out_t *out);
kc_answer_t kc_cmd_busy(const kc_view_t *view, kc_out_t *out);

/* What START asks for. */
typedef struct {
    kc_acq_t acq;
    uint32_t n_goal, seed;
    uint64_t free_mask;
    bool suspects; /* from what the monitor suspects */
} kc_start_t;
/* START, in a state that allows it: may it, and what does it ask for? */
kc_answer_t kc_cmd_start(const kc_view_t *view, const kc_cmd_t *cmd, kc_start_t *ask, kc_out_t *out);
/* TABLE_VALIDATE. A CONFIG that wants two holders is refused if the keys have one only. */
kc_answer_t kc_cmd_validate(kc_cmd_log_t *log, kc_tables_t *tables, const kc_cmd_t *cmd, kc_out_t *out);
/* TABLE_ACTIVATE: STORE, it becomes active when it is stored. Where CONFIG wants two holders, a KIN or CONFIG table needs
 * them too, for validation and activation: else one of them could put a correction in force, or end that rule. */
kc_answer_t kc_cmd_activate(const kc_cmd_log_t *log, kc_tables_t *tables, const kc_cmd_t *cmd, kc_out_t *out);
/* A chunk has to be signed. It is not answered; events say why one is refused. */
void kc_cmd_chunk(kc_cmd_log_t *log, kc_tables_t *tables, const kc_view_t *view,
                  const kc_table_chunk_t *chunk, kc_out_t *out);

#endif
