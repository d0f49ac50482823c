/* Commands: one table says who may send each, in which states it is taken, and how it is answered. */
#ifndef KC_DISPATCH_H
#define KC_DISPATCH_H

#include "kc_app.h"
#include "kc_work.h"

/* Admit, check, carry out and answer one command. Its outcome is for the sequencer; STORE: it is answered when what it
 * changes is stored. aborted: an ABORT came with it, and wins over what moves the arm or changes what is in force. */
kc_outcome_t kc_dispatch(kc_app_t *app, const kc_cmd_t *cmd, bool aborted, kc_work_t *work, kc_out_t *out);

#endif
