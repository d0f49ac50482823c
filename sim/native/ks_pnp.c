#include "ks_pnp.h"

#include <math.h>
#include <stdbool.h>
#include <stddef.h>

#define UNKNOWNS 6u
#define REFINE_MAX 100u
#define REFINE_UNTIL 1e-12 /* [m, rad] of a step */
#define ROUNDING \
    (1.0 + 1e-12) /* of a sum of squares: nearer to the minimum a good step may seem to raise it */
#define DAMPING_FIRST 1e-6
#define DAMPING_FACTOR 10.0
/* 8 sin^2(a/2) at a = 0.01 rad: the squared Frobenius norm of the difference of two attitudes that are a apart. */
#define SAME_ATTITUDE 1.99998333e-4

typedef struct {
    uint32_t n; /* corners */
    const double *camera, *corner_m, *corner_px;
} view_t;

/* Sums over all corners at a pose: squared residuals, J'J (lower triangle) and J'r. */
typedef struct {
    double cost, H[UNKNOWNS][UNKNOWNS], g[UNKNOWNS];
} normal_t;

static void turned(const double R[9], const double x[3], double out[3])
{
    for (uint32_t i = 0u; i < 3u; i++) {
        out[i] = R[3u * i] * x[0] + R[3u * i + 1u] * x[1] + R[3u * i + 2u] * x[2];
    }
}

static void product(const double A[9], const double B[9], double out[9])
{
    for (uint32_t i = 0u; i < 9u; i++) {
        const double *row = &A[i / 3u * 3u];
        out[i] = row[0] * B[i % 3u] + row[1] * B[3u + i % 3u] + row[2] * B[6u + i % 3u];
    }
}

static void cross(const double a[3], const double b[3], double out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* ---- plane poses of one tag (Collins & Bartoli 2014) */

/* Where a tag is in the tool frame: centre, edge, and its axes as columns of R. */
static double place_tag(const double corner[12], double R[9], double centre[3])
{
    double x[3], y[3], z[3], squared = 0.0;
    for (uint32_t i = 0u; i < 3u; i++) {
        x[i] = corner[3u + i] - corner[i];
        y[i] = corner[i] - corner[9u + i];
        centre[i] = 0.25 * (corner[i] + corner[3u + i] + corner[6u + i] + corner[9u + i]);
        squared += x[i] * x[i];
    }
    const double edge = sqrt(squared);
    for (uint32_t i = 0u; i < 3u; i++) {
        x[i] /= edge;
        y[i] /= edge;
    }
    cross(x, y, z);
    for (uint32_t i = 0u; i < 3u; i++) {
        R[3u * i] = x[i];
        R[3u * i + 1u] = y[i];
        R[3u * i + 2u] = z[i];
    }
    return edge;
}

/* Image of the centre (u, v) of a square at depth 1, and its derivative by x and y of the square [per edge]; of the
 * homography that takes the square to its corners (Heckbert 1989). */
static void centre_of(const double *camera, const double px[8], double image[2], double J[4])
{
    double x[4][2];
    for (uint32_t k = 0u; k < 4u; k++) { /* (0, 0), (1, 0), (1, 1), (0, 1) */
        const double *corner = &px[2u * (3u - k)];
        x[k][0] = (corner[0] - camera[2]) / camera[0];
        x[k][1] = (corner[1] - camera[3]) / camera[1];
    }
    double a[2], b[2], s[2];
    for (uint32_t i = 0u; i < 2u; i++) {
        a[i] = x[1][i] - x[2][i];
        b[i] = x[3][i] - x[2][i];
        s[i] = x[0][i] - x[1][i] + x[2][i] - x[3][i];
    }
    const double det = a[0] * b[1] - b[0] * a[1];
    const double g = (s[0] * b[1] - b[0] * s[1]) / det;
    const double h = (a[0] * s[1] - s[0] * a[1]) / det;
    const double w = 1.0 + 0.5 * (g + h);
    for (uint32_t i = 0u; i < 2u; i++) {
        const double along = x[1][i] - x[0][i] + g * x[1][i], across = x[3][i] - x[0][i] + h * x[3][i];
        image[i] = (0.5 * (along + across) + x[0][i]) / w;
        J[2u * i] = (along - g * image[i]) / w;
        J[2u * i + 1u] = (across - h * image[i]) / w;
    }
}

/* Both attitudes of a plane whose origin is seen at (u, v) with derivative J, and its depth, in units of J's. */
static double plane_attitudes(const double image[2], const double J[4], double R[2][9])
{
    const double u = image[0], v = image[1], norm = sqrt(u * u + v * v + 1.0);
    const double n[3] = {u / norm, v / norm, 1.0 / norm}, c = 1.0 / (1.0 + n[2]);
    const double sight[9] = {1.0 - n[0] * n[0] * c,
                             -n[0] * n[1] * c,
                             n[0],
                             -n[0] * n[1] * c,
                             1.0 - n[1] * n[1] * c,
                             n[1],
                             -n[0],
                             -n[1],
                             n[2]};
    const double B[4] = {sight[0] - u * sight[6], sight[1] - u * sight[7], sight[3] - v * sight[6],
                         sight[4] - v * sight[7]};
    const double det = B[0] * B[3] - B[1] * B[2];
    double A[4];
    for (uint32_t i = 0u; i < 2u; i++) {
        A[i] = (B[3] * J[i] - B[1] * J[2u + i]) / det;
        A[2u + i] = (B[0] * J[2u + i] - B[2] * J[i]) / det;
    }
    const double xx = A[0] * A[0] + A[1] * A[1], yy = A[2] * A[2] + A[3] * A[3];
    const double xy = A[0] * A[2] + A[1] * A[3];
    const double largest = sqrt(0.5 * (xx + yy + sqrt((xx - yy) * (xx - yy) + 4.0 * xy * xy)));
    for (uint32_t i = 0u; i < 4u; i++) { A[i] /= largest; }
    const double up = sqrt(fmax(0.0, 1.0 - A[0] * A[0] - A[2] * A[2]));
    const double across = copysign(sqrt(fmax(0.0, 1.0 - A[1] * A[1] - A[3] * A[3])),
                                   -A[0] * A[1] - A[2] * A[3]);
    for (uint32_t k = 0u; k < 2u; k++) {
        const double sign = k == 0u ? 1.0 : -1.0;
        const double x[3] = {A[0], A[2], sign * up}, y[3] = {A[1], A[3], sign * across};
        double z[3];
        cross(x, y, z);
        const double tilted[9] = {x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]};
        product(sight, tilted, R[k]);
    }
    return 1.0 / largest;
}

static void plane_poses(const double *camera, const double corner_m[12], const double px[8],
                        ks_pose_t pose[2])
{
    double tag[9], centre_m[3], image[2], J[4], R[2][9];
    const double edge_m = place_tag(corner_m, tag, centre_m);
    centre_of(camera, px, image, J);
    const double depth_m = edge_m * plane_attitudes(image, J, R);
    const double seen_m[3] = {depth_m * image[0], depth_m * image[1], depth_m};
    const double back[9] = {tag[0], tag[3], tag[6], tag[1], tag[4], tag[7], tag[2], tag[5], tag[8]};
    for (uint32_t k = 0u; k < 2u; k++) {
        double offset_m[3];
        product(R[k], back, pose[k].R);
        turned(pose[k].R, centre_m, offset_m);
        for (uint32_t i = 0u; i < 3u; i++) { pose[k].p_m[i] = seen_m[i] - offset_m[i]; }
    }
}

/* ---- refinement on all corners (Levenberg and Marquardt) */

static void add_row(normal_t *sum, const double row[UNKNOWNS], double residual)
{
    sum->cost += residual * residual;
    for (uint32_t i = 0u; i < UNKNOWNS; i++) {
        sum->g[i] += row[i] * residual;
        for (uint32_t j = 0u; j <= i; j++) { sum->H[i][j] += row[i] * row[j]; }
    }
}

/* Sums at a pose; false if a corner does not lie before the camera. */
static bool residuals(const view_t *view, const ks_pose_t *pose, normal_t *sum)
{
    *sum = (normal_t){0};
    for (uint32_t k = 0u; k < view->n; k++) {
        double r[3];
        turned(pose->R, &view->corner_m[3u * k], r);
        const double z = r[2] + pose->p_m[2];
        if (!(z > 0.0)) { return false; }
        for (uint32_t axis = 0u; axis < 2u; axis++) {
            const double ratio = (r[axis] + pose->p_m[axis]) / z, scale = view->camera[axis] / z;
            const double by[3] = {axis == 0u ? scale : 0.0, axis == 1u ? scale : 0.0, -scale * ratio};
            double row[UNKNOWNS] = {by[0], by[1], by[2]};
            cross(r, by, &row[3]);
            add_row(sum, row,
                    view->camera[axis] * ratio + view->camera[2u + axis] - view->corner_px[2u * k + axis]);
        }
    }
    return isfinite(sum->cost);
}

/* Step of (1 + damping) diag: false if the matrix is not positive definite. */
static bool damped_step(const normal_t *sum, double damping, double step[UNKNOWNS])
{
    double L[UNKNOWNS][UNKNOWNS];
    for (uint32_t i = 0u; i < UNKNOWNS; i++) {
        for (uint32_t j = 0u; j <= i; j++) {
            double x = sum->H[i][j] * (i == j ? 1.0 + damping : 1.0);
            for (uint32_t k = 0u; k < j; k++) { x -= L[i][k] * L[j][k]; }
            if (i == j && !(x > 0.0)) { return false; }
            L[i][j] = i == j ? sqrt(x) : x / L[j][j];
        }
    }
    for (uint32_t i = 0u; i < UNKNOWNS; i++) {
        double x = -sum->g[i];
        for (uint32_t k = 0u; k < i; k++) { x -= L[i][k] * step[k]; }
        step[i] = x / L[i][i];
    }
    for (uint32_t i = UNKNOWNS; i-- > 0u;) {
        for (uint32_t k = i + 1u; k < UNKNOWNS; k++) { step[i] -= L[k][i] * step[k]; }
        step[i] /= L[i][i];
    }
    return true;
}

/* The pose moved by a step; its turn is that of the quaternion (1, w/2). */
static void moved(const ks_pose_t *from, const double step[UNKNOWNS], ks_pose_t *to)
{
    const double x = 0.5 * step[3], y = 0.5 * step[4], z = 0.5 * step[5];
    const double s = 2.0 / (1.0 + x * x + y * y + z * z);
    const double turn[9] = {1.0 - s * (y * y + z * z), s * (x * y - z),           s * (x * z + y),
                            s * (x * y + z),           1.0 - s * (x * x + z * z), s * (y * z - x),
                            s * (x * z - y),           s * (y * z + x),           1.0 - s * (x * x + y * y)};
    product(turn, from->R, to->R);
    for (uint32_t i = 0u; i < 3u; i++) { to->p_m[i] = from->p_m[i] + step[i]; }
}

static double largest(const double step[UNKNOWNS])
{
    double most = 0.0;
    for (uint32_t i = 0u; i < UNKNOWNS; i++) { most = fmax(most, fabs(step[i])); }
    return most;
}

/* To the minimum that this start leads to; sum: there. False if there is none before the camera. */
static bool refine(const view_t *view, ks_pose_t *pose, normal_t *sum)
{
    double damping = DAMPING_FIRST;
    if (!residuals(view, pose, sum)) { return false; }
    for (uint32_t k = 0u; k < REFINE_MAX; k++) {
        double step[UNKNOWNS];
        ks_pose_t tried;
        normal_t there;
        if (!damped_step(sum, damping, step)) { return false; }
        moved(pose, step, &tried);
        const bool better = residuals(view, &tried, &there) && there.cost <= sum->cost * ROUNDING;
        if (better) {
            *pose = tried;
            *sum = there;
        }
        if (largest(step) < REFINE_UNTIL) { break; }
        damping *= better ? 1.0 / DAMPING_FACTOR : DAMPING_FACTOR;
    }
    pose->rms_px = sqrt(sum->cost / (2.0 * (double)view->n));
    return true;
}

/* ---- the best and the next one */

static bool same_attitude(const ks_pose_t *a, const ks_pose_t *b)
{
    double squared = 0.0;
    for (uint32_t i = 0u; i < 9u; i++) { squared += (a->R[i] - b->R[i]) * (a->R[i] - b->R[i]); }
    return squared <= SAME_ATTITUDE;
}

/* Index of the pose with the least residual, of those with another attitude than `than` if that is given; n: none. */
static uint32_t best_of(uint32_t n, const ks_pose_t *found, const ks_pose_t *than)
{
    uint32_t best = n;
    for (uint32_t i = 0u; i < n; i++) {
        const bool considered = than == NULL || !same_attitude(&found[i], than);
        if (considered && (best == n || found[i].rms_px < found[best].rms_px)) { best = i; }
    }
    return best;
}

uint32_t ks_pnp(uint32_t n_tags, const double *camera, const double *corner_m, const double *corner_px,
                ks_pose_t pose[2], double *information)
{
    if (n_tags == 0u || n_tags > KS_TAG_MAX) { return 0u; }
    const view_t view = {4u * n_tags, camera, corner_m, corner_px};
    ks_pose_t found[2u * KS_TAG_MAX];
    normal_t sum[2u * KS_TAG_MAX];
    uint32_t n = 0u;
    for (uint32_t tag = 0u; tag < n_tags; tag++) {
        ks_pose_t start[2];
        plane_poses(camera, &corner_m[12u * tag], &corner_px[8u * tag], start);
        for (uint32_t k = 0u; k < 2u; k++) {
            found[n] = start[k];
            if (refine(&view, &found[n], &sum[n])) { n++; }
        }
    }
    if (n == 0u) { return 0u; }
    const uint32_t best = best_of(n, found, NULL), other = best_of(n, found, &found[best]);
    pose[0] = found[best];
    pose[1] = found[other < n ? other : best];
    for (uint32_t i = 0u; i < UNKNOWNS * UNKNOWNS; i++) {
        const uint32_t row = i / UNKNOWNS, col = i % UNKNOWNS;
        information[i] = row >= col ? sum[best].H[row][col] : sum[best].H[col][row];
    }
    return other < n ? 2u : 1u;
}
