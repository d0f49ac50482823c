#include "kc_local.h"

#include <stddef.h>

#include "kc_chi2.h"
#include "kc_fit.h"
#include "kc_libm.h"

uint32_t kc_local_rows(const kc_est_t *est) { return 6u * (est->n_obs - est->n_outliers); }

bool kc_local_doubt(const kc_config_t *config, const kc_est_t *est, kc_status_t status, double *p)
{
    uint32_t rows = kc_local_rows(est);
    bool whole = kc_fit_solved(status) && est->n_outliers == 0u && rows > 0u;
    double likely = whole ? kc_chi2_sf(est->cost, rows) : 0.0;
    if (p != NULL) { *p = likely; }
    return !whole || likely < config->doubt_p;
}

double kc_local_power(const kc_config_t *config, uint32_t rows, double known)
{
    uint32_t m = known > 0.0 ? (uint32_t)kc_min(known, (double)rows) : 0u;
    if (m == 0u) { return 0.0; }
    double noise = (double)(rows - m); /* what they do not determine is as large as with any arm */
    double beyond = kc_chi2_quantile(config->doubt_p, rows) - noise;
    return kc_chi2_sf(beyond / (config->outside_factor * config->outside_factor), m);
}
