#include "kc_holder.h"

bool kc_holder_same(uint32_t key_id, uint32_t other_id)
{
    return key_id / KC_HOLDER_NUMBERS == other_id / KC_HOLDER_NUMBERS;
}

bool kc_holder_two(const kc_keys_t *keys)
{
    bool two = false;
    for (uint32_t i = 1u; i < KC_KEY_MAX; i++) {
        two = two || (i < keys->n && !kc_holder_same(keys->key[0].id, keys->key[i].id));
    }
    return two;
}

kc_answer_t kc_holder_possible(const kc_config_t *config, const kc_keys_t *keys, kc_out_t *out)
{
    if (config->go_by_other_key == 0u || kc_holder_two(keys)) { return kc_answer_ok(KC_OC_STAY); }
    return kc_answer_refuse(&out->events, KC_EVT_KEYS_ONE_HOLDER, -1, (double)keys->n, 0.0, KC_ERR_STATE);
}

kc_answer_t kc_holder_second(const kc_config_t *config, uint32_t first, const kc_cmd_t *cmd, kc_out_t *out)
{
    uint32_t second = cmd->auth.key_id;
    if (config->go_by_other_key == 0u || !kc_holder_same(first, second)) { return kc_answer_ok(KC_OC_STAY); }
    return kc_answer_refuse(&out->events, KC_EVT_CMD_SAME_KEY, cmd->opcode, (double)second, (double)first,
                            KC_ERR_AUTH);
}
