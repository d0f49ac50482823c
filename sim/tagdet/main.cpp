// kincal-tagdet: KC_IMAGE in, KC_DETECTION out; in lockstep also KC_TIME in, KC_TICK_DONE out.
//
// With --image it reads image files instead and prints one JSON line for each.
#include <lcm/lcm.h>
#include <unistd.h>

#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <exception>
#include <iostream>
#include <opencv2/imgcodecs.hpp>
#include <stdexcept>
#include <string>
#include <vector>

#include "detect.hpp"
#include "frame.hpp"
#include "pose.hpp"

extern "C" {
#include "kcm_detection_t.h"
#include "kcm_tick_done_t.h"
#include "kcm_time_t.h"
}

namespace {

using tagdet::Config;
using tagdet::DetectedTag;
using tagdet::Detector;
using tagdet::Solution;

constexpr int HEARTBEAT_MS = 100;

volatile std::sig_atomic_t stop_requested = 0;

void on_signal(int) { stop_requested = 1; }

struct Options {
    std::string url;
    std::string config;
    bool lockstep = false;
    bool verbose = false;
    std::vector<std::string> images;
};

void fill_corners(const std::vector<DetectedTag> &detected, kcm_detection_t *msg)
{
    for (size_t k = 0; k < detected.size(); k++) {
        msg->tag_id[k] = detected[k].tag->id;
        for (size_t i = 0; i < 4; i++) {
            msg->corner_px[8 * k + 2 * i] = detected[k].corner_px[i].x;
            msg->corner_px[8 * k + 2 * i + 1] = detected[k].corner_px[i].y;
        }
    }
}

void fill_pose(const Config &config, const Solution &s, kcm_detection_t *msg)
{
    const std::array<double, 4> q = tagdet::quaternion(s.best.R_cam_tool);
    const std::array<double, 4> q_alt = tagdet::quaternion(s.alternative.R_cam_tool);
    for (int i = 0; i < 3; i++) {
        msg->p_cam_tool_m[i] = s.best.p_cam_tool[i];
        msg->p_alt_m[i] = s.alternative.p_cam_tool[i];
    }
    for (size_t i = 0; i < 4; i++) {
        msg->q_cam_tool_wxyz[i] = q[i];
        msg->q_alt_wxyz[i] = q_alt[i];
    }
    int n = 0;
    for (int row = 0; row < 6; row++) {
        for (int col = row; col < 6; col++) { msg->cov[n++] = s.cov(row, col); }
    }
    msg->rms_px = s.best.rms_px;
    msg->rms_alt_px = s.alternative.rms_px;
    msg->range_m = cv::norm(s.best.p_cam_tool);
    msg->incid_rad = s.incidence_rad;
    const cv::Vec3d uvw = config.K * s.best.p_cam_tool;
    msg->u_px = uvw[0] / uvw[2];
    msg->v_px = uvw[1] / uvw[2];
}

// Everything about one frame; no tag, or no pose from those there are, gives n_tags = 0. Throws
// std::runtime_error if the image has another size than the configuration.
kcm_detection_t process_frame(const Config &config, Detector &detector, const cv::Mat &grey, int *unknown)
{
    kcm_detection_t msg{};
    for (int32_t &id : msg.tag_id) { id = -1; }
    msg.q_cam_tool_wxyz[0] = msg.q_alt_wxyz[0] = 1.0;
    if (grey.cols != config.width_px || grey.rows != config.height_px) {
        throw std::runtime_error("image is " + std::to_string(grey.cols) + "x" + std::to_string(grey.rows) +
                                 ", the configuration says " + std::to_string(config.width_px) + "x" +
                                 std::to_string(config.height_px));
    }
    std::vector<DetectedTag> detected = detector.detect(grey, unknown);
    Solution s{};
    if (tagdet::solve(config, &detected, &s)) {
        msg.n_tags = static_cast<int32_t>(detected.size());
        fill_corners(detected, &msg);
        fill_pose(config, s, &msg);
    }
    return msg;
}

// A frame and what follows it must wait in the socket while the frame before is processed.
std::string with_receive_buffer(const std::string &url)
{
    if (url.rfind("udpm:", 0) != 0 || url.find("recv_buf_size=") != std::string::npos) { return url; }
    return url + (url.find('?') == std::string::npos ? "?" : "&") + "recv_buf_size=4194304";
}

class Process {
public:
    Process(const Options &options, const Config &config)
        : options_(options), config_(config), detector_(config),
          lcm_(lcm_create(with_receive_buffer(options.url).c_str()))
    {
        if (lcm_ == nullptr) { throw std::runtime_error("cannot open LCM at " + options.url); }
        lcm_subscribe(lcm_, "KC_IMAGE", &Process::on_image, this);
        if (options.lockstep) { lcm_subscribe(lcm_, "KC_TIME", &Process::on_time, this); }
    }
    ~Process() { lcm_destroy(lcm_); }
    Process(const Process &) = delete;
    Process &operator=(const Process &) = delete;

    // Runs until a signal. Messages are handled one after the other in the order of their arrival, so
    // KC_TIME is answered only after every image before it.
    void run()
    {
        std::fprintf(stderr, "kincal-tagdet: listening on %s\n", options_.url.c_str());
        while (stop_requested == 0) {
            if (options_.lockstep && last_tick_ == 0) { publish_done(); }
            // A signal ends the wait with an error of its own.
            if (lcm_handle_timeout(lcm_, HEARTBEAT_MS) < 0 && stop_requested == 0) {
                throw std::runtime_error("LCM stopped working");
            }
        }
        std::fprintf(stderr,
                     "kincal-tagdet: %ld images, %ld with a pose, %ld unknown tags, %ld messages refused\n",
                     images_, poses_, unknown_, refused_);
    }

private:
    static void on_image(const lcm_recv_buf_t *buf, const char *, void *self)
    {
        static_cast<Process *>(self)->image(buf->data, buf->data_size);
    }

    static void on_time(const lcm_recv_buf_t *buf, const char *, void *self)
    {
        static_cast<Process *>(self)->time(buf->data, buf->data_size);
    }

    void image(const void *message, size_t size)
    {
        images_++;
        tagdet::Frame frame{};
        try {
            frame = tagdet::read_frame(message, size);
        } catch (const std::exception &e) {
            refuse("KC_IMAGE", e.what());
            return;
        }
        handle(frame);
    }

    void time(const void *message, size_t size)
    {
        kcm_time_t msg{};
        if (kcm_time_t_decode(message, 0, static_cast<int>(size), &msg) < 0) {
            refuse("KC_TIME", "no time_t");
        } else {
            tick(msg.tick);
        }
    }

    // Each is counted; the first, second, fourth, eighth ... is named, so that a flood of them fills no disk.
    void refuse(const std::string &what, const char *why)
    {
        refused_++;
        if ((refused_ & (refused_ - 1)) == 0) {
            std::fprintf(stderr, "kincal-tagdet: %s dropped: %s (%ld refused so far)\n", what.c_str(), why,
                         refused_);
        }
    }

    void handle(const tagdet::Frame &frame)
    {
        const auto start = std::chrono::steady_clock::now();
        kcm_detection_t msg{};
        try {
            msg = detection_of(frame);
        } catch (const std::exception &e) {
            // A damaged image is reported, and not answered: that is not the same as "no tag".
            refuse("frame " + std::to_string(frame.seq), e.what());
            return;
        }
        poses_ += msg.n_tags > 0 ? 1 : 0;
        kcm_detection_t_publish(lcm_, "KC_DETECTION", &msg);
        published_++;
        if (options_.verbose) {
            const std::chrono::duration<double, std::milli> took = std::chrono::steady_clock::now() - start;
            std::fprintf(stderr, "kincal-tagdet: frame %d: %d tags, rms %.3f px, %.0f ms\n", msg.seq,
                         msg.n_tags, msg.rms_px, took.count());
        }
    }

    kcm_detection_t detection_of(const tagdet::Frame &image)
    {
        const cv::Mat grey = tagdet::decode_frame(config_, image);
        int unknown = 0;
        kcm_detection_t msg = process_frame(config_, detector_, grey, &unknown);
        msg.t_us = image.t_us;
        msg.seq = image.seq;
        unknown_ += unknown;
        if (unknown > 0) {
            std::fprintf(stderr, "kincal-tagdet: frame %d: %d unknown tags\n", image.seq, unknown);
        }
        return msg;
    }

    void tick(int64_t number)
    {
        if (number != last_tick_) {
            last_tick_ = number;
            published_in_tick_ = published_;
            published_ = 0;
        }
        publish_done();
    }

    void publish_done()
    {
        kcm_tick_done_t done{};
        done.tick = last_tick_;
        done.who = KCM_TICK_DONE_T_WHO_DETECTOR;
        done.n_published = published_in_tick_;
        kcm_tick_done_t_publish(lcm_, "KC_TICK_DONE", &done);
    }

    const Options &options_;
    const Config &config_;
    Detector detector_;
    lcm_t *lcm_;
    int64_t last_tick_ = 0;
    int32_t published_ = 0;
    int32_t published_in_tick_ = 0;
    long images_ = 0;
    long poses_ = 0;
    long unknown_ = 0;
    long refused_ = 0;
};

template <size_t N> void print_list(const char *name, const double (&values)[N], const char *end)
{
    std::printf("\"%s\": [", name);
    for (size_t i = 0; i < N; i++) { std::printf("%s%.17g", i == 0 ? "" : ", ", values[i]); }
    std::printf("]%s", end);
}

void print_json(const std::string &path, const kcm_detection_t &d, int unknown, double took_ms)
{
    std::printf("{\"image\": \"%s\", \"ms\": %.1f, \"unknown_tags\": %d, \"n_tags\": %d, \"tag_id\": [%d, "
                "%d, %d, %d], ",
                path.c_str(), took_ms, unknown, d.n_tags, d.tag_id[0], d.tag_id[1], d.tag_id[2], d.tag_id[3]);
    print_list("p_cam_tool_m", d.p_cam_tool_m, ", ");
    print_list("q_cam_tool_wxyz", d.q_cam_tool_wxyz, ", ");
    print_list("cov", d.cov, ", ");
    print_list("p_alt_m", d.p_alt_m, ", ");
    print_list("q_alt_wxyz", d.q_alt_wxyz, ", ");
    std::printf("\"rms_px\": %.17g, \"rms_alt_px\": %.17g, \"range_m\": %.17g, \"incid_rad\": %.17g, "
                "\"u_px\": %.17g, \"v_px\": %.17g, ",
                d.rms_px, d.rms_alt_px, d.range_m, d.incid_rad, d.u_px, d.v_px);
    print_list("corner_px", d.corner_px, "}\n");
}

void process_file(const Config &config, Detector &detector, const std::string &path)
{
    const auto start = std::chrono::steady_clock::now();
    const cv::Mat grey = cv::imread(path, cv::IMREAD_GRAYSCALE);
    if (grey.empty()) { throw std::runtime_error(path + ": not a readable image"); }
    int unknown = 0;
    const kcm_detection_t msg = process_frame(config, detector, grey, &unknown);
    const std::chrono::duration<double, std::milli> took = std::chrono::steady_clock::now() - start;
    print_json(path, msg, unknown, took.count());
    std::fflush(stdout);
}

void process_files(const Options &options, const Config &config)
{
    Detector detector(config);
    for (const std::string &path : options.images) {
        if (path != "-") {
            process_file(config, detector, path);
            continue;
        }
        for (std::string line; std::getline(std::cin, line);) { process_file(config, detector, line); }
    }
}

constexpr const char *USAGE =
    "usage: kincal-tagdet --config FILE --url LCM_URL [--lockstep] [--verbose]\n"
    "       kincal-tagdet --config FILE --image FILE...\n"
    "\n"
    "Finds 36h11 tags in KC_IMAGE and publishes KC_DETECTION: one pose from all tags of the tool.\n"
    "  --config FILE   camera and tags, as sim/models/detector.yml\n"
    "  --url URL       LCM network, for example udpm://239.255.76.67:7667?ttl=0\n"
    "  --lockstep      answer every KC_TIME with KC_TICK_DONE once all images before it are done\n"
    "  --verbose       one line for every frame\n"
    "  --image FILE... read image files and print one JSON line for each;\n"
    "                  - reads their names from standard input, one a line, until it ends\n";

Options parse(int argc, char **argv)
{
    Options o;
    for (int i = 1; i < argc; i++) {
        const std::string arg = argv[i];
        if (arg == "--lockstep") {
            o.lockstep = true;
        } else if (arg == "--verbose") {
            o.verbose = true;
        } else if (arg == "--help" || arg == "-h") {
            std::fputs(USAGE, stdout);
            std::exit(0);
        } else if ((arg == "--url" || arg == "--config") && i + 1 < argc) {
            (arg == "--url" ? o.url : o.config) = argv[++i];
        } else if (arg == "--image" && i + 1 < argc) {
            o.images.assign(argv + i + 1, argv + argc);
            i = argc;
        } else {
            throw std::invalid_argument("unknown or incomplete option '" + arg + "'");
        }
    }
    if (o.config.empty()) { throw std::invalid_argument("--config is missing"); }
    if (o.url.empty() == o.images.empty()) { throw std::invalid_argument("give either --url or --image"); }
    return o;
}

}  // namespace

int main(int argc, char **argv)
{
    struct sigaction action{};
    action.sa_handler = on_signal;
    sigaction(SIGINT, &action, nullptr);
    sigaction(SIGTERM, &action, nullptr);
    try {
        const Options options = parse(argc, argv);
        const Config config = tagdet::load_config(options.config);
        if (!options.images.empty()) {
            process_files(options, config);
        } else {
            Process(options, config).run();
        }
    } catch (const std::invalid_argument &e) {
        std::fprintf(stderr, "kincal-tagdet: %s\n\n%s", e.what(), USAGE);
        return 2;
    } catch (const std::exception &e) {
        std::fprintf(stderr, "kincal-tagdet: %s\n", e.what());
        return 1;
    }
    return 0;
}
