/* kc_update.c: what each state of an update makes of the newest pose, call by call. Whole calibrations: test_update.c. */
#include "kc_update.h"

#include <math.h>
#include <string.h>

#include "given_parts.h"
#include "kc_suspicion.h"
#include "kc_vec.h"
#include "unity.h"

#define POSES 10u
#define PHI 0.02 /* joint 7 is off by this */

static kc_update_t s_update;
static kc_arena_calibration_t s_arena;
static kc_evaluation_t s_evaluation;
static kc_evaluated_t s_evaluated;
static kc_work_t s_work;
static kc_config_t *s_config;
static kc_est_t *const s_est = &parts.est;
static kc_latest_t *const s_latest = &parts.latest;

static void given_poses(uint32_t n, double phi_rad, double noise)
{
    kc_update_start(s_latest, s_est, &s_arena, &parts.view, parts.tables.active.config.est.free_mask);
    given_measured(n, phi_rad, noise, 0.0);
    kc_update_begin(&s_update);
    s_work = kc_work_unlimited();
}

void setUp(void)
{
    given_parts();
    s_config = &parts.tables.active.config;
    parts.plan.n_min = 3u;
    given_poses(POSES, PHI, 0.1);
}

/* From suspects that say that nothing is wrong. */
static void given_prior(void)
{
    static const kc_suspects_t suspects;
    kc_suspicion_begin(s_est, &parts.view, &suspects, &parts.out);
    memset(&parts.out, 0, sizeof parts.out);
}

static kc_outcome_id_t solve(void)
{
    return kc_update_solve(&s_update, s_latest, s_est, &s_arena.gp, &parts.view, &s_work).id;
}

static kc_outcome_id_t refine(void)
{
    return kc_update_refine(&s_update, s_latest, s_est, &parts.view, &s_work).id;
}

static kc_outcome_t learn(void)
{
    memset(&parts.out, 0, sizeof parts.out);
    return kc_update_learn(&s_update, s_latest, s_est, &parts.plan, &s_arena, &parts.view, &s_work,
                           &parts.out);
}

static kc_outcome_id_t report(void)
{
    memset(&parts.out, 0, sizeof parts.out);
    return kc_update_report(&s_update, s_latest, &s_evaluated, &s_evaluation, &parts.view, &s_work,
                            &parts.out)
        .id;
}

/* UPDATE, and as far as LEARN or REPORT. */
static void solved(void)
{
    kc_update_begin(&s_update);
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, solve());
    kc_update_begin(&s_update);
}

static void learn_all(void)
{
    solved();
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, learn().id);
    kc_update_begin(&s_update);
}

/* ---- START ---- */

void test_a_calibration_begins_with_nothing_of_the_one_before(void)
{
    memset(s_latest, 0x5a, sizeof *s_latest);
    memset(&s_arena, 0x5a, sizeof s_arena);
    memset(s_est, 0x5a, sizeof *s_est);
    parts.tables.active.kin.value[3] = 0.25;
    kc_update_start(s_latest, s_est, &s_arena, &parts.view, 0x30u);
    TEST_ASSERT_EQUAL_PTR(&parts.tables.active.arm, s_est->arm);
    TEST_ASSERT_EQUAL_PTR(&parts.tables.active.terms, s_est->terms);
    TEST_ASSERT_EQUAL_UINT64(0x30u, s_est->opt.free_mask);
    TEST_ASSERT_EQUAL_DOUBLE(s_config->est.outlier_p, s_est->opt.outlier_p);
    TEST_ASSERT_EQUAL_UINT32(0u, s_est->hold_none + s_est->without + s_est->n_obs + s_est->rank +
                                     s_est->n_free + s_est->by_prior + s_est->by_bounds);
    TEST_ASSERT_EQUAL_DOUBLE(0.25, s_latest->coef[3]);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_latest->f);
    TEST_ASSERT_EQUAL_INT(KC_ENDED_NOT, s_latest->ended);
    TEST_ASSERT_TRUE(s_latest->gp_ok);
    for (uint32_t c = 0u; c < 9u; c++) { /* where the tool is at each candidate */
        const kc_cand_t *at = &parts.tables.active.space.cand[c];
        double same = 0.0;
        for (uint32_t i = 0u; i < 3u; i++) {
            TEST_ASSERT_DOUBLE_WITHIN(1e-6, (double)at->p_m[i], s_arena.cand_pt[c].p_m[i]);
        }
        for (uint32_t i = 0u; i < 4u; i++) { same += (double)at->q_wxyz[i] * s_arena.cand_pt[c].q_wxyz[i]; }
        TEST_ASSERT_DOUBLE_WITHIN(1e-6, 1.0, fabs(same));
        TEST_ASSERT_EQUAL_MEMORY(at->q_seed, &s_arena.cand_q[c * KC_JOINT_MAX], sizeof at->q_seed);
    }
    TEST_ASSERT_EACH_EQUAL_HEX8(0x5a, &s_arena.cand_q[9u * KC_JOINT_MAX],
                                KC_JOINT_MAX * sizeof s_arena.cand_q[0]);
    s_config->initial_design = KC_INITIAL_INFORMATION;
    kc_update_start(s_latest, s_est, &s_arena, &parts.view, 0x30u);
    TEST_ASSERT_EQUAL_UINT8(1u, s_est->by_bounds);
}

void test_the_begin_of_a_calibration_is_charged_candidate_by_candidate(void)
{
    kc_space_t *s = &parts.tables.active.space;
    s->n_cand = 0u;
    uint64_t none = kc_update_start_cost(&parts.view), one_more = 0u;
    for (uint32_t n = 1u; n < 4u; n++) {
        s->n_cand = n;
        one_more = (kc_update_start_cost(&parts.view) - none) / n;
        TEST_ASSERT_TRUE(one_more > kc_kernel_cost(&parts.tables.active.kernel));
        TEST_ASSERT_EQUAL_UINT64(none + n * one_more, kc_update_start_cost(&parts.view));
    }
    TEST_ASSERT_TRUE(none > one_more);
}

/* ---- UPDATE ---- */

/* By the correction so far, which is nominal: joint 7 alone turns the tool. Objective of the poses, not of what was
 * observed on the way. */
void test_the_newest_pose_is_judged_by_the_estimate_before_it(void)
{
    double dp[POSES], dr[POSES], y[KC_MEAS_MAX];
    parts.plan.obs_of[0] = 1u; /* one observation on the way to the first */
    for (uint32_t k = 1u; k < POSES - 1u; k++) { parts.plan.obs_of[k] = (uint8_t)(k + 1u); }
    parts.plan.n_meas = POSES - 1u;
    s_latest->n_checked = 4u;
    s_latest->dr_rad[POSES] = -1.0; /* not observed */
    s_config->stop_rot_rad = 1.0;
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, solve());
    for (uint32_t i = 0u; i < POSES; i++) { TEST_ASSERT_DOUBLE_WITHIN(2e-3, PHI, s_latest->dr_rad[i]); }
    TEST_ASSERT_EQUAL_DOUBLE(-1.0, s_latest->dr_rad[POSES]);
    for (uint32_t k = 0u; k < POSES - 1u; k++) {
        dp[k] = s_latest->dp_m[parts.plan.obs_of[k]];
        dr[k] = s_latest->dr_rad[parts.plan.obs_of[k]];
    }
    kc_acq_objective(dp, dr, POSES - 1u, s_config->a1, s_config->sp_floor_m, s_config->sq_floor_rad, y);
    TEST_ASSERT_EQUAL_DOUBLE_ARRAY(y, s_latest->y, POSES - 1u);
    TEST_ASSERT_EQUAL_DOUBLE(y[POSES - 2u], s_latest->f);
    TEST_ASSERT_EQUAL_DOUBLE(s_latest->dp_m[POSES - 1u], s_latest->res.pos_m);
    TEST_ASSERT_EQUAL_DOUBLE(s_latest->dr_rad[POSES - 1u], s_latest->res.rot_rad);
    TEST_ASSERT_TRUE(s_latest->gp_sigma > 0.0);
    TEST_ASSERT_EQUAL_UINT32(5u, s_latest->n_checked); /* predicted as well as required, once more */
    TEST_ASSERT_EQUAL_INT(KC_OK, s_latest->status);
    TEST_ASSERT_DOUBLE_WITHIN(2e-3, PHI, s_est->coef[24]);
    TEST_ASSERT_EQUAL_UINT8(0u, s_est->hold_none);
    s_config->stop_rot_rad = 1e-6;
    s_latest->gp_ok = false;
    s_latest->gp_mean = 3.0;
    solved();
    TEST_ASSERT_EQUAL_UINT32(0u, s_latest->n_checked);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_latest->gp_sigma + s_latest->gp_mean);
    s_config->stop_rot_rad = s_config->stop_pos_m = 0.0; /* nothing is required: no pose meets it */
    solved();
    TEST_ASSERT_EQUAL_UINT32(0u, s_latest->n_checked);
}

void test_few_observations_hold_no_coefficient(void)
{
    static const struct {
        uint32_t n_local, n_min;
        uint8_t by_information, by_prior, hold_none;
    } cases[] = {{0u, 3u, 0u, 0u, 0u}, {POSES, 3u, 0u, 0u, 1u}, {4u, 6u, 1u, 0u, 0u},
                 {4u, 7u, 1u, 0u, 1u}, {4u, 7u, 0u, 0u, 0u},    {0u, 3u, 0u, 1u, 1u}};
    for (uint32_t i = 0u; i < sizeof cases / sizeof cases[0]; i++) {
        setUp();
        parts.plan.n_local = cases[i].n_local;
        parts.plan.n_min = cases[i].n_min;
        parts.plan.by_information = cases[i].by_information != 0u;
        if (cases[i].by_prior) { given_prior(); }
        (void)solve();
        TEST_ASSERT_EQUAL_UINT8(cases[i].hold_none, s_est->hold_none);
        TEST_ASSERT_EQUAL_UINT8(cases[i].by_information, s_est->by_bounds);
    }
}

/* An estimate that was made before the newest pose, and by which that is near, is trusted. */
void test_an_estimate_that_predicted_the_newest_pose_better_is_trusted(void)
{
    s_latest->status = KC_OK;
    s_est->coef[24] = PHI;
    (void)solve();
    TEST_ASSERT_TRUE(s_latest->trusted);
    setUp();
    s_latest->status = KC_OK; /* it is as far off as the correction */
    s_est->coef[24] = 0.0;
    (void)solve();
    TEST_ASSERT_FALSE(s_latest->trusted);
    setUp();
    s_latest->status = KC_ERR_NUM; /* it has failed */
    s_est->coef[24] = PHI;
    (void)solve();
    TEST_ASSERT_FALSE(s_latest->trusted);
    setUp();
    given_poses(1u, PHI, 0.1);
    s_est->coef[24] = PHI; /* the first pose: there was none */
    (void)solve();
    TEST_ASSERT_FALSE(s_latest->trusted);
}

/* The part that begins when the residuals are done is charged by itself, and begins with the charge: called with ever
 * more work left in the step. Returns how often the residuals were done and the part waited. */
static uint32_t waits(uint32_t part)
{
    static kc_est_t est;
    static kc_latest_t latest;
    static kc_arena_calibration_t arena;
    uint32_t n = 0u;
    est = *s_est;
    latest = *s_latest;
    arena = s_arena;
    for (uint64_t left = 0u; left < KC_STEP_WORK; left += 2000u) {
        *s_est = est;
        *s_latest = latest;
        s_arena = arena;
        kc_update_begin(&s_update);
        s_update.part = part;
        s_work = (kc_work_t){left + 1u, 1u};
        kc_outcome_id_t oc = part == 0u ? solve() : learn().id;
        TEST_ASSERT_TRUE(s_work.used <= left + 1u);
        if (s_update.part != part) { return n; }
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, oc);
        TEST_ASSERT_EQUAL_MEMORY(&est.job, &s_est->job, sizeof est.job);
        TEST_ASSERT_EQUAL_UINT32(arena.gp.n, s_arena.gp.n);
        n += s_update.i == POSES;
    }
    TEST_FAIL_MESSAGE("it has never begun");
    return 0u;
}

void test_what_does_not_fit_into_a_step_waits(void)
{
    learn_all(); /* so that the process holds something */
    TEST_ASSERT_TRUE(waits(0u) > 0u);
    TEST_ASSERT_TRUE(waits(1u) > 0u);
    kc_update_begin(&s_update);
    s_latest->gp_ok = false; /* which costs nothing then */
    s_work = (kc_work_t){kc_model_cost(s_est->arm, s_est->terms, s_latest->coef, false), 0u};
    (void)solve();
    TEST_ASSERT_EQUAL_UINT32(0u, s_update.part);
    TEST_ASSERT_EQUAL_UINT32(1u, s_update.i);
}

/* ---- REFINE ---- */

void test_a_good_fit_or_one_from_the_same_start_is_not_tried_again(void)
{
    for (uint32_t bad = 0u; bad < 2u; bad++) {
        solved();
        if (bad) { s_config->second_start_noise_scale = 1e-9; }
        TEST_ASSERT_EQUAL_INT(KC_OC_DONE, refine());
        TEST_ASSERT_EQUAL_UINT32(0u, s_update.part);
    }
    s_config->second_start_noise_scale = 2.0;
    s_latest->coef[24] = 0.01;
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, refine());
    TEST_ASSERT_EQUAL_UINT32(0u, s_update.part);
}

/* The second start is the latest correction; if the first was as good, the estimate is made from that again. */
void test_a_second_start_counts_if_it_is_better(void)
{
    for (uint32_t better = 0u; better < 2u; better++) {
        for (int by = -1; by < 2; by += 2) {
            setUp();
            solved();
            const double coef = s_est->coef[24];
            s_config->second_start_noise_scale = 1e-9;
            s_latest->coef[24] = (double)by * 0.0625;
            s_work = (kc_work_t){1u, 1u}; /* used up: the estimate is begun, and waits */
            TEST_ASSERT_EQUAL_INT(KC_OC_STAY, refine());
            TEST_ASSERT_EQUAL_UINT32(1u, s_update.part);
            TEST_ASSERT_EQUAL_DOUBLE((double)by * 0.0625, s_est->start[24]);
            if (better) { s_update.first.n_outliers = 9u; }
            s_work = kc_work_unlimited();
            TEST_ASSERT_EQUAL_INT(KC_OC_DONE, refine());
            TEST_ASSERT_EQUAL_UINT32(better ? 1u : 2u, s_update.part);
            TEST_ASSERT_EQUAL_DOUBLE(better ? (double)by * 0.0625 : 0.0, s_est->start[24]);
            TEST_ASSERT_DOUBLE_WITHIN(1e-6, coef, s_est->coef[24]);
        }
    }
}

/* ---- LEARN ---- */

void test_each_outlier_that_comes_or_goes_is_reported_by_its_pose(void)
{
    static const struct {
        bool was, is, extra;
        kc_event_id_t event;
    } cases[] = {{false, true, false, KC_EVT_CAL_OUTLIER},
                 {true, false, false, KC_EVT_CAL_OUTLIER_ACCEPTED},
                 {false, true, true, KC_EVT_CAL_EXTRA_OUTLIER},
                 {true, false, true, KC_EVT_CAL_EXTRA_OUTLIER_ACCEPTED},
                 {true, true, false, KC_EVT_NONE}};
    for (uint32_t i = 0u; i < 5u; i++) {
        setUp();
        solved();
        parts.plan.taken_at[6] = (uint8_t)(cases[i].extra ? KC_AT_ARRIVAL : KC_AT_CANDIDATE);
        parts.plan.pose_of[6] = 5u;
        s_latest->outlier_reported[6] = cases[i].was;
        s_est->outlier[6] = cases[i].is;
        (void)learn();
        if (cases[i].event != KC_EVT_NONE) {
            expect_event(cases[i].event, 5, cases[i].extra ? 7.0 : 0.0, 0.0);
        }
        TEST_ASSERT_EQUAL_UINT32(0u, parts.out.events.n);
        TEST_ASSERT_EQUAL_UINT8(cases[i].is, s_latest->outlier_reported[6]);
    }
}

/* Determined, or held by nothing, or one that was trusted. */
void test_which_estimate_becomes_the_correction_for_aiming(void)
{
    static const struct {
        kc_status_t status;
        uint32_t less_rank;
        uint8_t hold_none;
        bool trusted, taken;
    } cases[] = {{KC_OK, 0u, 0u, false, true},
                 {KC_OK, 1u, 0u, false, false},
                 {KC_OK, 1u, 1u, false, true},
                 {KC_OK, 1u, 0u, true, true},
                 {KC_ERR_NUM, 0u, 0u, true, false}};
    for (uint32_t i = 0u; i < 5u; i++) {
        setUp();
        solved();
        s_latest->status = cases[i].status;
        s_latest->trusted = cases[i].trusted;
        s_est->rank -= cases[i].less_rank;
        s_est->hold_none = cases[i].hold_none;
        s_latest->coef[24] = 0.5;
        TEST_ASSERT_EQUAL_INT(KC_OC_DONE, learn().id);
        TEST_ASSERT_EQUAL_DOUBLE(cases[i].taken ? s_est->coef[24] : 0.5, s_latest->coef[24]);
        if (cases[i].status != KC_OK) { expect_event(KC_EVT_CAL_EST, -1, KC_ERR_NUM, 0.0); }
        TEST_ASSERT_EQUAL_UINT32(0u, parts.out.events.n);
    }
}

/* Objective of all poses with the new estimate, the newest pose where it was measured; without room it is lost. */
void test_the_gaussian_process_learns_f_of_all_poses_anew(void)
{
    learn_all();
    TEST_ASSERT_EQUAL_UINT32(1u, s_arena.gp.n);
    TEST_ASSERT_EQUAL_MEMORY(s_est->obs[POSES - 1u].p_m, s_arena.gp.x[0].p_m, 3u * sizeof(double));
    TEST_ASSERT_EQUAL_MEMORY(s_est->obs[POSES - 1u].q_wxyz, s_arena.gp.x[0].q_wxyz, 4u * sizeof(double));
    TEST_ASSERT_EQUAL_DOUBLE(s_latest->y[0], s_arena.gp.y[0]);
    TEST_ASSERT_TRUE(s_latest->dr_rad[0] < 0.1 * PHI);
    s_arena.gp.n = KC_MEAS_MAX;
    learn_all();
    TEST_ASSERT_FALSE(s_latest->gp_ok);
    learn_all(); /* and the calibration goes on */
}

void test_hyperparameters_are_chosen_when_the_table_asks(void)
{
    for (uint32_t choose = 0u; choose < 2u; choose++) {
        setUp();
        parts.tables.active.kernel.choose = (uint8_t)choose;
        parts.tables.active.kernel.hyper[0].sigma_s = 1e-3; /* f = -1 cannot come from that */
        given_poses(1u, PHI, 0.1);
        learn_all();
        TEST_ASSERT_EQUAL_UINT32(choose, s_arena.gp.hyper);
    }
}

void test_a_pose_that_no_correction_explains_ends_it(void)
{
    for (uint32_t off = 0u; off < 2u; off++) {
        setUp();
        s_config->mismatch_pos_m = 0.005;
        s_config->est.outlier_max = 0u;
        given_poses(POSES, PHI, 0.1);
        if (off) { s_est->obs[POSES - 1u].p_m[1] += 0.05; }
        solved();
        kc_outcome_t oc = learn();
        TEST_ASSERT_EQUAL_INT(off ? KC_OC_ABORT : KC_OC_DONE, oc.id);
        TEST_ASSERT_EQUAL_UINT32(off, parts.out.events.n);
        if (!off) { continue; }
        TEST_ASSERT_EQUAL_INT(KC_CAUSE_MODEL_MISMATCH, oc.cause);
        expect_event(KC_EVT_CAL_MODEL_MISMATCH, (int32_t)parts.plan.pose_of[parts.out.events.e[0].index - 1],
                     parts.out.events.e[0].got, parts.out.events.e[0].want);
    }
}

/* The others agree without it, but it is no bad detection if the pose was seen alike twice. */
void test_a_pose_that_was_left_out_and_seen_twice_alike_is_the_one_that_nothing_explains(void)
{
    parts.plan.n_local = parts.plan.n_meas;
    s_est->without = 3u;
    solved();
    s_latest->leave_out.decided = true;
    for (uint32_t k = 0u; k < POSES; k++) { parts.plan.cand_of[k] = (uint16_t)k; }
    parts.plan.cand_of[5] = 2u;
    s_est->obs[5] = s_est->obs[2];
    kc_outcome_t oc = learn();
    TEST_ASSERT_EQUAL_INT(KC_OC_ABORT, oc.id);
    TEST_ASSERT_EQUAL_INT(KC_CAUSE_MODEL_MISMATCH, oc.cause);
    const kc_event_t *e = parts.out.events.e;
    TEST_ASSERT_EQUAL_UINT16(KC_EVT_CAL_OUTLIER, e[0].id);
    TEST_ASSERT_EQUAL_UINT16(KC_EVT_CAL_MODEL_MISMATCH, e[1].id);
    TEST_ASSERT_EQUAL_INT32(parts.plan.pose_of[2], e[1].index);
    TEST_ASSERT_EQUAL_DOUBLE(s_latest->dp_m[2], e[1].got);
    TEST_ASSERT_EQUAL_DOUBLE(s_latest->dr_rad[2], e[1].want);
}

void test_a_prior_that_the_poses_contradict_is_dropped_and_the_estimate_made_again(void)
{
    given_poses(POSES, 10.0 * PHI, 0.1);
    given_prior();
    solved();
    s_latest->n_checked = 4u;
    TEST_ASSERT_EQUAL_INT(KC_OC_AGAIN, learn().id);
    TEST_ASSERT_EQUAL_UINT32(0u, s_latest->n_checked);
    TEST_ASSERT_EQUAL_UINT16(KC_EVT_CAL_SUSPECTS_DROPPED, parts.out.events.e[0].id);
    learn_all();
}

/* ---- REPORT ---- */

/* Over every candidate of a small space, each once; charged one by one. */
void test_the_prediction_is_the_mean_over_the_candidates(void)
{
    kc_residual_t sum2 = {0.0, 0.0};
    kc_fixed_t fixed;
    learn_all();
    kc_model_fix(s_est->arm, s_est->terms, s_est->coef, &fixed);
    for (uint32_t c = 0u; c < 9u; c++) {
        kc_ctx_t ctx;
        kc_eval_t eval;
        double cov[36];
        kc_view_ctx(&parts.view, c, &ctx);
        kc_est_pose_cov(s_est, &fixed, &ctx, &eval, cov);
        sum2.pos_m += cov[0] + cov[7] + cov[14];
        sum2.rot_rad += cov[21] + cov[28] + cov[35];
    }
    for (uint32_t large = 0u; large < 2u; large++) { /* residuals smaller, and larger than stated */
        uint32_t steps = 1u;
        s_est->noise_scale = large ? 3.0 : 0.5;
        const double scale = large ? 3.0 : 1.0;
        kc_update_begin(&s_update);
        for (s_work = (kc_work_t){1u, 0u}; report() == KC_OC_STAY; s_work = (kc_work_t){1u, 0u}) { steps++; }
        TEST_ASSERT_EQUAL_UINT32(9u, steps);
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, scale * sqrt(sum2.pos_m / 9.0), parts.out.progress.pred_pos_m);
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, scale * sqrt(sum2.rot_rad / 9.0), parts.out.progress.pred_rot_rad);
    }
}

void test_progress_says_what_was_learned(void)
{
    parts.cal = (kc_cal_t){
        .session = 2u, .candidate = 3, .replicate = 4, .chosen_by = 5, .acq_value = 6.5, .energy_j = 7.5};
    parts.servo_steps = 8u;
    learn_all();
    s_latest->status = KC_ERR_ITER;
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, report());
    const kc_progress_t *p = &parts.out.progress;
    const double got[] = {p->session,     p->pose,        p->n_goal,      p->candidate,
                          p->replicate,   p->servo_steps, p->acquisition, p->acquisition_value,
                          p->energy_j,    p->res_pos_m,   p->res_rot_rad, p->f,
                          p->gp_mean,     p->gp_sigma,    p->rank,        p->n_free,
                          p->dof,         p->chi2,        p->est_status,  p->fit_pos_m,
                          p->fit_rot_rad, p->coef[24]};
    const double want[] = {2,
                           POSES,
                           POSES,
                           3,
                           4,
                           8,
                           5,
                           6.5,
                           7.5,
                           s_latest->res.pos_m,
                           s_latest->res.rot_rad,
                           s_latest->f,
                           s_latest->gp_mean,
                           s_latest->gp_sigma,
                           s_est->rank,
                           s_est->n_free,
                           s_est->dof,
                           s_est->chi2,
                           KC_ERR_ITER,
                           s_est->fit_pos_m,
                           s_est->fit_rot_rad,
                           s_latest->coef[24]};
    TEST_ASSERT_EQUAL_DOUBLE_ARRAY(want, got, sizeof want / sizeof want[0]);
    TEST_ASSERT_TRUE(parts.out.has_progress);
    expect_event(KC_EVT_CAL_POSE, (int32_t)POSES, s_latest->res.pos_m, s_latest->res.rot_rad);
}

/* What ends it: a required rotation that the estimate meets or not, poses checked, the power of a test of the table in
 * force, and whether it was tested before. */
void test_it_ends_when_it_is_good_enough_or_the_table_in_force_is_right(void)
{
    static const struct {
        double phi_rad, noise, stop_rot_rad, power;
        uint32_t checks, n_min;
        bool tested;
        kc_ended_t ended;
        kc_event_id_t event; /* NONE: only CAL_POSE */
        bool tested_then;
    } cases[] = {
        {PHI, 0.1, 0.05, 0.0, 0u, 3u, false, KC_ENDED_REQUIREMENT, KC_EVT_CAL_CONVERGED, false},
        {PHI, 0.1, 0.0, 0.0, 0u, 3u, false, KC_ENDED_NOT, KC_EVT_NONE, false},
        {PHI, 0.1, 1e-6, 0.0, 0u, 3u, false, KC_ENDED_NOT, KC_EVT_NONE, false},
        {PHI, 0.1, 0.05, 0.0, 99u, 3u, false, KC_ENDED_NOT, KC_EVT_NONE, false},
        {PHI, 0.1, 0.05, 0.0, 0u, 99u, false, KC_ENDED_NOT, KC_EVT_NONE, false},
        /* a poor fit is not good enough */
        {PHI, 20.0, 0.9, 0.0, 0u, 3u, false, KC_ENDED_NOT, KC_EVT_NONE, false},
        /* a table that is right: tested at the power, or before */
        {0.0, 0.5, 0.05, 0.9, 99u, 3u, false, KC_ENDED_NO_CHANGE, KC_EVT_CAL_AGREES, true},
        {0.0, 0.5, 5e-3, 0.9999, 0u, 3u, false, KC_ENDED_NOT, KC_EVT_NONE, false},
        {0.0, 0.5, 0.05, 0.0, 0u, 3u, false, KC_ENDED_REQUIREMENT, KC_EVT_CAL_CONVERGED, false},
        {0.0, 0.5, 0.05, 0.9, 0u, 3u, true, KC_ENDED_REQUIREMENT, KC_EVT_CAL_CONVERGED, true},
        /* one that is wrong: looked at once; for certain before the power is reached */
        {PHI, 0.1, 0.05, 0.9, 99u, 3u, false, KC_ENDED_NOT, KC_EVT_CAL_DISAGREES, true},
        {PHI, 0.1, 0.05, 0.9, 99u, 3u, true, KC_ENDED_NOT, KC_EVT_NONE, true},
        {PHI, 0.1, 5e-3, 0.9999, 0u, 3u, false, KC_ENDED_REQUIREMENT, KC_EVT_CAL_CONVERGED, true},
    };
    for (uint32_t i = 0u; i < sizeof cases / sizeof cases[0]; i++) {
        setUp();
        s_config->stop_rot_rad = cases[i].stop_rot_rad;
        s_config->stop_checks = cases[i].checks;
        s_config->no_change_power = cases[i].power;
        s_config->est.outlier_p = 0.0;
        parts.plan.n_min = cases[i].n_min; /* besides local ones */
        parts.plan.n_local = 1u;
        if (cases[i].event == KC_EVT_CAL_AGREES) { parts.tables.active.camera.plate_sigma_rad = 0.01; }
        given_poses(POSES, cases[i].phi_rad, cases[i].noise);
        learn_all();
        s_latest->tested_early = cases[i].tested;
        TEST_ASSERT_EQUAL_INT(KC_OC_DONE, report());
        TEST_ASSERT_EQUAL_INT(cases[i].ended, s_latest->ended);
        TEST_ASSERT_EQUAL_INT(cases[i].tested_then, s_latest->tested_early);
        const kc_event_t *e = parts.out.events.e;
        TEST_ASSERT_EQUAL_UINT32(cases[i].event != KC_EVT_NONE ? 2u : 1u, parts.out.events.n);
        if (cases[i].event == KC_EVT_NONE) { continue; }
        TEST_ASSERT_EQUAL_UINT16(cases[i].event, e->id);
        const bool tested = cases[i].event != KC_EVT_CAL_CONVERGED;
        TEST_ASSERT_EQUAL_INT(tested ? (int32_t)POSES : -1, e->index);
        TEST_ASSERT_EQUAL_DOUBLE(tested ? s_evaluated.fit.p_no_change : s_evaluated.bound.pos_m, e->got);
        if (cases[i].event == KC_EVT_CAL_AGREES) {
            /* the power that it had, and what the camera chain left of it */
            const double level = kc_verdict_level(s_config, true);
            const double power = kc_evaluation_power(&s_evaluated, &s_evaluation, &parts.view, level, false);
            TEST_ASSERT_TRUE(power >= 0.9 && e->want > 0.5 && e->want < power - 1e-6);
            TEST_ASSERT_EQUAL_DOUBLE(
                kc_evaluation_power(&s_evaluated, &s_evaluation, &parts.view, level, true), e->want);
        } else {
            TEST_ASSERT_EQUAL_DOUBLE(tested ? 0.5 * s_config->no_change_p : 0.0, e->want);
        }
    }
}

void test_an_update_begins_at_its_first_part(void)
{
    kc_update_t cursor = {.part = 3u, .i = 7u, .sum2 = {1.0, 2.0}};
    kc_update_begin(&cursor);
    TEST_ASSERT_EQUAL_UINT32(0u, cursor.part);
    TEST_ASSERT_EQUAL_UINT32(0u, cursor.i);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, cursor.sum2.pos_m);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, cursor.sum2.rot_rad);
}
