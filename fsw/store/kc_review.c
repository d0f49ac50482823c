#include "kc_review.h"

#include <string.h>

uint32_t kc_review_encode(kc_review_t *review, const kc_kin_t *kin, kc_verdict_t verdict)
{
    review->verdict = (uint32_t)verdict;
    (void)kc_tbl_encode(KC_TBL_KIN, kin, 0u, review->image, KC_KIN_IMAGE_MAX, &review->n);
    review->kin = *kin;
    return kc_tbl_image_crc(review->image, review->n);
}

void kc_review_wait(kc_review_t *review, kc_out_t *out)
{
    review->crc = kc_tbl_image_crc(review->image, review->n);
    kc_event(&out->events, KC_EVT_COR_PROPOSED, -1, (double)review->crc, (double)review->kin.n_poses);
}

/* The journal names it no more; the copy is deleted so that it does not come back without a journal. */
static void forget(kc_review_t *review, kc_out_t *out)
{
    review->crc = 0u;
    kc_journal_store(out, KC_STORE_PROPOSAL, review->image, 0u);
}

kc_status_t kc_review_activate(kc_review_t *review, kc_tables_t *tables, kc_out_t *out)
{
    kc_status_t st = kc_tbl_set_kin(tables, &review->kin, &out->events);
    if (st != KC_OK) { return st; }
    forget(review, out);
    kc_event(&out->events, KC_EVT_COR_ACTIVE, -1, (double)tables->active.crc[KC_TBL_KIN], 0.0);
    return KC_OK;
}

void kc_review_drop(kc_review_t *review, kc_out_t *out)
{
    if (review->crc == 0u) { return; }
    kc_event(&out->events, KC_EVT_COR_REJECTED, -1, (double)review->crc, 0.0);
    forget(review, out);
}

kc_outcome_t kc_review_armed(const kc_review_t *review, const kc_view_t *view, kc_out_t *out)
{
    if (kc_view_in_state_us(view) <= view->tables->config.approval_timeout_us) {
        return kc_outcome(KC_OC_STAY);
    }
    kc_event(&out->events, KC_EVT_COR_EXPIRED, -1, (double)review->crc, 0.0);
    return kc_outcome(KC_OC_EXPIRE);
}

void kc_review_report(const kc_review_t *review, const kc_view_t *view, kc_hk_t *hk)
{
    uint64_t passed_us = kc_view_in_state_us(view), timeout_us = view->tables->config.approval_timeout_us;
    bool armed = view->place->state == KC_ST_ARMED && passed_us < timeout_us;
    hk->proposal_crc = review->crc;
    hk->proposal_verdict = kc_review_verdict(review);
    hk->approval_left_us = armed ? timeout_us - passed_us : 0u;
    hk->armed_key = armed ? review->armed_key : 0u;
    hk->go_by_other_key = view->tables->config.go_by_other_key;
}

/* ---- commands ---- */

static kc_answer_t wrong_crc(kc_out_t *out, uint32_t crc, uint32_t want)
{
    return kc_answer_refuse(&out->events, KC_EVT_CMD_CRC, -1, (double)crc, (double)want, KC_ERR_CRC);
}

/* Not a good fit, as far as is known: only an override arms it. */
static kc_answer_t check_fit(const kc_review_t *review, int32_t overrides, kc_out_t *out)
{
    kc_event_id_t why = review->verdict == (uint32_t)KC_VERDICT_POOR ? KC_EVT_COR_POOR
                                                                     : KC_EVT_COR_NO_VERDICT;
    if (review->verdict == (uint32_t)KC_VERDICT_CHANGE) { return kc_answer_ok(KC_OC_ARM); }
    if (overrides == KC_OVERRIDE_NONE) {
        return kc_answer_refuse(&out->events, why, -1, (double)review->crc, 0.0, KC_ERR_ARG);
    }
    kc_event(&out->events, KC_EVT_COR_OVERRIDE, -1, (double)review->crc, 0.0);
    return kc_answer_ok(KC_OC_ARM);
}

/* The first step was taken: by whom, and who may take the second one. */
static void arm(kc_review_t *review, const kc_config_t *config, uint32_t key_id, kc_out_t *out)
{
    review->armed_key = key_id;
    kc_event(&out->events, KC_EVT_COR_ARMED, -1, (double)review->crc, 0.0);
    if (config->go_by_other_key == 0u) { return; }
    kc_event(&out->events, KC_EVT_COR_OTHER_KEY, -1, (double)key_id, (double)config->approval_timeout_us);
}

kc_answer_t kc_review_arm(kc_review_t *review, const kc_config_t *config, const kc_keys_t *keys,
                          const kc_cmd_t *cmd, kc_out_t *out)
{
    uint32_t crc = (uint32_t)cmd->arg_i[0];
    int32_t overrides = cmd->arg_i[1];
    if (crc != review->crc) { return wrong_crc(out, crc, review->crc); }
    if (overrides != KC_OVERRIDE_NONE && overrides != KC_OVERRIDE_FIT) {
        return kc_answer_refuse(&out->events, KC_EVT_CMD_ARG, 1, (double)overrides, (double)KC_OVERRIDE_FIT,
                                KC_ERR_ARG);
    }
    kc_answer_t answer = kc_holder_possible(config, keys, out);
    if (answer.status == KC_OK) { answer = check_fit(review, overrides, out); }
    if (answer.status == KC_OK) { arm(review, config, cmd->auth.key_id, out); }
    return answer;
}

kc_answer_t kc_review_go(kc_review_t *review, const kc_tables_t *tables, const kc_cmd_t *cmd, kc_out_t *out)
{
    uint32_t mark = out->events.n, crc = (uint32_t)cmd->arg_i[0];
    if (crc != review->crc) { return wrong_crc(out, crc, review->crc); }
    kc_answer_t answer = kc_holder_second(&tables->active.config, review->armed_key, cmd, out);
    if (answer.status != KC_OK) { return answer; }
    kc_status_t st = kc_tbl_decode(KC_TBL_KIN, review->image, review->n, &review->kin, &out->events);
    if (st == KC_OK) { st = kc_tbl_kin_fits(tables, &review->kin, &out->events); }
    return kc_answer_by(st, &out->events, mark, KC_OC_STORE);
}

kc_answer_t kc_review_reject(const kc_review_t *review, uint32_t crc, kc_out_t *out)
{
    return crc == review->crc ? kc_answer_ok(KC_OC_STORE) : wrong_crc(out, crc, review->crc);
}

kc_answer_t kc_review_rollback(const kc_tables_t *tables, uint32_t crc, kc_out_t *out)
{
    const kc_active_t *a = &tables->active;
    if (crc != a->crc[KC_TBL_KIN]) { return wrong_crc(out, crc, a->crc[KC_TBL_KIN]); }
    if (a->kin_prev_crc != 0u) { return kc_answer_ok(KC_OC_STORE); }
    return kc_answer_refuse(&out->events, KC_EVT_COR_NO_PREVIOUS, -1, 0.0, 0.0, KC_ERR_STATE);
}

/* ---- boot ---- */

kc_status_t kc_review_load(kc_review_t *review, const kc_tables_t *tables, uint32_t verdict,
                           const uint8_t *image, uint32_t n, kc_events_t *ev)
{
    uint32_t active = tables->active.crc[KC_TBL_KIN];
    if (review->crc != 0u || kc_tbl_image_crc(image, n) == active) { return KC_ERR_STATE; }
    kc_status_t st = n <= KC_KIN_IMAGE_MAX ? kc_tbl_decode(KC_TBL_KIN, image, n, &review->kin, ev)
                                           : KC_ERR_FORMAT;
    if (st == KC_OK) { st = kc_tbl_kin_fits(tables, &review->kin, ev); }
    if (st != KC_OK) { return st; }
    if (review->kin.prev_crc != active) {
        kc_event(ev, KC_EVT_TBL_DEPENDS, KC_TBL_KIN, (double)review->kin.prev_crc, (double)active);
        return KC_ERR_STATE;
    }
    memcpy(review->image, image, n);
    review->n = n;
    review->crc = kc_tbl_image_crc(image, n);
    review->verdict = verdict;
    return KC_OK;
}
