/* From a detection to an observation, and which of the two poses of a flat tag it is. */
#ifndef KC_OBSERVATION_H
#define KC_OBSERVATION_H

#include <stdbool.h>

#include "kc_sensors.h"
#include "kc_tables.h"

/* Arm and pan-tilt unit when the frame was taken. */
typedef struct {
    const kc_arm_state_t *arm;
    const kc_pantilt_state_t *pantilt;
    double t_s; /* elapsed time, a variable of bases */
} kc_posture_t;

/* Observation of the tool at the detection's first pose: in the base frame, with the nominal camera. */
void kc_observation(const kc_camera_t *camera, const kc_detection_t *det, const kc_posture_t *at,
                    kc_obs_t *obs);

/* Residual [m, rad] of an observation at any coefficients; predicted (NULL: not wanted) gets the pose of the
 * model. */
void kc_observation_residual(const kc_fixed_t *fixed, const kc_obs_t *obs, double r[6], kc_pose_t *predicted);

/* Whether the second pose of a flat tag is the right one: its reprojection is about as good (rms), and its
 * angle to the prediction is smaller than that of the first one, and small enough for the prediction to be
 * trusted. */
bool kc_observation_is_flipped(const kc_config_t *config, double rms_px, double rms_alt_px, double angle_rad,
                               double angle_alt_rad);

/* Put the pose first that is nearer to the prediction with coefficients coef. */
void kc_observation_unflip(const kc_active_t *tables, const double *coef, const kc_posture_t *at,
                           kc_detection_t *det);

#endif
