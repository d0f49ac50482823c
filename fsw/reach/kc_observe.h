/* OBSERVE, SEARCH, TURN: what a frame shows, the next servo step, the pan-tilt search along a spiral. */
#ifndef KC_OBSERVE_H
#define KC_OBSERVE_H

#include "kc_channels.h"
#include "kc_pantilt.h"
#include "kc_reach.h"
#include "kc_request.h"
#include "kc_view.h"

/* All of it belongs to the current candidate. */
typedef struct {
    kc_tried_t tried;
    uint32_t servo_steps;
    uint32_t i_search;                     /* place on the spiral */
    double middle_pan_rad, middle_tilt_rad; /* of the search */
    kc_pose_t measured, predicted; /* tool in base, camera corrections applied; model */
    double off_m[3];               /* measured less predicted position */
    double q_detected[KC_JOINT_MAX]; /* joints at the last detection */
    double q_servo[KC_JOINT_MAX];    /* where the next servo step goes */
    kc_servo_mem_t servo;
    bool at_stop;
    bool extra_held; /* the last extra observation is the newest of all, at last_extra ... */
    bool same_place; /* ... and the pose is measured there too */
    kc_taken_at_t taken_at; /* what MEASURE measures */
    uint32_t n_extra;      /* observations begun on the way to this candidate, */
    kc_pose_t last_extra;  /* and where the tool was at the last one */
} kc_observe_t;

/* A new candidate. */
void kc_observe_begin(kc_observe_t *observe);
/* The pan-tilt unit was aimed: a search starts from here. */
void kc_observe_aimed(kc_observe_t *observe, const kc_pantilt_t *pantilt);
/* At a stop on the way to the candidate; back on the way. */
void kc_observe_at_stop(kc_observe_t *observe, bool at_stop);
/* OBSERVE: SERVO (to q_servo), MEASURE (of taken_at), APPROACH, SEED, RETREAT (to q_detected), SEARCH or SKIP; at a stop
 * MEASURE or ONWARD. */
kc_outcome_t kc_observe_run(kc_observe_t *observe, kc_request_t *request, const kc_view_t *view,
                            kc_out_t *out);
/* What MEASURE has come to. On the way an observation is of use, but not needed: done or not, SERVO to q_servo, from a
 * stop ONWARD. */
kc_outcome_t kc_observe_measured(const kc_observe_t *observe, kc_outcome_t measured);
/* SEARCH: DONE if tags were detected, SEARCH for the next place. */
kc_outcome_t kc_observe_search(kc_observe_t *observe, kc_request_t *request, const kc_view_t *view,
                               kc_out_t *out);
/* TURN begins: to the next place of the spiral; SKIP if there is none. */
kc_outcome_t kc_observe_turn(kc_observe_t *observe, kc_pantilt_t *pantilt, const kc_view_t *view,
                             kc_out_t *out);

#endif
