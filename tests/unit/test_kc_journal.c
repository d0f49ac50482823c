/* kc_journal.c: when a record is stored. Records on their way through the store: test_journal.c. */
#include "kc_journal.h"

#include <string.h>

#include "unity.h"

void test_a_change_of_any_field_is_stored_and_the_passing_of_time_is_not(void)
{
    static kc_journal_store_t j;
    static kc_out_t out;
    kc_journal_t now = {.state = 7u, .session = 1u};
    memset(&j, 0, sizeof j);
    j.last = now;
    for (uint32_t field = 0u; field <= 15u; field++) {
        switch (field) {
        case 0u: now.t_us += 5u; break;
        case 1u: now.state++; break;
        case 2u: now.session++; break;
        case 3u: now.pose++; break;
        case 4u: now.boot_count++; break;
        case 5u: now.kin_crc++; break;
        case 6u: now.prev_crc++; break;
        case 7u: now.proposal_crc++; break;
        case 8u: now.candidate++; break;
        case 9u: now.seg_from++; break;
        case 10u: now.seg_to++; break;
        case 11u: now.counters.key[1].key_id++; break;
        case 12u: now.counters.key[1].since_us++; break;
        case 13u: now.counters.key[1].last[1][1]++; break;
        case 14u: now.counters.key[0].last[0][0]++; break;
        default: break; /* nothing */
        }
        out.n_store = 0u;
        kc_journal_note(&j, &now, 0u, &out);
        TEST_ASSERT_EQUAL_UINT32(field >= 1u && field <= 14u ? 1u : 0u, out.n_store);
        bool twice = (field >= 5u && field <= 7u) || (field >= 11u && field <= 14u); /* names and counters */
        TEST_ASSERT_EQUAL_INT(twice, j.again);
        j.again = false;
    }
}
