/* Frames of one measurement at rest, and their mean. */
#ifndef KC_FRAMES_H
#define KC_FRAMES_H

#include <stdbool.h>

#include "kc_sensors.h"
#include "kc_tables.h"

typedef struct {
    uint32_t n;
    kc_pose_t first;           /* camera-to-tool of the first frame */
    double dp_m[3], dw_rad[3]; /* sums of differences to the first frame */
    double cov[36], q[KC_JOINT_MAX], dq[KC_JOINT_MAX];
    double range_m, incid_rad, u_px, v_px, rms_px, rms_alt_px, pan_rad, tilt_rad;
    double corner_px[8u * KC_TAG_MAX];
    bool same_tags;
    kc_detection_t det; /* of the first frame */
} kc_frames_t;

void kc_frames_clear(kc_frames_t *frames);
void kc_frames_add(kc_frames_t *frames, const kc_detection_t *det, const kc_arm_state_t *arm,
                   const kc_pantilt_state_t *pantilt);
/* Distance of a frame from the mean of the frames held; 0 without any. */
void kc_frames_jump(const kc_frames_t *frames, const kc_detection_t *det, double *pos_m, double *rot_rad);
/* Mean of at least one frame: the detection, with the covariance of the mean; encoder readings and pan-tilt
 * angles; the rest of arm and pantilt stays. Time, number, tags and the second solution are those of the
 * first frame. */
void kc_frames_mean(const kc_frames_t *frames, const kc_config_t *config, kc_detection_t *det,
                    kc_arm_state_t *arm, kc_pantilt_state_t *pantilt);

#endif
