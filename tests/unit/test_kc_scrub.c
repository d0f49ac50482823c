/* kc_scrub.c: memory that changes by itself is found and named; what is put in its place is no fault. */
#include "kc_scrub.h"

#include <string.h>

#include "given_parts.h"
#include "unity.h"

#define PARTS_N 9u /* kin_prev, seven tables, observations */

static kc_scrub_t s_scrub;
static kc_active_t *s_tables;

void setUp(void)
{
    given_parts();
    s_tables = &parts.tables.active;
    s_tables->kin_prev_crc = PARTS_CRC;
    parts.est.n_obs = 3u;
    memset(&s_scrub, 0, sizeof s_scrub);
}

static kc_outcome_t run(void) { return kc_scrub_run(&s_scrub, &parts.tables, &parts.est, &parts.out.events); }

/* All parts once; the outcome that was not STAY, if there was one. */
static kc_outcome_t round_of_parts(void)
{
    kc_outcome_t found = kc_outcome(KC_OC_STAY);
    for (uint32_t n = 0u; n < PARTS_N;) {
        uint32_t part = s_scrub.part;
        kc_outcome_t oc = run();
        if (oc.id != KC_OC_STAY) { found = oc; }
        n += s_scrub.part != part;
    }
    return found;
}

static void expect_found(void)
{
    kc_outcome_t oc = round_of_parts();
    TEST_ASSERT_EQUAL_INT(KC_OC_ABORT, oc.id);
    TEST_ASSERT_EQUAL_INT(KC_CAUSE_MEMORY, oc.cause);
}

static void expect_nothing(void)
{
    for (uint32_t i = 0u; i < 2u; i++) { TEST_ASSERT_EQUAL_INT(KC_OC_STAY, round_of_parts().id); }
    TEST_ASSERT_EQUAL_UINT32(0u, parts.out.events.n);
}

void test_all_of_the_memory_is_looked_at_slice_by_slice(void)
{
    uint32_t steps = 0u, slices = 1u; /* and observations */
    for (uint16_t kind = 0u; kind < KC_TBL_COUNT; kind++) {
        slices += (kc_tbl_active_bytes(kind) + KC_SCRUB_BYTES - 1u) / KC_SCRUB_BYTES;
    }
    TEST_ASSERT_TRUE(3u * sizeof(kc_obs_t) <= KC_SCRUB_BYTES);
    do {
        (void)run();
    } while (++steps < 1000u && (s_scrub.part != 0u || s_scrub.at != 0u));
    TEST_ASSERT_EQUAL_UINT32(slices, steps);
    expect_nothing();
}

void test_any_changed_byte_of_a_table_is_found_and_the_table_no_longer_in_force(void)
{
    for (uint16_t kind = 0u; kind < KC_TBL_COUNT; kind++) {
        uint32_t n = kc_tbl_active_bytes(kind),
                 *crc = kind == 0u ? &s_tables->kin_prev_crc : &s_tables->crc[kind];
        uint8_t *at = kind == 0u ? (uint8_t *)&s_tables->kin_prev
                                 : (uint8_t *)kc_tbl_active_ptr(s_tables, kind);
        for (uint32_t k = 0u; k < 3u; k++) { /* first, middle, last */
            setUp();
            at[k * (n - 1u) / 2u] ^= 4u;
            expect_found();
            expect_event(KC_EVT_MEMORY_TABLE, kind == 0u ? (int32_t)KC_STORE_PREV : (int32_t)kind,
                         (double)(PARTS_CRC + kind), 0.0);
            TEST_ASSERT_EQUAL_UINT32(0u, *crc);
            TEST_ASSERT_EQUAL_HEX32(1u << kind, s_scrub.lost);
            expect_nothing(); /* what is not in force is not looked at */
        }
    }
}

void test_a_changed_observation_is_found_once(void)
{
    (void)round_of_parts();
    ((uint8_t *)&parts.est.obs[2])[sizeof(kc_obs_t) - 1u] ^= 1u;
    expect_found();
    expect_event(KC_EVT_MEMORY_OBSERVATIONS, -1, 3.0, 0.0);
    expect_nothing();
}

void test_observations_that_come_or_are_dropped_are_no_fault(void)
{
    (void)round_of_parts();
    parts.est.obs[3].p_m[0] = 1.0;
    parts.est.n_obs = 4u;
    expect_nothing();
    parts.est.n_obs = 0u; /* another calibration */
    expect_nothing();
    parts.est.obs[0].p_m[0] = 2.0;
    parts.est.n_obs = 1u;
    expect_nothing();
}

void test_a_table_that_is_replaced_while_it_is_compared_is_no_fault(void)
{
    while (s_scrub.part != KC_TBL_SPACE || s_scrub.at == 0u) { (void)run(); }
    s_tables->space.n_initial = 1u;
    given_seal(s_tables, KC_TBL_SPACE);
    expect_nothing();
}
