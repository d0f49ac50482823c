/* Memory of the choice of candidates while a calibration runs; kc_arena.h says what else it is used for. */
#ifndef KC_CHOICE_H
#define KC_CHOICE_H

#include <stdint.h>

#include "kc_acquire.h"
#include "kc_clear.h"
#include "kc_gp.h"
#include "kc_evaluation.h"

/* Where the choice of the next candidate stands between two steps (kc_select.c). */
typedef struct {
    uint32_t part, i;
    uint32_t cand; /* the one chosen */
    bool initial;  /* whether the arm leaves the park pose is part of it */
    /* then: the local initial pose of the largest gain, that gain, and whether it is predicted safe */
    uint32_t local;
    double local_gain;
    bool local_safe;
    uint8_t eligible[KC_CAND_MAX]; /* what it is among */
    float cost[KC_CAND_MAX];       /* of each (kc_cost.h) */
    kc_clear_t clear; /* of the pose that the arm leaves the park pose for */
} kc_choice_t;

typedef struct {
    kc_gp_t gp;
    kc_point_t cand_pt[KC_CAND_MAX];          /* goal poses of the candidates */
    float cand_q[KC_CAND_MAX * KC_JOINT_MAX]; /* joints expected there */
    kc_choice_t choice;
    union {
        kc_acq_work_t acq; /* only inside one choice */
        kc_evaluation_t evaluation;  /* only inside one REPORT */
    };
} kc_arena_calibration_t;

#endif
