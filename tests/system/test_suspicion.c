/* kc_suspicion.c: a calibration from what the monitor suspects. */
#include <math.h>
#include <string.h>

#include "given_small_arm.h"
#include "given_world.h"
#include "kc_local.h"
#include "kc_suspicion.h"
#include "unity.h"

#define APP (&kc_app_instance)
#define N_LOCAL 9u
#define ANY 10.0 /* m: every pose is safe */
#define PHI(j) (4u * (j)) /* coefficient: offset of joint j, from 0 */

/* Encoders slipped by these, no other error; local initial poses chosen by information. */
static void given_slipped(const double bias[7])
{
    given_world();
    for (uint32_t j = 0u; j < 7u; j++) { world.truth.joint[j].phi_rad += bias[j]; }
    world.config.search_steps = 0u;
    given_local_poses(N_LOCAL, 0u);
    world.config.acquisition = KC_ACQ_DOPT;
    world.config.initial_design = KC_INITIAL_INFORMATION;
    world.config.local_safe_m = ANY;
    world.config.leave_safe_m = ANY;
    world.config.power_min = 0.0;
    world.noise_m = 5e-4;
    world.noise_rad = 3.5e-3;
}

static const double FOURTH[7] = {0.0, 0.0, 0.0, 0.08, 0.0, 0.0, 0.0};

void setUp(void) { given_slipped(FOURTH); }

/* Idle, and the monitor names joints with these chances, as if it had weighed them. */
static void given_named(const double chance[KC_JOINT_MAX])
{
    world_boot();
    world_ticks(10u);
    world.requested = true;
    world.frame_requested = 9000;
    world_tick(); /* its window is that of the tables in force */
    kc_suspects_t *s = &APP->monitoring.suspects;
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) {
        s->chance[j] = chance[j];
        if (chance[j] > 0.5) { s->joints |= 1u << j; }
        if (chance[j] > 0.01) { s->suspects |= 1u << j; }
    }
}

static void given_certain(uint32_t joint)
{
    double chance[KC_JOINT_MAX] = {0.0};
    chance[joint] = 1.0;
    given_named(chance);
}

static int32_t start(int32_t suspects)
{
    world_cmd(KC_CMD_START, -1, 6, 1)->arg_i[3] = suspects;
    world_tick();
    return world.ack.status;
}

static void to_the_end(void)
{
    TEST_ASSERT_TRUE(world_until(KC_ST_REVIEW, 6000u));
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_CHANGE, world.proposal.verdict);
}

/* Largest error of the estimated offsets, over how large it may be by chance. */
static double worst_offset(const double *coef)
{
    double worst = 0.0;
    for (uint32_t j = 0u; j < 7u; j++) {
        double truth = world.truth.joint[j].phi_rad - world.arm.joint[j].phi_rad;
        worst = fmax(worst, fabs(coef[PHI(j)] - truth));
    }
    return worst;
}

/* ---- a calibration ---- */

void test_a_right_suspicion_is_a_good_correction_from_the_first_pose_on(void)
{
    given_certain(3u);
    TEST_ASSERT_EQUAL_INT(KC_OK, start(1));
    to_the_end();
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_CAL_SUSPECTS_DROPPED));
    for (uint32_t i = 0u; i < world.n_progress; i++) {
        TEST_ASSERT_TRUE(worst_offset(world.progress[i].coef) < 0.006);
    }
    setUp();
    given_certain(3u);
    TEST_ASSERT_EQUAL_INT(KC_OK, start(0));
    to_the_end();
    TEST_ASSERT_TRUE(worst_offset(world.progress[0].coef) > 0.012); /* without it one pose is not enough */
}

/* Joint 2 is named with certainty, and it is joint 4. */
void test_a_wrong_suspicion_is_dropped_and_the_correction_is_right(void)
{
    given_certain(1u);
    TEST_ASSERT_EQUAL_INT(KC_OK, start(1));
    TEST_ASSERT_TRUE(world_until_event(KC_EVT_CAL_SUSPECTS_DROPPED, 2000u));
    const kc_event_t *e = &world.last[KC_EVT_CAL_SUSPECTS_DROPPED];
    TEST_ASSERT_TRUE(e->index >= 1 && e->index <= 3);
    TEST_ASSERT_TRUE(e->got < world.config.doubt_p);
    TEST_ASSERT_EQUAL_DOUBLE(world.config.doubt_p, e->want);
    TEST_ASSERT_EQUAL_UINT8(0u, APP->est.by_prior);
    TEST_ASSERT_EQUAL_INT((int)APP->est.n_obs, (int)APP->plan.n_obs); /* nothing that was measured is lost */
    TEST_ASSERT_TRUE(APP->est.n_obs > 0u);
    to_the_end();
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_SUSPECTS_DROPPED));
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_CAL_MODEL_MISMATCH));
    TEST_ASSERT_TRUE(worst_offset(world.proposal.kin.value) < 0.01);
    TEST_ASSERT_EQUAL_UINT32(28u, world.proposal.rank);
}

/* One that is outside its bounds is stopped as without a suspicion. */
void test_an_arm_outside_its_bounds_is_stopped_whatever_is_suspected(void)
{
    for (int32_t suspects = 0; suspects < 2; suspects++) {
        setUp();
        world.config.power_min = 0.95;
        world.config.mismatch_pos_m = 0.02;
        world.config.mismatch_rot_rad = 0.06;
        world.truth.joint[2].d_m += 0.2;
        for (uint32_t c = 0u; c < 28u; c++) {
            world.terms.coef[c].lb *= 0.1;
            world.terms.coef[c].ub *= 0.1;
        }
        given_certain(3u);
        TEST_ASSERT_EQUAL_INT(KC_OK, start(suspects));
        TEST_ASSERT_TRUE(world_until(KC_ST_SAFE, 6000u));
        TEST_ASSERT_EQUAL_UINT32((uint32_t)suspects, world_events(KC_EVT_CAL_SUSPECTS_DROPPED));
        TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_CAL_MODEL_MISMATCH));
        TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_CAL_LEAVES_PARK));
    }
}

/* The suspicion is certain of every coefficient, so by it every pose would be safe at once. */
void test_what_is_safe_is_predicted_by_the_bounds(void)
{
    uint32_t local[2];
    for (uint32_t k = 0u; k < 2u; k++) {
        setUp();
        world.config.rest_part = 1e-6;
        world.config.leave_safe_m = 0.004;
        world.config.doubt_p = 1e-300; /* whatever is seen */
        given_certain(3u);
        TEST_ASSERT_EQUAL_INT(KC_OK, start((int32_t)k));
        to_the_end();
        for (local[k] = 0u; world.meas[local[k]].candidate >= (int32_t)(world.space.n_cand - N_LOCAL);) {
            local[k]++;
        }
        TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_CAL_SUSPECTS_DROPPED));
    }
    TEST_ASSERT_TRUE(local[0] > 2u);
    TEST_ASSERT_TRUE(local[1] >= local[0]);
}

/* The power to notice an arm outside its bounds, too. */
void test_the_power_is_that_by_the_bounds(void)
{
    world.config.rest_part = 1e-6;
    world.config.doubt_p = 1e-300;
    world.config.power_min = 0.999999;
    given_certain(3u);
    TEST_ASSERT_EQUAL_INT(KC_OK, start(1));
    to_the_end();
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_CAL_LEAVES_PARK));
    for (uint32_t i = 0u; i < N_LOCAL; i++) {
        TEST_ASSERT_TRUE(world.meas[i].candidate >= (int32_t)(world.space.n_cand - N_LOCAL));
    }
}

void test_the_check_of_a_suspicion_is_charged(void)
{
    static kc_out_t out;
    given_certain(3u);
    TEST_ASSERT_EQUAL_INT(KC_OK, start(1));
    TEST_ASSERT_TRUE(world_until(KC_ST_LEARN, 2000u));
    kc_work_t work[2] = {kc_work_unlimited(), kc_work_unlimited()};
    for (uint32_t k = 0u; k < 2u; k++) {
        APP->est.by_prior = (uint8_t)(1u - k);
        kc_update_begin(&APP->update);
        (void)kc_update_learn(&APP->update, &APP->latest, &APP->est, &APP->plan, &APP->arena.calibration,
                              &APP->view, &work[k], &out);
    }
    TEST_ASSERT_TRUE(work[0].used >= work[1].used + KC_LOCAL_DOUBT_COST ||
                     work[0].used > KC_LOCAL_DOUBT_COST);
}
