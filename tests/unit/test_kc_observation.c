/* kc_observation.c: the planar flip. The rest is tested where it is used: kc_measure, kc_observe. */
#include "given_tables.h"
#include "kc_observation.h"
#include "unity.h"

static kc_config_t s_config;

void setUp(void)
{
    given_config(&s_config);
    s_config.flip_rms_ratio = 2.0;
    s_config.flip_trust_rad = 0.5;
}

void test_the_second_pose_is_taken_if_it_is_about_as_good_and_nearer_to_the_prediction(void)
{
    TEST_ASSERT_TRUE(kc_observation_is_flipped(&s_config, 0.5, 1.0, 0.9, 0.5));
}

void test_a_second_pose_that_fits_the_image_worse_is_not_taken(void)
{
    TEST_ASSERT_FALSE(kc_observation_is_flipped(&s_config, 0.5, 1.01, 0.9, 0.1));
}

void test_a_second_pose_farther_from_the_prediction_is_not_taken(void)
{
    TEST_ASSERT_FALSE(kc_observation_is_flipped(&s_config, 0.5, 0.5, 0.2, 0.2));
    TEST_ASSERT_FALSE(kc_observation_is_flipped(&s_config, 0.5, 0.5, 0.2, 0.3));
}

void test_a_prediction_far_from_both_is_not_trusted(void)
{
    TEST_ASSERT_FALSE(kc_observation_is_flipped(&s_config, 0.5, 0.5, 0.9, 0.51));
}
