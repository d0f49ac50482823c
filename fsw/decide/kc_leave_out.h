/* A single bad detection among the local initial poses. Where no correction explains all of them, the estimate is
 * repeated without one observation after the other. The one without which the others fit best is left out, and its
 * pose is measured again: with an arm outside its bounds the residual is the same again, with a bad detection not. */
#ifndef KC_LEAVE_OUT_H
#define KC_LEAVE_OUT_H

#include <stdbool.h>

#include "kc_plan.h"
#include "kc_tables.h"

/* Observations count from 1 here, 0 is none. */
typedef struct {
    uint32_t trial; /* left out of the estimate that is tried */
    uint32_t best; /* without it the others fit best */
    double best_cost; /* of the estimate without it */
    bool decided; /* every trial is done: the estimate without the best one is repeated */
} kc_leave_out_t;

typedef enum {
    KC_LEAVE_OUT_DONE = 0, /* the estimate is used, without the observation that it left out */
    KC_LEAVE_OUT_AGAIN, /* estimate again, without the observation that *without names */
    KC_LEAVE_OUT_NONE /* there is no observation without which the others fit */
} kc_leave_out_answer_t;

/* Whether another measurement of the same candidate agrees with observation i to within the jump limits: then it is
 * no bad detection. */
bool kc_leave_out_repeated(const kc_config_t *config, const kc_plan_t *plan, const kc_obs_t *obs, uint32_t i);

/* Evaluate the estimate without observation *without. fits: it explains the others; cost: of it. No observation that
 * was repeated is left out. *s is all zero at first, and after every answer but AGAIN; at most n_meas + 2 calls
 * until then. */
kc_leave_out_answer_t kc_leave_out_next(kc_leave_out_t *search, const kc_config_t *config,
                                        const kc_plan_t *plan, const kc_obs_t *obs, bool fits, double cost,
                                        uint32_t *without);

#endif
