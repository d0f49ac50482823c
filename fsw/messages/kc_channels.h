/* What comes in and goes out with a step, and by which channel. */
#ifndef KC_CHANNELS_H
#define KC_CHANNELS_H

#include <stdint.h>

#include "kc_events.h"
#include "kc_messages.h"
#include "kc_sensors.h"
#include "kc_store.h"

/* From flight, in the order in which they are published, after answers and events: channel KC_CHANNEL, member of kc_out_t
 * (it has the channel's name), kc_message_t here and kcm_message_t on the wire, function of kc_wire.c that writes it. */
#define KC_OUT_LIST(X)                                                    \
    X(ARM_CMD, arm_cmd, arm_cmd, kc_wire_arm_cmd)                         \
    X(PANTILT_CMD, pantilt_cmd, pantilt_cmd, kc_wire_pantilt_cmd)         \
    X(FRAME_REQUEST, frame_request, frame_request, kc_wire_frame_request) \
    X(MEAS, meas, meas, kc_wire_meas)                                     \
    X(PROGRESS, progress, progress, kc_wire_progress)                     \
    X(PROPOSAL, proposal, proposal, kc_wire_proposal)                     \
    X(TABLE_DOWN, table_down, table_chunk, kc_wire_table_down)            \
    X(HK, hk, hk, kc_wire_hk)

/* To flight, on channels KC_CMD, KC_TABLE_UP, KC_DETECTION, KC_ARM_STATE and KC_PANTILT_STATE: of the first three each
 * message counts, at most so many come in with a step; of the others the newest of a step. */
typedef struct {
    uint32_t n_cmd, n_chunk, n_det;
    uint32_t n_rx_errors;
    kc_cmd_t cmd[KC_CMD_QUEUE_MAX];
    kc_table_chunk_t chunk[KC_CHUNK_QUEUE_MAX];
    kc_detection_t det[KC_DET_QUEUE_MAX];
    uint8_t has_arm, has_pantilt;
    kc_arm_state_t arm;
    kc_pantilt_state_t pantilt;
    /* answer of the edge to the store requests of the last step, if there were any: KC_OK when all of them are
     * done and read back; else that of the first failure and its kind, those after it were not done */
    uint8_t has_store_result;
    uint16_t store_kind;
    int32_t store_status;
} kc_in_t;

#define KC_OUT_HAS_(CHANNEL, member, message, wire) uint8_t has_##member;
#define KC_OUT_MEMBER_(CHANNEL, member, message, wire) kc_##message##_t member;
typedef struct {
    uint32_t n_ack, n_store;
    kc_ack_t ack[KC_CMD_QUEUE_MAX + 1u]; /* also of a command that had to be stored */
    kc_events_t events;
    kc_store_t store[KC_STORE_QUEUE_MAX];
    KC_OUT_LIST(KC_OUT_HAS_)
    KC_OUT_LIST(KC_OUT_MEMBER_)
} kc_out_t;

#endif
