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
#include "kc_opcodes.h"

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

#define KC_Q_NONE_(...)
#define KC_Q_WAITING_(CHANNEL, member, message, copied, order, step, room) \
    uint32_t n_##member;                                                   \
    struct {                                                               \
        int64_t t_us;                                                      \
        uint32_t account;                                                  \
        kc_##message##_t m;                                                \
    } member[room]; /* NOLINT(bugprone-macro-parentheses): a declaration */
typedef struct {
    KC_IN_LIST(KC_Q_WAITING_, KC_Q_NONE_)
} kc_queue_t;

/* kc_queue_cmd and so on, one for each queued channel: whether it waits now; false if there is no room or the stamp lies
 * too far ahead of now: the message is lost. vouched: a holder of a key sent it. */
#define KC_Q_PUT_(CHANNEL, member, message, copied, order, step, room)                             \
    bool kc_queue_##member(kc_queue_t *q, int64_t t_us, int64_t now_us, const kc_##message##_t *m, \
                           bool vouched);
KC_IN_LIST(KC_Q_PUT_, KC_Q_NONE_)
/* Move what is due into in, as much as one step takes; the rest waits for the next. */
void kc_queue_take(kc_queue_t *q, int64_t now_us, kc_in_t *in);

#endif
