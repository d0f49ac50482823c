/* kc_monitoring.c: observations in normal operation feed the monitor; during a calibration nothing
 * changes. */
#include <math.h>
#include <string.h>

#include "given_world.h"
#include "unity.h"

#define APP (&kc_app_instance)

void setUp(void) { given_world(); }

/* Idle and settled, joint j standing `bias` beyond its reading. */
static void given_idle(uint32_t j, double bias)
{
    world.noise_m = 5e-4;
    world.noise_rad = 3.5e-3;
    world.bias[j] = bias;
    world_boot();
    world_ticks(4u);
}

/* Somebody else asks for n frames, each after the arm stood somewhere else. */
static void observations(uint32_t n)
{
    for (uint32_t i = 0u; i < n; i++) {
        for (uint32_t j = 0u; j < 7u; j++) {
            world.q_cmd[j] = world.q[j] = 0.3 + 0.17 * (double)((3u * i + 5u * j) % 7u);
        }
        world_ticks(2u);
        world.requested = true;
        world.frame_requested = 9000 + (int32_t)i;
        world_tick();
    }
}

void test_healthy_observations_raise_nothing(void)
{
    given_idle(0u, 0.0);
    observations(100u);
    TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_BOOT));
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_MON_SUSPECT));
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_MON_UNEXPLAINED));
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_DET_UNREQUESTED));
    TEST_ASSERT_EQUAL_UINT32(KC_MON_OBS_MAX, APP->arena.idle.monitor.n);
}

void test_a_joint_that_reads_wrong_is_named_within_5_observations(void)
{
    for (uint32_t j = 0u; j < 7u; j++) {
        given_world();
        given_idle(j, 0.03);
        observations(5u);
        const kc_event_t *e = &world.last[KC_EVT_MON_SUSPECT];
        TEST_ASSERT_TRUE(world_events(KC_EVT_MON_SUSPECT) >= 1u);
        TEST_ASSERT_EQUAL_INT((int)j + 1, e->index);
        TEST_ASSERT_DOUBLE_WITHIN(0.01, 0.03, e->got);
        TEST_ASSERT_TRUE(((uint32_t)e->want >> j & 1u) != 0u);
    }
}

void test_two_joints_at_once_are_named_together(void)
{
    given_idle(1u, 0.1);
    world.bias[3] = -0.08;
    observations(6u);
    const kc_event_t *e = &world.last[KC_EVT_MON_SEVERAL];
    TEST_ASSERT_TRUE(world_events(KC_EVT_MON_SEVERAL) >= 1u);
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_MON_UNEXPLAINED));
    TEST_ASSERT_TRUE(e->index == 2 || e->index == 4);
    TEST_ASSERT_EQUAL_DOUBLE(10.0, e->got); /* joints 2 and 4 */
    TEST_ASSERT_EQUAL_DOUBLE(10.0, e->want);
    const kc_mon_verdict_t *v = &APP->monitoring.newest;
    TEST_ASSERT_EQUAL_INT(KC_MON_SEVERAL, v->state);
    TEST_ASSERT_EQUAL_HEX32(0xau, v->suspects);
    TEST_ASSERT_EQUAL_INT(e->index, (int)v->joint + 1);
    TEST_ASSERT_DOUBLE_WITHIN(0.01, v->joint == 1u ? 0.1 : -0.08, v->bias);
    TEST_ASSERT_TRUE(v->sigma > 1e-4 && v->sigma < 0.01 && v->p <= KC_MON_P && v->p_rest > KC_MON_P_REST);
    world_ticks(11u);
    TEST_ASSERT_EQUAL_UINT32(6u, v->n_obs);
    for (uint32_t j = 0u; j < 7u; j++) {
        TEST_ASSERT_DOUBLE_WITHIN(0.01, j == 1u || j == 3u ? 1.0 : 0.0, world.hk.mon_chance[j]);
    }
    world.bias[1] = world.bias[3] = 0.0;
    observations(8u);
    world_ticks(11u);
    TEST_ASSERT_EQUAL_INT(KC_MON_QUIET, world.hk.mon_state);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, world.hk.mon_chance[1]);
    TEST_ASSERT_FALSE(kc_monitoring_names(&APP->monitoring, &APP->view));
}

void test_a_bent_link_is_unexplained(void)
{
    given_idle(0u, 0.0);
    world.truth.joint[1].alpha_rad += 0.1;
    world.truth.joint[2].d_m += 0.05;
    observations(6u);
    world_tick();
    TEST_ASSERT_TRUE(world_events(KC_EVT_MON_UNEXPLAINED) >= 1u);
    const kc_event_t *e = &world.last[KC_EVT_MON_UNEXPLAINED];
    TEST_ASSERT_EQUAL_INT(-1, e->index);
    TEST_ASSERT_TRUE(e->got > 0.01 && e->got < 0.5); /* m, of the newest observation */
    TEST_ASSERT_TRUE(e->want > 0.05 && e->want < 0.3); /* rad */
    TEST_ASSERT_FALSE(kc_monitoring_names(&APP->monitoring, &APP->view));
}

void test_observations_while_something_moves_or_has_not_settled_are_not_compared(void)
{
    given_idle(0u, 0.0);
    world.arm_vibrates = 1;
    world.requested = true;
    world_tick();
    world.requested = true; /* at rest again, but not for settle_us */
    world_tick();
    TEST_ASSERT_EQUAL_UINT32(2u, world_events(KC_EVT_MON_NOT_AT_REST));
    world_ticks(3u);
    world.arm_silent = true;
    world_ticks(8u);
    world.requested = true;
    world_tick();
    TEST_ASSERT_EQUAL_UINT32(3u, world_events(KC_EVT_MON_NOT_AT_REST));
    TEST_ASSERT_EQUAL_UINT32(0u, APP->arena.idle.monitor.n);
}

static void repeat(kc_detection_t *d) { d->t_us = APP->monitoring.t_us; }
static void early(kc_detection_t *d) { d->t_us = 1u; }
static void ahead(kc_detection_t *d) { d->t_us += 1000000u; }
static void crowd(kc_detection_t *d) { d->n_tags = 9u; }
static void stranger(kc_detection_t *d) { d->tag_id[0] = 17; }
static void vague(kc_detection_t *d) { d->cov[0] = 0.01; }

/* One more observation, spoiled: this event, and the monitor as before. */
static void refused(void (*spoil)(kc_detection_t *d), uint32_t event)
{
    static kc_monitor_t before;
    before = APP->arena.idle.monitor;
    uint32_t n = world_events(event);
    world.spoil = spoil;
    world.requested = true;
    world_tick();
    TEST_ASSERT_EQUAL_UINT32(n + 1u, world_events(event));
    TEST_ASSERT_EQUAL_MEMORY(&before, &APP->arena.idle.monitor, sizeof before);
}

void test_bad_observations_are_refused_with_their_event(void)
{
    given_idle(0u, 0.0);
    observations(3u);
    refused(repeat, KC_EVT_IN_STALE);
    refused(early, KC_EVT_DET_OLD);
    TEST_ASSERT_EQUAL_INT(-1, world.last[KC_EVT_DET_OLD].index);
    refused(ahead, KC_EVT_IN_RANGE);
    refused(crowd, KC_EVT_IN_RANGE);
    refused(stranger, KC_EVT_DET_UNKNOWN_TAG);
    refused(vague, KC_EVT_DET_UNCERTAIN);
    world.hide = 1;
    refused(NULL, KC_EVT_DET_NONE);
}

void test_only_idle_listens(void)
{
    given_idle(0u, 0.0);
    APP->place.state = KC_ST_SAFE;
    observations(2u);
    TEST_ASSERT_EQUAL_UINT32(2u, world_events(KC_EVT_DET_UNREQUESTED));
    TEST_ASSERT_EQUAL_UINT32(0u, APP->arena.idle.monitor.n);
}

static void evaluate(kc_work_t work)
{
    static kc_out_t out;
    kc_monitoring_evaluate(&APP->monitoring, &APP->arena.idle.monitor, &APP->view, &work, &out);
}

void test_the_verdict_waits_for_a_step_that_has_room_for_it(void)
{
    given_idle(2u, 0.05);
    observations(5u);
    world_tick();
    APP->monitoring.newest.state = KC_MON_QUIET;
    evaluate(kc_work_of_step());
    TEST_ASSERT_EQUAL_INT(KC_MON_QUIET, APP->monitoring.newest.state); /* nothing new */
    APP->monitoring.due = true;
    evaluate((kc_work_t){KC_STEP_WORK, KC_STEP_WORK});
    TEST_ASSERT_EQUAL_INT(KC_MON_QUIET, APP->monitoring.newest.state);
    evaluate(kc_work_of_step());
    TEST_ASSERT_TRUE(APP->monitoring.weigh); /* found; the joints behind it are weighed in the next step */
    TEST_ASSERT_EQUAL_INT(KC_MON_QUIET, APP->monitoring.newest.state);
    APP->monitoring.due = true; /* the weighing comes first */
    evaluate((kc_work_t){KC_STEP_WORK, KC_STEP_WORK});
    TEST_ASSERT_TRUE(APP->monitoring.weigh);
    evaluate(kc_work_of_step());
    TEST_ASSERT_EQUAL_INT(KC_MON_NAMED, APP->monitoring.newest.state);
    TEST_ASSERT_FALSE(APP->monitoring.weigh);
    TEST_ASSERT_TRUE(APP->monitoring.due);
}

void test_another_joint_that_explains_more_takes_the_place_of_the_one_found(void)
{
    given_idle(2u, 0.05);
    observations(5u);
    world_tick();
    kc_mon_verdict_t *found = &APP->monitoring.found;
    TEST_ASSERT_EQUAL_INT(KC_MON_NAMED, found->state);
    for (uint32_t k = 0u; k < 2u; k++) {
        found->joint = k == 0u ? 2u : 5u;
        found->bias = 0.04;
        APP->monitoring.weigh = true;
        evaluate(kc_work_unlimited());
        const kc_mon_verdict_t *v = &APP->monitoring.newest;
        TEST_ASSERT_EQUAL_INT(KC_MON_NAMED, v->state);
        TEST_ASSERT_EQUAL_UINT32(2u, v->joint);
        TEST_ASSERT_EQUAL_DOUBLE(k == 0u ? 0.04 : APP->monitoring.suspects.bias[2], v->bias);
    }
    TEST_ASSERT_DOUBLE_WITHIN(5e-3, 0.05, APP->monitoring.newest.bias);
}

/* Joint 4 is certain; that joint 3 is the other one is only likely. */
void test_of_two_joints_the_surer_one_is_reported(void)
{
    given_idle(3u, 0.1);
    world.bias[2] = 0.004;
    observations(6u);
    world_tick();
    const kc_suspects_t *s = &APP->monitoring.suspects;
    TEST_ASSERT_EQUAL_INT(KC_MON_SEVERAL, APP->monitoring.newest.state);
    TEST_ASSERT_EQUAL_HEX32(0xcu, s->joints);
    TEST_ASSERT_TRUE(s->chance[3] > 0.999 && s->chance[2] < 0.9);
    TEST_ASSERT_EQUAL_UINT32(3u, APP->monitoring.newest.joint);
    TEST_ASSERT_EQUAL_DOUBLE(s->bias[3], APP->monitoring.newest.bias);
    TEST_ASSERT_EQUAL_DOUBLE(s->sigma[3], APP->monitoring.newest.sigma);
    TEST_ASSERT_EQUAL_INT(4, world.last[KC_EVT_MON_SEVERAL].index);
}

void test_what_is_found_is_not_weighed_after_a_change_of_tables(void)
{
    given_idle(2u, 0.05);
    observations(5u);
    world_tick();
    TEST_ASSERT_TRUE(kc_monitoring_names(&APP->monitoring, &APP->view));
    APP->monitoring.due = true;
    evaluate(kc_work_of_step());
    TEST_ASSERT_TRUE(APP->monitoring.weigh);
    APP->cal.session++;
    TEST_ASSERT_FALSE(kc_monitoring_names(&APP->monitoring, &APP->view));
    evaluate(kc_work_of_step());
    TEST_ASSERT_FALSE(APP->monitoring.weigh);
}

void test_observations_with_other_tables_get_no_verdict(void)
{
    given_idle(2u, 0.05);
    observations(5u);
    world_tick();
    APP->monitoring.newest.state = KC_MON_QUIET;
    APP->monitoring.due = true;
    APP->tables.active.crc[KC_TBL_KIN] ^= 1u;
    evaluate(kc_work_of_step());
    APP->tables.active.crc[KC_TBL_KIN] ^= 1u;
    evaluate(kc_work_of_step());
    TEST_ASSERT_EQUAL_INT(KC_MON_QUIET, APP->monitoring.newest.state);
}

void test_detections_of_one_step_get_one_verdict(void)
{
    given_idle(2u, 0.05);
    world.frames_at_once = KC_DET_QUEUE_MAX;
    observations(2u);
    TEST_ASSERT_EQUAL_UINT32(KC_MON_OBS_MAX, APP->arena.idle.monitor.n);
    TEST_ASSERT_EQUAL_INT(KC_MON_NAMED, APP->monitoring.newest.state);
    TEST_ASSERT_FALSE(APP->monitoring.due);
}

void test_a_new_correction_begins_a_new_window(void)
{
    given_idle(2u, 0.05);
    observations(5u);
    TEST_ASSERT_EQUAL_INT(KC_MON_NAMED, APP->monitoring.reported.state);
    APP->tables.active.crc[KC_TBL_KIN] ^= 1u;
    APP->tables.active.kin.value[8] = 0.05; /* J3.phi_rad: the joint stands where the table says now */
    world_seal(KC_TBL_KIN);
    observations(5u);
    TEST_ASSERT_EQUAL_INT(KC_MON_QUIET, APP->monitoring.reported.state);
    TEST_ASSERT_EQUAL_UINT32(5u, APP->arena.idle.monitor.n);
}

/* docs/STATES.md: what the executive does with the event. */
void test_the_named_joint_alone_is_recalibrated(void)
{
    given_idle(2u, 0.05);
    observations(5u);
    uint32_t suspects = (uint32_t)world.last[KC_EVT_MON_SUSPECT].want;
    TEST_ASSERT_EQUAL_HEX32(0x4u, suspects);
    memset(world.q, 0, sizeof world.q); /* back at the hub, a verified place */
    memset(world.q_cmd, 0, sizeof world.q_cmd);
    world_ticks(2u);
    kc_cmd_t *c = world_cmd(KC_CMD_START, -1, 4, 3);
    c->arg_u64 = 0x100u; /* J3.phi_rad */
    world_tick();
    TEST_ASSERT_EQUAL_INT(0, world.ack.status);
    for (uint32_t i = 0u; i < 4000u && world_calibrating(); i++) { world_tick(); }
    TEST_ASSERT_TRUE(world_stored(10u));
    TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_CHANGE, world.proposal.verdict);
    TEST_ASSERT_EQUAL_UINT32(1u, world.proposal.n_free);
    TEST_ASSERT_DOUBLE_WITHIN(3e-3, 0.05, world.proposal.kin.value[8]);
}

/* ---- found missing by mutants ---- */

void test_an_observation_counts_from_the_settling_time_on(void)
{
    given_idle(0u, 0.0);
    world.arm_vibrates = 1;
    world_tick();
    for (uint32_t i = 0u; i < 2u; i++) { /* at rest since this tick; then for settle_us exactly */
        world.requested = 1;
        world.frame_requested = 77;
        world_tick();
        TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_MON_NOT_AT_REST));
        TEST_ASSERT_EQUAL_UINT32(i, APP->arena.idle.monitor.n);
    }
    const kc_event_t *e = &world.last[KC_EVT_MON_NOT_AT_REST];
    TEST_ASSERT_EQUAL_INT(-1, e->index);
    TEST_ASSERT_EQUAL_DOUBLE(77.0, e->got);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, e->want);
}

void test_without_a_table_that_it_needs_nothing_is_compared(void)
{
    static const uint16_t kinds[] = {KC_TBL_ARM, KC_TBL_CAMERA, KC_TBL_TERMS, KC_TBL_CONFIG};
    for (uint32_t i = 0u; i < 4u; i++) {
        given_world();
        given_idle(0u, 0.0);
        observations(2u);
        APP->tables.active.crc[kinds[i]] = 0u;
        observations(1u);
        TEST_ASSERT_EQUAL_UINT32(1u, world_events(KC_EVT_DET_UNREQUESTED));
        TEST_ASSERT_EQUAL_UINT32(2u, APP->arena.idle.monitor.n);
    }
}

void test_a_finding_is_repeated_when_other_joints_are_suspected_or_the_bias_has_changed(void)
{
    given_idle(2u, 0.05);
    observations(8u);
    uint32_t n = world_events(KC_EVT_MON_SUSPECT);
    kc_mon_verdict_t *reported = &APP->monitoring.reported;
    for (uint32_t what = 0u; what < 5u; what++) {
        *reported = APP->monitoring.newest;
        TEST_ASSERT_EQUAL_INT(KC_MON_NAMED, reported->state);
        switch (what) {
        case 0u: break; /* the same */
        case 1u: reported->suspects ^= 0x40u; break;
        case 2u: reported->joint = 5u; break;
        case 3u: reported->bias += 20.0 * reported->sigma; break;
        default: reported->bias -= 20.0 * reported->sigma; break;
        }
        observations(1u);
        n += what > 0u ? 1u : 0u;
        TEST_ASSERT_EQUAL_UINT32(n, world_events(KC_EVT_MON_SUSPECT));
    }
}

void test_that_a_finding_has_gone_is_no_event(void)
{
    given_idle(0u, 0.0);
    observations(3u);
    APP->monitoring.reported.state = KC_MON_NAMED;
    observations(1u);
    TEST_ASSERT_EQUAL_INT(KC_MON_QUIET, APP->monitoring.newest.state);
    TEST_ASSERT_EQUAL_INT(KC_MON_NAMED, APP->monitoring.reported.state);
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_MON_SUSPECT) + world_events(KC_EVT_MON_UNEXPLAINED));
}

void test_a_calibration_begins_a_new_window(void)
{
    given_idle(0u, 0.0);
    observations(3u);
    APP->cal.session++;
    observations(2u);
    TEST_ASSERT_EQUAL_UINT32(2u, APP->arena.idle.monitor.n);
}

void test_an_observation_that_cannot_be_compared_changes_nothing(void)
{
    given_idle(0u, 0.0);
    observations(3u);
    kc_monitoring_t before = APP->monitoring;
    kc_detection_t d = world.in.det[0];
    d.t_us = world.now_us;
    d.p_cam_tool_m[0] = NAN;
    kc_work_t work = kc_work_of_step();
    kc_monitoring_observe(&APP->monitoring, &APP->arena.idle.monitor, &APP->view, &d, &work, &world.out);
    TEST_ASSERT_EQUAL_UINT32(3u, APP->arena.idle.monitor.n);
    TEST_ASSERT_EQUAL_UINT64(before.t_us, APP->monitoring.t_us);
    TEST_ASSERT_EQUAL_MEMORY(&before.newest, &APP->monitoring.newest, sizeof before.newest);
}

/* A joint that the correction knows to drift by 1 mrad/s, and that does not. */
void test_an_observation_is_compared_with_the_correction_at_its_time(void)
{
    world.terms.term[8].basis[0] = (kc_basis_t){.fn = KC_FN_LIN, .var = KC_VAR_T, .c1 = 1.0};
    given_idle(0u, 0.0);
    world.noise_m = world.noise_rad = 0.0;
    APP->tables.active.kin.value[8] = 1e-3;
    world_seal(KC_TBL_KIN);
    observations(1u);
    double t_s = (double)APP->clock.now_us * 1e-6;
    TEST_ASSERT_TRUE(t_s > 0.5);
    TEST_ASSERT_DOUBLE_WITHIN(1e-5, 1e-3 * t_s, APP->monitoring.newest.off_rad);
}

void test_an_observation_and_a_verdict_are_charged(void)
{
    given_idle(2u, 0.05);
    observations(5u);
    kc_detection_t d = world.in.det[0];
    d.t_us = world.now_us;
    const kc_active_t *a = &APP->tables.active;
    kc_work_t work = kc_work_of_step();
    kc_monitoring_observe(&APP->monitoring, &APP->arena.idle.monitor, &APP->view, &d, &work, &world.out);
    TEST_ASSERT_EQUAL_UINT32(6u, APP->arena.idle.monitor.n);
    TEST_ASSERT_TRUE(work.used > kc_model_cost(&a->arm, &a->terms, a->kin.value, false));
    const uint64_t cost = kc_monitor_evaluate_cost(&APP->arena.idle.monitor);
    APP->monitoring.weigh = false;
    evaluate((kc_work_t){cost, 1u});
    TEST_ASSERT_TRUE(APP->monitoring.due); /* it does not quite fit */
    evaluate((kc_work_t){cost + 1u, 1u});
    TEST_ASSERT_FALSE(APP->monitoring.due);
    const uint64_t more = kc_suspects_cost(&APP->arena.idle.monitor);
    evaluate((kc_work_t){more, 1u});
    TEST_ASSERT_TRUE(APP->monitoring.weigh);
    evaluate((kc_work_t){more + 1u, 1u});
    TEST_ASSERT_FALSE(APP->monitoring.weigh);
}
