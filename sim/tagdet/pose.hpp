// Pose of the tool from the corners of the detected tags.
#ifndef KC_TAGDET_POSE_HPP
#define KC_TAGDET_POSE_HPP

#include <array>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

namespace tagdet {

// A tag on the tool. Tag frame: x right, y down, z into the tag as a viewer sees it.
struct Tag {
    int id;
    double size_m;         // edge of the black square
    cv::Matx33d R_tool_tag;
    cv::Vec3d p_tool_tag;  // centre of the tag
};

// What the detector believes about camera and tags: sim/models/detector.yml.
struct Config {
    int width_px, height_px;
    cv::Matx33d K;  // pixel centres have whole coordinates
    double edge_sigma_px, aligned_sigma_px, corner_sigma_weight;
    double max_rms_px;
    float quad_decimate;
    int threads, max_hamming;
    double min_decision_margin;
    std::vector<Tag> tags;
};

// Reads the configuration; throws std::runtime_error naming file and field.
Config load_config(const std::string &path);

// A tag of the configuration in the image: corners bottom left, bottom right, top right, top left.
struct DetectedTag {
    const Tag *tag;
    std::array<cv::Point2d, 4> corner_px;
};

// Tool in the camera frame [m], with the RMS of the reprojection error.
struct Pose {
    cv::Matx33d R_cam_tool;
    cv::Vec3d p_cam_tool;
    double rms_px;
};

struct Solution {
    Pose best;
    Pose alternative;  // the other minimum (planar flip); equal to `best` if there is none
    // Position [m] and rotation vector [rad], both in the camera frame; rotation error on the left.
    cv::Matx66d cov;
    double incidence_rad;  // of the tag seen least obliquely
};

// One pose from all tags together. Each tag's two plane poses (IPPE) are refined on all corners; the
// one with the least reprojection error is the answer. While its RMS is above max_rms_px, the tag
// that worsens it most is taken out of *detected: something hides a part of it. False, with *out unchanged,
// if nothing is left, no candidate is in front of the camera or the geometry does not fix a pose.
bool solve(const Config &config, std::vector<DetectedTag> *detected, Solution *out);

// Unit quaternion (w, x, y, z), w >= 0.
std::array<double, 4> quaternion(const cv::Matx33d &R);

}  // namespace tagdet

#endif
