#include "kc_queue.h"

#include <string.h>

/* Their difference may exceed 63 bits: nothing has checked either. */
static bool ahead(int64_t t_us, int64_t now_us)
{
    return t_us > now_us && (uint64_t)t_us - (uint64_t)now_us > KC_Q_AHEAD_US;
}

/* ---- accounts of KC_IN_LIST: whose room a message takes ---- */

#define NO_ROOM UINT32_MAX
#define CHUNKS_VOUCHED 1u

static bool same_signature(const kc_auth_t *a, const kc_auth_t *b)
{
    return a->key_id == b->key_id && a->counter == b->counter;
}

/* How many of an account wait. *copy: whether m is one of them already. */
static uint32_t cmds(const kc_queue_t *q, uint32_t account, const kc_cmd_t *m, bool *copy)
{
    uint32_t n = 0u;
    for (uint32_t i = 0u; i < q->n_cmd; i++) {
        if (q->cmd[i].account != account) { continue; }
        n++;
        *copy = *copy || same_signature(&q->cmd[i].m.auth, &m->auth);
    }
    return n;
}

static uint32_t chunks(const kc_queue_t *q, uint32_t account, const kc_chunk_t *m, bool *copy)
{
    uint32_t n = 0u;
    for (uint32_t i = 0u; i < q->n_chunk; i++) {
        const kc_chunk_t *o = &q->chunk[i].m;
        if (q->chunk[i].account != account) { continue; }
        n++;
        *copy = *copy || (o->source == m->source && same_signature(&o->auth, &m->auth));
    }
    return n;
}

static uint32_t account_of_cmd(const kc_queue_t *q, const kc_cmd_t *m, bool vouched)
{
    bool copy = false, any = false;
    if (vouched) {
        uint32_t own = (uint32_t)m->source, n = cmds(q, own, m, &copy);
        if (!copy && n < KC_Q_CMD_QUOTA) { return own; }
        if (!copy && m->opcode != KC_CMD_ABORT) { return NO_ROOM; }
    }
    uint32_t shared = m->opcode == KC_CMD_ABORT ? KC_Q_ABORTS : KC_Q_OTHERS;
    return cmds(q, shared, m, &any) < KC_Q_CMD_QUOTA ? shared : NO_ROOM;
}

static uint32_t account_of_chunk(const kc_queue_t *q, const kc_chunk_t *m, bool vouched)
{
    bool copy = false, any = false;
    if (vouched) {
        uint32_t n = chunks(q, CHUNKS_VOUCHED, m, &copy);
        if (!copy) { return n < KC_Q_CHUNK - KC_Q_CHUNK_OTHERS ? CHUNKS_VOUCHED : NO_ROOM; }
    }
    return chunks(q, KC_Q_OTHERS, m, &any) < KC_Q_CHUNK_OTHERS ? KC_Q_OTHERS : NO_ROOM;
}

#define ACCOUNT_TURN(q, m, vouched) account_of_cmd((q), (m), (vouched))
#define ACCOUNT_PLACE(q, m, vouched) account_of_chunk((q), (m), (vouched))
#define ACCOUNT_SEQ(q, m, vouched) ((q)->n_det < KC_Q_DET ? KC_Q_OTHERS : NO_ROOM)

/* ---- orders of KC_IN_LIST: what is before what ---- */

/* Order of two messages: by the first pair of keys that differs. */
static bool before(const int64_t *a, const int64_t *b, uint32_t n)
{
    for (uint32_t i = 0u; i < n; i++) {
        if (a[i] != b[i]) { return a[i] < b[i]; }
    }
    return false;
}

#define ABORTS_TAKEN KC_Q_ACCOUNTS /* place of their number behind those of the accounts */

/* The first ABORT of a step comes first, whoever sent it and however much waits; further ones that nobody vouches for come
 * last: they change nothing any more. */
static int64_t late(const uint32_t *taken, uint32_t account, const kc_cmd_t *m)
{
    if (m->opcode == KC_CMD_ABORT && taken[ABORTS_TAKEN] == 0u) { return -1; }
    return account == KC_Q_ABORTS ? 1 : 0;
}

/* taken: commands of each account in this step; the one with the fewest comes next. */
static bool turn_before(const uint32_t *taken, uint32_t m_account, const kc_cmd_t *m, uint32_t o_account,
                        const kc_cmd_t *o)
{
    int32_t later = (int32_t)((uint32_t)m->seq - (uint32_t)o->seq); /* numbers wrap */
    const int64_t a[4] = {late(taken, m_account, m), taken[m_account], m->source, later};
    const int64_t b[4] = {late(taken, o_account, o), taken[o_account], o->source, 0};
    return before(a, b, 4u);
}

static void took_turn(uint32_t *taken, uint32_t account, const kc_cmd_t *m)
{
    taken[account]++;
    if (m->opcode == KC_CMD_ABORT) { taken[ABORTS_TAKEN]++; }
}

/* What is vouched for comes first. */
static bool place_before(uint32_t m_account, int64_t m_us, const kc_chunk_t *m, uint32_t o_account,
                         int64_t o_us, const kc_chunk_t *o)
{
    const int64_t a[4] = {-(int64_t)m_account, m_us, m->kind, m->offset};
    const int64_t b[4] = {-(int64_t)o_account, o_us, o->kind, o->offset};
    return before(a, b, 4u);
}

#define BEFORE_TURN(taken, a, b) turn_before((taken), (a)->account, &(a)->m, (b)->account, &(b)->m)
#define BEFORE_PLACE(taken, a, b) \
    place_before((a)->account, (a)->t_us, &(a)->m, (b)->account, (b)->t_us, &(b)->m)
#define BEFORE_SEQ(taken, a, b) ((a)->m.seq < (b)->m.seq)
#define TOOK_TURN(taken, w) took_turn((taken), (w)->account, &(w)->m);
#define TOOK_PLACE(taken, w)
#define TOOK_SEQ(taken, w)

/* ---- the queues of the list ---- */

#define PUT(CHANNEL, member, message, copied, order, step, room)                                   \
    bool kc_queue_##member(kc_queue_t *q, int64_t t_us, int64_t now_us, const kc_##message##_t *m, \
                           bool vouched)                                                           \
    {                                                                                              \
        (void)vouched;                                                                             \
        uint32_t account = ahead(t_us, now_us) ? NO_ROOM : ACCOUNT_##order(q, m, vouched);         \
        if (account == NO_ROOM || q->n_##member >= (room)) { return false; }                       \
        q->member[q->n_##member].t_us = t_us;                                                      \
        q->member[q->n_##member].account = account;                                                \
        q->member[q->n_##member++].m = *m;                                                         \
        return true;                                                                               \
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

#define TAKE(CHANNEL, member, message, copied, order, step, room)                                \
    while (in->n_##member < (step) && (i = first_##member(q, now_us, taken)) < q->n_##member) {  \
        TOOK_##order(taken, &q->member[i]) in->member[in->n_##member++] = q->member[i].m; \
        q->member[i] = q->member[--q->n_##member];                                               \
    }
/* ABORT counts against all that waits with it, in whichever order and steps they are taken. */
static void stop_waiting(kc_queue_t *q, int64_t now_us)
{
    bool stop = false;
    for (uint32_t i = 0u; i < q->n_cmd; i++) {
        stop = stop || (q->cmd[i].t_us < now_us && q->cmd[i].m.opcode == KC_CMD_ABORT);
    }
    for (uint32_t i = 0u; stop && i < q->n_cmd; i++) {
        if (q->cmd[i].t_us < now_us) { q->cmd[i].m.stopped = 1u; }
    }
}

void kc_queue_take(kc_queue_t *q, int64_t now_us, kc_in_t *in)
{
    uint32_t i, taken[KC_Q_ACCOUNTS + 1u] = {0u};
    stop_waiting(q, now_us);
    KC_IN_LIST(TAKE, KC_Q_NONE_)
}
