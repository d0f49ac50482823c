/* kc_wire.c: every field between messages and structs, each with a value of its own. */
#include <string.h>

#include "kc_verdict.h"
#include "kc_wire.h"
#include "unity.h"

/* Fill an object with bytes that make small, different doubles and integers. */
static void fill(double *v, uint32_t n, double from)
{
    for (uint32_t i = 0u; i < n; i++) { v[i] = from + (double)i; }
}

void test_commands_keep_every_argument(void)
{
    kcm_cmd_t m = {1, 2, 3, 4, {5, 6, 7, -8}, -1, {1.5, 2.5, 3.5, 4.5}, 7, -2, {0x0807060504030201, -2}};
    kc_cmd_t c;
    kc_wire_cmd(&m, &c);
    TEST_ASSERT_EQUAL_UINT64(1u, c.t_us);
    TEST_ASSERT_EQUAL_UINT32(7u, c.auth.key_id);
    TEST_ASSERT_EQUAL_UINT64(UINT64_MAX - 1u, c.auth.counter);
    TEST_ASSERT_EQUAL_MEMORY("\1\2\3\4\5\6\7\10\376\377\377\377\377\377\377\377", c.auth.mac, KC_MAC_BYTES);
    TEST_ASSERT_EQUAL_INT(2, c.seq);
    TEST_ASSERT_EQUAL_INT(3, c.source);
    TEST_ASSERT_EQUAL_INT(4, c.opcode);
    TEST_ASSERT_EQUAL_INT(-8, c.arg_i[3]);
    TEST_ASSERT_EQUAL_UINT64(UINT64_MAX, c.arg_u64); /* all 64 coefficients */
    TEST_ASSERT_EQUAL_DOUBLE(4.5, c.arg_d[3]);
}

void test_negative_sizes_of_a_chunk_become_too_large(void)
{
    static kcm_table_chunk_t m;
    static kc_table_chunk_t c;
    m.kind = 5;
    m.total_bytes = -1;
    m.offset = -1024;
    m.n = -5;
    m.data[1023] = 77u;
    m.t_us = 3;
    m.source = 2;
    m.key_id = 8;
    m.counter = 9;
    m.mac[1] = 10;
    kc_wire_table_up(&m, &c);
    TEST_ASSERT_EQUAL_UINT64(3u, c.t_us);
    TEST_ASSERT_EQUAL_INT(2, c.source);
    TEST_ASSERT_EQUAL_UINT32(8u, c.auth.key_id);
    TEST_ASSERT_EQUAL_UINT64(9u, c.auth.counter);
    TEST_ASSERT_EQUAL_UINT8(10u, c.auth.mac[8]);
    TEST_ASSERT_EQUAL_INT(5, c.kind);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, c.total);
    TEST_ASSERT_TRUE(c.offset > KC_IMAGE_MAX && c.n > KC_CHUNK_BYTES);
    TEST_ASSERT_EQUAL_UINT8(77u, c.data[1023]);
}

void test_arm_and_pantilt_states_keep_every_reading(void)
{
    kcm_arm_state_t m;
    kc_arm_state_t s = {.fault_mask = 4};
    kcm_pantilt_state_t hm = {10, 11, 0.1, 0.2, 1};
    kc_pantilt_state_t h;
    memset(&m, 0, sizeof m);
    m.t_us = 5;
    m.seq = 6;
    m.n_joints = 7;
    fill(m.q_rad, 8u, 1.0);
    fill(m.dq_rad_s, 8u, 11.0);
    fill(m.q_cmd_rad, 8u, 21.0);
    m.dir[2] = -1;
    m.moving = 1;
    m.fault_mask = 9;
    m.temp_c = -30.0;
    m.payload_kg = 0.5;
    fill(m.g_m_s2, 3u, 31.0);
    kc_wire_arm_state(&m, &s);
    TEST_ASSERT_EQUAL_UINT64(5u, s.t_us);
    TEST_ASSERT_EQUAL_UINT32(7u, s.n_joints);
    TEST_ASSERT_EQUAL_DOUBLE(8.0, s.q[7]);
    TEST_ASSERT_EQUAL_DOUBLE(18.0, s.dq[7]);
    TEST_ASSERT_EQUAL_DOUBLE(28.0, s.q_cmd[7]);
    TEST_ASSERT_EQUAL_DOUBLE(-1.0, s.dir[2]);
    TEST_ASSERT_EQUAL_INT(1, s.moving);
    TEST_ASSERT_EQUAL_INT(9 | 4, s.fault_mask); /* one of an earlier state of the step stays */
    TEST_ASSERT_EQUAL_DOUBLE(-30.0, s.temp_c);
    TEST_ASSERT_EQUAL_DOUBLE(33.0, s.g_m_s2[2]);
    kc_wire_pantilt_state(&hm, &h);
    TEST_ASSERT_EQUAL_UINT64(10u, h.t_us);
    TEST_ASSERT_EQUAL_INT(11, h.seq);
    TEST_ASSERT_EQUAL_DOUBLE(0.2, h.tilt_rad);
    TEST_ASSERT_EQUAL_INT(1, h.moving);
}

void test_a_detection_unpacks_its_covariance(void)
{
    static kcm_detection_t m;
    static kc_detection_t d;
    fill(m.cov, 21u, 0.0);
    fill(m.corner_px, 32u, 100.0);
    m.n_tags = -1;
    m.tag_id[3] = 4;
    m.p_alt_m[2] = 0.3;
    m.rms_alt_px = 0.7;
    m.v_px = 12.0;
    kc_wire_detection(&m, &d);
    TEST_ASSERT_EQUAL_DOUBLE(5.0, d.cov[5]);
    TEST_ASSERT_EQUAL_DOUBLE(5.0, d.cov[30]);
    TEST_ASSERT_EQUAL_DOUBLE(6.0, d.cov[7]);
    TEST_ASSERT_EQUAL_DOUBLE(20.0, d.cov[35]);
    TEST_ASSERT_EQUAL_DOUBLE(131.0, d.corner_px[31]);
    TEST_ASSERT_TRUE(d.n_tags > KC_TAG_MAX);
    TEST_ASSERT_EQUAL_INT(4, d.tag_id[3]);
    TEST_ASSERT_EQUAL_DOUBLE(0.3, d.p_alt_m[2]);
    TEST_ASSERT_EQUAL_DOUBLE(0.7, d.rms_alt_px);
    TEST_ASSERT_EQUAL_DOUBLE(12.0, d.v_px);
}

void test_answers_events_and_commands_go_out_whole(void)
{
    const kc_ack_t a = {1, 2, 3, -4, 15};
    const kc_event_t e = {61, KC_SEV_INFO, 7, 0.5, 0.6};
    static kc_arm_cmd_t c;
    static kc_table_chunk_t k;
    kcm_ack_t am;
    kcm_event_t em;
    kcm_arm_cmd_t cm;
    static kcm_table_chunk_t km;
    kc_wire_ack(&a, 99, &am);
    TEST_ASSERT_EQUAL_INT(1, am.source);
    TEST_ASSERT_EQUAL_INT(-4, am.status);
    TEST_ASSERT_EQUAL_INT(15, am.event_id);
    kc_wire_event(&e, 99, 12, &em);
    TEST_ASSERT_EQUAL_INT(12, em.seq);
    TEST_ASSERT_EQUAL_INT(61, em.id);
    TEST_ASSERT_EQUAL_INT(7, em.index);
    TEST_ASSERT_EQUAL_DOUBLE(0.6, em.want);
    c.seq = 5;
    c.n_joints = 7u;
    c.q[6] = 1.25;
    c.speed_scale = 0.5;
    c.hold = 1u;
    kc_wire_arm_cmd(&c, 99, &cm);
    TEST_ASSERT_EQUAL_DOUBLE(1.25, cm.q_rad[6]);
    TEST_ASSERT_EQUAL_INT(7, cm.n_joints);
    TEST_ASSERT_EQUAL_INT(1, cm.hold);
    k.kind = 4;
    k.total = 2000u;
    k.offset = 1024u;
    k.n = 976u;
    k.data[3] = 9u;
    km.counter = 1;
    km.key_id = km.source = 1; /* of a message before it */
    kc_wire_table_down(&k, 99, &km);
    TEST_ASSERT_EQUAL_INT(0, km.source);
    TEST_ASSERT_EQUAL_INT(0, km.key_id);
    TEST_ASSERT_EQUAL_INT64(0, km.counter);
    TEST_ASSERT_EQUAL_INT(2000, km.total_bytes);
    TEST_ASSERT_EQUAL_INT(976, km.n);
    TEST_ASSERT_EQUAL_UINT8(9u, km.data[3]);
}

void test_housekeeping_carries_the_crcs_bit_by_bit(void)
{
    static kc_hk_t h;
    static kcm_hk_t m;
    h.table_crc[4] = 0xdeadbeefu;
    h.proposal_crc = 0x80000000u;
    h.proposal_verdict = 2u;
    h.approval_left_us = 599000000u;
    h.armed_key = 101u;
    h.go_by_other_key = 1;
    h.boot_state = -1;
    h.n_rx_errors = 3u;
    h.energy_j = 12.5;
    h.mon_state = 1;
    h.mon_joint = 7;
    h.mon_suspects = 0x41u;
    h.mon_n_obs = 5u;
    h.mon_bias = -0.02;
    h.mon_sigma = 0.001;
    h.mon_p = 1e-9;
    h.mon_chance[7] = 0.25;
    h.n_tx_errors = 8;
    kc_wire_hk(&h, 99, &m);
    TEST_ASSERT_EQUAL_HEX32(0xdeadbeefu, (uint32_t)m.table_crc[4]);
    TEST_ASSERT_EQUAL_HEX32(0x80000000u, (uint32_t)m.proposal_crc);
    TEST_ASSERT_EQUAL_INT(KCM_PROPOSAL_T_POOR, m.proposal_verdict);
    TEST_ASSERT_EQUAL_INT64(599000000, m.approval_left_us);
    TEST_ASSERT_EQUAL_INT(101, m.armed_key);
    TEST_ASSERT_EQUAL_INT(1, m.go_by_other_key);
    TEST_ASSERT_EQUAL_INT(-1, m.boot_state);
    TEST_ASSERT_EQUAL_INT(8, m.n_tx_errors);
    TEST_ASSERT_EQUAL_INT(3, m.n_rx_errors);
    TEST_ASSERT_EQUAL_DOUBLE(12.5, m.energy_j);
    TEST_ASSERT_EQUAL_INT(1, m.mon_state);
    TEST_ASSERT_EQUAL_INT(7, m.mon_joint);
    TEST_ASSERT_EQUAL_HEX32(0x41u, (uint32_t)m.mon_suspects);
    TEST_ASSERT_EQUAL_INT(5, m.mon_n_obs);
    TEST_ASSERT_EQUAL_DOUBLE(-0.02, m.mon_bias);
    TEST_ASSERT_EQUAL_DOUBLE(0.001, m.mon_sigma);
    TEST_ASSERT_EQUAL_DOUBLE(1e-9, m.mon_p);
    TEST_ASSERT_EQUAL_DOUBLE(0.25, m.mon_chance[7]);
}

void test_a_measurement_goes_out_whole(void)
{
    static kc_meas_t s;
    static kcm_meas_t m;
    s.t_us = 5u;
    s.pose = 3u;
    s.candidate = 17;
    s.replicate = 1;
    s.n_joints = 7u;
    fill(s.arm.q, 8u, 1.0);
    s.arm.dir[1] = -1.0;
    fill(s.obs.cov, 36u, 0.0);
    fill(s.obs.p_m, 3u, 50.0);
    fill(s.obs.q_cam_wxyz, 4u, 60.0);
    fill(s.arm.q_cmd, 8u, 11.0);
    fill(s.arm.dq, 8u, 21.0);
    fill(s.arm.g_m_s2, 3u, 31.0);
    s.arm.temp_c = -40.0;
    s.arm.payload_kg = 0.7;
    fill(s.obs.q_wxyz, 4u, 80.0);
    fill(s.obs.p_cam_m, 3u, 90.0);
    fill(s.det.p_cam_tool_m, 3u, 70.0);
    fill(s.det.q_cam_tool_wxyz, 4u, 100.0);
    fill(s.det.p_alt_m, 3u, 110.0);
    fill(s.det.q_alt_wxyz, 4u, 120.0);
    fill(s.det.corner_px, 32u, 200.0);
    s.det.range_m = 0.9;
    s.det.incid_rad = 0.3;
    s.det.u_px = 640.0;
    s.det.v_px = 480.0;
    for (uint32_t k = 0u; k < KC_TBL_COUNT; k++) { s.crc[k] = 1000u + k; }
    s.det.n_tags = 2u;
    s.det.tag_id[1] = 1;
    s.det.rms_px = 0.4;
    s.n_frames = 3u;
    s.pan_rad = 0.1;
    s.crc[KC_TBL_KIN] = 0xffffffffu;
    kc_wire_meas(&s, 99, &m);
    TEST_ASSERT_EQUAL_INT(17, m.candidate);
    TEST_ASSERT_EQUAL_DOUBLE(7.0, m.q_rad[6]);
    TEST_ASSERT_EQUAL_INT(-1, m.dir[1]);
    TEST_ASSERT_EQUAL_DOUBLE(7.0, m.cov[6]); /* second row begins at its diagonal */
    TEST_ASSERT_EQUAL_DOUBLE(35.0, m.cov[20]);
    TEST_ASSERT_EQUAL_DOUBLE(52.0, m.p_m[2]);
    TEST_ASSERT_EQUAL_DOUBLE(63.0, m.q_cam_wxyz[3]);
    TEST_ASSERT_EQUAL_DOUBLE(72.0, m.p_cam_tool_m[2]);
    TEST_ASSERT_EQUAL_INT(3, m.n_frames);
    TEST_ASSERT_EQUAL_INT(-1, m.crc_kin);
    TEST_ASSERT_EQUAL_INT(1000 + KC_TBL_ARM, m.crc_arm);
    TEST_ASSERT_EQUAL_INT(1000 + KC_TBL_CAMERA, m.crc_camera);
    TEST_ASSERT_EQUAL_INT(1000 + KC_TBL_TERMS, m.crc_terms);
    TEST_ASSERT_EQUAL_DOUBLE(18.0, m.q_cmd_rad[7]);
    TEST_ASSERT_EQUAL_DOUBLE(28.0, m.dq_rad_s[7]);
    TEST_ASSERT_EQUAL_DOUBLE(33.0, m.g_m_s2[2]);
    TEST_ASSERT_EQUAL_DOUBLE(-40.0, m.temp_c);
    TEST_ASSERT_EQUAL_DOUBLE(0.7, m.payload_kg);
    TEST_ASSERT_EQUAL_DOUBLE(83.0, m.q_wxyz[3]);
    TEST_ASSERT_EQUAL_DOUBLE(92.0, m.p_cam_m[2]);
    TEST_ASSERT_EQUAL_DOUBLE(103.0, m.q_cam_tool_wxyz[3]);
    TEST_ASSERT_EQUAL_DOUBLE(112.0, m.p_alt_m[2]);
    TEST_ASSERT_EQUAL_DOUBLE(123.0, m.q_alt_wxyz[3]);
    TEST_ASSERT_EQUAL_DOUBLE(231.0, m.corner_px[31]);
    TEST_ASSERT_EQUAL_INT(2, m.n_tags);
    TEST_ASSERT_EQUAL_INT(1, m.tag_id[1]);
    TEST_ASSERT_EQUAL_DOUBLE(0.9, m.range_m);
    TEST_ASSERT_EQUAL_DOUBLE(0.3, m.incid_rad);
    TEST_ASSERT_EQUAL_DOUBLE(640.0, m.u_px);
    TEST_ASSERT_EQUAL_DOUBLE(480.0, m.v_px);
    TEST_ASSERT_EQUAL_DOUBLE(0.4, m.rms_px);
}

void test_progress_and_proposal_go_out_whole(void)
{
    static kc_progress_t p;
    static kcm_progress_t pm;
    static kc_proposal_t s;
    static kcm_proposal_t m;
    p.pose = 4u;
    p.n_goal = 20u;
    p.acquisition = -1;
    p.f = -0.5;
    p.energy_j = 70.0;
    p.coef[63] = 6.3;
    kc_wire_progress(&p, 9, &pm);
    TEST_ASSERT_EQUAL_INT(20, pm.n_goal);
    TEST_ASSERT_EQUAL_INT(-1, pm.acquisition);
    TEST_ASSERT_EQUAL_DOUBLE(-0.5, pm.f);
    TEST_ASSERT_EQUAL_DOUBLE(70.0, pm.energy_j);
    TEST_ASSERT_EQUAL_DOUBLE(6.3, pm.coef[63]);
    s.crc = 0xcafebabeu;
    s.verdict = KC_VERDICT_POOR;
    s.kin.n_coef = 3u;
    fill(s.kin.value, 3u, 1.0);
    fill(s.kin.sigma, 3u, 0.1);
    s.status[1] = KC_COEF_HELD;
    s.status[2] = KC_COEF_MASKED;
    s.confounded[1] = 1ull << 63;
    s.cov[5] = 0.25;
    kc_wire_proposal(&s, 9, &m);
    TEST_ASSERT_EQUAL_HEX32(0xcafebabeu, (uint32_t)m.crc);
    TEST_ASSERT_EQUAL_INT(KC_VERDICT_POOR, m.verdict);
    TEST_ASSERT_EQUAL_DOUBLE(3.0, m.value[2]);
    TEST_ASSERT_EQUAL_DOUBLE(0.1, m.sigma[0]);
    TEST_ASSERT_EQUAL_DOUBLE(1.1, m.sigma[1]); /* not estimated: as in the table, whose CRC is compared */
    TEST_ASSERT_EQUAL_DOUBLE(2.1, m.sigma[2]);
    TEST_ASSERT_EQUAL_INT(KC_COEF_HELD, m.status[1]);
    TEST_ASSERT_TRUE(m.confounded[1] == INT64_MIN);
    TEST_ASSERT_EQUAL_DOUBLE(0.25, m.cov[5]);
}
