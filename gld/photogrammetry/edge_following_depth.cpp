#include "gld/photogrammetry/edge_following_depth.h"

#include "gld/photogrammetry/photograph_composition.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>
#include <vector>

namespace gld {
namespace {

// Chosen on drawn rooms (seeds 900000 and 31003) and the Lund door, TartanAir and RealEstate10K of docs/RESULTS.md,
// by the PSNR of carried photographs. Other windows, colours, passes and slopes that were tried kept two thirds of the
// gain and more (docs/HISTORY.md).
constexpr int kSamplesAside = 5;        // of the window, to each side
constexpr double kSamplesAcross = 112;  // of the longer side: so far apart they are, however large the map is
constexpr double kNearSamples = 4;      // one standard deviation
constexpr double kAlikeColours = 0.1;   // of colours' distance, one standard deviation
constexpr int kMedianPasses = 2;
// Logarithms of depth. Where those around differ by less there is no edge; and where the median is no farther from a
// pixel's own there is none at that pixel, but a slope, which a median of one side would shift.
constexpr float kFlat = 0.02F, kSlope = 0.03F;

constexpr size_t kWindowSide = 2 * kSamplesAside + 1;

// Returns the number of a sample of the window.
size_t sample(int row, int column) {
  return static_cast<size_t>(row + kSamplesAside) * kWindowSide + static_cast<size_t>(column + kSamplesAside);
}

// Returns (height, width, 3) of the depth's size.
std::vector<float> colours_of(const PicturedView& picture, const PlanarDepth& depth) {
  const PicturedView small = reduced_view(picture, std::max(depth.width, depth.height));
  std::vector<float> colours(static_cast<size_t>(3 * depth.width * depth.height));
  for (int64_t y = 0; y < depth.height; ++y) {
    const int64_t from_y = (2 * y + 1) * small.height / (2 * depth.height);
    for (int64_t x = 0; x < depth.width; ++x) {
      const int64_t from_x = (2 * x + 1) * small.width / (2 * depth.width);
      std::copy_n(&small.rgb[static_cast<size_t>(3 * (from_y * small.width + from_x))], 3,
                  &colours[static_cast<size_t>(3 * (y * depth.width + x))]);
    }
  }
  return colours;
}

struct WeightedDepth {
  float log_depth = 0, weight = 0;
};

// The samples of a window on one side of a pixel's own depth.
struct Side {
  std::array<WeightedDepth, kWindowSide * kWindowSide> samples;
  size_t count = 0;
  double weight = 0;

  void add(const WeightedDepth& sample) {
    samples[count++] = sample;
    weight += sample.weight;
  }

  // Returns the first depth, from the least on, up to which half of all the weight lies, before_it of which is below
  // this side.
  float reaching_half(double before_it, double all) {
    const auto end = samples.begin() + static_cast<std::ptrdiff_t>(count);
    std::sort(samples.begin(), end,
              [](const WeightedDepth& a, const WeightedDepth& b) { return a.log_depth < b.log_depth; });
    double reached = before_it;
    const auto found = std::find_if(samples.begin(), end - 1, [&](const WeightedDepth& each) {
      reached += each.weight;
      return 2 * reached >= all;
    });
    return found->log_depth;
  }
};

class EdgeFollowing {
 public:
  EdgeFollowing(const PlanarDepth& depth, const PicturedView& picture)
      : width_(depth.width), height_(depth.height), colours_(colours_of(picture, depth)) {
    const double longer = static_cast<double>(std::max(width_, height_));
    apart_ = std::max<int64_t>(1, std::llround(longer / kSamplesAcross));
    for (int y = -kSamplesAside; y <= kSamplesAside; ++y) {
      for (int x = -kSamplesAside; x <= kSamplesAside; ++x)
        nearness_[sample(y, x)] =
            static_cast<float>(std::exp(-(x * x + y * y) / (2 * kNearSamples * kNearSamples)));
    }
  }

  // Returns the median of the logarithms of depth around that pixel, whose own is known (NaN is not known), or its own
  // where the median is no farther than kSlope from it: then nothing need be sorted.
  float median(const std::vector<float>& logs, int64_t x, int64_t y) const {
    const float own = logs[static_cast<size_t>(y * width_ + x)];
    if (flat_around(logs, x, y, own)) return own;
    Side nearer, farther;
    double beside = 0;
    for_each_around(logs, x, y, [&](float value, size_t place, int64_t pixel) {
      const WeightedDepth found{value, nearness_[place] * likeness(y * width_ + x, pixel)};
      if (std::abs(value - own) <= kSlope) {
        beside += found.weight;
      } else {
        (value < own ? nearer : farther).add(found);
      }
    });
    const double all = nearer.weight + beside + farther.weight;
    if (nearer.count > 0 && 2 * nearer.weight >= all) return nearer.reaching_half(0, all);
    if (farther.count > 0 && 2 * (nearer.weight + beside) < all)
      return farther.reaching_half(nearer.weight + beside, all);
    return own;
  }

 private:
  // Calls each(logarithm, number of the window's sample, pixel) for those around whose depth is known.
  template <class Each>
  void for_each_around(const std::vector<float>& logs, int64_t x, int64_t y, const Each& each) const {
    for (int row = -kSamplesAside; row <= kSamplesAside; ++row) {
      const int64_t from_y = y + row * apart_;
      if (from_y < 0 || from_y >= height_) continue;
      for (int column = -kSamplesAside; column <= kSamplesAside; ++column) {
        const int64_t from_x = x + column * apart_;
        if (from_x < 0 || from_x >= width_) continue;
        const int64_t pixel = from_y * width_ + from_x;
        const float value = logs[static_cast<size_t>(pixel)];
        if (!std::isnan(value)) each(value, sample(row, column), pixel);
      }
    }
  }

  bool flat_around(const std::vector<float>& logs, int64_t x, int64_t y, float own) const {
    float least = own, most = own;
    for_each_around(logs, x, y, [&](float value, size_t, int64_t) {
      least = std::min(least, value);
      most = std::max(most, value);
    });
    return most - least < kFlat;
  }

  float likeness(int64_t pixel, int64_t other) const {
    const float* a = &colours_[static_cast<size_t>(3 * pixel)];
    const float* b = &colours_[static_cast<size_t>(3 * other)];
    float squares = 0;
    for (int channel = 0; channel < 3; ++channel)
      squares += (a[channel] - b[channel]) * (a[channel] - b[channel]);
    return std::exp(squares * static_cast<float>(-1 / (2 * kAlikeColours * kAlikeColours)));
  }

  int64_t width_, height_, apart_ = 1;
  std::vector<float> colours_;
  std::array<float, kWindowSide * kWindowSide> nearness_{};
};

}  // namespace

PlanarDepth edge_following_depth(const PlanarDepth& depth, const PicturedView& picture,
                                 const ConfidenceMap& confirmed, int threads) {
  if (depth.values.empty() || picture.rgb.empty()) return depth;
  const EdgeFollowing edges(depth, picture);
  std::vector<float> logs(depth.values.size());
  std::transform(depth.values.begin(), depth.values.end(), logs.begin(),
                 [](float value) { return PlanarDepth::known(value) ? std::log(value) : std::nanf(""); });
  for (int pass = 0; pass < kMedianPasses; ++pass) {
    std::vector<float> next = logs;
#pragma omp parallel for num_threads(threads) schedule(dynamic, 8)
    for (int64_t y = 0; y < depth.height; ++y) {
      for (int64_t x = 0; x < depth.width; ++x) {
        const auto pixel = static_cast<size_t>(y * depth.width + x);
        const float open = confirmed.empty() ? 1 : 1 - std::clamp(2 * confirmed.values[pixel], 0.0F, 1.0F);
        if (std::isnan(logs[pixel]) || open <= 0) continue;
        next[pixel] += open * (edges.median(logs, x, y) - logs[pixel]);
      }
    }
    logs = std::move(next);
  }
  PlanarDepth result = depth;
  for (size_t pixel = 0; pixel < logs.size(); ++pixel) {
    if (!std::isnan(logs[pixel])) result.values[pixel] = std::exp(logs[pixel]);
  }
  return result;
}

}  // namespace gld
