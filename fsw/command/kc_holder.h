/* Approval by two persons: whose a key is, and whether the second step of a change comes from another holder than the
 * first. The number of a key says whose it is: keys whose numbers have the same hundreds are one holder's (1 to 99, 101 to
 * 199, ...), so that the two keys of a rotation do not count as two persons. */
#ifndef KC_HOLDER_H
#define KC_HOLDER_H

#include <stdbool.h>

#include "kc_answer.h"
#include "kc_channels.h"
#include "kc_config.h"

#define KC_HOLDER_NUMBERS 100u /* of keys, for each holder */

bool kc_holder_same(uint32_t key_id, uint32_t other_id);
/* Whether the keys of flight have more than one holder. */
bool kc_holder_two(const kc_keys_t *keys);
/* Refused (KC_ERR_STATE) if CONFIG wants two holders and there is only one: no second step could follow. */
kc_answer_t kc_holder_possible(const kc_config_t *config, const kc_keys_t *keys, kc_out_t *out);
/* The second step, whose first one key `first` has signed. Refused (KC_ERR_AUTH) if CONFIG wants another holder. */
kc_answer_t kc_holder_second(const kc_config_t *config, uint32_t first, const kc_cmd_t *cmd, kc_out_t *out);

#endif
