/* kc_monitoring.c: when the monitor listens, and since when everything is at rest. What it finds: test_monitoring.c. */
#include "kc_monitoring.h"

#include <math.h>

#include "given_parts.h"
#include "unity.h"

#define FRESH_US 500000u
#define ADD_COST 30000u /* of an observation, without the model */

static kc_monitoring_t s_monitoring;
static kc_monitor_t s_monitor;

void setUp(void)
{
    given_parts();
    s_monitoring.resting = false;
    s_monitoring.rest_us = 1u;
    parts.telemetry.has_arm = parts.telemetry.has_pantilt = true;
    parts.telemetry.arm_ok_us = parts.telemetry.pantilt_ok_us = PARTS_NOW_US - FRESH_US;
}

static bool rests(void)
{
    kc_monitoring_rest(&s_monitoring, &parts.view);
    return s_monitoring.resting;
}

void test_it_is_at_rest_from_the_first_step_on_in_which_all_stand_still(void)
{
    TEST_ASSERT_TRUE(rests());
    TEST_ASSERT_EQUAL_UINT64(PARTS_NOW_US, s_monitoring.rest_us);
    parts.clock.now_us++;
    parts.telemetry.arm_ok_us = parts.telemetry.pantilt_ok_us = parts.clock.now_us;
    TEST_ASSERT_TRUE(rests());
    TEST_ASSERT_EQUAL_UINT64(PARTS_NOW_US, s_monitoring.rest_us);
}

/* One model with derivatives, two poses: its residual, and both solutions of a flat tag. What was seen before all
 * came to rest costs nothing. */
void test_an_observation_is_charged_and_due_if_all_stood_still_when_it_was_taken(void)
{
    const kc_active_t *a = &parts.tables.active;
    const double *coef = a->kin.value;
    kc_work_t work = kc_work_unlimited();
    kc_detection_t det = {0};
    given_detection(&a->arm, parts.telemetry.arm.q, 0.0, &det);
    (void)rests();
    s_monitoring.rest_us = PARTS_NOW_US - 1000u - a->config.settle_us;
    s_monitoring.weigh = true; /* what another calibration has found */
    s_monitoring.session = parts.cal.session + 1u;
    for (uint32_t late = 0u; late < 2u; late++) {
        det.t_us = parts.clock.clock_us - 1001u + late;
        kc_monitoring_observe(&s_monitoring, &s_monitor, &parts.view, &det, &work, &parts.out);
        TEST_ASSERT_TRUE(s_monitoring.due == (late != 0u));
        if (late == 0u) { expect_event(KC_EVT_MON_NOT_AT_REST, -1, (double)det.seq, 0.0); }
        TEST_ASSERT_EQUAL_UINT64(late == 0u
                                     ? 0u
                                     : kc_model_cost(&a->arm, &a->terms, coef, true) +
                                           2u * kc_model_cost(&a->arm, &a->terms, coef, false) + ADD_COST,
                                 work.used);
    }
    TEST_ASSERT_EQUAL_UINT64(PARTS_NOW_US - 1000u, s_monitoring.t_us);
    TEST_ASSERT_EQUAL_UINT32(1u, s_monitor.n);
    TEST_ASSERT_EQUAL_UINT32(parts.cal.session, s_monitoring.session);
    TEST_ASSERT_FALSE(s_monitoring.weigh);
}

/* Eight detections of the arm as it is; the monitor finds something. */
static void observe(const kc_arm_t *arm)
{
    double *q = parts.telemetry.arm.q;
    kc_work_t work = kc_work_unlimited();
    (void)rests();
    s_monitoring.session = parts.cal.session + 1u; /* it begins anew */
    s_monitoring.rest_us = 0u;
    for (uint32_t i = 0u; i < 8u; i++) {
        kc_detection_t det = {.t_us = parts.clock.clock_us};
        for (uint32_t j = 0u; j < 7u; j++) { q[j] = 0.3 * sin(1.0 + 5.0 * i + 2.0 * j); }
        given_detection(arm, q, 0.0, &det);
        kc_monitoring_observe(&s_monitoring, &s_monitor, &parts.view, &det, &work, &parts.out);
    }
    kc_monitoring_evaluate(&s_monitoring, &s_monitor, &parts.view, &work, &parts.out);
    TEST_ASSERT_TRUE(s_monitoring.weigh);
}

/* What explains the observations best is named, whichever joint the monitor found: weighed in the step after. */
void test_the_joint_that_is_off_is_named_with_its_bias(void)
{
    for (uint32_t joint = 0u; joint < 4u; joint++) {
        kc_arm_t arm = parts.tables.active.arm;
        kc_work_t work = kc_work_unlimited();
        setUp();
        arm.joint[joint].phi_rad += 0.05;
        observe(&arm);
        s_monitoring.found.joint = 5u;
        kc_monitoring_evaluate(&s_monitoring, &s_monitor, &parts.view, &work, &parts.out);
        TEST_ASSERT_EQUAL_INT(KC_MON_NAMED, s_monitoring.newest.state);
        TEST_ASSERT_EQUAL_UINT32(joint, s_monitoring.newest.joint);
        TEST_ASSERT_DOUBLE_WITHIN(0.005, 0.05, s_monitoring.newest.bias);
        expect_event(KC_EVT_MON_SUSPECT, (int32_t)joint + 1, s_monitoring.newest.bias,
                     (double)s_monitoring.newest.suspects);
    }
}

/* Joints 2 and 3, 2 and 4, 3 and 4: all are suspects, and of two that are as likely it is the first. */
void test_of_two_joints_that_are_off_the_likelier_is_named(void)
{
    for (uint32_t k = 0u; k < 3u; k++) {
        const uint32_t one = k < 2u ? 1u : 2u, other = k == 0u ? 2u : 3u;
        kc_arm_t arm = parts.tables.active.arm;
        kc_work_t work = kc_work_unlimited();
        setUp();
        arm.joint[one].phi_rad += 0.05;
        arm.joint[other].phi_rad -= 0.04;
        observe(&arm);
        kc_monitoring_evaluate(&s_monitoring, &s_monitor, &parts.view, &work, &parts.out);
        const kc_mon_verdict_t *v = &s_monitoring.newest;
        const double *chance = s_monitoring.suspects.chance;
        TEST_ASSERT_EQUAL_INT(KC_MON_SEVERAL, v->state);
        TEST_ASSERT_EQUAL_HEX32(1u << one | 1u << other, s_monitoring.suspects.joints);
        TEST_ASSERT_EQUAL_UINT32(chance[other] > chance[one] ? other : one, v->joint);
        TEST_ASSERT_EQUAL_DOUBLE(s_monitoring.suspects.bias[v->joint], v->bias);
    }
}

void test_it_is_not_at_rest_where_something_moves_is_silent_or_faulty(void)
{
    for (uint32_t i = 0u; i < 7u; i++) {
        kc_telemetry_t *t = &parts.telemetry;
        setUp();
        switch (i) {
        case 0u: t->arm.moving = 1u; break;
        case 1u: t->pantilt.moving = 1u; break;
        case 2u: t->arm.fault_mask = 4; break;
        case 3u: t->has_arm = false; break;
        case 4u: t->has_pantilt = false; break;
        case 5u: t->arm_ok_us--; break;
        default: t->pantilt_ok_us--; break;
        }
        TEST_ASSERT_FALSE(rests());
        TEST_ASSERT_EQUAL_UINT64(1u, s_monitoring.rest_us);
    }
}
