/* kc_path.c: only verified segments. */
#include <math.h>
#include <string.h>

#include "given_tables.h"
#include "kc_path.h"
#include "unity.h"

#define NODE(c) (KC_HUB_MAX + (c))

static kc_space_t s_s;
static kc_arm_t s_arm;
static uint16_t s_path[KC_PATH_MAX];
static uint32_t s_n;

void setUp(void)
{
    given_arm(&s_arm);
    given_space(&s_s, 9u, 1u);
    s_n = 99u;
}

static void expect_path(uint32_t from, uint32_t to, const uint16_t *want, uint32_t n)
{
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_path_plan(&s_s, from, to, s_path, &s_n));
    TEST_ASSERT_EQUAL_UINT32(n, s_n);
    for (uint32_t i = 0u; i < n; i++) { TEST_ASSERT_EQUAL_UINT16(want[i], s_path[i]); }
}

void test_no_path_is_needed_to_where_the_arm_is(void)
{
    expect_path(NODE(3u), NODE(3u), NULL, 0u);
    expect_path(1u, 1u, NULL, 0u);
}

void test_a_verified_direct_move_is_taken(void)
{
    const uint16_t want[] = {NODE(4u)};
    expect_path(NODE(2u), NODE(4u), want, 1u);
}

void test_without_a_direct_segment_the_path_leads_over_both_hubs(void)
{
    const uint16_t want[] = {0u, 1u, NODE(3u)};
    expect_path(NODE(2u), NODE(3u), want, 3u); /* 2 hangs on hub 0, 3 on hub 1 */
}

void test_candidates_of_one_hub_meet_at_it(void)
{
    const uint16_t want[] = {0u, NODE(6u)};
    expect_path(NODE(2u), NODE(6u), want, 2u);
}

void test_paths_between_hubs_and_candidates(void)
{
    const uint16_t to_cand[] = {1u, NODE(3u)}, from_own[] = {NODE(2u)}, to_hub[] = {0u, 1u}, hubs[] = {1u},
                   own[] = {0u};
    expect_path(0u, NODE(3u), to_cand, 2u);
    expect_path(0u, NODE(2u), from_own, 1u);
    expect_path(NODE(2u), 1u, to_hub, 2u);
    expect_path(0u, 1u, hubs, 1u);
    expect_path(NODE(2u), 0u, own, 1u);
}

void test_the_longest_path_fits(void)
{
    given_chain(&s_s, KC_HUB_MAX);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_path_plan(&s_s, NODE(0u), NODE(15u), s_path, &s_n));
    TEST_ASSERT_EQUAL_UINT32(KC_HUB_MAX + 1u, s_n);
    for (uint32_t h = 0u; h < KC_HUB_MAX; h++) { TEST_ASSERT_EQUAL_UINT16(h, s_path[h]); }
    TEST_ASSERT_EQUAL_UINT16(NODE(15u), s_path[KC_HUB_MAX]);
}

/* From every hub of a chain to every other, back to hub 0 as well. */
void test_a_chain_is_followed_in_both_directions(void)
{
    given_chain(&s_s, 6u);
    for (uint32_t from = 0u; from < 6u; from++) {
        for (uint32_t to = 0u; to < 6u; to++) {
            uint16_t want[KC_PATH_MAX];
            uint32_t n = 0u;
            for (uint32_t h = from; h != to; n++) {
                h = from < to ? h + 1u : h - 1u;
                want[n] = (uint16_t)h;
            }
            expect_path(from, to, want, n);
            if (from != to) {
                memmove(&want[1], want, n * sizeof want[0]);
                want[0] = (uint16_t)from;
                want[n + 1u] = (uint16_t)NODE(to);
                expect_path(NODE(from), NODE(to), want, n + 2u);
            }
        }
    }
}

void test_the_shortest_path_over_hubs_is_taken_lowest_index_first(void)
{
    /* a ring 0-1-2-3-0: from 0 to 2 both paths are as long */
    const uint16_t want[] = {1u, 2u};
    given_chain(&s_s, 4u);
    s_s.hub_edge[0] |= 8u;
    s_s.hub_edge[3] |= 1u;
    expect_path(0u, 2u, want, 2u);
}

void test_hubs_that_are_not_connected_give_no_path(void)
{
    s_s.hub_edge[0] = 0u;
    s_s.hub_edge[1] = 0u;
    TEST_ASSERT_EQUAL_INT(KC_ERR_PATH, kc_path_plan(&s_s, NODE(2u), NODE(3u), s_path, &s_n));
    TEST_ASSERT_EQUAL_UINT32(0u, s_n);
}

void test_from_an_unknown_place_there_is_no_path(void)
{
    TEST_ASSERT_EQUAL_INT(KC_ERR_PATH, kc_path_plan(&s_s, KC_NODE_NONE, NODE(3u), s_path, &s_n));
    TEST_ASSERT_EQUAL_UINT32(0u, s_n);
}

void test_to_a_node_that_does_not_exist_there_is_no_path(void)
{
    TEST_ASSERT_EQUAL_INT(KC_ERR_PATH, kc_path_plan(&s_s, 0u, NODE(9u), s_path, &s_n));
    TEST_ASSERT_EQUAL_INT(KC_ERR_PATH, kc_path_plan(&s_s, 0u, 2u, s_path, &s_n));
}

void test_joints_of_a_node_are_those_of_the_table(void)
{
    double q[KC_JOINT_MAX];
    kc_path_joints(&s_s, 1u, q);
    TEST_ASSERT_EQUAL_DOUBLE(0.5, q[0]);
    TEST_ASSERT_EQUAL_DOUBLE(1.0, q[3]);
    kc_path_joints(&s_s, NODE(5u), q);
    TEST_ASSERT_EQUAL_DOUBLE((double)s_s.cand[5].q_seed[6], q[6]);
}

static const double s_bound[KC_JOINT_MAX] = {0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.4, 0.1};

void test_the_nearest_node_is_found_by_its_largest_joint_difference_in_servo_bounds(void)
{
    double q[KC_JOINT_MAX], dist;
    for (uint32_t c = 0u; c < 9u; c++) {
        kc_path_joints(&s_s, NODE(c), q);
        q[2] += 0.01;
        q[6] -= 0.02;
        TEST_ASSERT_EQUAL_UINT32(NODE(c), kc_path_nearest(&s_s, s_bound, q, &dist));
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.1, dist);
    }
    kc_path_joints(&s_s, 1u, q);
    TEST_ASSERT_EQUAL_UINT32(1u, kc_path_nearest(&s_s, s_bound, q, &dist));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, dist);
}

void test_a_joint_far_off_on_a_long_servo_bound_is_nearer_than_one_beyond_a_short_servo_bound(void)
{
    double q[KC_JOINT_MAX], dist;
    memcpy(s_s.cand[1].q_seed, s_s.cand[0].q_seed, sizeof s_s.cand[0].q_seed);
    s_s.cand[1].q_seed[6] += 0.35f;
    s_s.cand[1].q_seed[0] += 0.15f;
    kc_path_joints(&s_s, NODE(0u), q);
    q[6] += 0.35; /* candidate 1 is 0.15 rad away, candidate 0 0.35 rad */
    TEST_ASSERT_EQUAL_UINT32(NODE(0u), kc_path_nearest(&s_s, s_bound, q, &dist));
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, 0.875, dist);
}

void test_hubs_have_a_short_servo_bound_whatever_the_candidates_have(void)
{
    static const double shorter[KC_JOINT_MAX] = {0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.02, 0.1};
    double q[KC_JOINT_MAX], dist;
    kc_path_joints(&s_s, 1u, q);
    q[6] += 0.04;
    TEST_ASSERT_EQUAL_UINT32(1u, kc_path_nearest(&s_s, s_bound, q, &dist));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.04 / KC_HUB_BOUND, dist);
    TEST_ASSERT_EQUAL_UINT32(1u, kc_path_nearest(&s_s, shorter, q, &dist));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 2.0, dist);
}

static void between(const float *a, const float *b, double t, double *q)
{
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { q[j] = (double)a[j] + t * ((double)b[j] - (double)a[j]); }
}

void test_a_place_on_a_verified_segment_leads_to_one_of_its_ends(void)
{
    double q[KC_JOINT_MAX];
    given_chain(&s_s, 3u);
    for (uint32_t h = 0u; h < 3u; h++) {
        for (uint32_t j = 0u; j < s_s.n_joints; j++) {
            s_s.hub_q[h][j] = (float)(h == j + 1u ? 0.5 : 0.0);
            s_s.cand[h].q_seed[j] = (float)(h == j ? 1.0 : -0.25);
        }
    }
    between(s_s.hub_q[0], s_s.hub_q[1], 0.4, q);
    TEST_ASSERT_EQUAL_UINT32(0u, kc_path_on_segment(&s_s, q, 0.01));
    between(s_s.hub_q[0], s_s.hub_q[2], 0.4, q); /* no segment in a chain */
    TEST_ASSERT_EQUAL_UINT32(KC_NODE_NONE, kc_path_on_segment(&s_s, q, 0.01));
    between(s_s.cand[2].q_seed, s_s.hub_q[2], 0.3, q);
    TEST_ASSERT_EQUAL_UINT32(2u, kc_path_on_segment(&s_s, q, 0.01));
    q[1] += 0.02;
    TEST_ASSERT_EQUAL_UINT32(KC_NODE_NONE, kc_path_on_segment(&s_s, q, 0.01));
    between(s_s.cand[2].q_seed, s_s.cand[1].q_seed, 0.6, q);
    TEST_ASSERT_EQUAL_UINT32(KC_NODE_NONE, kc_path_on_segment(&s_s, q, 0.01));
    s_s.edge[2u * 1u / 2u / 8u] |= (uint8_t)(1u << (2u * 1u / 2u + 1u)); /* bit 2 (2 - 1) / 2 + 1 = 2 */
    TEST_ASSERT_EQUAL_UINT32(NODE(1u), kc_path_on_segment(&s_s, q, 0.01));
    s_s.hub_edge[0] |= 4u;
    s_s.hub_edge[2] |= 1u;
    between(s_s.hub_q[0], s_s.hub_q[2], 0.4, q); /* now there is one */
    TEST_ASSERT_EQUAL_UINT32(0u, kc_path_on_segment(&s_s, q, 0.01));
}

void test_an_empty_space_has_no_nearest_node(void)
{
    double q[KC_JOINT_MAX] = {0.0}, dist;
    memset(&s_s, 0, sizeof s_s);
    TEST_ASSERT_EQUAL_UINT32(KC_NODE_NONE, kc_path_nearest(&s_s, s_bound, q, &dist));
    TEST_ASSERT_TRUE(isinf(dist));
}

/* ---- local initial poses ---- */

/* Candidates 6 to 8 are local initial poses, 8 in reserve, ahead of two other initial poses. */
static void given_first(void)
{
    static const uint16_t initial[] = {6u, 7u, 8u, 0u, 1u};
    for (uint32_t c = 6u; c < 9u; c++) { s_s.cand[c].why = KC_CAND_LOCAL | 1u; }
    s_s.cand[8].why |= KC_CAND_RESERVE;
    memcpy(s_s.initial, initial, sizeof initial);
    s_s.n_initial = 5u;
}

void test_hubs_and_local_initial_poses_have_a_short_servo_bound_and_others_their_own(void)
{
    given_first();
    TEST_ASSERT_EQUAL_DOUBLE(KC_HUB_BOUND, kc_path_bound(&s_s, 1u, 0.4));
    TEST_ASSERT_EQUAL_DOUBLE(KC_HUB_BOUND, kc_path_bound(&s_s, NODE(6u), 0.4));
    TEST_ASSERT_EQUAL_DOUBLE(0.02, kc_path_bound(&s_s, NODE(8u), 0.02));
    TEST_ASSERT_EQUAL_DOUBLE(0.4, kc_path_bound(&s_s, NODE(5u), 0.4));
}

void test_a_local_initial_pose_has_the_bound_of_a_hub(void)
{
    double q[KC_JOINT_MAX], dist;
    given_first();
    kc_path_joints(&s_s, NODE(7u), q);
    q[6] += 0.04;
    TEST_ASSERT_EQUAL_UINT32(NODE(7u), kc_path_nearest(&s_s, s_bound, q, &dist));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.04 / KC_HUB_BOUND, dist);
}

/* ---- on a segment ---- */

static void part_between(uint32_t a, uint32_t b, double part, double *q)
{
    double to[KC_JOINT_MAX];
    kc_path_joints(&s_s, a, q);
    kc_path_joints(&s_s, b, to);
    for (uint32_t j = 0u; j < 7u; j++) { q[j] += part * (to[j] - q[j]); }
}

void test_a_place_on_a_verified_segment_is_known_from_both_ends(void)
{
    const uint32_t pair[3][2] = {{0u, 1u}, {NODE(2u), NODE(4u)}, {NODE(3u), s_s.cand[3].hub}};
    double q[KC_JOINT_MAX];
    for (uint32_t k = 0u; k < 3u; k++) {
        part_between(pair[k][0], pair[k][1], 0.4, q);
        TEST_ASSERT_TRUE(kc_path_on(&s_s, pair[k][0], pair[k][1], q, 1e-6));
        TEST_ASSERT_TRUE(kc_path_on(&s_s, pair[k][1], pair[k][0], q, 1e-6));
        TEST_ASSERT_TRUE(kc_path_leads_to(&s_s, pair[k][0], q, 1e-6));
        TEST_ASSERT_TRUE(kc_path_leads_to(&s_s, pair[k][1], q, 1e-6));
        q[2] += 0.01;
        TEST_ASSERT_FALSE(kc_path_on(&s_s, pair[k][0], pair[k][1], q, 1e-3));
        TEST_ASSERT_FALSE(kc_path_leads_to(&s_s, pair[k][0], q, 1e-3));
    }
}

/* Beyond an end in the direction of the segment, and beside it at the end. */
void test_a_place_beyond_the_ends_of_a_segment_is_not_on_it(void)
{
    static const double part[] = {-0.2, -0.03, 0.0, 0.5, 1.0, 1.03, 1.2};
    double q[KC_JOINT_MAX];
    for (uint32_t k = 0u; k < sizeof part / sizeof part[0]; k++) {
        const bool on = part[k] >= 0.0 && part[k] <= 1.0;
        part_between(0u, 1u, part[k], q); /* joint 4 moves by 1 rad */
        TEST_ASSERT_EQUAL_INT(on, kc_path_on(&s_s, 0u, 1u, q, 0.02));
        TEST_ASSERT_EQUAL_INT(on, kc_path_on(&s_s, 1u, 0u, q, 0.02));
        TEST_ASSERT_TRUE(kc_path_on(&s_s, 0u, 1u, q, 0.21));
        TEST_ASSERT_EQUAL_UINT32(on ? 0u : KC_NODE_NONE, kc_path_on_segment(&s_s, q, 0.02));
        q[6] += 0.019;
        TEST_ASSERT_EQUAL_INT(on, kc_path_on(&s_s, 0u, 1u, q, 0.02));
        q[6] += 0.002;
        TEST_ASSERT_FALSE(kc_path_on(&s_s, 0u, 1u, q, 0.02));
    }
}

void test_a_posture_between_nodes_without_a_segment_is_on_none(void)
{
    double q[KC_JOINT_MAX];
    part_between(NODE(2u), NODE(3u), 0.4, q); /* no edge */
    TEST_ASSERT_FALSE(kc_path_on(&s_s, NODE(2u), NODE(3u), q, 1e-3));
    part_between(NODE(3u), 1u - s_s.cand[3].hub, 0.4, q); /* the other hub */
    TEST_ASSERT_FALSE(kc_path_on(&s_s, NODE(3u), 1u - s_s.cand[3].hub, q, 1e-3));
    part_between(0u, 1u, 0.4, q);
    TEST_ASSERT_FALSE(kc_path_on(&s_s, 0u, 2u, q, 10.0)); /* no such node */
    TEST_ASSERT_FALSE(kc_path_on(&s_s, NODE(9u), 0u, q, 10.0));
}

/* ---- found missing by mutants ---- */

/* What lies beyond the arm's joints in arrays plays no part. */
void test_joints_that_the_arm_does_not_have_are_not_looked_at(void)
{
    double q[KC_JOINT_MAX], bound[KC_JOINT_MAX], dist = 0.0;
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { bound[j] = 0.4; }
    kc_path_joints(&s_s, NODE(3u), q);
    q[7] = 9.0;
    s_s.cand[3].q_seed[7] = -5.0f;
    TEST_ASSERT_EQUAL_UINT32(NODE(3u), kc_path_nearest(&s_s, bound, q, &dist));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, dist);
    TEST_ASSERT_TRUE(kc_path_on(&s_s, s_s.cand[3].hub, NODE(3u), q, 1e-6));
    TEST_ASSERT_TRUE(kc_path_leads_to(&s_s, NODE(3u), q, 1e-6));
    TEST_ASSERT_EQUAL_UINT32(s_s.cand[3].hub, kc_path_on_segment(&s_s, q, 1e-6));
}

/* Bits of a node itself and of nodes beyond the table's number name no segment. */
void test_nodes_that_the_table_does_not_have_are_not_looked_at(void)
{
    double q[KC_JOINT_MAX], dist = 0.0;
    uint32_t last = s_s.n_cand - 1u, hub = s_s.cand[last].hub;
    memset(s_s.edge, 0xff, sizeof s_s.edge);
    for (uint32_t h = 0u; h < KC_HUB_MAX; h++) { s_s.hub_edge[h] = 0xffffu; }
    part_between(NODE(last), NODE(2u), 0.4, q);
    TEST_ASSERT_EQUAL_UINT32(NODE(2u), kc_path_on_segment(&s_s, q, 1e-6));
    s_s.n_cand = last;
    TEST_ASSERT_EQUAL_UINT32(KC_NODE_NONE, kc_path_on_segment(&s_s, q, 1e-6));
    TEST_ASSERT_FALSE(kc_path_leads_to(&s_s, NODE(2u), q, 1e-6));
    part_between(NODE(last), hub, 0.4, q);
    TEST_ASSERT_EQUAL_UINT32(KC_NODE_NONE, kc_path_on_segment(&s_s, q, 1e-6));
    TEST_ASSERT_FALSE(kc_path_leads_to(&s_s, hub, q, 1e-6));
    kc_path_joints(&s_s, NODE(last), q);
    TEST_ASSERT_TRUE(kc_path_nearest(&s_s, s_bound, q, &dist) != NODE(last));
    TEST_ASSERT_TRUE(dist > 1.0);
    s_s.n_hub = 1u;
    s_s.n_cand = 0u;
    kc_path_joints(&s_s, 1u, q);
    TEST_ASSERT_EQUAL_UINT32(KC_NODE_NONE, kc_path_on_segment(&s_s, q, 1e-6));
    TEST_ASSERT_EQUAL_UINT32(0u, kc_path_nearest(&s_s, s_bound, q, &dist));
    kc_path_joints(&s_s, 0u, q); /* at a hub, but on no segment */
    TEST_ASSERT_EQUAL_UINT32(KC_NODE_NONE, kc_path_on_segment(&s_s, q, 1e-6));
}

void test_a_node_is_a_hub_or_a_candidate_of_the_table(void)
{
    TEST_ASSERT_TRUE(kc_path_is_node(&s_s, s_s.n_hub - 1u));
    TEST_ASSERT_FALSE(kc_path_is_node(&s_s, s_s.n_hub));
    TEST_ASSERT_FALSE(kc_path_is_node(&s_s, KC_HUB_MAX - 1u));
    TEST_ASSERT_TRUE(kc_path_is_node(&s_s, NODE(0u)));
    TEST_ASSERT_TRUE(kc_path_is_node(&s_s, NODE(s_s.n_cand - 1u)));
    TEST_ASSERT_FALSE(kc_path_is_node(&s_s, NODE(s_s.n_cand)));
    TEST_ASSERT_FALSE(kc_path_is_node(&s_s, KC_NODE_NONE));
}
