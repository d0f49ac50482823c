/* kc_layout.c: the rules between fields of each kind, entry and field named. */
#include <math.h>
#include <string.h>

#include "given_tables.h"
#include "kc_layout.h"
#include "unity.h"

static kc_tbl_scratch_t s_t;
static kc_walk_t s_w;

static void check(uint16_t kind)
{
    memset(&s_w, 0, sizeof s_w);
    s_w.mode = KC_WALK_CHECK;
    kc_layout_walk(&s_w, kind, &s_t);
}

static void expect_refused(uint16_t kind, int32_t index, uint32_t field, double got)
{
    check(kind);
    TEST_ASSERT_EQUAL_UINT32(1u, s_w.n_bad);
    TEST_ASSERT_EQUAL_UINT16(KC_EVT_TBL_RANGE, s_w.bad_id);
    TEST_ASSERT_EQUAL_INT32(index, s_w.bad_index);
    TEST_ASSERT_EQUAL_UINT32(field, s_w.bad_field);
    TEST_ASSERT_EQUAL_DOUBLE(got, s_w.bad_got);
}

void test_crossed_joint_limits_are_refused(void)
{
    given_arm(&s_t.arm);
    s_t.arm.joint[3].q_max = -1.0;
    expect_refused(KC_TBL_ARM, 3, 10u, -1.0);
}

void test_a_joint_without_speed_is_refused(void)
{
    given_arm(&s_t.arm);
    s_t.arm.joint[6].speed_max = 0.0;
    expect_refused(KC_TBL_ARM, 6, 11u, 0.0);
}

void test_a_negative_mass_is_refused(void)
{
    given_arm(&s_t.arm);
    s_t.arm.joint[0].mass_kg = -1.0;
    expect_refused(KC_TBL_ARM, 0, 12u, -1.0);
}

void test_crossed_pantilt_limits_are_refused(void)
{
    given_camera(&s_t.camera);
    s_t.camera.pan_max_rad = -2.0;
    expect_refused(KC_TBL_CAMERA, -1, 6u, -2.0);
    given_camera(&s_t.camera);
    s_t.camera.tilt_max_rad = -2.0;
    expect_refused(KC_TBL_CAMERA, -1, 8u, -2.0);
}

void test_a_tag_named_twice_is_refused(void)
{
    given_camera(&s_t.camera);
    s_t.camera.tag[1].id = 0;
    expect_refused(KC_TBL_CAMERA, 1, 16u, 0.0);
}

void test_a_tag_outside_its_family_is_refused(void)
{
    given_camera(&s_t.camera);
    s_t.camera.tag[1].id = 587;
    expect_refused(KC_TBL_CAMERA, 1, 16u, 587.0);
}

void test_a_camera_without_tags_is_refused(void)
{
    given_camera(&s_t.camera);
    s_t.camera.n_tags = 0u;
    expect_refused(KC_TBL_CAMERA, -1, 15u, 0.0);
}

void test_crossed_bounds_are_refused(void)
{
    given_terms(&s_t.terms);
    s_t.terms.coef[9].ub = -2.0;
    expect_refused(KC_TBL_TERMS, 9, 5u, -2.0);
}

void test_a_term_of_a_coefficient_that_is_not_there_is_refused(void)
{
    given_terms(&s_t.terms);
    s_t.terms.term[5].coef = 28u;
    expect_refused(KC_TBL_TERMS, 1005, 9u, 28.0);
}

void test_an_unknown_basis_is_refused(void)
{
    given_terms(&s_t.terms);
    s_t.terms.term[5].basis[1].var = KC_VAR_COUNT;
    expect_refused(KC_TBL_TERMS, 1005, 14u, KC_VAR_COUNT);
}

void test_minus_zero_is_still_nominal(void)
{
    given_kin(&s_t.kin);
    s_t.kin.value[3] = -0.0;
    check(KC_TBL_KIN);
    TEST_ASSERT_EQUAL_UINT32(0u, s_w.n_bad);
}

void test_a_negative_sigma_is_refused(void)
{
    given_kin(&s_t.kin);
    s_t.kin.sigma[3] = -1.0;
    expect_refused(KC_TBL_KIN, 3, 3u, -1.0);
}

void test_initial_poses_and_hubs_that_do_not_exist_are_refused(void)
{
    given_space(&s_t.space, 9u, 1u);
    s_t.space.initial[2] = 9u;
    expect_refused(KC_TBL_SPACE, 2, 5u, 9.0);
    given_space(&s_t.space, 9u, 1u);
    s_t.space.cand[7].hub = 2u;
    expect_refused(KC_TBL_SPACE, 7, 16u, 2.0);
}

void test_a_candidate_that_expects_no_tag_is_refused(void)
{
    given_space(&s_t.space, 9u, 1u);
    s_t.space.cand[7].tags = 0u;
    expect_refused(KC_TBL_SPACE, 7, 15u, 0.0);
}

void test_a_space_that_names_no_arm_is_refused(void)
{
    given_space(&s_t.space, 9u, 0u);
    expect_refused(KC_TBL_SPACE, -1, 9u, 0.0);
}

void test_a_bad_number_of_hubs_ends_the_walk(void)
{
    given_space(&s_t.space, 9u, 1u);
    s_t.space.n_hub = 0u;
    expect_refused(KC_TBL_SPACE, -1, 2u, 0.0);
    TEST_ASSERT_TRUE(s_w.lost);
}

void test_a_bad_number_of_spectral_weights_is_refused(void)
{
    given_kernel(&s_t.kernel);
    s_t.kernel.hyper[1].n_w = KC_SPECTRUM_MAX + 1u;
    expect_refused(KC_TBL_KERNEL, 1, 9u, KC_SPECTRUM_MAX + 1.0);
}

void test_an_unknown_kind_walks_nothing(void)
{
    check(KC_TBL_COUNT);
    TEST_ASSERT_TRUE(s_w.lost);
    TEST_ASSERT_EQUAL_UINT32(0u, kc_layout_struct_bytes(KC_TBL_COUNT));
    TEST_ASSERT_EQUAL_UINT32(0u, kc_layout_struct_bytes(0u));
}

void test_walks_that_write_leave_the_table_alone(void)
{
    static uint8_t out[KC_IMAGE_MAX];
    static kc_tbl_scratch_t before;
    for (uint16_t kind = 1u; kind < KC_TBL_COUNT; kind++) {
        memset(&s_t, 0x11, sizeof s_t); /* nonsense, but with counts that are refused or small */
        if (kind == KC_TBL_SPACE) { given_space(&s_t.space, 9u, 1u); }
        before = s_t;
        memset(&s_w, 0, sizeof s_w);
        s_w.mode = KC_WALK_WRITE;
        s_w.out = out;
        s_w.cap = sizeof out;
        kc_layout_walk(&s_w, kind, &s_t);
        TEST_ASSERT_EQUAL_MEMORY(&before, &s_t, sizeof s_t);
    }
}

void test_bodies_and_volumes_out_of_range_are_refused_by_number(void)
{
    given_space(&s_t.space, 9u, 1u);
    s_t.space.n_body = KC_BODY_MAX + 1u;
    expect_refused(KC_TBL_SPACE, -1, 19u, KC_BODY_MAX + 1.0);
    given_space(&s_t.space, 9u, 1u);
    s_t.space.body[1].frame = 8u;
    expect_refused(KC_TBL_SPACE, KC_SPACE_INDEX_BODY + 1, 20u, 8.0);
    given_space(&s_t.space, 9u, 1u);
    s_t.space.body[0].start_m[1] = 11.0f;
    expect_refused(KC_TBL_SPACE, KC_SPACE_INDEX_BODY, 21u, 11.0);
    given_space(&s_t.space, 9u, 1u);
    s_t.space.body[0].end_m[1] = -11.0f;
    expect_refused(KC_TBL_SPACE, KC_SPACE_INDEX_BODY, 22u, -11.0);
    given_space(&s_t.space, 9u, 1u);
    s_t.space.body[0].radius_m = 0.0f;
    expect_refused(KC_TBL_SPACE, KC_SPACE_INDEX_BODY, 23u, 0.0);
    given_space(&s_t.space, 9u, 1u);
    s_t.space.body[1].collision_pairs = 2u; /* itself */
    expect_refused(KC_TBL_SPACE, KC_SPACE_INDEX_BODY + 1, 30u, 2.0);
    given_space(&s_t.space, 9u, 1u);
    s_t.space.body[1].collision_pairs = 1u;
    check(KC_TBL_SPACE);
    TEST_ASSERT_EQUAL_UINT32(0u, s_w.n_bad);
    given_space(&s_t.space, 9u, 1u);
    s_t.space.n_volume = KC_VOLUME_MAX + 1u;
    expect_refused(KC_TBL_SPACE, -1, 24u, KC_VOLUME_MAX + 1.0);
    given_space(&s_t.space, 9u, 1u);
    s_t.space.volume[1].kind = 4u;
    expect_refused(KC_TBL_SPACE, KC_SPACE_INDEX_VOLUME + 1, 25u, 4.0);
    given_space(&s_t.space, 9u, 1u);
    s_t.space.volume[1].p_m[0] = 11.0f;
    expect_refused(KC_TBL_SPACE, KC_SPACE_INDEX_VOLUME + 1, 26u, 11.0);
    given_space(&s_t.space, 9u, 1u);
    s_t.space.volume[1].size_m[0] = 11.0f;
    expect_refused(KC_TBL_SPACE, KC_SPACE_INDEX_VOLUME + 1, 27u, 11.0);
    given_space(&s_t.space, 9u, 1u);
    s_t.space.volume[1].radius_m = -1.0f;
    expect_refused(KC_TBL_SPACE, KC_SPACE_INDEX_VOLUME + 1, 28u, -1.0);
    given_space(&s_t.space, 9u, 1u);
    s_t.space.volume[1].excluded = 4u;
    expect_refused(KC_TBL_SPACE, KC_SPACE_INDEX_VOLUME + 1, 29u, 4.0);
}

void test_errors_that_no_space_can_be_verified_for_are_refused(void)
{
    const int32_t at = KC_SPACE_INDEX_VERIFIED + 6;
    given_space(&s_t.space, 9u, 1u);
    s_t.space.verified[6].phi_rad = -0.1;
    expect_refused(KC_TBL_SPACE, at, 31u, -0.1);
    given_space(&s_t.space, 9u, 1u);
    s_t.space.verified[6].alpha_rad = 7.0;
    expect_refused(KC_TBL_SPACE, at, 32u, 7.0);
    given_space(&s_t.space, 9u, 1u);
    s_t.space.verified[6].a_m = -0.1;
    expect_refused(KC_TBL_SPACE, at, 33u, -0.1);
    given_space(&s_t.space, 9u, 1u);
    s_t.space.verified[6].d_m = 11.0;
    expect_refused(KC_TBL_SPACE, at, 34u, 11.0);
}
