#include "gld/photogrammetry/semi_global_matching.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <utility>

namespace gld {
namespace {

constexpr double kPaths = 2 * kPathsAPass;

// The costs of paths at every pixel of a row, with guards, and a pixel of no costs before the first and behind the
// last.
class PathRow {
 public:
  PathRow(int64_t width, int64_t planes)
      : stride_(planes + 2 * kPathGuard),
        values_(static_cast<size_t>((width + 2) * stride_), uint16_t{0}),
        least_(static_cast<size_t>(width + 2), uint16_t{0}) {
    for (int64_t pixel = 0; pixel < width + 2; ++pixel) {
      uint16_t* first = values_.data() + pixel * stride_;
      std::fill(first, first + kPathGuard, kPathGuardCost);
      std::fill(first + stride_ - kPathGuard, first + stride_, kPathGuardCost);
    }
  }

  // x goes from -1 to width.
  uint16_t* at(int64_t x) { return values_.data() + (x + 1) * stride_ + kPathGuard; }
  uint16_t& least(int64_t x) { return least_[static_cast<size_t>(x + 1)]; }

 private:
  int64_t stride_;
  std::vector<uint16_t> values_, least_;
};

// What big steps cost, by the difference of brightness.
class BigSteps {
 public:
  BigSteps(const StereoPicture& picture, const PathPenalties& penalties) : picture_(picture) {
    const double edge = std::max(1e-6, penalties.edge * static_cast<double>(picture.deviation));
    // Brightness differs by 2 at most.
    for (size_t i = 0; i < kLevels; ++i) {
      const double difference = 2.0 * static_cast<double>(i) / static_cast<double>(kLevels - 1);
      const double price = std::max(penalties.big_step / (1 + difference / edge), penalties.least_big_step);
      prices_[i] = static_cast<uint16_t>(std::lround(price * kDearestMatch));
    }
  }

  uint16_t between(int64_t pixel, int64_t other) const {
    const float difference = std::abs(picture_.brightness[static_cast<size_t>(pixel)] -
                                      picture_.brightness[static_cast<size_t>(other)]);
    return prices_[static_cast<size_t>(difference * (0.5F * static_cast<float>(kLevels - 1)))];
  }

 private:
  static constexpr size_t kLevels = 1025;
  const StereoPicture& picture_;
  uint16_t prices_[kLevels + 1] = {};
};

// Makes one pass over the rows: direction 1 is down and to the right, -1 is up and to the left.
template <class Visit>
void pass(const CostVolume& volume, const BigSteps& big_steps, uint16_t small_step, int64_t direction,
          const Visit& visit) {
  const int64_t width = volume.width, height = volume.height;
  // Paths from the row before: straight, and from both sides. Each needs the row that it comes from.
  std::vector<PathRow> before(3, PathRow(width, volume.stride)), after = before;
  PathRow along(2, volume.stride);  // two pixels that take turns
  const int64_t first_row = direction > 0 ? 0 : height - 1, first_column = direction > 0 ? 0 : width - 1;
  PathRow start(1, volume.stride);
  for (int64_t line = 0; line < height; ++line) {
    const int64_t y = first_row + direction * line;
    for (int64_t i = 0; i < width; ++i) {
      const int64_t x = first_column + direction * i;
      const int64_t pixel = y * width + x;
      PathStep step{};
      step.planes = volume.stride;
      step.cost = volume.at(x, y);
      step.small_step = small_step;
      for (size_t path = 0; path < 3; ++path) {
        const int64_t from = x + static_cast<int64_t>(path) - 1;
        step.before[path] = before[path].at(from);
        step.least[path] = before[path].least(from);
        step.after[path] = after[path].at(x);
        const bool inside = line > 0 && from >= 0 && from < width;
        step.big_step[path] = inside ? big_steps.between(pixel, (y - direction) * width + from) : uint16_t{0};
      }
      const int64_t turn = i % 2;
      step.before[3] = i > 0 ? along.at(1 - turn) : start.at(0);
      step.least[3] = i > 0 ? along.least(1 - turn) : uint16_t{0};
      step.after[3] = along.at(turn);
      step.big_step[3] = i > 0 ? big_steps.between(pixel, pixel - direction) : uint16_t{0};
      visit(pixel, step);
      for (size_t path = 0; path < 3; ++path) after[path].least(x) = step.least[path];
      along.least(turn) = step.least[3];
    }
    std::swap(before, after);
  }
}

}  // namespace

MatchedPlanes match_semi_globally(const CostVolume& volume, const StereoPicture& picture,
                                  const PathPenalties& penalties, int64_t one_minimum,
                                  const KernelTable& kernels) {
  const auto pixels = static_cast<size_t>(volume.width * volume.height);
  const std::unique_ptr<uint16_t[]> sums(new uint16_t[pixels * static_cast<size_t>(volume.stride)]);
  const BigSteps big_steps(picture, penalties);
  const auto small_step = static_cast<uint16_t>(std::lround(penalties.small_step * kDearestMatch));
  pass(volume, big_steps, small_step, 1, [&](int64_t pixel, PathStep& step) {
    step.sum = sums.get() + pixel * volume.stride;
    kernels.path_step(step);
  });
  MatchedPlanes matched;
  matched.plane.resize(pixels);
  matched.cost.resize(pixels);
  matched.uniqueness.resize(pixels);
  pass(volume, big_steps, small_step, -1, [&](int64_t pixel, PathStep& step) {
    step.sum = sums.get() + pixel * volume.stride;
    step.sum_before = step.sum;
    kernels.path_step(step);
    LeastCost best{};
    best.sum = step.sum;
    best.planes = volume.planes;
    best.apart = one_minimum;
    kernels.least_cost(best);
    float offset = 0;
    if (best.plane > 0 && best.plane + 1 < volume.planes) {
      const auto low = static_cast<float>(step.sum[best.plane - 1]),
                 high = static_cast<float>(step.sum[best.plane + 1]);
      const float bend = low + high - 2 * static_cast<float>(best.least);
      if (bend > 0) offset = 0.5F * (low - high) / bend;
    }
    const auto at = static_cast<size_t>(pixel);
    matched.plane[at] = static_cast<float>(best.plane) + offset;
    matched.cost[at] = step.cost[best.plane];
    matched.uniqueness[at] = best.second == 0xFFFF ? 0.0F
                                                   : static_cast<float>(best.second - best.least) /
                                                         static_cast<float>(kPaths * kDearestMatch);
  });
  return matched;
}

double semi_global_operations() {
  // Each path takes three minima, two additions, a subtraction, the least and the sum.
  return kPaths * 8;
}

double semi_global_traffic() {
  // In each of two passes the cost counts; each path counts thrice as it was and once as it becomes; the sum is
  // written, read, written and read twice for the least.
  return 2 * 1 + kPaths * 4 * 2 + 5 * 2;
}

}  // namespace gld
