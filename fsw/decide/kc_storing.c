#include "kc_storing.h"

kc_storing_t kc_storing_next(kc_status_t status, uint32_t tries, uint32_t retries)
{
    if (status == KC_OK) { return KC_STORING_DONE; }
    return tries <= retries ? KC_STORING_AGAIN : KC_STORING_REFUSE;
}

bool kc_storing_counts(bool journal, uint32_t named, uint32_t crc) { return !journal || crc == named; }
