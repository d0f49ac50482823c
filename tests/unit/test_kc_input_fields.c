/* kc_input_fields.c: the number of a field in an event, as a name and an element. */
#include "kc_input_fields.h"

#include "unity.h"

static void expect_name(int32_t index, const char *name, uint32_t element)
{
    uint32_t got = 99u;
    TEST_ASSERT_EQUAL_STRING(name, kc_input_field(index, &got));
    TEST_ASSERT_EQUAL_UINT32(element, got);
}

void test_every_number_has_the_name_of_its_field_and_its_element(void)
{
    expect_name(101, "arm t_us", 0u);
    expect_name(110, "arm q_rad", 1u);
    expect_name(109 + (int32_t)KC_JOINT_MAX, "arm q_rad", KC_JOINT_MAX);
    expect_name(154, "arm g_m_s2", 3u);
    expect_name(203, "pan-tilt tilt_rad", 0u);
    expect_name(305, "detection p_cam_tool_m", 3u);
    expect_name(306, "detection p_alt_m", 1u);
    expect_name(395, "detection cov", 36u);
}

void test_numbers_of_no_field_have_no_name(void)
{
    static const int32_t none[] = {INT32_MIN, -1,  0,   100,      102, 110 + (int32_t)KC_JOINT_MAX,
                                   155,       204, 396, INT32_MAX};
    for (uint32_t i = 0u; i < sizeof none / sizeof none[0]; i++) { expect_name(none[i], "", 0u); }
}
