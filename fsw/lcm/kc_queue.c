#include "kc_queue.h"

#include <string.h>

/* Their difference may exceed 63 bits: nothing has checked either. */
static bool ahead(int64_t t_us, int64_t now_us)
{
    return t_us > now_us && (uint64_t)t_us - (uint64_t)now_us > KC_Q_AHEAD_US;
}

/* The quota of a command: that of its source, 0 for all unknown ones. */
static uint32_t account(const kc_cmd_t *m)
{
    return m->source >= 1 && m->source <= (int32_t)KC_SOURCE_MAX ? (uint32_t)m->source : 0u;
}

static uint32_t room(const kc_queue_t *q, const kc_cmd_t *m)
{
    uint32_t n = 0u;
    uint32_t most = KC_Q_CMD_QUOTA;
    if (m->opcode == KC_CMD_ABORT && account(m) != 0u) { most += KC_Q_CMD_ABORTS; }
    for (uint32_t i = 0u; i < q->n_cmd; i++) { n += account(&q->cmd[i].m) == account(m); }
    return n < most ? most - n : 0u;
}

static bool over_quota(const kc_queue_t *q, const kc_cmd_t *m) { return room(q, m) == 0u; }

/* ---- orders of KC_IN_LIST: what is before what, what is refused besides when the queue is full ---- */

/* Order of two messages: by the first pair of keys that differs. */
static bool before(const int64_t *a, const int64_t *b, uint32_t n)
{
    for (uint32_t i = 0u; i < n; i++) {
        if (a[i] != b[i]) { return a[i] < b[i]; }
    }
    return false;
}

/* taken: commands of each account in this step; the one with the fewest comes next. */
static bool turn_before(const uint32_t *taken, const kc_cmd_t *m, const kc_cmd_t *o)
{
    int32_t later = (int32_t)((uint32_t)m->seq - (uint32_t)o->seq); /* numbers wrap */
    const int64_t a[3] = {taken[account(m)], m->source, later};
    const int64_t b[3] = {taken[account(o)], o->source, 0};
    return before(a, b, 3u);
}

static bool place_before(int64_t m_us, const kc_chunk_t *m, int64_t o_us, const kc_chunk_t *o)
{
    const int64_t a[3] = {m_us, m->kind, m->offset};
    const int64_t b[3] = {o_us, o->kind, o->offset};
    return before(a, b, 3u);
}

#define BEFORE_TURN(taken, a, b) turn_before((taken), &(a)->m, &(b)->m)
#define BEFORE_PLACE(taken, a, b) place_before((a)->t_us, &(a)->m, (b)->t_us, &(b)->m)
#define BEFORE_SEQ(taken, a, b) ((a)->m.seq < (b)->m.seq)
#define REFUSED_TURN(q, m) over_quota((q), (m))
#define REFUSED_PLACE(q, m) false
#define REFUSED_SEQ(q, m) false
#define TOOK_TURN(taken, m) (taken)[account(m)]++;
#define TOOK_PLACE(taken, m)
#define TOOK_SEQ(taken, m)

/* ---- the queues of the list ---- */

#define PUT(CHANNEL, member, message, copied, order, step, room)                                       \
    bool kc_queue_##member(kc_queue_t *q, int64_t t_us, int64_t now_us, const kc_##message##_t *m)     \
    {                                                                                                  \
        if (q->n_##member >= (room) || REFUSED_##order(q, m) || ahead(t_us, now_us)) { return false; } \
        q->member[q->n_##member].t_us = t_us;                                                          \
        q->member[q->n_##member++].m = *m;                                                             \
        return true;                                                                                   \
    }
KC_IN_LIST(PUT, KC_Q_NONE_)

/* Place of the one that comes next, n if none is due. */
#define FIRST(CHANNEL, member, message, copied, order, step, room)                                 \
    static uint32_t first_##member(const kc_queue_t *q, int64_t now_us, const uint32_t *taken)     \
    {                                                                                              \
        uint32_t best = q->n_##member;                                                             \
        (void)taken;                                                                               \
        for (uint32_t i = 0u; i < q->n_##member; i++) {                                            \
            if (q->member[i].t_us >= now_us) { continue; }                                         \
            if (best == q->n_##member || BEFORE_##order(taken, &q->member[i], &q->member[best])) { \
                best = i;                                                                          \
            }                                                                                      \
        }                                                                                          \
        return best;                                                                               \
    }
KC_IN_LIST(FIRST, KC_Q_NONE_)

#define TAKE(CHANNEL, member, message, copied, order, step, room)                               \
    while (in->n_##member < (step) && (i = first_##member(q, now_us, taken)) < q->n_##member) { \
        TOOK_##order(taken, &q->member[i].m) in->member[in->n_##member++] = q->member[i].m;     \
        q->member[i] = q->member[--q->n_##member];                                              \
    }
void kc_queue_take(kc_queue_t *q, int64_t now_us, kc_in_t *in)
{
    uint32_t i, taken[KC_SOURCE_MAX + 1u] = {0u};
    KC_IN_LIST(TAKE, KC_Q_NONE_)
}
