/* A solution in parts. A phase is what is computed at once when the pass over the observations before it (and
 * the QP) is over; each names the next pass and the next phase. */
#include <string.h>

#include "kc_camera.h"
#include "kc_est_priv.h"
#include "kc_libm.h"

#define DAMP_START 1e-3
#define QP_ITER_MAX (KC_QP_ITER_PER_VAR * KC_COEF_MAX)

typedef enum {
    DONE = 0,
    BEFORE, /* sums at start: residual before */
    IDENTIFIED, /* R of all requested: which are estimated */
    COSTED, /* sums: a fit begins */
    LINEARISED, /* R: model of the cost */
    STEPPED, /* the QP is solved: a step to try */
    TRIED, /* sums, and R, at trial: is it taken? */
    ALL_RANKED, /* R of all requested at the solution */
    OWN_RANKED, /* R of those estimated there: does the decision still stand? */
    WEIGHED, /* R: the test of outliers begins */
    CHAINED, /* sums: what the camera chain explains */
    TESTED, /* the worst inlier is known */
    REPORTED, /* sums: chi2, RMS */
    CHECKED, /* R: KKT residual */
    INVERTED /* R of those not at a bound: covariance */
} phase_t;

static void pass_to(kc_est_t *est, phase_t phase, kc_est_pass_t pass, const double *at)
{
    kc_est_pass_begin(est, pass, at);
    est->job.phase = (uint8_t)phase;
}

/* A phase that needs sums and R at coef, which mostly are those of the last trial. */
static void next(kc_est_t *est, phase_t phase)
{
    pass_to(est, phase, est->job.fresh ? KC_EST_PASS_NONE : KC_EST_PASS_FOLD, est->coef);
    est->job.fresh = true;
}

static void end(kc_est_t *est, kc_status_t status)
{
    est->job.status = status;
    est->job.phase = (uint8_t)DONE;
}

/* ---- fit, and decide rank again at the solution: a nominal arm can be singular where the real one is not,
 * and the other way round. Coefficients that become held return to start. ---- */

static void report(kc_est_t *est)
{
    kc_est_job_t *job = &est->job;
    if (job->status == KC_ERR_NUM) {
        end(est, KC_ERR_NUM);
        return;
    }
    if (job->status == KC_ERR_RANK) {
        kc_est_to_start(est, ~(uint64_t)0u, job->requested);
        job->fresh = false;
    }
    next(est, REPORTED);
}

/* The rank stands. One pose at a time is rejected, the worst first, until none is unlikely. */
static void settled(kc_est_t *est)
{
    bool test = est->job.status == KC_OK && est->opt.outlier_p > 0.0 &&
                est->n_outliers < est->opt.outlier_max;
    if (test) {
        next(est, WEIGHED);
    } else {
        report(est);
    }
}

static void identified(kc_est_t *est)
{
    kc_est_job_t *job = &est->job;
    kc_est_identify(est, job->requested);
    const uint64_t held = kc_est_held(est);
    if (job->n_fits++ > 0u && held != 0u) {
        kc_est_to_start(est, held, job->requested);
        job->fresh = false;
    }
    if (est->rank == 0u) {
        job->status = KC_ERR_RANK;
        settled(est);
    } else {
        next(est, COSTED);
    }
}

/* A fit ended. Two equally good choices of which to hold are common (any one of a dependent set), so the sets
 * are not compared: the rank of all must be the same, and those estimated must be independent. */
static void fitted(kc_est_t *est, kc_status_t status)
{
    kc_est_job_t *job = &est->job;
    job->status = status;
    if (status == KC_ERR_NUM || est->hold_none || job->n_fits >= KC_EST_PASSES) {
        settled(est);
    } else {
        next(est, ALL_RANKED);
    }
}

static void all_ranked(kc_est_t *est)
{
    est->job.rank_all = kc_est_rank(est, est->qp.L); /* what it leaves there is not needed */
    kc_est_narrow(est);
    next(est, OWN_RANKED);
}

/* Without those that are held it is no other rank. */
static void own_ranked(kc_est_t *est)
{
    kc_est_job_t *job = &est->job;
    const bool narrowed = est->n_idx < est->n_free;
    const uint32_t own = narrowed ? kc_est_rank(est, est->qp.L) : job->rank_all;
    if (job->rank_all == est->rank && own == est->rank) {
        settled(est);
    } else {
        job->fresh = !narrowed; /* of all requested */
        next(est, IDENTIFIED);
    }
}

/* ---- damped Gauss-Newton ---- */

static void costed(kc_est_t *est)
{
    kc_est_job_t *job = &est->job;
    job->lambda = DAMP_START;
    job->cost = job->sums.chi2 + kc_est_prior_cost(est, est->coef);
    job->iter = 0u;
    if (kc_finite(job->cost)) {
        next(est, LINEARISED);
    } else {
        fitted(est, KC_ERR_NUM);
    }
}

/* After a step, or before the first of an iteration: the damping rises until the cost does not. */
static void go_on(kc_est_t *est, kc_est_step_t step)
{
    kc_est_job_t *job = &est->job;
    if (step == KC_EST_STEP_AGAIN) { step = kc_est_try(est); }
    if (step == KC_EST_STEP_AGAIN) {
        pass_to(est, STEPPED, KC_EST_PASS_QP, est->coef);
        return;
    }
    est->iters++;
    job->iter++;
    if (step == KC_EST_STEP_TAKEN && job->iter < est->opt.iter_max) {
        next(est, LINEARISED);
    } else {
        fitted(est, step == KC_EST_STEP_LAST ? KC_OK : KC_ERR_ITER);
    }
}

static void linearised(kc_est_t *est)
{
    kc_est_model(est);
    est->job.tries = 0u;
    go_on(est, KC_EST_STEP_AGAIN);
}

static void stepped(kc_est_t *est)
{
    kc_est_trial(est);
    pass_to(est, TRIED, KC_EST_PASS_FOLD, est->trial);
}

static void tried(kc_est_t *est)
{
    go_on(est, kc_est_compare(est, est->job.sums.chi2 + kc_est_prior_cost(est, est->trial)));
}

/* ---- outliers ---- */

static void weighed(kc_est_t *est)
{
    kc_est_job_t *job = &est->job;
    kc_est_fold_prior(est);
    job->worst = est->n_obs;
    job->p_worst = 1.0;
    job->n_tested = 0u;
    if (est->camera != NULL) {
        memset(&est->chain, 0, sizeof est->chain);
        pass_to(est, CHAINED, KC_EST_PASS_CHAIN, est->coef);
    } else {
        pass_to(est, TESTED, KC_EST_PASS_OUTLIER, est->coef);
    }
}

static void chained(kc_est_t *est)
{
    kc_est_chain_end(est);
    pass_to(est, TESTED, KC_EST_PASS_OUTLIER, est->coef);
}

static void tested(kc_est_t *est)
{
    kc_est_job_t *job = &est->job;
    if (job->worst >= est->n_obs || job->p_worst * (double)job->n_tested >= est->opt.outlier_p) {
        report(est);
        return;
    }
    est->outlier[job->worst] = 1u;
    est->n_outliers++;
    job->n_fits = 0u;
    job->fresh = false;
    next(est, IDENTIFIED);
}

/* ---- report ---- */

static void before(kc_est_t *est)
{
    const kc_est_sums_t *s = &est->job.sums;
    if (!kc_finite(s->chi2)) {
        end(est, KC_ERR_NUM);
        return;
    }
    est->before_pos_m = kc_est_rms(s->pos2, s->n_pos);
    est->before_rot_rad = kc_est_rms(s->rot2, s->n_rot);
    next(est, IDENTIFIED);
}

static void reported(kc_est_t *est)
{
    const kc_est_sums_t *s = &est->job.sums;
    est->cost = s->chi2 + kc_est_prior_cost(est, est->coef);
    est->chi2 = est->by_prior != 0u ? est->cost : s->chi2;
    est->fit_pos_m = kc_est_rms(s->pos2, s->n_pos);
    est->fit_rot_rad = kc_est_rms(s->rot2, s->n_rot);
    next(est, CHECKED);
}

static void checked(kc_est_t *est)
{
    kc_est_fold_prior(est);
    est->kkt = kc_est_kkt(est, est->cost);
    kc_est_take_inside(est);
    next(est, INVERTED);
}

static void inverted(kc_est_t *est)
{
    kc_est_narrow(est);
    const kc_status_t st = kc_est_covariance(est);
    const uint32_t rows = est->job.sums.rows + (est->by_prior != 0u ? est->n_free : 0u);
    est->dof = (rows > est->n_idx) ? rows - est->n_idx : 0u;
    est->noise_scale = (est->dof > 0u) ? kc_sqrt(est->chi2 / (double)est->dof) : 1.0;
    end(est, st != KC_OK ? st : est->job.status);
}

/* ---- steps ---- */

static void advance(kc_est_t *est)
{
    switch ((phase_t)est->job.phase) {
    case BEFORE: before(est); break;
    case IDENTIFIED: identified(est); break;
    case COSTED: costed(est); break;
    case LINEARISED: linearised(est); break;
    case STEPPED: stepped(est); break;
    case TRIED: tried(est); break;
    case ALL_RANKED: all_ranked(est); break;
    case OWN_RANKED: own_ranked(est); break;
    case WEIGHED: weighed(est); break;
    case CHAINED: chained(est); break;
    case TESTED: tested(est); break;
    case REPORTED: reported(est); break;
    case CHECKED: checked(est); break;
    default: inverted(est); break; /* INVERTED; at DONE there is nothing to advance */
    }
}

/* Bound of the instructions of advance(): of a phase that factors R, or of one that works on vectors. */
static uint64_t advance_cost(const kc_est_t *est)
{
    const uint64_t n = est->n_free;
    switch ((phase_t)est->job.phase) {
    case IDENTIFIED:
    case LINEARISED:
    case ALL_RANKED:
    case OWN_RANKED:
    case WEIGHED:
    case CHECKED:
    case INVERTED: return 20000u + 10u * n * n * n;
    case CHAINED: return 100000u + 3000u * n + 60u * n * n;
    default: return 5000u + 30u * n * n;
    }
}

/* Of one observation in a pass: its whitened rows, and their way into R. */
static uint64_t observation_cost(const kc_est_t *est)
{
    const uint64_t n = est->n_free;
    const bool chain = est->job.pass == (uint8_t)KC_EST_PASS_CHAIN ||
                       (est->job.pass == (uint8_t)KC_EST_PASS_OUTLIER && est->camera != NULL);
    return kc_model_cost(est->arm, est->terms, est->start, true) + 5000u + 150u * n + 25u * n * n +
           (chain ? KC_CAMERA_CHAIN_COST + 40000u + 1000u * n : 0u);
}

/* The pass over the observations; true when it is over. */
static bool pass(kc_est_t *est, kc_work_t *work)
{
    kc_est_job_t *job = &est->job;
    const uint64_t cost = observation_cost(est);
    if (job->pass == (uint8_t)KC_EST_PASS_NONE) { return true; }
    for (; job->i < est->n_obs; job->i++) {
        if (est->outlier[job->i] != 0u) { continue; }
        if (!kc_work_take(work, cost)) { return false; }
        if (job->pass == (uint8_t)KC_EST_PASS_FOLD) {
            kc_est_fold(est, job->i);
        } else if (job->pass == (uint8_t)KC_EST_PASS_CHAIN) {
            kc_est_chain_add(est, job->i);
        } else {
            kc_est_outlier_test(est, job->i);
        }
    }
    return true;
}

/* The QP; true when it is solved. */
static bool solve_qp(kc_est_t *est, kc_work_t *work)
{
    const uint64_t cost = kc_qp_cost(est->qp.n);
    while (est->job.i < QP_ITER_MAX) {
        if (!kc_work_take(work, cost)) { return false; }
        est->job.i = kc_qp_iterate(&est->qp) ? est->job.i + 1u : QP_ITER_MAX;
    }
    return true;
}

void kc_est_begin(kc_est_t *est)
{
    est->job = (kc_est_job_t){.phase = (uint8_t)DONE, .status = KC_ERR_ARG};
    if (!kc_est_options_good(est)) { return; }
    est->job.requested = kc_est_requested(est);
    kc_est_reset(est, est->job.requested);
    next(est, BEFORE);
}

bool kc_est_step(kc_est_t *est, kc_work_t *work)
{
    while (est->job.phase != (uint8_t)DONE) {
        bool qp = est->job.pass == (uint8_t)KC_EST_PASS_QP;
        if (!(qp ? solve_qp(est, work) : pass(est, work))) { return false; }
        if (!kc_work_take(work, advance_cost(est))) { return false; }
        advance(est);
    }
    return true;
}

kc_status_t kc_est_solve(kc_est_t *est)
{
    kc_work_t work = kc_work_unlimited();
    kc_est_begin(est);
    (void)kc_est_step(est, &work);
    return est->job.status;
}
