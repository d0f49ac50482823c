#include "kc_camera.h"

#include "kc_check.h"
#include "kc_vec.h"

/* Points nearer than this to the camera plane are not in front [m]. */
#define FRONT_MIN_M 1e-6
/* A 36h11 tag needs its white border to be found: 10 cells, 8 of them inside the black square. */
#define TAG_WITH_BORDER (10.0 / 8.0)
#define TAG_ID_MAX 586

void kc_camera_pose(const kc_camera_t *cam, double pan_rad, double tilt_rad, kc_pose_t *T_base_cam)
{
    kc_pose_t mount;
    kc_pose_from_quat(cam->mast_xyz_m, cam->mast_quat_wxyz, T_base_cam);
    kc_pose_screw(T_base_cam, 2u, 0.0, pan_rad);
    kc_pose_screw(T_base_cam, 1u, 0.0, tilt_rad);
    kc_pose_from_quat(cam->pantilt_xyz_m, cam->pantilt_quat_wxyz, &mount);
    kc_pose_mul(T_base_cam, &mount, T_base_cam);
}

/* Point of the optical axis (o + s d, pan-tilt frame) as far from the pan-tilt centre as P is.
 * KC_ERR_REACH if the axis nowhere comes that close; h is its nearest point then. */
static kc_status_t on_optical_axis(const kc_camera_t *cam, double range_m, double h[3])
{
    kc_pose_t mount;
    double d[3];
    kc_pose_from_quat(cam->pantilt_xyz_m, cam->pantilt_quat_wxyz, &mount);
    kc_m3_col(mount.R, 2u, d);
    const double od = kc_v3_dot(mount.p_m, d);
    const double disc = od * od - kc_v3_dot(mount.p_m, mount.p_m) + range_m * range_m;
    const double s = -od + kc_sqrt(kc_max(disc, 0.0));
    kc_v3_add_scaled(mount.p_m, s, d, h);
    return disc >= 0.0 && s > 0.0 ? KC_OK : KC_ERR_REACH;
}

/* Clip an angle; 1 if it had to be. */
static bool clip(double *angle_rad, double lo, double hi)
{
    const double a = kc_clamp(*angle_rad, lo, hi);
    const bool cut = a < *angle_rad || a > *angle_rad;
    *angle_rad = a;
    return cut;
}

kc_status_t kc_camera_aim(const kc_camera_t *cam, const double p_base_m[3], double *pan_rad, double *tilt_rad)
{
    kc_pose_t mast;
    double P[3], h[3];
    kc_pose_from_quat(cam->mast_xyz_m, cam->mast_quat_wxyz, &mast);
    kc_pose_inv(&mast, &mast);
    kc_m3_mul_v3(mast.R, p_base_m, P);
    kc_v3_add_scaled(P, 1.0, mast.p_m, P);
    kc_status_t st = on_optical_axis(cam, kc_v3_norm(P), h);

    /* Rz(pan) Ry(tilt) h = P. Height: hz cos t - hx sin t = rho cos(t + psi) = Pz; of its two
     * solutions the one that looks outward. Then pan turns what is left onto P. */
    const double rho = kc_sqrt(h[0] * h[0] + h[2] * h[2]);
    const double psi = kc_atan2(h[0], h[2]);
    const double up = P[2] / kc_max(rho, FRONT_MIN_M);
    if (up > 1.0 || up < -1.0) { st = KC_ERR_REACH; }
    const double t = kc_acos(kc_clamp(up, -1.0, 1.0));
    const double out = rho * kc_sin(t);
    double pan = kc_atan2(P[1], P[0]) - kc_atan2(h[1], out);
    pan -= 2.0 * KC_PI * kc_floor((pan + KC_PI) / (2.0 * KC_PI));
    *pan_rad = pan;
    *tilt_rad = t - psi;
    const bool cut_pan = clip(pan_rad, cam->pan_min_rad, cam->pan_max_rad);
    const bool cut_tilt = clip(tilt_rad, cam->tilt_min_rad, cam->tilt_max_rad);
    return cut_pan || cut_tilt ? KC_ERR_REACH : st;
}

kc_status_t kc_camera_project(const kc_camera_t *cam, const double p_cam_m[3], double uv_px[2])
{
    if (!(p_cam_m[2] > FRONT_MIN_M)) { return KC_ERR_RANGE; }
    uv_px[0] = cam->cx_px + cam->fx_px * p_cam_m[0] / p_cam_m[2];
    uv_px[1] = cam->cy_px + cam->fy_px * p_cam_m[1] / p_cam_m[2];
    return KC_OK;
}

static bool inside_image(const kc_camera_t *cam, const double p_cam_m[3])
{
    double uv[2];
    if (kc_camera_project(cam, p_cam_m, uv) != KC_OK) { return false; }
    return uv[0] >= 0.0 && uv[0] <= (double)cam->width_px - 1.0 && uv[1] >= 0.0 &&
           uv[1] <= (double)cam->height_px - 1.0;
}

static bool tag_visible(const kc_camera_t *cam, const kc_tag_t *tag, const kc_pose_t *T_cam_tool,
                        double max_incid_rad)
{
    kc_pose_t T;
    double z[3];
    kc_pose_from_quat(tag->xyz_m, tag->quat_wxyz, &T);
    kc_pose_mul(T_cam_tool, &T, &T);
    kc_m3_col(T.R, 2u, z); /* into the tag: along the line of sight when seen square on */
    if (kc_v3_dot(z, T.p_m) < kc_cos(max_incid_rad) * kc_v3_norm(T.p_m)) { return false; }
    const double half = 0.5 * TAG_WITH_BORDER * tag->size_m;
    bool inside = true;
    for (uint32_t corner = 0u; corner < 4u; corner++) {
        const double c[3] = {corner & 1u ? half : -half, corner & 2u ? half : -half, 0.0};
        double p[3];
        kc_m3_mul_v3(T.R, c, p);
        kc_v3_add_scaled(p, 1.0, T.p_m, p);
        inside = inside && inside_image(cam, p);
    }
    return inside;
}

uint32_t kc_camera_visible(const kc_camera_t *cam, const kc_pose_t *T_cam_tool, double max_incid_rad)
{
    uint32_t seen = 0u;
    for (uint32_t i = 0u; i < cam->n_tags; i++) {
        if (tag_visible(cam, &cam->tag[i], T_cam_tool, max_incid_rad)) { seen |= 1u << i; }
    }
    return seen;
}

/* Turning what is seen about an axis through a point, by angle_rad. */
static void turn_about(const double axis[3], const double through_m[3], const double p_m[3], double angle_rad,
                       double out[6])
{
    double arm[3];
    kc_v3_sub(p_m, through_m, arm);
    kc_v3_cross(axis, arm, out);
    for (uint32_t k = 0u; k < 3u; k++) {
        out[k] *= angle_rad;
        out[3u + k] = angle_rad * axis[k];
    }
}

/* Along, and about, the axes of a frame: six errors. Rotations are about through_m. */
static void chain_frame(const double R[9], const double through_m[3], const double p_m[3], double sigma_m,
                        double sigma_rad, double (*H)[6])
{
    for (uint32_t a = 0u; a < 3u; a++) {
        double axis[3];
        kc_m3_col(R, a, axis);
        for (uint32_t k = 0u; k < 3u; k++) {
            H[a][k] = sigma_m * axis[k];
            H[a][3u + k] = 0.0;
        }
        turn_about(axis, through_m, p_m, sigma_rad, H[3u + a]);
    }
}

/* About one axis of a frame. */
static void chain_turn(const kc_pose_t *T, uint32_t axis, const double p_m[3], double sigma_rad,
                       double out[6])
{
    double a[3];
    kc_m3_col(T->R, axis, a);
    turn_about(a, T->p_m, p_m, sigma_rad, out);
}

void kc_camera_chain(const kc_camera_t *cam, double pan_rad, double tilt_rad, const kc_pose_t *tool,
                     double since_s, double H[KC_CHAIN_COUNT][6])
{
    kc_pose_t T;
    const double *p = tool->p_m;
    chain_frame(tool->R, p, p, cam->plate_sigma_m, cam->plate_sigma_rad, &H[KC_CHAIN_PLATE]);
    kc_camera_pose(cam, pan_rad, tilt_rad, &T);
    for (uint32_t k = 0u; k < 3u; k++) {
        H[KC_CHAIN_SIZE][k] = cam->tag_size_sigma * (p[k] - T.p_m[k]);
        H[KC_CHAIN_SIZE][3u + k] = 0.0;
    }
    kc_pose_from_quat(cam->mast_xyz_m, cam->mast_quat_wxyz, &T);
    chain_frame(T.R, T.p_m, p, since_s * cam->drift_sigma_m_s, since_s * cam->drift_sigma_rad_s,
                &H[KC_CHAIN_DRIFT]);
    chain_frame(T.R, T.p_m, p, cam->mast_sigma_m, cam->mast_sigma_rad, &H[KC_CHAIN_MAST]);
    chain_turn(&T, 2u, p, cam->zero_sigma_rad, H[KC_CHAIN_ZERO]);
    kc_pose_screw(&T, 2u, 0.0, pan_rad);
    chain_turn(&T, 1u, p, cam->zero_sigma_rad, H[KC_CHAIN_ZERO + 1u]);
    chain_turn(&T, 0u, p, cam->axis_sigma_rad, H[KC_CHAIN_AXIS]);
    kc_pose_screw(&T, 1u, 0.0, tilt_rad);
    chain_turn(&T, 0u, p, cam->axis_sigma_rad, H[KC_CHAIN_AXIS + 1u]);
    chain_turn(&T, 2u, p, cam->axis_sigma_rad, H[KC_CHAIN_AXIS + 2u]);
}

static void check_tags(kc_check_t *c, const kc_camera_t *cam)
{
    for (uint32_t i = 0u; i < cam->n_tags; i++) {
        const kc_tag_t *tag = &cam->tag[i];
        kc_check(c, tag->id >= 0 && tag->id <= TAG_ID_MAX, (int32_t)i, tag->id);
        for (uint32_t k = 0u; k < i; k++) { kc_check(c, cam->tag[k].id != tag->id, (int32_t)i, tag->id); }
        kc_check_positive(c, tag->size_m, (int32_t)i);
        kc_check_frame(c, tag->xyz_m, tag->quat_wxyz, (int32_t)i);
    }
}

kc_status_t kc_camera_validate(const kc_camera_t *cam, int32_t *index, double *got)
{
    kc_check_t c = kc_check_start();
    kc_check_frame(&c, cam->mast_xyz_m, cam->mast_quat_wxyz, -1);
    kc_check_frame(&c, cam->pantilt_xyz_m, cam->pantilt_quat_wxyz, -1);
    kc_check_finite(&c, &cam->pan_min_rad, 1u, -1);
    kc_check_finite(&c, &cam->pan_max_rad, 1u, -1);
    kc_check(&c, cam->pan_min_rad < cam->pan_max_rad, -1, cam->pan_min_rad);
    kc_check_finite(&c, &cam->tilt_min_rad, 1u, -1);
    kc_check_finite(&c, &cam->tilt_max_rad, 1u, -1);
    kc_check(&c, cam->tilt_min_rad < cam->tilt_max_rad, -1, cam->tilt_min_rad);
    kc_check_positive(&c, cam->fx_px, -1);
    kc_check_positive(&c, cam->fy_px, -1);
    kc_check_finite(&c, &cam->cx_px, 1u, -1);
    kc_check_finite(&c, &cam->cy_px, 1u, -1);
    kc_check(&c, cam->width_px >= 1u && cam->width_px <= 65535u, -1, cam->width_px);
    kc_check(&c, cam->height_px >= 1u && cam->height_px <= 65535u, -1, cam->height_px);
    const double sigma[9] = {cam->mast_sigma_m,    cam->mast_sigma_rad,  cam->zero_sigma_rad,
                             cam->axis_sigma_rad,  cam->tag_size_sigma,  cam->plate_sigma_m,
                             cam->plate_sigma_rad, cam->drift_sigma_m_s, cam->drift_sigma_rad_s};
    for (uint32_t k = 0u; k < 9u; k++) { kc_check(&c, sigma[k] >= 0.0 && kc_finite(sigma[k]), -1, sigma[k]); }
    kc_check(&c, cam->n_tags >= 1u && cam->n_tags <= KC_TAG_MAX, -1, cam->n_tags);
    if (c.st == KC_OK) { check_tags(&c, cam); }
    return kc_check_end(&c, index, got);
}
