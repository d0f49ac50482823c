/* kc_tables.c: images, staging, validation, activation. Every refusal: answer, event and state. */
#include <math.h>
#include <string.h>

#include "given_tables.h"
#include "kc_layout.h"
#include "unity.h"

static kc_tables_t s_t, s_before;
static kc_tbl_scratch_t s_scratch, s_table, s_back;
static uint8_t s_staged[KC_IMAGE_MAX];
static kc_events_t s_ev;
static uint8_t s_image[KC_IMAGE_MAX], s_window[KC_IMAGE_MAX];
static uint32_t s_n;

static void forget_events(void) { memset(&s_ev, 0, sizeof s_ev); }

void setUp(void)
{
    memset(&s_t, 0, sizeof s_t);
    memset(&s_table, 0, sizeof s_table);
    s_t.scratch = &s_scratch;
    s_t.staging.image = s_staged;
    forget_events();
}

/* A good table of the kind in s_table; SPACE for the active arm. */
static void given_table(uint16_t kind)
{
    memset(&s_table, 0, sizeof s_table);
    switch (kind) {
    case KC_TBL_ARM: given_arm(&s_table.arm); break;
    case KC_TBL_CAMERA: given_camera(&s_table.camera); break;
    case KC_TBL_TERMS: given_terms(&s_table.terms); break;
    case KC_TBL_KIN: given_kin(&s_table.kin); break;
    case KC_TBL_SPACE: given_space(&s_table.space, 30u, s_t.active.crc[KC_TBL_ARM] | 1u); break;
    case KC_TBL_KERNEL: given_kernel(&s_table.kernel); break;
    default: given_config(&s_table.config); break;
    }
    if (kind == KC_TBL_SPACE && s_t.active.crc[KC_TBL_ARM] != 0u) {
        s_table.space.arm_crc = s_t.active.crc[KC_TBL_ARM];
    }
}

static void given_image_of(uint16_t kind)
{
    given_table(kind);
    s_n = given_image(kind, &s_table, s_image);
}

static kc_status_t stage(uint16_t kind)
{
    kc_status_t st = KC_OK;
    for (uint32_t at = 0u; st == KC_OK && at < s_n; at += KC_CHUNK_BYTES) {
        uint32_t n = s_n - at < KC_CHUNK_BYTES ? s_n - at : KC_CHUNK_BYTES;
        st = kc_tbl_chunk(&s_t, kind, s_n, at, &s_image[at], n, &s_ev);
    }
    return st;
}

static uint32_t image_crc(void) { return kc_tbl_image_crc(s_image, s_n); }

/* A good table of the kind. */
static void given_staged(uint16_t kind)
{
    given_image_of(kind);
    TEST_ASSERT_EQUAL_INT(KC_OK, stage(kind));
}

/* What is in s_table. */
static void given_table_staged(uint16_t kind)
{
    s_n = given_image(kind, &s_table, s_image);
    TEST_ASSERT_EQUAL_INT(KC_OK, stage(kind));
    forget_events();
}

static void given_table_valid(uint16_t kind)
{
    s_n = given_image(kind, &s_table, s_image);
    TEST_ASSERT_EQUAL_INT(KC_OK, stage(kind));
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_validate(&s_t, kind, image_crc(), &s_ev));
}

static void bring_in(uint16_t kind)
{
    given_table_valid(kind);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_activate(&s_t, kind, image_crc(), &s_ev));
}

static void given_active(uint16_t kind)
{
    given_table(kind);
    bring_in(kind);
    forget_events();
}

static void given_all_active(void)
{
    for (uint16_t kind = 1u; kind < KC_TBL_COUNT; kind++) { given_active(kind); }
}

/* A correction that belongs to the active arm and terms. */
static void given_correction(double value)
{
    given_table(KC_TBL_KIN);
    for (uint32_t i = 0u; i < 28u; i++) {
        s_table.kin.value[i] = value;
        s_table.kin.sigma[i] = 1e-3;
    }
    s_table.kin.arm_crc = s_t.active.crc[KC_TBL_ARM];
    s_table.kin.terms_crc = s_t.active.crc[KC_TBL_TERMS];
    s_table.kin.session = 5u;
    s_table.kin.n_poses = 20u;
    s_table.kin.made_us = 123456789012345ull;
}

static void remember(void) { s_before = s_t; }
static void expect_active_unchanged(void)
{
    TEST_ASSERT_EQUAL_MEMORY(&s_before.active, &s_t.active, sizeof s_t.active);
}

static void expect_event(uint16_t id, int32_t index, double got, double want)
{
    int at = event_at(&s_ev, id);
    TEST_ASSERT_MESSAGE(at >= 0, kc_event_name(id));
    TEST_ASSERT_EQUAL_INT32(index, s_ev.e[at].index);
    TEST_ASSERT_EQUAL_DOUBLE(got, s_ev.e[at].got);
    TEST_ASSERT_EQUAL_DOUBLE(want, s_ev.e[at].want);
}

/* ---- images ---- */

void test_an_image_starts_with_magic_kind_version_size_and_crc(void)
{
    given_image_of(KC_TBL_CAMERA);
    TEST_ASSERT_EQUAL_MEMORY("KCT1", s_image, 4);
    TEST_ASSERT_EQUAL_HEX8(KC_TBL_CAMERA, s_image[4]);
    TEST_ASSERT_EQUAL_HEX8(0, s_image[5]);
    TEST_ASSERT_EQUAL_HEX8(kc_layout_version(KC_TBL_CAMERA), s_image[6]);
    TEST_ASSERT_EQUAL_HEX8((s_n - 16u) & 0xffu, s_image[8]);
    TEST_ASSERT_EQUAL_HEX8((s_n - 16u) >> 8u, s_image[9]);
    TEST_ASSERT_EQUAL_HEX32(image_crc(), (uint32_t)s_image[12] | (uint32_t)s_image[13] << 8u |
                                             (uint32_t)s_image[14] << 16u | (uint32_t)s_image[15] << 24u);
}

void test_every_kind_reads_back_what_was_written(void)
{
    for (uint16_t kind = 1u; kind < KC_TBL_COUNT; kind++) {
        uint32_t n_again = 0u;
        given_image_of(kind);
        memset(&s_back, 0xa5, sizeof s_back);
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_decode(kind, s_image, s_n, &s_back, &s_ev));
        TEST_ASSERT_EQUAL_UINT32(0u, s_ev.n);
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_encode(kind, &s_back, 0u, s_window, KC_IMAGE_MAX, &n_again));
        TEST_ASSERT_EQUAL_UINT32(s_n, n_again);
        TEST_ASSERT_EQUAL_MEMORY(s_image, s_window, s_n);
    }
}

void test_a_read_table_equals_the_written_one_field_by_field(void)
{
    given_image_of(KC_TBL_ARM);
    memset(&s_back, 0xa5, sizeof s_back);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_decode(KC_TBL_ARM, s_image, s_n, &s_back, &s_ev));
    TEST_ASSERT_EQUAL_STRING("WAM7", s_back.arm.name);
    TEST_ASSERT_EQUAL_UINT32(7u, s_back.arm.n_joints);
    TEST_ASSERT_EQUAL_DOUBLE(-4.76, s_back.arm.joint[4].q_min);
    TEST_ASSERT_EQUAL_DOUBLE(0.55, s_back.arm.joint[2].d_m);
    TEST_ASSERT_EQUAL_DOUBLE(9.48, s_back.arm.joint[5].gear_ratio);
    TEST_ASSERT_EQUAL_DOUBLE(-9.81, s_back.arm.gravity_m_s2[2]);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_back.arm.joint[7].mass_kg); /* not stored, so zero */
}

void test_the_size_of_an_image_follows_its_content(void)
{
    given_image_of(KC_TBL_KIN);
    TEST_ASSERT_EQUAL_UINT32(16u + 4u + 28u * 16u + 28u, s_n);
    s_table.kin.n_coef = 2u;
    TEST_ASSERT_EQUAL_UINT32(16u + 4u + 2u * 16u + 28u, given_image(KC_TBL_KIN, &s_table, s_image));
}

/* By the sizes of the fields in docs/TABLES.md; what is repeated counts as often as the given tables have it. */
void test_every_image_has_the_size_of_its_documented_fields(void)
{
    static const uint32_t want[KC_TBL_COUNT] = {
        [KC_TBL_ARM] = 24u + 4u + 7u * 98u + 136u,
        [KC_TBL_CAMERA] = 112u + 8u * 8u + 8u + 4u + 2u * 68u + 9u * 8u,
        [KC_TBL_TERMS] = 8u + 28u * 57u + 28u * 50u + 4u,
        [KC_TBL_KIN] = 4u + 28u * 16u + 28u,
        [KC_TBL_SPACE] = 16u + 3u * 2u + 2u * 30u + 7u * 4u + 4u + 30u * 68u + 55u + 2u * (4u + 2u * 33u) +
                         7u * 32u,
        [KC_TBL_KERNEL] = 14u + 2u * (44u + 21u * 8u),
        [KC_TBL_CONFIG] = 65u + 108u + 76u + 41u + 89u + 117u + 63u + 24u +
                          17u, /* designing to observing on the way, what was added last */
    };
    for (uint16_t kind = 1u; kind < KC_TBL_COUNT; kind++) {
        given_image_of(kind);
        TEST_ASSERT_EQUAL_UINT32(16u + want[kind], s_n);
    }
    given_space(&s_table.space, 2u, 1u); /* one segment, in a byte; two initial poses */
    TEST_ASSERT_EQUAL_UINT32(16u + want[KC_TBL_SPACE] - 2u - 28u * 68u - 54u,
                             given_image(KC_TBL_SPACE, &s_table, s_image));
}

void test_the_largest_search_space_fits_an_image(void)
{
    given_space(&s_table.space, KC_CAND_MAX, 1u);
    s_table.space.n_joints = KC_JOINT_MAX;
    s_table.space.n_hub = KC_HUB_MAX;
    s_table.space.n_initial = KC_INITIAL_MAX;
    s_table.space.n_stop = KC_STOP_MAX;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_encode(KC_TBL_SPACE, &s_table, 0u, s_image, KC_IMAGE_MAX, &s_n));
    TEST_ASSERT_LESS_OR_EQUAL(KC_IMAGE_MAX, s_n);
}

void test_a_dump_in_windows_gives_the_whole_image(void)
{
    given_image_of(KC_TBL_SPACE);
    for (uint32_t at = 0u; at < s_n; at += 100u) {
        uint32_t n = 0u;
        kc_status_t st = kc_tbl_encode(KC_TBL_SPACE, &s_table, at, &s_window[at], 100u, &n);
        TEST_ASSERT_EQUAL_UINT32(s_n, n);
        TEST_ASSERT_EQUAL_INT(at + 100u < s_n ? KC_ERR_FULL : KC_OK, st);
    }
    TEST_ASSERT_EQUAL_MEMORY(s_image, s_window, s_n);
}

void test_a_window_beyond_the_end_writes_nothing(void)
{
    uint32_t n = 0u;
    given_image_of(KC_TBL_KIN);
    s_window[0] = 0xeeu;
    TEST_ASSERT_EQUAL_INT(KC_ERR_FULL, kc_tbl_encode(KC_TBL_KIN, &s_table, s_n + 1u, s_window, 10u, &n));
    TEST_ASSERT_EQUAL_UINT32(s_n, n);
    TEST_ASSERT_EQUAL_HEX8(0xee, s_window[0]);
}

void test_sizing_needs_no_buffer(void)
{
    uint32_t n = 0u;
    given_image_of(KC_TBL_KIN);
    TEST_ASSERT_EQUAL_INT(KC_ERR_FULL, kc_tbl_encode(KC_TBL_KIN, &s_table, 0u, NULL, 0u, &n));
    TEST_ASSERT_EQUAL_UINT32(s_n, n);
}

void test_encoding_refuses_an_unknown_kind_and_an_impossible_count(void)
{
    uint32_t n = 9u;
    TEST_ASSERT_EQUAL_INT(KC_ERR_ARG, kc_tbl_encode(KC_TBL_COUNT, &s_table, 0u, s_window, 10u, &n));
    TEST_ASSERT_EQUAL_UINT32(0u, n);
    s_table.kin.n_coef = KC_COEF_MAX + 1u;
    TEST_ASSERT_EQUAL_INT(KC_ERR_ARG, kc_tbl_encode(KC_TBL_KIN, &s_table, 0u, s_window, 10u, &n));
    TEST_ASSERT_EQUAL_UINT32(0u, n);
}

void test_a_stub_of_an_image_has_no_crc(void)
{
    given_image_of(KC_TBL_KIN);
    TEST_ASSERT_EQUAL_HEX32(0u, kc_tbl_image_crc(s_image, 15u));
    s_image[0] = 'X';
    TEST_ASSERT_EQUAL_HEX32(0u, kc_tbl_image_crc(s_image, s_n));
}

/* ---- staging ---- */

void test_chunks_in_order_complete_the_image(void)
{
    given_image_of(KC_TBL_SPACE);
    TEST_ASSERT_GREATER_THAN(KC_CHUNK_BYTES, s_n);
    TEST_ASSERT_EQUAL_INT(KC_OK, stage(KC_TBL_SPACE));
    TEST_ASSERT_EQUAL_INT(KC_STAGE_COMPLETE, s_t.staging.state);
    TEST_ASSERT_EQUAL_UINT32(s_n, s_t.staging.n);
    expect_event(KC_EVT_TBL_STAGED, KC_TBL_SPACE, (double)s_n, 0.0);
    TEST_ASSERT_EQUAL_MEMORY(s_image, s_t.staging.image, s_n);
}

/* The first 1024 bytes of a SPACE image of total 3000. */
static void given_first_chunk(void)
{
    given_all_active();
    remember();
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_chunk(&s_t, KC_TBL_SPACE, 3000u, 0u, s_image, 1024u, &s_ev));
    TEST_ASSERT_EQUAL_INT(KC_STAGE_LOADING, s_t.staging.state);
}

static void expect_chunk_refused(kc_status_t want, uint16_t kind, uint32_t total, uint32_t at, uint32_t n)
{
    TEST_ASSERT_EQUAL_INT(want, kc_tbl_chunk(&s_t, kind, total, at, s_image, n, &s_ev));
    TEST_ASSERT_EQUAL_INT(KC_STAGE_NONE, s_t.staging.state);
    TEST_ASSERT_EQUAL_UINT32(0u, s_t.staging.n);
    expect_active_unchanged();
}

void test_a_chunk_that_does_not_continue_the_image_drops_it(void)
{
    static const struct {
        uint16_t kind;
        uint32_t total, at, n;
    } wrong[] = {
        {KC_TBL_SPACE, 3000u, 1025u, 100u}, /* leaves a gap */
        {KC_TBL_SPACE, 3000u, 1023u, 100u}, /* overlaps */
        {KC_TBL_ARM, 3000u, 1024u, 100u}, /* another kind */
        {KC_TBL_SPACE, 3001u, 1024u, 100u}, /* another total */
        {KC_TBL_SPACE, 1100u, 1024u, 77u}, /* past the end */
        {KC_TBL_SPACE, 3000u, 0xffffffffu, 2u}, /* past the end of what counts */
        {KC_TBL_SPACE, 3000u, 1024u, 0u}, /* empty */
        {KC_TBL_SPACE, 3000u, 0u, 1025u}, /* larger than a chunk */
    };
    for (size_t i = 0u; i < sizeof wrong / sizeof wrong[0]; i++) {
        given_first_chunk();
        forget_events();
        expect_chunk_refused(KC_ERR_FORMAT, wrong[i].kind, wrong[i].total, wrong[i].at, wrong[i].n);
        TEST_ASSERT_MESSAGE(event_at(&s_ev, KC_EVT_TBL_CHUNK) >= 0, "no TBL_CHUNK");
        if (i == 0u) { expect_event(KC_EVT_TBL_CHUNK, KC_TBL_SPACE, 1025.0, 1024.0); }
    }
}

void test_a_chunk_ends_within_the_image_wherever_it_begins(void)
{
    static const uint32_t cases[][4] = {/* total, at, n, fits */
                                        {1000u, 0u, 1000u, 1u}, {1000u, 0u, 1001u, 0u}, {1u, 0u, 1u, 1u},
                                        {1u, 0u, 2u, 0u},       {1024u, 0u, 1024u, 1u}, {0u, 0u, 1u, 0u},
                                        {3000u, 1024u, 1u, 1u}, {1024u, 1024u, 1u, 0u}};
    for (uint32_t i = 0u; i < sizeof cases / sizeof cases[0]; i++) {
        const uint32_t *c = cases[i];
        given_first_chunk();
        const kc_status_t st = kc_tbl_chunk(&s_t, KC_TBL_SPACE, c[0], c[1], s_image, c[2], &s_ev);
        TEST_ASSERT_EQUAL_INT(c[3] != 0u ? KC_OK : KC_ERR_FORMAT, st);
        TEST_ASSERT_EQUAL_UINT32(c[3] != 0u ? c[1] + c[2] : 0u, s_t.staging.n);
    }
    /* the second and last chunk: one byte too many */
    for (uint32_t more = 0u; more < 2u; more++) {
        forget_events();
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_chunk(&s_t, KC_TBL_SPACE, 1100u, 0u, s_image, 1024u, &s_ev));
        const kc_status_t st = kc_tbl_chunk(&s_t, KC_TBL_SPACE, 1100u, 1024u, s_image, 76u + more, &s_ev);
        TEST_ASSERT_EQUAL_INT(more == 0u ? KC_OK : KC_ERR_FORMAT, st);
        TEST_ASSERT_EQUAL_INT(more == 0u ? KC_STAGE_COMPLETE : KC_STAGE_NONE, s_t.staging.state);
    }
}

void test_a_repeated_chunk_drops_the_image(void)
{
    given_first_chunk();
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_chunk(&s_t, KC_TBL_SPACE, 3000u, 1024u, s_image, 1024u, &s_ev));
    expect_chunk_refused(KC_ERR_FORMAT, KC_TBL_SPACE, 3000u, 1024u, 1024u);
    expect_event(KC_EVT_TBL_CHUNK, KC_TBL_SPACE, 1024.0, 2048.0);
}

void test_a_continuation_without_a_start_is_refused(void)
{
    remember();
    expect_chunk_refused(KC_ERR_FORMAT, KC_TBL_SPACE, 3000u, 1024u, 100u);
    TEST_ASSERT_TRUE(event_at(&s_ev, KC_EVT_TBL_CHUNK) >= 0);
}

void test_an_image_larger_than_the_buffer_is_refused_as_full(void)
{
    given_first_chunk();
    expect_chunk_refused(KC_ERR_FULL, KC_TBL_SPACE, KC_IMAGE_MAX + 1u, 0u, 100u);
    expect_event(KC_EVT_TBL_FORMAT, 3, (double)KC_IMAGE_MAX + 1.0, (double)KC_IMAGE_MAX);
}

void test_a_chunk_of_an_unknown_kind_is_refused(void)
{
    given_first_chunk();
    expect_chunk_refused(KC_ERR_FORMAT, 0u, 3000u, 0u, 100u);
    expect_event(KC_EVT_TBL_FORMAT, 1, 0.0, 7.0);
}

void test_a_chunk_at_offset_zero_starts_over(void)
{
    given_first_chunk();
    given_staged(KC_TBL_KIN);
    TEST_ASSERT_EQUAL_INT(KC_STAGE_COMPLETE, s_t.staging.state);
    TEST_ASSERT_EQUAL_UINT16(KC_TBL_KIN, s_t.staging.kind);
}

void test_discard_empties_the_stage_and_says_so_once(void)
{
    given_staged(KC_TBL_ARM);
    remember();
    kc_tbl_discard(&s_t, &s_ev);
    expect_event(KC_EVT_TBL_DISCARDED, KC_TBL_ARM, 0.0, 0.0);
    TEST_ASSERT_EQUAL_INT(KC_STAGE_NONE, s_t.staging.state);
    TEST_ASSERT_EQUAL_UINT32(0u, s_t.staging.kind + s_t.staging.n +
                                     s_t.staging.total); /* as housekeeping has it */
    expect_active_unchanged();
    forget_events();
    kc_tbl_discard(&s_t, &s_ev);
    TEST_ASSERT_EQUAL_UINT32(0u, s_ev.n);
}

/* ---- refused images: wrong header, CRC, content ---- */

/* Stage s_image as `kind` and validate it: refused with `want`, and nothing changes. */
static void expect_image_refused(uint16_t kind, kc_status_t want, uint16_t id)
{
    remember();
    TEST_ASSERT_EQUAL_INT(KC_OK, stage(kind));
    forget_events();
    TEST_ASSERT_EQUAL_INT(want, kc_tbl_validate(&s_t, kind, image_crc(), &s_ev));
    TEST_ASSERT_MESSAGE(event_at(&s_ev, id) >= 0, kc_event_name(id));
    TEST_ASSERT_EQUAL_INT(KC_STAGE_COMPLETE, s_t.staging.state);
    expect_active_unchanged();
    /* and it can't be activated */
    forget_events();
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, kc_tbl_activate(&s_t, kind, image_crc(), &s_ev));
    expect_event(KC_EVT_TBL_NOT_READY, (int32_t)kind, 0.0, 0.0);
    expect_active_unchanged();
    /* its events once more, for the caller */
    forget_events();
    (void)kc_tbl_validate(&s_t, kind, image_crc(), &s_ev);
}

static void expect_table_refused(uint16_t kind, kc_status_t want, uint16_t id)
{
    s_n = given_image(kind, &s_table, s_image);
    expect_image_refused(kind, want, id);
}

void test_wrong_magic_is_refused(void)
{
    given_active(KC_TBL_ARM);
    given_image_of(KC_TBL_ARM);
    s_image[3] = '2';
    expect_image_refused(KC_TBL_ARM, KC_ERR_FORMAT, KC_EVT_TBL_FORMAT);
    expect_event(KC_EVT_TBL_FORMAT, 0, 0x3254434b, 0x3154434b); /* KCT2, KCT1 */
}

void test_an_image_of_another_kind_is_refused(void)
{
    given_active(KC_TBL_ARM);
    given_image_of(KC_TBL_CAMERA);
    expect_image_refused(KC_TBL_ARM, KC_ERR_FORMAT, KC_EVT_TBL_FORMAT);
    expect_event(KC_EVT_TBL_FORMAT, 1, KC_TBL_CAMERA, KC_TBL_ARM);
}

void test_wrong_version_is_refused(void)
{
    given_active(KC_TBL_ARM);
    given_image_of(KC_TBL_ARM);
    s_image[6] = 9u;
    expect_image_refused(KC_TBL_ARM, KC_ERR_FORMAT, KC_EVT_TBL_FORMAT);
    expect_event(KC_EVT_TBL_FORMAT, 2, 9.0, (double)kc_layout_version(KC_TBL_ARM));
}

/* Of an image that ends in all bytes of its size. */
void test_what_a_header_says_is_named_with_all_its_bytes(void)
{
    static const struct {
        uint32_t at, field;
        uint8_t bytes[4];
        uint32_t n;
        double got;
    } cases[] = {{0u, 0u, {0x11u, 0x22u, 0x33u, 0x44u}, 4u, 1144201745.0}, /* magic */
                 {4u, 1u, {0x01u, 0x02u}, 2u, 513.0},
                 {6u, 2u, {0x03u, 0x04u}, 2u, 1027.0},
                 {8u, 3u, {0x01u, 0x02u, 0x03u, 0x04u}, 4u, 67305985.0}};
    for (uint32_t i = 0u; i < sizeof cases / sizeof cases[0]; i++) {
        given_image_of(KC_TBL_ARM);
        TEST_ASSERT_EQUAL_HEX8(0u, s_image[10]);
        TEST_ASSERT_EQUAL_HEX8(0u, s_image[11]);
        memcpy(&s_image[cases[i].at], cases[i].bytes, cases[i].n);
        forget_events();
        TEST_ASSERT_EQUAL_INT(KC_ERR_FORMAT, kc_tbl_decode(KC_TBL_ARM, s_image, s_n, &s_scratch, &s_ev));
        TEST_ASSERT_EQUAL_UINT16(KC_EVT_TBL_FORMAT, s_ev.e[0].id);
        TEST_ASSERT_EQUAL_INT32((int32_t)cases[i].field, s_ev.e[0].index);
        TEST_ASSERT_EQUAL_DOUBLE(cases[i].got, s_ev.e[0].got);
    }
}

void test_each_kind_has_a_layout_version_of_its_own(void)
{
    for (uint16_t kind = 1u; kind < KC_TBL_COUNT; kind++) {
        TEST_ASSERT_GREATER_THAN(0, kc_layout_version(kind));
    }
    TEST_ASSERT_EQUAL_UINT16(0, kc_layout_version(0));
    TEST_ASSERT_EQUAL_UINT16(0, kc_layout_version(KC_TBL_COUNT));
    /* As docs/INTERFACES.md has them: images of before are told apart. */
    static const uint16_t version[KC_TBL_COUNT] = {
        [KC_TBL_ARM] = 1u,   [KC_TBL_CAMERA] = 2u, [KC_TBL_TERMS] = 1u, [KC_TBL_KIN] = 1u,
        [KC_TBL_SPACE] = 2u, [KC_TBL_KERNEL] = 1u, [KC_TBL_CONFIG] = 2u};
    for (uint16_t kind = 1u; kind < KC_TBL_COUNT; kind++) {
        TEST_ASSERT_EQUAL_UINT16(version[kind], kc_layout_version(kind));
    }
    /* Corrections that are stored on board today have to load in every later version of flight. */
    TEST_ASSERT_EQUAL_UINT16(1, kc_layout_version(KC_TBL_KIN));
}

void test_wrong_payload_size_is_refused(void)
{
    given_active(KC_TBL_ARM);
    given_image_of(KC_TBL_ARM);
    s_image[8]++;
    expect_image_refused(KC_TBL_ARM, KC_ERR_FORMAT, KC_EVT_TBL_FORMAT);
    expect_event(KC_EVT_TBL_FORMAT, 3, (double)(s_n - 16u + 1u), (double)(s_n - 16u));
}

void test_wrong_crc_is_refused(void)
{
    given_active(KC_TBL_ARM);
    given_image_of(KC_TBL_ARM);
    s_image[s_n - 1u] ^= 1u;
    expect_image_refused(KC_TBL_ARM, KC_ERR_CRC, KC_EVT_TBL_CRC);
}

void test_an_image_shorter_than_its_header_is_refused(void)
{
    TEST_ASSERT_EQUAL_INT(KC_ERR_FORMAT, kc_tbl_decode(KC_TBL_ARM, s_image, 15u, &s_back, &s_ev));
    expect_event(KC_EVT_TBL_FORMAT, 3, 15.0, 16.0);
}

void test_decoding_an_unknown_kind_is_refused(void)
{
    TEST_ASSERT_EQUAL_INT(KC_ERR_FORMAT, kc_tbl_decode(KC_TBL_COUNT, s_image, 16u, &s_back, &s_ev));
    expect_event(KC_EVT_TBL_FORMAT, 1, KC_TBL_COUNT, 7.0);
}

void test_an_image_with_bytes_too_many_is_refused(void)
{
    given_active(KC_TBL_ARM);
    given_image_of(KC_TBL_ARM);
    s_image[s_n++] = 0u;
    given_resealed(s_image, s_n);
    expect_image_refused(KC_TBL_ARM, KC_ERR_FORMAT, KC_EVT_TBL_FORMAT);
    expect_event(KC_EVT_TBL_FORMAT, 3, (double)s_n - 16.0, (double)s_n - 17.0);
}

void test_an_image_cut_short_is_refused_at_every_length(void)
{
    given_active(KC_TBL_ARM);
    for (uint16_t kind = 1u; kind < KC_TBL_COUNT; kind++) {
        uint32_t whole, step;
        given_image_of(kind);
        whole = s_n;
        step = 1u + whole / 97u;
        for (uint32_t n = KC_TBL_HDR_BYTES; n < whole; n += step) {
            kc_status_t st;
            forget_events();
            given_resealed(s_image, n);
            st = kc_tbl_decode(kind, s_image, n, &s_back, &s_ev);
            TEST_ASSERT_EQUAL_INT(KC_ERR_FORMAT, st);
            TEST_ASSERT_EQUAL_UINT16(KC_EVT_TBL_FORMAT, s_ev.e[0].id);
            given_image_of(kind);
        }
    }
}

void test_any_single_flipped_bit_is_refused(void)
{
    given_image_of(KC_TBL_KIN);
    for (uint32_t bit = 0u; bit < 8u * s_n; bit++) {
        s_image[bit / 8u] ^= (uint8_t)(1u << (bit % 8u));
        forget_events();
        TEST_ASSERT_NOT_EQUAL(KC_OK, kc_tbl_decode(KC_TBL_KIN, s_image, s_n, &s_back, &s_ev));
        TEST_ASSERT_EQUAL_UINT32(1u, s_ev.n);
        s_image[bit / 8u] ^= (uint8_t)(1u << (bit % 8u));
    }
}

void test_the_first_bad_value_is_named_and_all_are_counted(void)
{
    given_active(KC_TBL_ARM);
    given_table(KC_TBL_ARM);
    s_table.arm.joint[2].a_m = NAN;
    s_table.arm.joint[4].d_m = 99.0;
    s_table.arm.tool_quat_wxyz[0] = 1.1;
    expect_table_refused(KC_TBL_ARM, KC_ERR_RANGE, KC_EVT_TBL_NOT_FINITE);
    TEST_ASSERT_EQUAL_UINT32(2u, s_ev.n);
    TEST_ASSERT_EQUAL_INT32(2, s_ev.e[0].index);
    TEST_ASSERT_TRUE(isnan(s_ev.e[0].got));
    TEST_ASSERT_EQUAL_DOUBLE(7.0, s_ev.e[0].want);
    expect_event(KC_EVT_TBL_BAD_TOTAL, KC_TBL_ARM, 3.0, 0.0);
}

void test_a_quaternion_off_unit_norm_is_refused(void)
{
    given_active(KC_TBL_CAMERA);
    given_table(KC_TBL_CAMERA);
    s_table.camera.tag[1].quat_wxyz[0] *= 1.001;
    s_table.camera.tag[1].quat_wxyz[2] *= 1.001;
    expect_table_refused(KC_TBL_CAMERA, KC_ERR_RANGE, KC_EVT_TBL_NOT_UNIT);
}

/* Rules between fields that only the owner of a kind knows: the entry is named, and one is counted. */
void test_the_rules_of_a_kind_are_checked_after_its_fields(void)
{
    given_active(KC_TBL_ARM);
    given_table(KC_TBL_KERNEL);
    s_table.kernel.hyper[1].w[0] += 0.25; /* at rotation 0 the kernel is 1 */
    expect_table_refused(KC_TBL_KERNEL, KC_ERR_RANGE, KC_EVT_TBL_RANGE);
    TEST_ASSERT_EQUAL_INT32(1, s_ev.e[event_at(&s_ev, KC_EVT_TBL_RANGE)].index);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 1.25, s_ev.e[event_at(&s_ev, KC_EVT_TBL_RANGE)].got);
    expect_event(KC_EVT_TBL_BAD_TOTAL, KC_TBL_KERNEL, 1.0, 0.0);
    given_table(KC_TBL_TERMS);
    s_table.terms.term[3].basis[0].var = KC_VAR_Q;
    s_table.terms.term[3].basis[0].index = KC_JOINT_MAX + 1u;
    expect_table_refused(KC_TBL_TERMS, KC_ERR_RANGE, KC_EVT_TBL_RANGE);
    expect_event(KC_EVT_TBL_RANGE, 1003, KC_JOINT_MAX + 1.0, 0.0);
    expect_event(KC_EVT_TBL_BAD_TOTAL, KC_TBL_TERMS, 1.0, 0.0);
    given_table(KC_TBL_SPACE);
    s_table.space.initial[1] = s_table.space.initial[0];
    expect_table_refused(KC_TBL_SPACE, KC_ERR_RANGE, KC_EVT_TBL_RANGE);
    expect_event(KC_EVT_TBL_BAD_TOTAL, KC_TBL_SPACE, 1.0, 0.0);
}

void test_an_impossible_count_is_refused(void)
{
    given_active(KC_TBL_ARM);
    given_image_of(KC_TBL_ARM);
    s_image[KC_TBL_HDR_BYTES + KC_NAME_LEN] = 9u;
    given_resealed(s_image, s_n);
    expect_image_refused(KC_TBL_ARM, KC_ERR_RANGE, KC_EVT_TBL_RANGE);
}

/* ---- validation and activation ---- */

void test_a_good_image_is_validated_and_activated(void)
{
    given_staged(KC_TBL_ARM);
    remember();
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_validate(&s_t, KC_TBL_ARM, image_crc(), &s_ev));
    TEST_ASSERT_EQUAL_INT(KC_STAGE_VALID, s_t.staging.state);
    expect_active_unchanged();
    forget_events();
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_activate(&s_t, KC_TBL_ARM, image_crc(), &s_ev));
    expect_event(KC_EVT_TBL_ACTIVATED, KC_TBL_ARM, (double)image_crc(), 0.0);
    TEST_ASSERT_EQUAL_INT(KC_STAGE_NONE, s_t.staging.state);
    TEST_ASSERT_EQUAL_HEX32(image_crc(), s_t.active.crc[KC_TBL_ARM]);
    TEST_ASSERT_EQUAL_MEMORY(&s_table.arm, &s_t.active.arm, sizeof s_table.arm);
}

void test_every_kind_can_become_active(void)
{
    given_all_active();
    for (uint16_t kind = 1u; kind < KC_TBL_COUNT; kind++) {
        TEST_ASSERT_NOT_EQUAL(0u, s_t.active.crc[kind]);
        TEST_ASSERT_NOT_NULL(kc_tbl_active_ptr(&s_t.active, kind));
    }
    TEST_ASSERT_NULL(kc_tbl_active_ptr(&s_t.active, KC_TBL_COUNT));
}

void test_activation_survives_a_scratch_overwritten_in_between(void)
{
    given_staged(KC_TBL_ARM);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_validate(&s_t, KC_TBL_ARM, image_crc(), &s_ev));
    memset(&s_scratch, 0x5a, sizeof s_scratch); /* a calibration used the memory */
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_activate(&s_t, KC_TBL_ARM, image_crc(), &s_ev));
    TEST_ASSERT_EQUAL_MEMORY(&s_table.arm, &s_t.active.arm, sizeof s_table.arm);
}

void test_activation_without_validation_is_refused(void)
{
    given_staged(KC_TBL_ARM);
    remember();
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, kc_tbl_activate(&s_t, KC_TBL_ARM, image_crc(), &s_ev));
    expect_event(KC_EVT_TBL_NOT_READY, KC_TBL_ARM, 0.0, 0.0);
    TEST_ASSERT_EQUAL_INT(KC_STAGE_COMPLETE, s_t.staging.state);
    expect_active_unchanged();
}

void test_validation_of_nothing_is_refused(void)
{
    remember();
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, kc_tbl_validate(&s_t, KC_TBL_ARM, 1u, &s_ev));
    expect_event(KC_EVT_TBL_NOT_READY, KC_TBL_ARM, 0.0, 0.0);
    expect_active_unchanged();
}

void test_validation_naming_another_kind_is_refused(void)
{
    given_staged(KC_TBL_ARM);
    remember();
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, kc_tbl_validate(&s_t, KC_TBL_CAMERA, image_crc(), &s_ev));
    expect_event(KC_EVT_TBL_NOT_READY, KC_TBL_CAMERA, 0.0, 0.0);
    expect_active_unchanged();
}

void test_commands_naming_another_crc_are_refused(void)
{
    given_staged(KC_TBL_ARM);
    remember();
    TEST_ASSERT_EQUAL_INT(KC_ERR_CRC, kc_tbl_validate(&s_t, KC_TBL_ARM, image_crc() + 1u, &s_ev));
    expect_event(KC_EVT_CMD_CRC, KC_TBL_ARM, (double)image_crc() + 1.0, (double)image_crc());
    TEST_ASSERT_EQUAL_INT(KC_STAGE_COMPLETE, s_t.staging.state);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_validate(&s_t, KC_TBL_ARM, image_crc(), &s_ev));
    forget_events();
    TEST_ASSERT_EQUAL_INT(KC_ERR_CRC, kc_tbl_activate(&s_t, KC_TBL_ARM, image_crc() + 1u, &s_ev));
    TEST_ASSERT_EQUAL_INT(KC_STAGE_VALID, s_t.staging.state);
    expect_active_unchanged();
}

/* ---- dependencies ---- */

void test_terms_without_an_arm_are_refused(void)
{
    given_image_of(KC_TBL_TERMS);
    expect_image_refused(KC_TBL_TERMS, KC_ERR_STATE, KC_EVT_TBL_MISSING);
}

void test_terms_of_a_joint_the_arm_does_not_have_are_refused(void)
{
    given_active(KC_TBL_ARM);
    given_table(KC_TBL_TERMS);
    s_table.terms.term[27].frame = 8u;
    expect_table_refused(KC_TBL_TERMS, KC_ERR_RANGE, KC_EVT_TBL_RANGE);
    expect_event(KC_EVT_TBL_RANGE, 1027, 8.0, 0.0);
    expect_event(KC_EVT_TBL_BAD_TOTAL, KC_TBL_TERMS, 1.0, 0.0);
}

void test_terms_of_an_arm_with_the_same_joints_and_other_links_are_refused(void)
{
    /* given */
    given_active(KC_TBL_ARM);
    uint32_t mine = kc_arm_kinematics_crc(&s_t.active.arm);
    given_table(KC_TBL_TERMS);
    s_table.terms.kinematics_crc = mine ^ 1u;
    given_table_staged(KC_TBL_TERMS);
    /* when, then */
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, kc_tbl_validate(&s_t, KC_TBL_TERMS, image_crc(), &s_ev));
    expect_event(KC_EVT_TBL_ARM_DIFFERS, KC_TBL_TERMS, (double)(mine ^ 1u), (double)mine);
    TEST_ASSERT_EQUAL_HEX32(0u, s_t.active.crc[KC_TBL_TERMS]);
}

void test_terms_of_this_arm_are_accepted_and_read_back_with_its_crc(void)
{
    given_active(KC_TBL_ARM);
    given_table(KC_TBL_TERMS);
    s_table.terms.kinematics_crc = kc_arm_kinematics_crc(&s_t.active.arm);
    bring_in(KC_TBL_TERMS);
    TEST_ASSERT_EQUAL_HEX32(kc_arm_kinematics_crc(&s_t.active.arm), s_t.active.terms.kinematics_crc);
}

void test_another_arm_drops_the_terms_that_were_made_for_the_old_one(void)
{
    /* given */
    given_active(KC_TBL_ARM);
    given_table(KC_TBL_TERMS);
    s_table.terms.kinematics_crc = kc_arm_kinematics_crc(&s_t.active.arm);
    bring_in(KC_TBL_TERMS);
    given_table(KC_TBL_ARM);
    s_table.arm.joint[2].d_m += 0.01;
    forget_events();
    /* when */
    bring_in(KC_TBL_ARM);
    /* then */
    TEST_ASSERT_TRUE(event_at(&s_ev, KC_EVT_TBL_DROPPED) >= 0);
    TEST_ASSERT_EQUAL_HEX32(0u, s_t.active.crc[KC_TBL_TERMS]);
}

void test_a_space_of_another_arm_is_refused(void)
{
    given_active(KC_TBL_ARM);
    given_table(KC_TBL_SPACE);
    s_table.space.arm_crc ^= 1u;
    expect_table_refused(KC_TBL_SPACE, KC_ERR_STATE, KC_EVT_TBL_DEPENDS);
    expect_event(KC_EVT_TBL_DEPENDS, KC_TBL_SPACE, (double)s_table.space.arm_crc,
                 (double)s_t.active.crc[KC_TBL_ARM]);
}

void test_a_space_without_an_arm_is_refused(void)
{
    given_image_of(KC_TBL_SPACE);
    expect_image_refused(KC_TBL_SPACE, KC_ERR_STATE, KC_EVT_TBL_MISSING);
}

void test_a_space_with_a_seed_outside_the_limits_is_refused(void)
{
    given_active(KC_TBL_ARM);
    given_table(KC_TBL_SPACE);
    s_table.space.cand[4].q_seed[1] = 2.5f;
    expect_table_refused(KC_TBL_SPACE, KC_ERR_RANGE, KC_EVT_TBL_RANGE);
    expect_event(KC_EVT_TBL_RANGE, 4, 2.5, 0.0);
}

void test_a_correction_needs_arm_and_terms(void)
{
    given_image_of(KC_TBL_KIN);
    expect_image_refused(KC_TBL_KIN, KC_ERR_STATE, KC_EVT_TBL_MISSING);
    given_active(KC_TBL_ARM);
    given_image_of(KC_TBL_KIN);
    expect_image_refused(KC_TBL_KIN, KC_ERR_STATE, KC_EVT_TBL_MISSING);
}

void test_a_correction_with_another_number_of_coefficients_is_refused(void)
{
    given_all_active();
    given_table(KC_TBL_KIN);
    s_table.kin.n_coef = 27u;
    expect_table_refused(KC_TBL_KIN, KC_ERR_RANGE, KC_EVT_TBL_RANGE);
    expect_event(KC_EVT_TBL_RANGE, -1, 27.0, 1.0); /* field 1 */
    expect_event(KC_EVT_TBL_BAD_TOTAL, KC_TBL_KIN, 1.0, 0.0);
}

void test_a_correction_of_another_arm_or_of_other_terms_is_refused(void)
{
    given_all_active();
    given_correction(0.01);
    s_table.kin.arm_crc ^= 4u;
    expect_table_refused(KC_TBL_KIN, KC_ERR_STATE, KC_EVT_TBL_DEPENDS);
    given_correction(0.01);
    s_table.kin.terms_crc ^= 4u;
    expect_table_refused(KC_TBL_KIN, KC_ERR_STATE, KC_EVT_TBL_DEPENDS);
}

void test_a_correction_outside_its_bounds_is_refused(void)
{
    given_all_active();
    given_correction(0.01);
    s_table.kin.value[2] = 0.31; /* J1.a_m, bound 0.3 */
    s_table.kin.value[5] = -1.51; /* J2.alpha_rad, bound 1.5 */
    expect_table_refused(KC_TBL_KIN, KC_ERR_RANGE, KC_EVT_TBL_RANGE);
    expect_event(KC_EVT_TBL_RANGE, 2, 0.31, 2.0);
    expect_event(KC_EVT_TBL_BAD_TOTAL, KC_TBL_KIN, 2.0, 0.0);
}

void test_a_nominal_table_with_values_is_refused(void)
{
    given_all_active();
    given_table(KC_TBL_KIN);
    s_table.kin.value[3] = 1e-9;
    expect_table_refused(KC_TBL_KIN, KC_ERR_RANGE, KC_EVT_TBL_RANGE);
}

void test_a_correction_naming_only_one_table_is_refused(void)
{
    given_all_active();
    given_correction(0.0);
    s_table.kin.terms_crc = 0u;
    expect_table_refused(KC_TBL_KIN, KC_ERR_RANGE, KC_EVT_TBL_RANGE);
    expect_event(KC_EVT_TBL_RANGE, -1, 0.0, 5.0);
}

void test_a_dependency_lost_after_validation_stops_activation(void)
{
    given_all_active();
    given_correction(0.01);
    given_table_valid(KC_TBL_KIN);
    s_t.active.crc[KC_TBL_ARM] ^= 1u; /* as if another ARM table had been loaded meanwhile */
    remember();
    forget_events();
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, kc_tbl_activate(&s_t, KC_TBL_KIN, image_crc(), &s_ev));
    TEST_ASSERT_TRUE(event_at(&s_ev, KC_EVT_TBL_DEPENDS) >= 0);
    TEST_ASSERT_EQUAL_INT(KC_STAGE_COMPLETE, s_t.staging.state);
    expect_active_unchanged();
}

void test_terms_bring_a_nominal_correction_with_a_crc(void)
{
    given_active(KC_TBL_ARM);
    TEST_ASSERT_EQUAL_HEX32(0u, s_t.active.crc[KC_TBL_KIN]);
    given_active(KC_TBL_TERMS);
    given_image_of(KC_TBL_KIN);
    TEST_ASSERT_EQUAL_HEX32(image_crc(), s_t.active.crc[KC_TBL_KIN]);
    TEST_ASSERT_EQUAL_MEMORY(&s_table.kin, &s_t.active.kin, sizeof s_table.kin);
    TEST_ASSERT_EQUAL_HEX32(0u, s_t.active.kin_prev_crc);
}

/* ---- what another ARM table drops ---- */

static void given_another_arm(uint32_t n_joints)
{
    given_table(KC_TBL_ARM);
    s_table.arm.n_joints = n_joints;
    s_table.arm.joint[0].d_m = 0.001;
}

void test_another_arm_drops_space_and_correction(void)
{
    uint32_t old_arm, new_arm;
    given_all_active();
    given_correction(0.01);
    bring_in(KC_TBL_KIN);
    old_arm = s_t.active.crc[KC_TBL_ARM];
    forget_events();
    given_another_arm(7u);
    bring_in(KC_TBL_ARM);
    new_arm = s_t.active.crc[KC_TBL_ARM];
    TEST_ASSERT_NOT_EQUAL(old_arm, new_arm);
    TEST_ASSERT_EQUAL_HEX32(0u, s_t.active.crc[KC_TBL_SPACE]);
    TEST_ASSERT_EQUAL_UINT32(0u, s_t.active.space.n_cand);
    TEST_ASSERT_EQUAL_UINT32(28u, s_t.active.kin.n_coef); /* nominal */
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_t.active.kin.value[0]);
    TEST_ASSERT_NOT_EQUAL(0u, s_t.active.crc[KC_TBL_KIN]);
    TEST_ASSERT_NOT_EQUAL(0u, s_t.active.crc[KC_TBL_TERMS]); /* seven joints: they still fit */
    TEST_ASSERT_EQUAL_UINT32(4u, s_ev.n); /* staged, activated, and the two dropped */
    TEST_ASSERT_EQUAL_UINT16(KC_EVT_TBL_DROPPED, s_ev.e[2].id);
    TEST_ASSERT_EQUAL_INT32(KC_TBL_SPACE, s_ev.e[2].index);
    TEST_ASSERT_EQUAL_DOUBLE((double)old_arm, s_ev.e[2].got);
    TEST_ASSERT_EQUAL_DOUBLE((double)new_arm, s_ev.e[2].want);
    TEST_ASSERT_EQUAL_UINT16(KC_EVT_TBL_DROPPED, s_ev.e[3].id);
    TEST_ASSERT_EQUAL_INT32(KC_TBL_KIN, s_ev.e[3].index);
}

/* Neither terms nor a space nor a correction have been there. */
void test_another_arm_drops_nothing_that_is_not_there(void)
{
    given_active(KC_TBL_ARM);
    given_another_arm(6u);
    bring_in(KC_TBL_ARM);
    TEST_ASSERT_EQUAL_UINT32(2u, s_ev.n); /* staged, activated */
    for (uint16_t kind = KC_TBL_ARM + 1u; kind < KC_TBL_COUNT; kind++) {
        TEST_ASSERT_EQUAL_HEX32(0u, s_t.active.crc[kind]);
    }
}

void test_the_same_arm_again_drops_nothing(void)
{
    given_all_active();
    remember();
    given_table(KC_TBL_ARM);
    bring_in(KC_TBL_ARM);
    expect_active_unchanged();
    TEST_ASSERT_TRUE(event_at(&s_ev, KC_EVT_TBL_DROPPED) < 0);
}

void test_an_arm_with_fewer_joints_drops_the_terms_too(void)
{
    given_all_active();
    given_another_arm(6u);
    bring_in(KC_TBL_ARM);
    TEST_ASSERT_EQUAL_HEX32(0u, s_t.active.crc[KC_TBL_TERMS]);
    TEST_ASSERT_EQUAL_HEX32(0u, s_t.active.crc[KC_TBL_SPACE]);
    TEST_ASSERT_EQUAL_HEX32(0u, s_t.active.crc[KC_TBL_KIN]);
    TEST_ASSERT_EQUAL_UINT32(0u, s_t.active.kin.n_coef);
    TEST_ASSERT_EQUAL_UINT32(0u, s_t.active.terms.n_coef);
}

void test_other_terms_drop_the_correction_and_its_previous_one(void)
{
    given_all_active();
    given_correction(0.01);
    bring_in(KC_TBL_KIN);
    given_correction(0.02);
    bring_in(KC_TBL_KIN);
    TEST_ASSERT_NOT_EQUAL(0u, s_t.active.kin_prev_crc);
    forget_events();
    remember();
    given_table(KC_TBL_TERMS);
    s_table.terms.coef[0].ub = 1.4;
    bring_in(KC_TBL_TERMS);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_t.active.kin.value[0]);
    TEST_ASSERT_EQUAL_HEX32(0u, s_t.active.kin.arm_crc);
    TEST_ASSERT_EQUAL_HEX32(0u, s_t.active.kin_prev_crc);
    static const kc_kin_t none;
    TEST_ASSERT_EQUAL_MEMORY(&none, &s_t.active.kin_prev, sizeof none);
    expect_event(KC_EVT_TBL_DROPPED, KC_TBL_KIN, (double)s_before.active.crc[KC_TBL_TERMS],
                 (double)s_t.active.crc[KC_TBL_TERMS]);
}

void test_terms_with_fewer_coefficients_replace_the_nominal_table_quietly(void)
{
    given_all_active();
    given_table(KC_TBL_TERMS);
    s_table.terms.n_coef = 4u;
    s_table.terms.n_term = 4u;
    bring_in(KC_TBL_TERMS);
    TEST_ASSERT_EQUAL_UINT32(4u, s_t.active.kin.n_coef);
    TEST_ASSERT_TRUE(event_at(&s_ev, KC_EVT_TBL_DROPPED) < 0);
}

/* ---- the correction in force, and the one before ---- */

void test_a_new_correction_keeps_the_one_before(void)
{
    uint32_t nominal;
    given_all_active();
    nominal = s_t.active.crc[KC_TBL_KIN];
    given_correction(0.01);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_set_kin(&s_t, &s_table.kin, &s_ev));
    s_n = given_image(KC_TBL_KIN, &s_table, s_image);
    TEST_ASSERT_EQUAL_HEX32(image_crc(), s_t.active.crc[KC_TBL_KIN]);
    TEST_ASSERT_EQUAL_HEX32(nominal, s_t.active.kin_prev_crc);
    TEST_ASSERT_EQUAL_DOUBLE(0.01, s_t.active.kin.value[7]);
    expect_event(KC_EVT_TBL_ACTIVATED, KC_TBL_KIN, (double)image_crc(), 0.0);
}

void test_where_no_correction_was_the_one_for_rollback_stays(void)
{
    given_all_active();
    s_t.active.crc[KC_TBL_KIN] = 0u;
    s_t.active.kin_prev_crc = 0x77u;
    given_correction(0.01);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_set_kin(&s_t, &s_table.kin, &s_ev));
    TEST_ASSERT_EQUAL_HEX32(0x77u, s_t.active.kin_prev_crc);
}

void test_a_correction_that_does_not_fit_is_not_set(void)
{
    given_all_active();
    remember();
    given_correction(2.0);
    TEST_ASSERT_EQUAL_INT(KC_ERR_RANGE, kc_tbl_set_kin(&s_t, &s_table.kin, &s_ev));
    TEST_ASSERT_TRUE(event_at(&s_ev, KC_EVT_TBL_RANGE) >= 0);
    expect_active_unchanged();
}

void test_rollback_brings_the_one_before_back_once(void)
{
    uint32_t first;
    given_all_active();
    given_correction(0.01);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_set_kin(&s_t, &s_table.kin, &s_ev));
    first = s_t.active.crc[KC_TBL_KIN];
    given_correction(0.02);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_set_kin(&s_t, &s_table.kin, &s_ev));
    forget_events();
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_rollback(&s_t, &s_ev));
    expect_event(KC_EVT_COR_ROLLBACK, -1, (double)first, 0.0);
    TEST_ASSERT_EQUAL_HEX32(first, s_t.active.crc[KC_TBL_KIN]);
    TEST_ASSERT_EQUAL_DOUBLE(0.01, s_t.active.kin.value[0]);
    remember();
    forget_events();
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, kc_tbl_rollback(&s_t, &s_ev));
    expect_event(KC_EVT_COR_NO_PREVIOUS, -1, 0.0, 0.0);
    expect_active_unchanged();
}

/* ---- bounds: what TERMS can describe is what SPACE was verified for ---- */

/* Compliance of joint 4, on top of the DH errors. */
static void given_compliance(double bound)
{
    kc_terms_t *t = &s_table.terms;
    kc_coef_t *c = &t->coef[t->n_coef];
    memcpy(c->name, "compliance", 11u);
    c->lb = -bound;
    c->ub = bound;
    c->scale = 1e-3;
    c->enabled = 1u;
    t->term[t->n_term] = (kc_term_t){.coef = (uint16_t)t->n_coef, .frame = 3u, .comp = KC_RZ, .gain = 1.0};
    t->term[t->n_term].basis[0] = (kc_basis_t){KC_FN_LIN, KC_VAR_TAU, 4u, 0.0, 1.0};
    t->n_coef++;
    t->n_term++;
}

static void expect_refused(uint16_t kind, uint16_t id, int32_t coef, double sum, double verified_for)
{
    given_table_staged(kind);
    remember();
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, kc_tbl_validate(&s_t, kind, image_crc(), &s_ev));
    expect_event(id, coef, sum, verified_for);
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, kc_tbl_load(&s_t, kind, s_image, s_n, &s_ev));
    expect_active_unchanged();
}

void test_terms_more_than_a_tenth_wider_than_the_space_are_refused(void)
{
    given_all_active();
    given_table(KC_TBL_TERMS);
    s_table.terms.coef[12].ub = 1.66; /* J4.phi_rad; verified for 1.5 */
    expect_refused(KC_TBL_TERMS, KC_EVT_TBL_TERMS_WIDE, 12, 1.66, 1.5);
    given_table(KC_TBL_TERMS);
    s_table.terms.coef[12].lb = -1.66;
    expect_refused(KC_TBL_TERMS, KC_EVT_TBL_TERMS_WIDE, 12, 1.66, 1.5);
    given_table(KC_TBL_TERMS);
    s_table.terms.coef[12].ub = 1.65; /* a tenth */
    bring_in(KC_TBL_TERMS);
}

void test_a_space_verified_for_less_than_the_active_terms_is_refused(void)
{
    given_all_active();
    given_table(KC_TBL_SPACE);
    s_table.space.verified[2].d_m = 0.27; /* J3.d_m is within 0.3 */
    expect_refused(KC_TBL_SPACE, KC_EVT_TBL_SPACE_NARROW, 11, 0.3, 0.27);
    given_table(KC_TBL_SPACE);
    s_table.space.verified[2].d_m = 0.28;
    bring_in(KC_TBL_SPACE);
    s_t.active.crc[KC_TBL_TERMS] = 0u; /* what stands there without a CRC is no table */
    given_table(KC_TBL_SPACE);
    s_table.space.verified[2].d_m = 0.27;
    bring_in(KC_TBL_SPACE);
}

void test_stored_terms_and_a_space_that_do_not_belong_together_are_not_both_loaded(void)
{
    given_active(KC_TBL_ARM);
    given_table(KC_TBL_TERMS);
    s_table.terms.coef[12].ub = 1.66;
    bring_in(KC_TBL_TERMS); /* there is no space yet */
    given_table(KC_TBL_SPACE);
    expect_refused(KC_TBL_SPACE, KC_EVT_TBL_SPACE_NARROW, 12, 1.66, 1.5);
    /* and the other way round */
    given_active(KC_TBL_TERMS);
    given_active(KC_TBL_SPACE);
    given_table(KC_TBL_TERMS);
    s_table.terms.coef[12].ub = 1.66;
    expect_refused(KC_TBL_TERMS, KC_EVT_TBL_TERMS_WIDE, 12, 1.66, 1.5);
}

void test_a_space_that_came_after_validation_stops_activation_of_wide_terms(void)
{
    given_active(KC_TBL_ARM);
    given_table(KC_TBL_SPACE);
    uint32_t n = given_image(KC_TBL_SPACE, &s_table, s_window);
    given_table(KC_TBL_TERMS);
    s_table.terms.coef[0].lb = -1.7;
    given_table_valid(KC_TBL_TERMS);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_load(&s_t, KC_TBL_SPACE, s_window, n, &s_ev));
    forget_events();
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, kc_tbl_activate(&s_t, KC_TBL_TERMS, image_crc(), &s_ev));
    expect_event(KC_EVT_TBL_TERMS_WIDE, 0, 1.7, 1.5);
}

void test_an_effect_beside_dh_errors_at_their_full_bounds_is_refused(void)
{
    given_all_active();
    given_table(KC_TBL_TERMS);
    s_table.terms.coef[12].lb = -1.65;
    given_compliance(1e-3);
    given_table_staged(KC_TBL_TERMS);
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, kc_tbl_validate(&s_t, KC_TBL_TERMS, image_crc(), &s_ev));
    TEST_ASSERT_EQUAL_INT32(28, s_ev.e[event_at(&s_ev, KC_EVT_TBL_TERMS_WIDE)].index);
    given_table(KC_TBL_TERMS);
    given_compliance(1e-3); /* beside a DH error of 1.5 */
    bring_in(KC_TBL_TERMS);
}

/* A space of before says nothing about the errors that it was verified for. */
void test_a_space_of_the_former_layout_is_refused_by_its_version(void)
{
    given_active(KC_TBL_ARM);
    given_image_of(KC_TBL_SPACE);
    s_n -= 7u * 4u * 8u;
    given_resealed(s_image, s_n);
    s_image[6] = 1u;
    TEST_ASSERT_EQUAL_INT(KC_ERR_FORMAT, kc_tbl_load(&s_t, KC_TBL_SPACE, s_image, s_n, &s_ev));
    expect_event(KC_EVT_TBL_FORMAT, 2, 1.0, 2.0);
}

/* ---- boot ---- */

void test_stored_images_load_in_order_of_kinds(void)
{
    for (uint16_t kind = 1u; kind < KC_TBL_COUNT; kind++) {
        given_image_of(kind);
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_load(&s_t, kind, s_image, s_n, &s_ev));
        TEST_ASSERT_EQUAL_HEX32(image_crc(), s_t.active.crc[kind]);
    }
    TEST_ASSERT_EQUAL_HEX32(0u, s_t.active.kin_prev_crc);
    TEST_ASSERT_EQUAL_INT(KC_STAGE_NONE, s_t.staging.state);
}

void test_a_damaged_stored_image_changes_nothing(void)
{
    given_all_active();
    given_image_of(KC_TBL_CONFIG);
    s_image[40] ^= 0x10u;
    remember();
    TEST_ASSERT_EQUAL_INT(KC_ERR_CRC, kc_tbl_load(&s_t, KC_TBL_CONFIG, s_image, s_n, &s_ev));
    TEST_ASSERT_TRUE(event_at(&s_ev, KC_EVT_TBL_CRC) >= 0);
    expect_active_unchanged();
}

void test_a_stored_correction_of_another_arm_is_not_loaded(void)
{
    given_all_active();
    given_correction(0.01);
    s_table.kin.arm_crc ^= 1u;
    s_n = given_image(KC_TBL_KIN, &s_table, s_image);
    remember();
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, kc_tbl_load(&s_t, KC_TBL_KIN, s_image, s_n, &s_ev));
    TEST_ASSERT_TRUE(event_at(&s_ev, KC_EVT_TBL_DEPENDS) >= 0);
    expect_active_unchanged();
}

void test_the_previous_correction_is_loaded_for_rollback(void)
{
    given_all_active();
    given_correction(0.03);
    s_n = given_image(KC_TBL_KIN, &s_table, s_image);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_load_prev(&s_t, s_image, s_n, &s_ev));
    TEST_ASSERT_EQUAL_HEX32(image_crc(), s_t.active.kin_prev_crc);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_tbl_rollback(&s_t, &s_ev));
    TEST_ASSERT_EQUAL_DOUBLE(0.03, s_t.active.kin.value[0]);
}

void test_a_previous_correction_that_does_not_fit_is_refused(void)
{
    given_all_active();
    given_correction(0.03);
    s_table.kin.terms_crc ^= 1u;
    s_n = given_image(KC_TBL_KIN, &s_table, s_image);
    remember();
    TEST_ASSERT_EQUAL_INT(KC_ERR_STATE, kc_tbl_load_prev(&s_t, s_image, s_n, &s_ev));
    expect_active_unchanged();
    s_image[20] ^= 1u;
    TEST_ASSERT_EQUAL_INT(KC_ERR_CRC, kc_tbl_load_prev(&s_t, s_image, s_n, &s_ev));
    expect_active_unchanged();
}

void test_the_same_terms_again_keep_the_correction(void)
{
    given_all_active();
    given_correction(0.01);
    bring_in(KC_TBL_KIN);
    given_correction(0.02);
    bring_in(KC_TBL_KIN);
    remember();
    given_table(KC_TBL_TERMS);
    bring_in(KC_TBL_TERMS);
    expect_active_unchanged();
    TEST_ASSERT_TRUE(event_at(&s_ev, KC_EVT_TBL_DROPPED) < 0);
}

void test_another_arm_drops_a_correction_although_the_terms_are_the_same(void)
{
    given_all_active();
    given_correction(0.01);
    bring_in(KC_TBL_KIN);
    given_another_arm(7u);
    bring_in(KC_TBL_ARM);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_t.active.kin.value[0]);
}

/* A flipped bit took the ARM table out of force (kc_scrub.c); the ground uploads it again. */
void test_an_arm_that_comes_back_finds_its_search_space(void)
{
    given_all_active();
    uint32_t space = s_t.active.crc[KC_TBL_SPACE];
    s_t.active.crc[KC_TBL_ARM] = 0u;
    given_table(KC_TBL_ARM);
    bring_in(KC_TBL_ARM);
    TEST_ASSERT_EQUAL_HEX32(space, s_t.active.crc[KC_TBL_SPACE]);
    TEST_ASSERT_TRUE(event_at(&s_ev, KC_EVT_TBL_DROPPED) < 0);
}

void test_no_table_has_the_number_zero_or_one_beyond_the_last(void)
{
    TEST_ASSERT_NULL(kc_tbl_active_ptr(&s_t.active, 0u));
    TEST_ASSERT_NULL(kc_tbl_active_ptr(&s_t.active, KC_TBL_COUNT));
    TEST_ASSERT_EQUAL_PTR(&s_t.active.arm, kc_tbl_active_ptr(&s_t.active, KC_TBL_ARM));
}
