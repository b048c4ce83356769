#include "gld/photogrammetry/match_judgement.h"

#include "gld/photogrammetry/depth_between.h"
#include "gld/photogrammetry/percentile.h"
#include "gld/photogrammetry/window_sums.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/Core>

namespace gld {
namespace {

// Confidence is 0 at the first value and full at the second.
constexpr float kUnlikeCorrelation = 0.4F, kAlikeCorrelation = 0.75F;
constexpr float kAmbiguousBelow = 0.01F, kUniqueAbove = 0.06F;
// Movement in another photograph, in pixels, for 1 % of depth: matches are right to a sixth of a pixel or so.
constexpr float kLeastMovement = 0.02F, kEnoughMovement = 0.12F;
// What is far has at least the depth at which it lies so many pixels from where it was matched, by its movement there.
constexpr double kFarPixels = 1;
// It lies beyond so many of the depths that are certain: about the point that the camera moves to, near things move as
// little.
constexpr double kNearShare = 0.98;
// Share of the pixels about one that are certain too.
constexpr double kFewestCertain = 0.3;
constexpr float kLeastContrast = 2;  // of a window, in kBrightnessNoise
// Depths of two views agree within a pixel, and within this many planes or this share of inverse depth.
constexpr double kAgreePixels = 1.0;
constexpr double kAgreePlanes = 2.0;
constexpr double kAgreeShare = 0.02;

float ramp(float value, float from, float to) { return std::clamp((value - from) / (to - from), 0.0F, 1.0F); }

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
      if (!lies_inside(place, pictures_[other])) continue;
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

// Returns the least (or most) of the values within radius, rows first.
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

// Forgets what is far where that is no farther than what is certain, or where nothing is certain to compare with.
void forget_what_is_not_beyond(StereoDepth& found) {
  std::vector<double> certain;
  for (size_t i = 0; i < found.depth.values.size(); ++i) {
    if (found.confidence.values[i] >= kConfidentStereo)
      certain.push_back(static_cast<double>(found.depth.values[i]));
  }
  const double beyond =
      certain.empty() ? std::numeric_limits<double>::infinity() : percentile(certain, kNearShare);
  for (float& least : found.least.values) {
    if (static_cast<double>(least) <= beyond) least = 0;
  }
}

}  // namespace

std::vector<StereoDepth> judged_matches(const std::vector<StereoPicture>& pictures,
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
    depth.least = {width, height, std::vector<float>(pixels, 0.0F)};
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
        const double movement = votes.movement * finest_pixels;
        const float placed = ramp(static_cast<float>(movement), kLeastMovement, kEnoughMovement);
        const float matched_at_all = std::min({alike, unique, agreed, textured});
        const float confidence = std::min(matched_at_all, placed);
        if (placed < kConfidentStereo && matched_at_all >= kConfidentStereo && movement > 0) {
          // A hundredth of the inverse depth moves it by so many pixels.
          const double nearer = 1 + 0.01 * kFarPixels / movement;
          depth.least.values[i] = static_cast<float>(static_cast<double>(depth.depth.values[i]) / nearer);
        }
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

void doubt_edges_and_specks(StereoDepth& found, int64_t radius) {
  if (found.compared.empty()) return;
  const auto nearest = window_extremes(found.depth, radius, [](float a, float b) { return std::min(a, b); });
  // What is far is no surface before what is far beside it, whatever depth was matched; all else is, sure or not.
  forget_what_is_not_beyond(found);
  PlanarDepth not_far = found.depth;
  for (size_t i = 0; i < not_far.values.size(); ++i) {
    if (found.least.values[i] > 0) not_far.values[i] = std::numeric_limits<float>::infinity();
  }
  const auto nearest_of_these =
      window_extremes(not_far, radius, [](float a, float b) { return std::min(a, b); });
  const auto farthest = window_extremes(found.depth, radius, [](float a, float b) { return std::max(a, b); });
  std::vector<double> certain(found.confidence.values.size());
  for (size_t i = 0; i < certain.size(); ++i)
    certain[i] = found.confidence.values[i] >= kConfidentStereo || found.least.values[i] > 0 ? 1 : 0;
  window_sums(found.depth.width, found.depth.height, radius, certain);
  const double fewest = kFewestCertain * static_cast<double>((2 * radius + 1) * (2 * radius + 1));
  for (size_t i = 0; i < certain.size(); ++i) {
    float& confidence = found.confidence.values[i];
    float& least = found.least.values[i];
    if (confidence < kConfidentStereo && least == 0) continue;
    const float depth = found.depth.values[i];
    const bool edge = least > 0 ? kOneSurface * nearest_of_these[i] < least
                                : farthest[i] > kOneSurface * depth || kOneSurface * nearest[i] < depth;
    if (!edge && certain[i] >= fewest) continue;
    least = 0;
    if (confidence < kConfidentStereo) continue;
    confidence = 0.5F * kConfidentStereo;
    found.doubt[i] = edge ? StereoDoubt::kEdge : StereoDoubt::kContradicted;
  }
  if (!shows_something_far(found)) std::fill(found.least.values.begin(), found.least.values.end(), 0.0F);
}

}  // namespace gld
