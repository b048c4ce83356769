#include "gld/photogrammetry/plane_sweep_stereo.h"

#include "gld/base/error.h"
#include "gld/photogrammetry/match_judgement.h"
#include "gld/photogrammetry/plane_sweep.h"
#include "gld/photogrammetry/semi_global_matching.h"
#include "gld/photogrammetry/stereo_picture.h"
#include "gld/photogrammetry/stereo_prior.h"
#include "gld/photogrammetry/swept_views.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <string>

namespace gld {
namespace {

// Rows of a band of a sweep, which is one thread's: a window's rows are looked up twice at its ends.
constexpr int64_t kBandRows = 56;

// Does one pass over all views: everything but the check between views.
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
  int64_t most_bytes = 1;  // a byte a plane for the costs, two for the sums of paths
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

std::vector<StereoPicture> pictures_of(const std::vector<PicturedView>& views, int64_t side, int64_t radius,
                                       int threads) {
  std::vector<StereoPicture> pictures(views.size());
#pragma omp parallel for num_threads(threads) schedule(dynamic)
  for (size_t view = 0; view < views.size(); ++view)
    pictures[view] = stereo_picture(views[view], side, radius);
  return pictures;
}

// What is far was matched as surely as what is confident.
bool hardly_any_matched(const std::vector<StereoDepth>& views) {
  size_t matched = 0, of = 0;
  for (const StereoDepth& view : views) {
    matched += view.confident_pixels() + view.far_pixels();
    of += view.confidence.values.size();
  }
  return hardly_any(matched, of);
}

// Of all views.
struct FirstPass {
  std::vector<InverseDepths> ranges;
  std::vector<SweptView> swept;
  std::vector<StereoDepth> found;
};

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

size_t StereoDepth::confident_pixels() const {
  return static_cast<size_t>(std::count_if(confidence.values.begin(), confidence.values.end(),
                                           [](float value) { return value >= kConfidentStereo; }));
}

size_t StereoDepth::far_pixels() const {
  return static_cast<size_t>(
      std::count_if(least.values.begin(), least.values.end(), [](float value) { return value > 0; }));
}

double StereoScene::confident_share() const {
  double share = 0;
  for (const StereoDepth& view : views) share += view.confident_share() / static_cast<double>(views.size());
  return share;
}

double StereoDepth::confident_share() const {
  if (confidence.values.empty()) return 0;
  return static_cast<double>(confident_pixels()) / static_cast<double>(confidence.values.size());
}

StereoScene stereo_depth(const std::vector<PicturedView>& views, const std::vector<Eigen::Vector3d>& points,
                         const StereoOptions& options, const KernelSettings& settings) {
  options.check();
  check_views(views);
  const int64_t radius = options.window / 2;
  const Baselines baselines(views);
  StereoScene scene;

  // The first pass has all depths and no prior.
  const auto coarse =
      pictures_of(views, std::min(options.coarse_side, options.largest_side), radius, settings.threads);
  const auto fine = pictures_of(views, options.largest_side, radius, settings.threads);
  const double finest_pixels =
      views.empty() ? 1 : static_cast<double>(fine[0].width) / static_cast<double>(coarse[0].width);
  const auto first_pass = [&](const std::vector<InverseDepths>& ranges) {
    FirstPass pass;
    pass.ranges = ranges;
    pass.swept.resize(views.size());
    for (size_t view = 0; view < views.size(); ++view) {
      if (ranges[view].empty()) continue;
      pass.swept[view].planes = planes_over(ranges[view], options.planes);
      pass.swept[view].compared = photographs_for(view, coarse, baselines, ranges[view], options.photographs);
    }
    pass.found = judged_matches(coarse, pass.swept, sweep_views(coarse, pass.swept, options, settings),
                                radius, finest_pixels, settings);
    for (StereoDepth& view : pass.found) doubt_edges_and_specks(view, 1);
    return pass;
  };
  std::vector<InverseDepths> ranges(views.size()), to_infinity(views.size());
  bool points_end_somewhere = false;
  for (size_t view = 0; view < views.size(); ++view) {
    const PointRange of_points = range_of_points(coarse[view], points);
    ranges[view] = of_points.depths;
    if (ranges[view].empty()) ranges[view] = range_of_visibility(view, coarse, baselines);
    to_infinity[view] = of_points.all_over ? ranges[view] : InverseDepths{0, ranges[view].most};
    points_end_somewhere = points_end_somewhere || (!of_points.depths.empty() && !of_points.all_over);
  }
  // No point lies in the sky: where points are not all over, what is there may be beyond all of them.
  FirstPass pass;
  if (points_end_somewhere) pass = first_pass(to_infinity);
  if (std::none_of(pass.found.begin(), pass.found.end(), shows_something_far)) pass = first_pass(ranges);
  const std::vector<StereoDepth>& first = pass.found;
  std::vector<SweptView>& swept = pass.swept;
  std::vector<std::vector<float>> coarse_priors;
  for (size_t view = 0; view < views.size(); ++view)
    coarse_priors.push_back(prior_at(views[view], coarse[view]));
  scene.prior = prior_agreement(first, coarse_priors);
  const bool prior_judged = scene.prior && scene.prior->pixels > 0;

  // The second pass has the depths that were found, with the prior.
  std::vector<std::vector<float>> priors;
  for (size_t view = 0; view < views.size(); ++view) {
    priors.push_back(prior_at(views[view], fine[view]));
    if (swept[view].compared.empty()) continue;
    InverseDepths range = range_of_found(first[view]);
    if (range.empty()) {
      range = pass.ranges[view];
    } else if (range.least > 0) {
      range.least = std::max(range.least, pass.ranges[view].least);
    }
    if (prior_judged && !priors[view].empty() && widens_range(*scene.prior)) {
      const InverseDepths of_prior = range_of_prior(priors[view], scene.prior->scale);
      if (!of_prior.empty())
        range = {std::min(range.least, of_prior.least), std::max(range.most, of_prior.most)};
    }
    swept[view].planes = planes_over(range, options.planes);
    // What a wide prior adds to the range may lie where no other photograph looks.
    auto compared = photographs_for(view, coarse, baselines, range, options.photographs);
    if (!compared.empty()) swept[view].compared = std::move(compared);
    if (!prior_judged || priors[view].empty()) continue;
    swept[view].prior = scaled_prior(priors[view], *scene.prior);
  }
  scene.views = judged_matches(fine, swept, sweep_views(fine, swept, options, settings), radius, 1, settings);
#pragma omp parallel for num_threads(settings.threads) schedule(dynamic)
  for (size_t view = 0; view < views.size(); ++view) doubt_edges_and_specks(scene.views[view], radius);
  // What agreed by chance does not agree again: then the unit that the first pass told is none either.
  const bool prior_holds = prior_judged && !hardly_any_matched(scene.views);
  if (prior_judged && !prior_holds) scene.prior = PriorAgreement();
  // A view that no other one overlaps has the unit of all priors too.
  const double prior_scale = prior_holds ? scene.prior->scale : 1;
#pragma omp parallel for num_threads(settings.threads) schedule(dynamic)
  for (size_t view = 0; view < views.size(); ++view) {
    if (prior_holds && swept[view].prior.any()) {
      put_prior_in(scene.views[view], swept[view], *scene.prior);
    } else if (!priors[view].empty()) {
      take_prior(scene.views[view], priors[view], prior_scale);
    }
  }
  return scene;
}

}  // namespace gld
