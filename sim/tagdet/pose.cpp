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

// The two plane poses of one tag, as poses of the tool.
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

// Variance of a corner coordinate [px^2]. The known corner noise counts as corner_sigma_weight residuals,
// beside those of this fit that its 6 unknowns left free: with one tag these are only two.
double corner_variance(const Config &config, const Pose &pose, size_t n_corners)
{
    const double n = 2.0 * static_cast<double>(n_corners);
    const double known = config.corner_sigma_weight * config.corner_sigma_px * config.corner_sigma_px;
    return (known + n * pose.rms_px * pose.rms_px) / (config.corner_sigma_weight + n - 6.0);
}

// sigma^2 (J^T J)^-1 over all corners. False if singular.
bool covariance(const Config &config, const Pose &pose, const Points &tool, cv::Matx66d *cov)
{
    cv::Matx66d JtJ = cv::Matx66d::zeros();
    for (const cv::Point3d &corner : tool) {
        const cv::Matx<double, 2, 6> J = corner_jacobian(config.K, pose, corner);
        JtJ += J.t() * J;
    }
    bool ok = false;
    const cv::Matx66d inverse = JtJ.inv(cv::DECOMP_CHOLESKY, &ok);
    if (ok) { *cov = 0.5 * (inverse + inverse.t()) * corner_variance(config, pose, tool.size()); }
    return ok;
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
                             const Points &tool, const Pixels &pixels)
{
    std::vector<Pose> found;
    for (const DetectedTag &d : detected) {
        for (const Pose &start : plane_poses(config.K, d)) {
            const Pose pose = refine(config.K, start, tool, pixels);
            if (std::isfinite(pose.rms_px) && in_front(pose, tool)) { found.push_back(pose); }
        }
    }
    std::stable_sort(found.begin(), found.end(),
                     [](const Pose &a, const Pose &b) { return a.rms_px < b.rms_px; });
    return found;
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
    const std::vector<Pose> found = candidates(config, detected, tool, pixels);
    if (found.empty()) { return false; }
    Solution s{};
    s.best = found.front();
    const auto other = std::find_if(found.begin(), found.end(), [&](const Pose &p) {
        return rotation_angle(s.best.R_cam_tool.t() * p.R_cam_tool) > SAME_RAD;
    });
    s.alternative = other == found.end() ? s.best : *other;
    s.incidence_rad = min_incidence(s.best, detected);
    if (!covariance(config, s.best, tool, &s.cov)) { return false; }
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
                      c.corner_sigma_px > 0.0 && c.corner_sigma_weight >= 0.0 && c.max_rms_px > 0.0 &&
                      c.quad_decimate >= 1.0F && c.threads >= 1 && c.max_hamming >= 0 && c.max_hamming <= 2;
    if (!sane) {
        throw std::runtime_error(path + ": image size, focal lengths, corner_sigma_px, corner_sigma_weight, "
                                        "max_rms_px, quad_decimate (>= 1), "
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
    c.corner_sigma_px = field<double>(root, "corner_sigma_px", path);
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
