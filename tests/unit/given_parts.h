/* The parts of a calibration that functions read through kc_view_t, with good tables and everything else zero: for
 * tests that call one function with values. */
#ifndef GIVEN_PARTS_H
#define GIVEN_PARTS_H

#include "kc_answer.h"
#include "kc_app_parts.h"
#include "kc_channels.h"
#include "kc_view.h"

typedef struct {
    kc_view_t view; /* of all below */
    kc_clock_t clock;
    kc_place_t place;
    kc_tables_t tables;
    kc_telemetry_t telemetry;
    kc_cal_t cal;
    kc_plan_t plan;
    kc_latest_t latest;
    kc_est_t est;
    uint32_t servo_steps;
    kc_out_t out; /* of the last call */
} parts_t;

extern parts_t parts;

/* Nine candidates; the CRC of a table is PARTS_CRC + its kind. The clock shows a good hour. */
#define PARTS_CRC 0x1000u
#define PARTS_NOW_US 4000000000u
void given_parts(void);
/* The same in kc_app_instance, idle, with an arm and a pan-tilt unit that were heard just now. */
void given_app(void);
/* What a camera whose tilt is off shows of this arm: pose, range and covariance. */
void given_detection(const kc_arm_t *arm, const double *q, double tilt_rad, kc_detection_t *det);
/* n poses are measured, with noise times `noise`, of an arm whose joint 7 is off; nothing is estimated yet. */
void given_measured(uint32_t n, double phi_rad, double noise, double tilt_rad);
/* A test has changed this table in memory on purpose: flight shall take it as it is. Kind 0: kin_prev. */
void given_seal(kc_active_t *a, uint16_t kind);
/* Sign a command. */
void given_signature(kc_cmd_t *cmd, const kc_key_t *key, uint64_t counter);
/* Whether exactly this event came since the last call; the outputs are cleared. */
void expect_event(kc_event_id_t id, int32_t index, double got, double want);
/* Whether a command was refused with this answer, and exactly this event came. */
void expect_refused(kc_answer_t answer, kc_status_t status, kc_event_id_t id, int32_t index, double got,
                    double want);
void expect_taken(kc_answer_t answer, kc_outcome_id_t outcome);

#endif
