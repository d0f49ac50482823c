/* What every part of the component may read. A part changes only its own data, which it is handed apart. */
#ifndef KC_VIEW_H
#define KC_VIEW_H

#include <stdbool.h>
#include <stdint.h>

#include "kc_acquire.h"
#include "kc_ended.h"
#include "kc_fit.h"
#include "kc_leave_out.h"
#include "kc_plan.h"
#include "kc_sensors.h"
#include "kc_states.h"
#include "kc_tables.h"

/* Time. */
typedef struct {
    uint64_t now_us;   /* elapsed time: every time-out counts in it, and no stamp of a message */
    uint64_t clock_us; /* mission time of the newest step */
    uint64_t behind_us; /* by how much mission time advanced less than the number of steps says */
} kc_clock_t;

/* Where the sequencer stands. */
typedef struct {
    kc_state_t state;
    uint64_t since_us; /* elapsed time */
} kc_place_t;

/* The last accepted telemetry. */
typedef struct {
    kc_arm_state_t arm;
    kc_pantilt_state_t pantilt;
    bool has_arm, has_pantilt;
    uint64_t arm_ok_us, pantilt_ok_us; /* elapsed time of the last accepted message */
} kc_telemetry_t;

/* The calibration under way, or the last one. */
typedef struct {
    uint32_t session;
    kc_acq_t acq;
    uint64_t start_us;
    double energy_j;              /* used since START */
    uint64_t energy_us;           /* time up to which it is counted */
    int32_t candidate, replicate; /* current one, -1: none */
    double acq_value;
    int32_t chosen_by; /* kc_acq_t; -1 = initial pose or replicate */
    kc_ended_t ended;  /* why it proposes; NOT: it goes on, or is aborted */
} kc_cal_t;

/* Latest estimate, with all poses so far, and what follows from it. */
typedef struct {
    kc_status_t status;       /* of the estimator */
    double coef[KC_COEF_MAX]; /* latest correction, for aiming and for f */
    bool gp_ok;
    bool trusted;   /* the estimate predicted the newest pose better */
    kc_ended_t ended; /* REQUIREMENT or NO_CHANGE: no more poses are needed */
    kc_residual_t res;  /* residual of the newest pose before it was used */
    double f, gp_mean, gp_sigma;
    kc_residual_t pred; /* predicted sigma over the search space */
    bool tested_early;       /* the table in force was tested before the end */
    uint32_t n_checked; /* poses in a row that were predicted as well as required, before they were used */
    kc_leave_out_t leave_out; /* search for a bad detection among the local initial poses */
    uint8_t outlier_reported[KC_MEAS_MAX];
    double y[KC_MEAS_MAX]; /* objective of each pose */
    double dp_m[KC_MEAS_MAX], dr_rad[KC_MEAS_MAX]; /* residual of each observation */
} kc_latest_t;

typedef struct {
    const kc_clock_t *clock;
    const kc_place_t *place;
    const kc_active_t *tables;
    const kc_telemetry_t *telemetry;
    const kc_cal_t *cal;
    const kc_plan_t *plan;
    const kc_latest_t *latest;
    const kc_est_t *est;
    const uint32_t *servo_steps; /* at this candidate */
} kc_view_t;

/* Silence: longest time without telemetry while it matters. */
#define KC_SILENT_US 2000000u
/* Candidates that stand for the search space in predictions. */
#define KC_SPACE_SAMPLES 256u

/* Every how many candidates one of them is. */
uint32_t kc_view_stride(const kc_view_t *view);
/* Elapsed time at which a message with this stamp was made, as far as clocks agree. */
uint64_t kc_view_elapsed(const kc_view_t *view, uint64_t stamp_us);
uint64_t kc_view_in_state_us(const kc_view_t *view);
bool kc_view_at_rest(const kc_view_t *view);
/* Input variables of the bases at candidate c, at rest. */
void kc_view_ctx(const kc_view_t *view, uint32_t cand, kc_ctx_t *ctx);
/* Pose of the tool at joints q, with the latest correction. */
void kc_view_expect(const kc_view_t *view, const double *q, kc_pose_t *T);
/* The same at candidate cand, with any coefficients. */
void kc_view_pose(const kc_view_t *view, const kc_fixed_t *fixed, uint32_t cand, kc_pose_t *T);
/* Largest distance of a joint from q. */
double kc_view_distance(const kc_view_t *view, const double *q);
/* Seed joints of the current candidate; whether it is a local initial pose. */
void kc_view_seed(const kc_view_t *view, double *q);
bool kc_view_local(const kc_view_t *view);

#endif
