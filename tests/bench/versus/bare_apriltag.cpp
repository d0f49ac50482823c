// libapriltag as it is, with the settings of a detector configuration: reads names of images from standard
// input, one a line, and prints what it detects in each: identities and corners as the library gives them.
#include <apriltag/apriltag.h>
#include <apriltag/tag36h11.h>

#include <cstdio>
#include <iostream>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <string>

int main(int argc, char **argv)
{
    if (argc != 2) { return 2; }
    const cv::FileStorage config(argv[1], cv::FileStorage::READ);
    apriltag_family_t *family = tag36h11_create();
    apriltag_detector_t *detector = apriltag_detector_create();
    apriltag_detector_add_family_bits(detector, family, static_cast<int>(config["max_hamming"]));
    detector->nthreads = static_cast<int>(config["threads"]);
    detector->quad_decimate = static_cast<float>(config["quad_decimate"]);
    detector->refine_edges = true;
    for (std::string line; std::getline(std::cin, line);) {
        cv::Mat grey = cv::imread(line, cv::IMREAD_GRAYSCALE);
        if (grey.empty()) { return 1; }
        image_u8_t view = {grey.cols, grey.rows, static_cast<int32_t>(grey.step[0]), grey.data};
        zarray_t *all = apriltag_detector_detect(detector, &view);
        std::printf("{\"tags\": [");
        for (int i = 0; i < zarray_size(all); i++) {
            apriltag_detection_t *d = nullptr;
            zarray_get(all, i, static_cast<void *>(&d));
            std::printf("%s{\"id\": %d, \"margin\": %.9g, \"corner_px\": [", i == 0 ? "" : ", ", d->id,
                        static_cast<double>(d->decision_margin));
            for (int k = 0; k < 8; k++) { std::printf("%s%.17g", k == 0 ? "" : ", ", d->p[k / 2][k % 2]); }
            std::printf("]}");
        }
        std::printf("]}\n");
        std::fflush(stdout);
        apriltag_detections_destroy(all);
    }
    apriltag_detector_destroy(detector);
    tag36h11_destroy(family);
    return 0;
}
