#include "detect.hpp"

#include <apriltag/apriltag.h>
#include <apriltag/tag36h11.h>

#include <algorithm>
#include <new>
#include <stdexcept>

namespace tagdet {
namespace {

// libapriltag puts pixel centres at half coordinates; here they are whole.
constexpr double CENTRE_PX = 0.5;

bool is_better(const apriltag_detection_t *a, const apriltag_detection_t *b)
{
    return b == nullptr || a->decision_margin > b->decision_margin;
}

DetectedTag detected_tag(const Tag &tag, const apriltag_detection_t &d)
{
    DetectedTag out{};
    out.tag = &tag;
    for (size_t i = 0; i < 4; i++) { out.corner_px[i] = {d.p[i][0] - CENTRE_PX, d.p[i][1] - CENTRE_PX}; }
    return out;
}

// Index of a tag in the configuration; its size if the tag is unknown.
size_t index_of(const Config &config, int id)
{
    const auto is_it = [id](const Tag &tag) { return tag.id == id; };
    return static_cast<size_t>(std::find_if(config.tags.begin(), config.tags.end(), is_it) -
                               config.tags.begin());
}

}  // namespace

Detector::Detector(const Config &config)
    : config_(config), family_(tag36h11_create()), detector_(apriltag_detector_create())
{
    if (family_ == nullptr || detector_ == nullptr) { throw std::bad_alloc(); }
    apriltag_detector_add_family_bits(detector_, family_, config.max_hamming);
    detector_->nthreads = config.threads;
    detector_->quad_decimate = config.quad_decimate;
    detector_->refine_edges = true;
}

Detector::~Detector()
{
    apriltag_detector_destroy(detector_);
    tag36h11_destroy(family_);
}

std::vector<DetectedTag> Detector::detect(const cv::Mat &grey, int *unknown)
{
    if (grey.type() != CV_8UC1 || grey.empty()) {
        throw std::invalid_argument("the image is not 8-bit grey");
    }
    image_u8_t view = {grey.cols, grey.rows, static_cast<int32_t>(grey.step[0]), grey.data};
    zarray_t *all = apriltag_detector_detect(detector_, &view);
    std::vector<const apriltag_detection_t *> best(config_.tags.size(), nullptr);
    *unknown = 0;
    for (int i = 0; i < zarray_size(all); i++) {
        apriltag_detection_t *d = nullptr;
        zarray_get(all, i, static_cast<void *>(&d));
        if (static_cast<double>(d->decision_margin) < config_.min_decision_margin) { continue; }
        const size_t k = index_of(config_, d->id);
        if (k == best.size()) {
            (*unknown)++;
        } else if (is_better(d, best[k])) {
            best[k] = d;
        }
    }
    std::vector<DetectedTag> detected;
    for (size_t k = 0; k < best.size(); k++) {
        if (best[k] != nullptr) { detected.push_back(detected_tag(config_.tags[k], *best[k])); }
    }
    apriltag_detections_destroy(all);
    return detected;
}

}  // namespace tagdet
