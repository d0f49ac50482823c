/* Arm commands. The arm only moves along verified segments, and within the servo bound around a candidate's
 * seed. */
#ifndef KC_MOVE_H
#define KC_MOVE_H

#include <stdbool.h>

#include "kc_channels.h"
#include "kc_guard.h"
#include "kc_path.h"
#include "kc_view.h"

/* Current move: verified way points, then the corrected joints inside the servo bound. */
typedef struct {
    uint32_t node; /* where the arm is or was last */
    uint16_t path[KC_PATH_MAX + 1u];
    uint32_t n_path, i_path;
    double q_target[KC_JOINT_MAX]; /* last arm command */
    double q_former[KC_JOINT_MAX]; /* the target that the arm echoed when that was sent */
    double q_final[KC_JOINT_MAX];  /* joints at the candidate, after the way points */
    uint16_t seg_from, seg_to;     /* current verified segment, kept through an abort */
    uint32_t i_stop;               /* next stop on the segment to the candidate */
    bool to_stop;                  /* the arm is on its way to a stop, or there */
    uint64_t sent_us, start_us;
    uint64_t near_us; /* stamp of the first message in a row with the arm at its target; 0: none */
    int32_t seq; /* of the last command */
    uint32_t holds; /* how often hold may still be sent again ... */
    uint64_t held_us; /* ... after it was sent first */
    bool foreign; /* the target that the arm may be moving to is of an earlier run, and not known */
    /* a command that the guard still checks */
    bool checking;
    uint32_t from, to;
    double q_from[KC_JOINT_MAX], q_to[KC_JOINT_MAX];
    kc_guard_job_t check;
} kc_move_t;

void kc_move_hold(kc_move_t *move, const kc_view_t *view, kc_out_t *out);
/* Each step: hold is sent again while the arm goes on to the target of flight's last move, which it echoes; an event if it
 * still does in the end. Whoever else moves the arm after it was held is left alone. */
void kc_move_held(kc_move_t *move, const kc_view_t *view, kc_out_t *out);
/* Every arm command but hold goes through here. The guard (kc_guard.h) checks it as a move along the verified
 * segment between two nodes, or within the bound of one node. STAY: sent, or the check goes on in kc_move_wait.
 * SKIP: refused, with an event; nothing sent. */
kc_outcome_t kc_move_send(kc_move_t *move, const kc_view_t *view, kc_work_t *work, kc_out_t *out,
                          uint32_t from, uint32_t to, const double *q);
/* The same, within the servo bound of the current candidate. */
kc_outcome_t kc_move_near(kc_move_t *move, const kc_view_t *view, kc_work_t *work, kc_out_t *out,
                          const double *q);

/* Plan the path to the current candidate (a replicate: over its hub, so that it is approached again) and start.
 * DONE; SKIP: no path, or the guard refused; ABORT: no verified path begins where the arm is. */
kc_outcome_t kc_move_begin(kc_move_t *move, const kc_view_t *view, kc_work_t *work, kc_out_t *out);
/* MOVE: DONE when the arm is at the candidate, or at a stop (kc_move_stopped). A way point is passed while the arm
 * still vibrates there: two messages one after the other find it there, so that it does not run through. */
kc_outcome_t kc_move_run(kc_move_t *move, const kc_view_t *view, kc_work_t *work, kc_out_t *out);
/* Joints (of all of them, KC_JOINT_MAX) at which the next frame is taken: of the next stop, or of the candidate. */
void kc_move_next_view(const kc_move_t *move, const kc_view_t *view, double *q);
/* Whether the arm is at a stop; and on from there. DONE: sent; SKIP: the guard refused. */
bool kc_move_stopped(const kc_move_t *move);
kc_outcome_t kc_move_onward(kc_move_t *move, const kc_view_t *view, kc_work_t *work, kc_out_t *out);
/* Wait for the guard, then for the arm: DONE when it echoes its target, is at rest and there. Sent again if it was lost, that
 * is while the arm echoes what it did before: a third target is somebody else's, whom flight does not contradict. SKIP:
 * refused. */
kc_outcome_t kc_move_wait(kc_move_t *move, const kc_view_t *view, kc_work_t *work, kc_out_t *out);

/* Node within whose bound the arm is, or KC_NODE_NONE. dist: distance from the nearest node, in bounds. */
uint32_t kc_move_node(const kc_move_t *move, const kc_view_t *view, double *dist);
/* Servo bound of each joint: the smaller one of SPACE and CONFIG. */
void kc_move_bound(const kc_active_t *tables, double *bound);
/* Joint intervals at a candidate: limits with margin, and the servo bound around the seed. */
void kc_move_box(const kc_active_t *tables, uint32_t cand, double *lo, double *hi);
/* Goal pose of the tool at a candidate. */
void kc_move_goal(const kc_space_t *space, uint32_t cand, kc_pose_t *T);
/* Joints that bring the corrected arm to the candidate, as far as the servo bound allows. Not reaching it
 * is no error: the servo continues from there, and a pose measured beside its candidate is as good. Returns how
 * often the model was evaluated: at most KC_MOVE_EVALS(iter_max). */
#define KC_MOVE_EVALS(iter_max) ((iter_max) + 1u)
uint32_t kc_move_joints(const kc_view_t *view, uint32_t cand, uint32_t iter_max, double *q);
/* Bounds of the instructions of kc_move_joints that evaluates the model n times, and of kc_move_begin without
 * the guard. */
uint64_t kc_move_joints_cost(const kc_view_t *view, uint32_t n);
uint64_t kc_move_begin_cost(const kc_view_t *view);

#endif
