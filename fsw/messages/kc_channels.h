/* Channels: what comes in and goes out with a step, and by which name.
 *
 * X(CHANNEL, member, message, copied): channel KC_CHANNEL, member of kc_in_t or kc_out_t, kc_message_t here and
 * kcm_message_t on the wire. copied: FIELDS, as KC_CHANNEL_FIELDS lists them; or OWN, by a function of kc_wire.c.
 * The member of a new channel has the channel's name.
 *
 * To flight. QUEUED(..., order, step, room): each one counts, at most `step` come in with a step and `room` wait.
 * order SEQ: by their field seq (others: kc_queue.c). NEWEST: the newest of a step counts. */
#ifndef KC_CHANNELS_H
#define KC_CHANNELS_H

#include <stdint.h>

#include "kc_events.h"
#include "kc_messages.h"
#include "kc_sensors.h"
#include "kc_store.h"

#define KC_IN_LIST(QUEUED, NEWEST)                                                   \
    QUEUED(CMD, cmd, cmd, OWN, TURN, KC_CMD_QUEUE_MAX, KC_Q_CMD)                     \
    QUEUED(TABLE_UP, chunk, table_chunk, OWN, PLACE, KC_CHUNK_QUEUE_MAX, KC_Q_CHUNK) \
    QUEUED(DETECTION, det, detection, OWN, SEQ, KC_DET_QUEUE_MAX, KC_Q_DET)          \
    NEWEST(ARM_STATE, arm, arm_state, OWN)                                           \
    NEWEST(PANTILT_STATE, pantilt, pantilt_state, OWN)

/* From flight, in the order in which they are published, after answers and events. */
#define KC_OUT_LIST(X)                                     \
    X(ARM_CMD, arm_cmd, arm_cmd, OWN)                      \
    X(PANTILT_CMD, pantilt_cmd, pantilt_cmd, FIELDS)       \
    X(FRAME_REQUEST, frame_request, frame_request, FIELDS) \
    X(MEAS, meas, meas, OWN)                               \
    X(PROGRESS, progress, progress, FIELDS)                \
    X(PROPOSAL, proposal, proposal, OWN)                   \
    X(TABLE_DOWN, table_down, table_chunk, OWN)            \
    X(HK, hk, hk, FIELDS)

#define KC_IN_COUNT_(CHANNEL, member, message, copied, order, step, room) uint32_t n_##member;
#define KC_IN_QUEUED_(CHANNEL, member, message, copied, order, step, room) kc_##message##_t member[step];
#define KC_IN_HAS_(CHANNEL, member, message, copied) uint8_t has_##member;
#define KC_IN_NEWEST_(CHANNEL, member, message, copied) kc_##message##_t member;
#define KC_IN_NONE_(...)
typedef struct {
    KC_IN_LIST(KC_IN_COUNT_, KC_IN_NONE_)
    uint32_t n_rx_errors;
    KC_IN_LIST(KC_IN_QUEUED_, KC_IN_NONE_)
    KC_IN_LIST(KC_IN_NONE_, KC_IN_HAS_)
    KC_IN_LIST(KC_IN_NONE_, KC_IN_NEWEST_)
    /* answer of the edge to the store requests of the last step, if there were any: KC_OK when all of them are
     * done and read back; else that of the first failure and its kind, those after it were not done */
    uint8_t has_store_result;
    uint16_t store_kind;
    int32_t store_status;
} kc_in_t;

#define KC_OUT_HAS_(CHANNEL, member, message, copied) uint8_t has_##member;
#define KC_OUT_MEMBER_(CHANNEL, member, message, copied) kc_##message##_t member;
typedef struct {
    uint32_t n_ack, n_store;
    kc_ack_t ack[KC_CMD_QUEUE_MAX + 1u]; /* also of a command that had to be stored */
    kc_events_t events;
    kc_store_t store[KC_STORE_QUEUE_MAX];
    KC_OUT_LIST(KC_OUT_HAS_)
    KC_OUT_LIST(KC_OUT_MEMBER_)
} kc_out_t;

#endif
