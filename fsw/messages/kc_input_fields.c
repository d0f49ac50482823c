#include "kc_input_fields.h"

#include <stddef.h>

typedef struct {
    int32_t first;
    uint32_t count;
    const char *name;
} field_t;

#define FIELD_(first, count, NAME, name) {(first), (count), name},
static const field_t s_field[] = {KC_INPUT_FIELD_LIST(FIELD_)};
#define FIELD_N (sizeof s_field / sizeof s_field[0])

const char *kc_input_field(int32_t index, uint32_t *element)
{
    *element = 0u;
    for (size_t i = 0u; i < FIELD_N; i++) {
        const field_t *f = &s_field[i];
        if (index < f->first || index >= f->first + (int32_t)f->count) { continue; }
        if (f->count > 1u) { *element = (uint32_t)(index - f->first) + 1u; }
        return f->name;
    }
    return "";
}
