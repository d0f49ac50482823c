/* kc_space.c: spaces that can be trusted. */
#include <math.h>
#include <string.h>

#include "given_tables.h"
#include "kc_space.h"
#include "unity.h"

static kc_space_t s_s;
static kc_arm_t s_arm;

void setUp(void)
{
    given_arm(&s_arm);
    given_space(&s_s, 9u, 1u);
}

void test_an_edge_is_the_same_in_both_directions(void)
{
    TEST_ASSERT_TRUE(kc_space_edge(&s_s, 2u, 4u));
    TEST_ASSERT_TRUE(kc_space_edge(&s_s, 4u, 2u));
    TEST_ASSERT_FALSE(kc_space_edge(&s_s, 2u, 3u));
}

void test_there_is_no_edge_to_itself_or_beyond_the_candidates(void)
{
    TEST_ASSERT_FALSE(kc_space_edge(&s_s, 2u, 2u));
    s_s.edge[sizeof s_s.edge - 1u] = 0xffu;
    TEST_ASSERT_FALSE(kc_space_edge(&s_s, 1023u, 1022u));
    memset(s_s.edge, 0xff, sizeof s_s.edge);
    TEST_ASSERT_TRUE(kc_space_edge(&s_s, 8u, 2u));
    TEST_ASSERT_FALSE(kc_space_edge(&s_s, 9u, 2u)); /* the first that there is not */
}

/* Bit i (i - 1) / 2 + j, from the lowest of each byte: of a pair alone, and of all but that. */
void test_every_pair_of_candidates_has_a_bit_of_its_own(void)
{
    const uint32_t n = 12u;
    given_space(&s_s, n, 1u);
    for (uint32_t hi = 1u, bit = 0u; hi < n; hi++) {
        for (uint32_t lo = 0u; lo < hi; lo++, bit++) {
            for (uint32_t others = 0u; others < 2u; others++) {
                memset(s_s.edge, others != 0u ? 0xff : 0, sizeof s_s.edge);
                s_s.edge[bit / 8u] ^= (uint8_t)(1u << (bit % 8u));
                for (uint32_t i = 0u; i < n; i++) {
                    for (uint32_t j = 0u; j < n; j++) {
                        const bool pair = (i == hi && j == lo) || (i == lo && j == hi);
                        const bool edge = i != j && pair == (others == 0u);
                        TEST_ASSERT_EQUAL_INT(edge, kc_space_edge(&s_s, i, j));
                    }
                }
            }
        }
    }
}

/* ---- local initial poses ---- */

/* Candidates 6 to 8 are local initial poses, 8 in reserve, ahead of two other initial poses. */
static void given_first(void)
{
    static const uint16_t initial[] = {6u, 7u, 8u, 0u, 1u};
    memset(s_s.edge, 0, sizeof s_s.edge);
    for (uint32_t c = 6u; c < 9u; c++) {
        s_s.cand[c].why = KC_CAND_LOCAL | 1u;
        s_s.cand[c].hub = 0u;
        memcpy(s_s.cand[c].q_seed, s_s.hub_q[0], sizeof s_s.cand[c].q_seed);
    }
    s_s.cand[8].why |= KC_CAND_RESERVE;
    memcpy(s_s.initial, initial, sizeof initial);
    s_s.n_initial = 5u;
}

void test_a_bit_of_why_says_what_is_a_local_initial_pose_and_what_a_reserve_pose(void)
{
    given_first();
    s_s.cand[0].why = 0x3fffu;
    for (uint32_t c = 0u; c < 9u; c++) {
        TEST_ASSERT_EQUAL_INT(c >= 6u, kc_space_local(&s_s, c));
        TEST_ASSERT_EQUAL_INT(c == 8u, kc_space_reserve(&s_s, c));
    }
}

void test_local_initial_poses_are_counted_among_the_initial_poses(void)
{
    TEST_ASSERT_EQUAL_UINT32(0u, kc_space_n_local(&s_s));
    given_first();
    TEST_ASSERT_EQUAL_UINT32(3u, kc_space_n_local(&s_s));
}

/* ---- validation ---- */

static void expect_valid(const kc_arm_t *arm)
{
    int32_t index = -7;
    double got = -7.0;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_space_validate(&s_s, arm, &index, &got));
    TEST_ASSERT_EQUAL_INT32(-7, index);
}

static void expect_refused(int32_t want_index, double want_got)
{
    int32_t index = -7;
    double got = -7.0;
    TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, kc_space_validate(&s_s, &s_arm, &index, &got));
    TEST_ASSERT_EQUAL_INT32(want_index, index);
    if (isnan(want_got)) {
        TEST_ASSERT_TRUE(isnan(got));
    } else {
        TEST_ASSERT_DOUBLE_WITHIN(1e-6, want_got, got);
    }
    setUp();
}

void test_a_good_space_is_accepted_with_and_without_an_arm(void)
{
    expect_valid(&s_arm);
    expect_valid(NULL);
    given_space(&s_s, KC_CAND_MAX, 1u);
    expect_valid(&s_arm);
    given_space(&s_s, 1u, 1u);
    expect_valid(&s_arm);
    given_chain(&s_s, KC_HUB_MAX);
    expect_valid(&s_arm);
}

void test_impossible_counts_are_refused(void)
{
    s_s.n_cand = 0u;
    expect_refused(-1, 0.0);
    s_s.n_cand = KC_CAND_MAX + 1u;
    expect_refused(-1, KC_CAND_MAX + 1.0);
    s_s.n_hub = 0u;
    expect_refused(-1, 0.0);
    s_s.n_hub = KC_HUB_MAX + 1u;
    expect_refused(-1, KC_HUB_MAX + 1.0);
    s_s.n_joints = 0u;
    expect_refused(-1, 0.0);
    s_s.n_joints = KC_JOINT_MAX + 1u;
    expect_refused(-1, KC_JOINT_MAX + 1.0);
    s_s.n_initial = KC_INITIAL_MAX + 1u;
    expect_refused(-1, KC_INITIAL_MAX + 1.0);
}

void test_a_number_of_joints_that_no_arm_has_is_refused_without_an_arm(void)
{
    static const uint32_t bad[2] = {0u, KC_JOINT_MAX + 1u};
    for (uint32_t i = 0u; i < 2u; i++) {
        int32_t index = -7;
        double got = -7.0;
        s_s.n_joints = bad[i];
        TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, kc_space_validate(&s_s, NULL, &index, &got));
        TEST_ASSERT_EQUAL_INT32(-1, index);
        TEST_ASSERT_EQUAL_DOUBLE(bad[i], got);
    }
}

void test_another_number_of_joints_than_the_arm_has_is_refused(void)
{
    s_s.n_joints = 6u;
    expect_refused(-1, 6.0);
}

void test_the_servo_bound_of_every_joint_must_be_positive_and_finite(void)
{
    for (uint32_t j = 0u; j < s_arm.n_joints; j++) {
        s_s.servo_bound[j] = 0.0f;
        expect_refused(-1, 0.0);
        s_s.servo_bound[j] = NAN;
        expect_refused(-1, NAN);
    }
    s_s.servo_bound[s_arm.n_joints] = 0.0f; /* there is no such joint */
    s_s.servo_bound[0] = 1e-3f;
    expect_valid(&s_arm);
}

void test_an_initial_pose_that_is_no_candidate_is_refused(void)
{
    for (uint32_t k = 0u; k < 3u; k++) {
        given_space(&s_s, 9u, 1u);
        s_s.initial[k] = 9u;
        expect_refused(KC_SPACE_INDEX_INITIAL + (int32_t)k, 9.0);
    }
    given_space(&s_s, 9u, 1u);
    s_s.initial[3] = 9u; /* behind the last one */
    expect_valid(&s_arm);
}

void test_an_initial_pose_listed_twice_is_refused(void)
{
    given_first();
    s_s.initial[1] = s_s.initial[0]; /* else the local initial pose it stood for would never be taken */
    expect_refused(KC_SPACE_INDEX_INITIAL + 1, (double)s_s.initial[0]);
}

void test_a_hub_outside_the_joint_limits_is_refused(void)
{
    s_s.hub_q[1][1] = 2.1f;
    expect_refused(KC_SPACE_INDEX_HUB + 1, 2.1);
    s_s.hub_q[0][3] = -1.0f;
    expect_refused(KC_SPACE_INDEX_HUB, -1.0);
}

/* Every joint of every hub and candidate, beyond either limit. */
void test_every_joint_of_every_node_has_its_limits(void)
{
    for (uint32_t k = 0u; k < 11u * 7u * 2u; k++) {
        const uint32_t node = k / 14u, j = k / 2u % 7u;
        float *q = node < 2u ? s_s.hub_q[node] : s_s.cand[node - 2u].q_seed;
        const double limit = k % 2u == 0u ? s_arm.joint[j].q_max + 0.01 : s_arm.joint[j].q_min - 0.01;
        q[j] = (float)limit;
        expect_refused(node < 2u ? KC_SPACE_INDEX_HUB + (int32_t)node : (int32_t)node - 2,
                       (double)(float)limit);
        given_space(&s_s, 9u, 1u);
    }
}

void test_each_candidate_needs_a_hub_that_is_reached(void)
{
    for (int32_t i = 0; i < 9; i++) {
        given_space(&s_s, 9u, 1u);
        s_s.n_hub = 3u; /* hub 2 stands alone */
        expect_valid(&s_arm);
        s_s.cand[i].hub = 2u;
        expect_refused(i, 2.0);
    }
}

void test_a_hub_segment_in_one_direction_only_is_refused(void)
{
    s_s.hub_edge[1] = 0u;
    expect_refused(KC_SPACE_INDEX_HUB, 2.0);
}

void test_a_segment_to_a_hub_that_does_not_exist_is_refused(void)
{
    s_s.hub_edge[1] = 5u;
    expect_refused(KC_SPACE_INDEX_HUB + 1, 5.0);
}

void test_a_candidate_with_nan_is_refused_wherever_it_is(void)
{
    s_s.cand[3].p_m[2] = NAN;
    expect_refused(3, NAN);
    s_s.cand[3].q_wxyz[1] = NAN;
    expect_refused(3, NAN);
    s_s.cand[3].q_seed[6] = NAN;
    expect_refused(3, NAN);
    s_s.cand[3].pan_rad = NAN;
    expect_refused(3, NAN);
    s_s.cand[3].tilt_rad = NAN;
    expect_refused(3, NAN);
}

void test_a_candidate_off_the_unit_norm_is_refused(void)
{
    for (uint32_t k = 0u; k < 4u; k++) { s_s.cand[3].q_wxyz[k] *= 1.00001f; }
    expect_refused(3, 1.00001);
}

void test_a_quaternion_shorter_or_longer_than_one_is_refused(void)
{
    for (uint32_t k = 0u; k < 8u; k++) {
        const float norm = k % 2u == 0u ? 0.999f : 1.001f;
        memset(s_s.cand[4].q_wxyz, 0, sizeof s_s.cand[4].q_wxyz);
        s_s.cand[4].q_wxyz[k / 2u] = norm;
        expect_refused(4, (double)norm);
        given_space(&s_s, 9u, 1u);
    }
}

void test_a_seed_outside_the_joint_limits_is_refused(void)
{
    s_s.cand[8].q_seed[4] = 1.25f;
    expect_refused(8, 1.25);
}

void test_a_seed_at_a_joint_limit_is_inside(void)
{
    s_arm.joint[2].q_min = -2.75; /* both exact in single precision */
    s_arm.joint[2].q_max = 2.75;
    s_s.cand[4].q_seed[2] = 2.75f;
    expect_valid(&s_arm);
    s_s.cand[4].q_seed[2] = -2.75f;
    expect_valid(&s_arm);
}

void test_a_candidate_on_a_hub_that_does_not_exist_is_refused(void)
{
    s_s.cand[8].hub = 2u;
    expect_refused(8, 2.0);
}

void test_an_edge_bit_beyond_the_candidates_is_refused(void)
{
    s_s.edge[4] = (uint8_t)(s_s.edge[4] | 0x10u); /* 9 candidates: bits 0..35 */
    expect_refused(-1, (double)(s_s.edge[4]));
    s_s.edge[sizeof s_s.edge - 1u] = 1u;
    expect_refused(-1, 1.0);
}

void test_a_candidate_that_no_hub_segment_leads_to_is_refused(void)
{
    s_s.hub_edge[0] = 0u;
    s_s.hub_edge[1] = 0u;
    expect_refused(1, 1.0); /* the first one on hub 1 */
}

/* Hubs in a chain 0, 4, 3, 2, 1: from hub 0 each round reaches one more. */
void test_a_hub_at_the_end_of_a_chain_is_reached(void)
{
    static const uint8_t chain[5] = {0u, 4u, 3u, 2u, 1u};
    given_space(&s_s, 9u, 1u);
    s_s.n_hub = 5u;
    memset(s_s.hub_edge, 0, sizeof s_s.hub_edge);
    for (uint32_t k = 0u; k + 1u < 5u; k++) {
        s_s.hub_edge[chain[k]] = (uint16_t)(s_s.hub_edge[chain[k]] | 1u << chain[k + 1u]);
        s_s.hub_edge[chain[k + 1u]] = (uint16_t)(s_s.hub_edge[chain[k + 1u]] | 1u << chain[k]);
    }
    s_s.cand[8].hub = 1u;
    expect_valid(NULL);
    s_s.hub_edge[4] = 1u; /* cut behind hub 4 */
    s_s.hub_edge[3] = 1u << 2;
    for (uint32_t i = 0u; i < 8u; i++) { s_s.cand[i].hub = 4u; }
    expect_refused(8, 1.0);
}

void test_an_unused_hub_may_be_isolated(void)
{
    s_s.n_hub = 3u;
    expect_valid(&s_arm);
}

/* ---- bodies and volumes ---- */

void test_too_many_bodies_or_volumes_are_refused(void)
{
    s_s.n_body = KC_BODY_MAX + 1u;
    expect_refused(-1, KC_BODY_MAX + 1.0);
    s_s.n_volume = KC_VOLUME_MAX + 1u;
    expect_refused(-1, KC_VOLUME_MAX + 1.0);
    s_s.n_body = 0u;
    s_s.volume[0].excluded = 0u;
    s_s.n_volume = 0u;
    expect_valid(&s_arm);
}

/* As many of everything as there may be. */
void test_the_largest_counts_are_accepted(void)
{
    given_space(&s_s, 40u, 1u);
    for (uint32_t i = 2u; i < KC_BODY_MAX; i++) { s_s.body[i] = s_s.body[0]; }
    for (uint32_t i = 2u; i < KC_VOLUME_MAX; i++) { s_s.volume[i] = s_s.volume[0]; }
    for (uint32_t i = 0u; i < KC_INITIAL_MAX; i++) { s_s.initial[i] = (uint16_t)i; }
    s_s.n_body = KC_BODY_MAX;
    expect_valid(&s_arm);
    s_s.n_volume = KC_VOLUME_MAX;
    expect_valid(&s_arm);
    s_s.n_initial = KC_INITIAL_MAX;
    expect_valid(&s_arm);
    s_s.n_hub = KC_HUB_MAX;
    expect_valid(&s_arm);
    s_s.n_initial = 0u;
    s_s.n_body = s_s.n_volume = 0u;
    expect_valid(&s_arm);
}

void test_a_body_that_is_none_is_refused(void)
{
    const int32_t at = KC_SPACE_INDEX_BODY + 1;
    s_s.body[1].frame = 8u;
    expect_refused(at, 8.0);
    s_s.body[1].start_m[2] = NAN;
    expect_refused(at, NAN);
    s_s.body[1].end_m[0] = INFINITY;
    expect_refused(at, INFINITY);
    s_s.body[1].radius_m = 0.0f;
    expect_refused(at, 0.0);
    s_s.body[1].radius_m = NAN;
    expect_refused(at, NAN);
    s_s.body[1].radius_m = INFINITY;
    expect_refused(at, INFINITY);
}

void test_a_body_that_must_not_meet_itself_or_one_after_it_is_refused(void)
{
    const int32_t at = KC_SPACE_INDEX_BODY + 1;
    s_s.body[1].collision_pairs = 1u;
    expect_valid(&s_arm);
    s_s.body[1].collision_pairs = 2u;
    expect_refused(at, 2.0);
    s_s.body[0].collision_pairs = 1u;
    expect_refused(at - 1, 1.0);
}

void test_errors_that_it_was_verified_for_must_be_sizes(void)
{
    const int32_t at = KC_SPACE_INDEX_VERIFIED + 6;
    s_s.verified[6] = (kc_dh_bound_t){0.0, 0.0, 0.0, 0.0};
    expect_valid(&s_arm);
    s_s.verified[6].phi_rad = -1.0;
    expect_refused(at, -1.0);
    s_s.verified[6].alpha_rad = NAN;
    expect_refused(at, NAN);
    s_s.verified[6].a_m = INFINITY;
    expect_refused(at, INFINITY);
    s_s.verified[6].d_m = -1.0;
    expect_refused(at, -1.0);
}

void test_local_initial_poses_must_lead_the_initial_poses(void)
{
    given_first();
    expect_valid(&s_arm);
    s_s.initial[1] = 0u;
    s_s.initial[3] = 7u;
    expect_refused(KC_SPACE_INDEX_INITIAL + 1, 0.0);
    given_first();
    s_s.initial[0] = 0u;
    s_s.initial[3] = 6u;
    expect_refused(KC_SPACE_INDEX_INITIAL, 0.0);
}

/* The guard does not check the clearance of moves to and from them: the way has to be short, and over hub 0. */
void test_a_local_initial_pose_far_from_the_park_pose_is_refused(void)
{
    int32_t index;
    double got;
    for (uint32_t j = 0u; j < s_s.n_joints; j++) {
        for (int sign = -1; sign <= 1; sign += 2) {
            given_first();
            s_s.cand[8].q_seed[j] = s_s.hub_q[0][j] + (float)sign * 0.999f;
            TEST_ASSERT_EQUAL_INT(KC_OK, kc_space_validate(&s_s, NULL, &index, &got));
            s_s.cand[8].q_seed[j] = s_s.hub_q[0][j] + (float)sign * 1.25f;
            TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, kc_space_validate(&s_s, NULL, &index, &got));
            TEST_ASSERT_EQUAL_INT(8, index);
            TEST_ASSERT_DOUBLE_WITHIN(1e-6, 1.25, got);
        }
    }
}

void test_a_local_initial_pose_of_another_hub_is_refused(void)
{
    given_first();
    s_s.cand[7].hub = 1u;
    expect_refused(7, 1.0);
}

static void set_edge(uint32_t hi, uint32_t lo)
{
    uint32_t bit = hi * (hi - 1u) / 2u + lo;
    s_s.edge[bit / 8u] |= (uint8_t)(1u << bit % 8u);
}

/* It would lead far away without a check of the clearance. */
void test_a_segment_between_a_local_initial_pose_and_a_candidate_does_not_count(void)
{
    given_first();
    set_edge(7u, 3u);
    set_edge(8u, 7u);
    set_edge(5u, 3u);
    expect_valid(&s_arm);
    TEST_ASSERT_FALSE(kc_space_edge(&s_s, 7u, 3u));
    TEST_ASSERT_FALSE(kc_space_edge(&s_s, 3u, 7u));
    TEST_ASSERT_FALSE(kc_space_edge(&s_s, 8u, 7u));
    TEST_ASSERT_TRUE(kc_space_edge(&s_s, 5u, 3u));
}

void test_a_local_initial_pose_outside_the_initial_list_is_refused(void)
{
    given_first();
    s_s.cand[4].why = KC_CAND_LOCAL;
    expect_refused(8, (double)(KC_CAND_LOCAL | KC_CAND_RESERVE | 1u)); /* one too many up to here */
}

void test_a_reserve_pose_that_is_no_local_initial_pose_is_refused(void)
{
    for (int32_t c = 0; c < 9; c += 4) {
        s_s.cand[c].why = KC_CAND_RESERVE | 1u;
        expect_refused(c, (double)(KC_CAND_RESERVE | 1u));
    }
}

void test_a_volume_that_is_none_is_refused(void)
{
    const int32_t at = KC_SPACE_INDEX_VOLUME + 1;
    s_s.volume[1].kind = 4u;
    expect_refused(at, 4.0);
    s_s.volume[1].excluded = 4u; /* there are two bodies */
    expect_refused(at, 4.0);
    s_s.volume[1].p_m[1] = NAN;
    expect_refused(at, NAN);
    s_s.volume[1].size_m[1] = NAN;
    expect_refused(at, NAN);
    for (uint32_t k = 0u; k < 3u; k++) {
        s_s.volume[1].size_m[k] = 0.0f;
        expect_refused(at, 0.0);
        s_s.volume[1].size_m[k] = -0.5f;
        expect_refused(at, -0.5);
    }
    s_s.volume[1].kind = KC_VOL_CAPSULE; /* has no radius */
    expect_refused(at, 0.0);
    s_s.volume[1].kind = KC_VOL_SPHERE;
    expect_refused(at, 0.0);
    s_s.volume[1].kind = KC_VOL_SPHERE;
    s_s.volume[1].radius_m = 0.1f;
    expect_valid(&s_arm);
}

/* ---- stops ---- */

void test_a_stop_is_at_a_part_of_the_segment_from_the_hub(void)
{
    double q[KC_JOINT_MAX];
    s_s.n_stop = 3u;
    s_s.cand[1].hub = 1u;
    s_s.stop[1][0] = 64u;
    s_s.stop[1][1] = 192u;
    TEST_ASSERT_EQUAL_UINT32(0u, kc_space_n_stops(&s_s, 0u));
    TEST_ASSERT_EQUAL_UINT32(2u, kc_space_n_stops(&s_s, 1u));
    s_s.stop[1][2] = 200u;
    TEST_ASSERT_EQUAL_UINT32(3u, kc_space_n_stops(&s_s, 1u));
    s_s.stop[1][3] = 201u; /* beyond what the table has */
    TEST_ASSERT_EQUAL_UINT32(3u, kc_space_n_stops(&s_s, 1u));
    kc_space_stop(&s_s, 1u, 1u, q);
    for (uint32_t j = 0u; j < 7u; j++) {
        double a = (double)s_s.hub_q[1][j], b = (double)s_s.cand[1].q_seed[j];
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.25 * a + 0.75 * b, q[j]);
    }
}

void test_stops_are_in_order_and_local_initial_poses_have_none(void)
{
    const uint8_t good[4] = {3u, 7u, 0u, 0u}, back[4] = {7u, 3u, 0u, 0u}, twice[4] = {7u, 7u, 0u, 0u};
    const uint8_t gap[4] = {0u, 3u, 0u, 0u};
    memcpy(s_s.stop[2], good, sizeof good);
    for (uint32_t i = 0u; i < 4u; i++) { TEST_ASSERT_TRUE(kc_space_stop_fits(&s_s, 2u, i)); }
    s_s.cand[2].why |= KC_CAND_LOCAL;
    TEST_ASSERT_FALSE(kc_space_stop_fits(&s_s, 2u, 0u));
    TEST_ASSERT_TRUE(kc_space_stop_fits(&s_s, 2u, 2u)); /* none there */
    s_s.cand[2].why = 0u;
    memcpy(s_s.stop[2], back, sizeof back);
    TEST_ASSERT_FALSE(kc_space_stop_fits(&s_s, 2u, 1u));
    memcpy(s_s.stop[2], twice, sizeof twice);
    TEST_ASSERT_FALSE(kc_space_stop_fits(&s_s, 2u, 1u));
    memcpy(s_s.stop[2], gap, sizeof gap);
    TEST_ASSERT_FALSE(kc_space_stop_fits(&s_s, 2u, 1u));
}
