#include "kc_check.h"

#include "kc_libm.h"
#include "kc_limits.h"

#define UNIT_NORM_TOL 1e-6

kc_check_t kc_check_start(void)
{
    const kc_check_t c = {KC_OK, 0, 0.0};
    return c;
}

void kc_check(kc_check_t *c, bool ok, int32_t index, double got)
{
    if (ok || c->st != KC_OK) { return; }
    c->st = KC_ERR_RANGE;
    c->index = index;
    c->got = got;
}

void kc_check_finite(kc_check_t *c, const double *v, uint32_t n, int32_t index)
{
    for (uint32_t i = 0u; i < n; i++) { kc_check(c, kc_finite(v[i]), index, v[i]); }
}

void kc_check_positive(kc_check_t *c, double v, int32_t index)
{
    kc_check(c, kc_finite(v) && v > 0.0, index, v);
}

void kc_check_not_negative(kc_check_t *c, double v, int32_t index)
{
    kc_check(c, kc_finite(v) && v >= 0.0, index, v);
}

void kc_check_frame(kc_check_t *c, const double xyz_m[3], const double q_wxyz[4], int32_t index)
{
    double n2 = 0.0;
    kc_check_finite(c, xyz_m, 3u, index);
    for (int i = 0; i < 4; i++) { n2 += q_wxyz[i] * q_wxyz[i]; }
    const double norm = kc_sqrt(n2);
    kc_check(c, kc_fabs(norm - 1.0) <= UNIT_NORM_TOL, index, norm); /* NaN fails too */
}

kc_status_t kc_check_end(const kc_check_t *c, int32_t *index, double *got)
{
    if (c->st != KC_OK) {
        *index = c->index;
        *got = c->got;
    }
    return c->st;
}

bool kc_name_ok(const char *name)
{
    uint32_t n = 0u;
    while (n < KC_NAME_LEN && name[n] >= ' ' && name[n] <= '~') { n++; }
    bool ok = n > 0u && n < KC_NAME_LEN;
    for (uint32_t i = n; i < KC_NAME_LEN; i++) { ok = ok && name[i] == '\0'; }
    return ok;
}
