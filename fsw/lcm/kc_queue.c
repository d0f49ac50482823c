#include "kc_queue.h"

#include <string.h>

static bool ahead(int64_t t_us, int64_t now_us) { return t_us > now_us && t_us - now_us > KC_Q_AHEAD_US; }

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

bool kc_queue_cmd(kc_queue_t *q, int64_t t_us, int64_t now_us, const kc_cmd_t *m)
{
    if (room(q, m) == 0u || ahead(t_us, now_us)) { return false; }
    q->cmd[q->n_cmd].t_us = t_us;
    q->cmd[q->n_cmd++].m = *m;
    return true;
}

bool kc_queue_chunk(kc_queue_t *q, int64_t t_us, int64_t now_us, const kc_chunk_t *m)
{
    if (q->n_chunk == KC_Q_CHUNK || ahead(t_us, now_us)) { return false; }
    q->chunk[q->n_chunk].t_us = t_us;
    q->chunk[q->n_chunk++].m = *m;
    return true;
}

bool kc_queue_det(kc_queue_t *q, int64_t t_us, int64_t now_us, const kc_detection_t *m)
{
    if (q->n_det == KC_Q_DET || ahead(t_us, now_us)) { return false; }
    q->det[q->n_det].t_us = t_us;
    q->det[q->n_det++].m = *m;
    return true;
}

/* Order of two messages: by the first pair of keys that differs. */
static bool before(const int64_t *a, const int64_t *b, uint32_t n)
{
    for (uint32_t i = 0u; i < n; i++) {
        if (a[i] != b[i]) { return a[i] < b[i]; }
    }
    return false;
}

/* taken: commands of each account in this step; the one with the fewest comes next. */
static uint32_t first_cmd(const kc_queue_t *q, int64_t now_us, const uint32_t *taken)
{
    uint32_t best = q->n_cmd;
    for (uint32_t i = 0u; i < q->n_cmd; i++) {
        if (q->cmd[i].t_us >= now_us) { continue; }
        const kc_cmd_t *m = &q->cmd[i].m, *o = &q->cmd[best % KC_Q_CMD].m;
        int32_t later = (int32_t)((uint32_t)m->seq - (uint32_t)o->seq); /* numbers wrap */
        const int64_t a[3] = {taken[account(m)], m->source, later};
        const int64_t b[3] = {taken[account(o)], o->source, 0};
        if (best == q->n_cmd || before(a, b, 3u)) { best = i; }
    }
    return best;
}

static uint32_t first_chunk(const kc_queue_t *q, int64_t now_us)
{
    uint32_t best = q->n_chunk;
    for (uint32_t i = 0u; i < q->n_chunk; i++) {
        if (q->chunk[i].t_us >= now_us) { continue; }
        const uint32_t k = best % KC_Q_CHUNK;
        const int64_t a[3] = {q->chunk[i].t_us, q->chunk[i].m.kind, q->chunk[i].m.offset};
        const int64_t b[3] = {q->chunk[k].t_us, q->chunk[k].m.kind, q->chunk[k].m.offset};
        if (best == q->n_chunk || before(a, b, 3u)) { best = i; }
    }
    return best;
}

static uint32_t first_det(const kc_queue_t *q, int64_t now_us)
{
    uint32_t best = q->n_det;
    for (uint32_t i = 0u; i < q->n_det; i++) {
        if (q->det[i].t_us >= now_us) { continue; }
        if (best == q->n_det || q->det[i].m.seq < q->det[best].m.seq) { best = i; }
    }
    return best;
}

void kc_queue_take(kc_queue_t *q, int64_t now_us, kc_in_t *in)
{
    uint32_t i, taken[KC_SOURCE_MAX + 1u] = {0u};
    while (in->n_cmd < KC_CMD_QUEUE_MAX && (i = first_cmd(q, now_us, taken)) < q->n_cmd) {
        taken[account(&q->cmd[i].m)]++;
        in->cmd[in->n_cmd++] = q->cmd[i].m;
        q->cmd[i] = q->cmd[--q->n_cmd];
    }
    while (in->n_chunk < KC_CHUNK_QUEUE_MAX && (i = first_chunk(q, now_us)) < q->n_chunk) {
        in->chunk[in->n_chunk++] = q->chunk[i].m;
        q->chunk[i] = q->chunk[--q->n_chunk];
    }
    while (in->n_det < KC_DET_QUEUE_MAX && (i = first_det(q, now_us)) < q->n_det) {
        in->det[in->n_det++] = q->det[i].m;
        q->det[i] = q->det[--q->n_det];
    }
}
