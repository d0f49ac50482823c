// Pose of the tool from the corners of its tags, for the mode without pixels (docs/METHOD.md 19). Lengths are in
// metres, images in pixels; poses take the tool to the camera frame, z forward, x right, y down. Nothing of flight is
// used. Vectors of three and matrices of six are written out: Eigen's templates took the compiler 20 times as long.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

namespace {

constexpr double INFINITE = std::numeric_limits<double>::infinity();
constexpr double SAME_RAD = 0.01;
constexpr int REFINE_MAX = 100;
constexpr double REFINE_UNTIL = 1e-12;  // [m, rad] of a step
// Of a sum of squares: near the minimum a good step may seem to raise it.
constexpr double ROUNDING = 1.0 + 1e-12;
constexpr double DAMPING_FIRST = 1e-6;

struct Vector {
    double x, y, z;
};

Vector operator+(const Vector &a, const Vector &b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
Vector operator-(const Vector &a, const Vector &b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
Vector operator*(double s, const Vector &a) { return {s * a.x, s * a.y, s * a.z}; }
double dot(const Vector &a, const Vector &b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
double norm(const Vector &a) { return std::sqrt(dot(a, a)); }
Vector cross(const Vector &a, const Vector &b)
{
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

using Matrix = std::array<Vector, 3>;  // columns
Vector operator*(const Matrix &A, const Vector &v) { return v.x * A[0] + v.y * A[1] + v.z * A[2]; }

constexpr size_t DOF = 6;
using Vector6 = std::array<double, DOF>;
using Matrix6 = std::array<Vector6, DOF>;

struct Pose {
    Matrix R;
    Vector p_m;
};

struct View {
    const double *camera, *corner_m, *corner_px;
    size_t corners;

    Vector point_m(size_t k) const { return {corner_m[3 * k], corner_m[3 * k + 1], corner_m[3 * k + 2]}; }
    // Where a corner is seen, at depth 1.
    Vector image(size_t k) const
    {
        return {(corner_px[2 * k] - camera[2]) / camera[0], (corner_px[2 * k + 1] - camera[3]) / camera[1],
                1.0};
    }
};

// Of all corners at a pose: sum of squared residuals, J'J (lower triangle) and J'r by position and a
// rotation vector on the left.
struct Normal {
    double cost = 0.0;
    Matrix6 H = {};
    Vector6 g = {};

    // A coordinate of an image by the seen point.
    void add(double residual, const Vector &by, const Vector &arm)
    {
        const Vector turned = cross(arm, by);
        const Vector6 J = {by.x, by.y, by.z, turned.x, turned.y, turned.z};
        cost += residual * residual;
        for (size_t i = 0; i < DOF; i++) {
            for (size_t j = 0; j <= i; j++) { H[i][j] += J[i] * J[j]; }
            g[i] += J[i] * residual;
        }
    }
};

Normal normal(const View &view, const Pose &pose)
{
    const double fx = view.camera[0], fy = view.camera[1], cx = view.camera[2], cy = view.camera[3];
    Normal sum;
    for (size_t k = 0; k < view.corners; k++) {
        const Vector arm = pose.R * view.point_m(k), seen = arm + pose.p_m;
        const double x = seen.x / seen.z, y = seen.y / seen.z;
        sum.add(fx * x + cx - view.corner_px[2 * k], fx / seen.z * Vector{1.0, 0.0, -x}, arm);
        sum.add(fy * y + cy - view.corner_px[2 * k + 1], fy / seen.z * Vector{0.0, 1.0, -y}, arm);
        if (!(seen.z > 0.0)) { sum.cost = INFINITE; }
    }
    return sum;
}

// A^-1 b of a positive definite A (lower triangle), by its Cholesky factor.
Vector6 solved(Matrix6 A, Vector6 b)
{
    for (size_t j = 0; j < DOF; j++) {
        for (size_t i = j; i < DOF; i++) {
            for (size_t k = 0; k < j; k++) { A[i][j] -= A[i][k] * A[j][k]; }
            A[i][j] = i == j ? std::sqrt(A[j][j]) : A[i][j] / A[j][j];
        }
        for (size_t k = 0; k < j; k++) { b[j] -= A[j][k] * b[k]; }
        b[j] /= A[j][j];
    }
    for (size_t i = DOF; i-- > 0;) {
        for (size_t k = i + 1; k < DOF; k++) { b[i] -= A[k][i] * b[k]; }
        b[i] /= A[i][i];
    }
    return b;
}

struct Fit {
    Pose pose;
    Normal sum;
};

// By the rotation of the quaternion (1, half).
Pose moved(const Pose &pose, const Vector &shift_m, const Vector &half)
{
    const double factor = 2.0 / (1.0 + dot(half, half));
    Pose there{pose.R, pose.p_m + shift_m};
    for (Vector &axis : there.R) { axis = axis + factor * cross(half, axis + cross(half, axis)); }
    return there;
}

// To the minimum that a start leads to (Levenberg and Marquardt); the cost is infinite if a corner
// is not before the camera at the start.
Fit refined(const View &view, const Pose &start)
{
    Fit fit{start, normal(view, start)};
    double damping = DAMPING_FIRST, size = fit.sum.cost < INFINITE ? 1.0 : 0.0;
    for (int k = 0; k < REFINE_MAX && size >= REFINE_UNTIL; k++) {
        Matrix6 damped = fit.sum.H;
        for (size_t i = 0; i < DOF; i++) { damped[i][i] *= 1.0 + damping; }
        const Vector6 s = solved(damped, fit.sum.g);
        const Pose next = moved(fit.pose, {-s[0], -s[1], -s[2]}, {-0.5 * s[3], -0.5 * s[4], -0.5 * s[5]});
        const Normal there = normal(view, next);
        const bool better = there.cost <= fit.sum.cost * ROUNDING;
        if (better) { fit = {next, there}; }
        damping *= better ? 0.1 : 10.0;
        size = 0.0;
        for (double step : s) { size = std::max(size, std::abs(step)); }
    }
    return fit;
}

// Both poses of a tag that fit the derivative of its homography at the centre (Collins & Bartoli 2014). They differ in
// which way the tag leans along the line of sight.
std::array<Pose, 2> plane_poses(const View &view, size_t first)
{
    const Vector a_m = view.point_m(first), b_m = view.point_m(first + 1), c_m = view.point_m(first + 2),
                 d_m = view.point_m(first + 3);
    const Vector x_m = 0.5 * (b_m - a_m), y_m = 0.5 * (a_m - d_m), middle_m = 0.25 * (a_m + b_m + c_m + d_m);
    const double half_m = norm(x_m);  // of an edge, the unit of length in the plane
    const Matrix R_tool_tag = {1.0 / half_m * x_m, 1.0 / half_m * y_m,
                               1.0 / (half_m * half_m) * cross(x_m, y_m)};

    // The corners of a square, two by two across, have the same sum: so have their images, each at its depth. That of
    // the fourth is 1.
    const Vector a = view.image(first), b = view.image(first + 1), c = view.image(first + 2),
                 fourth = view.image(first + 3);
    const double volume = dot(a, cross(b, c));
    const Vector at_a = dot(fourth, cross(b, c)) / volume * a, at_b = -dot(fourth, cross(c, a)) / volume * b,
                 at_c = dot(fourth, cross(a, b)) / volume * c;
    const Vector sum = at_a + at_b + at_c + fourth;
    const double scale = 4.0 / sum.z;  // homography of the square from -1 to 1, y up: 1 in the last place
    const Vector by_x = 0.5 * scale * (at_b - at_a), by_y = 0.5 * scale * (at_a - fourth),
                 centre = 0.25 * scale * sum, line = 1.0 / norm(centre) * centre;
    const auto across = [&](const Vector &by) {  // the line of sight, per depth
        const Vector image = by - by.z * centre;
        return image - dot(line, image) * line;
    };
    const Vector u = across(by_x), v = across(by_y);
    const double uu = dot(u, u), uv = dot(u, v), vv = dot(v, v), mean = 0.5 * (uu + vv);
    const double largest = mean + std::sqrt(std::max(0.0, mean * mean - (uu * vv - uv * uv)));
    const double lean_x = std::sqrt(std::max(0.0, 1.0 - uu / largest)),
                 lean_y = std::copysign(std::sqrt(std::max(0.0, 1.0 - vv / largest)), -uv);

    std::array<Pose, 2> poses = {};
    const double per_depth = 1.0 / std::sqrt(largest);
    double side = 1.0;
    for (Pose &pose : poses) {
        const Vector x = per_depth * u + side * lean_x * line, y = per_depth * v + side * lean_y * line,
                     z = cross(x, y);
        const Matrix tool = {Vector{R_tool_tag[0].x, R_tool_tag[1].x, R_tool_tag[2].x},
                             Vector{R_tool_tag[0].y, R_tool_tag[1].y, R_tool_tag[2].y},
                             Vector{R_tool_tag[0].z, R_tool_tag[1].z, R_tool_tag[2].z}};
        const Matrix R = {x, y, z};
        pose.R = {R * tool[0], R * tool[1], R * tool[2]};
        pose.p_m = half_m * per_depth * centre - pose.R * middle_m;
        side = -1.0;
    }
    return poses;
}

// Between two attitudes [rad].
double angle(const Matrix &A, const Matrix &B)
{
    double distance2 = 0.0;
    for (size_t k = 0; k < 3; k++) { distance2 += dot(A[k] - B[k], A[k] - B[k]); }
    return 2.0 * std::asin(std::min(1.0, std::sqrt(distance2 / 8.0)));
}

void write(const Fit &fit, size_t corners, double *out)
{
    const Pose &pose = fit.pose;
    for (size_t k = 0; k < 3; k++) {
        out[k] = pose.R[k].x;
        out[3 + k] = pose.R[k].y;
        out[6 + k] = pose.R[k].z;
    }
    out[9] = pose.p_m.x;
    out[10] = pose.p_m.y;
    out[11] = pose.p_m.z;
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
    const size_t n = 4 * size_t{n_tags};
    const View view{camera, corner_m, corner_px, n};
    const auto better = [](const Fit &a, const Fit &b) { return a.sum.cost < b.sum.cost; };
    std::vector<Fit> fits;
    for (size_t first = 0; first < n; first += 4) {
        for (const Pose &start : plane_poses(view, first)) {
            const Fit fit = refined(view, start);
            if (std::isfinite(fit.sum.cost)) {
                fits.insert(std::upper_bound(fits.begin(), fits.end(), fit, better), fit);
            }
        }
    }
    if (fits.empty()) { return 0; }
    const auto other = std::find_if(fits.begin(), fits.end(), [&](const Fit &fit) {
        return angle(fit.pose.R, fits[0].pose.R) > SAME_RAD;
    });
    const bool two = other != fits.end();
    write(fits[0], n, poses);
    write(two ? *other : fits[0], n, poses + 13);
    const Matrix6 &H = fits[0].sum.H;
    for (size_t i = 0; i < DOF; i++) {
        for (size_t j = 0; j <= i; j++) { information[DOF * i + j] = information[DOF * j + i] = H[i][j]; }
    }
    return two ? 2 : 1;
}
