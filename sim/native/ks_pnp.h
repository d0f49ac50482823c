/* Pose of the tool from the corners of its tags, for the mode without pixels (docs/METHOD.md 19). Lengths are in
 * metres, images in pixels; poses take the tool to the camera frame, z forward, x right, y down. Nothing is kept
 * between calls, and nothing of flight is used. */
#ifndef KS_PNP_H
#define KS_PNP_H

#include <stdint.h>

#define KS_TAG_MAX 4u
#define KS_CORNER_MAX (4u * KS_TAG_MAX)

typedef struct {
    double R[9]; /* rows */
    double p_m[3];
    double rms_px; /* of reprojection, over 2 coordinates a corner */
} ks_pose_t;

/* The minima of the reprojection error, all corners alike: each tag gives two plane poses, each is refined on the
 * corners of all tags.
 *   camera       fx, fy, cx, cy [px]
 *   corner_m     n_tags x 4 x 3, tool frame, in libapriltag's order: x of the tag runs from the first to the second,
 *                y from the fourth to the first
 *   corner_px    n_tags x 4 x 2
 *   pose         the best, then the next one more than 0.01 rad from it, or the best again if there is none
 *   information  6 x 6, J'J at the best [px^2 per m, rad]: position, then a rotation vector on the left
 * Number of poses found: 0 (none lies before the camera; the results mean nothing), 1 or 2. */
uint32_t ks_pnp(uint32_t n_tags, const double *camera, const double *corner_m, const double *corner_px,
                ks_pose_t pose[2], double *information);

#endif
