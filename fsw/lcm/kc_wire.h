/* Between LCM messages and the component's structs, units unchanged: what both name alike is copied by the lists of
 * fields in kc_messages.h, the rest by hand. Nothing is checked here; the component does that. */
#ifndef KC_WIRE_H
#define KC_WIRE_H

#include "kc_channels.h"
#include "kcm.h"

/* To flight. kc_wire_arm keeps the faults that `to` holds: the newest state of a step counts, but no fault of it is
 * lost. */
void kc_wire_cmd(const kcm_cmd_t *from, kc_cmd_t *to);
void kc_wire_chunk(const kcm_table_chunk_t *from, kc_chunk_t *to);
void kc_wire_det(const kcm_detection_t *from, kc_detection_t *to);
void kc_wire_arm(const kcm_arm_state_t *from, kc_arm_state_t *to);
void kc_wire_pantilt(const kcm_pantilt_state_t *from, kc_pantilt_state_t *to);

/* From flight; t_us: mission time. */
void kc_wire_arm_cmd(const kc_arm_cmd_t *from, int64_t t_us, kcm_arm_cmd_t *to);
void kc_wire_pantilt_cmd(const kc_pantilt_cmd_t *from, int64_t t_us, kcm_pantilt_cmd_t *to);
void kc_wire_frame_request(const kc_frame_request_t *from, int64_t t_us, kcm_frame_request_t *to);
void kc_wire_meas(const kc_meas_t *from, int64_t t_us, kcm_meas_t *to);
void kc_wire_progress(const kc_progress_t *from, int64_t t_us, kcm_progress_t *to);
void kc_wire_proposal(const kc_proposal_t *from, int64_t t_us, kcm_proposal_t *to);
void kc_wire_table_down(const kc_table_chunk_t *from, int64_t t_us, kcm_table_chunk_t *to);
void kc_wire_hk(const kc_hk_t *from, int64_t t_us, kcm_hk_t *to);
void kc_wire_ack(const kc_ack_t *from, int64_t t_us, kcm_ack_t *to);
void kc_wire_event(const kc_event_t *from, int64_t t_us, int32_t seq, kcm_event_t *to);

#endif
