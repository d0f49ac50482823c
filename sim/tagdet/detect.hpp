// Finds the tool's tags in a grey image (libapriltag, family 36h11).
#ifndef KC_TAGDET_DETECT_HPP
#define KC_TAGDET_DETECT_HPP

#include <opencv2/core.hpp>
#include <vector>

#include "pose.hpp"

struct apriltag_detector;
struct apriltag_family;

namespace tagdet {

class Detector {
public:
    // Keeps a reference to the configuration.
    explicit Detector(const Config &config);
    ~Detector();
    Detector(const Detector &) = delete;
    Detector &operator=(const Detector &) = delete;

    // Tags of the configuration in an 8-bit grey image, in the order of the configuration; corners with
    // pixel centres at whole coordinates. *unknown counts tags that are not in the configuration. Throws
    // std::invalid_argument if the image is not 8-bit grey.
    std::vector<DetectedTag> detect(const cv::Mat &grey, int *unknown);

private:
    const Config &config_;
    apriltag_family *family_;
    apriltag_detector *detector_;
};

}  // namespace tagdet

#endif
