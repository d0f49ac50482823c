#include "kc_wire.h"

#include <string.h>

/* LCM has no unsigned types: bits are kept. */
static int32_t i32(uint32_t x) { return (int32_t)x; }

#define IS_REAL(x) _Generic((x), float: 1, double: 1, default: 0)
#define COPY_AS(to, from, one_to, one_from)                                                         \
    do {                                                                                            \
        _Static_assert(sizeof(to) == sizeof(from), "same size on both sides");                      \
        _Static_assert(IS_REAL(one_to) == IS_REAL(one_from), "whole number or not, on both sides"); \
        memcpy(&(to), &(from), sizeof(to));                                                         \
    } while (0)
#define COPY(to, from) COPY_AS(to, from, (to)[0], (from)[0])
/* Of a list in kc_messages.h, between the structs that `from` and `to` point to. */
#define COPY_FIELD(type, name) COPY_AS(to->name, from->name, to->name, from->name);
#define COPY_ARRAY(type, name, count) COPY(to->name, from->name);
#define COPY_FIELDS(LIST) LIST(COPY_FIELD, COPY_ARRAY)

/* ---- in ---- */

static void copy_auth(int32_t key_id, int64_t counter, const int64_t *mac, kc_auth_t *to)
{
    to->key_id = (uint32_t)key_id;
    to->counter = (uint64_t)counter;
    for (uint32_t i = 0u; i < KC_MAC_BYTES; i++) {
        to->mac[i] = (uint8_t)((uint64_t)mac[i / 8u] >> (8u * (i % 8u)));
    }
}

void kc_wire_cmd(const kcm_cmd_t *from, kc_cmd_t *to)
{
    COPY_FIELDS(KC_CMD_FIELDS)
    copy_auth(from->key_id, from->counter, from->mac, &to->auth);
    to->stopped = 0u;
}

void kc_wire_chunk(const kcm_table_chunk_t *from, kc_chunk_t *to)
{
    COPY_FIELDS(KC_TABLE_CHUNK_FIELDS)
    to->t_us = (uint64_t)from->t_us;
    to->total = (uint32_t)from->total_bytes; /* negative ones become too large */
    copy_auth(from->key_id, from->counter, from->mac, &to->auth);
}

void kc_wire_arm(const kcm_arm_state_t *from, kc_arm_state_t *to)
{
    COPY_FIELDS(KC_ARM_STATE_FIELDS)
    COPY(to->q, from->q_rad);
    COPY(to->dq, from->dq_rad_s);
    COPY(to->q_cmd, from->q_cmd_rad);
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { to->dir[j] = (double)from->dir[j]; }
    to->moving = from->moving != 0;
    to->fault_mask |= from->fault_mask;
}

void kc_wire_pantilt(const kcm_pantilt_state_t *from, kc_pantilt_state_t *to)
{
    COPY_FIELDS(KC_PANTILT_STATE_FIELDS)
    to->moving = from->moving != 0;
}

static void unpack_cov(const double *packed, double cov[36])
{
    uint32_t k = 0u;
    for (uint32_t i = 0u; i < 6u; i++) {
        for (uint32_t j = i; j < 6u; j++, k++) { cov[6u * i + j] = cov[6u * j + i] = packed[k]; }
    }
}

static void pack_cov(const double cov[36], double *packed)
{
    uint32_t k = 0u;
    for (uint32_t i = 0u; i < 6u; i++) {
        for (uint32_t j = i; j < 6u; j++) { packed[k++] = cov[6u * i + j]; }
    }
}

void kc_wire_det(const kcm_detection_t *from, kc_detection_t *to)
{
    COPY_FIELDS(KC_DETECTION_FIELDS)
    unpack_cov(from->cov, to->cov);
}

/* ---- out ---- */

void kc_wire_ack(const kc_ack_t *from, int64_t t_us, kcm_ack_t *to)
{
    to->t_us = t_us;
    COPY_FIELDS(KC_ACK_FIELDS)
}

void kc_wire_event(const kc_event_t *from, int64_t t_us, int32_t seq, kcm_event_t *to)
{
    *to = (kcm_event_t){t_us, seq, from->id, from->severity, from->got, from->want, from->index};
}

void kc_wire_pantilt_cmd(const kc_pantilt_cmd_t *from, int64_t t_us, kcm_pantilt_cmd_t *to)
{
    to->t_us = t_us;
    COPY_FIELDS(KC_PANTILT_CMD_FIELDS)
}

void kc_wire_frame_request(const kc_frame_request_t *from, int64_t t_us, kcm_frame_request_t *to)
{
    to->t_us = t_us;
    COPY_FIELDS(KC_FRAME_REQUEST_FIELDS)
}

void kc_wire_progress(const kc_progress_t *from, int64_t t_us, kcm_progress_t *to)
{
    to->t_us = t_us;
    COPY_FIELDS(KC_PROGRESS_FIELDS)
}

void kc_wire_hk(const kc_hk_t *from, int64_t t_us, kcm_hk_t *to)
{
    to->t_us = t_us;
    COPY_FIELDS(KC_HK_FIELDS)
}

void kc_wire_arm_cmd(const kc_arm_cmd_t *from, int64_t t_us, kcm_arm_cmd_t *to)
{
    to->t_us = t_us;
    COPY_FIELDS(KC_ARM_CMD_FIELDS)
    COPY(to->q_rad, from->q);
}

void kc_wire_table_down(const kc_chunk_t *from, int64_t t_us, kcm_table_chunk_t *to)
{
    memset(to, 0, sizeof *to); /* nobody's, and not signed */
    to->t_us = t_us;
    COPY_FIELDS(KC_TABLE_CHUNK_FIELDS)
    to->total_bytes = i32(from->total);
}

static void meas_arm(const kc_arm_state_t *arm, kcm_meas_t *to)
{
    COPY(to->q_rad, arm->q);
    COPY(to->q_cmd_rad, arm->q_cmd);
    COPY(to->dq_rad_s, arm->dq);
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { to->dir[j] = (int8_t)arm->dir[j]; }
    to->temp_c = arm->temp_c;
    to->payload_kg = arm->payload_kg;
    COPY(to->g_m_s2, arm->g_m_s2);
}

static void meas_det(const kc_detection_t *det, kcm_meas_t *to)
{
    COPY(to->p_cam_tool_m, det->p_cam_tool_m);
    COPY(to->q_cam_tool_wxyz, det->q_cam_tool_wxyz);
    to->n_tags = i32(det->n_tags);
    COPY(to->tag_id, det->tag_id);
    COPY(to->p_alt_m, det->p_alt_m);
    COPY(to->q_alt_wxyz, det->q_alt_wxyz);
    to->range_m = det->range_m;
    to->incid_rad = det->incid_rad;
    to->u_px = det->u_px;
    to->v_px = det->v_px;
    to->rms_px = det->rms_px;
    COPY(to->corner_px, det->corner_px);
}

void kc_wire_meas(const kc_meas_t *from, int64_t t_us, kcm_meas_t *to)
{
    (void)t_us; /* it has a time of its own */
    COPY_FIELDS(KC_MEAS_FIELDS)
    meas_arm(&from->arm, to);
    COPY(to->p_m, from->obs.p_m);
    COPY(to->q_wxyz, from->obs.q_wxyz);
    pack_cov(from->obs.cov, to->cov);
    COPY(to->p_cam_m, from->obs.p_cam_m);
    COPY(to->q_cam_wxyz, from->obs.q_cam_wxyz);
    meas_det(&from->det, to);
    to->crc_arm = i32(from->crc[KC_TBL_ARM]);
    to->crc_camera = i32(from->crc[KC_TBL_CAMERA]);
    to->crc_terms = i32(from->crc[KC_TBL_TERMS]);
    to->crc_kin = i32(from->crc[KC_TBL_KIN]);
}

void kc_wire_proposal(const kc_proposal_t *from, int64_t t_us, kcm_proposal_t *to)
{
    to->t_us = t_us;
    COPY_FIELDS(KC_PROPOSAL_FIELDS)
    to->n_coef = i32(from->kin.n_coef);
    memcpy(to->value, from->kin.value, sizeof to->value);
    memcpy(to->sigma, from->kin.sigma, sizeof to->sigma);
    to->crc_arm = i32(from->kin.arm_crc);
    to->crc_terms = i32(from->kin.terms_crc);
}
