/* A change of what is in force: stored and read back first, made then, answered last.
 *
 * All that it needs is asked of the edge in one step, the journal at the end. The journal names by CRC what is
 * in force, so its write makes the change: whatever happens before it, the old state comes back after a
 * restart, whatever happens after it, the new one. What could not be stored is tried again, as often as
 * CONFIG says; then the change is refused and everything stays as it was.
 *
 * What is stored and cannot be put in force, since it has changed in memory meanwhile, is refused as well: the journal
 * names what was in force again, and a table other than KIN, which it does not name, is stored over by the active one
 * before the command is answered. ABORT in that moment does not wait for it: it is stored over at once, in one try, and an
 * event says so if that fails. */
#ifndef KC_CHANGE_H
#define KC_CHANGE_H

#include <stdbool.h>

#include "kc_channels.h"
#include "kc_cmd.h"
#include "kc_journal.h"
#include "kc_review.h"
#include "kc_view.h"

typedef enum {
    KC_CHANGE_NONE = 0,
    KC_CHANGE_PROPOSE, /* a correction waits for the ground */
    KC_CHANGE_ACCEPT,  /* a correction is accepted on board */
    KC_CHANGE_APPROVE,
    KC_CHANGE_REJECT,
    KC_CHANGE_ROLLBACK,
    KC_CHANGE_TABLE, /* a staged table becomes active */
    KC_CHANGE_PUT_BACK /* it could not: the active one is stored again */
} kc_change_kind_t;

typedef struct {
    kc_change_kind_t kind;
    bool safe;       /* it began in SAFE */
    bool by_command; /* which is answered at the end */
    kc_cmd_t cmd;
    uint32_t tries;
    bool asked;      /* the edge's answer comes with the next step */
    uint64_t due_us; /* elapsed time of the next try */
    bool failing;    /* the last answer of the edge was a failure: reported once */
    kc_status_t made; /* PUT_BACK: why the table could not become active */
} kc_change_t;

/* Bound of the instructions of asking for KC_CHANGE_PUT_BACK. */
#define KC_CHANGE_BACK_COST (40u * KC_IMAGE_MAX)

/* What a change reads and changes, and the journal's record of this step. */
typedef struct {
    const kc_view_t *view;
    kc_tables_t *tables;
    kc_review_t *review;
    kc_journal_store_t *journal;
    kc_journal_images_t *images;
    kc_cmd_log_t *log;
    kc_journal_t now;
} kc_change_parts_t;

/* Begin one; cmd NULL: no command asked for it. */
void kc_change_begin(kc_change_t *change, kc_change_kind_t kind, const kc_view_t *view, const kc_cmd_t *cmd);
/* STORE: ask the edge, when it is time. */
void kc_change_run(kc_change_t *change, const kc_change_parts_t *parts, kc_out_t *out);
/* The edge's answer to the requests of the last step, whoever made them: the change is made or refused, and
 * its command answered; or it is tried again (STAY). */
kc_outcome_t kc_change_stored(kc_change_t *change, const kc_change_parts_t *parts, const kc_in_t *in,
                              kc_out_t *out);
/* ABORT: it ends between two tries, or before what it asked for in this step is done; its command is refused. What is to be
 * put back is asked for now (KC_CHANGE_BACK_COST), and ends with the edge's answer. */
void kc_change_cancel(kc_change_t *change, const kc_change_parts_t *parts, kc_out_t *out);

#endif
