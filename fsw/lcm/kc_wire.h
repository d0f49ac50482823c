/* Between LCM messages and the component's structs: field by field, units unchanged. Nothing is checked
 * here; the component does that. */
#ifndef KC_WIRE_H
#define KC_WIRE_H

#include "kc_app.h"
#include "kcm_ack_t.h"
#include "kcm_arm_cmd_t.h"
#include "kcm_arm_state_t.h"
#include "kcm_cmd_t.h"
#include "kcm_detection_t.h"
#include "kcm_event_t.h"
#include "kcm_hk_t.h"
#include "kcm_meas_t.h"
#include "kcm_pantilt_state_t.h"
#include "kcm_progress_t.h"
#include "kcm_proposal_t.h"
#include "kcm_table_chunk_t.h"

void kc_wire_cmd(const kcm_cmd_t *m, kc_cmd_t *c);
void kc_wire_chunk(const kcm_table_chunk_t *m, kc_chunk_t *c);
void kc_wire_arm(const kcm_arm_state_t *m, kc_arm_state_t *s);
void kc_wire_pantilt(const kcm_pantilt_state_t *m, kc_pantilt_state_t *s);
void kc_wire_det(const kcm_detection_t *m, kc_detection_t *d);

void kc_wire_ack(const kc_ack_t *a, int64_t t_us, kcm_ack_t *m);
void kc_wire_event(const kc_event_t *e, int64_t t_us, int32_t seq, kcm_event_t *m);
void kc_wire_arm_cmd(const kc_arm_cmd_t *c, int64_t t_us, kcm_arm_cmd_t *m);
void kc_wire_dump(const kc_chunk_t *c, int64_t t_us, kcm_table_chunk_t *m);
void kc_wire_hk(const kc_hk_t *h, int64_t t_us, int32_t n_tx_errors, kcm_hk_t *m);
void kc_wire_meas(const kc_meas_t *s, kcm_meas_t *m);
void kc_wire_progress(const kc_progress_t *p, int64_t t_us, kcm_progress_t *m);
void kc_wire_proposal(const kc_proposal_t *p, int64_t t_us, kcm_proposal_t *m);

#endif
