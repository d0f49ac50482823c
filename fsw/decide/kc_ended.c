#include "kc_ended.h"

#define TEXT_(number, name, text) text,
static const char *const s_text[] = {"", KC_ENDED_LIST(TEXT_)};

const char *kc_ended_text(int32_t ended)
{
    return ended >= 0 && ended < (int32_t)KC_ENDED_COUNT ? s_text[ended] : "";
}
