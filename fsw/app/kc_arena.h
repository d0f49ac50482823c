/* Memory that is used for one thing while a calibration runs and for another while none does: the only place
 * where storage overlaps.
 *
 *   calibration   from START until the state is IDLE or SAFE again. START discards what is staged and begins
 *                 everything here anew.
 *   idle          otherwise: tables are staged and decoded, the monitor holds its window. Commands for tables
 *                 are refused while a calibration runs or its correction waits for review, and the monitor
 *                 begins a new window after a calibration.
 *
 *   proposal      in PROPOSE: no pose is chosen any more. (Within `calibration`, kc_choice.h overlaps what a choice and
 *                 what an evaluation in REPORT need.)
 *
 * In STORE images in `idle` are handed to the store, and a correction or a table is put in force, for which
 * idle.scratch is used: the calibration part is not needed any more by then. */
#ifndef KC_ARENA_H
#define KC_ARENA_H

#include "kc_choice.h"
#include "kc_journal.h"
#include "kc_monitor.h"
#include "kc_tables.h"

typedef struct {
    uint8_t staged[KC_IMAGE_MAX];
    kc_tbl_scratch_t scratch; /* only inside one function of kc_tables.h */
    kc_monitor_t monitor;
    kc_journal_images_t images; /* in STORE, and at boot */
} kc_arena_idle_t;

typedef union {
    kc_arena_calibration_t calibration;
    kc_evaluation_t proposal;
    kc_arena_idle_t idle;
} kc_arena_t;

#endif
