#include "gld/photogrammetry/photograph_composition.h"

#include "gld/cameras/image_size.h"
#include "gld/cameras/resized_camera.h"
#include "gld/photogrammetry/bilinear_neighbours.h"
#include "gld/photogrammetry/membrane.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include <Eigen/Core>

namespace gld {
namespace {

constexpr float kVarianceOfOne = PhotographView::kVarianceOfOne;
constexpr float kColourNoise = PhotographView::kColourNoise;
// A generated picture's error where no photograph can tell it (22 dB).
constexpr double kUsualGeneratedVariance = 0.006;
// And this is where none shows the place (17 dB: real places have 12 to 24 there, drawn rooms 21).
constexpr double kUnseenVariance = 0.02;

// Returns a picture reduced to another size, every pixel the mean of the area that it covers.
std::vector<float> area_means(const PicturedView& view, int64_t width, int64_t height) {
  std::vector<float> reduced(static_cast<size_t>(3 * width * height), 0.0F);
  const double across = static_cast<double>(view.width) / static_cast<double>(width);
  const double down = static_cast<double>(view.height) / static_cast<double>(height);
  // Returns the part of source cell `cell` that [from, to) covers.
  const auto covered = [](int64_t cell, double from, double to) {
    return std::min(to, static_cast<double>(cell + 1)) - std::max(from, static_cast<double>(cell));
  };
  for (int64_t row = 0; row < height; ++row) {
    const double top = static_cast<double>(row) * down, bottom = top + down;
    for (int64_t column = 0; column < width; ++column) {
      const double left = static_cast<double>(column) * across, right = left + across;
      float* to = reduced.data() + 3 * (row * width + column);
      for (auto y = static_cast<int64_t>(top); y < view.height && static_cast<double>(y) < bottom; ++y) {
        for (auto x = static_cast<int64_t>(left); x < view.width && static_cast<double>(x) < right; ++x) {
          const auto share =
              static_cast<float>(covered(y, top, bottom) * covered(x, left, right) / (across * down));
          for (int64_t c = 0; c < 3; ++c)
            to[c] += share * view.rgb[static_cast<size_t>(3 * (y * view.width + x) + c)];
        }
      }
    }
  }
  return reduced;
}

// Of each pixel of a target view the angle between the lines of sight of target and source, radians.
class SightAngle {
 public:
  SightAngle(const Camera& source, const Camera& target)
      : centre_(target.camera_from_world() * source.world_from_camera.translation()),
        rays_(target.intrinsics.inverse()) {}

  double operator()(double x, double y, double depth) const {
    const Eigen::Vector3d point = depth * (rays_ * Eigen::Vector3d(x, y, 1));
    const Eigen::Vector3d from_source = point - centre_;
    return std::atan2(point.cross(from_source).norm(), point.dot(from_source));
  }

 private:
  Eigen::Vector3d centre_;  // of the source, in the target camera's frame
  Eigen::Matrix3d rays_;
};

// Returns how far a pixel's neighbourhood is seen, from 0 at the border of what is seen to 1 `reach` pixels inside: the
// photograph's weight near where it ends. Steps are along rows and columns.
std::vector<float> inside_weight(const CarriedPicture& picture, int64_t reach) {
  const int64_t width = picture.width, height = picture.height;
  std::vector<int64_t> steps(picture.seen.size());
  for (size_t i = 0; i < steps.size(); ++i) steps[i] = picture.seen[i] != 0 ? reach : 0;
  // Beyond the target's own border nothing ends: only what is not seen inside of it counts.
  const auto relax = [&](int64_t row, int64_t column, int64_t from_row, int64_t from_column) {
    if (from_row < 0 || from_column < 0 || from_row >= height || from_column >= width) return;
    auto& here = steps[static_cast<size_t>(row * width + column)];
    here = std::min(here, steps[static_cast<size_t>(from_row * width + from_column)] + 1);
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
  std::vector<float> weights(steps.size());
  for (size_t i = 0; i < steps.size(); ++i)
    weights[i] = static_cast<float>(steps[i]) / static_cast<float>(reach);
  return weights;
}

// Takes means over windows of `reach` pixels to each side of the values that are known, by running sums along rows and
// columns.
void known_window_means(int64_t width, int64_t height, int64_t reach, const std::vector<float>& known,
                        std::vector<float>& values) {
  std::vector<double> sums(values.size()), counts(values.size());
  const auto pass = [&](auto&& line) {
    for (int64_t row = 0; row < height; ++row) line(static_cast<size_t>(row * width), width, size_t{1});
    for (int64_t column = 0; column < width; ++column) {
      line(static_cast<size_t>(column), height, static_cast<size_t>(width));
    }
  };
  for (size_t i = 0; i < values.size(); ++i) {
    sums[i] = static_cast<double>(known[i]) * (known[i] > 0 ? static_cast<double>(values[i]) : 0.0);
    counts[i] = static_cast<double>(known[i]);
  }
  std::vector<double> copy;
  const auto window = [&](std::vector<double>& data) {
    pass([&](size_t first, int64_t count, size_t stride) {
      copy.assign(static_cast<size_t>(count) + 1, 0.0);
      for (int64_t i = 0; i < count; ++i)
        copy[static_cast<size_t>(i) + 1] =
            copy[static_cast<size_t>(i)] + data[first + static_cast<size_t>(i) * stride];
      for (int64_t i = 0; i < count; ++i) {
        data[first + static_cast<size_t>(i) * stride] =
            copy[static_cast<size_t>(std::min(i + reach + 1, count))] -
            copy[static_cast<size_t>(std::max<int64_t>(i - reach, 0))];
      }
    });
  };
  window(sums);
  window(counts);
  for (size_t i = 0; i < values.size(); ++i) {
    if (known[i] > 0 && counts[i] > 0) values[i] = static_cast<float>(std::max(0.0, sums[i] / counts[i]));
  }
}

// A generated picture's errors where photographs agree with each other best.
struct GeneratedErrors {
  double square = 0;    // their mean square
  double variance = 0;  // less what each colour is off by on average
};

// Returns nothing where photographs agree hardly anywhere, as where each place is shown by a single one.
std::optional<GeneratedErrors> errors_where_agreed(const PhotographView& view,
                                                   const std::vector<float>& generated) {
  constexpr size_t kFewest = 100;  // pixels
  constexpr float kAgree = 4 * kColourNoise;
  double squares = 0;
  std::array<double, 3> sums{};
  size_t count = 0;
  for (size_t pixel = 0; pixel < view.variance.size(); ++pixel) {
    if (view.variance[pixel] > kAgree) continue;
    ++count;
    for (size_t c = 0; c < 3; ++c) {
      const double off = static_cast<double>(generated[3 * pixel + c] - view.rgb[3 * pixel + c]);
      sums[c] += off;
      squares += off * off / 3;
    }
  }
  if (count < kFewest) return std::nullopt;
  const auto pixels = static_cast<double>(count);
  GeneratedErrors errors{squares / pixels, squares / pixels};
  for (const double sum : sums) errors.variance -= (sum / pixels) * (sum / pixels) / 3;
  errors.variance = std::max(errors.variance, 0.0);
  return errors;
}

// Returns the depth of a target view at another size. Between cells of one surface it is interpolated; at an edge the
// nearest cell's is taken, so that no surface hangs between two.
TargetDepth resized_depth(const TargetDepth& depth, int64_t width, int64_t height) {
  if (depth.width == width && depth.height == height) return depth;
  constexpr double kOneSurface = 1.05;
  TargetDepth result{width, height, std::vector<double>(static_cast<size_t>(width * height)),
                     std::vector<uint8_t>(static_cast<size_t>(width * height))};
  for (int64_t row = 0; row < height; ++row) {
    const double y =
        (static_cast<double>(row) + 0.5) * static_cast<double>(depth.height) / static_cast<double>(height) -
        0.5;
    for (int64_t column = 0; column < width; ++column) {
      const double x = (static_cast<double>(column) + 0.5) * static_cast<double>(depth.width) /
                           static_cast<double>(width) -
                       0.5;
      const BilinearNeighbours around(depth.width, depth.height, x, y);
      double sum = 0, least = std::numeric_limits<double>::infinity(), most = 0;
      for (size_t i = 0; i < 4; ++i) {
        const double value = depth.values[around.cells[i]];
        sum += static_cast<double>(around.weights[i]) * value;
        least = std::min(least, value);
        most = std::max(most, value);
      }
      const auto pixel = static_cast<size_t>(row * width + column);
      const size_t nearest = around.nearest();
      result.values[pixel] = most <= kOneSurface * least ? sum : depth.values[nearest];
      result.reached[pixel] = depth.reached[nearest];
    }
  }
  return result;
}

}  // namespace

double PhotographView::shown_share() const {
  if (variance.empty()) return 0;
  size_t count = 0;
  for (size_t pixel = 0; pixel < variance.size(); ++pixel) count += shown(pixel) ? 1 : 0;
  return static_cast<double>(count) / static_cast<double>(variance.size());
}

bool PhotographView::complete() const {
  constexpr double kUnshown = 0.001, kConfirmed = 0.9;
  const auto pixels = static_cast<double>(variance.size());
  double count = 0, confirmed = 0, sum = 0;
  for (size_t pixel = 0; pixel < variance.size(); ++pixel) {
    if (!shown(pixel)) continue;
    count += 1;
    confirmed += variance[pixel] < kVarianceOfOne ? 1 : 0;
    sum += static_cast<double>(variance[pixel]);
  }
  return count > 0 && count >= (1 - kUnshown) * pixels && confirmed >= kConfirmed * pixels &&
         sum <= static_cast<double>(kVarianceOfOne) * count;
}

PicturedView reduced_view(const PicturedView& view, int64_t side) {
  const auto [width, height] = image_within(view.width, view.height, side);
  PicturedView reduced;
  reduced.camera = resized_camera(view.camera, width, height);
  reduced.depth = view.depth;
  reduced.width = width;
  reduced.height = height;
  reduced.rgb = width == view.width && height == view.height ? view.rgb : area_means(view, width, height);
  return reduced;
}

PlacedPhotographs place_photographs(const std::vector<PicturedView>& sources,
                                    const std::vector<ColourGains>& gains, const Camera& target,
                                    const PhotographViewOptions& options) {
  PlacedPhotographs placed{{}, target, {}, options.carry};
  // What is shown of a photograph is as sharp as it; pictures from bilinear colours have .60 of the truth's sharpness,
  // these .75 (the Lund door at 448x448).
  placed.carry.colours = ColourSampling::kCubic;
  if (sources.empty()) return placed;
  placed.photographs = evened_photographs(sources, gains, target);
  const auto [width, height] = image_within(target.width, target.height, options.matched_side);
  std::vector<PicturedView> small;
  small.reserve(placed.photographs.size());
  for (const PicturedView& source : placed.photographs)
    small.push_back(reduced_view(source, options.matched_side));
  placed.depth =
      resized_depth(matched_target_depth(small, resized_camera(target, width, height), options.carry),
                    target.width, target.height);
  return placed;
}

PlacedPhotographs reduced(const PlacedPhotographs& placed, int64_t side) {
  const auto [width, height] = image_within(placed.target.width, placed.target.height, side);
  PlacedPhotographs small{{}, resized_camera(placed.target, width, height), {}, placed.carry};
  if (placed.photographs.empty()) return small;
  for (const PicturedView& photograph : placed.photographs)
    small.photographs.push_back(reduced_view(photograph, side));
  small.depth = resized_depth(placed.depth, width, height);
  return small;
}

PhotographView view_from_photographs(const PlacedPhotographs& placed) {
  const std::vector<PicturedView>& even = placed.photographs;
  const Camera& target = placed.target;
  const TargetDepth& depth = placed.depth;
  const auto pixels = static_cast<size_t>(target.width * target.height);
  PhotographView view{target.width, target.height, std::vector<float>(3 * pixels, 0.0F),
                      std::vector<float>(pixels, std::numeric_limits<float>::infinity())};
  if (even.empty()) return view;
  const auto carried = carry_pictures_to(even, target, depth, placed.carry);

  // A line of sight that is off by this counts half as much.
  constexpr double kHalfAngle = 0.05;
  const int64_t feather = std::max<int64_t>(1, std::max(target.width, target.height) / 40);
  std::vector<std::vector<float>> weights;
  for (size_t i = 0; i < carried.size(); ++i) {
    std::vector<float> weight = inside_weight(carried[i], feather);
    const SightAngle angle(even[i].camera, target);
    for (int64_t row = 0; row < target.height; ++row) {
      for (int64_t column = 0; column < target.width; ++column) {
        const auto pixel = static_cast<size_t>(row * target.width + column);
        if (weight[pixel] == 0) continue;
        const double off =
            angle(static_cast<double>(column) + 0.5, static_cast<double>(row) + 0.5, depth.values[pixel]) /
            kHalfAngle;
        weight[pixel] *= static_cast<float>(1 / (1 + off * off));
      }
    }
    weights.push_back(std::move(weight));
  }
  std::vector<float> known(pixels, 0.0F);
  for (size_t pixel = 0; pixel < pixels; ++pixel) {
    size_t shown = 0, best = 0;
    float total = 0;
    for (size_t i = 0; i < carried.size(); ++i) {
      if (carried[i].seen[pixel] == 0) continue;
      if (shown == 0 || weights[i][pixel] > weights[best][pixel]) best = i;
      total += weights[i][pixel];
      ++shown;
    }
    if (shown == 0) continue;
    known[pixel] = 1;
    float* colour = view.rgb.data() + 3 * pixel;
    if (shown == 1 || total <= 0) {
      std::copy_n(carried[best].rgb.begin() + static_cast<std::ptrdiff_t>(3 * pixel), 3, colour);
      view.variance[pixel] = kVarianceOfOne;
      continue;
    }
    float spread = 0;
    for (size_t c = 0; c < 3; ++c) {
      float mean = 0, square = 0;
      for (size_t i = 0; i < carried.size(); ++i) {
        if (carried[i].seen[pixel] == 0) continue;
        const float value = carried[i].rgb[3 * pixel + c], weight = weights[i][pixel] / total;
        mean += weight * value;
        square += weight * value * value;
      }
      colour[c] = mean;
      spread += std::max(0.0F, square - mean * mean) / 3;
    }
    view.variance[pixel] = kColourNoise + spread;
    // Two things, not one with an error: their mean would be a ghost of both.
    constexpr float kContradiction = 0.02F;
    if (spread > kContradiction) {
      const float alone = kContradiction / spread;
      for (size_t c = 0; c < 3; ++c)
        colour[c] = alone * colour[c] + (1 - alone) * carried[best].rgb[3 * pixel + c];
    }
  }
  // A single pixel may agree by chance: its neighbourhood says whether its depth is right.
  constexpr int64_t kNeighbourhood = 2;
  known_window_means(target.width, target.height, kNeighbourhood, known, view.variance);
  for (float& value : view.rgb) value = std::clamp(value, 0.0F, 1.0F);
  return view;
}

PhotographView view_from_photographs(const std::vector<PicturedView>& sources,
                                     const std::vector<ColourGains>& gains, const Camera& target,
                                     const PhotographViewOptions& options) {
  return view_from_photographs(place_photographs(sources, gains, target, options));
}

double generated_variance(const PhotographView& view, const std::vector<float>& generated) {
  const auto errors = errors_where_agreed(view, generated);
  return errors ? errors->square : kUsualGeneratedVariance;
}

double belief_in_generated(const PhotographView& view, const std::vector<float>& generated) {
  constexpr double kHalf = 0.004;   // 24 dB
  constexpr double kUnknown = 0.5;  // where nothing tells
  const auto errors = errors_where_agreed(view, generated);
  if (!errors) return kUnknown;
  const double ratio = errors->variance / kHalf;
  return 1 / (1 + ratio * ratio);
}

ComposedPicture compose(const PhotographView& view, const std::vector<float>& generated,
                        double generated_variance) {
  const size_t pixels = view.variance.size();
  ComposedPicture result{generated, std::vector<float>(pixels, 0.0F)};
  std::vector<float> differences(3 * pixels, 0.0F);
  for (size_t pixel = 0; pixel < pixels; ++pixel) {
    if (!view.shown(pixel)) continue;
    const auto variance = static_cast<double>(view.variance[pixel]);
    result.shown[pixel] = static_cast<float>(generated_variance / (generated_variance + variance));
    for (size_t c = 0; c < 3; ++c)
      differences[3 * pixel + c] = view.rgb[3 * pixel + c] - generated[3 * pixel + c];
  }
  const std::vector<float> moved = membrane(view.width, view.height, 3, differences, result.shown);
  const double shown_share = view.shown_share();
  const bool all_or_nothing = shown_share == 0 || shown_share == 1;
  const auto belief = static_cast<float>(all_or_nothing ? 1 : belief_in_generated(view, generated));
  const std::vector<float> smooth = all_or_nothing ? std::vector<float>() : filled(view);
  for (size_t pixel = 0; pixel < pixels; ++pixel) {
    const float shown = result.shown[pixel];
    for (size_t c = 0; c < 3; ++c) {
      float& colour = result.rgb[3 * pixel + c];
      colour = shown * view.rgb[3 * pixel + c] + (1 - shown) * (colour + moved[3 * pixel + c]);
      if (!all_or_nothing && !view.shown(pixel))
        colour = belief * colour + (1 - belief) * smooth[3 * pixel + c];
      colour = std::clamp(colour, 0.0F, 1.0F);
    }
  }
  return result;
}

double expected_variance(const PhotographView& view, double generated_variance) {
  double sum = 0;
  for (size_t pixel = 0; pixel < view.variance.size(); ++pixel) {
    const auto variance = static_cast<double>(view.variance[pixel]);
    // The variance is of the mixture that compose() makes: v_g v / (v_g + v).
    sum += view.shown(pixel) ? variance / (1 + variance / generated_variance) : kUnseenVariance;
  }
  return view.variance.empty() ? kUnseenVariance : sum / static_cast<double>(view.variance.size());
}

std::vector<float> filled(const PhotographView& view) {
  std::vector<float> weights(view.variance.size());
  bool any = false;
  for (size_t pixel = 0; pixel < weights.size(); ++pixel) {
    weights[pixel] = view.shown(pixel) ? 1.0F : 0.0F;
    any = any || view.shown(pixel);
  }
  if (!any) return std::vector<float>(view.rgb.size(), 0.5F);
  return membrane(view.width, view.height, 3, view.rgb, weights);
}

}  // namespace gld
