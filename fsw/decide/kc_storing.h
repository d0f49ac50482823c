/* Decisions about what is stored: try again or refuse, and which stored copy counts after a restart. */
#ifndef KC_STORING_H
#define KC_STORING_H

#include <stdbool.h>
#include <stdint.h>

#include "kc_status.h"

typedef enum { KC_STORING_DONE, KC_STORING_AGAIN, KC_STORING_REFUSE } kc_storing_t;

/* After try number `tries` (from 1) that came to `status`; `retries` more than one are allowed. */
kc_storing_t kc_storing_next(kc_status_t status, uint32_t tries, uint32_t retries);

/* Whether a stored copy counts. The journal names by CRC what is in force; without a journal (journal = false)
 * every good copy counts, the newest first. crc: of the copy; named: by the journal, 0: none. */
bool kc_storing_counts(bool journal, uint32_t named, uint32_t crc);

#endif
