#include "pose.hpp"

#include <algorithm>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <stdexcept>

namespace tagdet {
namespace {

// Two refined candidates this close are the same minimum.
constexpr double SAME_RAD = 0.01;
constexpr int REFINE_ITER_MAX = 50;
constexpr double REFINE_EPS = 1e-12;
constexpr int WEIGHTED_ITER_MAX = 15;
constexpr double WEIGHTED_EPS = 1e-10;
// Tilts of a tag seen from the front: the minima are not farther from each other, the one minimum is not more oblique.
constexpr double FRONT_BETWEEN_RAD = 0.21;
constexpr double FRONT_INCIDENCE_RAD = 0.105;
constexpr int TILTS_ALONG = 30;  // to each side
constexpr int TILTS_ACROSS = 8;
constexpr double TILT_SIGMAS = 4.0;
constexpr int TILT_ITER = 2;

using Points = std::vector<cv::Point3d>;
using Pixels = std::vector<cv::Point2d>;

// Corners in the tag frame, in libapriltag's order.
Points tag_corners(const Tag &tag)
{
    const double h = 0.5 * tag.size_m;
    return {{-h, h, 0.0}, {h, h, 0.0}, {h, -h, 0.0}, {-h, -h, 0.0}};
}

double rotation_angle(const cv::Matx33d &R)
{
    const std::array<double, 4> q = quaternion(R);
    return 2.0 * std::atan2(std::sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3]), q[0]);
}

bool in_front(const Pose &pose, const Points &tool)
{
    return std::all_of(tool.begin(), tool.end(), [&](const cv::Point3d &x) {
        return (pose.R_cam_tool * cv::Vec3d(x.x, x.y, x.z) + pose.p_cam_tool)[2] > 0.0;
    });
}

double reprojection_rms(const cv::Matx33d &K, const Pose &pose, const Points &tool, const Pixels &pixels)
{
    double sum = 0.0;
    for (size_t i = 0; i < tool.size(); i++) {
        const cv::Vec3d x = K *
                            (pose.R_cam_tool * cv::Vec3d(tool[i].x, tool[i].y, tool[i].z) + pose.p_cam_tool);
        const double du = x[0] / x[2] - pixels[i].x;
        const double dv = x[1] / x[2] - pixels[i].y;
        sum += du * du + dv * dv;
    }
    return std::sqrt(sum / (2.0 * static_cast<double>(tool.size())));
}

Pose refine(const cv::Matx33d &K, const Pose &start, const Points &tool, const Pixels &pixels)
{
    cv::Vec3d rvec;
    cv::Vec3d tvec = start.p_cam_tool;
    cv::Rodrigues(start.R_cam_tool, rvec);
    const cv::TermCriteria stop(cv::TermCriteria::EPS + cv::TermCriteria::COUNT, REFINE_ITER_MAX, REFINE_EPS);
    cv::solvePnPRefineLM(tool, pixels, K, cv::noArray(), rvec, tvec, stop);
    Pose pose{};
    cv::Rodrigues(rvec, pose.R_cam_tool);
    pose.p_cam_tool = tvec;
    pose.rms_px = reprojection_rms(K, pose, tool, pixels);
    return pose;
}

// The two plane poses of one tag, as poses of the tool (docs/METHOD.md 19).
std::vector<Pose> plane_poses(const cv::Matx33d &K, const DetectedTag &detected)
{
    std::vector<cv::Mat> rvecs;
    std::vector<cv::Mat> tvecs;
    const Pixels pixels(detected.corner_px.begin(), detected.corner_px.end());
    cv::solvePnPGeneric(tag_corners(*detected.tag), pixels, K, cv::noArray(), rvecs, tvecs, false,
                        cv::SOLVEPNP_IPPE);
    std::vector<Pose> poses;
    for (size_t i = 0; i < rvecs.size(); i++) {
        cv::Matx33d R_cam_tag;
        cv::Rodrigues(rvecs[i], R_cam_tag);
        Pose pose{};
        pose.R_cam_tool = R_cam_tag * detected.tag->R_tool_tag.t();
        pose.p_cam_tool = cv::Vec3d(tvecs[i].at<double>(0), tvecs[i].at<double>(1), tvecs[i].at<double>(2)) -
                          pose.R_cam_tool * detected.tag->p_tool_tag;
        poses.push_back(pose);
    }
    return poses;
}

// d pixels / d (position, left rotation vector) of one corner, both in the camera frame.
cv::Matx<double, 2, 6> corner_jacobian(const cv::Matx33d &K, const Pose &pose, const cv::Point3d &corner)
{
    const double fx = K(0, 0);
    const double fy = K(1, 1);
    const cv::Vec3d r = pose.R_cam_tool * cv::Vec3d(corner.x, corner.y, corner.z);
    const cv::Vec3d x = r + pose.p_cam_tool;
    const cv::Matx23d D(fx / x[2], 0.0, -fx * x[0] / (x[2] * x[2]), 0.0, fy / x[2],
                        -fy * x[1] / (x[2] * x[2]));
    // A small turn w moves the corner by w x r = -[r]x w.
    const cv::Matx33d minus_cross(0.0, r[2], -r[1], -r[2], 0.0, r[0], r[1], -r[0], 0.0);
    const cv::Matx23d Dw = D * minus_cross;
    cv::Matx<double, 2, 6> J;
    for (int row = 0; row < 2; row++) {
        for (int col = 0; col < 3; col++) {
            J(row, col) = D(row, col);
            J(row, col + 3) = Dw(row, col);
        }
    }
    return J;
}

using Corners = std::array<cv::Point2d, 4>;
using Matx88 = cv::Matx<double, 8, 8>;
using Matx84 = cv::Matx<double, 8, 4>;

// Standard deviation of the offset of a line that was fitted to an edge [px]. An edge along a row or a column of
// pixels meets every pixel at the same place, so that its error does not average out (docs/METHOD.md 19.1).
double edge_sigma(const Config &config, const cv::Point2d &along)
{
    const double steps = std::min(std::abs(along.x), std::abs(along.y));
    const double aligned = config.aligned_sigma_px * config.aligned_sigma_px / (1.0 + std::pow(steps, 4));
    return std::sqrt(config.edge_sigma_px * config.edge_sigma_px + aligned);
}

// Corners are where the lines of neighbouring edges meet. The error of a line fitted to points that are spread
// evenly over the edge is sigma in its middle and twice that at its ends, which go opposite ways: covariance
// sigma^2 [4 -2; -2 4] (docs/METHOD.md 19.1). Information (inverse covariance) of the eight coordinates.
Matx88 corner_information(const Config &config, const Corners &px)
{
    Matx88 offset_cov = Matx88::zeros();  // start and end of edge k, which goes from corner k to the next
    Matx88 corner_of = Matx88::zeros();  // d corners / d offsets
    std::array<cv::Vec2d, 4> normal;
    for (size_t k = 0; k < 4; k++) {
        const cv::Point2d along = px[(k + 1) % 4] - px[k];
        const int at = static_cast<int>(2 * k);
        const double variance = std::pow(edge_sigma(config, along), 2);
        normal[k] = cv::Vec2d(-along.y, along.x) / cv::norm(along);
        offset_cov(at, at) = offset_cov(at + 1, at + 1) = 4.0 * variance;
        offset_cov(at, at + 1) = offset_cov(at + 1, at) = -2.0 * variance;
    }
    for (size_t k = 0; k < 4; k++) {
        const size_t before = (k + 3) % 4;
        const cv::Matx22d meet(normal[before][0], normal[before][1], normal[k][0], normal[k][1]);
        const cv::Matx22d inverse = meet.inv();
        for (int row = 0; row < 2; row++) {
            const int at = static_cast<int>(2 * k) + row;
            corner_of(at, static_cast<int>(2 * before) + 1) = inverse(row, 0);
            corner_of(at, static_cast<int>(2 * k)) = inverse(row, 1);
        }
    }
    const Matx88 cov = corner_of * offset_cov * corner_of.t();
    return cov.inv(cv::DECOMP_CHOLESKY);
}

// Normal equations of the corners of one pose.
struct Normal {
    cv::Matx66d H;
    cv::Vec6d g;
    double chi2;
};

Normal normal_equations(const Config &config, const Pose &pose, const Points &tool, const Pixels &pixels,
                        const std::vector<Matx88> &information)
{
    Normal out{cv::Matx66d::zeros(), cv::Vec6d::all(0.0), 0.0};
    for (size_t tag = 0; tag < information.size(); tag++) {
        cv::Matx<double, 8, 6> J;
        cv::Vec<double, 8> r;
        for (size_t i = 0; i < 4; i++) {
            const size_t k = 4 * tag + i;
            const cv::Vec3d corner(tool[k].x, tool[k].y, tool[k].z);
            const cv::Vec3d x = config.K * (pose.R_cam_tool * corner + pose.p_cam_tool);
            const cv::Matx<double, 2, 6> Ji = corner_jacobian(config.K, pose, tool[k]);
            const int at = static_cast<int>(2 * i);
            r[at] = pixels[k].x - x[0] / x[2];
            r[at + 1] = pixels[k].y - x[1] / x[2];
            for (int col = 0; col < 6; col++) {
                J(at, col) = Ji(0, col);
                J(at + 1, col) = Ji(1, col);
            }
        }
        const cv::Matx<double, 6, 8> JtI = J.t() * information[tag];
        out.H += JtI * J;
        out.g += JtI * r;
        out.chi2 += r.dot(information[tag] * r);
    }
    return out;
}

// The pose that the corners with these covariances make most likely, from one nearby. False if singular.
bool weighted(const Config &config, const Points &tool, const Pixels &pixels,
              const std::vector<Matx88> &information, Pose *pose)
{
    for (int it = 0; it < WEIGHTED_ITER_MAX; it++) {
        const Normal n = normal_equations(config, *pose, tool, pixels, information);
        bool ok = false;
        const cv::Vec6d step = n.H.inv(cv::DECOMP_CHOLESKY, &ok) * n.g;
        if (!ok) { return false; }
        cv::Matx33d turn;
        cv::Rodrigues(cv::Vec3d(step[3], step[4], step[5]), turn);
        pose->p_cam_tool += cv::Vec3d(step[0], step[1], step[2]);
        pose->R_cam_tool = turn * pose->R_cam_tool;
        if (cv::norm(step) < WEIGHTED_EPS) { break; }
    }
    pose->rms_px = reprojection_rms(config.K, *pose, tool, pixels);
    return true;
}

// How much larger the variance is than known beforehand. What is known counts as corner_sigma_weight residuals,
// beside those of this fit that its unknowns left free: with one tag these are only two (docs/METHOD.md 19.2).
double variance_scale(const Config &config, double chi2, size_t n_corners, double unknowns)
{
    const double n = 2.0 * static_cast<double>(n_corners);
    return (config.corner_sigma_weight + chi2) / (config.corner_sigma_weight + n - unknowns);
}

// First order. False if singular.
bool covariance(const Config &config, const Pose &pose, const Points &tool, const Pixels &pixels,
                const std::vector<Matx88> &information, cv::Matx66d *cov)
{
    const Normal n = normal_equations(config, pose, tool, pixels, information);
    bool ok = false;
    const cv::Matx66d inverse = n.H.inv(cv::DECOMP_CHOLESKY, &ok);
    if (ok) { *cov = 0.5 * (inverse + inverse.t()) * variance_scale(config, n.chi2, tool.size(), 6.0); }
    return ok;
}

cv::Matx33d rotation(const cv::Vec3d &w)
{
    cv::Matx33d R;
    cv::Rodrigues(w, R);
    return R;
}

cv::Vec3d rotation_vector(const cv::Matx33d &R)
{
    cv::Vec3d w;
    cv::Rodrigues(R, w);
    return w;
}

// ---- a single tag seen from the front -------------------------------------------------------------------
//
// The image depends on the tilt of such a tag in second order: the two minima are close, and the
// covariance of neither says how far the truth may be. So the likelihood of the corners is summed over a grid of
// tilts about the middle of the two minima. Position and turn about the line of sight are fitted at each tilt
// (docs/METHOD.md 19.3).

// One tilt: pose of the tag with the best position and turn there.
struct Tilted {
    cv::Matx33d R;
    cv::Vec3d p;
    double chi2, log_likelihood;
    cv::Matx44d H;  // of position and turn
};

Tilted at_tilt(const Config &config, const cv::Matx33d &R, const cv::Vec3d &p, const cv::Vec3d &line,
               const Points &flat, const Corners &px, const Matx88 &information)
{
    Tilted t{R, p, 0.0, 0.0, cv::Matx44d::zeros()};
    for (int it = 0; it <= TILT_ITER; it++) {
        Matx84 A;
        cv::Vec<double, 8> r;
        for (size_t i = 0; i < 4; i++) {
            const cv::Vec3d from_centre = t.R * cv::Vec3d(flat[i].x, flat[i].y, flat[i].z);
            const cv::Vec3d x = from_centre + t.p;
            const cv::Vec3d uvw = config.K * x;
            const cv::Vec3d turned = line.cross(from_centre);
            const int at = static_cast<int>(2 * i);
            for (int row = 0; row < 2; row++) {
                const double f = config.K(row, row) / x[2];
                A(at + row, row) = f;
                A(at + row, 1 - row) = 0.0;
                A(at + row, 2) = -f * x[row] / x[2];
                A(at + row, 3) = f * turned[row] - f * x[row] / x[2] * turned[2];
            }
            r[at] = px[i].x - uvw[0] / uvw[2];
            r[at + 1] = px[i].y - uvw[1] / uvw[2];
        }
        const cv::Matx<double, 4, 8> AtI = A.t() * information;
        t.H = AtI * A;
        t.chi2 = r.dot(information * r);
        if (it == TILT_ITER) { break; }
        const cv::Vec4d step = t.H.inv() * (AtI * r);
        t.p += cv::Vec3d(step[0], step[1], step[2]);
        t.R = rotation(step[3] * line) * t.R;
    }
    // Eight residuals, four of which go to the unknowns that are summed over.
    const double weight = config.corner_sigma_weight;
    t.log_likelihood = -0.5 * (weight + 4.0) * std::log1p(t.chi2 / weight) -
                       0.5 * std::log(cv::determinant(t.H));
    return t;
}

// Range of tilts: along the difference of the minima and across it [rad].
struct TiltGrid {
    cv::Matx33d R_cam_tag;  // middle
    cv::Vec3d p_cam_tag, line, along, across;
    double reach_along, reach_across;
};

TiltGrid tilt_grid(const Tag &tag, const Solution &s)
{
    TiltGrid g{};
    const cv::Matx33d R = s.best.R_cam_tool * tag.R_tool_tag;
    const cv::Vec3d between = rotation_vector(s.alternative.R_cam_tool * s.best.R_cam_tool.t());
    g.R_cam_tag = rotation(0.5 * between) * R;
    g.p_cam_tag = 0.5 * (s.best.R_cam_tool * tag.p_tool_tag + s.best.p_cam_tool +
                         s.alternative.R_cam_tool * tag.p_tool_tag + s.alternative.p_cam_tool);
    g.line = g.p_cam_tag / cv::norm(g.p_cam_tag);
    const cv::Vec3d flat = cv::norm(between) > SAME_RAD ? between - g.line * g.line.dot(between)
                                                        : g.line.cross(cv::Vec3d(0.0, 1.0, 0.0));
    g.along = flat / cv::norm(flat);
    g.across = g.line.cross(g.along);
    return g;
}

void set_reach(TiltGrid *g, const cv::Matx66d &cov, double between_rad)
{
    const cv::Matx33d C = cov.get_minor<3, 3>(3, 3);
    g->reach_along = 0.5 * between_rad + TILT_SIGMAS * std::sqrt(g->along.dot(C * g->along));
    g->reach_across = TILT_SIGMAS * std::sqrt(g->across.dot(C * g->across));
}

std::vector<Tilted> all_tilts(const Config &config, const DetectedTag &d, const TiltGrid &g,
                              const Matx88 &information)
{
    const Points flat = tag_corners(*d.tag);
    std::vector<Tilted> tilts;
    for (int i = -TILTS_ALONG; i <= TILTS_ALONG; i++) {
        for (int k = -TILTS_ACROSS; k <= TILTS_ACROSS; k++) {
            const cv::Vec3d w = g.along * (g.reach_along * i / TILTS_ALONG) +
                                g.across * (g.reach_across * k / TILTS_ACROSS);
            tilts.push_back(at_tilt(config, rotation(w) * g.R_cam_tag, g.p_cam_tag, g.line, flat, d.corner_px,
                                    information));
        }
    }
    return tilts;
}

// Weights of tilts, with the sum 1.
std::vector<double> likelihoods(const std::vector<Tilted> &tilts)
{
    double most = tilts.front().log_likelihood, sum = 0.0;
    for (const Tilted &t : tilts) { most = std::max(most, t.log_likelihood); }
    std::vector<double> weights;
    for (const Tilted &t : tilts) {
        weights.push_back(std::exp(t.log_likelihood - most));
        sum += weights.back();
    }
    for (double &w : weights) { w /= sum; }
    return weights;
}

// Mean pose of the tool over all tilts by their likelihood, with its covariance.
void average(const Config &config, const DetectedTag &d, const TiltGrid &g, const std::vector<Tilted> &tilts,
             Solution *s)
{
    const std::vector<double> weights = likelihoods(tilts);
    const cv::Matx33d R_middle = g.R_cam_tag * d.tag->R_tool_tag.t();
    std::vector<cv::Vec6d> poses;  // position, rotation vector from the middle
    cv::Vec6d mean = cv::Vec6d::all(0.0);
    cv::Matx44d H = cv::Matx44d::zeros();
    double chi2 = 0.0;
    for (size_t k = 0; k < tilts.size(); k++) {
        const cv::Matx33d R = tilts[k].R * d.tag->R_tool_tag.t();
        const cv::Vec3d p = tilts[k].p - R * d.tag->p_tool_tag;
        const cv::Vec3d w = rotation_vector(R * R_middle.t());
        poses.emplace_back(p[0], p[1], p[2], w[0], w[1], w[2]);
        mean += weights[k] * poses.back();
        H += weights[k] * tilts[k].H;
        chi2 += weights[k] * tilts[k].chi2;
    }
    s->best.R_cam_tool = rotation(cv::Vec3d(mean[3], mean[4], mean[5])) * R_middle;
    s->best.p_cam_tool = cv::Vec3d(mean[0], mean[1], mean[2]);
    const cv::Vec3d lever = g.line.cross(-(s->best.R_cam_tool * d.tag->p_tool_tag));
    cv::Matx<double, 6, 4> of_tool = cv::Matx<double, 6, 4>::zeros();
    for (int row = 0; row < 3; row++) {
        of_tool(row, row) = 1.0;
        of_tool(row, 3) = lever[row];
        of_tool(row + 3, 3) = g.line[row];
    }
    s->cov = of_tool * (H.inv() * variance_scale(config, chi2, 4, 4.0)) * of_tool.t();
    for (size_t k = 0; k < tilts.size(); k++) {
        const cv::Vec6d off = poses[k] - mean;
        s->cov += weights[k] * (off * off.t());
    }
    s->cov = 0.5 * (s->cov + s->cov.t());
}

double min_incidence(const Pose &pose, const std::vector<DetectedTag> &detected)
{
    double best = CV_PI;
    for (const DetectedTag &d : detected) {
        const cv::Vec3d centre = pose.R_cam_tool * d.tag->p_tool_tag + pose.p_cam_tool;
        const cv::Vec3d inward = pose.R_cam_tool * d.tag->R_tool_tag * cv::Vec3d(0.0, 0.0, 1.0);
        const double along = inward.dot(centre) / cv::norm(centre);
        best = std::min(best, std::acos(std::clamp(along, -1.0, 1.0)));
    }
    return best;
}

template <typename T> T field(const cv::FileNode &node, const char *name, const std::string &where)
{
    const cv::FileNode value = node[name];
    if (value.empty() || !(value.isInt() || value.isReal())) {
        throw std::runtime_error(where + ": '" + name + "' is missing or not a number");
    }
    return static_cast<T>(static_cast<double>(value));
}

Tag load_tag(const cv::FileNode &node, const std::string &where)
{
    Tag tag{};
    tag.id = field<int>(node, "id", where);
    tag.size_m = field<double>(node, "size_m", where);
    const double a = field<double>(node, "turn_y_deg", where) * CV_PI / 180.0;
    tag.R_tool_tag = cv::Matx33d(std::cos(a), 0.0, std::sin(a), 0.0, 1.0, 0.0, -std::sin(a), 0.0,
                                 std::cos(a));
    const cv::FileNode xyz = node["xyz_m"];
    if (!xyz.isSeq() || xyz.size() != 3) {
        throw std::runtime_error(where + ": 'xyz_m' needs three numbers");
    }
    for (int i = 0; i < 3; i++) { tag.p_tool_tag[i] = static_cast<double>(xyz[i]); }
    if (tag.id < 0 || !(tag.size_m > 0.0)) {
        throw std::runtime_error(where + ": a tag needs an id >= 0 and a size above 0");
    }
    return tag;
}

}  // namespace

std::array<double, 4> quaternion(const cv::Matx33d &R)
{
    // The largest of the four components is found first, so that half turns lose no digits.
    const std::array<double, 4> four = {1.0 + R(0, 0) + R(1, 1) + R(2, 2), 1.0 + R(0, 0) - R(1, 1) - R(2, 2),
                                        1.0 - R(0, 0) + R(1, 1) - R(2, 2), 1.0 - R(0, 0) - R(1, 1) + R(2, 2)};
    const long k = std::max_element(four.begin(), four.end()) - four.begin();
    const double s = 0.5 / std::sqrt(four[static_cast<size_t>(k)]);
    const double a = R(2, 1) - R(1, 2);
    const double b = R(0, 2) - R(2, 0);
    const double c = R(1, 0) - R(0, 1);
    const double xy = R(0, 1) + R(1, 0);
    const double xz = R(0, 2) + R(2, 0);
    const double yz = R(1, 2) + R(2, 1);
    std::array<double, 4> q{};
    switch (k) {
    case 0: q = {four[0] * s, a * s, b * s, c * s}; break;
    case 1: q = {a * s, four[1] * s, xy * s, xz * s}; break;
    case 2: q = {b * s, xy * s, four[2] * s, yz * s}; break;
    default: q = {c * s, xz * s, yz * s, four[3] * s}; break;
    }
    const double norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    const double scale = q[0] < 0.0 ? -1.0 / norm : 1.0 / norm;
    for (double &v : q) { v *= scale; }
    return q;
}

namespace {

// The two plane poses of every tag, refined on all corners; those in front of the camera, best first.
std::vector<Pose> candidates(const Config &config, const std::vector<DetectedTag> &detected,
                             const Points &tool, const Pixels &pixels, const std::vector<Matx88> &information)
{
    std::vector<Pose> found;
    for (const DetectedTag &d : detected) {
        for (const Pose &start : plane_poses(config.K, d)) {
            Pose pose = refine(config.K, start, tool, pixels);
            const bool good = weighted(config, tool, pixels, information, &pose);
            if (good && std::isfinite(pose.rms_px) && in_front(pose, tool)) { found.push_back(pose); }
        }
    }
    std::stable_sort(found.begin(), found.end(),
                     [](const Pose &a, const Pose &b) { return a.rms_px < b.rms_px; });
    return found;
}

double between(const Solution &s) { return rotation_angle(s.best.R_cam_tool.t() * s.alternative.R_cam_tool); }

bool from_the_front(const Solution &s)
{
    const double angle = between(s);
    return angle > SAME_RAD ? angle < FRONT_BETWEEN_RAD : s.incidence_rad < FRONT_INCIDENCE_RAD;
}

// The mean over the tilts of a single tag takes the place of the best pose and its covariance.
void average_tilts(const Config &config, const DetectedTag &d, const Matx88 &information, Solution *s)
{
    TiltGrid g = tilt_grid(*d.tag, *s);
    Points tool;
    for (const cv::Point3d &c : tag_corners(*d.tag)) {
        const cv::Vec3d x = d.tag->R_tool_tag * cv::Vec3d(c.x, c.y, c.z) + d.tag->p_tool_tag;
        tool.emplace_back(x[0], x[1], x[2]);
    }
    // In the middle tilts are least certain.
    Pose middle{};
    middle.R_cam_tool = g.R_cam_tag * d.tag->R_tool_tag.t();
    middle.p_cam_tool = g.p_cam_tag - middle.R_cam_tool * d.tag->p_tool_tag;
    const Pixels pixels(d.corner_px.begin(), d.corner_px.end());
    const Normal n = normal_equations(config, middle, tool, pixels, {information});
    bool ok = false;
    const cv::Matx66d cov = n.H.inv(cv::DECOMP_CHOLESKY, &ok);
    set_reach(&g, ok ? cov : s->cov, between(*s));
    average(config, d, g, all_tilts(config, d, g, information), s);
}

// The fit to exactly these tags.
bool solve_all(const Config &config, const std::vector<DetectedTag> &detected, Solution *out)
{
    Points tool;
    Pixels pixels;
    for (const DetectedTag &d : detected) {
        for (const cv::Point3d &c : tag_corners(*d.tag)) {
            const cv::Vec3d x = d.tag->R_tool_tag * cv::Vec3d(c.x, c.y, c.z) + d.tag->p_tool_tag;
            tool.emplace_back(x[0], x[1], x[2]);
        }
        pixels.insert(pixels.end(), d.corner_px.begin(), d.corner_px.end());
    }
    std::vector<Matx88> information;
    information.reserve(detected.size());
    for (const DetectedTag &d : detected) { information.push_back(corner_information(config, d.corner_px)); }
    const std::vector<Pose> found = candidates(config, detected, tool, pixels, information);
    if (found.empty()) { return false; }
    Solution s{};
    s.best = found.front();
    const auto other = std::find_if(found.begin(), found.end(), [&](const Pose &p) {
        return rotation_angle(s.best.R_cam_tool.t() * p.R_cam_tool) > SAME_RAD;
    });
    s.alternative = other == found.end() ? s.best : *other;
    s.incidence_rad = min_incidence(s.best, detected);
    if (!covariance(config, s.best, tool, pixels, information, &s.cov)) { return false; }
    if (detected.size() == 1 && from_the_front(s)) {
        average_tilts(config, detected.front(), information.front(), &s);
        s.best.rms_px = reprojection_rms(config.K, s.best, tool, pixels);
        s.alternative = s.best;  // the mean stands for both
    }
    *out = s;
    return true;
}

// Takes out the tag whose absence leaves the best fit; false if no fit is left without any one of them.
bool drop_worst(const Config &config, std::vector<DetectedTag> *detected, Solution *out)
{
    bool found = false;
    std::vector<DetectedTag> kept;
    for (size_t k = 0; k < detected->size(); k++) {
        std::vector<DetectedTag> rest = *detected;
        rest.erase(rest.begin() + static_cast<long>(k));
        Solution s{};
        if (!rest.empty() && solve_all(config, rest, &s) && (!found || s.best.rms_px < out->best.rms_px)) {
            found = true;
            *out = s;
            kept = rest;
        }
    }
    *detected = kept;
    return found;
}

cv::FileStorage open_yaml(const std::string &path)
{
    cv::FileStorage file;
    try {
        file.open(path, cv::FileStorage::READ);
    } catch (const cv::Exception &e) {
        throw std::runtime_error(path + ": not readable as YAML: " + e.what());
    }
    if (!file.isOpened()) { throw std::runtime_error(path + ": cannot be opened"); }
    return file;
}

void check_ranges(const Config &c, const std::string &path)
{
    const bool sane = c.width_px > 0 && c.height_px > 0 && c.K(0, 0) > 0.0 && c.K(1, 1) > 0.0 &&
                      c.edge_sigma_px > 0.0 && c.aligned_sigma_px >= 0.0 && c.corner_sigma_weight > 0.0 &&
                      c.max_rms_px > 0.0 && c.quad_decimate >= 1.0F && c.threads >= 1 && c.max_hamming >= 0 &&
                      c.max_hamming <= 2;
    if (!sane) {
        throw std::runtime_error(path + ": image size, focal lengths, edge_sigma_px, aligned_sigma_px, "
                                        "corner_sigma_weight, max_rms_px, quad_decimate (>= 1), "
                                        "threads (>= 1) or max_hamming (0..2) is out of range");
    }
    if (c.tags.empty() || c.tags.size() > 4) { throw std::runtime_error(path + ": 1 to 4 tags are needed"); }
}

}  // namespace

bool solve(const Config &config, std::vector<DetectedTag> *detected, Solution *out)
{
    Solution s{};
    bool fits = !detected->empty() && solve_all(config, *detected, &s);
    while (fits && s.best.rms_px > config.max_rms_px) { fits = drop_worst(config, detected, &s); }
    if (fits) { *out = s; }
    return fits;
}

Config load_config(const std::string &path)
{
    const cv::FileStorage file = open_yaml(path);
    const cv::FileNode root = file.root();
    Config c{};
    c.width_px = field<int>(root, "width_px", path);
    c.height_px = field<int>(root, "height_px", path);
    c.K = cv::Matx33d(field<double>(root, "fx_px", path), 0.0, field<double>(root, "cx_px", path), 0.0,
                      field<double>(root, "fy_px", path), field<double>(root, "cy_px", path), 0.0, 0.0, 1.0);
    c.edge_sigma_px = field<double>(root, "edge_sigma_px", path);
    c.aligned_sigma_px = field<double>(root, "aligned_sigma_px", path);
    c.corner_sigma_weight = field<double>(root, "corner_sigma_weight", path);
    c.max_rms_px = field<double>(root, "max_rms_px", path);
    c.quad_decimate = field<float>(root, "quad_decimate", path);
    c.threads = field<int>(root, "threads", path);
    c.max_hamming = field<int>(root, "max_hamming", path);
    c.min_decision_margin = field<double>(root, "min_decision_margin", path);
    for (const cv::FileNode &node : root["tags"]) {
        c.tags.push_back(load_tag(node, path + ": tag " + std::to_string(c.tags.size() + 1)));
    }
    check_ranges(c, path);
    return c;
}

}  // namespace tagdet
