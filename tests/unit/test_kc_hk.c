/* kc_hk.c: what is counted, and when the next report is due. */
#include "kc_hk.h"

#include "given_parts.h"
#include "unity.h"

static kc_hk_state_t s_counts;

void setUp(void)
{
    given_parts();
    s_counts = (kc_hk_state_t){.seq = 40};
}

void test_a_report_is_due_each_second_after_the_one_before(void)
{
    TEST_ASSERT_TRUE(kc_hk_count(&s_counts, 500000u, &parts.out));
    TEST_ASSERT_FALSE(kc_hk_count(&s_counts, 1499999u, &parts.out));
    TEST_ASSERT_TRUE(kc_hk_count(&s_counts, 1500000u, &parts.out));
    TEST_ASSERT_FALSE(kc_hk_count(&s_counts, 2499999u, &parts.out));
}

void test_it_says_what_all_steps_have_brought(void)
{
    kc_hk_t hk = {0};
    for (uint32_t i = 0u; i < 3u; i++) {
        parts.out.has_meas = i != 1u;
        parts.out.events.n = 2u * (i < 2u);
        parts.out.events.dropped = i;
        parts.out.events.e[1].id = (uint16_t)(100u + i);
        (void)kc_hk_count(&s_counts, 0u, &parts.out);
    }
    kc_hk_fill(&s_counts, &hk);
    const int32_t got[] = {hk.seq, (int32_t)hk.n_meas, (int32_t)hk.n_events, (int32_t)hk.n_events_dropped,
                           hk.last_event_id};
    const int32_t want[] = {41, 2, 4, 3, 101};
    TEST_ASSERT_EQUAL_INT32_ARRAY(want, got, 5u);
}
