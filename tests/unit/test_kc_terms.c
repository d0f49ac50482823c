/* kc_terms.c: DH coefficients and every refused table. */
#include <math.h>
#include <string.h>

#include "kc_terms.h"
#include "unity.h"

static kc_terms_t s_t;
static const double BOUND[4] = {1.5, 0.6, 0.05, 0.2};

void setUp(void)
{
    memset(&s_t, 0, sizeof s_t);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_terms_add_dh(&s_t, 7u, BOUND));
}

void test_dh_coefficients_are_named_bounded_and_placed(void)
{
    static const char *name[4] = {"J3.phi_rad", "J3.alpha_rad", "J3.a_m", "J3.d_m"};
    static const uint8_t frame[4] = {2u, 3u, 3u, 2u}, comp[4] = {KC_RZ, KC_RX, KC_TX, KC_TZ};
    TEST_ASSERT_EQUAL_UINT32(28u, s_t.n_coef);
    TEST_ASSERT_EQUAL_UINT32(28u, s_t.n_term);
    for (uint32_t e = 0u; e < 4u; e++) {
        const kc_coef_t *coef = &s_t.coef[8u + e];
        const kc_term_t *term = &s_t.term[8u + e];
        TEST_ASSERT_EQUAL_STRING(name[e], coef->name);
        TEST_ASSERT_EQUAL_DOUBLE(-BOUND[e], coef->lb);
        TEST_ASSERT_EQUAL_DOUBLE(BOUND[e], coef->ub);
        TEST_ASSERT_EQUAL_UINT8(1u, coef->enabled);
        TEST_ASSERT_EQUAL_UINT16(8u + e, term->coef);
        TEST_ASSERT_EQUAL_UINT8(frame[e], term->frame);
        TEST_ASSERT_EQUAL_UINT8(comp[e], term->comp);
        TEST_ASSERT_EQUAL_DOUBLE(1.0, term->gain);
        TEST_ASSERT_EQUAL_UINT8(KC_VAR_ONE, term->basis[0].var);
        TEST_ASSERT_EQUAL_UINT8(KC_VAR_ONE, term->basis[1].var);
    }
}

void test_nothing_of_what_was_there_before_gets_into_a_coefficient(void)
{
    static kc_terms_t clean;
    clean = s_t;
    memset(&s_t, 0xff, sizeof s_t);
    s_t.n_coef = s_t.n_term = 0u;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_terms_add_dh(&s_t, 7u, BOUND));
    TEST_ASSERT_EQUAL_MEMORY(clean.coef, s_t.coef, 28u * sizeof clean.coef[0]);
    TEST_ASSERT_EQUAL_MEMORY(clean.term, s_t.term, 28u * sizeof clean.term[0]);
}

void test_an_arm_of_as_many_joints_as_there_may_be_gets_its_terms(void)
{
    for (uint32_t n = 0u; n <= KC_JOINT_MAX; n++) {
        memset(&s_t, 0, sizeof s_t);
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_terms_add_dh(&s_t, n, BOUND));
        TEST_ASSERT_EQUAL_UINT32(4u * n, s_t.n_coef);
        TEST_ASSERT_EQUAL_UINT32(4u * n, s_t.n_term);
        int32_t index = -9;
        double got = 0.0;
        TEST_ASSERT_EQUAL_INT(n > 0u ? KC_OK : KC_ERR_RANGE, kc_terms_validate(&s_t, n, &index, &got));
    }
    s_t.n_coef = KC_COEF_MAX - 28u; /* as many as are left */
    s_t.n_term = KC_TERM_MAX - 28u;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_terms_add_dh(&s_t, 7u, BOUND));
    TEST_ASSERT_EQUAL_UINT32(KC_COEF_MAX, s_t.n_coef);
    TEST_ASSERT_EQUAL_UINT32(KC_TERM_MAX, s_t.n_term);
}

/* Of every coefficient and every term, first and last. */
void test_each_entry_is_checked(void)
{
    for (uint32_t k = 0u; k < 28u; k++) {
        int32_t index = -9;
        double got = 0.0;
        setUp();
        s_t.coef[k].scale = -1.0;
        TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, kc_terms_validate(&s_t, 7u, &index, &got));
        TEST_ASSERT_EQUAL_INT32((int32_t)k, index);
        setUp();
        s_t.term[k].comp = KC_RZ + 1u;
        TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, kc_terms_validate(&s_t, 7u, &index, &got));
        TEST_ASSERT_EQUAL_INT32(KC_TERMS_INDEX_TERM + (int32_t)k, index);
        setUp();
        s_t.n_coef = s_t.n_term = k; /* what lies beyond them is not */
        s_t.coef[k].scale = -1.0;
        s_t.term[k].comp = KC_RZ + 1u;
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_terms_validate(&s_t, 7u, &index, &got));
    }
}

void test_what_add_dh_makes_is_valid(void)
{
    int32_t index = -9;
    double got = 0.0;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_terms_validate(&s_t, 7u, &index, &got));
    for (; s_t.n_term < KC_TERM_MAX; s_t.n_term++) { s_t.term[s_t.n_term] = s_t.term[0]; }
    for (; s_t.n_coef < KC_COEF_MAX; s_t.n_coef++) { s_t.coef[s_t.n_coef] = s_t.coef[0]; }
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_terms_validate(&s_t, 7u, &index, &got)); /* as many as there may be */
    memset(&s_t, 0, sizeof s_t);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_terms_validate(&s_t, 7u, &index, &got)); /* no terms at all */
}

void test_dh_that_does_not_fit_leaves_the_table_unchanged(void)
{
    static kc_terms_t before;
    s_t.n_coef = KC_COEF_MAX - 27u;
    before = s_t;
    TEST_ASSERT_EQUAL_INT(KC_ERR_FULL, kc_terms_add_dh(&s_t, 7u, BOUND));
    TEST_ASSERT_EQUAL_MEMORY(&before, &s_t, sizeof before);
    s_t.n_coef = 0u;
    s_t.n_term = KC_TERM_MAX - 27u;
    before = s_t;
    TEST_ASSERT_EQUAL_INT(KC_ERR_FULL, kc_terms_add_dh(&s_t, 7u, BOUND));
    TEST_ASSERT_EQUAL_MEMORY(&before, &s_t, sizeof before);
    TEST_ASSERT_EQUAL_INT(KC_ERR_FULL, kc_terms_add_dh(&s_t, KC_JOINT_MAX + 1u, BOUND));
}

static void refused_for(uint32_t n_joints, int32_t index_want, double got_want)
{
    int32_t index = -9;
    double got = -9.0;
    TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, kc_terms_validate(&s_t, n_joints, &index, &got));
    TEST_ASSERT_EQUAL_INT32(index_want, index);
    TEST_ASSERT_EQUAL_DOUBLE(got_want, got);
    setUp();
}

static void refused(int32_t index, double got) { refused_for(7u, index, got); }

void test_wrong_counts_are_refused(void)
{
    s_t.n_coef = KC_COEF_MAX + 1u;
    refused(-1, KC_COEF_MAX + 1.0);
    s_t.n_term = KC_TERM_MAX + 1u;
    refused(-1, KC_TERM_MAX + 1.0);
    refused_for(0u, -1, 0.0);
    refused_for(KC_JOINT_MAX + 1u, -1, KC_JOINT_MAX + 1.0);
}

void test_bounds_that_meet_are_bounds(void)
{
    int32_t index = -9;
    double got = -9.0;
    s_t.coef[6].lb = s_t.coef[6].ub;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_terms_validate(&s_t, 7u, &index, &got));
}

void test_wrong_coefficients_are_refused_by_number(void)
{
    s_t.coef[5].name[0] = '\0';
    refused(5, 0.0);
    s_t.coef[5].lb = NAN;
    refused(5, NAN);
    s_t.coef[5].ub = INFINITY;
    refused(5, INFINITY);
    s_t.coef[6].lb = 1.0; /* above its ub */
    refused(6, 1.0);
    s_t.coef[6].prior_sigma = -0.1;
    refused(6, -0.1);
    s_t.coef[6].scale = 0.0;
    refused(6, 0.0);
    s_t.coef[6].enabled = 2u;
    refused(6, 2.0);
}

void test_wrong_terms_are_refused_by_number(void)
{
    s_t.term[3].coef = 28u;
    refused(1003, 28.0);
    s_t.term[3].frame = 8u; /* an arm of 7 joints has no frame 8 */
    refused(1003, 8.0);
    s_t.term[3].frame = KC_FRAME_COUNT;
    refused(1003, 12.0);
    s_t.term[3].comp = 6u;
    refused(1003, 6.0);
    s_t.term[3].gain = NAN;
    refused(1003, NAN);
    s_t.term[3].basis[0].fn = KC_FN_COUNT;
    refused(1003, KC_FN_COUNT);
    s_t.term[3].basis[1].var = KC_VAR_COUNT;
    refused(1003, KC_VAR_COUNT);
    s_t.term[3].basis[1].c0 = INFINITY;
    refused(1003, INFINITY);
    s_t.term[3].basis[0].c1 = NAN;
    refused(1003, NAN);
}

void test_a_sine_has_no_offset_beyond_the_largest_angle(void)
{
    const kc_basis_t ripple = {KC_FN_SIN, KC_VAR_Q, 2u, -9e5, 1e6};
    s_t.term[3].basis[1] = ripple;
    refused(1003, 1e6);
    s_t.term[3].basis[0] = ripple;
    s_t.term[3].basis[0].fn = KC_FN_COS;
    refused(1003, 1e6);
    s_t.term[3].basis[0] = ripple; /* 1e6 rad: just allowed */
    s_t.term[3].basis[0].c0 = 1.0;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_terms_validate(&s_t, 7u, &(int32_t){0}, &(double){0}));
    s_t.term[3].basis[0] = ripple; /* no angle: the others and the constant stay as they were */
    s_t.term[3].basis[0].fn = KC_FN_TANH;
    s_t.term[3].basis[1] = ripple;
    s_t.term[3].basis[1].var = KC_VAR_ONE;
    s_t.term[3].basis[1].index = 0u;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_terms_validate(&s_t, 7u, &(int32_t){0}, &(double){0}));
}

void test_frames_beyond_the_arm_are_tool_camera_and_measured(void)
{
    int32_t index;
    double got;
    for (uint8_t f = KC_FRAME_TOOL; f < KC_FRAME_COUNT; f++) {
        s_t.term[0].frame = f;
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_terms_validate(&s_t, 7u, &index, &got));
    }
}

/* Least and greatest index of a variable on an arm of 7 joints. */
static void index_limits(uint8_t var, uint8_t *least, uint8_t *most)
{
    const bool link = var == KC_VAR_MX || var == KC_VAR_MY || var == KC_VAR_MZ || var == KC_VAR_GX ||
                      var == KC_VAR_GY || var == KC_VAR_GZ;
    const bool joint = var == KC_VAR_Q || var == KC_VAR_TAU || var == KC_VAR_DIR || var == KC_VAR_QDOT ||
                       var == KC_VAR_TAU_PAYLOAD;
    *least = joint ? 1u : 0u;
    *most = joint || link ? 7u : 0u;
}

void test_every_variable_takes_its_own_range_of_indices(void)
{
    for (uint8_t var = 0u; var < KC_VAR_LEVX; var++) {
        uint8_t least, most;
        index_limits(var, &least, &most);
        for (uint8_t i = 0u; i <= 9u; i++) {
            int32_t index;
            double got;
            s_t.term[1].basis[1].var = var;
            s_t.term[1].basis[1].index = i;
            const kc_status_t want = i >= least && i <= most ? KC_OK : KC_ERR_RANGE;
            TEST_ASSERT_EQUAL_INT(want, kc_terms_validate(&s_t, 7u, &index, &got));
        }
    }
}

void test_columns_of_a_pnp_pose_and_last_moves_do_not_fly(void)
{
    for (uint8_t var = KC_VAR_PNP_TX; var <= KC_VAR_MOVE; var++) {
        for (uint8_t i = 0u; i <= 2u; i++) {
            int32_t index;
            double got;
            s_t.term[1].basis[1].var = var;
            s_t.term[1].basis[1].index = i;
            TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, kc_terms_validate(&s_t, 7u, &index, &got));
        }
    }
}

static kc_status_t with_lever(uint8_t var, uint32_t index)
{
    int32_t at;
    double got;
    s_t.term[1].basis[1].var = var;
    s_t.term[1].basis[1].index = (uint8_t)index;
    return kc_terms_validate(&s_t, 7u, &at, &got);
}

void test_a_lever_takes_a_link_with_a_joint_and_a_body_beyond_it(void)
{
    for (uint8_t var = KC_VAR_LEVX; var <= KC_VAR_LEVZ; var++) {
        TEST_ASSERT_EQUAL_INT(KC_OK, with_lever(var, KC_LEVER_INDEX(0u, 1u)));
        TEST_ASSERT_EQUAL_INT(KC_OK, with_lever(var, KC_LEVER_INDEX(6u, 7u)));
        TEST_ASSERT_EQUAL_INT(KC_OK, with_lever(var, KC_LEVER_INDEX(6u, KC_LEVER_TOOL)));
        TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, with_lever(var, KC_LEVER_INDEX(7u, KC_LEVER_TOOL)));
        TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, with_lever(var, KC_LEVER_INDEX(3u, 3u)));
        TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, with_lever(var, KC_LEVER_INDEX(3u, 2u)));
        TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, with_lever(var, KC_LEVER_INDEX(0u, 8u)));
    }
}
