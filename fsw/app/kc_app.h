/* KinCal as a component. kc_app_step is its only entry: time and messages in, messages out; no clock,
 * file or socket is touched, and the same inputs give the same outputs to the byte. */
#ifndef KC_APP_H
#define KC_APP_H

#include <stdbool.h>
#include <stdint.h>

#include "kc_auth.h"
#include "kc_channels.h"
#include "kc_states.h"
#include "kc_tables.h"

/* The component's whole state; static, caller owns it, callers touch nothing inside. */
struct kc_app;
typedef struct kc_app kc_app_t;
extern kc_app_t kc_app_instance; /* the one instance of the flight process */

/* Start. Tables come next through kc_app_load, then kc_app_boot. */
void kc_app_init(kc_app_t *app);
/* The keys whose holders may command, before boot. Without them only what needs no signature is taken. */
void kc_app_keys(kc_app_t *app, const kc_keys_t *keys);
/* Offer a stored or default image before boot: the edge offers every image it finds, best first (newest
 * slot, older slot, default of the table directory); the first good one of each kind wins, of KIN, PREV and
 * PROPOSAL the one that the journal names. kind as in kc_store_t. n = 0: a copy that cannot be read, BOOT_SLOT_BAD.
 * KC_ERR_* : refused, offer the next. Order of kinds: JOURNAL, 1..7, PREV, PROPOSAL. */
kc_status_t kc_app_load(kc_app_t *app, uint16_t kind, const uint8_t *data, uint32_t n);
/* KC_IMAGE_MAX bytes into which the edge may read what it offers, until kc_app_boot: nothing is staged before. */
uint8_t *kc_app_image_room(kc_app_t *app);
/* All offered: records events for what is missing and for the state in which the last run ended; they come
 * out of the first step. */
void kc_app_boot(kc_app_t *app);
/* One tick. now_us: mission time, the clock that stamps messages. Where it stands still, steps back or steps
 * ahead, one tick counts as elapsed; time-outs go by elapsed time and see nothing of a step. */
void kc_app_step(kc_app_t *app, uint64_t now_us, const kc_in_t *in, kc_out_t *out);

/* Whether a step would take the signature of this message as things stand. For the edge: what a holder of a key sent
 * finds room that others cannot take. Nothing is taken or admitted by it. *macs: how many MACs may still be computed,
 * each of kc_auth_cost instructions, counted down; at 0 the answer is false. */
bool kc_app_vouches_cmd(const kc_app_t *app, const kc_cmd_t *cmd, uint32_t *macs);
bool kc_app_vouches_chunk(const kc_app_t *app, const kc_table_chunk_t *chunk, uint32_t *macs);

/* For tests and the ground: the active tables. */
const kc_active_t *kc_app_active(const kc_app_t *app);
kc_state_t kc_app_state(const kc_app_t *app);

#endif
