#include "kc_fit.h"

#include "kc_chi2.h"
#include "kc_libm.h"

bool kc_fit_solved(kc_status_t status) { return status == KC_OK || status == KC_ERR_ITER; }

kc_fit_quality_t kc_fit_quality(const kc_est_t *est, kc_status_t status)
{
    return (kc_fit_quality_t){
        .status = status,
        .noise_scale = est->noise_scale,
        .cost = kc_fit_solved(status) ? est->cost : KC_INF,
        .n_outliers = est->n_outliers,
        .nothing_held = est->hold_none || est->rank == est->n_free,
    };
}

bool kc_fit_needs_second_start(const kc_config_t *config, const kc_fit_quality_t *first)
{
    return first->status != KC_OK || !(first->noise_scale <= config->second_start_noise_scale) ||
           first->n_outliers > 0u;
}

bool kc_fit_second_is_better(const kc_fit_quality_t *first, const kc_fit_quality_t *second)
{
    bool better = second->n_outliers < first->n_outliers ||
                  (second->n_outliers == first->n_outliers && second->cost < first->cost);
    return kc_fit_solved(second->status) && second->nothing_held && better;
}

static double weighted(const kc_config_t *config, kc_residual_t residual)
{
    return config->a1 * residual.pos_m / config->vopt_len_m + (1.0 - config->a1) * residual.rot_rad;
}

bool kc_fit_predicts_better(const kc_config_t *config, kc_residual_t with_new, kc_residual_t with_used)
{
    return 2.0 * weighted(config, with_new) < weighted(config, with_used);
}

/* Errors along three axes, alike and normal. */
#define AXES 3u
#define CHECK_P 1e-3 /* a pose that is predicted as well as required fails its check so rarely */

static bool within(double residual, double limit, const double *cov)
{
    double noise2 = (cov[0] + cov[7] + cov[14]) / (double)AXES;
    return limit <= 0.0 || residual * residual <= limit * limit + kc_chi2_quantile(CHECK_P, AXES) * noise2;
}

bool kc_fit_checked(const kc_config_t *config, kc_residual_t residual, const double cov[36])
{
    return within(residual.pos_m, config->stop_pos_m, cov) &&
           within(residual.rot_rad, config->stop_rot_rad, &cov[21]);
}

bool kc_fit_required(const kc_config_t *config)
{
    return config->stop_pos_m > 0.0 || config->stop_rot_rad > 0.0;
}

bool kc_fit_determined(const kc_est_t *est, kc_status_t status)
{
    return status == KC_OK && est->rank == est->n_free && est->dof >= est->n_free;
}

bool kc_fit_meets(const kc_config_t *config, kc_residual_t bound)
{
    const kc_config_t *c = config;
    return kc_fit_required(c) && (c->stop_pos_m <= 0.0 || bound.pos_m <= c->stop_pos_m) &&
           (c->stop_rot_rad <= 0.0 || bound.rot_rad <= c->stop_rot_rad);
}

/* Whether all coefficients of TERMS are requested: then residuals are not due to a choice of the operator. */
static bool all_requested(const kc_est_t *est)
{
    for (uint32_t c = 0u; c < est->terms->n_coef; c++) {
        if (est->terms->coef[c].enabled != 0u && (est->opt.free_mask >> c & 1u) == 0u) { return false; }
    }
    return true;
}

/* Local initial poses that are all a little off, or several that do not fit the others. Effects that a
 * model lacks are nearly the same at all of them, so they are not the reason. */
static bool local_mismatch(const kc_config_t *config, const kc_est_t *est, bool only_local)
{
    bool limited = config->mismatch_pos_m > 0.0 || config->mismatch_rot_rad > 0.0;
    bool noisy = est->dof >= config->mismatch_dof_min && est->noise_scale > config->mismatch_noise_scale;
    uint32_t n_outliers = est->n_outliers - (est->without > 0u ? 1u : 0u);
    return limited && only_local && est->hold_none && all_requested(est) &&
           (noisy || n_outliers >= config->mismatch_outliers_min);
}

static bool beyond(const kc_config_t *config, kc_residual_t residual)
{
    return (config->mismatch_pos_m > 0.0 && residual.pos_m > config->mismatch_pos_m) ||
           (config->mismatch_rot_rad > 0.0 && residual.rot_rad > config->mismatch_rot_rad);
}

bool kc_fit_mismatch(const kc_config_t *config, const kc_est_t *est, const kc_residual_t *residual,
                     const kc_plan_t *plan, uint32_t *worst)
{
    bool newest_too = local_mismatch(config, est, kc_plan_only_local(plan));
    uint32_t n = 0u, last = 0u; /* poses, and the last of them */
    *worst = 0u;
    if (est->rank < est->n_free && !est->hold_none) { return false; } /* a coefficient is held */
    for (uint32_t i = 0u; i < plan->n_obs; i++) {
        bool left_out = i + 1u == est->without;
        if (left_out || (!beyond(config, residual[i]) && (!newest_too || i + 1u != plan->n_obs))) {
            continue;
        }
        n += plan->pose_of[i] != last ? 1u : 0u;
        last = plan->pose_of[i];
        *worst = i;
    }
    return n >= (kc_plan_only_local(plan) ? 1u : 2u);
}
