/* kc_reach.c: no tags, the search, the side of an approach. */
#include <math.h>

#include "given_tables.h"
#include "kc_reach.h"
#include "unity.h"

static kc_camera_t s_camera;
static kc_config_t s_config;

void setUp(void)
{
    given_camera(&s_camera);
    given_config(&s_config);
    s_config.search_steps = 49u;
    s_config.search_step_rad = 0.1;
}

void test_without_tags_the_seed_comes_first_then_the_search_then_the_candidate_is_skipped(void)
{
    kc_tried_t t = {false, false, false, false};
    TEST_ASSERT_EQUAL_INT(KC_NO_TAGS_SEED, kc_reach_no_tags(&t, false));
    TEST_ASSERT_EQUAL_INT(KC_NO_TAGS_SEARCH, kc_reach_no_tags(&t, true)); /* it stands there */
    t.seed = true;
    TEST_ASSERT_EQUAL_INT(KC_NO_TAGS_SEARCH, kc_reach_no_tags(&t, false));
    t.searched = true;
    TEST_ASSERT_EQUAL_INT(KC_NO_TAGS_SKIP, kc_reach_no_tags(&t, false));
}

void test_tags_that_were_detected_and_lost_are_never_searched(void)
{
    for (int bits = 0; bits < 4; bits++) {
        kc_tried_t t = {true, (bits & 1) != 0, (bits & 2) != 0, false};
        TEST_ASSERT_EQUAL_INT(KC_NO_TAGS_RETREAT, kc_reach_no_tags(&t, bits == 0));
        t.retreated = true; /* once */
        TEST_ASSERT_EQUAL_INT(KC_NO_TAGS_SKIP, kc_reach_no_tags(&t, bits == 0));
    }
}

void test_the_spiral_covers_square_rings_once_each_a_step_from_the_one_before(void)
{
    int seen[7][7] = {{0}};
    double x0 = 0.0, y0 = 0.0;
    for (uint32_t i = 1u; i <= 48u; i++) {
        double x = 0.0, y = 0.0;
        kc_reach_spiral(i, &x, &y);
        TEST_ASSERT_EQUAL_DOUBLE(1.0, fabs(x - x0) + fabs(y - y0));
        TEST_ASSERT_TRUE(fabs(x) <= 3.0 && fabs(y) <= 3.0);
        TEST_ASSERT_EQUAL_INT(0, seen[(int)x + 3][(int)y + 3]++);
        if (i == 8u) { TEST_ASSERT_EQUAL_INT(0, seen[0][3] + seen[6][3] + seen[3][0] + seen[3][6]); }
        x0 = x;
        y0 = y;
    }
}

void test_before_the_first_measurement_all_places_are_searched(void)
{
    TEST_ASSERT_EQUAL_UINT32(49u, kc_reach_search_limit(&s_camera, &s_config, 0u, 0.0, 0.0));
}

void test_later_as_far_as_twice_the_last_residual_reaches_beyond_the_middle_of_the_image(void)
{
    double quarter = 0.5 * atan2(0.5 * (double)s_camera.height_px, s_camera.fy_px);
    for (uint32_t rings = 0u; rings <= 3u; rings++) {
        double off = rings == 0u ? 0.5 * quarter : quarter + ((double)rings - 0.5) * 0.1;
        uint32_t n = (2u * rings + 1u) * (2u * rings + 1u) - 1u;
        TEST_ASSERT_EQUAL_UINT32(n, kc_reach_search_limit(&s_camera, &s_config, 1u, tan(0.5 * off), 1.0));
    }
    TEST_ASSERT_EQUAL_UINT32(49u,
                             kc_reach_search_limit(&s_camera, &s_config, 1u, 9.0, 1.0)); /* all there are */
}

void test_a_range_that_cannot_be_does_not_widen_the_search(void)
{
    TEST_ASSERT_EQUAL_UINT32(kc_reach_search_limit(&s_camera, &s_config, 1u, 0.02, 0.1),
                             kc_reach_search_limit(&s_camera, &s_config, 1u, 0.02, 0.0));
}

void test_a_joint_draws_back_to_the_side_asked_for(void)
{
    TEST_ASSERT_EQUAL_DOUBLE(0.75, kc_reach_draw_back(1.0, 0.0, 2.0, 0.25, true));
    TEST_ASSERT_EQUAL_DOUBLE(1.25, kc_reach_draw_back(1.0, 0.0, 2.0, 0.25, false));
}

void test_a_joint_without_enough_room_takes_the_side_with_more(void)
{
    TEST_ASSERT_EQUAL_DOUBLE(0.375, kc_reach_draw_back(0.125, 0.0, 2.0, 0.25, true));
    TEST_ASSERT_EQUAL_DOUBLE(1.625, kc_reach_draw_back(1.875, 0.0, 2.0, 0.25, false));
    TEST_ASSERT_EQUAL_DOUBLE(0.0,
                             kc_reach_draw_back(0.125, 0.0, 0.1875, 0.25, false)); /* as far as there is */
    TEST_ASSERT_EQUAL_DOUBLE(1.375, kc_reach_draw_back(1.125, 1.0, 3.0, 0.25, true)); /* wherever that is */
    TEST_ASSERT_EQUAL_DOUBLE(-1.375, kc_reach_draw_back(-1.125, -3.0, -1.0, 0.25, false));
}

void test_a_joint_beyond_its_interval_never_moves_farther_out(void)
{
    TEST_ASSERT_EQUAL_DOUBLE(2.25, kc_reach_draw_back(2.5, 0.0, 2.0, 0.25, false));
    TEST_ASSERT_EQUAL_DOUBLE(-0.25, kc_reach_draw_back(-0.5, 0.0, 2.0, 0.25, true));
}
