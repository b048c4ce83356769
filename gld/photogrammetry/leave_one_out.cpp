#include "gld/photogrammetry/leave_one_out.h"

#include "gld/cameras/resized_camera.h"
#include "gld/photogrammetry/matched_source_depth.h"
#include "gld/photogrammetry/photograph_composition.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <utility>

namespace gld {
namespace {

// Returns a picture's mean over blocks, row by row; blocks at the right and bottom end are left out where they are not
// whole.
std::vector<float> block_means(const std::vector<float>& values, int64_t width, int64_t height,
                               int64_t channels, int64_t block) {
  if (block == 1) return values;
  const int64_t columns = width / block, rows = height / block;
  std::vector<float> means(static_cast<size_t>(columns * rows * channels), 0.0F);
  const float share = 1 / static_cast<float>(block * block);
  for (int64_t y = 0; y < rows * block; ++y) {
    for (int64_t x = 0; x < columns * block; ++x) {
      for (int64_t c = 0; c < channels; ++c) {
        means[static_cast<size_t>(((y / block) * columns + x / block) * channels + c)] +=
            share * values[static_cast<size_t>((y * width + x) * channels + c)];
      }
    }
  }
  return means;
}

// Returns dB of colours from 0 to 1, over the pixels whose weight is at least a half; it is not a number where there
// are none.
double psnr_of(const std::vector<float>& truth, const std::vector<float>& made,
               const std::vector<float>& weights) {
  double sum = 0;
  int64_t pixels = 0;
  for (size_t pixel = 0; 3 * pixel < truth.size(); ++pixel) {
    if (!weights.empty() && weights[pixel] < 0.5F) continue;
    ++pixels;
    for (size_t c = 0; c < 3; ++c) {
      const double off = static_cast<double>(truth[3 * pixel + c] - made[3 * pixel + c]);
      sum += off * off / 3;
    }
  }
  if (pixels == 0) return std::numeric_limits<double>::quiet_NaN();
  // Two pictures of 8 bits that are equal but for their rounding.
  constexpr double kRounding = 1.0 / (255.0 * 255.0 * 12.0);
  return -10 * std::log10(std::max(sum / static_cast<double>(pixels), kRounding));
}

double moved_apart(const Camera& a, const Camera& b) {
  return (a.world_from_camera.translation() - b.world_from_camera.translation()).norm();
}

double turned_apart(const Camera& a, const Camera& b) {
  const double cosine = a.world_from_camera.linear().col(2).dot(b.world_from_camera.linear().col(2));
  return std::acos(std::clamp(cosine, -1.0, 1.0));
}

// Returns the others by how near they were taken: a turn by a radian counts as much as the distance to the farthest of
// them.
std::vector<size_t> nearest_others(const std::vector<PicturedView>& views, size_t view, int64_t most) {
  double farthest = 0;
  std::vector<std::pair<double, size_t>> ranked;
  for (const PicturedView& other : views)
    farthest = std::max(farthest, moved_apart(views[view].camera, other.camera));
  for (size_t other = 0; other < views.size(); ++other) {
    if (other == view) continue;
    const double apart = farthest > 0 ? moved_apart(views[view].camera, views[other].camera) / farthest : 0;
    ranked.emplace_back(apart + turned_apart(views[view].camera, views[other].camera), other);
  }
  std::sort(ranked.begin(), ranked.end());
  std::vector<size_t> others;
  for (size_t i = 0; i < ranked.size() && static_cast<int64_t>(i) < most; ++i)
    others.push_back(ranked[i].second);
  return others;
}

std::vector<PicturedView> chosen(const std::vector<PicturedView>& views, const std::vector<size_t>& numbers) {
  std::vector<PicturedView> result;
  result.reserve(numbers.size());
  for (const size_t number : numbers) result.push_back(views[number]);
  return result;
}

// The sources of one that is left out, with depth.
struct Carried {
  std::vector<PicturedView> sources;
  double reach = SourceDepth().reach;
  bool by_its_match = false;
};

// Takes depth of the others alone; where they do not tell any, as a single one, that which they have with the
// photograph that is left out; else what they came with.
Carried with_depth(const std::vector<PicturedView>& views, const std::vector<size_t>& others, size_t left_out,
                   const std::vector<Eigen::Vector3d>& points, const StereoOptions& options,
                   const KernelSettings& settings) {
  Carried carried{chosen(views, others)};
  std::vector<PicturedView> matched = carried.sources;
  for (const bool with_left_out : {false, true}) {
    if (with_left_out) matched.push_back(views[left_out]);
    const SourceDepth found = matched_source_depth(stereo_depth(matched, points, options, settings));
    if (!found.known()) continue;
    for (size_t i = 0; i < carried.sources.size(); ++i) carried.sources[i].depth = found.views[i];
    carried.reach = found.reach;
    carried.by_its_match = with_left_out;
    break;
  }
  return carried;
}

bool knows_depth(const PicturedView& source) { return !source.depth.values.empty(); }

// sources are with depth, or with none of which nothing can be said.
PhotographView predicted_view(std::vector<PicturedView> sources, double reach, const PicturedView& left_out) {
  sources.erase(std::remove_if(sources.begin(), sources.end(), std::not_fn(knows_depth)), sources.end());
  PhotographViewOptions options;
  options.carry.depth_reach = reach;
  const Camera camera = resized_camera(left_out.camera, left_out.width, left_out.height);
  return view_from_photographs(sources, exposure_gains(sources), camera, options);
}

LeftOutPhotograph compared(const std::vector<PicturedView>& views, size_t view, std::vector<size_t> from,
                           const PhotographView& predicted, int64_t block) {
  const auto reduced = [&](const std::vector<float>& rgb) {
    return block_means(rgb, predicted.width, predicted.height, 3, block);
  };
  std::vector<float> shown(predicted.variance.size());
  for (size_t pixel = 0; pixel < shown.size(); ++pixel) shown[pixel] = predicted.shown(pixel) ? 1.0F : 0.0F;
  const std::vector<float> truth = reduced(views[view].rgb);
  std::vector<float> mean(truth.size(), 0.0F);
  for (const size_t other : from) {
    const std::vector<float> picture = reduced(views[other].rgb);
    for (size_t i = 0; i < mean.size(); ++i) mean[i] += picture[i] / static_cast<float>(from.size());
  }
  LeftOutPhotograph result;
  result.view = view;
  result.covered = predicted.shown_share();
  const std::vector<float> made = reduced(filled(predicted));
  result.psnr = psnr_of(truth, made, {});
  result.psnr_covered = psnr_of(truth, made, block_means(shown, predicted.width, predicted.height, 1, block));
  result.psnr_nearest = psnr_of(truth, reduced(views[from.front()].rgb), {});
  result.psnr_mean = psnr_of(truth, mean, {});
  result.expected = -10 * std::log10(expected_variance(predicted, std::numeric_limits<double>::infinity()));
  result.from = std::move(from);
  return result;
}

}  // namespace

std::vector<LeftOutPhotograph> leave_one_out(const std::vector<PicturedView>& views,
                                             const std::vector<Eigen::Vector3d>& points,
                                             const LeaveOneOutOptions& options,
                                             const KernelSettings& settings) {
  std::vector<LeftOutPhotograph> result;
  if (views.size() < 2) return result;
  const auto count = std::min(views.size(), static_cast<size_t>(std::max<int64_t>(1, options.photographs)));
  for (size_t i = 0; i < count; ++i) {
    const size_t view = (2 * i + 1) * views.size() / (2 * count);
    std::vector<size_t> others = nearest_others(views, view, options.neighbours);
    Carried carried = with_depth(views, others, view, points, options.stereo, settings);
    const bool known = std::any_of(carried.sources.begin(), carried.sources.end(), knows_depth);
    const PhotographView predicted = predicted_view(std::move(carried.sources), carried.reach, views[view]);
    result.push_back(compared(views, view, std::move(others), predicted, options.block));
    result.back().by_its_match = carried.by_its_match;
    result.back().depth_known = known;
  }
  return result;
}

LeftOutPhotograph mean_of(const std::vector<LeftOutPhotograph>& left_out) {
  LeftOutPhotograph mean;
  double covered_ones = 0, psnr_covered = 0;
  const auto count = static_cast<double>(left_out.size());
  for (const LeftOutPhotograph& one : left_out) {
    mean.covered += one.covered / count;
    mean.depth_known = mean.depth_known || one.depth_known;
    mean.psnr += one.psnr / count;
    mean.psnr_nearest += one.psnr_nearest / count;
    mean.psnr_mean += one.psnr_mean / count;
    mean.expected += one.expected / count;
    if (std::isnan(one.psnr_covered)) continue;
    covered_ones += 1;
    psnr_covered += one.psnr_covered;
  }
  mean.psnr_covered = psnr_covered / covered_ones;
  return mean;
}

}  // namespace gld
