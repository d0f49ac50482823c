// The way of a KC_IMAGE into the tag detector: the message, the header of its JPEG, the decoder, the search for tags, the
// pose. The camera of the configuration is small, so that a frame is quick.
//
// Input: how, then a JPEG that is put into a message, or the message itself.
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "detect.hpp"
#include "frame.hpp"

extern "C" {
#include "kcm_image_t.h"
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

namespace {

constexpr int WIDTH_PX = 64, HEIGHT_PX = 48;
constexpr size_t FIXED = 32;

void must(bool holds, const char *what)
{
    if (holds) { return; }
    std::fprintf(stderr, "does not hold: %s\n", what);
    std::abort();
}

tagdet::Config config()
{
    tagdet::Config c{};
    c.width_px = WIDTH_PX;
    c.height_px = HEIGHT_PX;
    c.K = cv::Matx33d(60.0, 0.0, 31.5, 0.0, 60.0, 23.5, 0.0, 0.0, 1.0);
    c.edge_sigma_px = 0.0225;
    c.aligned_sigma_px = 0.075;
    c.corner_sigma_weight = 10.0;
    c.max_rms_px = 1.0;
    c.quad_decimate = 1.0F;
    c.threads = 1;
    c.max_hamming = 1;
    c.min_decision_margin = 5.0;
    c.tags = {{0, 0.1, cv::Matx33d::eye(), {}}, {1, 0.1, cv::Matx33d::eye(), {0.2, 0.0, 0.0}}};
    return c;
}

std::vector<uint8_t> message_of(const uint8_t *jpeg, size_t size)
{
    std::vector<uint8_t> message(FIXED + size);
    kcm_image_t image{};
    image.width_px = WIDTH_PX;
    image.height_px = HEIGHT_PX;
    image.n_bytes = static_cast<int32_t>(size);
    image.jpeg = const_cast<uint8_t *>(jpeg);  // NOLINT(cppcoreguidelines-pro-type-const-cast)
    const int n = kcm_image_t_encode(message.data(), 0, static_cast<int>(message.size()), &image);
    must(n == static_cast<int>(message.size()), "the size of a message");
    return message;
}

// What read_frame() takes is safe for the generated decoder, which reads the same.
void compare(const std::vector<uint8_t> &message, const tagdet::Frame &frame)
{
    kcm_image_t image{};
    const int n = static_cast<int>(message.size());
    must(kcm_image_t_decode(message.data(), 0, n, &image) == n, "decoded");
    must(image.t_us == frame.t_us && image.seq == frame.seq, "the same fields");
    must(static_cast<size_t>(image.n_bytes) == frame.n_bytes, "the same size");
    must(frame.n_bytes == 0 || std::memcmp(image.jpeg, frame.jpeg, frame.n_bytes) == 0, "the same bytes");
    kcm_image_t_decode_cleanup(&image);
}

void take(const tagdet::Config &camera, tagdet::Detector &detector, const std::vector<uint8_t> &message)
{
    const tagdet::Frame frame = tagdet::read_frame(message.data(), message.size());
    compare(message, frame);
    const cv::Mat grey = tagdet::decode_frame(camera, frame);
    must(grey.cols == WIDTH_PX && grey.rows == HEIGHT_PX && grey.type() == CV_8UC1, "the camera's image");
    int unknown = 0;
    std::vector<tagdet::DetectedTag> detected = detector.detect(grey, &unknown);
    must(detected.size() <= camera.tags.size() && unknown >= 0, "tags of the configuration");
    tagdet::Solution solution{};
    (void)tagdet::solve(camera, &detected, &solution);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static const tagdet::Config camera = config();
    static tagdet::Detector detector(camera);
    if (size == 0) { return 0; }
    const bool raw = (data[0] & 1U) != 0;
    const std::vector<uint8_t> message = raw ? std::vector<uint8_t>(data + 1, data + size)
                                             : message_of(data + 1, size - 1);
    try {
        take(camera, detector, message);
    } catch (const std::exception &) {
        // Refused, as the process does: counted and said.
    }
    return 0;
}
