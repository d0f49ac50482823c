#include "kc_plan.h"

#include <string.h>

_Static_assert(KC_INITIAL_MAX <= 32u, "a bit each in kc_plan_t.begun");

static bool begun(const kc_plan_t *p, uint32_t i) { return (p->begun >> i & 1u) != 0u; }

/* Local initial poses still to come; without those in reserve if only_due. */
static uint32_t local_left(const kc_plan_t *p, const kc_space_t *s, bool only_due)
{
    uint32_t n = 0u;
    for (uint32_t i = 0u; i < s->n_initial; i++) {
        bool left = !begun(p, i) && kc_space_local(s, s->initial[i]);
        n += left && (!only_due || !kc_space_reserve(s, s->initial[i])) ? 1u : 0u;
    }
    return n;
}

/* Local initial poses come on top of the requested ones: measured, current (0 or 1) and to come, as far as that is
 * known; one in reserve counts when it is taken. */
static uint32_t goal(const kc_plan_t *p, const kc_space_t *s, uint32_t under_way)
{
    uint32_t n = p->n_own + p->n_local + under_way + (p->by_information ? 0u : local_left(p, s, true));
    return n < KC_MEAS_MAX ? n : KC_MEAS_MAX;
}

void kc_plan_start(kc_plan_t *p, const kc_space_t *space, const kc_config_t *config, uint32_t n_goal)
{
    memset(p, 0, sizeof *p);
    p->n_min = config->poses_min;
    p->by_information = config->initial_design == (uint8_t)KC_INITIAL_INFORMATION;
    p->n_own = kc_space_n_local(space) > 0u && n_goal < p->n_min ? p->n_min : n_goal;
    p->n_goal = goal(p, space, 0u);
    for (uint32_t c = 0u; c < space->n_cand; c++) { p->usable[c] = (uint8_t)!kc_space_local(space, c); }
}

void kc_plan_by_table(kc_plan_t *p, const kc_space_t *space, const kc_config_t *config)
{
    kc_plan_start(p, space, config, p->n_own);
    p->by_information = false;
    p->n_goal = goal(p, space, 0u);
}

bool kc_plan_no_tags(const kc_plan_t *p, const kc_space_t *space, const kc_config_t *config)
{
    bool nothing = p->n_local == 0u && p->n_tried >= config->tags_tried_min;
    bool little = 3u * p->n_local < p->n_tried && local_left(p, space, false) == 0u;
    return nothing || little;
}

bool kc_plan_complete(const kc_plan_t *p, const kc_space_t *space)
{
    return p->n_meas >= goal(p, space, 0u) || p->n_obs >= KC_MEAS_MAX;
}

bool kc_plan_enough(const kc_plan_t *p)
{
    return p->n_meas - p->n_local >= (p->n_local > 0u ? p->n_min : 1u);
}

/* Local initial poses in reserve are taken while tags are detected at few; the last ones also while a
 * coefficient is undetermined. */
static bool reserve_needed(const kc_plan_t *p, const kc_space_t *s, bool undetermined)
{
    return 2u * p->n_local < p->n_tried || (undetermined && local_left(p, s, true) == 0u);
}

/* Initial poses in their order, without those that have become unusable. */
static bool next_initial(kc_plan_t *p, const kc_space_t *s, bool undetermined, uint32_t *cand)
{
    for (uint32_t i = 0u; i < s->n_initial; i++) {
        if (begun(p, i)) { continue; }
        p->begun |= 1u << i;
        *cand = s->initial[i];
        if (kc_space_local(s, *cand)) {
            if (kc_space_reserve(s, *cand) && !reserve_needed(p, s, undetermined)) { continue; }
            p->n_tried++;
            return true;
        }
        if (p->usable[*cand]) { return true; }
    }
    return false;
}

/* The first measured poses again (not the local initial poses), one after every `every` poses. */
static bool next_replicate(kc_plan_t *p, uint32_t every, uint32_t *cand)
{
    uint32_t n = p->n_meas - p->n_local;
    if (every == 0u || n % every != 0u || p->rep_at == n) { return false; }
    p->rep_at = n;
    *cand = p->cand_of[p->n_local + p->n_rep++];
    return true;
}

static uint32_t times_measured(const kc_plan_t *p, uint32_t cand)
{
    uint32_t n = 0u;
    for (uint32_t i = 0u; i < p->n_meas; i++) { n += p->cand_of[i] == cand ? 1u : 0u; }
    return n;
}

bool kc_plan_local(const kc_plan_t *p, const kc_space_t *space, uint8_t *eligible)
{
    uint32_t n = 0u;
    memset(eligible, 0, KC_CAND_MAX);
    for (uint32_t i = 0u; i < space->n_initial; i++) {
        uint32_t c = space->initial[i];
        if (begun(p, i) || !kc_space_local(space, c) || kc_space_reserve(space, c)) { continue; }
        eligible[c] = 1u;
        n++;
    }
    return p->by_information && n > 0u && p->n_meas > 0u && p->n_meas == p->n_local && p->again == 0u;
}

void kc_plan_after_local(const kc_plan_t *p, const kc_space_t *space, bool in_order, uint8_t *eligible)
{
    memcpy(eligible, p->usable, sizeof p->usable);
    if (!in_order) { return; }
    memset(eligible, 0, sizeof p->usable);
    for (uint32_t i = 0u; i < space->n_initial; i++) {
        uint32_t c = space->initial[i];
        if (begun(p, i) || p->usable[c] == 0u) { continue; } /* local ones are never usable */
        eligible[c] = 1u;
        return;
    }
}

void kc_plan_begin(kc_plan_t *p, const kc_space_t *space, uint32_t cand)
{
    for (uint32_t i = 0u; i < space->n_initial; i++) {
        if (space->initial[i] == cand) { p->begun |= 1u << i; }
    }
    p->n_tried += kc_space_local(space, cand) ? 1u : 0u;
}

void kc_plan_leave(kc_plan_t *p, const kc_space_t *space, bool in_order)
{
    for (uint32_t i = 0u; i < space->n_initial; i++) {
        if (!in_order || kc_space_local(space, space->initial[i])) { p->begun |= 1u << i; }
    }
}

void kc_plan_again(kc_plan_t *p, uint32_t i)
{
    if (times_measured(p, p->cand_of[i]) == 1u) { p->again = i + 1u; }
}

/* A local initial pose again. */
static bool next_again(kc_plan_t *p, uint32_t *cand)
{
    if (p->again == 0u) { return false; }
    *cand = p->cand_of[p->again - 1u];
    p->again = 0u;
    p->n_tried++;
    return true;
}

bool kc_plan_next(kc_plan_t *p, const kc_space_t *space, uint32_t replicate_every, bool undetermined,
                  uint32_t *cand)
{
    return next_again(p, cand) || next_initial(p, space, undetermined, cand) ||
           next_replicate(p, replicate_every, cand);
}

uint32_t kc_plan_choose(kc_plan_t *p, const kc_space_t *space, uint32_t cand)
{
    p->n_goal = goal(p, space, kc_space_local(space, cand) ? 1u : 0u);
    return times_measured(p, cand);
}

static void observed(kc_plan_t *p, kc_taken_at_t taken_at)
{
    p->pose_of[p->n_obs] = (uint8_t)(p->n_meas + 1u);
    p->taken_at[p->n_obs] = (uint8_t)taken_at;
    p->n_obs++;
}

void kc_plan_measured(kc_plan_t *p, const kc_space_t *space, uint32_t cand)
{
    p->obs_of[p->n_meas] = (uint8_t)p->n_obs;
    observed(p, KC_AT_CANDIDATE);
    p->cand_of[p->n_meas++] = (uint16_t)cand;
    p->usable[cand] = 0u;
    p->n_local += kc_space_local(space, cand) ? 1u : 0u;
}

void kc_plan_extra(kc_plan_t *p, kc_taken_at_t taken_at) { observed(p, taken_at); }

void kc_plan_drop_extra(kc_plan_t *p) { p->n_obs--; }

bool kc_plan_has_room(const kc_plan_t *p) { return p->n_obs + p->n_goal < KC_MEAS_MAX + p->n_meas; }

bool kc_plan_only_local(const kc_plan_t *p) { return p->n_obs == p->n_local; }

void kc_plan_skipped(kc_plan_t *p, uint32_t cand) { p->usable[cand] = 0u; }
