/* Which poses a calibration measures, and how many: the initial design in its order, replicates, and what is
 * left to the acquisition. Observations on the way to a pose are no poses: they are held beside them, as far as there
 * is room. */
#ifndef KC_PLAN_H
#define KC_PLAN_H

#include <stdbool.h>

#include "kc_tables.h"

/* Poses beyond those requested: enough to tell one bad detection from an arm that has changed. */
#define KC_PLAN_MORE_MAX 2u

/* Where an observation was taken. */
typedef enum {
    KC_AT_CANDIDATE = 0, /* it is that of a pose */
    KC_AT_ARRIVAL = 1,   /* on the way to one: where the arm came to rest before the first servo step ... */
    KC_AT_SERVO_STEP = 2, /* ... and after a servo step */
    KC_AT_STOP = 3 /* at a stop on the segment to it */
} kc_taken_at_t;

typedef struct {
    uint32_t n_min;            /* fewest of them that a proposal needs */
    uint32_t n_own;            /* poses requested, local initial poses not counted; with n_more */
    uint32_t n_more;           /* poses beyond those requested */
    uint32_t n_goal;           /* poses in all, as far as is known */
    uint32_t n_meas;           /* measured */
    uint32_t n_obs;            /* observations: of these, and on the way to poses */
    uint32_t n_tried, n_local; /* local initial poses begun, measured */
    uint32_t begun;            /* initial poses begun or passed over: a bit each, in the order of SPACE */
    bool by_information;       /* initial poses are chosen, as many as are needed (kc_local.h) */
    uint32_t again;            /* measurement whose pose is the next, from 1; 0: none */
    uint32_t n_rep, rep_at;    /* replicates done; poses measured when the last was chosen */
    uint16_t cand_of[KC_MEAS_MAX]; /* candidate of each measured pose */
    uint8_t obs_of[KC_MEAS_MAX];   /* observation of each measured pose, from 0 */
    uint8_t pose_of[KC_MEAS_MAX]; /* pose of each observation, from 1; on the way: the one that comes next */
    uint8_t taken_at[KC_MEAS_MAX]; /* each observation, kc_taken_at_t */
    uint8_t usable[KC_CAND_MAX]; /* what the acquisition may choose; never local initial poses */
} kc_plan_t;

/* n_goal: poses requested; with local initial poses, which come on top, at least those a proposal needs. */
void kc_plan_start(kc_plan_t *plan, const kc_space_t *space, const kc_config_t *config, uint32_t n_goal);
/* Begin again: all initial poses, in the order of the table. */
void kc_plan_by_table(kc_plan_t *plan, const kc_space_t *space, const kc_config_t *config);
/* Local initial poses without tags: too few detections to determine the errors of the arm. Without any it
 * makes no larger moves, and with hardly any it does not leave the park pose. */
bool kc_plan_no_tags(const kc_plan_t *plan, const kc_space_t *space, const kc_config_t *config);
/* Everything that was requested is measured, or no more observations can be held. */
bool kc_plan_complete(const kc_plan_t *plan, const kc_space_t *space);
/* One pose beyond those requested; false if KC_PLAN_MORE_MAX were added already, or no more can be held. */
bool kc_plan_more(kc_plan_t *plan);
/* Measured enough for a proposal: local initial poses alone never are. */
bool kc_plan_enough(const kc_plan_t *plan);
/* Next pose that is not the acquisition's to choose: an initial pose or a replicate; false if there is none.
 * undetermined: the estimate leaves coefficients open, so reserve poses are of use. */
bool kc_plan_next(kc_plan_t *plan, const kc_space_t *space, uint32_t replicate_every, bool undetermined,
                  uint32_t *cand);
/* Whether local initial poses may be chosen by information: none but them was measured, none is to be repeated, and
 * eligible[] (KC_CAND_MAX), those that are left but for the reserve, is not empty. */
bool kc_plan_local(const kc_plan_t *plan, const kc_space_t *space, uint8_t *eligible);
/* What may come after them: every candidate, or (in_order) the next initial pose of SPACE, if there is one left. */
void kc_plan_after_local(const kc_plan_t *plan, const kc_space_t *space, bool in_order, uint8_t *eligible);
/* An initial pose is begun that was chosen so. */
void kc_plan_begin(kc_plan_t *plan, const kc_space_t *space, uint32_t cand);
/* The arm leaves the park pose: no local initial poses any more; without in_order no other ones either. */
void kc_plan_leave(kc_plan_t *plan, const kc_space_t *space, bool in_order);
/* The local initial pose of measurement i (from 0) is measured again, the next time; nothing if it was already. */
void kc_plan_again(kc_plan_t *plan, uint32_t i);
/* Candidate chosen: n_goal counts it. Returns how many times it was measured before. */
uint32_t kc_plan_choose(kc_plan_t *plan, const kc_space_t *space, uint32_t cand);
void kc_plan_measured(kc_plan_t *plan, const kc_space_t *space, uint32_t cand);
/* An observation was taken on the way to the candidate chosen. */
void kc_plan_extra(kc_plan_t *plan, kc_taken_at_t taken_at);
/* The newest observation, which is one of these, is dropped. */
void kc_plan_drop_extra(kc_plan_t *plan);
/* Whether one may be: there is room for it and for all poses still to come, those beyond the requested ones too. */
bool kc_plan_has_room(const kc_plan_t *plan);
/* Whether every observation is that of a local initial pose. */
bool kc_plan_only_local(const kc_plan_t *plan);
void kc_plan_skipped(kc_plan_t *plan, uint32_t cand);

#endif
