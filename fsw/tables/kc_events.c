#include "kc_events.h"

#include <stdbool.h>
#include <stddef.h>

typedef struct {
    uint16_t id;
    uint8_t severity;
    const char *name;
    const char *text;
    const char *action;
} dict_t;

#define DICT_ENTRY_(id, name, sev, text, action) {(id), KC_SEV_##sev, #name, text, action},
static const dict_t s_dict[] = {KC_EVENT_LIST(DICT_ENTRY_)};
#define DICT_N (sizeof s_dict / sizeof s_dict[0])

static const dict_t *find(uint32_t id)
{
    for (size_t i = 0u; i < DICT_N; i++) {
        if (s_dict[i].id == id) { return &s_dict[i]; }
    }
    return NULL;
}

const char *kc_event_name(uint16_t id)
{
    const dict_t *d = find(id);
    return d != NULL ? d->name : "UNKNOWN";
}

const char *kc_event_text(uint16_t id)
{
    const dict_t *d = find(id);
    return d != NULL ? d->text : "";
}

const char *kc_event_action(uint16_t id)
{
    const dict_t *d = find(id);
    return d != NULL ? d->action : "";
}

kc_severity_t kc_event_severity(uint16_t id)
{
    const dict_t *d = find(id);
    return d != NULL ? (kc_severity_t)d->severity : KC_SEV_ERROR;
}

#define CAUSE_TEXT_(number, name, text) text,
static const char *const s_cause[] = {KC_CAUSE_LIST(CAUSE_TEXT_)};

const char *kc_cause_text(int32_t cause)
{
    return cause >= 0 && cause < (int32_t)KC_CAUSE_COUNT ? s_cause[cause] : "";
}

static bool recorded(const kc_events_t *events, kc_event_id_t id, int32_t index)
{
    for (uint32_t i = 0u; i < events->n; i++) {
        if (events->e[i].id == (uint16_t)id && events->e[i].index == index) { return true; }
    }
    return false;
}

void kc_event(kc_events_t *events, kc_event_id_t id, int32_t index, double got, double want)
{
    if (recorded(events, id, index)) { return; }
    if (events->n >= KC_EVENTS_MAX) {
        events->dropped++;
        return;
    }
    events->e[events->n].id = (uint16_t)id;
    events->e[events->n].severity = (uint8_t)kc_event_severity((uint16_t)id);
    events->e[events->n].index = index;
    events->e[events->n].got = got;
    events->e[events->n].want = want;
    events->n++;
}
