/* Checks of table entries that remember the first problem only: index and value go into an event. */
#ifndef KC_CHECK_H
#define KC_CHECK_H

#include <stdbool.h>
#include <stdint.h>

#include "kc_status.h"

typedef struct {
    kc_status_t st; /* KC_OK until the first failed check, then KC_ERR_RANGE */
    int32_t index;  /* of the first failed check */
    double got;     /* its value */
} kc_check_t;

kc_check_t kc_check_start(void);
/* Record (index, got) unless ok or something failed before. */
void kc_check(kc_check_t *c, bool ok, int32_t index, double got);
void kc_check_finite(kc_check_t *c, const double *v, uint32_t n, int32_t index);
void kc_check_positive(kc_check_t *c, double v, int32_t index);     /* finite, > 0 */
void kc_check_not_negative(kc_check_t *c, double v, int32_t index); /* finite, >= 0 */
/* Finite origin and unit quaternion (1e-6 of the norm). */
void kc_check_frame(kc_check_t *c, const double xyz_m[3], const double q_wxyz[4], int32_t index);
/* Write index and value, if something failed, and give the status. */
kc_status_t kc_check_end(const kc_check_t *c, int32_t *index, double *got);

/* A name of KC_NAME_LEN bytes: not empty, printable ASCII, NUL terminated and padded with NUL. */
bool kc_name_ok(const char *name);

#endif
