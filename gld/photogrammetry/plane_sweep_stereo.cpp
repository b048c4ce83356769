#include "gld/photogrammetry/plane_sweep_stereo.h"

#include "gld/base/error.h"
#include "gld/photogrammetry/depth_between.h"
#include "gld/photogrammetry/plane_sweep.h"
#include "gld/photogrammetry/semi_global_matching.h"
#include "gld/photogrammetry/stereo_picture.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <string>
#include <utility>

#include <Eigen/Geometry>
#include <Eigen/LU>

namespace gld {
namespace {

// Rows of a band of a sweep, which is one thread's: a window's rows are looked up twice at its ends.
constexpr int64_t kBandRows = 56;
// Baselines below this share of the largest one are none; nor are those that are rounding of a position.
constexpr double kBaselineOfLargest = 1e-4;
constexpr double kPositionRounding = 1e-9;
// The nearest plane is where this share of the picture is inside of another photograph.
constexpr double kLeastOverlap = 0.25;
constexpr int64_t kFewestPoints = 20;
// What is found is not all there is: ranges of points, and of confident pixels of the first pass, are widened.
constexpr double kPointMargin = 1.6;
constexpr double kFoundMargin = 1.25;
constexpr double kPriorMargin = 1.1;
// Fewer confident pixels than this share of them (and no fewer than 50) say nothing of range or prior.
constexpr double kHardlyAny = 0.01;
// Confidence: 0 at the first value, full at the second.
constexpr float kUnlikeCorrelation = 0.4F, kAlikeCorrelation = 0.75F;
constexpr float kAmbiguousBelow = 0.01F, kUniqueAbove = 0.06F;
// Movement in another photograph, in pixels, for 1 % of depth: matches are right to a sixth of a pixel or so.
constexpr float kLeastMovement = 0.02F, kEnoughMovement = 0.12F;
// Share of the pixels about one that are certain too.
constexpr double kFewestCertain = 0.3;
constexpr double kPixelsOfMinimum = 1.5;
constexpr float kLeastContrast = 2;  // of a window, in kBrightnessNoise
// Depths of two views agree within a pixel, and within this many planes or this share of inverse depth.
constexpr double kAgreePixels = 1.0;
constexpr double kAgreePlanes = 2.0;
constexpr double kAgreeShare = 0.02;
// The prior: a correlation lower by kCorrelationOfPrior is one unit of log likelihood, at most kMostOfPrior of them,
// fading with its spread beyond kGoodPrior.
constexpr double kCorrelationOfPrior = 0.1;
constexpr double kMostOfPrior = 4;
constexpr double kGoodPrior = 0.1;
constexpr double kLeastSpread = 0.01;
// What counts at most of a confident pixel's distance from the prior, and where distances count as wrong matches, in
// spreads of the prior.
constexpr double kMostOfSpread = 3, kFarCertain = 8, kFarUncertain = 3;
// A prior that is off by more does not widen the depths that are looked at.
constexpr double kUsablePrior = 0.25;
// Depth that the photographs are not sure of: the least standard deviation of its logarithm.
constexpr double kLeastUncertain = 0.05;

float ramp(float value, float from, float to) { return std::clamp((value - from) / (to - from), 0.0F, 1.0F); }

double percentile(std::vector<double>& values, double share) {
  const auto place =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), place, values.end());
  return *place;
}

// Pixels and planar depth of one camera to another's, both counted from pixel middles.
struct BetweenViews {
  Eigen::Matrix3d turned;
  Eigen::Vector3d moved;

  BetweenViews(const Camera& from, const Camera& to) {
    Eigen::Matrix3d middle = Eigen::Matrix3d::Identity();
    middle(0, 2) = middle(1, 2) = 0.5;
    const Eigen::Isometry3d relative = to.camera_from_world() * from.world_from_camera;
    const Eigen::Matrix3d pixels = middle.inverse() * to.intrinsics;
    turned = pixels * relative.linear() * from.intrinsics.inverse() * middle;
    moved = pixels * relative.translation();
  }
  // (x, y, 1) times its depth in the other view.
  Eigen::Vector3d operator()(double x, double y, double depth) const {
    return depth * (turned * Eigen::Vector3d(x, y, 1)) + moved;
  }
};

bool inside(const Eigen::Vector3d& place, const StereoPicture& picture) {
  if (!(place.z() > 0)) return false;
  const double x = place.x() / place.z(), y = place.y() / place.z();
  return x >= -0.5 && y >= -0.5 && x < static_cast<double>(picture.width) - 0.5 &&
         y < static_cast<double>(picture.height) - 0.5;
}

double baseline(const Camera& a, const Camera& b) {
  return (a.world_from_camera.translation() - b.world_from_camera.translation()).norm();
}

// Which views stand far enough from each other to say something.
class Baselines {
 public:
  explicit Baselines(const std::vector<PicturedView>& views) : views_(views) {
    double largest = 0, position = 0;
    for (const PicturedView& a : views) {
      position = std::max(position, a.camera.world_from_camera.translation().norm());
      for (const PicturedView& b : views) largest = std::max(largest, baseline(a.camera, b.camera));
    }
    least_ = std::max(kBaselineOfLargest * largest, kPositionRounding * position);
  }
  bool apart(size_t a, size_t b) const { return baseline(views_[a].camera, views_[b].camera) > least_; }

 private:
  const std::vector<PicturedView>& views_;
  double least_ = 0;
};

constexpr int64_t kSampledSide = 12;

// The share of the view's pixels (of some of them) that lie inside of the other view on a plane of that inverse depth,
// and how far they move there from where they would be at infinity, pixels.
struct Overlap {
  double share = 0;
  double parallax = 0;
};
Overlap overlap_at(const StereoPicture& view, const StereoPicture& other, double inverse_depth) {
  const BetweenViews to_other(view.camera, other.camera);
  Overlap overlap;
  for (int64_t row = 0; row < kSampledSide; ++row) {
    for (int64_t column = 0; column < kSampledSide; ++column) {
      const double x =
          (static_cast<double>(column) + 0.5) / kSampledSide * static_cast<double>(view.width) - 0.5;
      const double y =
          (static_cast<double>(row) + 0.5) / kSampledSide * static_cast<double>(view.height) - 0.5;
      const Eigen::Vector3d far = to_other.turned * Eigen::Vector3d(x, y, 1);
      const Eigen::Vector3d place = far + inverse_depth * to_other.moved;
      if (!inside(place, other)) continue;
      overlap.share += 1;
      if (far.z() > 0) {
        overlap.parallax += (place.head<2>() / place.z() - far.head<2>() / far.z()).norm();
      } else {
        overlap.parallax += static_cast<double>(other.width);
      }
    }
  }
  if (overlap.share > 0) overlap.parallax /= overlap.share;
  overlap.share /= kSampledSide * kSampledSide;
  return overlap;
}

struct InverseDepths {
  double least = 0;
  double most = 0;
  bool empty() const { return !(most > least); }
};

// Of the points before the view and inside of it.
InverseDepths range_of_points(const StereoPicture& view, const std::vector<Eigen::Vector3d>& points) {
  std::vector<double> inverse;
  const Eigen::Isometry3d camera_from_world = view.camera.camera_from_world();
  for (const Eigen::Vector3d& point : points) {
    const Eigen::Vector3d seen = camera_from_world * point;
    if (!(seen.z() > 0)) continue;
    const Eigen::Vector3d pixel = view.camera.intrinsics * seen;
    if (pixel.x() < 0 || pixel.y() < 0 || pixel.x() > pixel.z() * static_cast<double>(view.width) ||
        pixel.y() > pixel.z() * static_cast<double>(view.height)) {
      continue;
    }
    inverse.push_back(1 / seen.z());
  }
  if (static_cast<int64_t>(inverse.size()) < kFewestPoints) return {};
  return {percentile(inverse, 0.01) / kPointMargin, percentile(inverse, 0.99) * kPointMargin};
}

// From infinity to where kLeastOverlap of the picture is inside of another photograph.
InverseDepths range_of_visibility(size_t view, const std::vector<StereoPicture>& pictures,
                                  const Baselines& baselines) {
  InverseDepths range;
  for (size_t other = 0; other < pictures.size(); ++other) {
    if (other == view || !baselines.apart(view, other)) continue;
    const double unit = baseline(pictures[view].camera, pictures[other].camera);
    // From a hundred baselines away to a tenth of one, in steps of a tenth.
    for (double inverse = 10 / unit; inverse > 0.01 / unit && inverse > range.most; inverse /= 1.1) {
      if (overlap_at(pictures[view], pictures[other], inverse).share >= kLeastOverlap) {
        range.most = inverse;
        break;
      }
    }
  }
  return range;
}

SweptPlanes planes_over(const InverseDepths& range, int64_t count) {
  SweptPlanes planes;
  planes.count = count;
  // No plane at infinity, whose depth is no number.
  planes.farthest = std::max(range.least, range.most / static_cast<double>(2 * count));
  planes.step = (range.most - planes.farthest) / static_cast<double>(count - 1);
  return planes;
}

// Those which see most of what the view sees at the middle of its range, from somewhere else.
std::vector<size_t> photographs_for(size_t view, const std::vector<StereoPicture>& pictures,
                                    const Baselines& baselines, const InverseDepths& range, int64_t most) {
  std::vector<std::pair<double, size_t>> ranked;
  for (size_t other = 0; other < pictures.size(); ++other) {
    if (other == view || !baselines.apart(view, other)) continue;
    double value = 0;
    for (int i = 1; i <= 3; ++i) {
      const double inverse = range.least + (range.most - range.least) * 0.2 * i;
      const Overlap overlap = overlap_at(pictures[view], pictures[other], inverse);
      // A twentieth of the picture's width of parallax is enough to tell depth, and three tenths is much for a window.
      const double parallax = overlap.parallax / static_cast<double>(pictures[view].width);
      value += overlap.share * std::min(1.0, parallax / 0.05) * std::min(1.0, 0.3 / std::max(parallax, 1e-9));
    }
    if (value > 0) ranked.emplace_back(-value, other);
  }
  std::sort(ranked.begin(), ranked.end());
  if (static_cast<int64_t>(ranked.size()) > most) ranked.resize(static_cast<size_t>(most));
  std::vector<size_t> result;
  for (const auto& entry : ranked) result.push_back(entry.second);
  return result;
}

// The prior as a view's costs take it.
struct ScaledPrior {
  std::vector<float> log_depth;  // (height, width), scaled; not a number where not known
  double steepness = 0;          // of the cost, for each squared unit of log depth
  double dearest = 0;

  bool any() const { return !log_depth.empty(); }
};

struct SweptView {
  std::vector<size_t> compared;
  SweptPlanes planes;
  ScaledPrior prior;
};

// Correlation falls off over a pixel or two: planes that lie as near to each other in the photographs are one minimum.
int64_t planes_of_one_minimum(size_t view, const std::vector<StereoPicture>& pictures,
                              const SweptView& swept) {
  const double middle = swept.planes.inverse_depth(0.5 * static_cast<double>(swept.planes.count));
  double pixels = 0;
  for (const size_t other : swept.compared)
    pixels += overlap_at(pictures[view], pictures[other], middle).parallax;
  const double of_plane = pixels / static_cast<double>(swept.compared.size()) * swept.planes.step / middle;
  return std::clamp<int64_t>(std::lround(kPixelsOfMinimum / std::max(of_plane, 1e-6)), 3,
                             swept.planes.count / 4);
}

// One pass over all views: everything but the check between views.
std::vector<MatchedPlanes> sweep_views(const std::vector<StereoPicture>& pictures,
                                       const std::vector<SweptView>& swept, const StereoOptions& options,
                                       const KernelSettings& settings) {
  const KernelTable& kernels = kernel_table(settings.instruction_set);
  std::vector<MatchedPlanes> matched(pictures.size());
  PathPenalties penalties;
  penalties.small_step = options.small_step;
  penalties.big_step = options.big_step;
  std::vector<size_t> todo;
  for (size_t view = 0; view < pictures.size(); ++view) {
    if (!swept[view].compared.empty()) todo.push_back(view);
  }
  int64_t most_bytes = 1;
  for (const size_t view : todo) {
    most_bytes = std::max(most_bytes, 3 * pictures[view].width * pictures[view].height *
                                          (swept[view].planes.count + kPlaneGroup));
  }
  const auto at_a_time = static_cast<size_t>(
      std::clamp<int64_t>((options.memory_limit << 20) / most_bytes, 1, std::max(1, settings.threads)));
  for (size_t first = 0; first < todo.size(); first += at_a_time) {
    const size_t count = std::min(at_a_time, todo.size() - first);
    std::vector<std::unique_ptr<CostVolume>> volumes;
    std::vector<std::unique_ptr<ReferenceWindows>> windows(count);
    struct Band {
      size_t place;
      int64_t first_row;
    };
    std::vector<Band> bands;
    for (size_t place = 0; place < count; ++place) {
      const size_t view = todo[first + place];
      const StereoPicture& picture = pictures[view];
      volumes.push_back(
          std::make_unique<CostVolume>(picture.width, picture.height, swept[view].planes.count));
      for (int64_t row = 0; row < picture.height; row += kBandRows) bands.push_back({place, row});
    }
#pragma omp parallel for num_threads(settings.threads) schedule(dynamic)
    for (size_t place = 0; place < count; ++place)
      windows[place] = std::make_unique<ReferenceWindows>(pictures[todo[first + place]], options.window / 2);
#pragma omp parallel for num_threads(settings.threads) schedule(dynamic)
    for (size_t band = 0; band < bands.size(); ++band) {
      const size_t place = bands[band].place, view = todo[first + place];
      PlaneSweep sweep;
      sweep.reference = &pictures[view];
      sweep.windows = windows[place].get();
      for (const size_t other : swept[view].compared) sweep.photographs.push_back(&pictures[other]);
      sweep.planes = swept[view].planes;
      const int64_t end = std::min(bands[band].first_row + kBandRows, pictures[view].height);
      sweep_rows(sweep, kernels, bands[band].first_row, end, *volumes[place]);
      const ScaledPrior& prior = swept[view].prior;
      if (!prior.any()) continue;
      std::vector<float> places(static_cast<size_t>(sweep.planes.count));
      for (size_t plane = 0; plane < places.size(); ++plane)
        places[plane] = static_cast<float>(-std::log(sweep.planes.inverse_depth(static_cast<double>(plane))));
      for (int64_t y = bands[band].first_row; y < end; ++y) {
        for (int64_t x = 0; x < pictures[view].width; ++x) {
          const float middle = prior.log_depth[static_cast<size_t>(y * pictures[view].width + x)];
          if (!std::isfinite(middle)) continue;
          kernels.add_prior_costs({sweep.planes.count, places.data(), middle,
                                   static_cast<float>(prior.steepness), static_cast<float>(prior.dearest),
                                   volumes[place]->at(x, y)});
        }
      }
    }
#pragma omp parallel for num_threads(settings.threads) schedule(dynamic)
    for (size_t place = 0; place < count; ++place) {
      const size_t view = todo[first + place];
      matched[view] = match_semi_globally(*volumes[place], pictures[view], penalties,
                                          planes_of_one_minimum(view, pictures, swept[view]), kernels);
      // What the prior added does not belong to the match.
      const ScaledPrior& prior = swept[view].prior;
      for (size_t i = 0; prior.any() && i < matched[view].cost.size(); ++i) {
        if (!std::isfinite(prior.log_depth[i])) continue;
        const double plane = std::round(static_cast<double>(matched[view].plane[i]));
        const auto off = static_cast<double>(
            static_cast<float>(-std::log(swept[view].planes.inverse_depth(plane))) - prior.log_depth[i]);
        const auto added = static_cast<int>(std::min(prior.dearest, prior.steepness * off * off));
        matched[view].cost[i] = static_cast<uint8_t>(std::max(0, matched[view].cost[i] - added));
      }
    }
  }
  return matched;
}

// How many of the views that a pixel was compared with agree with its depth, and how many see something else there.
struct Votes {
  int64_t agree = 0;
  int64_t differ = 0;
  double movement = 0;
};

class CrossCheck {
 public:
  CrossCheck(const std::vector<StereoPicture>& pictures, const std::vector<SweptView>& swept,
             const std::vector<StereoDepth>& depth)
      : pictures_(pictures), swept_(swept), depth_(depth) {}

  // agree and differ count views; movement is how far, in pixels, the place moves in the one where it moves most when
  // the depth is 1 % larger.
  Votes operator()(size_t view, int64_t x, int64_t y, double depth, const std::vector<BetweenViews>& there,
                   const std::vector<BetweenViews>& back) const {
    Votes votes;
    const std::vector<size_t>& compared = swept_[view].compared;
    for (size_t i = 0; i < compared.size(); ++i) {
      const size_t other = compared[i];
      if (swept_[other].compared.empty()) continue;
      const Eigen::Vector3d place = there[i](static_cast<double>(x), static_cast<double>(y), depth);
      if (!inside(place, pictures_[other])) continue;
      const Eigen::Vector3d farther = there[i](static_cast<double>(x), static_cast<double>(y), 1.01 * depth);
      votes.movement =
          std::max(votes.movement, (farther.head<2>() / farther.z() - place.head<2>() / place.z()).norm());
      const auto column = static_cast<int64_t>(std::floor(place.x() / place.z() + 0.5));
      const auto row = static_cast<int64_t>(std::floor(place.y() / place.z() + 0.5));
      const PlanarDepth& map = depth_[other].depth;
      const auto pixel =
          static_cast<size_t>(std::min(row, map.height - 1) * map.width + std::min(column, map.width - 1));
      const auto found = static_cast<double>(map.values[pixel]);
      if (!(found > 0)) continue;
      const Eigen::Vector3d returned = back[i](static_cast<double>(column), static_cast<double>(row), found);
      const double off = std::abs(1 / returned.z() - 1 / depth);
      // The other view was asked at a pixel's middle, up to half a pixel off to both sides.
      const double moved = returned.z() > 0
                               ? (returned.head<2>() / returned.z() - place_of(view, x, y)).norm()
                               : std::numeric_limits<double>::infinity();
      const bool agree = moved <= kAgreePixels + 0.71 &&
                         off <= std::max(kAgreePlanes * swept_[view].planes.step, kAgreeShare / depth);
      (agree ? votes.agree : votes.differ) += 1;
    }
    return votes;
  }

 private:
  static Eigen::Vector2d place_of(size_t, int64_t x, int64_t y) {
    return {static_cast<double>(x), static_cast<double>(y)};
  }

  const std::vector<StereoPicture>& pictures_;
  const std::vector<SweptView>& swept_;
  const std::vector<StereoDepth>& depth_;
};

// Depth, confidence and doubt of all views from what was matched. finest_pixels: of the last pass, in a pixel of these
// pictures; movement counts in them.
std::vector<StereoDepth> judged(const std::vector<StereoPicture>& pictures,
                                const std::vector<SweptView>& swept,
                                const std::vector<MatchedPlanes>& matched, int64_t window_radius,
                                double finest_pixels, const KernelSettings& settings) {
  std::vector<StereoDepth> result(pictures.size());
  for (size_t view = 0; view < pictures.size(); ++view) {
    const int64_t width = pictures[view].width, height = pictures[view].height;
    const auto pixels = static_cast<size_t>(width * height);
    StereoDepth& depth = result[view];
    depth.depth = {width, height, std::vector<float>(pixels, 0.0F)};
    depth.confidence = ConfidenceMap(width, height);
    depth.doubt.assign(pixels, StereoDoubt::kUnseen);
    depth.compared = swept[view].compared;
    for (size_t i = 0; i < matched[view].plane.size(); ++i) {
      depth.depth.values[i] = static_cast<float>(
          1 / swept[view].planes.inverse_depth(static_cast<double>(matched[view].plane[i])));
    }
  }
  const CrossCheck check(pictures, swept, result);
#pragma omp parallel for num_threads(settings.threads) schedule(dynamic)
  for (size_t view = 0; view < pictures.size(); ++view) {
    if (swept[view].compared.empty()) continue;
    StereoDepth& depth = result[view];
    const ReferenceWindows windows(pictures[view], window_radius);
    std::vector<BetweenViews> there, back;
    for (const size_t other : swept[view].compared) {
      there.emplace_back(pictures[view].camera, pictures[other].camera);
      back.emplace_back(pictures[other].camera, pictures[view].camera);
    }
    const float noise =
        kBrightnessNoise * std::sqrt(static_cast<float>((2 * window_radius + 1) * (2 * window_radius + 1)));
    for (int64_t y = 0; y < depth.depth.height; ++y) {
      for (int64_t x = 0; x < depth.depth.width; ++x) {
        const auto i = static_cast<size_t>(y * depth.depth.width + x);
        const uint8_t cost = matched[view].cost[i];
        if (pictures[view].valid[i] == 0 || cost >= kUnseenMatch) continue;
        const float correlation = 1 - static_cast<float>(cost) / static_cast<float>(kDearestMatch);
        const float contrast = 1 / (windows.inverse_deviation[i] * noise);
        const Votes votes = check(view, x, y, static_cast<double>(depth.depth.values[i]), there, back);
        const float alike = ramp(correlation, kUnlikeCorrelation, kAlikeCorrelation);
        const float unique = ramp(matched[view].uniqueness[i], kAmbiguousBelow, kUniqueAbove);
        const float agreed = votes.agree == 0 ? 0.0F
                                              : static_cast<float>(votes.agree) /
                                                    static_cast<float>(votes.agree + votes.differ);
        const float textured = ramp(contrast, 0.5F * kLeastContrast, 1.5F * kLeastContrast);
        const float placed =
            ramp(static_cast<float>(votes.movement * finest_pixels), kLeastMovement, kEnoughMovement);
        const float confidence = std::min({alike, unique, agreed, textured, placed});
        depth.confidence.values[i] = confidence;
        depth.doubt[i] = confidence >= kConfidentStereo ? StereoDoubt::kNone
                         : textured == confidence       ? StereoDoubt::kUntextured
                         : alike == confidence          ? StereoDoubt::kUnlike
                         : placed == confidence         ? StereoDoubt::kFar
                         : unique == confidence         ? StereoDoubt::kAmbiguous
                                                        : StereoDoubt::kContradicted;
      }
    }
  }
  return result;
}

// Sums over windows of radius to each side, zeros outside.
void window_sums(int64_t width, int64_t height, int64_t radius, std::vector<double>& values) {
  const auto line = [radius](double* first, int64_t count, int64_t stride, std::vector<double>& sums) {
    sums.assign(static_cast<size_t>(count + 1), 0);
    for (int64_t i = 0; i < count; ++i)
      sums[static_cast<size_t>(i + 1)] = sums[static_cast<size_t>(i)] + first[i * stride];
    for (int64_t i = 0; i < count; ++i) {
      first[i * stride] = sums[static_cast<size_t>(std::min(i + radius + 1, count))] -
                          sums[static_cast<size_t>(std::max<int64_t>(i - radius, 0))];
    }
  };
  std::vector<double> sums;
  for (int64_t y = 0; y < height; ++y) line(values.data() + y * width, width, 1, sums);
  for (int64_t x = 0; x < width; ++x) line(values.data() + x, height, width, sums);
}

// The least (or most) of the values within radius, rows first.
template <class Choose>
std::vector<float> window_extremes(const PlanarDepth& depth, int64_t radius, const Choose& choose) {
  std::vector<float> along(depth.values.size()), result(depth.values.size());
  for (int64_t y = 0; y < depth.height; ++y) {
    for (int64_t x = 0; x < depth.width; ++x) {
      float value = depth.values[static_cast<size_t>(y * depth.width + x)];
      for (int64_t at = std::max<int64_t>(x - radius, 0); at <= std::min(x + radius, depth.width - 1); ++at)
        value = choose(value, depth.values[static_cast<size_t>(y * depth.width + at)]);
      along[static_cast<size_t>(y * depth.width + x)] = value;
    }
  }
  for (int64_t y = 0; y < depth.height; ++y) {
    for (int64_t x = 0; x < depth.width; ++x) {
      float value = along[static_cast<size_t>(y * depth.width + x)];
      for (int64_t at = std::max<int64_t>(y - radius, 0); at <= std::min(y + radius, depth.height - 1); ++at)
        value = choose(value, along[static_cast<size_t>(at * depth.width + x)]);
      result[static_cast<size_t>(y * depth.width + x)] = value;
    }
  }
  return result;
}

// A window that shows two surfaces gives the one's depth to pixels of the other, in all views alike, so that no other
// check sees it; and what is certain alone among what is not was matched by chance.
void doubt_edges_and_specks(StereoDepth& found, int64_t radius) {
  if (found.compared.empty()) return;
  const auto nearest = window_extremes(found.depth, radius, [](float a, float b) { return std::min(a, b); });
  const auto farthest = window_extremes(found.depth, radius, [](float a, float b) { return std::max(a, b); });
  std::vector<double> certain(found.confidence.values.size());
  for (size_t i = 0; i < certain.size(); ++i)
    certain[i] = found.confidence.values[i] >= kConfidentStereo ? 1 : 0;
  window_sums(found.depth.width, found.depth.height, radius, certain);
  const double fewest = kFewestCertain * static_cast<double>((2 * radius + 1) * (2 * radius + 1));
  for (size_t i = 0; i < certain.size(); ++i) {
    float& confidence = found.confidence.values[i];
    if (confidence < kConfidentStereo) continue;
    const float depth = found.depth.values[i];
    const bool edge = farthest[i] > kOneSurface * depth || kOneSurface * nearest[i] < depth;
    if (!edge && certain[i] >= fewest) continue;
    confidence = 0.5F * kConfidentStereo;
    found.doubt[i] = edge ? StereoDoubt::kEdge : StereoDoubt::kContradicted;
  }
}

// The prior at every pixel of the view's picture; 0 where not known.
std::vector<float> prior_at(const PicturedView& view, const StereoPicture& picture) {
  std::vector<float> result(static_cast<size_t>(picture.width * picture.height), 0.0F);
  if (view.depth.values.empty()) return {};
  const double columns = static_cast<double>(view.depth.width) / static_cast<double>(picture.width);
  const double rows = static_cast<double>(view.depth.height) / static_cast<double>(picture.height);
  for (int64_t y = 0; y < picture.height; ++y) {
    for (int64_t x = 0; x < picture.width; ++x) {
      result[static_cast<size_t>(y * picture.width + x)] =
          depth_between(view.depth, (static_cast<double>(x) + 0.5) * columns - 0.5,
                        (static_cast<double>(y) + 0.5) * rows - 0.5);
    }
  }
  return result;
}

// The middle of the shortest interval that holds half of the values, and the standard deviation of the normal
// distribution that has such an interval: up to a half of wrong matches does little to them.
struct ShortestHalf {
  double middle = 0;
  double deviation = 0;

  explicit ShortestHalf(std::vector<double>& values) {
    std::sort(values.begin(), values.end());
    const size_t half = values.size() / 2;
    double length = std::numeric_limits<double>::infinity();
    for (size_t first = 0; first + half < values.size(); ++first) {
      if (values[first + half] - values[first] >= length) continue;
      length = values[first + half] - values[first];
      middle = 0.5 * (values[first + half] + values[first]);
    }
    deviation = 0.5 * length / 0.6745;
  }
};

std::optional<PriorAgreement> agreement(const std::vector<StereoDepth>& found,
                                        const std::vector<std::vector<float>>& priors) {
  bool any = false;
  size_t asked = 0;
  std::vector<double> ratios, others;
  for (size_t view = 0; view < found.size(); ++view) {
    any = any || !priors[view].empty();
    asked += priors[view].size();
    for (size_t i = 0; i < priors[view].size(); ++i) {
      if (!PlanarDepth::known(priors[view][i]) || !PlanarDepth::known(found[view].depth.values[i])) continue;
      const double ratio =
          std::log(static_cast<double>(found[view].depth.values[i]) / static_cast<double>(priors[view][i]));
      (found[view].confidence.values[i] >= kConfidentStereo ? ratios : others).push_back(ratio);
    }
  }
  if (!any) return std::nullopt;
  PriorAgreement result;
  if (static_cast<double>(ratios.size()) < std::max(50.0, kHardlyAny * static_cast<double>(asked)))
    return result;
  result.pixels = static_cast<int64_t>(ratios.size());
  const ShortestHalf half(ratios);
  result.scale = std::exp(half.middle);
  result.spread = half.deviation;
  // The prior's own error is in that of the others too.
  if (others.size() > 2) {
    const double spread = 0.5 * (percentile(others, 0.84) - percentile(others, 0.16));
    result.uncertain = std::sqrt(std::max(0.0, spread * spread - result.spread * result.spread));
  }
  result.uncertain = std::max(result.uncertain, kLeastUncertain);
  return result;
}

// What the first pass is sure of, or nothing.
InverseDepths range_of_found(const StereoDepth& found) {
  std::vector<double> inverse;
  for (size_t i = 0; i < found.depth.values.size(); ++i) {
    if (found.confidence.values[i] >= kConfidentStereo)
      inverse.push_back(1 / static_cast<double>(found.depth.values[i]));
  }
  if (static_cast<double>(inverse.size()) <
      std::max(50.0, kHardlyAny * static_cast<double>(found.depth.values.size())))
    return {};
  return {percentile(inverse, 0.005) / kFoundMargin, percentile(inverse, 0.995) * kFoundMargin};
}

InverseDepths range_of_prior(const std::vector<float>& prior, double scale) {
  std::vector<double> inverse;
  for (const float depth : prior) {
    if (PlanarDepth::known(depth)) inverse.push_back(1 / (scale * static_cast<double>(depth)));
  }
  if (inverse.empty()) return {};
  return {percentile(inverse, 0.005) / kPriorMargin, percentile(inverse, 0.995) * kPriorMargin};
}

// Logarithm of photographs' depth over the prior as the confident pixels about each pixel say, wide windows first; it
// falls to 0 where there are none.
std::vector<double> local_correction(const StereoDepth& found, const std::vector<float>& log_prior,
                                     double spread) {
  const int64_t width = found.depth.width, height = found.depth.height;
  std::vector<double> correction(log_prior.size(), 0);
  for (const int64_t share : {4, 12, 36}) {
    std::vector<double> weights(log_prior.size(), 0), rest(log_prior.size(), 0);
    for (size_t i = 0; i < log_prior.size(); ++i) {
      if (found.confidence.values[i] < kConfidentStereo || !std::isfinite(log_prior[i])) continue;
      weights[i] = static_cast<double>(found.confidence.values[i]);
      const double off =
          std::log(static_cast<double>(found.depth.values[i])) - static_cast<double>(log_prior[i]);
      rest[i] =
          weights[i] * (std::clamp(off, -kMostOfSpread * spread, kMostOfSpread * spread) - correction[i]);
    }
    const int64_t radius = std::max<int64_t>(2, std::max(width, height) / share / 2);
    window_sums(width, height, radius, weights);
    window_sums(width, height, radius, rest);
    // As many confident pixels as a twentieth of the window count half.
    const double doubt = 0.05 * static_cast<double>((2 * radius + 1) * (2 * radius + 1));
    for (size_t i = 0; i < correction.size(); ++i) correction[i] += rest[i] / (weights[i] + doubt);
  }
  return correction;
}

// Each pixel's logarithm of depth as the mean of photographs and prior, by how far both are sure.
void put_prior_in(StereoDepth& found, const SweptView& swept, const PriorAgreement& agreement) {
  const double spread = std::max(agreement.spread, kLeastSpread);
  const double prior_variance = spread * spread;
  const std::vector<double> correction = local_correction(found, swept.prior.log_depth, spread);
  for (size_t i = 0; i < correction.size(); ++i) {
    const auto prior = static_cast<double>(swept.prior.log_depth[i]);
    if (!std::isfinite(prior)) continue;
    float& depth = found.depth.values[i];
    const double plane = 0.5 * swept.planes.step * static_cast<double>(depth);
    const auto confidence = static_cast<double>(found.confidence.values[i]);
    const double sure = plane * plane + 1e-6, unsure = agreement.uncertain * agreement.uncertain;
    // Between both by confidence, on a scale of logarithms.
    const double variance = std::exp(std::min(1.0, confidence / static_cast<double>(kConfidentStereo)) *
                                     std::log(sure / unsure)) *
                            unsure;
    const double other = prior + correction[i];
    const double off = std::log(static_cast<double>(depth)) - other;
    // Wrong matches are farther off than any prior of that spread is; those that are certain are believed longer.
    const double far =
        off / (spread * (confidence >= static_cast<double>(kConfidentStereo) ? kFarCertain : kFarUncertain));
    const double weight = prior_variance / (prior_variance + variance) / (1 + far * far * far * far);
    depth = static_cast<float>(std::exp(other + weight * off));
  }
}

std::vector<StereoPicture> pictures_of(const std::vector<PicturedView>& views, int64_t side, int64_t radius,
                                       int threads) {
  std::vector<StereoPicture> pictures(views.size());
#pragma omp parallel for num_threads(threads) schedule(dynamic)
  for (size_t view = 0; view < views.size(); ++view)
    pictures[view] = stereo_picture(views[view], side, radius);
  return pictures;
}

void check_views(const std::vector<PicturedView>& views) {
  for (size_t i = 0; i < views.size(); ++i) {
    const PicturedView& view = views[i];
    const auto values = static_cast<size_t>(std::max<int64_t>(0, 3 * view.width * view.height));
    if (view.width < 2 || view.height < 2 || view.rgb.size() != values) {
      fail({"stereo depth, view " + std::to_string(i), "a photograph of at least 2 x 2 pixels",
            std::to_string(view.rgb.size()) + " values for " + std::to_string(view.width) + " x " +
                std::to_string(view.height),
            "give only views that were photographed"});
    }
    if (view.depth.values.size() != static_cast<size_t>(view.depth.width * view.depth.height)) {
      fail({"stereo depth, view " + std::to_string(i),
            "prior depth of " + std::to_string(view.depth.width) + " x " + std::to_string(view.depth.height),
            std::to_string(view.depth.values.size()) + " values", "give all of it or none"});
    }
  }
}

// What the prior is where nothing else is known.
void take_prior(StereoDepth& result, const std::vector<float>& prior) {
  for (size_t i = 0; i < prior.size(); ++i) {
    result.depth.values[i] = PlanarDepth::known(prior[i]) ? prior[i] : 0.0F;
    result.confidence.values[i] = 0;
    if (result.doubt[i] == StereoDoubt::kNone) result.doubt[i] = StereoDoubt::kAmbiguous;
  }
}

}  // namespace

void StereoOptions::visit(FieldVisitor& visitor) {
  visitor.integer({"largest_side", "pixels: photographs are reduced to it"}, largest_side, {16, 8192});
  visitor.integer({"coarse_side", "pixels: of the first pass, which finds the range of depth"}, coarse_side,
                  {16, 8192});
  visitor.integer({"planes", "depths that are tried"}, planes, {8, 1024});
  visitor.integer({"window", "pixels a side of the windows that are correlated; odd"}, window,
                  {3, 2 * kMostWindowRadius + 1});
  visitor.integer({"photographs", "the most that each photograph is compared with"}, photographs,
                  {1, kMostSweptPhotographs});
  visitor.real({"small_step", "cost of one plane more than the pixel beside; correlation 0 costs 1"},
               small_step, {0, 1});
  visitor.real({"big_step", "cost of more planes, where both pixels are equally bright"}, big_step, {0, 1});
  visitor.integer({"memory_limit", "MiB for costs; less means fewer views at a time"}, memory_limit,
                  {1, 1 << 20});
}

void StereoOptions::check() const {
  if (window % 2 == 0) fail({"window", "an odd number of pixels", std::to_string(window), "use one more"});
  if (small_step > big_step) {
    fail({"small_step", "at most big_step", std::to_string(small_step), "lower it"});
  }
}

double StereoDepth::confident_share() const {
  if (confidence.values.empty()) return 0;
  const auto count = std::count_if(confidence.values.begin(), confidence.values.end(),
                                   [](float value) { return value >= kConfidentStereo; });
  return static_cast<double>(count) / static_cast<double>(confidence.values.size());
}

StereoScene stereo_depth(const std::vector<PicturedView>& views, const std::vector<Eigen::Vector3d>& points,
                         const StereoOptions& options, const KernelSettings& settings) {
  options.check();
  check_views(views);
  const int64_t radius = options.window / 2;
  const Baselines baselines(views);
  StereoScene scene;

  // First pass: all depths, no prior.
  const auto coarse =
      pictures_of(views, std::min(options.coarse_side, options.largest_side), radius, settings.threads);
  std::vector<SweptView> swept(views.size());
  std::vector<InverseDepths> wide(views.size());
  for (size_t view = 0; view < views.size(); ++view) {
    wide[view] = range_of_points(coarse[view], points);
    if (wide[view].empty()) wide[view] = range_of_visibility(view, coarse, baselines);
    if (wide[view].empty()) continue;
    swept[view].planes = planes_over(wide[view], options.planes);
    swept[view].compared = photographs_for(view, coarse, baselines, wide[view], options.photographs);
  }
  const auto fine = pictures_of(views, options.largest_side, radius, settings.threads);
  const double finest_pixels =
      views.empty() ? 1 : static_cast<double>(fine[0].width) / static_cast<double>(coarse[0].width);
  auto first =
      judged(coarse, swept, sweep_views(coarse, swept, options, settings), radius, finest_pixels, settings);
  for (StereoDepth& view : first) doubt_edges_and_specks(view, 1);
  std::vector<std::vector<float>> coarse_priors;
  for (size_t view = 0; view < views.size(); ++view)
    coarse_priors.push_back(prior_at(views[view], coarse[view]));
  scene.prior = agreement(first, coarse_priors);
  const bool prior_judged = scene.prior && scene.prior->pixels > 0;

  // Second pass: the depths that were found, with the prior.
  std::vector<std::vector<float>> priors;
  for (size_t view = 0; view < views.size(); ++view) {
    priors.push_back(prior_at(views[view], fine[view]));
    if (swept[view].compared.empty()) continue;
    InverseDepths range = range_of_found(first[view]);
    if (range.empty()) {
      range = wide[view];
    } else {
      range.least = std::max(range.least, wide[view].least);
    }
    if (prior_judged && !priors[view].empty() && scene.prior->spread < kUsablePrior) {
      const InverseDepths of_prior = range_of_prior(priors[view], scene.prior->scale);
      if (!of_prior.empty())
        range = {std::min(range.least, of_prior.least), std::max(range.most, of_prior.most)};
    }
    swept[view].planes = planes_over(range, options.planes);
    swept[view].compared = photographs_for(view, coarse, baselines, range, options.photographs);
    if (!prior_judged || priors[view].empty()) continue;
    ScaledPrior& prior = swept[view].prior;
    prior.log_depth.resize(priors[view].size());
    for (size_t i = 0; i < prior.log_depth.size(); ++i) {
      prior.log_depth[i] =
          PlanarDepth::known(priors[view][i])
              ? static_cast<float>(std::log(scene.prior->scale * static_cast<double>(priors[view][i])))
              : std::numeric_limits<float>::quiet_NaN();
    }
    const double spread = std::max(scene.prior->spread, kLeastSpread);
    const double believed =
        kCorrelationOfPrior * kDearestMatch / (1 + (spread / kGoodPrior) * (spread / kGoodPrior));
    prior.steepness = believed / (2 * spread * spread);
    prior.dearest = kMostOfPrior * believed;
  }
  scene.views = judged(fine, swept, sweep_views(fine, swept, options, settings), radius, 1, settings);
#pragma omp parallel for num_threads(settings.threads) schedule(dynamic)
  for (size_t view = 0; view < views.size(); ++view) {
    doubt_edges_and_specks(scene.views[view], radius);
    if (swept[view].prior.any()) {
      put_prior_in(scene.views[view], swept[view], *scene.prior);
    } else if (!priors[view].empty()) {
      take_prior(scene.views[view], priors[view]);
    }
  }
  return scene;
}

}  // namespace gld
