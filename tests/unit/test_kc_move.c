/* kc_move.c: commands of the arm, call by call; the arm does each at once. From hub 0, at zero, over hub 1 to
 * candidate 5. What the guard refuses: test_kc_guard.c. */
#include "kc_move.h"

#include <math.h>
#include <string.h>

#include "given_parts.h"
#include "kc_input_fields.h"
#include "unity.h"

#define CAND 5u
#define NODE (KC_HUB_MAX + CAND)
#define OFF 0.02 /* rad: twice the tolerance of arrival */
#define TIMEOUT_US 5000000u

static kc_move_t s_move;
static kc_arm_state_t *s_arm;
static kc_config_t *s_config;
static kc_space_t *s_space;

void setUp(void)
{
    given_parts();
    s_arm = &parts.telemetry.arm;
    s_config = &parts.tables.active.config;
    s_space = &parts.tables.active.space;
    s_config->arrive_tol = 0.5 * OFF;
    s_config->move_timeout_us = TIMEOUT_US;
    parts.cal.candidate = (int32_t)CAND;
    parts.plan.n_goal = 1u;
    s_arm->n_joints = 7u;
    memset(&s_move, 0, sizeof s_move);
    s_move.seg_from = s_move.seg_to = KC_NODE_NONE;
}

static kc_outcome_t begin(void)
{
    kc_work_t work = kc_work_unlimited();
    memset(&parts.out, 0, sizeof parts.out);
    return kc_move_begin(&s_move, &parts.view, &work, &parts.out);
}

static kc_outcome_t run(void)
{
    kc_work_t work = kc_work_unlimited();
    memset(&parts.out, 0, sizeof parts.out);
    return kc_move_run(&s_move, &parts.view, &work, &parts.out);
}

static kc_outcome_t wait(void)
{
    kc_work_t work = kc_work_unlimited();
    memset(&parts.out, 0, sizeof parts.out);
    return kc_move_wait(&s_move, &parts.view, &work, &parts.out);
}

/* The arm echoes its target and is there. */
static void arrives(void)
{
    memcpy(s_arm->q, s_move.q_target, sizeof s_arm->q);
    memcpy(s_arm->q_cmd, s_move.q_target, sizeof s_arm->q_cmd);
    s_arm->t_us++;
}

static void expect_sent(const double *q)
{
    TEST_ASSERT_TRUE(parts.out.has_arm_cmd);
    TEST_ASSERT_EQUAL_INT(0, parts.out.arm_cmd.hold);
    for (uint32_t j = 0u; j < 7u; j++) { TEST_ASSERT_DOUBLE_WITHIN(1e-12, q[j], parts.out.arm_cmd.q[j]); }
}

static void expect_sent_to(uint32_t node)
{
    double q[KC_JOINT_MAX];
    kc_path_joints(s_space, node, q);
    expect_sent(q);
}

/* ---- along the path ---- */

void test_a_move_leads_over_way_points_to_the_joints_at_the_candidate(void)
{
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, begin().id);
    expect_sent_to(1u);
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, run().id); /* it has not moved yet */
    TEST_ASSERT_FALSE(parts.out.has_arm_cmd);
    arrives();
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, run().id);
    expect_sent_to(NODE);
    arrives();
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, run().id);
    expect_sent(s_move.q_final);
    arrives();
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, run().id);
    TEST_ASSERT_EQUAL_UINT32(NODE, s_move.node);
    TEST_ASSERT_FALSE(kc_move_stopped(&s_move));
}

void test_commands_have_the_speed_of_config_and_hold_has_full_speed(void)
{
    s_config->speed_scale = 0.5;
    s_move.seq = 40;
    (void)begin();
    TEST_ASSERT_EQUAL_DOUBLE(0.5, parts.out.arm_cmd.speed_scale);
    TEST_ASSERT_EQUAL_INT32(41, parts.out.arm_cmd.seq);
    TEST_ASSERT_EQUAL_UINT32(7u, parts.out.arm_cmd.n_joints);
    s_arm->q[2] = 0.3;
    kc_move_hold(&s_move, &parts.view, &parts.out);
    TEST_ASSERT_EQUAL_INT(1, parts.out.arm_cmd.hold);
    TEST_ASSERT_EQUAL_DOUBLE(1.0, parts.out.arm_cmd.speed_scale);
    TEST_ASSERT_EQUAL_DOUBLE(0.3, parts.out.arm_cmd.q[2]);
    TEST_ASSERT_EQUAL_INT32(42, parts.out.arm_cmd.seq);
}

void test_an_arm_beside_a_node_goes_to_its_seed_first(void)
{
    s_arm->q[0] = OFF;
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, begin().id);
    expect_sent_to(0u);
    s_arm->q[0] = s_config->arrive_tol;
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, begin().id);
    expect_sent_to(1u);
}

void test_a_replicate_is_approached_over_its_hub(void)
{
    kc_path_joints(s_space, KC_HUB_MAX + CAND - 2u, s_arm->q); /* there is a direct segment */
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, begin().id);
    expect_sent_to(NODE);
    parts.cal.replicate = 1;
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, begin().id);
    expect_sent_to(1u);
    TEST_ASSERT_EQUAL_UINT32(2u, s_move.n_path);
}

void test_without_a_verified_path_the_candidate_is_skipped_and_away_from_all_of_them_it_ends(void)
{
    memset(s_space->hub_edge, 0, sizeof s_space->hub_edge);
    for (int32_t replicate = 0; replicate < 2; replicate++) {
        parts.cal.replicate = replicate;
        TEST_ASSERT_EQUAL_INT(KC_OC_SKIP, begin().id);
        expect_event(KC_EVT_CAL_NO_PATH, (int32_t)CAND, 0.0, 1.0);
    }
    s_config->servo.bound = 0.1; /* candidates are far */
    s_arm->q[1] = 0.06;
    kc_outcome_t oc = begin();
    TEST_ASSERT_EQUAL_INT(KC_OC_ABORT, oc.id);
    TEST_ASSERT_EQUAL_INT(KC_CAUSE_NO_PATH, oc.cause);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.06 / KC_HUB_BOUND, parts.out.events.e[0].got);
    TEST_ASSERT_EQUAL_DOUBLE(1.0, parts.out.events.e[0].want);
    TEST_ASSERT_EQUAL_INT32(CAND, parts.out.events.e[0].index);
}

/* Moving, so far beside the way point, in a message with this stamp; whether it is sent on. */
static bool passed(double off, uint64_t t_us)
{
    uint32_t i_path = s_move.i_path;
    arrives();
    s_arm->q[0] += off;
    s_arm->t_us = t_us;
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, run().id);
    return s_move.i_path > i_path;
}

void test_an_arm_that_runs_through_a_way_point_is_not_sent_on(void)
{
    (void)begin();
    s_arm->moving = 1u;
    TEST_ASSERT_FALSE(passed(0.0, 1u));
    TEST_ASSERT_FALSE(passed(0.0, 1u)); /* the same message */
    TEST_ASSERT_FALSE(passed(OFF, 2u)); /* it has run through */
    TEST_ASSERT_FALSE(passed(0.25 * OFF, 3u)); /* and comes back */
    TEST_ASSERT_TRUE(passed(-0.25 * OFF, 4u));
    TEST_ASSERT_EQUAL_UINT64(0u, s_move.near_us); /* of the next target nothing is known yet */
}

/* ---- waiting ---- */

static void given_sent(void)
{
    kc_work_t work = kc_work_unlimited();
    double q[KC_JOINT_MAX];
    setUp();
    kc_path_joints(s_space, NODE, s_arm->q);
    memcpy(s_arm->q_cmd, s_arm->q, sizeof s_arm->q_cmd);
    memcpy(q, s_arm->q, sizeof q);
    q[0] += 0.1;
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, kc_move_near(&s_move, &parts.view, &work, &parts.out, q).id);
    expect_sent(q);
}

void test_every_joint_has_to_echo_and_to_arrive_and_the_arm_to_rest(void)
{
    given_sent();
    for (uint32_t i = 0u; i < 14u; i++) {
        arrives();
        (i < 7u ? s_arm->q_cmd : s_arm->q)[i % 7u] += OFF;
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, wait().id);
    }
    arrives();
    s_arm->moving = 1u;
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, wait().id);
    s_arm->moving = 0u;
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, wait().id);
}

/* The guard takes several steps: meanwhile nothing is sent, then the command is, and once. */
void test_a_check_in_parts_ends_with_the_command(void)
{
    double q[KC_JOINT_MAX];
    kc_work_t none = {1u, 1u};
    kc_path_joints(s_space, NODE, s_arm->q);
    memcpy(s_arm->q_cmd, s_arm->q, sizeof s_arm->q_cmd);
    memcpy(q, s_arm->q, sizeof q);
    q[0] += 0.1;
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, kc_move_near(&s_move, &parts.view, &none, &parts.out, q).id);
    for (uint32_t k = 0u; k < 3u; k++) {
        TEST_ASSERT_FALSE(parts.out.has_arm_cmd);
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, kc_move_wait(&s_move, &parts.view, &none, &parts.out).id);
    }
    parts.clock.now_us += 5u;
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, wait().id);
    expect_sent(q);
    TEST_ASSERT_EQUAL_UINT64(parts.clock.now_us, s_move.start_us);
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, wait().id);
    TEST_ASSERT_FALSE(parts.out.has_arm_cmd);
    arrives();
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, wait().id);
}

void test_at_the_very_tolerance_it_has_arrived(void)
{
    given_sent();
    s_config->arrive_tol = 0.125;
    for (uint32_t j = 0u; j < 7u; j++) { s_move.q_target[j] = s_move.q_to[j] = 0.5; }
    for (uint32_t j = 0u; j < 7u; j++) {
        arrives();
        s_arm->q[j] = j % 2u == 0u ? 0.625 : 0.375;
        TEST_ASSERT_EQUAL_INT(KC_OC_DONE, wait().id);
        s_arm->q[j] += j % 2u == 0u ? 1e-9 : -1e-9;
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, wait().id);
    }
}

void test_a_command_that_got_lost_is_sent_again_each_second(void)
{
    given_sent();
    for (uint32_t k = 0u; k < 2u; k++) {
        parts.clock.now_us += 999999u;
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, wait().id);
        TEST_ASSERT_FALSE(parts.out.has_arm_cmd);
        parts.clock.now_us++;
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, wait().id);
        expect_sent(s_move.q_target);
    }
    s_arm->q_cmd[3] += 0.3; /* a third target: somebody else's, whom it does not contradict */
    parts.clock.now_us += 1000000u;
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, wait().id);
    TEST_ASSERT_FALSE(parts.out.has_arm_cmd);
}

void test_an_arm_that_does_not_arrive_in_time_ends_it(void)
{
    given_sent();
    s_arm->q_cmd[0] = s_move.q_target[0]; /* it has heard */
    parts.clock.now_us += TIMEOUT_US;
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, wait().id);
    parts.clock.now_us++;
    kc_outcome_t oc = wait();
    TEST_ASSERT_EQUAL_INT(KC_OC_ABORT, oc.id);
    TEST_ASSERT_EQUAL_INT(KC_CAUSE_ARM_LATE, oc.cause);
    expect_event(KC_EVT_CAL_MOVE_TIMEOUT, KC_INPUT_ARM, TIMEOUT_US + 1.0, 0.0);
}

/* Commands that the component should never send. */
void test_what_is_not_verified_is_not_sent(void)
{
    const struct {
        uint32_t to;
        double off;
    } cases[] = {{NODE, 1.6}, {0u, 0.0}}; /* beyond the bound of 1.5; not its hub */
    double q[KC_JOINT_MAX];
    kc_path_joints(s_space, NODE, s_arm->q);
    for (uint32_t i = 0u; i < 2u; i++) {
        kc_work_t work = kc_work_unlimited();
        kc_path_joints(s_space, cases[i].to, q);
        q[0] += q[0] > 0.0 ? -cases[i].off : cases[i].off;
        /* a check of another move that was broken off, and had found nothing */
        s_move.checking = true;
        s_move.check = (kc_guard_job_t){.verdict = KC_GUARD_OK, .over = true};
        kc_outcome_t oc = kc_move_send(&s_move, &parts.view, &work, &parts.out, NODE, cases[i].to, q);
        TEST_ASSERT_EQUAL_INT(KC_OC_SKIP, oc.id);
        TEST_ASSERT_FALSE(parts.out.has_arm_cmd);
        TEST_ASSERT_EQUAL_UINT32(1u, parts.out.events.n);
        TEST_ASSERT_EQUAL_INT(KC_EVT_GRD_PATH, parts.out.events.e[0].id);
        parts.out.events.n = 0u;
    }
    TEST_ASSERT_EQUAL_INT32(0, s_move.seq);
}

/* From hub 0 to candidate 0. */
void test_why_the_guard_refuses_is_an_event(void)
{
    static const kc_event_id_t why[] = {KC_EVT_GRD_LIMIT, KC_EVT_GRD_VOLUME, KC_EVT_GRD_SELF};
    for (uint32_t i = 0u; i < 3u; i++) {
        double q[KC_JOINT_MAX];
        kc_work_t work = kc_work_unlimited();
        setUp();
        kc_path_joints(s_space, KC_HUB_MAX, q);
        if (i == 0u) { s_config->servo.margin = 10.0; /* no joint has that margin */ }
        if (i == 1u) { /* a ball about the tool there */
            kc_volume_t *v = &s_space->volume[s_space->n_volume++];
            *v = (kc_volume_t){KC_VOL_SPHERE, {0.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f}, 0.02f, 0u};
            memcpy(v->p_m, s_space->cand[0].p_m, sizeof v->p_m);
        }
        if (i == 2u) { /* a ball about the tool, which reaches joint 4 there and not at the hub */
            s_space->n_body = 4u;
            s_space->body[2] = (kc_body_t){4u, {0.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f}, 0.01f, 0u};
            s_space->body[3] = (kc_body_t){0u, {0.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f}, 0.45f, 4u};
        }
        kc_outcome_t oc = kc_move_send(&s_move, &parts.view, &work, &parts.out, 0u, KC_HUB_MAX, q);
        TEST_ASSERT_EQUAL_INT(KC_OC_SKIP, oc.id);
        TEST_ASSERT_EQUAL_UINT16(why[i], parts.out.events.e[0].id);
        TEST_ASSERT_FALSE(parts.out.has_arm_cmd);
    }
}

/* A ball about the tool at candidate 0, which the arm passes if it stands as much lower as it carries. */
void test_the_guard_knows_what_the_arm_carries(void)
{
    kc_terms_t *t = &parts.tables.active.terms;
    kc_volume_t *v = &s_space->volume[s_space->n_volume++];
    double q[KC_JOINT_MAX];
    *v = (kc_volume_t){KC_VOL_SPHERE, {0.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f}, 0.02f, 0u};
    memcpy(v->p_m, s_space->cand[0].p_m, sizeof v->p_m);
    kc_path_joints(s_space, KC_HUB_MAX, q);
    t->term[t->n_term++] = (kc_term_t){.coef = 0u, .frame = 0u, .comp = KC_TZ, .gain = 1.0};
    t->term[t->n_term - 1u].basis[0] = (kc_basis_t){.fn = KC_FN_LIN, .var = KC_VAR_PAYLOAD, .c1 = 1.0};
    t->term[t->n_term - 1u].basis[1] = (kc_basis_t){.var = KC_VAR_ONE, .c1 = 1.0};
    t->term[0].gain = 0.0;
    parts.latest.coef[0] = 0.05;
    for (uint32_t carries = 0u; carries < 2u; carries++) {
        kc_work_t work = kc_work_unlimited();
        s_arm->payload_kg = 6.0 * (double)carries;
        parts.out.events.n = 0u;
        kc_outcome_t oc = kc_move_send(&s_move, &parts.view, &work, &parts.out, 0u, KC_HUB_MAX, q);
        TEST_ASSERT_EQUAL_INT(carries == 0u ? KC_OC_SKIP : KC_OC_STAY, oc.id);
    }
}

/* ---- hold ---- */

/* Calls of kc_move_held in steps of a tenth of a second; how often hold was sent again. */
static uint32_t held_again(uint32_t steps)
{
    uint32_t n = 0u;
    for (uint32_t i = 0u; i < steps; i++) {
        parts.clock.now_us += 100000u;
        parts.out.has_arm_cmd = 0u;
        kc_move_held(&s_move, &parts.view, &parts.out);
        n += parts.out.has_arm_cmd;
    }
    return n;
}

static void given_held(void)
{
    given_sent();
    memcpy(s_arm->q_cmd, s_move.q_target, sizeof s_arm->q_cmd);
    s_arm->moving = 1u;
    kc_move_hold(&s_move, &parts.view, &parts.out);
}

void test_hold_is_sent_again_for_three_seconds_while_the_arm_goes_on(void)
{
    given_held();
    TEST_ASSERT_EQUAL_UINT32(0u, held_again(2u));
    TEST_ASSERT_EQUAL_UINT32(9u, held_again(27u));
    TEST_ASSERT_EQUAL_UINT32(0u, parts.out.events.n);
    TEST_ASSERT_EQUAL_UINT32(1u, held_again(60u));
    expect_event(KC_EVT_ARM_NOT_HELD, -1, 3e6, 0.0);
    given_held();
    TEST_ASSERT_EQUAL_UINT32(2u, held_again(6u));
    s_arm->moving = 0u; /* it obeys */
    TEST_ASSERT_EQUAL_UINT32(0u, held_again(60u));
    TEST_ASSERT_EQUAL_UINT32(0u, parts.out.events.n);
}

/* What the guard had not finished is never sent. */
void test_hold_gives_up_a_command_that_the_guard_still_checks(void)
{
    const double *at = s_arm->q;
    double q[KC_JOINT_MAX];
    kc_work_t none = {1u, 1u};
    kc_path_joints(s_space, NODE, s_arm->q);
    memcpy(q, at, sizeof q);
    q[0] += 0.1;
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, kc_move_near(&s_move, &parts.view, &none, &parts.out, q).id);
    TEST_ASSERT_FALSE(parts.out.has_arm_cmd);
    kc_move_hold(&s_move, &parts.view, &parts.out);
    TEST_ASSERT_EQUAL_INT(1, parts.out.arm_cmd.hold);
    TEST_ASSERT_EQUAL_DOUBLE_ARRAY(at, parts.out.arm_cmd.q, 7u);
    (void)wait();
    TEST_ASSERT_FALSE(parts.out.has_arm_cmd);
    TEST_ASSERT_EQUAL_INT32(1, s_move.seq);
}

/* That is not flight's move; one that began before flight did may be. */
void test_an_arm_that_somebody_else_moves_is_not_held_again(void)
{
    given_held();
    s_arm->q_cmd[0] += 0.3;
    TEST_ASSERT_EQUAL_UINT32(0u, held_again(60u));
    given_held();
    s_move.start_us = 0u; /* flight has moved nothing yet, and knows no target */
    TEST_ASSERT_EQUAL_UINT32(0u, held_again(60u));
    given_held();
    s_move.start_us = 1u; /* in its first microsecond */
    TEST_ASSERT_EQUAL_UINT32(10u, held_again(60u));
    given_held();
    s_move.start_us = 0u;
    s_move.foreign = true;
    TEST_ASSERT_EQUAL_UINT32(10u, held_again(60u));
}

/* ---- where it stands ---- */

static void at_node(uint32_t node, double dist)
{
    double got = 0.0;
    TEST_ASSERT_EQUAL_UINT32(node, kc_move_node(&s_move, &parts.view, &got));
    if (dist >= 0.0) { TEST_ASSERT_DOUBLE_WITHIN(1e-9, dist, got); }
}

void test_it_is_at_a_node_within_its_bound(void)
{
    s_config->servo.bound = 0.2;
    kc_path_joints(s_space, NODE, s_arm->q);
    s_arm->q[0] += 0.15;
    at_node(NODE, 0.15 / (0.2 + s_config->arrive_tol));
    memset(s_arm->q, 0, sizeof s_arm->q);
    s_arm->q[1] = 0.06; /* candidates are far from here */
    at_node(KC_NODE_NONE, 0.06 / KC_HUB_BOUND);
}

void test_on_its_segment_it_is_bound_for_its_end_and_beside_it_nowhere(void)
{
    s_config->servo.bound = 0.05;
    s_arm->q[0] = 0.25; /* half way from hub 0 to hub 1, but for joint 4 */
    s_move.seg_from = 0u;
    s_move.seg_to = 1u;
    at_node(KC_NODE_NONE, -1.0);
    s_arm->q[3] = 0.5;
    at_node(1u, -1.0);
    /* Forgotten or unusable: the table still knows the segment, and leads to its lower end. */
    s_move.seg_to = KC_HUB_MAX + 1000u; /* a candidate that there is not */
    at_node(0u, -1.0);
    s_move.seg_to = 0u; /* no length */
    at_node(0u, -1.0);
    s_move.seg_from = 7u; /* a hub that there is not */
    at_node(0u, -1.0);
    /* To or from joints behind the last candidate. */
    memset(s_space->hub_edge, 0, sizeof s_space->hub_edge);
    for (uint32_t j = 0u; j < 7u; j++) {
        s_space->cand[s_space->n_cand].q_seed[j] = (float)(2.0 * s_arm->q[j]);
    }
    const uint16_t behind = (uint16_t)(KC_HUB_MAX + s_space->n_cand);
    for (uint32_t to = 0u; to < 2u; to++) {
        s_move.seg_from = to == 0u ? behind : 0u;
        s_move.seg_to = to == 0u ? 0u : behind;
        at_node(KC_NODE_NONE, -1.0);
    }
}

/* Any one joint may make the segment, first or last, and the arm be beside it by twice the tolerance. */
void test_on_a_segment_of_one_joint_it_is_between_the_ends_and_not_beyond(void)
{
    const struct {
        double part, beside;
        bool on;
    } cases[] = {{0.3, 0.0, true},
                 {0.7, 1.9 * 0.5 * OFF, true},
                 {0.5, -1.9 * 0.5 * OFF, true},
                 {0.5, 2.1 * 0.5 * OFF, false},
                 {1.2, 0.0, false},
                 {-0.2, 0.0, false}};
    s_config->servo.bound = 0.05;
    for (uint32_t j = 0u; j < 7u; j++) {
        memset(s_space->hub_q, 0, sizeof s_space->hub_q);
        s_space->hub_q[0][(j + 3u) % 7u] = s_space->hub_q[1][(j + 3u) % 7u] = 0.25f;
        s_space->hub_q[0][j] = -0.25f;
        s_space->hub_q[1][j] = 0.75f;
        s_space->hub_edge[0] = s_space->hub_edge[1] = 0u; /* so that the table does not hold it */
        for (uint32_t i = 0u; i < sizeof cases / sizeof cases[0]; i++) {
            memset(s_arm->q, 0, sizeof s_arm->q);
            s_arm->q[(j + 3u) % 7u] = 0.25;
            s_arm->q[j] = -0.25 + cases[i].part;
            s_arm->q[(j + 1u) % 7u] += cases[i].beside;
            for (uint16_t to = 0u; to < 2u; to++) {
                s_move.seg_from = 1u - to;
                s_move.seg_to = to;
                at_node(cases[i].on ? to : KC_NODE_NONE, -1.0);
            }
        }
    }
}

void test_at_the_very_bound_it_is_still_at_the_node(void)
{
    s_config->servo.bound = 0.125;
    s_config->arrive_tol = 0.125;
    for (uint32_t j = 0u; j < 7u; j++) { s_space->cand[CAND].q_seed[j] = 0.75f; }
    for (uint32_t j = 0u; j < 7u; j++) {
        kc_path_joints(s_space, NODE, s_arm->q);
        s_arm->q[j] = j % 2u == 0u ? 1.0 : 0.5;
        at_node(NODE, 1.0);
        s_arm->q[j] += j % 2u == 0u ? 1e-9 : -1e-9;
        double dist = 0.0;
        (void)kc_move_node(&s_move, &parts.view, &dist);
        TEST_ASSERT_TRUE(dist > 1.0);
    }
}

/* ---- bounds ---- */

void test_each_joint_is_bounded_by_the_smaller_bound_and_the_limits_with_their_margin(void)
{
    double bound[KC_JOINT_MAX], lo[KC_JOINT_MAX], hi[KC_JOINT_MAX];
    kc_active_t *a = &parts.tables.active;
    s_config->servo.bound = 0.375;
    s_config->servo.margin = 0.0625;
    for (uint32_t j = 0u; j < 7u; j++) {
        s_space->servo_bound[j] = j < 3u ? 0.25f : 0.5f;
        s_space->cand[CAND].q_seed[j] = 0.5f;
        a->arm.joint[j].q_min = j % 2u == 0u ? 0.25 : -1.0;
        a->arm.joint[j].q_max = j % 3u == 0u ? 0.75 : 2.0;
    }
    kc_move_bound(a, bound);
    kc_move_box(a, CAND, lo, hi);
    for (uint32_t j = 0u; j < 7u; j++) {
        const double size = j < 3u ? 0.25 : 0.375;
        TEST_ASSERT_EQUAL_DOUBLE(size, bound[j]);
        TEST_ASSERT_EQUAL_DOUBLE(j % 2u == 0u ? 0.3125 : 0.5 - size, lo[j]);
        TEST_ASSERT_EQUAL_DOUBLE(j % 3u == 0u ? 0.6875 : 0.5 + size, hi[j]);
    }
}

/* A quaternion that is not of unit length to the last bit is that of the rotation all the same. */
void test_the_goal_is_the_pose_of_the_table(void)
{
    kc_cand_t *c = &s_space->cand[CAND];
    kc_pose_t T;
    const double h = 0.70710678118654752, want[9] = {0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0};
    for (uint32_t i = 0u; i < 3u; i++) { c->p_m[i] = 0.25f * (float)(i + 1u); }
    c->q_wxyz[0] = c->q_wxyz[3] = (float)(1.001 * h); /* a quarter about z */
    c->q_wxyz[1] = c->q_wxyz[2] = 0.0f;
    kc_move_goal(s_space, CAND, &T);
    for (uint32_t i = 0u; i < 3u; i++) { TEST_ASSERT_EQUAL_DOUBLE(0.25 * (i + 1.0), T.p_m[i]); }
    for (uint32_t i = 0u; i < 9u; i++) { TEST_ASSERT_DOUBLE_WITHIN(1e-7, want[i], T.R[i]); }
}

/* The corrected arm is at the goal there, or as near as the bound lets it; local initial poses are their seeds. */
void test_the_joints_at_a_candidate_reach_it_or_end_at_the_bound(void)
{
    double q[KC_JOINT_MAX], at[KC_JOINT_MAX], seed[KC_JOINT_MAX], off[6];
    kc_pose_t T, goal;
    parts.latest.coef[0] = 0.1;
    parts.latest.coef[12] = -0.08;
    kc_path_joints(s_space, NODE, seed);
    kc_move_goal(s_space, CAND, &goal);
    for (uint32_t k = 0u; k < 3u; k++) {
        s_config->servo.bound = k == 0u ? 1.5 : 0.02;
        if (k == 2u) { s_space->cand[CAND].why |= KC_CAND_LOCAL; }
        uint32_t n = kc_move_joints(&parts.view, CAND, 40u, q);
        TEST_ASSERT_TRUE(k == 2u ? n == 0u : n > 1u && n <= KC_MOVE_EVALS(40u));
        memcpy(at, q, sizeof at);
        at[0] += 0.1;
        at[3] -= 0.08;
        kc_arm_fk(&parts.tables.active.arm, at, &T);
        kc_pose_residual(&T, &goal, off);
        double far = 0.0, off_m = sqrt(off[0] * off[0] + off[1] * off[1] + off[2] * off[2]);
        for (uint32_t j = 0u; j < 7u; j++) { far = fmax(far, fabs(q[j] - seed[j])); }
        TEST_ASSERT_EQUAL_INT(k == 0u, off_m <= s_config->servo.tol_pos_m);
        if (k > 0u) { TEST_ASSERT_DOUBLE_WITHIN(1e-12, k == 1u ? 0.02 : 0.0, far); }
    }
}

/* ---- stops ---- */

static const uint8_t STOP[KC_STOP_MAX] = {50u, 100u, 150u, 200u};

/* A move to CAND; the stops on the segment from its hub, in the order in which the arm was there. */
static void expect_stops(uint32_t n, const uint8_t *stop)
{
    double q[KC_JOINT_MAX];
    uint32_t k = 0u;
    kc_outcome_t oc = begin();
    for (uint32_t i = 0u; i < 10u; i++) {
        arrives();
        oc = run();
        if (oc.id == KC_OC_DONE && !kc_move_stopped(&s_move)) { break; }
        if (oc.id != KC_OC_DONE) { continue; }
        TEST_ASSERT_TRUE(k < n);
        for (uint32_t j = 0u; j < 7u; j++) {
            double hub = (double)s_space->hub_q[1][j], seed = (double)s_space->cand[CAND].q_seed[j];
            q[j] = hub + (double)stop[k] / 256.0 * (seed - hub);
            TEST_ASSERT_DOUBLE_WITHIN(1e-6, q[j], s_arm->q[j]);
        }
        k++;
        kc_work_t work = kc_work_unlimited();
        TEST_ASSERT_EQUAL_INT(KC_OC_DONE, kc_move_onward(&s_move, &parts.view, &work, &parts.out).id);
    }
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, oc.id);
    TEST_ASSERT_EQUAL_UINT32(n, k);
    for (uint32_t j = 0u; j < 7u; j++) { TEST_ASSERT_DOUBLE_WITHIN(1e-9, s_move.q_final[j], s_arm->q[j]); }
}

/* Before, the arm was on another move. */
static void given_stops(uint32_t stops_max)
{
    setUp();
    s_config->stops_max = stops_max;
    s_space->n_stop = KC_STOP_MAX;
    memcpy(s_space->stop[CAND], STOP, sizeof STOP);
    s_move.i_stop = 3u;
    s_move.i_path = 2u;
    s_move.to_stop = true;
}

void test_stops_are_made_evenly_those_that_are_allowed(void)
{
    static const uint8_t want[][4] = {{0u}, {150u}, {100u, 200u}, {50u, 150u, 200u}, {50u, 100u, 150u, 200u}};
    for (uint32_t n = 0u; n <= KC_STOP_MAX; n++) {
        given_stops(n);
        expect_stops(n, want[n]);
    }
    given_stops(KC_STOP_MAX); /* the table has fewer */
    memset(&s_space->stop[CAND][1], 0, KC_STOP_MAX - 1u);
    expect_stops(1u, STOP);
}

void test_no_stop_is_made_by_a_replicate_or_without_room_or_from_elsewhere(void)
{
    given_stops(4u);
    parts.cal.replicate = 1;
    expect_stops(0u, NULL);
    given_stops(4u);
    parts.plan.n_goal = KC_MEAS_MAX;
    expect_stops(0u, NULL);
    given_stops(4u); /* on the segment from candidate 3 */
    kc_path_joints(s_space, KC_HUB_MAX + CAND - 2u, s_arm->q);
    expect_stops(0u, NULL);
}

void test_the_next_view_is_at_the_next_stop_and_then_at_the_candidate(void)
{
    double view[KC_JOINT_MAX], q[KC_JOINT_MAX];
    given_stops(1u);
    (void)begin();
    kc_space_stop(s_space, CAND, 2u, q);
    for (uint32_t i = 0u; i < 2u; i++) { /* on the way to its hub, and to it */
        kc_move_next_view(&s_move, &parts.view, view);
        TEST_ASSERT_EQUAL_DOUBLE_ARRAY(q, view, 7u);
        arrives();
        (void)run();
    }
    kc_work_t work = kc_work_unlimited();
    (void)kc_move_onward(&s_move, &parts.view, &work, &parts.out);
    kc_move_next_view(&s_move, &parts.view, view);
    TEST_ASSERT_EQUAL_DOUBLE_ARRAY(s_move.q_final, view, 7u);
}

/* ---- charges ---- */

/* With as many joints and terms as there may be, each with two functions and loads, the move is a unit of one step. */
void test_the_joints_of_a_move_are_charged_with_less_than_a_step(void)
{

    kc_active_t *a = &parts.tables.active;
    a->arm.n_joints = KC_JOINT_MAX;
    a->terms.n_term = KC_TERM_MAX;
    for (uint32_t k = 0u; k < KC_TERM_MAX; k++) {
        a->terms.term[k] = (kc_term_t){.gain = 1.0};
        a->terms.term[k].basis[0] = (kc_basis_t){.fn = KC_FN_SIN, .var = KC_VAR_TAU, .index = 1u, .c1 = 1.0};
        a->terms.term[k].basis[1] = a->terms.term[k].basis[0];
    }
    a->terms.coef[0].enabled = 1u;
    const uint64_t cost = kc_move_begin_cost(&parts.view);
    TEST_ASSERT_TRUE(cost > KC_STEP_WORK / 2u && cost <= KC_STEP_WORK);
}
