// One frame from the network: nothing that it states about itself is believed before it was checked.
#ifndef KC_TAGDET_FRAME_HPP
#define KC_TAGDET_FRAME_HPP

#include <cstddef>
#include <cstdint>
#include <opencv2/core.hpp>

#include "pose.hpp"

namespace tagdet {

// An image_t where it was received; jpeg points into the message.
struct Frame {
    int64_t t_us;
    int32_t seq, width_px, height_px;
    const uint8_t *jpeg;
    size_t n_bytes;
};

// The frame in a message; throws std::runtime_error if the message is no image_t, or n_bytes is not the number of
// bytes that follow. lcm-gen's decoder of image_t must not see a message before: it takes n_bytes as it is, allocates
// that much and copies it, -1 too.
Frame read_frame(const void *message, size_t size);

// The image of a frame. Throws std::runtime_error unless it is a baseline JPEG with one component, in the resolution
// of the configuration; that is read from its header, before memory for the pixels is taken.
cv::Mat decode_frame(const Config &config, const Frame &frame);

}  // namespace tagdet

#endif
