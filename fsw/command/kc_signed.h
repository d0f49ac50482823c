/* What the MAC of a message is over. The bytes do not depend on the transport: a label for the channel, then every
 * field, little-endian, in the order of docs/INTERFACES.md. */
#ifndef KC_SIGNED_H
#define KC_SIGNED_H

#include "kc_auth.h"
#include "kc_messages.h"

#define KC_SIGNED_HEAD_MAX 104u

/* The head is written to the caller's bytes and, like the message, has to live as long as the text. */
kc_auth_text_t kc_signed_cmd(const kc_cmd_t *cmd, uint8_t head[KC_SIGNED_HEAD_MAX]);
kc_auth_text_t kc_signed_chunk(const kc_table_chunk_t *chunk, uint8_t head[KC_SIGNED_HEAD_MAX]);

#endif
