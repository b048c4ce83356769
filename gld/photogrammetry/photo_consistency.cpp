#include "gld/photogrammetry/photo_consistency.h"

#include "gld/photogrammetry/bilinear_neighbours.h"
#include "gld/photogrammetry/scale_consensus.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include <Eigen/Geometry>
#include <Eigen/LU>

namespace gld {
namespace {

constexpr int64_t kLargestSide = 128;  // of the reduced pictures
constexpr int64_t kWindow = 3;         // pixels to each side
constexpr size_t kMostComparisons = 24;
constexpr double kLeastBaseline = 0.01;     // of the largest distance between cameras
constexpr double kNearestDepth = 0.5;       // of the candidates, in baselines
constexpr float kLeastVariance = 4e-4F;     // of a window, over its colours: less is no texture
constexpr float kNoiseVariance = 1e-4F;     // added, so that noise does not correlate
constexpr float kTemperature = 0.1F;        // of correlations
constexpr float kUnseenCorrelation = 0.3F;  // what a candidate out of the other picture is worth
constexpr float kLeastSeen = 0.3F;          // of the candidates, for a window to be asked
// Of the windows asked, that correlate at some candidate better than one is worth that is out of the picture. Without
// texture in the second photograph none does, and all would vote for a scale that moves them out of it.
constexpr double kLeastTelling = 0.1;
constexpr int64_t kBlocksASideOfView = 4;
constexpr double kMatchingDeviation = 0.01;

using Plane = std::vector<float>;  // of a reduced picture, row by row

struct ReducedView {
  Eigen::Isometry3d world_from_camera = Eigen::Isometry3d::Identity();
  Eigen::Matrix3d intrinsics = Eigen::Matrix3d::Identity();  // of the reduced picture
  int64_t width = 0;
  int64_t height = 0;
  std::array<Plane, 3> colours;
  Plane depth;  // 0 where unknown

  size_t pixels() const { return static_cast<size_t>(width * height); }
};

// Returns the pixels of a side that a reduced pixel covers.
std::pair<int64_t, int64_t> covered(int64_t reduced, int64_t side, int64_t reduced_side) {
  const int64_t first = reduced * side / reduced_side;
  return {first, std::max(first + 1, (reduced + 1) * side / reduced_side)};
}

// Applies [1 2 1] / 4 along a line of values; the ends keep theirs.
void smooth_line(float* values, int64_t count, int64_t stride) {
  float before = values[0];
  for (int64_t i = 1; i + 1 < count; ++i) {
    const float here = values[i * stride];
    values[i * stride] = 0.25F * (before + 2 * here + values[(i + 1) * stride]);
    before = here;
  }
}

ReducedView reduced(const PicturedView& view) {
  ReducedView small;
  const double factor = std::max(
      1.0, static_cast<double>(std::max(view.width, view.height)) / static_cast<double>(kLargestSide));
  small.width = std::max<int64_t>(1, std::lround(static_cast<double>(view.width) / factor));
  small.height = std::max<int64_t>(1, std::lround(static_cast<double>(view.height) / factor));
  small.world_from_camera = view.camera.world_from_camera;
  small.intrinsics = view.camera.intrinsics;
  small.intrinsics.row(0) *= static_cast<double>(small.width) / static_cast<double>(view.camera.width);
  small.intrinsics.row(1) *= static_cast<double>(small.height) / static_cast<double>(view.camera.height);
  small.depth.resize(small.pixels());
  for (Plane& colour : small.colours) colour.resize(small.pixels());
  for (int64_t y = 0; y < small.height; ++y) {
    const auto rows = covered(y, view.height, small.height);
    for (int64_t x = 0; x < small.width; ++x) {
      const auto columns = covered(x, view.width, small.width);
      const auto pixel = static_cast<size_t>(y * small.width + x);
      std::array<double, 3> sum{};
      for (int64_t row = rows.first; row < rows.second && !view.rgb.empty(); ++row) {
        for (int64_t column = columns.first; column < columns.second; ++column) {
          for (size_t c = 0; c < 3; ++c) {
            sum[c] += view.rgb[static_cast<size_t>(3 * (row * view.width + column)) + c];
          }
        }
      }
      const auto area = static_cast<double>((rows.second - rows.first) * (columns.second - columns.first));
      for (size_t c = 0; c < 3; ++c) small.colours[c][pixel] = static_cast<float>(sum[c] / area);
      const int64_t depth_row =
          std::min(view.depth.height - 1, (2 * y + 1) * view.depth.height / (2 * small.height));
      const int64_t depth_column =
          std::min(view.depth.width - 1, (2 * x + 1) * view.depth.width / (2 * small.width));
      const float depth = view.depth.values[static_cast<size_t>(depth_row * view.depth.width + depth_column)];
      small.depth[pixel] = std::isfinite(depth) && depth > 0 ? depth : 0.0F;
    }
  }
  for (Plane& colour : small.colours) {
    for (int64_t y = 0; y < small.height; ++y) smooth_line(colour.data() + y * small.width, small.width, 1);
    for (int64_t x = 0; x < small.width; ++x) smooth_line(colour.data() + x, small.height, small.width);
  }
  return small;
}

// Sums over windows of 2 kWindow + 1 pixels a side, cut off at the border of the picture.
class WindowSums {
 public:
  WindowSums(int64_t width, int64_t height) : width_(width), height_(height) {
    integral_.assign(static_cast<size_t>((width + 1) * (height + 1)), 0.0);
  }

  void operator()(const Plane& values, Plane& sums) {
    for (int64_t y = 0; y < height_; ++y) {
      double row = 0;
      for (int64_t x = 0; x < width_; ++x) {
        row += values[static_cast<size_t>(y * width_ + x)];
        at(x + 1, y + 1) = at(x + 1, y) + row;
      }
    }
    for (int64_t y = 0; y < height_; ++y) {
      const int64_t top = std::max<int64_t>(0, y - kWindow), bottom = std::min(height_, y + kWindow + 1);
      for (int64_t x = 0; x < width_; ++x) {
        const int64_t left = std::max<int64_t>(0, x - kWindow), right = std::min(width_, x + kWindow + 1);
        sums[static_cast<size_t>(y * width_ + x)] =
            static_cast<float>(at(right, bottom) - at(left, bottom) - at(right, top) + at(left, top));
      }
    }
  }

 private:
  double& at(int64_t x, int64_t y) { return integral_[static_cast<size_t>(y * (width_ + 1) + x)]; }

  int64_t width_, height_;
  std::vector<double> integral_;
};

// A photograph as it would be seen from a view, by the view's depth.
class WarpedPhotograph {
 public:
  WarpedPhotograph(const ReducedView& view, const ReducedView& photograph)
      : view_(view), photograph_(photograph) {
    const Eigen::Isometry3d photograph_from_view =
        photograph.world_from_camera.inverse() * view.world_from_camera;
    const Eigen::Matrix3d pixel_from_pixel =
        photograph.intrinsics * photograph_from_view.linear() * view.intrinsics.inverse();
    for (int64_t y = 0; y < view.height; ++y) {
      for (int64_t x = 0; x < view.width; ++x) {
        directions_.emplace_back(pixel_from_pixel * Eigen::Vector3d(static_cast<double>(x) + 0.5,
                                                                    static_cast<double>(y) + 0.5, 1));
      }
    }
    shift_ = photograph.intrinsics * photograph_from_view.translation();
    for (Plane& colour : colours) colour.assign(view.pixels(), 0.0F);
    inside.assign(view.pixels(), 0.0F);
  }

  void warp(double scale) {
    // A view's own photograph stays where it is, also where its depth is not known.
    const bool own = &view_ == &photograph_;
    for (size_t i = 0; i < directions_.size(); ++i) {
      const double depth = own ? 1 : scale * static_cast<double>(view_.depth[i]);
      const Eigen::Vector3d projected = depth * directions_[i] + shift_;
      const double x = projected[0] / projected[2] - 0.5, y = projected[1] / projected[2] - 0.5;
      const double margin = own ? 1e-6 : 0;
      const bool seen = depth > 0 && projected[2] > 1e-3 * depth && x >= -margin && y >= -margin &&
                        x <= static_cast<double>(photograph_.width - 1) + margin &&
                        y <= static_cast<double>(photograph_.height - 1) + margin;
      inside[i] = seen ? 1.0F : 0.0F;
      for (Plane& colour : colours) colour[i] = 0.0F;
      if (!seen) continue;
      const BilinearNeighbours around(photograph_.width, photograph_.height, x, y);
      for (size_t c = 0; c < 3; ++c) {
        const Plane& colour = photograph_.colours[c];
        for (size_t n = 0; n < 4; ++n) colours[c][i] += around.weights[n] * colour[around.cells[n]];
      }
    }
  }

  std::array<Plane, 3> colours;
  Plane inside;  // 1 where the photograph shows the point

 private:
  const ReducedView& view_;
  const ReducedView& photograph_;
  std::vector<Eigen::Vector3d> directions_;  // of the view's pixels, in the photograph's pixels
  Eigen::Vector3d shift_ = Eigen::Vector3d::Zero();
};

// Windows of a view in two photographs.
class WindowComparison {
 public:
  WindowComparison(const ReducedView& view, const ReducedView& first, const ReducedView& second)
      : first_(view, first),
        second_(view, second),
        first_is_fixed_(&view == &first),
        sums_(view.width, view.height) {
    const size_t pixels = view.pixels();
    for (Plane* plane : {&area_, &seen_, &scratch_, &products_, &first_variance_, &second_variance_}) {
      plane->assign(pixels, 0.0F);
    }
    for (auto* planes : {&first_means_, &second_means_}) planes->fill(Plane(pixels, 0.0F));
    sums_(Plane(pixels, 1.0F), area_);
    if (first_is_fixed_) warp_first(1);
  }

  // Computes the correlation of each window at that scale, below -1 where one of the photographs does not show all of
  // it or it has no texture.
  void correlate(double scale, Plane& correlation) {
    if (!first_is_fixed_) warp_first(scale);
    second_.warp(scale);
    measure(second_, second_means_, second_variance_);
    for (size_t i = 0; i < scratch_.size(); ++i) scratch_[i] = first_.inside[i] * second_.inside[i];
    sums_(scratch_, seen_);
    for (size_t i = 0; i < scratch_.size(); ++i) {
      scratch_[i] = 0;
      for (size_t c = 0; c < 3; ++c) scratch_[i] += first_.colours[c][i] * second_.colours[c][i];
    }
    sums_(scratch_, products_);
    for (size_t i = 0; i < scratch_.size(); ++i) {
      float covariance = products_[i] / area_[i];
      for (size_t c = 0; c < 3; ++c) {
        covariance -= first_means_[c][i] * second_means_[c][i] / (area_[i] * area_[i]);
      }
      const bool comparable = seen_[i] > area_[i] - 0.5F && first_variance_[i] >= kLeastVariance;
      correlation[i] = comparable ? covariance / std::sqrt((first_variance_[i] + kNoiseVariance) *
                                                           (second_variance_[i] + kNoiseVariance))
                                  : -2.0F;
    }
  }

 private:
  void warp_first(double scale) {
    first_.warp(scale);
    measure(first_, first_means_, first_variance_);
  }

  // means are sums over windows; the variance is that of the three colours together.
  void measure(const WarpedPhotograph& photograph, std::array<Plane, 3>& means, Plane& variance) {
    for (size_t c = 0; c < 3; ++c) sums_(photograph.colours[c], means[c]);
    for (size_t i = 0; i < scratch_.size(); ++i) {
      scratch_[i] = 0;
      for (const Plane& colour : photograph.colours) scratch_[i] += colour[i] * colour[i];
    }
    sums_(scratch_, variance);
    for (size_t i = 0; i < variance.size(); ++i) {
      variance[i] /= area_[i];
      for (const Plane& mean : means) variance[i] -= mean[i] * mean[i] / (area_[i] * area_[i]);
      variance[i] = std::max(variance[i], 0.0F);
    }
  }

  WarpedPhotograph first_, second_;
  bool first_is_fixed_;
  WindowSums sums_;
  Plane area_, seen_, scratch_, products_, first_variance_, second_variance_;
  std::array<Plane, 3> first_means_, second_means_;
};

// Adds what the windows of a view say, each as an observation.
void compare(const std::vector<ReducedView>& views, const ComparedPhotographs& compared,
             ScaleConsensus& consensus) {
  const ReducedView& view = views[compared.view];
  WindowComparison comparison(view, views[compared.first], views[compared.second]);
  const ScaleCandidates& candidates = consensus.candidates();
  const auto count = static_cast<size_t>(candidates.count);
  std::vector<Plane> correlations(count, Plane(view.pixels()));
  for (size_t k = 0; k < count; ++k) {
    comparison.correlate(std::exp(candidates.log_scale(static_cast<double>(k))), correlations[k]);
  }
  // How many candidates a window is compared at, and the best correlation there.
  struct Asked {
    size_t seen = 0;
    float best = -1;
  };
  const auto asked = [&](size_t pixel) {
    Asked window;
    for (size_t k = 0; k < count && view.depth[pixel] > 0; ++k) {
      if (correlations[k][pixel] <= -1.5F) continue;
      ++window.seen;
      window.best = std::max(window.best, correlations[k][pixel]);
    }
    return window;
  };
  const auto is_seen = [&](const Asked& window) {
    return static_cast<float>(window.seen) >= kLeastSeen * static_cast<float>(count);
  };
  size_t windows = 0, telling = 0;
  for (size_t pixel = 0; pixel < view.pixels(); ++pixel) {
    const Asked window = asked(pixel);
    if (!is_seen(window)) continue;
    ++windows;
    if (window.best > kUnseenCorrelation) ++telling;
  }
  if (static_cast<double>(telling) < kLeastTelling * static_cast<double>(windows)) return;
  std::vector<float> density(count);
  for (int64_t y = 0; y < view.height; ++y) {
    for (int64_t x = 0; x < view.width; ++x) {
      const auto pixel = static_cast<size_t>(y * view.width + x);
      if (!is_seen(asked(pixel))) continue;
      for (size_t k = 0; k < count; ++k) {
        const bool comparable = correlations[k][pixel] > -1.5F;
        density[k] =
            std::exp(((comparable ? correlations[k][pixel] : kUnseenCorrelation) - 1) / kTemperature);
      }
      const auto block = static_cast<size_t>(y * kBlocksASideOfView / view.height * kBlocksASideOfView +
                                             x * kBlocksASideOfView / view.width);
      consensus.add(density, {compared.view, block});
    }
  }
}

double distance(const Camera& a, const Camera& b) {
  return (a.world_from_camera.translation() - b.world_from_camera.translation()).norm();
}

double median_depth(const std::vector<ReducedView>& views) {
  std::vector<float> depths;
  for (const ReducedView& view : views) {
    std::copy_if(view.depth.begin(), view.depth.end(), std::back_inserter(depths),
                 [](float depth) { return depth > 0; });
  }
  if (depths.empty()) return 0;
  const auto middle = depths.begin() + static_cast<std::ptrdiff_t>(depths.size() / 2);
  std::nth_element(depths.begin(), middle, depths.end());
  return *middle;
}

}  // namespace

std::vector<ComparedPhotographs> comparisons_of(const std::vector<Camera>& cameras,
                                                const std::vector<bool>& photographed) {
  double largest = 0, farthest = 0;
  for (size_t a = 0; a < cameras.size(); ++a) {
    if (!photographed[a]) continue;
    farthest = std::max(farthest, cameras[a].world_from_camera.translation().norm());
    for (size_t b = 0; b < cameras.size(); ++b) {
      if (photographed[b]) largest = std::max(largest, distance(cameras[a], cameras[b]));
    }
  }
  // Baselines that are rounding of the centres' own size say nothing.
  if (!(largest > 1e-9 * farthest)) return {};
  const auto nearest_to = [&](size_t view, double beyond) {
    std::vector<size_t> found;
    for (size_t i = 0; i < cameras.size(); ++i) {
      if (photographed[i] && distance(cameras[view], cameras[i]) >= beyond) found.push_back(i);
    }
    std::stable_sort(found.begin(), found.end(), [&](size_t a, size_t b) {
      return distance(cameras[view], cameras[a]) < distance(cameras[view], cameras[b]);
    });
    return found;
  };
  std::vector<std::vector<ComparedPhotographs>> of_view(cameras.size());
  for (size_t view = 0; view < cameras.size(); ++view) {
    const auto firsts = photographed[view] ? std::vector<size_t>{view} : nearest_to(view, 0);
    for (const size_t first : firsts) {
      for (const size_t second : nearest_to(first, kLeastBaseline * largest)) {
        const bool known = std::any_of(of_view[view].begin(), of_view[view].end(), [&](const auto& other) {
          return other.first == second && other.second == first;
        });
        if (!known) of_view[view].push_back({view, first, second});
      }
    }
  }
  // Every view's first comparison is taken, then every view's second one.
  std::vector<ComparedPhotographs> chosen;
  for (size_t rank = 0; rank < kMostComparisons; ++rank) {
    for (const auto& list : of_view) {
      if (rank < list.size() && chosen.size() < kMostComparisons) chosen.push_back(list[rank]);
    }
  }
  return chosen;
}

std::optional<DepthScale> scale_from_photo_consistency(const std::vector<PicturedView>& views,
                                                       const std::string& estimator) {
  std::vector<Camera> cameras;
  std::vector<bool> photographed;
  for (const PicturedView& view : views) {
    cameras.push_back(view.camera);
    photographed.push_back(!view.rgb.empty());
  }
  const auto comparisons = comparisons_of(cameras, photographed);
  if (comparisons.empty()) return std::nullopt;
  std::vector<ReducedView> small;
  small.reserve(views.size());
  for (const PicturedView& view : views) small.push_back(reduced(view));
  const double depth = median_depth(small);
  if (!(depth > 0)) return std::nullopt;
  double nearest = std::numeric_limits<double>::infinity(), farthest = 0, focal = 0;
  for (const ComparedPhotographs& compared : comparisons) {
    const double baseline = distance(cameras[compared.first], cameras[compared.second]);
    nearest = std::min(nearest, baseline);
    farthest = std::max(farthest, baseline);
    focal = std::max({focal, small[compared.view].intrinsics(0, 0), small[compared.view].intrinsics(1, 1)});
  }
  // Parallax of a point at depth z is focal * baseline / z pixels.
  ScaleCandidates candidates =
      ScaleCandidates::between(kNearestDepth * nearest / depth, focal * farthest / depth);
  candidates.cut_off = true;
  ScaleConsensus consensus(candidates);
  for (const ComparedPhotographs& compared : comparisons) compare(small, compared, consensus);
  return consensus.estimate(estimator, kMatchingDeviation);
}

}  // namespace gld
