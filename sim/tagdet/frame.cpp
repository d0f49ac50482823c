#include "frame.hpp"

#include <array>
#include <cstring>
#include <opencv2/imgcodecs.hpp>
#include <stdexcept>
#include <string>

extern "C" {
#include "kcm_image_t.h"
}

namespace tagdet {
namespace {

// Of an image_t without a JPEG: fingerprint and fields; the last of them is n_bytes.
constexpr size_t FIXED = 32;
constexpr size_t N_BYTES = 4;

uint32_t big_endian(const uint8_t *at, size_t n)
{
    uint32_t value = 0;
    for (size_t i = 0; i < n; i++) { value = value << 8U | at[i]; }
    return value;
}

std::string size_text(uint32_t width, uint32_t height)
{
    return std::to_string(width) + "x" + std::to_string(height);
}

// Markers of JPEG (ITU-T T.81, B.1.1.3).
constexpr uint8_t SOF0 = 0xC0, SOF1 = 0xC1, SOF15 = 0xCF, DHT = 0xC4, JPG = 0xC8, DAC = 0xCC;
constexpr uint8_t RST0 = 0xD0, SOS = 0xDA, MARKER = 0xFF;

// SOF0 and SOF1: sequential, Huffman. With one component these have one scan, which bounds the work.
bool is_frame_header(uint8_t marker)
{
    return marker >= SOF0 && marker <= SOF15 && marker != DHT && marker != JPG && marker != DAC;
}

// Where a JPEG's frame header begins (at its marker) and ends; throws if there is none before its first scan.
const uint8_t *frame_header(const uint8_t *at, const uint8_t *end, const uint8_t **header_end)
{
    if (end - at < 4 || at[0] != MARKER || at[1] != 0xD8) { throw std::runtime_error("not a JPEG"); }
    at += 2;
    while (end - at >= 4) {
        if (at[0] == MARKER && at[1] == MARKER) {  // filling
            at++;
            continue;
        }
        const uint32_t length = big_endian(at + 2, 2);
        const bool segment = at[0] == MARKER && at[1] >= SOF0 && (at[1] < RST0 || at[1] > SOS);
        if (!segment || length < 2 || end - at < static_cast<std::ptrdiff_t>(length) + 2) { break; }
        *header_end = at + 2 + length;
        if (is_frame_header(at[1])) { return at; }
        at = *header_end;
    }
    throw std::runtime_error("not a JPEG: no frame header");
}

void check_header(const Config &config, const Frame &frame)
{
    const uint8_t *end = nullptr;
    const uint8_t *at = frame_header(frame.jpeg, frame.jpeg + frame.n_bytes, &end);
    // marker, length, precision, height, width, number of components
    if (at[1] > SOF1 || end - at < 10 || at[4] != 8 || at[9] != 1) {
        throw std::runtime_error("not a baseline JPEG of 8 bits with one component");
    }
    const uint32_t height = big_endian(at + 5, 2);
    const uint32_t width = big_endian(at + 7, 2);
    const auto want_width = static_cast<uint32_t>(config.width_px);
    const auto want_height = static_cast<uint32_t>(config.height_px);
    if (width != want_width || height != want_height) {
        throw std::runtime_error("the JPEG is " + size_text(width, height) + ", the configuration says " +
                                 size_text(want_width, want_height));
    }
}

}  // namespace

Frame read_frame(const void *message, size_t size)
{
    std::array<uint8_t, FIXED> fixed{};
    const auto *bytes = static_cast<const uint8_t *>(message);
    if (size < FIXED) { throw std::runtime_error("no image_t: " + std::to_string(size) + " bytes"); }
    std::memcpy(fixed.data(), bytes, FIXED);
    // The generated decoder reads the fields, of an image without bytes.
    uint8_t *stated = fixed.data() + FIXED - N_BYTES;
    const uint32_t n_bytes = big_endian(stated, N_BYTES);
    std::memset(stated, 0, N_BYTES);
    kcm_image_t image{};
    if (kcm_image_t_decode(fixed.data(), 0, FIXED, &image) != FIXED) {
        throw std::runtime_error("no image_t: another fingerprint");
    }
    if (n_bytes != size - FIXED) {
        throw std::runtime_error("n_bytes is " + std::to_string(static_cast<int32_t>(n_bytes)) + ", " +
                                 std::to_string(size - FIXED) + " follow");
    }
    return {image.t_us, image.seq, image.width_px, image.height_px, bytes + FIXED, n_bytes};
}

cv::Mat decode_frame(const Config &config, const Frame &frame)
{
    check_header(config, frame);
    // imdecode() only reads.
    auto *jpeg = const_cast<uint8_t *>(frame.jpeg);  // NOLINT(cppcoreguidelines-pro-type-const-cast)
    const cv::Mat bytes(1, static_cast<int>(frame.n_bytes), CV_8UC1, static_cast<void *>(jpeg));
    cv::Mat grey = cv::imdecode(bytes, cv::IMREAD_GRAYSCALE | cv::IMREAD_IGNORE_ORIENTATION);
    if (grey.empty()) { throw std::runtime_error("not a JPEG"); }
    return grey;
}

}  // namespace tagdet
