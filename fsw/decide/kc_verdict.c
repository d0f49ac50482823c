#include "kc_verdict.h"

#include "kc_chi2.h"
#include "kc_libm.h"

/* More than this part (one in ...) of the poses rejected: what is left fits because it was chosen to. */
#define REJECTED_PART 4u

double kc_verdict_p_no_change(double chi2_gain, double noise_scale, uint32_t rank)
{
    double scale = kc_max(1.0, noise_scale);
    return rank == 0u ? 1.0 : kc_chi2_sf(kc_max(0.0, chi2_gain) / (scale * scale), rank);
}

bool kc_verdict_all_rejected(const kc_est_t *est)
{
    return est->opt.outlier_max > 0u && est->n_outliers >= est->opt.outlier_max;
}

bool kc_verdict_newest_rejected(const kc_est_t *est)
{
    return est->n_obs > 0u && est->outlier[est->n_obs - 1u] != 0u;
}

static bool many_rejected(const kc_est_t *est) { return REJECTED_PART * est->n_outliers > est->n_obs; }

static bool poor(const kc_config_t *config, const kc_est_t *est, kc_status_t status,
                 const kc_verdict_fit_t *fit)
{
    bool all_rejected = kc_verdict_all_rejected(est);
    return status != KC_OK || est->dof == 0u || many_rejected(est) || kc_verdict_newest_rejected(est) ||
           fit->noise_scale > config->poor_noise_scale ||
           ((fit->noise_scale > config->poor_noise_scale_unlikely || all_rejected) &&
            fit->p_fit < config->poor_p_fit);
}

double kc_verdict_level(const kc_config_t *config, bool tested_early)
{
    return tested_early ? 0.5 * config->no_change_p : config->no_change_p;
}

kc_verdict_t kc_verdict(const kc_config_t *config, const kc_est_t *est, kc_status_t status,
                        const kc_verdict_fit_t *fit, bool tested_early)
{
    if (poor(config, est, status, fit)) { return KC_VERDICT_POOR; }
    return fit->p_no_change > kc_verdict_level(config, tested_early) ? KC_VERDICT_NO_CHANGE
                                                                     : KC_VERDICT_CHANGE;
}

bool kc_verdict_acceptable(const kc_config_t *config, const kc_verdict_case_t *proposed)
{
    const kc_config_t *c = config;
    return c->accept_on_board && proposed->determined && !proposed->bounds_active &&
           !proposed->all_rejected && proposed->p_fit >= c->accept_p_fit_min &&
           proposed->sigma_pos_m <= c->accept_sigma_max_pos_m &&
           proposed->change_pos_m <= c->accept_change_max_pos_m;
}
