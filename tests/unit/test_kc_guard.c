/* kc_guard.c: what a command must not do. Distances against hand-made figures; tests/oracle has MuJoCo's. */
#include "kc_guard.h"

#include <math.h>
#include <string.h>

#include "given_dense.h"
#include "given_tables.h"
#include "unity.h"

#define NODE(c) (KC_HUB_MAX + (c))

static kc_space_t s_s;
static kc_arm_t s_arm;
static kc_terms_t s_terms;
static kc_ctx_t s_ctx;
static double s_coef[KC_COEF_MAX], s_from[KC_JOINT_MAX], s_to[KC_JOINT_MAX], s_bound[KC_JOINT_MAX];
static kc_guard_request_t s_ask;
static kc_guard_reason_t s_why;
static kc_guard_arm_t s_g; /* all frames at the base */
static uint32_t s_body, s_volume;

void setUp(void)
{
    given_arm(&s_arm);
    given_terms(&s_terms);
    given_space(&s_s, 9u, 1u);
    memset(&s_ctx, 0, sizeof s_ctx);
    memset(s_coef, 0, sizeof s_coef);
    s_g = (kc_guard_arm_t){.arm = &s_arm, .space = &s_s};
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { s_bound[j] = 0.4; }
    for (uint32_t i = 0u; i <= KC_JOINT_MAX; i++) { kc_pose_identity(&s_g.frame[i]); }
    kc_path_joints(&s_s, NODE(3u), s_from);
    memcpy(s_to, s_from, sizeof s_to);
    s_ask = (kc_guard_request_t){.arm = &s_arm,
                                 .terms = &s_terms,
                                 .coef = s_coef,
                                 .space = &s_s,
                                 .ctx = &s_ctx,
                                 .q_from = s_from,
                                 .q_to = s_to,
                                 .from = NODE(3u),
                                 .to = NODE(3u),
                                 .bound = s_bound,
                                 .margin = 0.02,
                                 .tol = 1e-3};
}

/* ---- distances ---- */

static double distance(kc_body_t body, kc_volume_t volume)
{
    s_s.n_body = s_s.n_volume = 1u;
    s_s.body[0] = body;
    s_s.volume[0] = volume;
    return kc_guard_clearance(&s_g, &s_body, &s_volume);
}

#define ROD(ax, ay, az, bx, by, bz, r) ((kc_body_t){0u, {ax, ay, az}, {bx, by, bz}, r, 0u})

void test_distance_to_the_ground_is_that_of_the_lower_end(void)
{
    kc_volume_t ground = {KC_VOL_BELOW, {5.0f, 5.0f, -0.5f}, {0.0f, 0.0f, 0.0f}, 0.0f, 0u};
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.4, distance(ROD(0.f, 0.f, 0.f, 1.f, 0.f, 1.f, 0.1f), ground));
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, -0.1, distance(ROD(0.f, 0.f, 0.f, 1.f, 0.f, -0.5f, 0.1f), ground));
}

void test_distance_to_a_ball_is_from_the_nearest_place_of_the_axis(void)
{
    kc_volume_t ball = {KC_VOL_SPHERE, {1.0f, 1.0f, 0.0f}, {0.0f, 0.0f, 0.0f}, 0.25f, 0u};
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.65, distance(ROD(0.f, 0.f, 0.f, 2.f, 0.f, 0.f, 0.1f), ball));
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, sqrt(2.0) - 0.35,
                              distance(ROD(0.f, 0.f, 0.f, -2.f, 0.f, 0.f, 0.1f), ball));
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, sqrt(2.0) - 0.35,
                              distance(ROD(0.f, 0.f, 0.f, 0.f, 0.f, 0.f, 0.1f), ball));
}

void test_distance_between_capsules(void)
{
    kc_volume_t mast = {KC_VOL_CAPSULE, {0.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 1.0f}, 0.05f, 0u};
    /* crossing at a distance; end to middle; parallel beside and beyond; a point */
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.15, distance(ROD(0.3f, -1.f, 0.5f, 0.3f, 1.f, 0.5f, 0.1f), mast));
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.35, distance(ROD(0.5f, 0.f, 0.5f, 1.5f, 0.f, 0.9f, 0.1f), mast));
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.25, distance(ROD(0.4f, 0.f, 0.2f, 0.4f, 0.f, 0.7f, 0.1f), mast));
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.85, distance(ROD(0.f, 0.f, 2.f, 0.f, 0.f, 3.f, 0.1f), mast));
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.25, distance(ROD(0.4f, 0.f, 0.2f, 0.4f, 0.f, 0.2f, 0.1f), mast));
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, -0.15, distance(ROD(-1.f, 0.f, 0.5f, 1.f, 0.f, 0.6f, 0.1f), mast));
}

void test_distance_to_a_box_from_its_side_edge_and_inside(void)
{
    kc_volume_t deck = {KC_VOL_BOX, {0.0f, 0.0f, -0.1f}, {0.5f, 0.7f, 0.1f}, 0.0f, 0u};
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.2, distance(ROD(-2.f, 0.f, 0.3f, 2.f, 0.f, 0.3f, 0.1f), deck));
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.4, distance(ROD(0.8f, 0.f, 0.4f, 2.f, 0.f, 3.f, 0.1f), deck));
    /* across the edge (0.5, y, 0): nearest in the middle of the rod */
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.5 * sqrt(2.0) - 0.1,
                              distance(ROD(0.f, 0.f, 1.5f, 1.5f, 0.f, 0.f, 0.1f), deck));
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, -0.1, distance(ROD(0.f, 0.f, 1.f, 0.f, 0.f, -0.1f, 0.1f), deck));
}

void test_the_nearest_pair_is_named_and_excluded_ones_are_not_checked(void)
{
    s_s.n_body = s_s.n_volume = 2u;
    s_s.body[0] = ROD(0.f, 0.f, 0.f, 0.f, 0.f, 1.f, 0.1f);
    s_s.body[1] = ROD(0.f, 0.f, 1.f, 0.f, 0.f, 2.f, 0.1f);
    s_s.volume[0] = (kc_volume_t){KC_VOL_BELOW, {0.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f}, 0.0f, 1u};
    s_s.volume[1] = (kc_volume_t){KC_VOL_SPHERE, {0.0f, 0.0f, 3.0f}, {0.0f, 0.0f, 0.0f}, 0.3f, 0u};
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.6, kc_guard_clearance(&s_g, &s_body, &s_volume));
    TEST_ASSERT_EQUAL_UINT32(1u, s_body);
    TEST_ASSERT_EQUAL_UINT32(1u, s_volume);
    s_s.volume[1].excluded = 2u;
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.9, kc_guard_clearance(&s_g, &s_body, &s_volume));
    TEST_ASSERT_EQUAL_UINT32(1u, s_body);
    TEST_ASSERT_EQUAL_UINT32(0u, s_volume);
    s_s.volume[0].excluded = 3u;
    s_s.volume[1].excluded = 3u;
    TEST_ASSERT_TRUE(isinf(kc_guard_clearance(&s_g, &s_body, &s_volume)));
}

/* ---- the arm itself ---- */

/* A rod along x at height 0 of the tool, one across it at 0.5 of joint 6, a ball at 0.2 of joint 1 (links
 * whose d is 0). */
static void given_three_bodies(void)
{
    s_s.n_body = 3u;
    s_s.body[0] = ROD(-1.f, 0.f, 0.f, 1.f, 0.f, 0.f, 0.1f);
    s_s.body[1] = ROD(0.f, -1.f, 0.5f, 0.f, 1.f, 0.5f, 0.05f);
    s_s.body[1].frame = 6u;
    s_s.body[2] = ROD(0.f, 0.f, 0.2f, 0.f, 0.f, 0.2f, 0.05f);
    s_s.body[2].frame = 1u;
}

static void expect_distance(double want, uint32_t body, uint32_t other)
{
    uint32_t met = 99u;
    s_body = 99u;
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, want, kc_guard_self_clearance(&s_g, &s_body, &met));
    TEST_ASSERT_EQUAL_UINT32(body, s_body);
    TEST_ASSERT_EQUAL_UINT32(other, met);
}

void test_of_the_arm_itself_only_pairs_that_must_not_meet_count(void)
{
    uint32_t met = 99u;
    given_three_bodies();
    TEST_ASSERT_TRUE(isinf(kc_guard_self_clearance(&s_g, &s_body, &met)));
    TEST_ASSERT_EQUAL_UINT32(99u, met);
    s_s.body[1].collision_pairs = 1u;
    expect_distance(0.35, 1u, 0u);
    s_s.body[2].collision_pairs = 2u;
    expect_distance(0.2, 2u, 1u);
    s_s.body[2].collision_pairs = 3u;
    expect_distance(0.05, 2u, 0u);
    s_s.body[2].radius_m = 0.15f; /* inside: negative */
    expect_distance(-0.05, 2u, 0u);
}

void test_a_body_moved_along_its_axis_counts_at_both_ends_of_the_move(void)
{
    given_three_bodies();
    s_s.body[2].collision_pairs = 2u;
    for (double by = -0.1; by <= 0.11; by += 0.2) { /* the frame is where the correction put it */
        s_g.frame[6].p_m[2] = by;
        s_g.along_m[6] = by;
        expect_distance(by < 0.0 ? 0.1 : 0.2, 2u, 1u); /* nearer now; nearer where it was */
    }
    s_g.along_m[1] = 0.15; /* both: the ball now, the rod as it was, and every other pair of ends */
    s_g.frame[1].p_m[2] = 0.15;
    expect_distance(0.05, 2u, 1u);
}

void test_volumes_see_both_ends_of_such_a_move_too(void)
{
    kc_volume_t ground = {KC_VOL_BELOW, {0.0f, 0.0f, -0.5f}, {0.0f, 0.0f, 0.0f}, 0.0f, 0u};
    kc_body_t rod = ROD(0.f, 0.f, 0.f, 1.f, 0.f, 0.f, 0.1f);
    rod.frame = 6u;
    s_g.frame[6].p_m[2] = s_g.along_m[6] = -0.1;
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.3, distance(rod, ground));
    s_g.frame[6].p_m[2] = s_g.along_m[6] = 0.1;
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.4, distance(rod, ground));
    rod.frame = 0u; /* the tool's corrections are known as they are */
    s_g.frame[0].p_m[2] = 0.1;
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.5, distance(rod, ground));
}

/* Joint 3 has d = 0.55. */
void test_a_link_with_a_length_leans_with_an_error_across_it(void)
{
    kc_volume_t ball = {KC_VOL_SPHERE, {0.5f, 0.0f, 0.55f}, {0.0f, 0.0f, 0.0f}, 0.1f, 0u};
    kc_volume_t foot = {KC_VOL_SPHERE, {-0.5f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f}, 0.1f, 0u};
    kc_body_t link = ROD(0.f, 0.f, 0.f, 0.f, 0.f, 0.55f, 0.05f);
    link.frame = 3u;
    s_g.across_m[3] = 0.2;
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.15, distance(link, ball)); /* far end at 0.2 */
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.35, distance(link, foot)); /* near end stayed at 0 */
    link.frame = 6u; /* joint 6 has no d: what moves is beyond it */
    s_g.across_m[6] = 0.2;
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.35, distance(link, ball));
    link.frame = 1u; /* of the first joint as of any */
    s_arm.joint[0].d_m = 0.55;
    s_g.across_m[1] = 0.2;
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.15, distance(link, ball));
}

/* Joint 3 has d = 0.55: its link reaches from where joint 2 is, and gets longer or shorter at the far end. */
void test_a_link_with_a_length_is_stretched_by_such_a_move(void)
{
    kc_volume_t ball = {KC_VOL_SPHERE, {0.0f, 0.0f, 1.0f}, {0.0f, 0.0f, 0.0f}, 0.1f, 0u};
    kc_volume_t ground = {KC_VOL_BELOW, {0.0f, 0.0f, -0.5f}, {0.0f, 0.0f, 0.0f}, 0.0f, 0u};
    kc_body_t link = ROD(0.f, 0.f, 0.f, 0.f, 0.f, 0.55f, 0.05f);
    link.frame = 3u;
    s_g.frame[3].p_m[2] = s_g.along_m[3] = 0.2;
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.1, distance(link, ball)); /* far end at 0.75 */
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.45, distance(link, ground)); /* near end stayed at 0 */
    link.start_m[2] = link.end_m[2] = 0.275f; /* half way: moved by half */
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.475, distance(link, ball));
}

/* The same with a length against the axis; and whichever joint it is, its own length counts. */
void test_a_link_against_its_axis_keeps_its_near_end_too(void)
{
    kc_volume_t ball = {KC_VOL_SPHERE, {0.0f, 0.0f, -1.0f}, {0.0f, 0.0f, 0.0f}, 0.1f, 0u};
    kc_volume_t aside = {KC_VOL_SPHERE, {0.5f, 0.0f, -0.55f}, {0.0f, 0.0f, 0.0f}, 0.1f, 0u};
    kc_body_t link = ROD(0.f, 0.f, 0.f, 0.f, 0.f, -0.55f, 0.05f);
    link.frame = 3u;
    s_arm.joint[2].d_m = -0.55;
    s_g.across_m[3] = 0.2;
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.15, distance(link, aside)); /* far end at 0.2 */
    s_g.across_m[3] = 0.0;
    s_g.frame[3].p_m[2] = s_g.along_m[3] = 0.2;
    TEST_ASSERT_DOUBLE_WITHIN(1e-7, 0.5, distance(link, ball)); /* far end at -0.35 */
}

void test_each_joint_has_a_length_of_its_own(void)
{
    kc_volume_t ball = {KC_VOL_SPHERE, {0.0f, 0.0f, -1.0f}, {0.0f, 0.0f, 0.0f}, 0.1f, 0u};
    kc_body_t body = ROD(0.f, 0.f, 0.5f, 0.f, 0.f, 0.5f, 0.05f);
    for (uint32_t j = 1u; j <= 7u; j++) {
        for (uint32_t has = 0u; has < 2u; has++) {
            setUp();
            for (uint32_t k = 0u; k < 7u; k++) {
                s_arm.joint[k].d_m = (k + 1u == j) == (has == 1u) ? 0.5 : 0.0;
            }
            s_g.along_m[j] = 0.2;
            body.frame = (uint8_t)j;
            /* at the far end of a link, where the frame is; without a link it may also be where it was */
            TEST_ASSERT_DOUBLE_WITHIN(1e-7, has == 1u ? 1.35 : 1.15, distance(body, ball));
        }
    }
}

/* ---- limits and paths ---- */

static void expect(kc_guard_verdict_t verdict, int32_t index, double got, double want)
{
    TEST_ASSERT_EQUAL_INT(verdict, kc_guard_check(&s_ask, &s_why));
    TEST_ASSERT_EQUAL_INT(index, s_why.index);
    TEST_ASSERT_DOUBLE_WITHIN(2e-6, got, s_why.got);
    TEST_ASSERT_DOUBLE_WITHIN(2e-6, want, s_why.want);
}

/* Refused at the first posture that is too near, which is no deeper than the deepest of the move. */
static void expect_met(kc_guard_verdict_t verdict, int32_t index, double deepest_m, double want)
{
    TEST_ASSERT_EQUAL_INT(verdict, kc_guard_check(&s_ask, &s_why));
    TEST_ASSERT_EQUAL_INT(index, s_why.index);
    TEST_ASSERT_EQUAL_DOUBLE(want, s_why.want);
    TEST_ASSERT_TRUE(s_why.got > -KC_GUARD_CLEAR_M - 2e-6 && s_why.got <= deepest_m + 2e-6);
}

static void expect_fine(void) { TEST_ASSERT_EQUAL_INT(KC_GUARD_OK, kc_guard_check(&s_ask, &s_why)); }

void test_a_joint_nearer_to_its_limit_than_the_margin_is_refused(void)
{
    s_to[2] = s_arm.joint[2].q_max - 0.01;
    expect(KC_GUARD_LIMIT, 3, s_to[2], s_arm.joint[2].q_max - 0.02);
    s_to[2] = s_arm.joint[2].q_min + 0.01;
    expect(KC_GUARD_LIMIT, 3, s_to[2], s_arm.joint[2].q_min + 0.02);
    s_to[2] = NAN;
    TEST_ASSERT_EQUAL_INT(KC_GUARD_LIMIT, kc_guard_check(&s_ask, &s_why));
    TEST_ASSERT_EQUAL_INT(3, s_why.index);
}

/* Each joint by itself, first and last. */
void test_every_joint_has_its_limits_and_its_bound(void)
{
    double seed[KC_JOINT_MAX];
    memcpy(seed, s_to, sizeof seed);
    s_s.n_body = 0u;
    for (uint32_t j = 0u; j < 7u; j++) {
        memcpy(s_to, seed, sizeof s_to);
        memcpy(s_from, seed, sizeof s_from);
        for (uint32_t i = 0u; i < KC_JOINT_MAX; i++) { s_bound[i] = 0.1 + 0.01 * (double)i; }
        s_to[j] = s_arm.joint[j].q_max;
        expect(KC_GUARD_LIMIT, (int32_t)j + 1, s_to[j], s_arm.joint[j].q_max - 0.02);
        s_to[j] = s_arm.joint[j].q_min;
        expect(KC_GUARD_LIMIT, (int32_t)j + 1, s_to[j], s_arm.joint[j].q_min + 0.02);
        for (uint32_t k = 0u; k < 4u; k++) { /* target or start, above or below */
            double *q = k < 2u ? s_to : s_from;
            memcpy(s_to, seed, sizeof s_to);
            memcpy(s_from, seed, sizeof s_from);
            q[j] = seed[j] + (k % 2u == 0u ? 1.0 : -1.0) * (s_bound[j] + 0.5 * s_ask.tol);
            expect_fine();
            q[j] = seed[j] + (k % 2u == 0u ? 1.0 : -1.0) * (s_bound[j] + 0.005);
            expect(KC_GUARD_PATH, (int32_t)j + 1, 0.005 - s_ask.tol, s_bound[j]);
        }
    }
}

/* The joint that is farthest off is named, the first of those that are as far. */
void test_of_joints_beyond_their_bound_the_worst_is_named(void)
{
    kc_cand_t *c = &s_s.cand[3];
    s_s.n_body = 0u;
    for (uint32_t j = 0u; j < 7u; j++) {
        c->q_seed[j] = 0.5f;
        s_bound[j] = 0.125;
        s_from[j] = s_to[j] = 0.75;
    }
    expect(KC_GUARD_PATH, 1, 0.125 - s_ask.tol, 0.125);
    s_to[4] = 0.875;
    expect(KC_GUARD_PATH, 5, 0.25 - s_ask.tol, 0.125);
}

/* From a stop on a segment to its end exactly: each joint by itself. */
void test_every_joint_has_to_be_at_the_end_of_the_segment(void)
{
    double seed[KC_JOINT_MAX], hub[KC_JOINT_MAX];
    s_s.n_body = 0u;
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { s_bound[j] = 0.01; } /* the start is far outside */
    kc_path_joints(&s_s, NODE(3u), seed);
    kc_path_joints(&s_s, s_s.cand[3].hub, hub);
    for (uint32_t j = 0u; j < 7u; j++) { s_from[j] = 0.5 * (seed[j] + hub[j]); }
    memcpy(s_to, seed, sizeof s_to);
    expect_fine();
    for (uint32_t j = 0u; j < 7u; j++) {
        s_to[j] = seed[j] + (j % 2u == 0u ? 1e-5 : -1e-5);
        TEST_ASSERT_EQUAL_INT(KC_GUARD_PATH, kc_guard_check(&s_ask, &s_why));
        s_to[j] = seed[j];
    }
}

/* Numbers of tables are single precision: a target on the margin is on it, whichever way it was rounded. */
void test_a_joint_exactly_at_the_margin_of_a_limit_is_fine(void)
{
    double lo = s_arm.joint[2].q_min + s_ask.margin, hi = s_arm.joint[2].q_max - s_ask.margin;
    s_s.n_body = 0u;
    for (uint32_t j = 0u; j < 7u; j++) { s_bound[j] = 9.0; }
    for (double off = -5e-7; off < 6e-7; off += 5e-7) {
        s_to[2] = hi + off;
        expect_fine();
        s_to[2] = lo + off;
        expect_fine();
    }
    s_to[2] = hi + 2e-6;
    expect(KC_GUARD_LIMIT, 3, hi + 2e-6, hi);
    s_to[2] = lo - 2e-6;
    expect(KC_GUARD_LIMIT, 3, lo - 2e-6, lo);
}

void test_inside_the_box_anything_goes_and_outside_nothing(void)
{
    s_to[4] += 0.399;
    s_from[1] -= 0.399;
    expect_fine();
    s_to[4] += 0.1;
    expect(KC_GUARD_PATH, 5, 0.499 - 0.4 - s_ask.tol, 0.4);
    s_to[4] -= 0.1;
    s_from[1] -= 0.2; /* came from outside */
    expect(KC_GUARD_PATH, 2, 0.599 - 0.4 - s_ask.tol, 0.4);
}

void test_the_box_has_two_sides_for_start_and_goal(void)
{
    double seed[KC_JOINT_MAX];
    memcpy(seed, s_to, sizeof seed);
    for (int side = -1; side <= 1; side += 2) {
        s_to[4] = seed[4] + side * 0.399;
        expect_fine();
        s_to[4] = seed[4] + side * 0.45;
        expect(KC_GUARD_PATH, 5, 0.05 - s_ask.tol, 0.4);
        s_to[4] = seed[4];
        s_from[4] = seed[4] + side * 0.45;
        expect(KC_GUARD_PATH, 5, 0.05 - s_ask.tol, 0.4);
        s_from[4] = seed[4];
    }
}

void test_the_box_around_a_hub_is_small(void)
{
    s_ask.from = s_ask.to = 1u;
    kc_path_joints(&s_s, 1u, s_from);
    kc_path_joints(&s_s, 1u, s_to);
    s_from[2] += KC_HUB_BOUND;
    expect_fine();
    s_from[2] += 0.01;
    expect(KC_GUARD_PATH, 3, 0.01 - s_ask.tol, KC_HUB_BOUND);
}

void test_a_verified_segment_goes_from_one_end_to_the_other(void)
{
    uint32_t hub = s_s.cand[3].hub;
    s_ask.from = hub;
    kc_path_joints(&s_s, hub, s_from);
    expect_fine();
    s_to[0] += 0.01; /* not its end */
    expect(KC_GUARD_PATH, 0, 0.0, 0.0);
    s_to[0] -= 0.01;
    s_from[0] += 0.01; /* not on it */
    expect(KC_GUARD_PATH, 0, 0.0, 0.0);
    s_from[0] -= 0.01;
    s_ask.from = 1u - hub; /* no such segment */
    expect(KC_GUARD_PATH, 0, 0.0, 0.0);
    s_ask.to = NODE(9u); /* no such node */
    expect(KC_GUARD_PATH, 0, 0.0, 0.0);
}

void test_an_arm_stopped_on_a_segment_may_go_to_its_end(void)
{
    kc_path_joints(&s_s, s_s.cand[3].hub, s_from);
    for (uint32_t j = 0u; j < 7u; j++) { s_from[j] += 0.3 * (s_to[j] - s_from[j]); }
    expect_fine();
    s_from[6] += 0.5;
    TEST_ASSERT_EQUAL_INT(KC_GUARD_PATH, kc_guard_check(&s_ask, &s_why));
}

void test_an_arm_may_be_sent_to_a_place_on_a_verified_segment(void)
{
    double end[KC_JOINT_MAX];
    memcpy(end, s_to, sizeof end);
    s_ask.from = s_s.cand[3].hub;
    kc_path_joints(&s_s, s_ask.from, s_from);
    for (uint32_t j = 0u; j < 7u; j++) { s_to[j] = s_from[j] + 0.3 * (end[j] - s_from[j]); }
    expect_fine();
    memcpy(s_from, s_to, sizeof s_to);
    for (uint32_t j = 0u; j < 7u; j++) { s_to[j] += 0.5 * (end[j] - s_to[j]); }
    expect_fine(); /* from one to the next */
    s_to[2] += 1e-4;
    expect(KC_GUARD_PATH, 0, 0.0, 0.0); /* beside it */
    s_to[2] -= 1e-4;
    s_from[2] += 0.01;
    expect(KC_GUARD_PATH, 0, 0.0, 0.0); /* from beside it */
}

/* ---- volumes ---- */

/* A ball where the tool's left end is at these joints, for the arm with the correction in use. */
static void put_ball(const double *q, float radius)
{
    kc_loads_t loads;
    double left[3] = {0.1, 0.0, 0.0}, p[3];
    memcpy(s_ctx.q, q, 7u * sizeof *q);
    kc_model_loads(&s_arm, &s_terms, s_coef, &s_ctx, &loads);
    kc_model_frames(&s_arm, &s_terms, s_coef, &s_ctx, &loads, s_g.frame, s_g.along_m, s_g.across_m);
    for (uint32_t i = 0u; i < 3u; i++) {
        p[i] = s_g.frame[0].p_m[i];
        for (uint32_t k = 0u; k < 3u; k++) { p[i] += s_g.frame[0].R[3u * i + k] * left[k]; }
    }
    s_s.volume[1] = (kc_volume_t){KC_VOL_SPHERE, {(float)p[0], (float)p[1], (float)p[2]}, {0}, radius, 1u};
}

void test_a_target_inside_a_volume_is_refused_with_body_and_depth(void)
{
    s_to[0] += 0.3;
    put_ball(s_to, 0.02f);
    expect_met(KC_GUARD_VOLUME, 1, 0.03, 1.0); /* the rod's 0.01 more */
    s_s.n_volume = 1u;
    expect_fine();
    s_s.n_volume = 2u;
    s_s.n_body = 0u;
    expect_fine();
}

void test_a_volume_between_the_ends_is_found_too(void)
{
    double half[KC_JOINT_MAX];
    s_to[0] += 0.38;
    s_from[0] -= 0.38;
    for (uint32_t j = 0u; j < 7u; j++) { half[j] = 0.5 * (s_from[j] + s_to[j]); }
    put_ball(half, 0.05f);
    expect_met(KC_GUARD_VOLUME, 1, 0.06, 1.0);
    for (uint32_t j = 0u; j < 7u; j++) { half[j] = s_from[j] + 0.373 * (s_to[j] - s_from[j]); }
    put_ball(half, 0.002f); /* nor is something thin passed between two postures */
    expect_met(KC_GUARD_VOLUME, 1, 0.012, 1.0);
    put_ball(s_from, 0.02f); /* inside already: it may leave */
    expect_fine();
    double t[KC_JOINT_MAX];
    memcpy(t, s_from, sizeof t);
    memcpy(s_from, s_to, sizeof t);
    memcpy(s_to, t, sizeof t); /* but not come back */
    expect_met(KC_GUARD_VOLUME, 1, 0.03, 1.0);
}

/* Where it first finds something, not farther on the way. */
void test_a_check_ends_at_the_first_posture_that_is_too_near(void)
{
    double at[KC_JOINT_MAX];
    for (double part = 0.25; part < 0.8; part += 0.25) {
        kc_guard_job_t job;
        kc_work_t work = kc_work_unlimited();
        setUp();
        s_to[0] += 0.38;
        s_from[0] -= 0.38;
        for (uint32_t j = 0u; j < 7u; j++) { at[j] = s_from[j] + part * (s_to[j] - s_from[j]); }
        put_ball(at, 0.02f);
        kc_guard_begin(&s_ask, &job);
        TEST_ASSERT_TRUE(kc_guard_step(&s_ask, &job, &work));
        TEST_ASSERT_EQUAL_INT(KC_GUARD_VOLUME, job.verdict);
        TEST_ASSERT_TRUE(job.over);
        TEST_ASSERT_TRUE(job.part > part - 0.25 && job.part < part);
        TEST_ASSERT_TRUE(job.at.d[0] < KC_GUARD_CLEAR_M);
    }
}

/* Links count with their length, to whichever side they go: nothing thin is passed between two postures. */
void test_links_against_their_axis_are_as_long(void)
{
    for (uint32_t j = 0u; j < 7u; j++) {
        s_arm.joint[j].d_m *= -1.5;
        s_arm.joint[j].a_m *= -3.0;
    }
    s_to[0] += 0.38;
    s_from[0] -= 0.38;
    for (double f = 0.06; f < 0.95; f += 0.047) {
        double at[KC_JOINT_MAX];
        for (uint32_t j = 0u; j < 7u; j++) { at[j] = s_from[j] + f * (s_to[j] - s_from[j]); }
        put_ball(at, 0.002f);
        expect_met(KC_GUARD_VOLUME, 1, 0.012, 1.0);
    }
}

/* A compliance of 0.01 rad/(N m) in joint 2: the ball is where the arm hangs, and it does not without its weight. */
void test_clearance_is_that_of_the_arm_as_it_sags(void)
{
    s_terms.coef[28] = (kc_coef_t){.name = "sag", .lb = -1.0, .ub = 1.0, .scale = 0.01, .enabled = 1u};
    s_terms.term[28] = (kc_term_t){.coef = 28u, .frame = 1u, .comp = KC_RZ, .gain = 1.0};
    s_terms.term[28].basis[0] = (kc_basis_t){KC_FN_LIN, KC_VAR_TAU, 2u, 0.0, 1.0};
    s_terms.n_coef = s_terms.n_term = 29u;
    s_coef[28] = 0.01;
    s_ctx.g_m_s2[2] = -9.81;
    s_to[0] += 0.3;
    put_ball(s_to, 0.02f);
    expect_met(KC_GUARD_VOLUME, 1, 0.03, 1.0);
    s_coef[28] = 0.0;
    expect_fine();
}

void test_clearance_is_that_of_the_corrected_arm(void)
{
    s_to[0] += 0.3;
    put_ball(s_to, 0.02f);
    s_coef[0] = -0.4; /* joint 1 reads wrong: the arm is elsewhere */
    expect_fine();
    put_ball(s_to, 0.02f);
    expect_met(KC_GUARD_VOLUME, 1, 0.03, 1.0);
}

/* ---- distances kept ---- */

void test_nothing_comes_nearer_than_the_clearance(void)
{
    s_to[0] += 0.3;
    put_ball(s_to, 0.02f);
    s_s.volume[1].radius_m = 0.02f;
    s_s.volume[1].p_m[2] += 0.1f;
    s_s.volume[1].excluded = 1u;
    double gap = 0.0;
    TEST_ASSERT_EQUAL_INT(KC_GUARD_OK, kc_guard_check(&s_ask, &s_why));
    gap = kc_guard_clearance(&s_g, &s_body, &s_volume); /* of the frames at s_to */
    TEST_ASSERT_TRUE(gap > KC_GUARD_CLEAR_M);
    s_s.volume[1].radius_m = (float)(0.02 + gap - KC_GUARD_CLEAR_M - 1e-4);
    expect_fine();
    s_s.volume[1].radius_m = (float)(0.02 + gap - KC_GUARD_CLEAR_M + 1e-4);
    expect_met(KC_GUARD_VOLUME, 1, -KC_GUARD_CLEAR_M + 1e-4, 1.0); /* not inside yet */
}

/* The nearest two bodies of the arm at some joints, as distance(). */
static double self_clearance_at(const double *q)
{
    uint32_t met;
    kc_loads_t loads;
    memcpy(s_ctx.q, q, 7u * sizeof *q);
    kc_model_loads(&s_arm, &s_terms, s_coef, &s_ctx, &loads);
    kc_model_frames(&s_arm, &s_terms, s_coef, &s_ctx, &loads, s_g.frame, s_g.along_m, s_g.across_m);
    return kc_guard_self_clearance(&s_g, &s_body, &met);
}

/* Elbow and tool must not meet; joint 4 brings them together, s_near is nearer than s_to. */
static void given_elbow(double gap_at_to)
{
    s_s.n_body = 2u;
    s_s.body[0] = ROD(0.f, 0.f, 0.f, 0.f, 0.f, 0.2f, 0.01f);
    s_s.body[0].frame = 3u;
    s_s.body[1] = ROD(0.f, 0.f, 0.f, 0.f, 0.f, 0.f, 0.01f);
    s_s.body[1].collision_pairs = 1u;
    s_to[3] += 0.3;
    s_s.body[1].radius_m = (float)(0.01 + self_clearance_at(s_to) - gap_at_to);
}

void test_a_move_through_self_collision_is_refused_with_both_bodies(void)
{
    given_elbow(KC_GUARD_CLEAR_M + 1e-4);
    s_s.n_volume = 0u;
    TEST_ASSERT_TRUE(self_clearance_at(s_from) > self_clearance_at(s_to)); /* it gets nearer */
    expect_fine();
    given_space(&s_s, 9u, 1u);
    s_to[3] -= 0.3;
    given_elbow(-0.02);
    expect_met(KC_GUARD_SELF, 1, 0.02, 0.0);
    s_s.body[1].collision_pairs = 0u;
    expect_fine();
}

void test_an_arm_too_near_to_itself_may_leave_but_not_go_deeper(void)
{
    double q[KC_JOINT_MAX];
    given_elbow(0.001);
    memcpy(q, s_from, sizeof q);
    memcpy(s_from, s_to, sizeof q);
    memcpy(s_to, q, sizeof q); /* from too near to far */
    expect_fine();
    memcpy(s_to, s_from, sizeof q);
    s_to[3] += 0.002; /* a little nearer still: by less than it may */
    double deeper = 0.001 - self_clearance_at(s_to);
    TEST_ASSERT_TRUE(deeper > 0.0 && deeper < KC_GUARD_LEAVE_M);
    expect_fine();
    s_to[3] += 0.05;
    deeper = 0.001 - self_clearance_at(s_to);
    TEST_ASSERT_TRUE(deeper > KC_GUARD_LEAVE_M);
    expect_met(KC_GUARD_SELF, 1, deeper - 0.001, 0.0);
}

/* ---- local initial poses ---- */

/* From the hub of candidate 3 to it (or back) with a sphere at the end of the move. */
static void given_path(bool back)
{
    uint32_t hub = s_s.cand[3].hub;
    kc_path_joints(&s_s, back ? NODE(3u) : hub, s_from);
    kc_path_joints(&s_s, back ? hub : NODE(3u), s_to);
    s_ask.from = back ? NODE(3u) : hub;
    s_ask.to = back ? hub : NODE(3u);
    put_ball(s_to, 0.02f);
}

void test_moves_to_and_from_local_initial_poses_are_not_checked_for_clearance(void)
{
    for (int back = 0; back < 2; back++) {
        s_s.cand[3].why = 0u;
        given_path(back);
        expect_met(KC_GUARD_VOLUME, 1, 0.03, 1.0);
        s_s.cand[3].why = KC_CAND_LOCAL;
        expect_fine();
    }
    s_ask.from = s_ask.to = NODE(3u); /* inside the box the same */
    kc_path_joints(&s_s, NODE(3u), s_to);
    memcpy(s_from, s_to, sizeof s_to);
    s_from[0] += 0.05;
    put_ball(s_to, 0.02f);
    expect_fine();
    s_s.cand[3].why = 0u;
    expect_met(KC_GUARD_VOLUME, 1, 0.03, 1.0);
}

void test_the_box_around_a_local_initial_pose_is_small(void)
{
    s_s.cand[3].why = KC_CAND_LOCAL;
    s_to[2] += KC_HUB_BOUND;
    expect_fine();
    s_to[2] += 0.01;
    expect(KC_GUARD_PATH, 3, 0.01 - s_ask.tol, KC_HUB_BOUND);
}

void test_limits_and_paths_are_checked_at_local_initial_poses_too(void)
{
    s_s.cand[3].why = KC_CAND_LOCAL;
    s_ask.from = 1u - s_s.cand[3].hub; /* no such segment */
    expect(KC_GUARD_PATH, 0, 0.0, 0.0);
    s_to[2] = s_arm.joint[2].q_max - 0.01;
    expect(KC_GUARD_LIMIT, 3, s_to[2], s_arm.joint[2].q_max - 0.02);
}

/* ---- in parts ---- */

void test_a_check_in_parts_comes_to_the_same(void)
{
    kc_guard_job_t job;
    s_to[0] += 0.3;
    put_ball(s_to, 0.02f);
    kc_guard_verdict_t whole = kc_guard_check(&s_ask, &s_why);
    TEST_ASSERT_EQUAL_INT(KC_GUARD_VOLUME, whole);
    kc_guard_begin(&s_ask, &job);
    uint32_t steps = 0u;
    for (bool over = false; !over; steps++) {
        kc_work_t work = {1u, 0u};
        over = kc_guard_step(&s_ask, &job, &work);
    }
    TEST_ASSERT_TRUE(steps > 2u);
    TEST_ASSERT_EQUAL_INT(whole, job.verdict);
    TEST_ASSERT_EQUAL_MEMORY(&s_why.got, &job.why.got, sizeof s_why.got);
}

/* ---- found missing by mutants ---- */

/* Beyond the end of the segment at the hub, where the nearest point of it is the end itself. */
static void step_off_the_hub(double by)
{
    uint32_t hub = s_s.cand[3].hub;
    kc_path_joints(&s_s, hub, s_from);
    s_from[0] += s_from[0] < s_to[0] ? -by : by;
}

void test_a_segment_is_left_by_twice_the_tolerance_at_most(void)
{
    for (uint32_t stopped = 0u; stopped < 2u; stopped++) {
        s_ask.from = stopped ? s_ask.to : s_s.cand[3].hub;
        step_off_the_hub(1.9e-3);
        expect_fine();
        step_off_the_hub(2.1e-3);
        TEST_ASSERT_EQUAL_INT(KC_GUARD_PATH, kc_guard_check(&s_ask, &s_why));
    }
}

static kc_body_t drawn_rod(uint64_t *rng)
{
    kc_body_t b = {.radius_m = 0.02f};
    for (uint32_t i = 0u; i < 3u; i++) {
        b.start_m[i] = (float)drawn(rng);
        b.end_m[i] = b.start_m[i] + (float)(1.2 * drawn(rng));
    }
    return b;
}

static void on_rod(const kc_body_t *b, double part, double p[3])
{
    for (uint32_t i = 0u; i < 3u; i++) {
        p[i] = (double)b->start_m[i] + part * ((double)b->end_m[i] - (double)b->start_m[i]);
    }
}

#define SAMPLES 60u
#define SAMPLE_TOL 0.03 /* half the distance of two samples on the longest rod, on both rods */

/* From samples on both axes: independent, and at most SAMPLE_TOL too large. */
static double sampled_between(const kc_body_t *one, const kc_body_t *two)
{
    double least = HUGE_VAL, p[3], q[3];
    for (uint32_t i = 0u; i <= SAMPLES; i++) {
        on_rod(one, (double)i / SAMPLES, p);
        for (uint32_t k = 0u; k <= SAMPLES; k++) {
            on_rod(two, (double)k / SAMPLES, q);
            least = fmin(least, sqrt(pow(p[0] - q[0], 2.0) + pow(p[1] - q[1], 2.0) + pow(p[2] - q[2], 2.0)));
        }
    }
    return least - (double)one->radius_m - (double)two->radius_m;
}

/* Pairs that a bound passes over are never the nearest. */
void test_the_nearest_of_many_bodies_is_found(void)
{
    uint64_t rng = 5u;
    for (uint32_t n = 0u; n < 60u; n++) {
        double want = HUGE_VAL;
        uint32_t met = 0u;
        s_s.n_body = 5u;
        for (uint32_t i = 0u; i < s_s.n_body; i++) {
            s_s.body[i] = drawn_rod(&rng);
            s_s.body[i].collision_pairs = UINT32_MAX; /* itself and later ones too: they play no part */
            for (uint32_t k = 0u; k < i; k++) {
                want = fmin(want, sampled_between(&s_s.body[i], &s_s.body[k]));
            }
        }
        TEST_ASSERT_DOUBLE_WITHIN(SAMPLE_TOL, want, kc_guard_self_clearance(&s_g, &s_body, &met));
        TEST_ASSERT_DOUBLE_WITHIN(SAMPLE_TOL, want, sampled_between(&s_s.body[s_body], &s_s.body[met]));
    }
}

static double sampled_to_box(const kc_body_t *b, const kc_volume_t *v)
{
    double least = HUGE_VAL, p[3];
    for (uint32_t i = 0u; i <= 10u * SAMPLES; i++) {
        double d2 = 0.0;
        on_rod(b, (double)i / (10.0 * SAMPLES), p);
        for (uint32_t k = 0u; k < 3u; k++) {
            double out = fabs(p[k] - (double)v->p_m[k]) - (double)v->size_m[k];
            d2 += out > 0.0 ? out * out : 0.0;
        }
        least = fmin(least, sqrt(d2));
    }
    return least - (double)b->radius_m;
}

void test_the_nearest_of_many_boxes_or_capsules_is_found(void)
{
    uint64_t rng = 8u;
    for (uint32_t n = 0u; n < 120u; n++) {
        const bool boxes = n < 60u;
        double want = HUGE_VAL;
        s_s.n_body = s_s.n_volume = 4u;
        for (uint32_t i = 0u; i < 4u; i++) {
            kc_volume_t *v = &s_s.volume[i];
            s_s.body[i] = drawn_rod(&rng);
            *v = (kc_volume_t){.kind = boxes ? KC_VOL_BOX : KC_VOL_CAPSULE};
            if (!boxes) { v->radius_m = 0.05f * (float)(i + 1u); }
            for (uint32_t k = 0u; k < 3u; k++) {
                v->p_m[k] = (float)(2.0 * drawn(&rng));
                v->size_m[k] = boxes ? (float)(0.01 + 0.3 * fabs(drawn(&rng)))
                                     : v->p_m[k] + (float)(1.2 * drawn(&rng)); /* the other end */
            }
        }
        for (uint32_t i = 0u; i < 16u; i++) {
            const kc_body_t *body = &s_s.body[i / 4u];
            const kc_volume_t *v = &s_s.volume[i % 4u];
            kc_body_t rod = {.radius_m = v->radius_m};
            memcpy(rod.start_m, v->p_m, sizeof rod.start_m);
            memcpy(rod.end_m, v->size_m, sizeof rod.end_m);
            want = fmin(want, boxes ? sampled_to_box(body, v) : sampled_between(body, &rod));
        }
        TEST_ASSERT_DOUBLE_WITHIN(boxes ? 2e-3 : SAMPLE_TOL, want,
                                  kc_guard_clearance(&s_g, &s_body, &s_volume));
    }
}

/* Instructions that a check is charged with. */
static uint64_t charged(void)
{
    kc_work_t work = kc_work_unlimited();
    kc_guard_job_t job;
    kc_guard_begin(&s_ask, &job);
    TEST_ASSERT_TRUE(kc_guard_step(&s_ask, &job, &work));
    return work.used;
}

/* What is charged for the first posture alone, and what has to be left of a step to begin with it. */
static uint64_t charged_for_one(void)
{
    kc_work_t one = {1u, 0u};
    kc_guard_job_t job;
    kc_guard_begin(&s_ask, &job);
    (void)kc_guard_step(&s_ask, &job, &one);
    TEST_ASSERT_EQUAL_UINT32(1u, job.k);
    return one.used;
}

static uint64_t set_aside(void)
{
    uint64_t least = 0u, most = 1ull << 30;
    while (most - least > 1u) {
        uint64_t left = (least + most) / 2u;
        kc_work_t work = {left + 1u, 1u};
        kc_guard_job_t job;
        kc_guard_begin(&s_ask, &job);
        (void)kc_guard_step(&s_ask, &job, &work);
        if (job.k > 0u) {
            most = left;
        } else {
            least = left;
        }
    }
    return most;
}

/* Where nothing can be passed over, no more and no less is set aside than is charged. */
void test_what_is_set_aside_for_a_posture_is_what_it_may_cost(void)
{
    static const uint8_t kinds[] = {KC_VOL_BELOW, KC_VOL_BOX, KC_VOL_CAPSULE, KC_VOL_SPHERE};
    s_s.n_volume = 1u;
    for (uint32_t i = 0u; i < 4u; i++) {
        s_s.n_body = 1u;
        s_s.body[0] = ROD(0.f, 0.f, 0.f, 0.f, 0.f, 0.2f, 0.01f);
        s_s.volume[0] = (kc_volume_t){kinds[i], {0.0f, 0.0f, -9.0f}, {0.1f, 0.1f, -8.0f}, 0.1f, 0u};
        uint64_t one = set_aside();
        if (kinds[i] != KC_VOL_BOX) { TEST_ASSERT_EQUAL_UINT64(charged_for_one(), one); }
        TEST_ASSERT_TRUE(charged_for_one() <= one);
        s_s.volume[0].excluded = 1u; /* of this body alone */
        TEST_ASSERT_EQUAL_UINT64(charged_for_one(), set_aside());
        TEST_ASSERT_TRUE(set_aside() < one);
    }
    given_three_bodies();
    s_s.volume[0] = (kc_volume_t){KC_VOL_SPHERE, {0.0f, 0.0f, -9.0f}, {0}, 0.1f, 2u};
    s_s.body[2].collision_pairs = ~1u; /* the one before; itself and later ones play no part */
    TEST_ASSERT_EQUAL_UINT64(charged_for_one(), set_aside());
}

/* A box is charged with what it costs: little where a bound says that another one is nearer. */
void test_a_box_that_is_passed_over_is_charged_with_less(void)
{
    s_s.n_body = 1u;
    s_s.body[0] = (kc_body_t){0u, {0.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.03f}, 0.03f, 0u};
    s_s.n_volume = 2u;
    for (uint32_t i = 0u; i < 2u; i++) {
        s_s.volume[i] =
            (kc_volume_t){KC_VOL_BOX, {0.0f, 0.0f, -2.0f - (float)i}, {0.1f, 0.1f, 0.1f}, 0.0f, 0u};
    }
    uint64_t near_first = charged();
    s_s.volume[0].p_m[2] = -3.0f;
    s_s.volume[1].p_m[2] = -2.0f;
    uint64_t near_last = charged();
    TEST_ASSERT_TRUE(near_last >= near_first + 5000u);
    s_s.volume[1].excluded = 1u;
    TEST_ASSERT_TRUE(charged() + 5000u <= near_last);
}

/* What lies beyond the arm's joints in arrays plays no part. */
void test_joints_that_the_arm_does_not_have_are_not_looked_at(void)
{
    double seed[KC_JOINT_MAX];
    s_from[7] = s_to[7] = 9.0;
    s_bound[7] = 0.0;
    s_arm.joint[7].q_max = -1.0;
    expect_fine();
    kc_path_joints(&s_s, s_s.cand[3].hub, seed);
    memcpy(s_from, seed, 7u * sizeof *seed);
    expect_fine();
    s_ask.from = s_s.cand[3].hub;
    expect_fine();
}

/* Far between the ends, so that no step may be as long as the whole slide. */
void test_a_volume_in_the_way_of_a_sliding_joint_is_found(void)
{
    double half[KC_JOINT_MAX];
    s_arm.joint[0].type = KC_PRISMATIC;
    s_arm.joint[0].q_min = -2.0;
    s_arm.joint[0].q_max = 2.0;
    s_bound[0] = 2.0;
    s_from[0] -= 0.9;
    s_to[0] += 0.9;
    for (uint32_t j = 0u; j < 7u; j++) { half[j] = s_from[j] + 0.443 * (s_to[j] - s_from[j]); }
    s_s.n_volume = 2u;
    put_ball(half, 0.002f);
    expect_met(KC_GUARD_VOLUME, 1, 0.012, 1.0);
    s_s.volume[1].p_m[0] += 5.0f;
    expect_fine();
}

void test_a_check_that_runs_out_of_postures_refuses(void)
{
    kc_guard_job_t job;
    kc_work_t one = {1u, 0u};
    s_to[0] += 0.3;
    expect_fine();
    kc_guard_begin(&s_ask, &job);
    TEST_ASSERT_FALSE(kc_guard_step(&s_ask, &job, &one)); /* the first posture */
    job.at.d[0] = KC_GUARD_CLEAR_M; /* so that the next one is near */
    job.k = KC_GUARD_STEPS_MAX + 1u;
    one.used = 0u;
    (void)kc_guard_step(&s_ask, &job, &one);
    TEST_ASSERT_TRUE(job.over);
    TEST_ASSERT_TRUE(job.part < 1.0);
    TEST_ASSERT_EQUAL_INT(KC_GUARD_VOLUME, job.verdict);
    TEST_ASSERT_EQUAL_MEMORY(&job.at.why[0], &job.why, sizeof job.why); /* what was nearest of volumes */
    kc_guard_begin(&s_ask, &job);
    one.used = 0u;
    TEST_ASSERT_FALSE(kc_guard_step(&s_ask, &job, &one));
    job.at.d[0] = KC_GUARD_CLEAR_M;
    job.k = KC_GUARD_STEPS_MAX; /* one posture less: it goes on */
    one.used = 0u;
    TEST_ASSERT_FALSE(kc_guard_step(&s_ask, &job, &one));
    TEST_ASSERT_EQUAL_INT(KC_GUARD_OK, job.verdict);
}

/* Postures of a move of joint 1, which keeps the height above the ground. */
static uint32_t postures_above_ground(double free_m)
{
    kc_work_t work = kc_work_unlimited();
    kc_work_t one = {1u, 0u};
    kc_guard_job_t job;
    s_s.n_body = s_s.n_volume = 1u;
    s_s.volume[0] = (kc_volume_t){.kind = KC_VOL_BELOW};
    kc_guard_begin(&s_ask, &job);
    (void)kc_guard_step(&s_ask, &job, &one);
    s_s.volume[0].p_m[2] = (float)(job.first.d[0] - KC_GUARD_CLEAR_M - free_m);
    kc_guard_begin(&s_ask, &job);
    TEST_ASSERT_TRUE(kc_guard_step(&s_ask, &job, &work));
    TEST_ASSERT_EQUAL_INT(KC_GUARD_OK, job.verdict);
    return job.k;
}

/* As far as the free distance lets the farthest point of the arm travel, but not less than the least step. */
void test_steps_of_a_check_are_as_long_as_the_free_distance_allows(void)
{
    for (uint32_t k = 0u; k < 4u;
         k++) { /* joint 1 turns one way or the other; joint 7 may slide, but stays */
        const double by = k % 2u == 0u ? 0.3 : -0.3;
        double reach = KC_GUARD_ABOUT_M;
        setUp();
        if (k >= 2u) {
            s_arm.joint[6].type = KC_PRISMATIC;
            reach += s_arm.joint[6].q_max - s_arm.joint[6].q_min;
        }
        for (uint32_t j = 0u; j < 7u; j++) { reach += fabs(s_arm.joint[j].a_m) + fabs(s_arm.joint[j].d_m); }
        const double *tool = s_arm.tool_xyz_m;
        reach += sqrt(tool[0] * tool[0] + tool[1] * tool[1] + tool[2] * tool[2]);
        s_to[0] += by;
        for (uint32_t steps = 1u; steps < 6u; steps++) {
            TEST_ASSERT_EQUAL_UINT32(1u + steps, postures_above_ground(1.01 * fabs(by) * reach / steps));
            TEST_ASSERT_EQUAL_UINT32(2u + steps, postures_above_ground(0.99 * fabs(by) * reach / steps));
        }
        uint32_t most = (uint32_t)ceil(fabs(by) / KC_GUARD_STEP);
        TEST_ASSERT_UINT32_WITHIN(1u, 1u + most, postures_above_ground(1e-4));
    }
}

/* At the target, of volumes and of the arm itself, whichever is nearer. */
void test_the_clearance_at_a_target_is_the_smaller_of_both(void)
{
    for (uint32_t k = 0u; k < 2u; k++) {
        uint64_t cost = 0u;
        setUp();
        given_elbow(k == 0u ? 0.02 : 0.3);
        if (k == 1u) { /* the ground just below the arm */
            s_s.volume[s_s.n_volume++] = (kc_volume_t){.kind = KC_VOL_BELOW, .p_m = {0.0f, 0.0f, 0.3f}};
        }
        const double self = self_clearance_at(s_to), volume = kc_guard_clearance(&s_g, &s_body, &s_volume);
        TEST_ASSERT_TRUE(k == 0u ? self < volume : volume < self);
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, fmin(self, volume), kc_guard_clearance_at(&s_ask, &cost));
        TEST_ASSERT_TRUE(cost > 0u && cost <= kc_guard_clearance_cost(&s_ask));
    }
}
