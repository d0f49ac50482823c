#include "kc_queue.h"

#include <string.h>

/* Their difference may exceed 63 bits: nothing has checked either. */
static bool ahead(int64_t t_us, int64_t now_us)
{
    return t_us > now_us && (uint64_t)t_us - (uint64_t)now_us > KC_Q_AHEAD_US;
}

/* ---- accounts: whose room a message takes ---- */

#define NO_ROOM UINT32_MAX
#define CHUNKS_VOUCHED 1u

static bool same_signature(const kc_auth_t *a, const kc_auth_t *b)
{
    return a->key_id == b->key_id && a->counter == b->counter;
}

/* How many of an account wait. *copy: whether m is one of them already. */
static uint32_t cmds(const kc_queue_t *queue, uint32_t account, const kc_cmd_t *cmd, bool *copy)
{
    uint32_t n = 0u;
    for (uint32_t i = 0u; i < queue->n_cmd; i++) {
        if (queue->cmd[i].account != account) { continue; }
        n++;
        *copy = *copy || same_signature(&queue->cmd[i].m.auth, &cmd->auth);
    }
    return n;
}

static uint32_t chunks(const kc_queue_t *queue, uint32_t account, const kc_table_chunk_t *chunk, bool *copy)
{
    uint32_t n = 0u;
    for (uint32_t i = 0u; i < queue->n_chunk; i++) {
        const kc_table_chunk_t *o = &queue->chunk[i].m;
        if (queue->chunk[i].account != account) { continue; }
        n++;
        *copy = *copy || (o->source == chunk->source && same_signature(&o->auth, &chunk->auth));
    }
    return n;
}

static uint32_t account_of_cmd(const kc_queue_t *queue, const kc_cmd_t *cmd, bool vouched)
{
    bool copy = false, any = false;
    if (vouched) {
        uint32_t own = (uint32_t)cmd->source, n = cmds(queue, own, cmd, &copy);
        if (!copy && n < KC_Q_CMD_QUOTA) { return own; }
        if (!copy && cmd->opcode != KC_CMD_ABORT) { return NO_ROOM; }
    }
    uint32_t shared = cmd->opcode == KC_CMD_ABORT ? KC_Q_ABORTS : KC_Q_OTHERS;
    return cmds(queue, shared, cmd, &any) < KC_Q_CMD_QUOTA ? shared : NO_ROOM;
}

static uint32_t account_of_chunk(const kc_queue_t *queue, const kc_table_chunk_t *chunk, bool vouched)
{
    bool copy = false, any = false;
    if (vouched) {
        uint32_t n = chunks(queue, CHUNKS_VOUCHED, chunk, &copy);
        if (!copy) { return n < KC_Q_CHUNK - KC_Q_CHUNK_OTHERS ? CHUNKS_VOUCHED : NO_ROOM; }
    }
    return chunks(queue, KC_Q_OTHERS, chunk, &any) < KC_Q_CHUNK_OTHERS ? KC_Q_OTHERS : NO_ROOM;
}

/* ---- orders: what is before what ---- */

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
static int64_t late(const uint32_t *taken, uint32_t account, const kc_cmd_t *cmd)
{
    if (cmd->opcode == KC_CMD_ABORT && taken[ABORTS_TAKEN] == 0u) { return -1; }
    return account == KC_Q_ABORTS ? 1 : 0;
}

/* taken: commands of each account in this step; the one with the fewest comes next. */
static bool turn_before(const uint32_t *taken, const kc_waiting_cmd_t *w, const kc_waiting_cmd_t *o)
{
    int32_t later = (int32_t)((uint32_t)w->m.seq - (uint32_t)o->m.seq); /* numbers wrap */
    const int64_t a[4] = {late(taken, w->account, &w->m), taken[w->account], w->m.source, later};
    const int64_t b[4] = {late(taken, o->account, &o->m), taken[o->account], o->m.source, 0};
    return before(a, b, 4u);
}

/* What is vouched for comes first. */
static bool place_before(const kc_waiting_chunk_t *w, const kc_waiting_chunk_t *o)
{
    const int64_t a[4] = {-(int64_t)w->account, w->t_us, w->m.kind, w->m.offset};
    const int64_t b[4] = {-(int64_t)o->account, o->t_us, o->m.kind, o->m.offset};
    return before(a, b, 4u);
}

/* ---- commands ---- */

bool kc_queue_cmd(kc_queue_t *queue, int64_t t_us, int64_t now_us, const kc_cmd_t *cmd, bool vouched)
{
    uint32_t account = ahead(t_us, now_us) ? NO_ROOM : account_of_cmd(queue, cmd, vouched);
    if (account == NO_ROOM || queue->n_cmd >= KC_Q_CMD) { return false; }
    queue->cmd[queue->n_cmd++] = (kc_waiting_cmd_t){t_us, account, *cmd};
    return true;
}

/* Place of the one that comes next, n if none is due. */
static uint32_t first_cmd(const kc_queue_t *queue, int64_t now_us, const uint32_t *taken)
{
    uint32_t best = queue->n_cmd;
    for (uint32_t i = 0u; i < queue->n_cmd; i++) {
        if (queue->cmd[i].t_us >= now_us) { continue; }
        if (best == queue->n_cmd || turn_before(taken, &queue->cmd[i], &queue->cmd[best])) { best = i; }
    }
    return best;
}

/* ABORT counts against all that waits with it, in whichever order and steps they are taken. */
static void stop_waiting(kc_queue_t *queue, int64_t now_us)
{
    bool stop = false;
    for (uint32_t i = 0u; i < queue->n_cmd; i++) {
        stop = stop || (queue->cmd[i].t_us < now_us && queue->cmd[i].m.opcode == KC_CMD_ABORT);
    }
    for (uint32_t i = 0u; stop && i < queue->n_cmd; i++) {
        if (queue->cmd[i].t_us < now_us) { queue->cmd[i].m.stopped = 1u; }
    }
}

static void take_cmds(kc_queue_t *queue, int64_t now_us, kc_in_t *in)
{
    uint32_t i, taken[KC_Q_ACCOUNTS + 1u] = {0u};
    stop_waiting(queue, now_us);
    while (in->n_cmd < KC_CMD_QUEUE_MAX && (i = first_cmd(queue, now_us, taken)) < queue->n_cmd) {
        taken[queue->cmd[i].account]++;
        if (queue->cmd[i].m.opcode == KC_CMD_ABORT) { taken[ABORTS_TAKEN]++; }
        in->cmd[in->n_cmd++] = queue->cmd[i].m;
        queue->cmd[i] = queue->cmd[--queue->n_cmd];
    }
}

/* ---- table chunks ---- */

bool kc_queue_chunk(kc_queue_t *queue, int64_t t_us, int64_t now_us, const kc_table_chunk_t *chunk,
                    bool vouched)
{
    uint32_t account = ahead(t_us, now_us) ? NO_ROOM : account_of_chunk(queue, chunk, vouched);
    if (account == NO_ROOM || queue->n_chunk >= KC_Q_CHUNK) { return false; }
    queue->chunk[queue->n_chunk++] = (kc_waiting_chunk_t){t_us, account, *chunk};
    return true;
}

static uint32_t first_chunk(const kc_queue_t *queue, int64_t now_us)
{
    uint32_t best = queue->n_chunk;
    for (uint32_t i = 0u; i < queue->n_chunk; i++) {
        if (queue->chunk[i].t_us >= now_us) { continue; }
        if (best == queue->n_chunk || place_before(&queue->chunk[i], &queue->chunk[best])) { best = i; }
    }
    return best;
}

static void take_chunks(kc_queue_t *queue, int64_t now_us, kc_in_t *in)
{
    uint32_t i;
    while (in->n_chunk < KC_CHUNK_QUEUE_MAX && (i = first_chunk(queue, now_us)) < queue->n_chunk) {
        in->chunk[in->n_chunk++] = queue->chunk[i].m;
        queue->chunk[i] = queue->chunk[--queue->n_chunk];
    }
}

/* ---- detections, by number ---- */

bool kc_queue_det(kc_queue_t *queue, int64_t t_us, int64_t now_us, const kc_detection_t *det)
{
    if (ahead(t_us, now_us) || queue->n_det >= KC_Q_DET) { return false; }
    queue->det[queue->n_det++] = (kc_waiting_det_t){t_us, *det};
    return true;
}

static uint32_t first_det(const kc_queue_t *queue, int64_t now_us)
{
    uint32_t best = queue->n_det;
    for (uint32_t i = 0u; i < queue->n_det; i++) {
        if (queue->det[i].t_us >= now_us) { continue; }
        if (best == queue->n_det || queue->det[i].m.seq < queue->det[best].m.seq) { best = i; }
    }
    return best;
}

static void take_dets(kc_queue_t *queue, int64_t now_us, kc_in_t *in)
{
    uint32_t i;
    while (in->n_det < KC_DET_QUEUE_MAX && (i = first_det(queue, now_us)) < queue->n_det) {
        in->det[in->n_det++] = queue->det[i].m;
        queue->det[i] = queue->det[--queue->n_det];
    }
}

void kc_queue_take(kc_queue_t *queue, int64_t now_us, kc_in_t *in)
{
    take_cmds(queue, now_us, in);
    take_chunks(queue, now_us, in);
    take_dets(queue, now_us, in);
}
