/* Messages of other participants wait here until they are due, and leave in an order that does not
 * depend on when they arrived: commands of one source by number, sources in turn, table chunks by kind and
 * offset (time first, so that one upload follows the other), detections by frame number.
 *
 * Due means: stamped earlier than now. In lockstep all of those have arrived when a tick begins. */
#ifndef KC_QUEUE_H
#define KC_QUEUE_H

#include <stdbool.h>

#include "kc_app.h"

#define KC_Q_CMD 32u
/* Commands of one source that may wait, so that none crowds out another; all unknown sources count as one.
 * ABORT finds room beyond: 2 x (8 + 4) + 8 = KC_Q_CMD. */
#define KC_Q_CMD_QUOTA 8u
#define KC_Q_CMD_ABORTS 4u
#define KC_Q_CHUNK 32u
#define KC_Q_DET 8u
#define KC_Q_AHEAD_US 10000000 /* a stamp further ahead than this will not be waited for */

#define KC_Q_NONE_(...)
#define KC_Q_WAITING_(CHANNEL, member, message, copied, order, step, room) \
    uint32_t n_##member;                                                   \
    struct {                                                               \
        int64_t t_us;                                                      \
        kc_##message##_t m;                                                \
    } member[room]; /* NOLINT(bugprone-macro-parentheses): a declaration */
typedef struct {
    KC_IN_LIST(KC_Q_WAITING_, KC_Q_NONE_)
} kc_queue_t;

/* kc_queue_cmd and so on, one for each queued channel: whether it waits now; false if there is no room or the stamp lies too far ahead of now: the message is lost. */
#define KC_Q_PUT_(CHANNEL, member, message, copied, order, step, room) \
    bool kc_queue_##member(kc_queue_t *q, int64_t t_us, int64_t now_us, const kc_##message##_t *m);
KC_IN_LIST(KC_Q_PUT_, KC_Q_NONE_)
/* Move what is due into in, as much as one step takes; the rest waits for the next. */
void kc_queue_take(kc_queue_t *q, int64_t now_us, kc_in_t *in);

#endif
