/* Camera on its pan-tilt unit, and the tags on the tool.
 *
 *   T_base_cam(pan, tilt) = T_base_mast Rz(pan) Ry(tilt) T_pantilt_cam
 * Camera frame: z forward, x right, y down (OpenCV). Positive tilt looks down. */
#ifndef KC_CAMERA_H
#define KC_CAMERA_H

#include <stdint.h>

#include "kc_limits.h"
#include "kc_rot.h"

typedef struct {
    int32_t id;          /* 36h11 member */
    double size_m;       /* edge of the black square */
    double xyz_m[3];     /* tag frame in the tool frame: origin at the tag centre, */
    double quat_wxyz[4]; /* x right, y down, z into the tag as a viewer sees it */
} kc_tag_t;

typedef struct {
    double mast_xyz_m[3], mast_quat_wxyz[4];
    double pantilt_xyz_m[3], pantilt_quat_wxyz[4]; /* T_pantilt_cam */
    double pan_min_rad, pan_max_rad, tilt_min_rad, tilt_max_rad;
    double fx_px, fy_px, cx_px, cy_px;
    uint32_t width_px, height_px;
    /* 1-sigma of how far the chain may be from the numbers above, each axis (METHOD.md 6.1); 0: exact */
    double mast_sigma_m, mast_sigma_rad;     /* pan-tilt unit on its mast: position, rotation */
    double zero_sigma_rad;                   /* zeros of pan and tilt */
    double axis_sigma_rad;                   /* axes not square to each other, camera turned on its mount */
    double tag_size_sigma;                   /* edges of all tags together, relative */
    double plate_sigma_m, plate_sigma_rad;   /* tags together on the tool: position, rotation */
    double drift_sigma_m_s, drift_sigma_rad_s; /* steady motion of the mast during a calibration */
    uint32_t n_tags;
    kc_tag_t tag[KC_TAG_MAX];
} kc_camera_t;

/* Errors of the chain: each moves the tool pose that is seen. Those of the tags do so wherever the camera is; the
 * others move all that the camera sees alike. */
#define KC_CHAIN_PLATE 0u /* 3 of position, 3 of rotation, in the tool frame */
#define KC_CHAIN_SIZE 6u
#define KC_CHAIN_DRIFT 7u /* 3 of position, 3 of rotation about the pan-tilt centre, base frame */
#define KC_CHAIN_MAST 13u /* the same */
#define KC_CHAIN_ZERO 19u /* pan, tilt */
#define KC_CHAIN_AXIS \
    21u /* tilt axis about the forward axis; camera about forward and up axis of its mount */
#define KC_CHAIN_COUNT 24u

void kc_camera_pose(const kc_camera_t *cam, double pan_rad, double tilt_rad, kc_pose_t *T_base_cam);

/* Pan and tilt that put the base-frame point in the image centre, clipped to the limits;
 * returns KC_ERR_REACH (angles still clipped) if the limits cut it off. */
kc_status_t kc_camera_aim(const kc_camera_t *cam, const double p_base_m[3], double *pan_rad,
                          double *tilt_rad);

/* Projection of a camera-frame point [px]; KC_ERR_RANGE if it is not in front. */
kc_status_t kc_camera_project(const kc_camera_t *cam, const double p_cam_m[3], double uv_px[2]);

/* Bit per tag (order of cam->tag) that lies with its white border inside the image and is visible with an
 * incidence below max_incid_rad, the tool being at T_cam_tool. No occlusion test. */
uint32_t kc_camera_visible(const kc_camera_t *cam, const kc_pose_t *T_cam_tool, double max_incid_rad);

/* Motion (dp [m]; rotation vector [rad], base frame) of the tool pose that is seen, for 1 sigma of each error of
 * the chain: the camera looking at tool with these angles, since_s after its drift began. */
void kc_camera_chain(const kc_camera_t *cam, double pan_rad, double tilt_rad, const kc_pose_t *tool,
                     double since_s, double H[KC_CHAIN_COUNT][6]);
#define KC_CAMERA_CHAIN_COST 12000u /* bound of its instructions */

/* First problem found: KC_ERR_RANGE, *index = tag or -1, *got = the value. */
kc_status_t kc_camera_validate(const kc_camera_t *cam, int32_t *index, double *got);

#endif
