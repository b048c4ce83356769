#pragma once

#include "datasets/scenes/resize_crop.h"
#include "datasets/scenes/scene.h"
#include "gld/photogrammetry/plane_sweep_stereo.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <ctime>
#include <string>
#include <vector>

namespace gld::test {

// Returns a frame at side x side pixels as stereo takes it, with its measured depth where asked for.
inline PicturedView pictured(const Frame& frame, int64_t side, FrameParts parts) {
  const SizedFrame sized = load_sized(frame, {side, side}, parts);
  PicturedView view;
  view.camera = sized.camera;
  view.width = sized.image.width;
  view.height = sized.image.height;
  for (const uint8_t value : sized.image.rgb) view.rgb.push_back(static_cast<float>(value) / 255);
  view.depth = {sized.depth.width, sized.depth.height, sized.depth.metres};
  return view;
}

inline std::vector<PicturedView> without_prior(std::vector<PicturedView> views) {
  for (PicturedView& view : views) view.depth = {};
  return views;
}

// What depth is worth beside what is known of it: |depth - known| / known.
struct StereoFigures {
  std::vector<double> errors;      // of confident pixels
  std::vector<double> all_errors;  // of all that have depth
  int64_t pixels = 0;
  int64_t confident = 0;

  void add(const StereoDepth& found, size_t pixel, double known) {
    const auto depth = static_cast<double>(found.depth.values[pixel]);
    if (!(depth > 0) || !(known > 0)) return;
    const double error = std::abs(depth - known) / known;
    all_errors.push_back(error);
    if (found.confidence.values[pixel] >= kConfidentStereo) errors.push_back(error);
  }
  void count_confident(const StereoDepth& found) {
    pixels += static_cast<int64_t>(found.depth.values.size());
    confident += std::lround(found.confident_share() * static_cast<double>(found.depth.values.size()));
  }
  static double mean_of(const std::vector<double>& values) {
    double sum = 0;
    for (const double value : values) sum += value;
    return sum / static_cast<double>(values.size());
  }
  static double median_of(std::vector<double> values) {
    if (values.empty()) return std::nan("");
    std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2),
                     values.end());
    return values[values.size() / 2];
  }
  // Not a number where nothing is confident.
  double mean() const { return mean_of(errors); }
  double mean_of_all() const { return mean_of(all_errors); }
  double confident_share() const { return static_cast<double>(confident) / static_cast<double>(pixels); }
  std::string text() const {
    char line[200];
    std::snprintf(
        line, sizeof(line),
        "AbsRel mean %.4f median %.4f of %zu confident places, mean %.4f median %.4f of %zu; %.1f %% of pixels confident",
        mean(), median_of(errors), errors.size(), mean_of_all(), median_of(all_errors), all_errors.size(),
        100 * confident_share());
    return line;
  }
};

// views have their known depth, of any size.
inline StereoFigures beside_depth(const StereoScene& scene, const std::vector<PicturedView>& views) {
  StereoFigures figures;
  for (size_t i = 0; i < views.size(); ++i) {
    const StereoDepth& found = scene.views[i];
    const PlanarDepth& known = views[i].depth;
    for (int64_t y = 0; y < found.depth.height; ++y) {
      for (int64_t x = 0; x < found.depth.width; ++x) {
        const int64_t row = (2 * y + 1) * known.height / (2 * found.depth.height);
        const int64_t column = (2 * x + 1) * known.width / (2 * found.depth.width);
        figures.add(found, static_cast<size_t>(y * found.depth.width + x),
                    static_cast<double>(known.values[static_cast<size_t>(row * known.width + column)]));
      }
    }
    figures.count_confident(found);
  }
  return figures;
}

// This counts CPU seconds of this process since it was made: what others on the machine do matters less than to the
// wall clock.
class CpuSeconds {
 public:
  double operator()() const { return static_cast<double>(std::clock() - start_) / CLOCKS_PER_SEC; }

 private:
  std::clock_t start_ = std::clock();
};

}  // namespace gld::test
