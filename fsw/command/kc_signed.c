#include "kc_signed.h"

#include <string.h>

#include "kc_codec.h"

#define LABEL_BYTES 16u

static kc_walk_t begin(uint8_t *head, const char *label)
{
    kc_walk_t w;
    memset(&w, 0, sizeof w);
    w.mode = KC_WALK_WRITE;
    w.out = head;
    w.cap = KC_SIGNED_HEAD_MAX;
    w.index = -1;
    memcpy(head, label, LABEL_BYTES);
    w.pos = LABEL_BYTES;
    return w;
}

static void u32(kc_walk_t *walk, uint32_t x) { kc_walk_u32(walk, 0u, &x, 0u, UINT32_MAX); }

static void i32(kc_walk_t *walk, int32_t x) { kc_walk_i32(walk, 0u, &x, INT32_MIN, INT32_MAX); }

static void u64(kc_walk_t *walk, uint64_t x) { kc_walk_u64(walk, 0u, &x, 0u, UINT64_MAX); }

static void sender(kc_walk_t *walk, const kc_auth_t *auth, uint64_t t_us, int32_t source)
{
    u32(walk, auth->key_id);
    u64(walk, auth->counter);
    u64(walk, t_us);
    i32(walk, source);
}

kc_auth_text_t kc_signed_cmd(const kc_cmd_t *cmd, uint8_t head[KC_SIGNED_HEAD_MAX])
{
    uint64_t bits;
    kc_walk_t w = begin(head, "KinCal command 1");
    sender(&w, &cmd->auth, cmd->t_us, cmd->source);
    i32(&w, cmd->seq);
    i32(&w, cmd->opcode);
    for (uint32_t i = 0u; i < 4u; i++) { i32(&w, cmd->arg_i[i]); }
    u64(&w, cmd->arg_u64);
    for (uint32_t i = 0u; i < 4u; i++) {
        memcpy(&bits, &cmd->arg_d[i], sizeof bits); /* whatever it is, also not a number */
        u64(&w, bits);
    }
    return (kc_auth_text_t){.head = head, .n_head = w.pos};
}

kc_auth_text_t kc_signed_chunk(const kc_table_chunk_t *chunk, uint8_t head[KC_SIGNED_HEAD_MAX])
{
    kc_walk_t w = begin(head, "KinCal chunk 1\0");
    sender(&w, &chunk->auth, chunk->t_us, chunk->source);
    i32(&w, chunk->kind);
    u32(&w, chunk->total);
    u32(&w, chunk->offset);
    u32(&w, chunk->n);
    return (kc_auth_text_t){.head = head, .n_head = w.pos, .body = chunk->data, .n_body = KC_CHUNK_BYTES};
}
