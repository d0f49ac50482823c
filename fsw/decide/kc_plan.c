#include "kc_plan.h"

#include <string.h>

_Static_assert(KC_INITIAL_MAX <= 32u, "a bit each in kc_plan_t.begun");

static bool begun(const kc_plan_t *plan, uint32_t i) { return (plan->begun >> i & 1u) != 0u; }

/* Local initial poses still to come; without those in reserve if only_due. */
static uint32_t local_left(const kc_plan_t *plan, const kc_space_t *space, bool only_due)
{
    uint32_t n = 0u;
    for (uint32_t i = 0u; i < space->n_initial; i++) {
        bool left = !begun(plan, i) && kc_space_local(space, space->initial[i]);
        n += left && (!only_due || !kc_space_reserve(space, space->initial[i])) ? 1u : 0u;
    }
    return n;
}

/* Local initial poses come on top of the requested ones: measured, current (0 or 1) and to come, as far as that is
 * known; one in reserve counts when it is taken. */
static uint32_t goal(const kc_plan_t *plan, const kc_space_t *space, uint32_t under_way)
{
    uint32_t n = plan->n_own + plan->n_local + under_way +
                 (plan->by_information ? 0u : local_left(plan, space, true));
    return n < KC_MEAS_MAX ? n : KC_MEAS_MAX;
}

void kc_plan_start(kc_plan_t *plan, const kc_space_t *space, const kc_config_t *config, uint32_t n_goal)
{
    memset(plan, 0, sizeof *plan);
    plan->n_min = config->poses_min;
    plan->by_information = config->initial_design == (uint8_t)KC_INITIAL_INFORMATION;
    plan->n_own = kc_space_n_local(space) > 0u && n_goal < plan->n_min ? plan->n_min : n_goal;
    plan->n_goal = goal(plan, space, 0u);
    for (uint32_t c = 0u; c < space->n_cand; c++) { plan->usable[c] = (uint8_t)!kc_space_local(space, c); }
}

void kc_plan_by_table(kc_plan_t *plan, const kc_space_t *space, const kc_config_t *config)
{
    kc_plan_start(plan, space, config, plan->n_own - plan->n_more);
    plan->by_information = false;
    plan->n_goal = goal(plan, space, 0u);
}

bool kc_plan_no_tags(const kc_plan_t *plan, const kc_space_t *space, const kc_config_t *config)
{
    bool nothing = plan->n_local == 0u && plan->n_tried >= config->tags_tried_min;
    bool little = 3u * plan->n_local < plan->n_tried && local_left(plan, space, false) == 0u;
    return nothing || little;
}

bool kc_plan_complete(const kc_plan_t *plan, const kc_space_t *space)
{
    return plan->n_meas >= goal(plan, space, 0u) || plan->n_obs >= KC_MEAS_MAX;
}

bool kc_plan_more(kc_plan_t *plan)
{
    if (plan->n_more == KC_PLAN_MORE_MAX || plan->n_meas >= KC_MEAS_MAX || plan->n_obs >= KC_MEAS_MAX) {
        return false;
    }
    plan->n_more++;
    plan->n_own++;
    return true;
}

bool kc_plan_enough(const kc_plan_t *plan)
{
    return plan->n_meas - plan->n_local >= (plan->n_local > 0u ? plan->n_min : 1u);
}

/* Local initial poses in reserve are taken while tags are detected at few; the last ones also while a
 * coefficient is undetermined. */
static bool reserve_needed(const kc_plan_t *plan, const kc_space_t *space, bool undetermined)
{
    return 2u * plan->n_local < plan->n_tried || (undetermined && local_left(plan, space, true) == 0u);
}

/* Initial poses in their order, without those that have become unusable. */
static bool next_initial(kc_plan_t *plan, const kc_space_t *space, bool undetermined, uint32_t *cand)
{
    for (uint32_t i = 0u; i < space->n_initial; i++) {
        if (begun(plan, i)) { continue; }
        plan->begun |= 1u << i;
        *cand = space->initial[i];
        if (kc_space_local(space, *cand)) {
            if (kc_space_reserve(space, *cand) && !reserve_needed(plan, space, undetermined)) { continue; }
            plan->n_tried++;
            return true;
        }
        if (plan->usable[*cand]) { return true; }
    }
    return false;
}

/* The first measured poses again (not the local initial poses), one after every `every` poses. */
static bool next_replicate(kc_plan_t *plan, uint32_t every, uint32_t *cand)
{
    uint32_t n = plan->n_meas - plan->n_local;
    if (every == 0u || n % every != 0u || plan->rep_at == n) { return false; }
    plan->rep_at = n;
    *cand = plan->cand_of[plan->n_local + plan->n_rep++];
    return true;
}

static uint32_t times_measured(const kc_plan_t *plan, uint32_t cand)
{
    uint32_t n = 0u;
    for (uint32_t i = 0u; i < plan->n_meas; i++) { n += plan->cand_of[i] == cand ? 1u : 0u; }
    return n;
}

bool kc_plan_local(const kc_plan_t *plan, const kc_space_t *space, uint8_t *eligible)
{
    uint32_t n = 0u;
    memset(eligible, 0, KC_CAND_MAX);
    for (uint32_t i = 0u; i < space->n_initial; i++) {
        uint32_t c = space->initial[i];
        if (begun(plan, i) || !kc_space_local(space, c) || kc_space_reserve(space, c)) { continue; }
        eligible[c] = 1u;
        n++;
    }
    return plan->by_information && n > 0u && plan->n_meas > 0u && plan->n_meas == plan->n_local &&
           plan->again == 0u;
}

void kc_plan_after_local(const kc_plan_t *plan, const kc_space_t *space, bool in_order, uint8_t *eligible)
{
    memcpy(eligible, plan->usable, sizeof plan->usable);
    if (!in_order) { return; }
    memset(eligible, 0, sizeof plan->usable);
    for (uint32_t i = 0u; i < space->n_initial; i++) {
        uint32_t c = space->initial[i];
        if (begun(plan, i) || plan->usable[c] == 0u) { continue; } /* local ones are never usable */
        eligible[c] = 1u;
        return;
    }
}

void kc_plan_begin(kc_plan_t *plan, const kc_space_t *space, uint32_t cand)
{
    for (uint32_t i = 0u; i < space->n_initial; i++) {
        if (space->initial[i] == cand) { plan->begun |= 1u << i; }
    }
    plan->n_tried += kc_space_local(space, cand) ? 1u : 0u;
}

void kc_plan_leave(kc_plan_t *plan, const kc_space_t *space, bool in_order)
{
    for (uint32_t i = 0u; i < space->n_initial; i++) {
        if (!in_order || kc_space_local(space, space->initial[i])) { plan->begun |= 1u << i; }
    }
}

void kc_plan_again(kc_plan_t *plan, uint32_t i)
{
    if (times_measured(plan, plan->cand_of[i]) == 1u) { plan->again = i + 1u; }
}

/* A local initial pose again. */
static bool next_again(kc_plan_t *plan, uint32_t *cand)
{
    if (plan->again == 0u) { return false; }
    *cand = plan->cand_of[plan->again - 1u];
    plan->again = 0u;
    plan->n_tried++;
    return true;
}

bool kc_plan_next(kc_plan_t *plan, const kc_space_t *space, uint32_t replicate_every, bool undetermined,
                  uint32_t *cand)
{
    return next_again(plan, cand) || next_initial(plan, space, undetermined, cand) ||
           next_replicate(plan, replicate_every, cand);
}

uint32_t kc_plan_choose(kc_plan_t *plan, const kc_space_t *space, uint32_t cand)
{
    plan->n_goal = goal(plan, space, kc_space_local(space, cand) ? 1u : 0u);
    return times_measured(plan, cand);
}

static void observed(kc_plan_t *plan, kc_taken_at_t taken_at)
{
    plan->pose_of[plan->n_obs] = (uint8_t)(plan->n_meas + 1u);
    plan->taken_at[plan->n_obs] = (uint8_t)taken_at;
    plan->n_obs++;
}

void kc_plan_measured(kc_plan_t *plan, const kc_space_t *space, uint32_t cand)
{
    plan->obs_of[plan->n_meas] = (uint8_t)plan->n_obs;
    observed(plan, KC_AT_CANDIDATE);
    plan->cand_of[plan->n_meas++] = (uint16_t)cand;
    plan->usable[cand] = 0u;
    plan->n_local += kc_space_local(space, cand) ? 1u : 0u;
}

void kc_plan_extra(kc_plan_t *plan, kc_taken_at_t taken_at) { observed(plan, taken_at); }

void kc_plan_drop_extra(kc_plan_t *plan) { plan->n_obs--; }

bool kc_plan_has_room(const kc_plan_t *plan)
{
    return plan->n_obs + plan->n_goal + KC_PLAN_MORE_MAX - plan->n_more < KC_MEAS_MAX + plan->n_meas;
}

bool kc_plan_only_local(const kc_plan_t *plan) { return plan->n_obs == plan->n_local; }

void kc_plan_skipped(kc_plan_t *plan, uint32_t cand) { plan->usable[cand] = 0u; }
