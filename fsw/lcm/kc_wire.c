#include "kc_wire.h"

#include <string.h>

/* LCM has no unsigned types: bits are kept. */
static int32_t i32(uint32_t x) { return (int32_t)x; }

#define COPY(to, from)                                                                       \
    do {                                                                                     \
        _Static_assert(sizeof(to) == sizeof(from), "same number of elements on both sides"); \
        memcpy((to), (from), sizeof(to));                                                    \
    } while (0)

/* ---- in ---- */

void kc_wire_cmd(const kcm_cmd_t *m, kc_cmd_t *c)
{
    c->seq = m->seq;
    c->source = m->source;
    c->opcode = m->opcode;
    COPY(c->arg_i, m->arg_i);
    c->arg_u64 = (uint64_t)m->arg_u64;
    COPY(c->arg_d, m->arg_d);
}

void kc_wire_chunk(const kcm_table_chunk_t *m, kc_chunk_t *c)
{
    c->kind = m->kind;
    c->total = (uint32_t)m->total_bytes; /* negative ones become too large */
    c->offset = (uint32_t)m->offset;
    c->n = (uint32_t)m->n;
    COPY(c->data, m->data);
}

void kc_wire_arm(const kcm_arm_state_t *m, kc_arm_state_t *s)
{
    s->t_us = (uint64_t)m->t_us;
    s->seq = m->seq;
    s->n_joints = (uint32_t)m->n_joints;
    COPY(s->q, m->q_rad);
    COPY(s->dq, m->dq_rad_s);
    COPY(s->q_cmd, m->q_cmd_rad);
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { s->dir[j] = (double)m->dir[j]; }
    s->moving = m->moving != 0;
    s->fault_mask = m->fault_mask;
    s->temp_c = m->temp_c;
    s->payload_kg = m->payload_kg;
    COPY(s->g_m_s2, m->g_m_s2);
}

void kc_wire_pantilt(const kcm_pantilt_state_t *m, kc_pantilt_state_t *s)
{
    s->t_us = (uint64_t)m->t_us;
    s->seq = m->seq;
    s->pan_rad = m->pan_rad;
    s->tilt_rad = m->tilt_rad;
    s->moving = m->moving != 0;
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

void kc_wire_det(const kcm_detection_t *m, kc_detection_t *d)
{
    d->t_us = (uint64_t)m->t_us;
    d->seq = m->seq;
    d->n_tags = (uint32_t)m->n_tags;
    COPY(d->tag_id, m->tag_id);
    COPY(d->p_cam_tool_m, m->p_cam_tool_m);
    COPY(d->q_cam_tool_wxyz, m->q_cam_tool_wxyz);
    unpack_cov(m->cov, d->cov);
    COPY(d->p_alt_m, m->p_alt_m);
    COPY(d->q_alt_wxyz, m->q_alt_wxyz);
    d->rms_px = m->rms_px;
    d->rms_alt_px = m->rms_alt_px;
    d->range_m = m->range_m;
    d->incid_rad = m->incid_rad;
    d->u_px = m->u_px;
    d->v_px = m->v_px;
    COPY(d->corner_px, m->corner_px);
}

/* ---- out ---- */

void kc_wire_ack(const kc_ack_t *a, int64_t t_us, kcm_ack_t *m)
{
    *m = (kcm_ack_t){t_us, a->source, a->seq, a->opcode, a->status, a->event_id};
}

void kc_wire_event(const kc_event_t *e, int64_t t_us, int32_t seq, kcm_event_t *m)
{
    *m = (kcm_event_t){t_us, seq, e->id, e->severity, e->got, e->want, e->index};
}

void kc_wire_arm_cmd(const kc_arm_cmd_t *c, int64_t t_us, kcm_arm_cmd_t *m)
{
    m->t_us = t_us;
    m->seq = c->seq;
    m->n_joints = i32(c->n_joints);
    COPY(m->q_rad, c->q);
    m->speed_scale = c->speed_scale;
    m->hold = (int8_t)c->hold;
}

void kc_wire_dump(const kc_chunk_t *c, int64_t t_us, kcm_table_chunk_t *m)
{
    m->t_us = t_us;
    m->kind = c->kind;
    m->total_bytes = i32(c->total);
    m->offset = i32(c->offset);
    m->n = i32(c->n);
    COPY(m->data, c->data);
}

void kc_wire_hk(const kc_hk_t *h, int64_t t_us, int32_t n_tx_errors, kcm_hk_t *m)
{
    m->t_us = t_us;
    m->seq = h->seq;
    m->state = h->state;
    m->session = i32(h->session);
    m->n_poses = i32(h->n_poses);
    m->n_poses_goal = i32(h->n_poses_goal);
    m->candidate = h->candidate;
    m->servo_steps = i32(h->servo_steps);
    m->n_meas = i32(h->n_meas);
    m->n_rejected = i32(h->n_rejected);
    m->n_cmd_ok = i32(h->n_cmd_ok);
    m->n_cmd_refused = i32(h->n_cmd_refused);
    m->n_events = i32(h->n_events);
    m->n_events_dropped = i32(h->n_events_dropped);
    m->last_event_id = h->last_event_id;
    m->n_tx_errors = n_tx_errors;
    m->n_rx_errors = i32(h->n_rx_errors);
    for (uint32_t k = 0u; k < KC_TBL_COUNT; k++) { m->table_crc[k] = i32(h->crc[k]); }
    m->staged_kind = h->staged_kind;
    m->staged_bytes = i32(h->staged_bytes);
    m->staged_state = h->staged_state;
    m->boot_state = h->boot_state;
    m->boot_pose = h->boot_pose;
    m->boot_count = i32(h->boot_count);
    m->proposal_crc = i32(h->proposal_crc);
    m->energy_j = h->energy_j;
    m->mon_state = h->mon_state;
    m->mon_joint = h->mon_joint;
    m->mon_suspects = i32(h->mon_suspects);
    m->mon_n_obs = i32(h->mon_n_obs);
    m->mon_bias = h->mon_bias;
    m->mon_sigma = h->mon_sigma;
    m->mon_p = h->mon_p;
}

static void meas_arm(const kc_arm_state_t *a, kcm_meas_t *m)
{
    COPY(m->q_rad, a->q);
    COPY(m->q_cmd_rad, a->q_cmd);
    COPY(m->dq_rad_s, a->dq);
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { m->dir[j] = (int8_t)a->dir[j]; }
    m->temp_c = a->temp_c;
    m->payload_kg = a->payload_kg;
    COPY(m->g_m_s2, a->g_m_s2);
}

static void meas_det(const kc_detection_t *d, kcm_meas_t *m)
{
    COPY(m->p_cam_tool_m, d->p_cam_tool_m);
    COPY(m->q_cam_tool_wxyz, d->q_cam_tool_wxyz);
    m->n_tags = i32(d->n_tags);
    COPY(m->tag_id, d->tag_id);
    COPY(m->p_alt_m, d->p_alt_m);
    COPY(m->q_alt_wxyz, d->q_alt_wxyz);
    m->range_m = d->range_m;
    m->incid_rad = d->incid_rad;
    m->u_px = d->u_px;
    m->v_px = d->v_px;
    m->rms_px = d->rms_px;
    COPY(m->corner_px, d->corner_px);
}

void kc_wire_meas(const kc_meas_t *s, kcm_meas_t *m)
{
    m->t_us = (int64_t)s->t_us;
    m->session = i32(s->session);
    m->pose = i32(s->pose);
    m->candidate = s->candidate;
    m->replicate = s->replicate;
    m->n_joints = i32(s->n_joints);
    meas_arm(&s->arm, m);
    COPY(m->p_m, s->obs.p_m);
    COPY(m->q_wxyz, s->obs.q_wxyz);
    pack_cov(s->obs.cov, m->cov);
    COPY(m->p_cam_m, s->obs.p_cam_m);
    COPY(m->q_cam_wxyz, s->obs.q_cam_wxyz);
    m->pan_rad = s->pan_rad;
    m->tilt_rad = s->tilt_rad;
    m->n_frames = i32(s->n_frames);
    meas_det(&s->det, m);
    m->crc_arm = i32(s->crc[KC_TBL_ARM]);
    m->crc_camera = i32(s->crc[KC_TBL_CAMERA]);
    m->crc_terms = i32(s->crc[KC_TBL_TERMS]);
    m->crc_kin = i32(s->crc[KC_TBL_KIN]);
}

void kc_wire_progress(const kc_progress_t *p, int64_t t_us, kcm_progress_t *m)
{
    m->t_us = t_us;
    m->session = i32(p->session);
    m->pose = i32(p->pose);
    m->n_goal = i32(p->n_goal);
    m->candidate = p->candidate;
    m->replicate = p->replicate;
    m->servo_steps = i32(p->servo_steps);
    m->acquisition = p->acquisition;
    m->acquisition_value = p->acquisition_value;
    m->res_pos_m = p->res_pos_m;
    m->res_rot_rad = p->res_rot_rad;
    m->f = p->f;
    m->gp_mean = p->gp_mean;
    m->gp_sigma = p->gp_sigma;
    m->pred_pos_m = p->pred_pos_m;
    m->pred_rot_rad = p->pred_rot_rad;
    m->rank = i32(p->rank);
    m->n_free = i32(p->n_free);
    m->dof = i32(p->dof);
    m->chi2 = p->chi2;
    m->est_status = p->est_status;
    m->fit_pos_m = p->fit_pos_m;
    m->fit_rot_rad = p->fit_rot_rad;
    m->energy_j = p->energy_j;
    COPY(m->coef, p->coef);
}

/* sigma is 0 where this calibration estimated nothing; the table keeps the old one there. */
static void proposal_coefs(const kc_proposal_t *p, kcm_proposal_t *m)
{
    for (uint32_t c = 0u; c < KC_COEF_MAX; c++) {
        bool est = p->status[c] != (uint8_t)KC_COEF_MASKED && p->status[c] != (uint8_t)KC_COEF_HELD;
        m->value[c] = p->kin.value[c];
        m->sigma[c] = est ? p->kin.sigma[c] : 0.0;
        m->status[c] = (int8_t)p->status[c];
        m->confounded[c] = (int64_t)p->confounded[c];
    }
}

void kc_wire_proposal(const kc_proposal_t *p, int64_t t_us, kcm_proposal_t *m)
{
    m->t_us = t_us;
    m->session = i32(p->session);
    m->crc = i32(p->crc);
    m->verdict = p->verdict;
    m->n_poses = i32(p->n_poses);
    m->n_outliers = i32(p->n_outliers);
    m->n_coef = i32(p->kin.n_coef);
    proposal_coefs(p, m);
    COPY(m->cov, p->cov);
    m->rank = i32(p->rank);
    m->n_free = i32(p->n_free);
    m->dof = i32(p->dof);
    m->chi2 = p->chi2;
    m->noise_scale = p->noise_scale;
    m->p_fit = p->p_fit;
    m->p_no_change = p->p_no_change;
    m->kkt = p->kkt;
    m->cond = p->cond;
    m->fit_pos_m = p->fit_pos_m;
    m->fit_rot_rad = p->fit_rot_rad;
    m->before_pos_m = p->before_pos_m;
    m->before_rot_rad = p->before_rot_rad;
    m->pred_pos_m = p->pred_pos_m;
    m->pred_rot_rad = p->pred_rot_rad;
    m->crc_arm = i32(p->kin.arm_crc);
    m->crc_terms = i32(p->kin.terms_crc);
    m->crc_kin_before = i32(p->crc_kin_before);
}
