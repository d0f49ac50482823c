/* kc_layout.c: the rules between fields of each kind, entry and field named. */
#include <math.h>
#include <stddef.h>
#include <stdio.h>
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

static void given_table(uint16_t kind)
{
    memset(&s_t, 0, sizeof s_t);
    switch (kind) {
    case KC_TBL_ARM: given_arm(&s_t.arm); break;
    case KC_TBL_CAMERA: given_camera(&s_t.camera); break;
    case KC_TBL_TERMS: given_terms(&s_t.terms); break;
    case KC_TBL_KIN: given_kin(&s_t.kin); break;
    case KC_TBL_SPACE: given_space(&s_t.space, 9u, 1u); break;
    case KC_TBL_KERNEL: given_kernel(&s_t.kernel); break;
    default: given_config(&s_t.config); break;
    }
}

static const char *s_what = "";

static void expect_refused(uint16_t kind, int32_t index, uint32_t field, double got)
{
    check(kind);
    TEST_ASSERT_EQUAL_UINT32_MESSAGE(1u, s_w.n_bad, s_what);
    TEST_ASSERT_EQUAL_UINT16_MESSAGE(KC_EVT_TBL_RANGE, s_w.bad_id, s_what);
    TEST_ASSERT_EQUAL_INT32_MESSAGE(index, s_w.bad_index, s_what);
    TEST_ASSERT_EQUAL_UINT32_MESSAGE(field, s_w.bad_field, s_what);
    TEST_ASSERT_EQUAL_DOUBLE_MESSAGE(got, s_w.bad_got, s_what);
}

/* A good table with one wrong value: its entry, the number of its field and the value are named. */
#define REFUSED(KIND, FIELD, VALUE, INDEX, NUMBER)                     \
    do {                                                               \
        given_table(KC_TBL_##KIND);                                    \
        s_t.FIELD = (VALUE);                                           \
        s_what = #FIELD;                                               \
        expect_refused(KC_TBL_##KIND, INDEX, NUMBER, (double)(VALUE)); \
    } while (0)

void test_a_wrong_value_is_refused_with_its_entry_and_field(void)
{
    REFUSED(ARM, arm.joint[3].q_max, -1.0, 3, 10u); /* below q_min */
    REFUSED(ARM, arm.joint[6].speed_max, 0.0, 6, 11u);
    REFUSED(ARM, arm.joint[0].mass_kg, -1.0, 0, 12u);
    REFUSED(CAMERA, camera.pan_max_rad, -2.0, -1, 6u); /* below pan_min_rad */
    REFUSED(CAMERA, camera.tilt_max_rad, -2.0, -1, 8u);
    REFUSED(CAMERA, camera.tag[1].id, 0, 1, 16u);   /* named twice */
    REFUSED(CAMERA, camera.tag[1].id, 587, 1, 16u); /* outside its family */
    REFUSED(CAMERA, camera.n_tags, 0u, -1, 15u);
    REFUSED(TERMS, terms.coef[9].ub, -2.0, 9, 5u);  /* below lb */
    REFUSED(TERMS, terms.term[5].coef, 28u, 1005, 9u); /* of a coefficient that is not there */
    REFUSED(TERMS, terms.term[5].basis[1].var, KC_VAR_COUNT, 1005, 14u);
    REFUSED(KIN, kin.sigma[3], -1.0, 3, 3u);
    REFUSED(SPACE, space.initial[2], 9u, 2, 5u); /* a pose and a hub that are not there */
    REFUSED(SPACE, space.cand[7].hub, 2u, 7, 16u);
    REFUSED(SPACE, space.cand[7].tags, 0u, 7, 15u); /* expects no tag */
    REFUSED(SPACE, space.arm_crc, 0u, -1, 9u);
    REFUSED(KERNEL, kernel.hyper[1].n_w, KC_SPECTRUM_MAX + 1u, 1, 9u);
}

void test_minus_zero_is_still_nominal(void)
{
    given_kin(&s_t.kin);
    s_t.kin.value[3] = -0.0;
    check(KC_TBL_KIN);
    TEST_ASSERT_EQUAL_UINT32(0u, s_w.n_bad);
}

void test_a_bad_number_of_hubs_ends_the_walk(void)
{
    REFUSED(SPACE, space.n_hub, 0u, -1, 2u);
    TEST_ASSERT_TRUE(s_w.lost);
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
    REFUSED(SPACE, space.n_body, KC_BODY_MAX + 1u, -1, 19u);
    REFUSED(SPACE, space.body[1].frame, 8u, KC_SPACE_INDEX_BODY + 1, 20u);
    REFUSED(SPACE, space.body[0].start_m[1], 11.0f, KC_SPACE_INDEX_BODY, 21u);
    REFUSED(SPACE, space.body[0].end_m[1], -11.0f, KC_SPACE_INDEX_BODY, 22u);
    REFUSED(SPACE, space.body[0].radius_m, 0.0f, KC_SPACE_INDEX_BODY, 23u);
    REFUSED(SPACE, space.body[1].collision_pairs, 2u, KC_SPACE_INDEX_BODY + 1, 30u); /* itself */
    given_space(&s_t.space, 9u, 1u);
    s_t.space.body[1].collision_pairs = 1u;
    check(KC_TBL_SPACE);
    TEST_ASSERT_EQUAL_UINT32(0u, s_w.n_bad);
    REFUSED(SPACE, space.n_volume, KC_VOLUME_MAX + 1u, -1, 24u);
    REFUSED(SPACE, space.volume[1].kind, 4u, KC_SPACE_INDEX_VOLUME + 1, 25u);
    REFUSED(SPACE, space.volume[1].p_m[0], 11.0f, KC_SPACE_INDEX_VOLUME + 1, 26u);
    REFUSED(SPACE, space.volume[1].size_m[0], 11.0f, KC_SPACE_INDEX_VOLUME + 1, 27u);
    REFUSED(SPACE, space.volume[1].radius_m, -1.0f, KC_SPACE_INDEX_VOLUME + 1, 28u);
    REFUSED(SPACE, space.volume[1].excluded, 4u, KC_SPACE_INDEX_VOLUME + 1, 29u);
}

void test_errors_that_no_space_can_be_verified_for_are_refused(void)
{
    const int32_t at = KC_SPACE_INDEX_VERIFIED + 6;
    REFUSED(SPACE, space.verified[6].phi_rad, -0.1, at, 31u);
    REFUSED(SPACE, space.verified[6].alpha_rad, 7.0, at, 32u);
    REFUSED(SPACE, space.verified[6].a_m, -0.1, at, 33u);
    REFUSED(SPACE, space.verified[6].d_m, 11.0, at, 34u);
}

/* ---- the limits of every field, as docs/TABLES.md has them; of what is repeated in the second entry, of arrays in the
 * last element ---- */

typedef struct {
    uint16_t kind;
    uint32_t field;
    int32_t index;
    size_t offset;
    char type; /* b u8, h u16, u u32, l u64, i i32, f f32, d f64; q, Q: a quaternion of f32, f64 */
    double lo, hi;
    bool rule; /* another field decides as well, so that the limits themselves may be refused */
} limit_t;

#define TURN_RAD 6.2831853071795865

static const limit_t s_limit[] = {
    {KC_TBL_ARM, 2u, -1, offsetof(kc_arm_t, n_joints), 'u', 1.0, 8.0, false},
    {KC_TBL_ARM, 3u, 1, offsetof(kc_arm_t, joint[1].type), 'b', 0.0, 1.0, false},
    {KC_TBL_ARM, 4u, 1, offsetof(kc_arm_t, joint[1].has_mass), 'b', 0.0, 1.0, false},
    {KC_TBL_ARM, 5u, 1, offsetof(kc_arm_t, joint[1].phi_rad), 'd', -TURN_RAD, TURN_RAD, false},
    {KC_TBL_ARM, 6u, 1, offsetof(kc_arm_t, joint[1].alpha_rad), 'd', -TURN_RAD, TURN_RAD, false},
    {KC_TBL_ARM, 7u, 1, offsetof(kc_arm_t, joint[1].a_m), 'd', -10.0, 10.0, false},
    {KC_TBL_ARM, 8u, 1, offsetof(kc_arm_t, joint[1].d_m), 'd', -10.0, 10.0, false},
    {KC_TBL_ARM, 9u, 1, offsetof(kc_arm_t, joint[1].q_min), 'd', -100.0, 100.0, false},
    {KC_TBL_ARM, 10u, 1, offsetof(kc_arm_t, joint[1].q_max), 'd', -100.0, 100.0, true},
    {KC_TBL_ARM, 11u, 1, offsetof(kc_arm_t, joint[1].speed_max), 'd', 1e-6, 100.0, false},
    {KC_TBL_ARM, 12u, 1, offsetof(kc_arm_t, joint[1].mass_kg), 'd', 0.0, 1e4, false},
    {KC_TBL_ARM, 13u, 1, offsetof(kc_arm_t, joint[1].com_m[2]), 'd', -10.0, 10.0, false},
    {KC_TBL_ARM, 14u, 1, offsetof(kc_arm_t, joint[1].gear_ratio), 'd', 0.0, 1e5, false},
    {KC_TBL_ARM, 15u, -1, offsetof(kc_arm_t, base_xyz_m[2]), 'd', -10.0, 10.0, false},
    {KC_TBL_ARM, 16u, -1, offsetof(kc_arm_t, base_quat_wxyz), 'Q', 0.0, 0.0, false},
    {KC_TBL_ARM, 17u, -1, offsetof(kc_arm_t, tool_xyz_m[2]), 'd', -10.0, 10.0, false},
    {KC_TBL_ARM, 18u, -1, offsetof(kc_arm_t, tool_quat_wxyz), 'Q', 0.0, 0.0, false},
    {KC_TBL_ARM, 19u, -1, offsetof(kc_arm_t, gravity_m_s2[2]), 'd', -100.0, 100.0, false},
    {KC_TBL_CAMERA, 1u, -1, offsetof(kc_camera_t, mast_xyz_m[2]), 'd', -10.0, 10.0, false},
    {KC_TBL_CAMERA, 2u, -1, offsetof(kc_camera_t, mast_quat_wxyz), 'Q', 0.0, 0.0, false},
    {KC_TBL_CAMERA, 3u, -1, offsetof(kc_camera_t, pantilt_xyz_m[2]), 'd', -10.0, 10.0, false},
    {KC_TBL_CAMERA, 4u, -1, offsetof(kc_camera_t, pantilt_quat_wxyz), 'Q', 0.0, 0.0, false},
    {KC_TBL_CAMERA, 5u, -1, offsetof(kc_camera_t, pan_min_rad), 'd', -TURN_RAD, TURN_RAD, false},
    {KC_TBL_CAMERA, 6u, -1, offsetof(kc_camera_t, pan_max_rad), 'd', -TURN_RAD, TURN_RAD, true},
    {KC_TBL_CAMERA, 7u, -1, offsetof(kc_camera_t, tilt_min_rad), 'd', -TURN_RAD, TURN_RAD, false},
    {KC_TBL_CAMERA, 8u, -1, offsetof(kc_camera_t, tilt_max_rad), 'd', -TURN_RAD, TURN_RAD, true},
    {KC_TBL_CAMERA, 9u, -1, offsetof(kc_camera_t, fx_px), 'd', 1.0, 1e6, false},
    {KC_TBL_CAMERA, 10u, -1, offsetof(kc_camera_t, fy_px), 'd', 1.0, 1e6, false},
    {KC_TBL_CAMERA, 11u, -1, offsetof(kc_camera_t, cx_px), 'd', -1e5, 1e5, false},
    {KC_TBL_CAMERA, 12u, -1, offsetof(kc_camera_t, cy_px), 'd', -1e5, 1e5, false},
    {KC_TBL_CAMERA, 13u, -1, offsetof(kc_camera_t, width_px), 'u', 1.0, 16384.0, false},
    {KC_TBL_CAMERA, 14u, -1, offsetof(kc_camera_t, height_px), 'u', 1.0, 16384.0, false},
    {KC_TBL_CAMERA, 15u, -1, offsetof(kc_camera_t, n_tags), 'u', 1.0, 4.0, false},
    {KC_TBL_CAMERA, 16u, 1, offsetof(kc_camera_t, tag[1].id), 'i', 0.0, 586.0, true},
    {KC_TBL_CAMERA, 17u, 1, offsetof(kc_camera_t, tag[1].size_m), 'd', 1e-3, 1.0, false},
    {KC_TBL_CAMERA, 18u, 1, offsetof(kc_camera_t, tag[1].xyz_m[2]), 'd', -10.0, 10.0, false},
    {KC_TBL_CAMERA, 19u, 1, offsetof(kc_camera_t, tag[1].quat_wxyz), 'Q', 0.0, 0.0, false},
    {KC_TBL_CAMERA, 20u, -1, offsetof(kc_camera_t, mast_sigma_m), 'd', 0.0, 0.1, false},
    {KC_TBL_CAMERA, 21u, -1, offsetof(kc_camera_t, mast_sigma_rad), 'd', 0.0, 0.1, false},
    {KC_TBL_CAMERA, 22u, -1, offsetof(kc_camera_t, zero_sigma_rad), 'd', 0.0, 0.1, false},
    {KC_TBL_CAMERA, 23u, -1, offsetof(kc_camera_t, axis_sigma_rad), 'd', 0.0, 0.1, false},
    {KC_TBL_CAMERA, 24u, -1, offsetof(kc_camera_t, tag_size_sigma), 'd', 0.0, 0.1, false},
    {KC_TBL_CAMERA, 25u, -1, offsetof(kc_camera_t, plate_sigma_m), 'd', 0.0, 0.1, false},
    {KC_TBL_CAMERA, 26u, -1, offsetof(kc_camera_t, plate_sigma_rad), 'd', 0.0, 0.1, false},
    {KC_TBL_CAMERA, 27u, -1, offsetof(kc_camera_t, drift_sigma_m_s), 'd', 0.0, 0.1, false},
    {KC_TBL_CAMERA, 28u, -1, offsetof(kc_camera_t, drift_sigma_rad_s), 'd', 0.0, 0.1, false},
    {KC_TBL_TERMS, 1u, -1, offsetof(kc_terms_t, n_coef), 'u', 1.0, 64.0, false},
    {KC_TBL_TERMS, 2u, -1, offsetof(kc_terms_t, n_term), 'u', 1.0, 160.0, false},
    {KC_TBL_TERMS, 4u, 1, offsetof(kc_terms_t, coef[1].lb), 'd', -1e6, 1e6, false},
    {KC_TBL_TERMS, 5u, 1, offsetof(kc_terms_t, coef[1].ub), 'd', -1e6, 1e6, true},
    {KC_TBL_TERMS, 6u, 1, offsetof(kc_terms_t, coef[1].prior_sigma), 'd', 0.0, 1e6, false},
    {KC_TBL_TERMS, 7u, 1, offsetof(kc_terms_t, coef[1].scale), 'd', 1e-12, 1e6, false},
    {KC_TBL_TERMS, 8u, 1, offsetof(kc_terms_t, coef[1].enabled), 'b', 0.0, 1.0, false},
    {KC_TBL_TERMS, 9u, 1001, offsetof(kc_terms_t, term[1].coef), 'h', 0.0, 63.0, true},
    {KC_TBL_TERMS, 10u, 1001, offsetof(kc_terms_t, term[1].frame), 'b', 0.0, 11.0, false},
    {KC_TBL_TERMS, 11u, 1001, offsetof(kc_terms_t, term[1].comp), 'b', 0.0, 5.0, false},
    {KC_TBL_TERMS, 12u, 1001, offsetof(kc_terms_t, term[1].gain), 'd', -1e6, 1e6, false},
    {KC_TBL_TERMS, 13u, 1001, offsetof(kc_terms_t, term[1].basis[1].fn), 'b', 0.0, 9.0, false},
    {KC_TBL_TERMS, 14u, 1001, offsetof(kc_terms_t, term[1].basis[1].var), 'b', 0.0, 35.0, false},
    {KC_TBL_TERMS, 15u, 1001, offsetof(kc_terms_t, term[1].basis[1].index), 'b', 0.0, 255.0, false},
    {KC_TBL_TERMS, 16u, 1001, offsetof(kc_terms_t, term[1].basis[1].c0), 'd', -1e6, 1e6, false},
    {KC_TBL_TERMS, 17u, 1001, offsetof(kc_terms_t, term[1].basis[1].c1), 'd', -1e6, 1e6, false},
    {KC_TBL_TERMS, 18u, -1, offsetof(kc_terms_t, kinematics_crc), 'u', 0.0, 4294967295.0, false},
    {KC_TBL_KIN, 1u, -1, offsetof(kc_kin_t, n_coef), 'u', 1.0, 64.0, false},
    {KC_TBL_KIN, 2u, 1, offsetof(kc_kin_t, value[1]), 'd', -1e6, 1e6, false},
    {KC_TBL_KIN, 3u, 1, offsetof(kc_kin_t, sigma[1]), 'd', 0.0, 1e6, false},
    {KC_TBL_KIN, 4u, -1, offsetof(kc_kin_t, arm_crc), 'u', 0.0, 4294967295.0, true},
    {KC_TBL_KIN, 5u, -1, offsetof(kc_kin_t, terms_crc), 'u', 0.0, 4294967295.0, true},
    {KC_TBL_KIN, 6u, -1, offsetof(kc_kin_t, prev_crc), 'u', 0.0, 4294967295.0, false},
    {KC_TBL_KIN, 7u, -1, offsetof(kc_kin_t, session), 'u', 0.0, 4294967295.0, false},
    {KC_TBL_KIN, 8u, -1, offsetof(kc_kin_t, n_poses), 'u', 0.0, 64.0, false},
    {KC_TBL_KIN, 9u, -1, offsetof(kc_kin_t, made_us), 'l', 0.0, 18446744073709551615.0, false},
    {KC_TBL_SPACE, 1u, -1, offsetof(kc_space_t, n_cand), 'u', 1.0, 1024.0, false},
    {KC_TBL_SPACE, 2u, -1, offsetof(kc_space_t, n_hub), 'u', 1.0, 16.0, false},
    {KC_TBL_SPACE, 3u, -1, offsetof(kc_space_t, n_joints), 'u', 1.0, 8.0, false},
    {KC_TBL_SPACE, 4u, -1, offsetof(kc_space_t, n_initial), 'u', 0.0, 32.0, false},
    {KC_TBL_SPACE, 5u, 1, offsetof(kc_space_t, initial[1]), 'h', 0.0, 1023.0, true},
    {KC_TBL_SPACE, 6u, 1, offsetof(kc_space_t, hub_q[1][6]), 'f', -100.0, 100.0, false},
    {KC_TBL_SPACE, 7u, 1, offsetof(kc_space_t, hub_edge[1]), 'h', 0.0, 65535.0, false},
    {KC_TBL_SPACE, 8u, -1, offsetof(kc_space_t, servo_bound[6]), 'f', 1e-6, 100.0, false},
    {KC_TBL_SPACE, 9u, -1, offsetof(kc_space_t, arm_crc), 'u', 1.0, 4294967295.0, false},
    {KC_TBL_SPACE, 10u, 1, offsetof(kc_space_t, cand[1].p_m[2]), 'f', -10.0, 10.0, false},
    {KC_TBL_SPACE, 11u, 1, offsetof(kc_space_t, cand[1].q_wxyz), 'q', 0.0, 0.0, false},
    {KC_TBL_SPACE, 12u, 1, offsetof(kc_space_t, cand[1].q_seed[6]), 'f', -100.0, 100.0, false},
    {KC_TBL_SPACE, 13u, 1, offsetof(kc_space_t, cand[1].pan_rad), 'f', -TURN_RAD, TURN_RAD, false},
    {KC_TBL_SPACE, 14u, 1, offsetof(kc_space_t, cand[1].tilt_rad), 'f', -TURN_RAD, TURN_RAD, false},
    {KC_TBL_SPACE, 15u, 1, offsetof(kc_space_t, cand[1].tags), 'b', 1.0, 15.0, false},
    {KC_TBL_SPACE, 16u, 1, offsetof(kc_space_t, cand[1].hub), 'b', 0.0, 15.0, true},
    {KC_TBL_SPACE, 17u, 1, offsetof(kc_space_t, cand[1].why), 'h', 0.0, 65535.0, false},
    {KC_TBL_SPACE, 19u, -1, offsetof(kc_space_t, n_body), 'u', 0.0, 24.0, false},
    {KC_TBL_SPACE, 20u, KC_SPACE_INDEX_BODY + 1, offsetof(kc_space_t, body[1].frame), 'b', 0.0, 8.0, true},
    {KC_TBL_SPACE, 21u, KC_SPACE_INDEX_BODY + 1, offsetof(kc_space_t, body[1].start_m[2]), 'f', -10.0, 10.0,
     false},
    {KC_TBL_SPACE, 22u, KC_SPACE_INDEX_BODY + 1, offsetof(kc_space_t, body[1].end_m[2]), 'f', -10.0, 10.0,
     false},
    {KC_TBL_SPACE, 23u, KC_SPACE_INDEX_BODY + 1, offsetof(kc_space_t, body[1].radius_m), 'f', 1e-6, 10.0,
     false},
    {KC_TBL_SPACE, 30u, KC_SPACE_INDEX_BODY + 1, offsetof(kc_space_t, body[1].collision_pairs), 'u', 0.0,
     16777215.0, true},
    {KC_TBL_SPACE, 24u, -1, offsetof(kc_space_t, n_volume), 'u', 0.0, 16.0, false},
    {KC_TBL_SPACE, 25u, KC_SPACE_INDEX_VOLUME + 1, offsetof(kc_space_t, volume[1].kind), 'b', 0.0, 3.0,
     false},
    {KC_TBL_SPACE, 26u, KC_SPACE_INDEX_VOLUME + 1, offsetof(kc_space_t, volume[1].p_m[2]), 'f', -10.0, 10.0,
     false},
    {KC_TBL_SPACE, 27u, KC_SPACE_INDEX_VOLUME + 1, offsetof(kc_space_t, volume[1].size_m[2]), 'f', -10.0,
     10.0, false},
    {KC_TBL_SPACE, 28u, KC_SPACE_INDEX_VOLUME + 1, offsetof(kc_space_t, volume[1].radius_m), 'f', 0.0, 10.0,
     false},
    {KC_TBL_SPACE, 29u, KC_SPACE_INDEX_VOLUME + 1, offsetof(kc_space_t, volume[1].excluded), 'u', 0.0,
     16777215.0, true},
    {KC_TBL_KERNEL, 1u, -1, offsetof(kc_kernel_t, arg), 'b', 0.0, 1.0, false},
    {KC_TBL_KERNEL, 2u, -1, offsetof(kc_kernel_t, n_hyper), 'u', 1.0, 32.0, false},
    {KC_TBL_KERNEL, 3u, -1, offsetof(kc_kernel_t, sigma_eps), 'd', 1e-9, 1e3, false},
    {KC_TBL_KERNEL, 4u, -1, offsetof(kc_kernel_t, choose), 'b', 0.0, 1.0, false},
    {KC_TBL_KERNEL, 5u, 1, offsetof(kc_kernel_t, hyper[1].sigma_s), 'd', 1e-6, 1e3, false},
    {KC_TBL_KERNEL, 6u, 1, offsetof(kc_kernel_t, hyper[1].beta_m), 'd', 1e-3, 1e3, false},
    {KC_TBL_KERNEL, 7u, 1, offsetof(kc_kernel_t, hyper[1].kappa), 'd', 1e-3, 1e3, false},
    {KC_TBL_KERNEL, 8u, 1, offsetof(kc_kernel_t, hyper[1].nu), 'd', 0.0, 100.0, false},
    {KC_TBL_KERNEL, 9u, 1, offsetof(kc_kernel_t, hyper[1].n_w), 'u', 1.0, 96.0, false},
    {KC_TBL_KERNEL, 10u, 1, offsetof(kc_kernel_t, hyper[1].w[20]), 'd', 0.0, 1.0, false},
    {KC_TBL_KERNEL, 11u, 1, offsetof(kc_kernel_t, hyper[1].trunc_err), 'd', 0.0, 0.1, false},
    {KC_TBL_CONFIG, 1u, -1, offsetof(kc_config_t, acquisition), 'b', 0.0, 4.0, false},
    {KC_TBL_CONFIG, 2u, -1, offsetof(kc_config_t, n_poses), 'u', 1.0, 64.0, false},
    {KC_TBL_CONFIG, 3u, -1, offsetof(kc_config_t, replicate_every), 'u', 0.0, 64.0, false},
    {KC_TBL_CONFIG, 4u, -1, offsetof(kc_config_t, beta_scale), 'd', 0.0, 1e3, false},
    {KC_TBL_CONFIG, 5u, -1, offsetof(kc_config_t, a1), 'd', 0.0, 1.0, false},
    {KC_TBL_CONFIG, 6u, -1, offsetof(kc_config_t, sp_floor_m), 'd', 1e-12, 1.0, false},
    {KC_TBL_CONFIG, 7u, -1, offsetof(kc_config_t, sq_floor_rad), 'd', 1e-12, 3.2, false},
    {KC_TBL_CONFIG, 8u, -1, offsetof(kc_config_t, vopt_len_m), 'd', 1e-6, 1e3, false},
    {KC_TBL_CONFIG, 9u, -1, offsetof(kc_config_t, stop_pos_m), 'd', 0.0, 1.0, false},
    {KC_TBL_CONFIG, 10u, -1, offsetof(kc_config_t, stop_rot_rad), 'd', 0.0, 3.2, false},
    {KC_TBL_CONFIG, 11u, -1, offsetof(kc_config_t, frames_per_meas), 'u', 1.0, 16.0, false},
    {KC_TBL_CONFIG, 12u, -1, offsetof(kc_config_t, frame_retries), 'u', 0.0, 50.0, false},
    {KC_TBL_CONFIG, 13u, -1, offsetof(kc_config_t, settle_us), 'l', 0.0, 3600000000.0, false},
    {KC_TBL_CONFIG, 14u, -1, offsetof(kc_config_t, frame_timeout_us), 'l', 1000.0, 3600000000.0, false},
    {KC_TBL_CONFIG, 15u, -1, offsetof(kc_config_t, move_timeout_us), 'l', 1000.0, 3600000000.0, false},
    {KC_TBL_CONFIG, 16u, -1, offsetof(kc_config_t, frame_age_max_us), 'l', 1000.0, 3600000000.0, false},
    {KC_TBL_CONFIG, 17u, -1, offsetof(kc_config_t, search_steps), 'u', 0.0, 49.0, false},
    {KC_TBL_CONFIG, 18u, -1, offsetof(kc_config_t, search_step_rad), 'd', 0.0, 1.6, false},
    {KC_TBL_CONFIG, 19u, -1, offsetof(kc_config_t, jump_pos_m), 'd', 1e-12, 10.0, false},
    {KC_TBL_CONFIG, 20u, -1, offsetof(kc_config_t, jump_rot_rad), 'd', 1e-12, 3.2, false},
    {KC_TBL_CONFIG, 21u, -1, offsetof(kc_config_t, sigma_pos_max_m), 'd', 1e-12, 1.0, false},
    {KC_TBL_CONFIG, 22u, -1, offsetof(kc_config_t, sigma_rot_max_rad), 'd', 1e-12, 3.2, false},
    {KC_TBL_CONFIG, 23u, -1, offsetof(kc_config_t, sigma_pos_min_m), 'd', 1e-12, 1.0, true},
    {KC_TBL_CONFIG, 24u, -1, offsetof(kc_config_t, sigma_rot_min_rad), 'd', 1e-12, 3.2, true},
    {KC_TBL_CONFIG, 25u, -1, offsetof(kc_config_t, rms_max_px), 'd', 1e-12, 1e3, false},
    {KC_TBL_CONFIG, 26u, -1, offsetof(kc_config_t, servo.gain), 'd', 1e-12, 1.0, false},
    {KC_TBL_CONFIG, 27u, -1, offsetof(kc_config_t, servo.damping), 'd', 1e-12, 10.0, false},
    {KC_TBL_CONFIG, 28u, -1, offsetof(kc_config_t, servo.step_max), 'd', 1e-12, 3.2, false},
    {KC_TBL_CONFIG, 29u, -1, offsetof(kc_config_t, servo.bound), 'd', 1e-12, 10.0, false},
    {KC_TBL_CONFIG, 30u, -1, offsetof(kc_config_t, servo.tol_pos_m), 'd', 1e-12, 1.0, false},
    {KC_TBL_CONFIG, 31u, -1, offsetof(kc_config_t, servo.tol_rot_rad), 'd', 1e-12, 3.2, false},
    {KC_TBL_CONFIG, 32u, -1, offsetof(kc_config_t, servo.margin), 'd', 0.0, 1.0, false},
    {KC_TBL_CONFIG, 33u, -1, offsetof(kc_config_t, servo_steps_max), 'u', 0.0, 1000.0, false},
    {KC_TBL_CONFIG, 34u, -1, offsetof(kc_config_t, speed_scale), 'd', 1e-3, 1.0, false},
    {KC_TBL_CONFIG, 35u, -1, offsetof(kc_config_t, arrive_tol), 'd', 1e-9, 0.01, false},
    {KC_TBL_CONFIG, 36u, -1, offsetof(kc_config_t, est.free_mask), 'l', 1.0, 18446744073709551615.0, false},
    {KC_TBL_CONFIG, 37u, -1, offsetof(kc_config_t, est.iter_max), 'u', 1.0, 100.0, false},
    {KC_TBL_CONFIG, 38u, -1, offsetof(kc_config_t, est.tol_step), 'd', 1e-15, 1.0, false},
    {KC_TBL_CONFIG, 39u, -1, offsetof(kc_config_t, est.rank_tol), 'd', 1e-15, 1.0, false},
    {KC_TBL_CONFIG, 40u, -1, offsetof(kc_config_t, est.outlier_p), 'd', 0.0, 0.5, false},
    {KC_TBL_CONFIG, 41u, -1, offsetof(kc_config_t, est.outlier_max), 'u', 0.0, 64.0, false},
    {KC_TBL_CONFIG, 42u, -1, offsetof(kc_config_t, est.use_prior), 'b', 0.0, 1.0, false},
    {KC_TBL_CONFIG, 43u, -1, offsetof(kc_config_t, accept_on_board), 'b', 0.0, 1.0, false},
    {KC_TBL_CONFIG, 44u, -1, offsetof(kc_config_t, accept_change_max_pos_m), 'd', 0.0, 10.0, false},
    {KC_TBL_CONFIG, 45u, -1, offsetof(kc_config_t, accept_sigma_max_pos_m), 'd', 0.0, 10.0, false},
    {KC_TBL_CONFIG, 46u, -1, offsetof(kc_config_t, accept_p_fit_min), 'd', 0.0, 1.0, false},
    {KC_TBL_CONFIG, 47u, -1, offsetof(kc_config_t, no_change_p), 'd', 1e-12, 0.5, false},
    {KC_TBL_CONFIG, 48u, -1, offsetof(kc_config_t, budget_us), 'l', 0.0, 3600000000000.0, false},
    {KC_TBL_CONFIG, 49u, -1, offsetof(kc_config_t, approach_rad), 'd', 0.0, 1.0, false},
    {KC_TBL_CONFIG, 50u, -1, offsetof(kc_config_t, power_idle_w), 'd', 0.0, 1e5, false},
    {KC_TBL_CONFIG, 51u, -1, offsetof(kc_config_t, power_move_w), 'd', 0.0, 1e5, true},
    {KC_TBL_CONFIG, 52u, -1, offsetof(kc_config_t, energy_budget_j), 'd', 0.0, 1e12, false},
    {KC_TBL_CONFIG, 53u, -1, offsetof(kc_config_t, mismatch_pos_m), 'd', 0.0, 10.0, false},
    {KC_TBL_CONFIG, 54u, -1, offsetof(kc_config_t, mismatch_rot_rad), 'd', 0.0, 4.0, false},
    {KC_TBL_CONFIG, 55u, -1, offsetof(kc_config_t, flip_rms_ratio), 'd', 1.0, 100.0, false},
    {KC_TBL_CONFIG, 56u, -1, offsetof(kc_config_t, flip_trust_rad), 'd', 0.0, 3.2, false},
    {KC_TBL_CONFIG, 57u, -1, offsetof(kc_config_t, frame_shared), 'd', 0.0, 1.0, false},
    {KC_TBL_CONFIG, 58u, -1, offsetof(kc_config_t, search_safety), 'd', 1.0, 100.0, false},
    {KC_TBL_CONFIG, 59u, -1, offsetof(kc_config_t, poses_min), 'u', 1.0, 64.0, false},
    {KC_TBL_CONFIG, 60u, -1, offsetof(kc_config_t, tags_tried_min), 'u', 1.0, 32.0, false},
    {KC_TBL_CONFIG, 61u, -1, offsetof(kc_config_t, second_start_noise_scale), 'd', 1.0, 1e3, false},
    {KC_TBL_CONFIG, 62u, -1, offsetof(kc_config_t, mismatch_noise_scale), 'd', 1.0, 1e3, false},
    {KC_TBL_CONFIG, 63u, -1, offsetof(kc_config_t, mismatch_dof_min), 'u', 1.0, 384.0, false},
    {KC_TBL_CONFIG, 64u, -1, offsetof(kc_config_t, mismatch_outliers_min), 'u', 1.0, 64.0, false},
    {KC_TBL_CONFIG, 65u, -1, offsetof(kc_config_t, poor_noise_scale), 'd', 1.0, 1e3, false},
    {KC_TBL_CONFIG, 66u, -1, offsetof(kc_config_t, poor_noise_scale_unlikely), 'd', 1.0, 1e3, true},
    {KC_TBL_CONFIG, 67u, -1, offsetof(kc_config_t, poor_p_fit), 'd', 0.0, 1.0, false},
    {KC_TBL_CONFIG, 68u, -1, offsetof(kc_config_t, store_retries), 'u', 0.0, 100.0, false},
    {KC_TBL_CONFIG, 69u, -1, offsetof(kc_config_t, store_retry_us), 'l', 1000.0, 3600000000.0, false},
    {KC_TBL_CONFIG, 70u, -1, offsetof(kc_config_t, approval_timeout_us), 'l', 1000000.0, 3600000000.0, false},
    {KC_TBL_CONFIG, 71u, -1, offsetof(kc_config_t, frame), 'b', 0.0, 1.0, false},
    {KC_TBL_CONFIG, 73u, -1, offsetof(kc_config_t, initial_design), 'b', 0.0, 1.0, false},
    {KC_TBL_CONFIG, 74u, -1, offsetof(kc_config_t, local_safe_m), 'd', 1e-12, 10.0, false},
    {KC_TBL_CONFIG, 75u, -1, offsetof(kc_config_t, leave_safe_m), 'd', 1e-12, 10.0, false},
    {KC_TBL_CONFIG, 76u, -1, offsetof(kc_config_t, doubt_p), 'd', 0.0, 0.5, false},
    {KC_TBL_CONFIG, 77u, -1, offsetof(kc_config_t, outside_factor), 'd', 1.001, 100.0, false},
    {KC_TBL_CONFIG, 78u, -1, offsetof(kc_config_t, power_min), 'd', 0.0, 0.999999, false},
    {KC_TBL_CONFIG, 79u, -1, offsetof(kc_config_t, rate_measure), 'b', 2.0, 3.0, false},
    {KC_TBL_CONFIG, 80u, -1, offsetof(kc_config_t, rate_cost), 'b', 0.0, 1.0, false},
    {KC_TBL_CONFIG, 81u, -1, offsetof(kc_config_t, frame_s), 'd', 0.0, 3600.0, false},
    {KC_TBL_CONFIG, 82u, -1, offsetof(kc_config_t, stop_confidence), 'd', 0.0, 0.9999, false},
    {KC_TBL_CONFIG, 83u, -1, offsetof(kc_config_t, stop_checks), 'u', 0.0, 64.0, false},
    {KC_TBL_CONFIG, 89u, -1, offsetof(kc_config_t, no_change_power), 'd', 0.0, 0.9999, false},
};

static size_t bytes_of(const limit_t *l)
{
    switch (l->type) {
    case 'b': return 1u;
    case 'h': return 2u;
    case 'u':
    case 'i':
    case 'f': return 4u;
    case 'q': return 16u;
    case 'Q': return 32u;
    default: return 8u;
    }
}

/* The field gets a value; false if its type does not have it. */
static bool put(const limit_t *l, double value)
{
    uint8_t *at = (uint8_t *)&s_t + l->offset;
    const uint64_t u64 = value > 0.0 ? value < 0x1p64 ? (uint64_t)value : UINT64_MAX : 0u;
    const uint32_t u32 = (uint32_t)u64;
    const uint16_t u16 = (uint16_t)u64;
    const uint8_t u8 = (uint8_t)u64;
    const int32_t i32 = (int32_t)value;
    const float f32 = (float)value;
    const void *from = l->type == 'b'   ? (const void *)&u8
                       : l->type == 'h' ? (const void *)&u16
                       : l->type == 'u' ? (const void *)&u32
                       : l->type == 'i' ? (const void *)&i32
                       : l->type == 'f' ? (const void *)&f32
                       : l->type == 'd' ? (const void *)&value
                                        : (const void *)&u64;
    memcpy(at, from, bytes_of(l));
    const bool real = l->type == 'f' || l->type == 'd' || l->type == 'i';
    return real || (value >= 0.0 && value < ldexp(1.0, (int)(8u * bytes_of(l))));
}

static bool refused_for(const limit_t *l)
{
    check(l->kind);
    return s_w.n_bad > 0u && s_w.bad_field == l->field && s_w.bad_index == l->index;
}

static double beyond(const limit_t *l, bool above)
{
    const double limit = above ? l->hi : l->lo;
    if (l->type == 'd') { return nextafter(limit, above ? INFINITY : -INFINITY); }
    if (l->type == 'f') { /* the next one that single precision has */
        float f = (float)limit;
        bool out = above ? (double)f > limit : (double)f < limit;
        return out ? (double)f : (double)nextafterf(f, above ? INFINITY : -INFINITY);
    }
    return above ? limit + 1.0 : limit - 1.0;
}

/* The limit, or the nearest number inside that single precision has. */
static double within(const limit_t *l, bool above)
{
    const double limit = above ? l->hi : l->lo;
    const float f = (float)limit;
    if (l->type != 'f') { return limit; }
    return (above ? (double)f > limit : (double)f < limit)
               ? (double)nextafterf(f, 0.5f * (float)(l->lo + l->hi))
               : (double)f;
}

void test_every_number_is_taken_at_its_limits_and_refused_beyond(void)
{
    for (size_t i = 0u; i < sizeof s_limit / sizeof s_limit[0]; i++) {
        const limit_t *l = &s_limit[i];
        if (l->type == 'Q' || l->type == 'q') { continue; }
        for (uint32_t above = 0u; above < 2u; above++) {
            char name[40];
            (void)snprintf(name, sizeof name, "kind %u field %u side %u", l->kind, (unsigned)l->field,
                           (unsigned)above);
            given_table(l->kind);
            (void)put(l, within(l, above != 0u));
            TEST_ASSERT_TRUE_MESSAGE(l->rule || !refused_for(l), name);
            given_table(l->kind);
            if (!put(l, beyond(l, above != 0u))) { continue; }
            TEST_ASSERT_TRUE_MESSAGE(refused_for(l), name);
        }
        given_table(l->kind);
        if (l->type != 'd' && l->type != 'f') { continue; }
        (void)put(l, NAN);
        TEST_ASSERT_TRUE(refused_for(l));
        TEST_ASSERT_EQUAL_UINT16(KC_EVT_TBL_NOT_FINITE, s_w.bad_id);
    }
}

void test_every_quaternion_must_have_the_norm_one(void)
{
    for (size_t i = 0u; i < sizeof s_limit / sizeof s_limit[0]; i++) {
        const limit_t *l = &s_limit[i];
        const double q[4] = {0.5, 0.5, 0.5, 0.5 + 1e-5};
        const float f[4] = {0.5f, 0.5f, 0.5f, 0.5f + 1e-5f};
        if (l->type != 'Q' && l->type != 'q') { continue; }
        given_table(l->kind);
        memcpy((uint8_t *)&s_t + l->offset, l->type == 'Q' ? (const void *)q : (const void *)f,
               l->type == 'Q' ? sizeof q : sizeof f);
        TEST_ASSERT_TRUE(refused_for(l));
        TEST_ASSERT_EQUAL_UINT16(KC_EVT_TBL_NOT_UNIT, s_w.bad_id);
    }
}

/* Through an image into an empty table. */
static void written_and_read(uint16_t kind)
{
    static uint8_t image[KC_IMAGE_MAX];
    memset(&s_w, 0, sizeof s_w);
    s_w.mode = KC_WALK_WRITE;
    s_w.out = image;
    s_w.cap = sizeof image;
    kc_layout_walk(&s_w, kind, &s_t);
    const uint32_t n = s_w.pos;
    memset(&s_t, 0, sizeof s_t);
    memset(&s_w, 0, sizeof s_w);
    s_w.mode = KC_WALK_READ;
    s_w.in = image;
    s_w.in_n = n;
    kc_layout_walk(&s_w, kind, &s_t);
    TEST_ASSERT_EQUAL_UINT32(n, s_w.pos);
}

/* Written and read again into an empty table, every field is where it was. */
static void given_stops(void)
{
    memset(&s_t, 0, sizeof s_t);
    given_space(&s_t.space, 5u, 1u);
    s_t.space.n_stop = 2u;
    s_t.space.stop[1][0] = 100u;
    s_t.space.stop[1][1] = 200u;
    s_t.space.stop[4][0] = 1u;
}

void test_stops_come_back_from_an_image_and_one_without_them_ends_before(void)
{
    given_stops();
    written_and_read(KC_TBL_SPACE);
    s_t.space.n_stop = 0u;
    memset(s_t.space.stop, 0, sizeof s_t.space.stop);
    written_and_read(KC_TBL_SPACE);
}

/* Every stop of every candidate by itself, and in the image one byte each. */
void test_each_stop_is_where_it_was(void)
{
    static kc_tbl_scratch_t written;
    memset(&s_t, 0, sizeof s_t);
    given_space(&s_t.space, 5u, 1u);
    written_and_read(KC_TBL_SPACE);
    const uint32_t without = s_w.pos;
    for (uint32_t n = 1u; n <= KC_STOP_MAX; n++) {
        s_t.space.n_stop = n;
        for (uint32_t i = 0u; i < 5u; i++) {
            for (uint32_t k = 0u; k < n; k++) { s_t.space.stop[i][k] = (uint8_t)(10u * i + k + 1u); }
        }
        written = s_t;
        written_and_read(KC_TBL_SPACE);
        TEST_ASSERT_EQUAL_MEMORY(written.space.stop, s_t.space.stop, sizeof s_t.space.stop);
        check(KC_TBL_SPACE);
        TEST_ASSERT_EQUAL_UINT32(0u, s_w.n_bad);
        written_and_read(KC_TBL_SPACE);
        TEST_ASSERT_EQUAL_UINT32(5u * n, s_w.pos - without - 4u);
    }
    for (uint32_t k = 0u; k < KC_STOP_MAX; k++) { /* a local pose has none */
        given_stops();
        s_t.space.n_stop = KC_STOP_MAX;
        memset(s_t.space.stop, 0, sizeof s_t.space.stop);
        s_t.space.cand[3].why = KC_CAND_LOCAL;
        for (uint32_t i = 0u; i <= k; i++) { s_t.space.stop[3][i] = (uint8_t)(i + 1u); }
        check(KC_TBL_SPACE);
        TEST_ASSERT_EQUAL_UINT32(k + 1u, s_w.n_bad);
        TEST_ASSERT_EQUAL_INT32(3, s_w.bad_index);
    }
}

void test_stops_out_of_order_or_too_many_are_refused(void)
{
    given_stops();
    s_t.space.stop[1][1] = 50u;
    expect_refused(KC_TBL_SPACE, 1, 36u, 50.0);
    given_stops();
    s_t.space.n_stop = KC_STOP_MAX + 1u;
    check(KC_TBL_SPACE);
    TEST_ASSERT_EQUAL_UINT32(35u, s_w.bad_field);
    TEST_ASSERT_EQUAL_UINT8(1u, s_w.lost);
}

void test_every_field_comes_back_from_an_image(void)
{
    static kc_tbl_scratch_t written;
    for (size_t i = 0u; i < sizeof s_limit / sizeof s_limit[0]; i++) {
        const limit_t *l = &s_limit[i];
        given_table(l->kind);
        /* counts keep theirs: others would walk entries that are not there */
        const bool real = l->type == 'd' || l->type == 'f';
        if (!l->rule && (real || l->index >= 0) && l->hi > l->lo) {
            (void)put(l, real ? l->lo + 0.375 * (l->hi - l->lo) : l->hi);
        }
        const double q[4] = {0.5, 0.1, -0.7, 0.5};
        const float f[4] = {0.5f, 0.1f, -0.7f, 0.5f};
        if (l->type == 'Q' || l->type == 'q') {
            memcpy((uint8_t *)&s_t + l->offset, l->type == 'Q' ? (const void *)q : (const void *)f,
                   bytes_of(l));
        }
        written = s_t;
        written_and_read(l->kind);
        TEST_ASSERT_EQUAL_MEMORY((uint8_t *)&written + l->offset, (uint8_t *)&s_t + l->offset, bytes_of(l));
    }
}

/* ---- arrays: every element of them has the limits, and comes back from an image ---- */

#define ARRAY(KIND, field, index, type, member, letter, most)                         \
    {{KC_TBL_##KIND, field, index, offsetof(type, member), letter, 0.0, most, false}, \
     (uint32_t)(sizeof(((type *)0)->member) / sizeof(((type *)0)->member[0]))}
static const struct {
    limit_t first;
    uint32_t n;
} s_array[] = {
    ARRAY(ARM, 13u, 0, kc_arm_t, joint[0].com_m, 'd', 10.0),
    ARRAY(ARM, 15u, -1, kc_arm_t, base_xyz_m, 'd', 10.0),
    ARRAY(ARM, 17u, -1, kc_arm_t, tool_xyz_m, 'd', 10.0),
    ARRAY(ARM, 19u, -1, kc_arm_t, gravity_m_s2, 'd', 100.0),
    ARRAY(CAMERA, 1u, -1, kc_camera_t, mast_xyz_m, 'd', 10.0),
    ARRAY(CAMERA, 3u, -1, kc_camera_t, pantilt_xyz_m, 'd', 10.0),
    ARRAY(CAMERA, 18u, 0, kc_camera_t, tag[0].xyz_m, 'd', 10.0),
    ARRAY(SPACE, 6u, 0, kc_space_t, hub_q[0], 'f', 100.0),
    ARRAY(SPACE, 8u, -1, kc_space_t, servo_bound, 'f', 100.0),
    ARRAY(SPACE, 10u, 0, kc_space_t, cand[0].p_m, 'f', 10.0),
    ARRAY(SPACE, 12u, 0, kc_space_t, cand[0].q_seed, 'f', 100.0),
    ARRAY(SPACE, 21u, KC_SPACE_INDEX_BODY, kc_space_t, body[0].start_m, 'f', 10.0),
    ARRAY(SPACE, 22u, KC_SPACE_INDEX_BODY, kc_space_t, body[0].end_m, 'f', 10.0),
    ARRAY(SPACE, 26u, KC_SPACE_INDEX_VOLUME, kc_space_t, volume[0].p_m, 'f', 10.0),
    ARRAY(SPACE, 27u, KC_SPACE_INDEX_VOLUME, kc_space_t, volume[0].size_m, 'f', 10.0),
    ARRAY(KERNEL, 10u, 0, kc_kernel_t, hyper[0].w, 'd', 1.0),
};

void test_every_element_of_an_array_is_checked_and_comes_back(void)
{
    static kc_tbl_scratch_t written;
    for (size_t i = 0u; i < sizeof s_array / sizeof s_array[0]; i++) {
        const limit_t *first = &s_array[i].first;
        uint32_t n = s_array[i].n;
        if (n == KC_JOINT_MAX) { n = 7u; } /* joints that the arm has */
        if (n == KC_SPECTRUM_MAX) { n = 21u; }
        for (uint32_t k = 0u; k < n; k++) {
            limit_t l = *first;
            l.offset += k * bytes_of(first);
            given_table(l.kind);
            (void)put(&l, beyond(&l, true));
            TEST_ASSERT_TRUE(refused_for(&l));
        }
        given_table(first->kind);
        for (uint32_t k = 0u; k < n; k++) {
            limit_t l = *first;
            l.offset += k * bytes_of(first);
            (void)put(&l, first->hi * (0.25 + (double)k / 64.0));
        }
        written = s_t;
        written_and_read(first->kind);
        TEST_ASSERT_EQUAL_MEMORY((uint8_t *)&written + first->offset, (uint8_t *)&s_t + first->offset,
                                 n * bytes_of(first));
    }
}

/* What one field may be beside another: docs/TABLES.md says "above", or "not below". */
void test_where_two_fields_may_be_equal(void)
{
    REFUSED(ARM, arm.joint[2].q_max, s_t.arm.joint[2].q_min, 2, 10u);
    REFUSED(CAMERA, camera.pan_max_rad, s_t.camera.pan_min_rad, -1, 6u);
    REFUSED(CAMERA, camera.tilt_max_rad, s_t.camera.tilt_min_rad, -1, 8u);
    given_table(KC_TBL_TERMS);
    s_t.terms.coef[4].ub = s_t.terms.coef[4].lb;
    check(KC_TBL_TERMS);
    TEST_ASSERT_EQUAL_UINT32(0u, s_w.n_bad);
    given_table(KC_TBL_CONFIG);
    s_t.config.sigma_pos_min_m = s_t.config.sigma_pos_max_m;
    s_t.config.sigma_rot_min_rad = s_t.config.sigma_rot_max_rad;
    s_t.config.power_move_w = s_t.config.power_idle_w = 5.0;
    s_t.config.poor_noise_scale_unlikely = s_t.config.poor_noise_scale;
    check(KC_TBL_CONFIG);
    TEST_ASSERT_EQUAL_UINT32(0u, s_w.n_bad);
    REFUSED(CONFIG, config.poor_noise_scale_unlikely, 2.0 * s_t.config.poor_noise_scale, -1, 66u);
}

/* Values belong to the arm and the terms that they were estimated for: both are named, or neither and all are zero. */
void test_a_correction_that_names_no_arm_or_half_of_what_it_is_for_is_refused(void)
{
    for (uint32_t i = 0u; i < 28u; i += 27u) {
        given_table(KC_TBL_KIN);
        s_t.kin.value[i] = 1e-9;
        expect_refused(KC_TBL_KIN, -1, 4u, 0.0);
    }
    given_table(KC_TBL_KIN);
    s_t.kin.arm_crc = 7u;
    expect_refused(KC_TBL_KIN, -1, 5u, 0.0);
    REFUSED(KIN, kin.terms_crc, 7u, -1, 5u);
}

void test_every_name_must_be_one(void)
{
    given_table(KC_TBL_ARM);
    s_t.arm.name[0] = '\x01';
    expect_refused(KC_TBL_ARM, -1, 1u, 1.0);
    given_table(KC_TBL_TERMS);
    s_t.terms.coef[1].name[2] = '\x7f';
    expect_refused(KC_TBL_TERMS, 1, 3u, 127.0);
}

void test_the_segments_of_candidates_come_back_from_an_image(void)
{
    static kc_tbl_scratch_t written;
    given_table(KC_TBL_SPACE);
    for (uint32_t k = 0u; k < 4u; k++) {
        s_t.space.edge[k] = (uint8_t)(0xa5u + k);
    } /* 36 pairs of 9 candidates */
    s_t.space.edge[4] = 0x0bu;
    written = s_t;
    written_and_read(KC_TBL_SPACE);
    TEST_ASSERT_EQUAL_MEMORY(written.space.edge, s_t.space.edge, sizeof written.space.edge);
}
