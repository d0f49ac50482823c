// Pose of the tool from the corners of its tags, for the mode without pixels (docs/METHOD.md 19). Lengths are in
// metres, images in pixels; poses take the tool to the camera frame, z forward, x right, y down. Nothing of flight is
// used.

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

namespace {

using Eigen::Index;
using Eigen::Matrix2d;
using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Corners = Eigen::Map<const Eigen::Matrix3Xd>;
using Pixels = Eigen::Map<const Eigen::Matrix2Xd>;
using Vector6d = Eigen::Matrix<double, 6, 1>;
using Information = Eigen::Matrix<double, 6, 6>;

constexpr double INFINITE = std::numeric_limits<double>::infinity();
constexpr double SAME_RAD = 0.01;
constexpr int REFINE_MAX = 100;
constexpr double REFINE_UNTIL = 1e-12;  // [m, rad] of a step
// Of a sum of squares: near the minimum a good step may seem to raise it.
constexpr double ROUNDING = 1.0 + 1e-12;
constexpr double DAMPING_FIRST = 1e-6;

struct Pose {
    Matrix3d R;
    Vector3d p_m;
};

struct View {
    Vector2d focal_px, centre_px;
    Corners corner_m;
    Pixels corner_px;
};

// Of all corners at a pose: sum of squared residuals, J'J and J'r by position and a rotation vector on the left.
struct Normal {
    double cost = 0.0;
    Information H = Information::Zero();
    Vector6d g = Vector6d::Zero();
};

Normal normal(const View &view, const Pose &pose)
{
    Normal sum;
    for (Index k = 0; k < view.corner_m.cols(); k++) {
        const Vector3d arm = pose.R * view.corner_m.col(k), seen = arm + pose.p_m;
        const Vector2d image = seen.hnormalized();
        const Vector2d residual = view.focal_px.cwiseProduct(image) + view.centre_px - view.corner_px.col(k);
        Eigen::Matrix<double, 2, 3> by;
        by << Matrix2d::Identity(), -image;
        by = (view.focal_px / seen.z()).asDiagonal() * by;
        Eigen::Matrix<double, 2, 6> J;
        J << by, by.rowwise().cross(-arm.transpose());
        sum.cost += seen.z() > 0.0 ? residual.squaredNorm() : INFINITE;
        sum.H += J.transpose() * J;
        sum.g += J.transpose() * residual;
    }
    return sum;
}

struct Fit {
    Pose pose;
    Normal sum;
};

// To the minimum that a start leads to (Levenberg and Marquardt); the cost is infinite if a corner
// is not before the camera at the start.
Fit refined(const View &view, const Pose &start)
{
    Fit fit{start, normal(view, start)};
    double damping = DAMPING_FIRST, size = fit.sum.cost < INFINITE ? 1.0 : 0.0;
    for (int k = 0; k < REFINE_MAX && size >= REFINE_UNTIL; k++) {
        Information damped = fit.sum.H;
        damped.diagonal() *= 1.0 + damping;
        const Vector6d step = -damped.llt().solve(fit.sum.g);
        const Eigen::Quaterniond turn(1.0, 0.5 * step[3], 0.5 * step[4], 0.5 * step[5]);
        const Pose moved{turn.normalized() * fit.pose.R, fit.pose.p_m + step.head<3>()};
        const Normal there = normal(view, moved);
        const bool better = there.cost <= fit.sum.cost * ROUNDING;
        if (better) { fit = {moved, there}; }
        damping *= better ? 0.1 : 10.0;
        size = step.lpNorm<Eigen::Infinity>();
    }
    return fit;
}

// Both poses of a tag that fit the derivative of its homography at the centre (Collins & Bartoli 2014). They differ in
// which way the tag leans along the line of sight.
std::array<Pose, 2> plane_poses(const View &view, Index first)
{
    const Eigen::Matrix<double, 3, 4> corner_m = view.corner_m.middleCols<4>(first);
    const Vector3d x_m = 0.5 * (corner_m.col(1) - corner_m.col(0)),
                   y_m = 0.5 * (corner_m.col(0) - corner_m.col(3));
    const double half_m = x_m.norm();  // of an edge, the unit of length in the plane
    Matrix3d R_tool_tag;
    R_tool_tag << x_m / half_m, y_m / half_m, x_m.cross(y_m) / (half_m * half_m);

    // The corners of a square, two by two across, have the same sum: so have their images, each at its depth.
    Matrix3d seen = (view.corner_px.middleCols<3>(first).colwise() - view.centre_px)
                        .cwiseQuotient(view.focal_px.replicate<1, 3>())
                        .colwise()
                        .homogeneous();
    const Vector3d fourth =
        (view.corner_px.col(first + 3) - view.centre_px).cwiseQuotient(view.focal_px).homogeneous();
    const Vector3d depth = seen.inverse() * fourth;
    seen.col(0) *= depth[0];
    seen.col(1) *= -depth[1];
    seen.col(2) *= depth[2];
    Matrix3d h;  // of the square from -1 to 1, y up
    h << 0.5 * (seen.col(1) - seen.col(0)), 0.5 * (seen.col(0) - fourth),
        0.25 * (seen.rowwise().sum() + fourth);
    h /= h(2, 2);
    const Vector3d centre = h.col(2), line = centre.normalized();
    Eigen::Matrix<double, 3, 2> across = h.leftCols<2>();  // of the line of sight, per depth
    across -= centre * h.row(2).head<2>();
    across -= line * (line.transpose() * across);
    const Matrix2d G = across.transpose() * across;
    const double mean = 0.5 * G.trace();
    const double largest = mean + std::sqrt(std::max(0.0, mean * mean - G.determinant()));
    const Matrix2d rest = Matrix2d::Identity() - G / largest;
    const Vector2d lean(std::sqrt(std::max(0.0, rest(0, 0))),
                        std::copysign(std::sqrt(std::max(0.0, rest(1, 1))), rest(0, 1)));

    std::array<Pose, 2> poses;
    for (size_t k = 0; k < 2; k++) {
        Matrix3d R;
        R.leftCols<2>() = across / std::sqrt(largest) + (k == 0 ? 1.0 : -1.0) * line * lean.transpose();
        R.col(2) = R.col(0).cross(R.col(1));
        poses[k].R = R * R_tool_tag.transpose();
        poses[k].p_m = half_m / std::sqrt(largest) * centre - poses[k].R * corner_m.rowwise().mean();
    }
    return poses;
}

void write(const Fit &fit, Index corners, double *out)
{
    Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>{out} = fit.pose.R;
    Eigen::Map<Vector3d>{out + 9} = fit.pose.p_m;
    out[12] = std::sqrt(fit.sum.cost / static_cast<double>(2 * corners));
}

}  // namespace

// The minima of the reprojection error, all corners alike: each tag gives two plane poses, each is refined on the
// corners of all tags.
//   camera       fx, fy, cx, cy [px]
//   corner_m     n_tags x 4 x 3, tool frame, in libapriltag's order: x of the tag runs from the first to the second,
//                y from the fourth to the first
//   corner_px    n_tags x 4 x 2
//   poses        2 x 13: attitude by rows, position, RMS of reprojection over 2 coordinates a corner; the best, then
//                the next one more than 0.01 rad from it, or the best again if there is none
//   information  6 x 6, J'J at the best [px^2 per m, rad]: position, then a rotation vector on the left
// Number of poses found: 0 (none lies before the camera; the results mean nothing), 1 or 2.
extern "C" uint32_t ks_pnp(uint32_t n_tags, const double *camera, const double *corner_m,
                           const double *corner_px, double *poses, double *information)
{
    const Index n = 4 * Index{n_tags};
    const View view{Vector2d(camera), Vector2d(camera + 2), Corners(corner_m, 3, n), Pixels(corner_px, 2, n)};
    std::vector<Fit> fits;
    for (Index first = 0; first < n; first += 4) {
        for (const Pose &start : plane_poses(view, first)) {
            const Fit fit = refined(view, start);
            if (std::isfinite(fit.sum.cost)) { fits.push_back(fit); }
        }
    }
    if (fits.empty()) { return 0; }
    std::stable_sort(fits.begin(), fits.end(),
                     [](const Fit &a, const Fit &b) { return a.sum.cost < b.sum.cost; });
    const auto other = std::find_if(fits.begin(), fits.end(), [&](const Fit &fit) {
        return Eigen::AngleAxisd(fit.pose.R * fits[0].pose.R.transpose()).angle() > SAME_RAD;
    });
    const bool two = other != fits.end();
    write(fits[0], n, poses);
    write(two ? *other : fits[0], n, poses + 13);
    Eigen::Map<Information>{information} = fits[0].sum.H;
    return two ? 2 : 1;
}
