#include "kc_queue.h"

#include <string.h>

static int ahead(int64_t t_us, int64_t now_us) { return t_us > now_us && t_us - now_us > KC_Q_AHEAD_US; }

int kc_queue_cmd(kc_queue_t *q, int64_t t_us, int64_t now_us, const kc_cmd_t *m)
{
    if (q->n_cmd == KC_Q_CMD || ahead(t_us, now_us)) { return -1; }
    q->cmd[q->n_cmd].t_us = t_us;
    q->cmd[q->n_cmd++].m = *m;
    return 0;
}

int kc_queue_chunk(kc_queue_t *q, int64_t t_us, int64_t now_us, const kc_chunk_t *m)
{
    if (q->n_chunk == KC_Q_CHUNK || ahead(t_us, now_us)) { return -1; }
    q->chunk[q->n_chunk].t_us = t_us;
    q->chunk[q->n_chunk++].m = *m;
    return 0;
}

int kc_queue_det(kc_queue_t *q, int64_t t_us, int64_t now_us, const kc_detection_t *m)
{
    if (q->n_det == KC_Q_DET || ahead(t_us, now_us)) { return -1; }
    q->det[q->n_det].t_us = t_us;
    q->det[q->n_det++].m = *m;
    return 0;
}

/* Order of two messages: by the first pair of keys that differs. */
static int before(const int64_t *a, const int64_t *b, uint32_t n)
{
    for (uint32_t i = 0u; i < n; i++) {
        if (a[i] != b[i]) { return a[i] < b[i]; }
    }
    return 0;
}

static uint32_t first_cmd(const kc_queue_t *q, int64_t now_us)
{
    uint32_t best = q->n_cmd;
    for (uint32_t i = 0u; i < q->n_cmd; i++) {
        if (q->cmd[i].t_us >= now_us) { continue; }
        const int64_t a[2] = {q->cmd[i].m.source, q->cmd[i].m.seq};
        const int64_t b[2] = {q->cmd[best % KC_Q_CMD].m.source, q->cmd[best % KC_Q_CMD].m.seq};
        if (best == q->n_cmd || before(a, b, 2u)) { best = i; }
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
    uint32_t i;
    while (in->n_cmd < KC_CMD_QUEUE_MAX && (i = first_cmd(q, now_us)) < q->n_cmd) {
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
