#include "kc_status.h"

const char *kc_status_name(kc_status_t st)
{
    switch (st) {
    case KC_OK: return "KC_OK";
    case KC_ERR_ARG: return "KC_ERR_ARG";
    case KC_ERR_FULL: return "KC_ERR_FULL";
    case KC_ERR_NUM: return "KC_ERR_NUM";
    case KC_ERR_ITER: return "KC_ERR_ITER";
    case KC_ERR_CRC: return "KC_ERR_CRC";
    case KC_ERR_FORMAT: return "KC_ERR_FORMAT";
    case KC_ERR_RANGE: return "KC_ERR_RANGE";
    case KC_ERR_STATE: return "KC_ERR_STATE";
    case KC_ERR_STALE: return "KC_ERR_STALE";
    case KC_ERR_RANK: return "KC_ERR_RANK";
    case KC_ERR_REACH: return "KC_ERR_REACH";
    case KC_ERR_PATH: return "KC_ERR_PATH";
    case KC_ERR_AUTH: return "KC_ERR_AUTH";
    default: return "KC_ERR_?";
    }
}
