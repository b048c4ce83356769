#include "gld/photogrammetry/picture_warp.h"

#include "gld/photogrammetry/bilinear_neighbours.h"
#include "gld/photogrammetry/depth_between.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

#include <Eigen/Geometry>
#include <Eigen/LU>

namespace gld {
namespace {

// So many points along each side of a pixel of the photograph are carried, so that what comes nearer stays without
// gaps.
constexpr int64_t kPointsAPixelSide = 3;
// So many depths are tried for a pixel: the predicted one times exp(-depth_reach ... depth_reach).
constexpr int64_t kCandidates = 25;
// A depth that is off by a tenth costs this, in brightness from 0 to 1; it grows with the square. It was measured on
// drawn rooms, with the windows.
constexpr float kPriceOfATenth = 0.005F;
constexpr int64_t kMatchedWindow = 4;      // pixels to each side
constexpr float kCostOfOneSource = 0.15F;  // of a pixel that fewer than two photographs show
constexpr int64_t kReachedWithin = 2;      // pixels

// This changes from one camera's pixels and planar depth to another's: (u, v, 1) depth -> depth (u, v, 1). It is found
// in double and applied in float, which places a pixel of a picture of 4096 to a thousandth.
class PixelTransform {
 public:
  struct Place {
    float x, y, z;  // (u, v, 1) times depth
  };

  PixelTransform(const Camera& from, const Camera& to) {
    const Eigen::Isometry3d to_from = to.camera_from_world() * from.world_from_camera;
    turned_ = (to.intrinsics * to_from.rotation() * from.intrinsics.inverse()).cast<float>();
    moved_ = (to.intrinsics * to_from.translation()).cast<float>();
  }

  // Returns the place of pixel (x, y), counted from the picture's corner, at that depth.
  Place operator()(float x, float y, float depth) const {
    const auto row = [&](Eigen::Index i) {
      return (turned_(i, 0) * x + turned_(i, 1) * y + turned_(i, 2)) * depth + moved_(i);
    };
    return {row(0), row(1), row(2)};
  }

 private:
  Eigen::Matrix3f turned_;
  Eigen::Vector3f moved_;
};

// Returns the nearest depth that comes to lie in each pixel of the target, and infinity where none does.
std::vector<double> carried_depth(const PicturedView& source, const Camera& target) {
  std::vector<double> nearest(static_cast<size_t>(target.width * target.height),
                              std::numeric_limits<double>::infinity());
  const PixelTransform target_from_source(source.camera, target);
  const int64_t columns = source.camera.width * kPointsAPixelSide,
                rows = source.camera.height * kPointsAPixelSide;
  const auto cells = [](int64_t point, int64_t points, int64_t side) {
    return (static_cast<double>(point) + 0.5) * static_cast<double>(side) / static_cast<double>(points) - 0.5;
  };
  for (int64_t row = 0; row < rows; ++row) {
    const float y = (static_cast<float>(row) + 0.5F) / kPointsAPixelSide;
    for (int64_t column = 0; column < columns; ++column) {
      const float depth = depth_between(source.depth, cells(column, columns, source.depth.width),
                                        cells(row, rows, source.depth.height));
      if (depth == 0.0F) continue;
      const float x = (static_cast<float>(column) + 0.5F) / kPointsAPixelSide;
      const auto in_target = target_from_source(x, y, depth);
      if (!(in_target.z > 0)) continue;
      const float u = std::floor(in_target.x / in_target.z), v = std::floor(in_target.y / in_target.z);
      if (!(u >= 0 && v >= 0 && u < static_cast<float>(target.width) &&
            v < static_cast<float>(target.height))) {
        continue;
      }
      double& cell =
          nearest[static_cast<size_t>(static_cast<int64_t>(v) * target.width + static_cast<int64_t>(u))];
      cell = std::min(cell, static_cast<double>(in_target.z));
    }
  }
  return nearest;
}

}  // namespace

double CarriedPicture::seen_share() const {
  if (seen.empty()) return 0;
  return static_cast<double>(std::accumulate(seen.begin(), seen.end(), int64_t{0})) /
         static_cast<double>(seen.size());
}

namespace {

// For every pixel the nearest one that is known (in steps along rows and columns), and how far it is.
struct NearestKnown {
  std::vector<size_t> pixel;
  std::vector<int64_t> steps;
  bool any = false;  // whether one is known at all

  NearestKnown(int64_t width, int64_t height, const std::vector<uint8_t>& known)
      : pixel(known.size()), steps(known.size()) {
    constexpr int64_t kFar = int64_t{1} << 40;
    for (size_t i = 0; i < known.size(); ++i) {
      pixel[i] = i;
      steps[i] = known[i] != 0 ? 0 : kFar;
      any = any || known[i] != 0;
    }
    const auto relax = [&](int64_t row, int64_t column, int64_t from_row, int64_t from_column) {
      if (from_row < 0 || from_column < 0 || from_row >= height || from_column >= width) return;
      const auto here = static_cast<size_t>(row * width + column);
      const auto there = static_cast<size_t>(from_row * width + from_column);
      if (steps[there] + 1 >= steps[here]) return;
      steps[here] = steps[there] + 1;
      pixel[here] = pixel[there];
    };
    for (int64_t row = 0; row < height; ++row) {
      for (int64_t column = 0; column < width; ++column) {
        relax(row, column, row - 1, column);
        relax(row, column, row, column - 1);
      }
    }
    for (int64_t row = height - 1; row >= 0; --row) {
      for (int64_t column = width - 1; column >= 0; --column) {
        relax(row, column, row + 1, column);
        relax(row, column, row, column + 1);
      }
    }
  }
};

// Applies [1 2 1] / 4 along both sides, of logarithms.
void smooth(int64_t width, int64_t height, std::vector<double>& depth) {
  const auto line = [&](size_t first, int64_t count, size_t stride) {
    double before = depth[first];
    for (int64_t i = 1; i + 1 < count; ++i) {
      double& here = depth[first + static_cast<size_t>(i) * stride];
      const double after = depth[first + static_cast<size_t>(i + 1) * stride];
      const double value = here;
      here = std::sqrt(value * std::sqrt(before * after));
      before = value;
    }
  };
  for (int64_t row = 0; row < height; ++row) line(static_cast<size_t>(row * width), width, 1);
  for (int64_t column = 0; column < width; ++column) {
    line(static_cast<size_t>(column), height, static_cast<size_t>(width));
  }
}

// Means over the windows of kMatchedWindow pixels to each side, cut off at the border.
class WindowMeans {
 public:
  WindowMeans(int64_t width, int64_t height)
      : width_(width), height_(height), along_rows_(static_cast<size_t>(width * height)) {}

  void operator()(std::vector<float>& values) {
    for (int64_t row = 0; row < height_; ++row)
      line(values, along_rows_, static_cast<size_t>(row * width_), width_, 1);
    for (int64_t column = 0; column < width_; ++column) {
      line(along_rows_, values, static_cast<size_t>(column), height_, static_cast<size_t>(width_));
    }
  }

 private:
  static void line(const std::vector<float>& from, std::vector<float>& to, size_t first, int64_t count,
                   size_t stride) {
    const auto value = [&](int64_t i) { return from[first + static_cast<size_t>(i) * stride]; };
    float sum = 0;
    for (int64_t i = 0; i < std::min(kMatchedWindow, count); ++i) sum += value(i);
    for (int64_t i = 0; i < count; ++i) {
      if (i + kMatchedWindow < count) sum += value(i + kMatchedWindow);
      if (i - kMatchedWindow > 0) sum -= value(i - kMatchedWindow - 1);
      const int64_t covered =
          std::min(i + kMatchedWindow, count - 1) - std::max<int64_t>(i - kMatchedWindow, 0) + 1;
      to[first + static_cast<size_t>(i) * stride] = sum / static_cast<float>(covered);
    }
  }

  int64_t width_, height_;
  std::vector<float> along_rows_;
};

// A pixel's place in a photograph, if it is inside of it.
struct PlaceInSource {
  bool inside = false;
  float depth = 0;  // from the source
  float x = 0;      // pixels of the photograph, from the first one's middle
  float y = 0;
};

// Returns the weights of the pixels at -1, 0, 1 and 2 for a place `t` of the way from 0 to 1 (Keys 1981, a = -1/2).
std::array<float, 4> cubic_weights(float t) {
  return {((-0.5F * t + 1) * t - 0.5F) * t, (1.5F * t - 2.5F) * t * t + 1, ((-1.5F * t + 2) * t + 0.5F) * t,
          (0.5F * t - 0.5F) * t * t};
}

// The photographs as the target view's pixels see them at a depth of its own each.
class SourcesFromTarget {
 public:
  SourcesFromTarget(const std::vector<PicturedView>& sources, const Camera& target) : sources_(sources) {
    for (const PicturedView& source : sources) transforms_.emplace_back(target, source.camera);
  }

  size_t count() const { return sources_.size(); }

  // Returns the place of the target's pixel (x, y), counted from the picture's corner, at that depth.
  PlaceInSource place(size_t source, float x, float y, float depth) const {
    const PicturedView& view = sources_[source];
    const auto in_source = transforms_[source](x, y, depth);
    PlaceInSource place;
    place.depth = in_source.z;
    if (!(in_source.z > 0)) return place;
    const float u = in_source.x / (in_source.z * static_cast<float>(view.camera.width));
    const float v = in_source.y / (in_source.z * static_cast<float>(view.camera.height));
    place.inside = u >= 0 && v >= 0 && u <= 1 && v <= 1;
    if (!place.inside) return place;
    place.x = u * static_cast<float>(view.width) - 0.5F;
    place.y = v * static_cast<float>(view.height) - 0.5F;
    return place;
  }

  std::array<float, 3> bilinear_colour(size_t source, const PlaceInSource& place) const {
    const PicturedView& view = sources_[source];
    const float x = std::clamp(place.x, 0.0F, static_cast<float>(view.width - 1));
    const float y = std::clamp(place.y, 0.0F, static_cast<float>(view.height - 1));
    const auto left = static_cast<int64_t>(x), top = static_cast<int64_t>(y);
    const float across = x - static_cast<float>(left), down = y - static_cast<float>(top);
    const float* upper = view.rgb.data() + 3 * (top * view.width + left);
    const float* lower = top + 1 < view.height ? upper + 3 * view.width : upper;
    const int64_t right = left + 1 < view.width ? 3 : 0;
    std::array<float, 3> mixed{};
    for (int64_t c = 0; c < 3; ++c) {
      const float above = upper[c] + across * (upper[right + c] - upper[c]);
      const float below = lower[c] + across * (lower[right + c] - lower[c]);
      mixed[static_cast<size_t>(c)] = above + down * (below - above);
    }
    return mixed;
  }

  std::array<float, 3> cubic_colour(size_t source, const PlaceInSource& place) const {
    const PicturedView& view = sources_[source];
    const float x = std::clamp(place.x, 0.0F, static_cast<float>(view.width - 1));
    const float y = std::clamp(place.y, 0.0F, static_cast<float>(view.height - 1));
    const auto left = static_cast<int64_t>(x), top = static_cast<int64_t>(y);
    const auto across = cubic_weights(x - static_cast<float>(left));
    const auto down = cubic_weights(y - static_cast<float>(top));
    std::array<int64_t, 4> columns{};
    for (int64_t i = 0; i < 4; ++i)
      columns[static_cast<size_t>(i)] = 3 * std::clamp<int64_t>(left + i - 1, 0, view.width - 1);
    std::array<float, 3> mixed{};
    for (int64_t j = 0; j < 4; ++j) {
      const float* row =
          view.rgb.data() + 3 * view.width * std::clamp<int64_t>(top + j - 1, 0, view.height - 1);
      for (size_t c = 0; c < 3; ++c) {
        float along = 0;
        for (size_t i = 0; i < 4; ++i) along += across[i] * row[columns[i] + static_cast<int64_t>(c)];
        mixed[c] += down[static_cast<size_t>(j)] * along;
      }
    }
    for (float& colour : mixed) colour = std::clamp(colour, 0.0F, 1.0F);
    return mixed;
  }

  // Returns whether the source shows something in front of that place.
  bool hidden(size_t source, const PlaceInSource& place, double behind) const {
    const PicturedView& view = sources_[source];
    const auto cell = [](float pixel, int64_t pixels, int64_t cells) {
      return (static_cast<double>(pixel) + 0.5) * static_cast<double>(cells) / static_cast<double>(pixels) -
             0.5;
    };
    const float shown = depth_between(view.depth, cell(place.x, view.width, view.depth.width),
                                      cell(place.y, view.height, view.depth.height));
    return shown > 0 && static_cast<double>(place.depth) > behind * static_cast<double>(shown);
  }

 private:
  const std::vector<PicturedView>& sources_;
  std::vector<PixelTransform> transforms_;
};

// Computes how much the photographs differ at each pixel: twice the mean distance from their mean colour, over the
// colours.
void differences(const SourcesFromTarget& sources, const Camera& target, const std::vector<double>& depth,
                 double factor, std::vector<float>& result) {
  std::vector<std::array<float, 3>> colours(sources.count());
  for (int64_t row = 0; row < target.height; ++row) {
    for (int64_t column = 0; column < target.width; ++column) {
      const auto pixel = static_cast<size_t>(row * target.width + column);
      size_t shown = 0;
      for (size_t source = 0; source < sources.count(); ++source) {
        const PlaceInSource place =
            sources.place(source, static_cast<float>(column) + 0.5F, static_cast<float>(row) + 0.5F,
                          static_cast<float>(factor * depth[pixel]));
        if (place.inside) colours[shown++] = sources.bilinear_colour(source, place);
      }
      result[pixel] = kCostOfOneSource;
      if (shown < 2) continue;
      float sum = 0;
      for (size_t c = 0; c < 3; ++c) {
        float mean = 0;
        for (size_t i = 0; i < shown; ++i) mean += colours[i][c] / static_cast<float>(shown);
        for (size_t i = 0; i < shown; ++i) sum += std::abs(colours[i][c] - mean);
      }
      result[pixel] = 2 * sum / static_cast<float>(3 * shown);
    }
  }
}

// Moves each pixel's depth to where the photographs agree.
void match(const SourcesFromTarget& sources, const Camera& target, double reach, std::vector<double>& depth) {
  if (sources.count() < 2 || reach <= 0) return;
  std::vector<float> cost(depth.size()), least(depth.size(), std::numeric_limits<float>::max());
  std::vector<double> best(depth.size(), 1);
  WindowMeans window_means(target.width, target.height);
  for (int64_t candidate = 0; candidate < kCandidates; ++candidate) {
    const double off =
        reach * (2.0 * static_cast<double>(candidate) / static_cast<double>(kCandidates - 1) - 1);
    const double factor = std::exp(off);
    differences(sources, target, depth, factor, cost);
    window_means(cost);
    const auto price = static_cast<float>(kPriceOfATenth * (off / 0.1) * (off / 0.1));
    for (size_t i = 0; i < depth.size(); ++i) {
      if (cost[i] + price >= least[i]) continue;
      least[i] = cost[i] + price;
      best[i] = factor;
    }
  }
  for (size_t i = 0; i < depth.size(); ++i) depth[i] *= best[i];
}

}  // namespace

TargetDepth matched_target_depth(const std::vector<PicturedView>& sources, const Camera& target,
                                 const CarryOptions& options) {
  const auto pixels = static_cast<size_t>(target.width * target.height);
  TargetDepth result{target.width, target.height,
                     std::vector<double>(pixels, std::numeric_limits<double>::infinity()),
                     std::vector<uint8_t>(pixels, 0)};
  auto& depth = result.values;
  for (const PicturedView& source : sources) {
    const std::vector<double> own = carried_depth(source, target);
    for (size_t i = 0; i < pixels; ++i) depth[i] = std::min(depth[i], own[i]);
  }
  std::vector<uint8_t> known(pixels);
  for (size_t i = 0; i < pixels; ++i) known[i] = std::isfinite(depth[i]) ? 1 : 0;
  const NearestKnown nearest(target.width, target.height, known);
  if (!nearest.any) return result;
  for (size_t i = 0; i < pixels; ++i) {
    depth[i] = depth[nearest.pixel[i]];
    result.reached[i] = nearest.steps[i] <= kReachedWithin ? 1 : 0;
  }
  smooth(target.width, target.height, depth);
  match(SourcesFromTarget(sources, target), target, options.depth_reach, depth);
  return result;
}

std::vector<CarriedPicture> carry_pictures_to(const std::vector<PicturedView>& sources, const Camera& target,
                                              const TargetDepth& depth, const CarryOptions& options) {
  const auto pixels = static_cast<size_t>(target.width * target.height);
  CarriedPicture empty;
  empty.width = target.width;
  empty.height = target.height;
  empty.rgb.assign(3 * pixels, 0.0F);
  empty.seen.assign(pixels, 0);
  std::vector<CarriedPicture> carried(sources.size(), empty);
  const SourcesFromTarget from_target(sources, target);
  for (size_t source = 0; source < sources.size(); ++source) {
    for (int64_t row = 0; row < target.height; ++row) {
      for (int64_t column = 0; column < target.width; ++column) {
        const auto pixel = static_cast<size_t>(row * target.width + column);
        if (depth.reached[pixel] == 0) continue;
        const PlaceInSource place =
            from_target.place(source, static_cast<float>(column) + 0.5F, static_cast<float>(row) + 0.5F,
                              static_cast<float>(depth.values[pixel]));
        if (!place.inside || from_target.hidden(source, place, options.hidden_behind)) continue;
        const auto colour = options.colours == ColourSampling::kCubic
                                ? from_target.cubic_colour(source, place)
                                : from_target.bilinear_colour(source, place);
        std::copy(colour.begin(), colour.end(),
                  carried[source].rgb.begin() + static_cast<std::ptrdiff_t>(3 * pixel));
        carried[source].seen[pixel] = 1;
      }
    }
  }
  return carried;
}

std::vector<CarriedPicture> carry_pictures(const std::vector<PicturedView>& sources, const Camera& target,
                                           const CarryOptions& options) {
  return carry_pictures_to(sources, target, matched_target_depth(sources, target, options), options);
}

CarriedPicture completed_picture(const std::vector<CarriedPicture>& carried) {
  CarriedPicture mean = carried.front();
  const size_t pixels = mean.seen.size();
  for (size_t pixel = 0; pixel < pixels; ++pixel) {
    float shown = 0;
    std::array<float, 3> sum{};
    for (const CarriedPicture& picture : carried) {
      if (picture.seen[pixel] == 0) continue;
      shown += 1;
      for (size_t c = 0; c < 3; ++c) sum[c] += picture.rgb[3 * pixel + c];
    }
    mean.seen[pixel] = shown > 0 ? 1 : 0;
    for (size_t c = 0; c < 3; ++c) mean.rgb[3 * pixel + c] = shown > 0 ? sum[c] / shown : 0.0F;
  }
  const NearestKnown nearest(mean.width, mean.height, mean.seen);
  for (size_t pixel = 0; pixel < pixels && nearest.any; ++pixel) {
    for (size_t c = 0; c < 3; ++c) mean.rgb[3 * pixel + c] = mean.rgb[3 * nearest.pixel[pixel] + c];
  }
  return mean;
}

PlanarDepth depth_seen_from(const PicturedView& source, const Camera& target) {
  const std::vector<double> own = carried_depth(source, target);
  std::vector<uint8_t> known(own.size());
  for (size_t i = 0; i < own.size(); ++i) known[i] = std::isfinite(own[i]) ? 1 : 0;
  const NearestKnown nearest(target.width, target.height, known);
  PlanarDepth depth{target.width, target.height, std::vector<float>(own.size(), 0.0F)};
  if (!nearest.any) return depth;
  for (size_t i = 0; i < own.size(); ++i) depth.values[i] = static_cast<float>(own[nearest.pixel[i]]);
  return depth;
}

}  // namespace gld
