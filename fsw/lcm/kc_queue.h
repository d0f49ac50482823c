/* Messages of other participants wait here until they are due, and leave in an order that does not
 * depend on when they arrived: commands of one source by number, sources in turn, table chunks by kind and
 * offset (time first, so that one upload follows the other), detections by frame number.
 *
 * Due means: stamped earlier than now. In lockstep all of those have arrived when a tick begins.
 *
 * An ABORT is taken in the next step whatever waits, and what waited with it is marked (stopped): one step takes only a
 * part of the queue, and the rest would be carried out after it.
 *
 * Room goes by who signed, not by who is named: what a holder of a key sent (vouched, kc_app_vouches_cmd) has room of its
 * own, and so has ABORT. All the rest shares one account, whatever source it names; and so does a second copy of what
 * waits already. */
#ifndef KC_QUEUE_H
#define KC_QUEUE_H

#include <stdbool.h>

#include "kc_channels.h"
#include "kc_counters.h"

/* Accounts of commands: of each source what is vouched for, ABORT of anybody, and all else. Each has room for
 * KC_Q_CMD_QUOTA, so that none crowds out another. */
#define KC_Q_OTHERS 0u
#define KC_Q_ABORTS (KC_SOURCE_MAX + 1u)
#define KC_Q_ACCOUNTS (KC_SOURCE_MAX + 2u)
#define KC_Q_CMD_QUOTA 8u
#define KC_Q_CMD (KC_Q_ACCOUNTS * KC_Q_CMD_QUOTA)
#define KC_Q_CHUNK 32u
#define KC_Q_CHUNK_OTHERS 8u /* of them: chunks that nobody vouches for */
#define KC_Q_DET 8u
#define KC_Q_AHEAD_US 10000000 /* a stamp further ahead than this will not be waited for */

/* A message that waits: when it is due, and whose room it takes. */
typedef struct {
    int64_t t_us;
    uint32_t account;
    kc_cmd_t m;
} kc_waiting_cmd_t;
typedef struct {
    int64_t t_us;
    uint32_t account;
    kc_table_chunk_t m;
} kc_waiting_chunk_t;
typedef struct {
    int64_t t_us;
    kc_detection_t m;
} kc_waiting_det_t;

typedef struct {
    uint32_t n_cmd, n_chunk, n_det;
    kc_waiting_cmd_t cmd[KC_Q_CMD];
    kc_waiting_chunk_t chunk[KC_Q_CHUNK];
    kc_waiting_det_t det[KC_Q_DET];
} kc_queue_t;

/* Whether the message waits now; false if there is no room or the stamp lies too far ahead of now: it is lost. vouched: a
 * holder of a key sent it. */
bool kc_queue_cmd(kc_queue_t *queue, int64_t t_us, int64_t now_us, const kc_cmd_t *cmd, bool vouched);
bool kc_queue_chunk(kc_queue_t *queue, int64_t t_us, int64_t now_us, const kc_table_chunk_t *chunk,
                    bool vouched);
bool kc_queue_det(kc_queue_t *queue, int64_t t_us, int64_t now_us, const kc_detection_t *det);
/* Move what is due into in, as much as one step takes; the rest waits for the next. */
void kc_queue_take(kc_queue_t *queue, int64_t now_us, kc_in_t *in);

#endif
