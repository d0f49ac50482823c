/* Between LCM messages and the component's structs, units unchanged: what both name alike is copied by the lists of
 * fields in kc_messages.h, the rest by hand. Nothing is checked here; the component does that. */
#ifndef KC_WIRE_H
#define KC_WIRE_H

#include "kc_channels.h"
#include "kcm.h"

/* kc_wire_cmd(from, to) and so on, one for each channel to flight. kc_wire_arm keeps the faults that `to` holds: the
 * newest state of a step counts, but no fault of it is lost. */
#define KC_WIRE_QUEUED_(CHANNEL, member, message, copied, order, step, room) \
    void kc_wire_##member(const kcm_##message##_t *from, kc_##message##_t *to);
#define KC_WIRE_NEWEST_(CHANNEL, member, message, copied) \
    void kc_wire_##member(const kcm_##message##_t *from, kc_##message##_t *to);
KC_IN_LIST(KC_WIRE_QUEUED_, KC_WIRE_NEWEST_)

/* kc_wire_hk(from, t_us, to) and so on, one for each channel from flight; t_us: mission time. */
#define KC_WIRE_OUT_(CHANNEL, member, message, copied) \
    void kc_wire_##member(const kc_##message##_t *from, int64_t t_us, kcm_##message##_t *to);
KC_OUT_LIST(KC_WIRE_OUT_)
void kc_wire_ack(const kc_ack_t *from, int64_t t_us, kcm_ack_t *to);
void kc_wire_event(const kc_event_t *from, int64_t t_us, int32_t seq, kcm_event_t *to);

#endif
