#include "datasets/registration/feature_registration.h"

#include "datasets/images/image_file.h"
#include "datasets/registration/incremental_registration.h"
#include "datasets/registration/matched_pairs.h"
#include "datasets/registration/picture_features.h"
#include "datasets/registration/registered_lenses.h"
#include "gld/base/interrupt.h"

#include <algorithm>
#include <cmath>
#include <map>

#include <fmt/format.h>
#include <opencv2/core/utility.hpp>

namespace gld {
namespace {

// Of lenses that nothing is known of: the middle of what cameras have, from wide to short telescope, and how far they
// scatter about it (of the logarithm).
constexpr double kUsualFocalLength = 0.95, kUsualSpread = 0.45;
// EXIF gives whole millimetres, and lenses lengthen when they focus near.
constexpr double kExifSpread = 0.06;
constexpr double kDistortionSpread = 0.05;
// Small pictures are sharp: places in them are known to a smaller part of a pixel.
constexpr double kFewestPixels = 1200;
// A search for a focal length begins at these.
constexpr double kFirstFocalLengths[] = {0.5, 0.75, 1.15, 1.75};
// Costs of registrations between which the photographs do not decide, and focal lengths that are not the same.
constexpr double kNearlyAsGood = 1.5, kOtherFocalLength = 1.15;
constexpr size_t kViewsOfSearch = 8;
constexpr size_t kObservationsOfSearch = 12000;

struct Problem {
  SeenPlaces seen;
  std::vector<double> exif_focal_lengths;  // one a lens; 0 where EXIF tells nothing
  bool searched = false;                   // a lens of which EXIF tells nothing
};

Problem problem_of(const std::vector<UnregisteredPhotograph>& photographs,
                   const std::vector<PictureFeatures>& pictures, const std::vector<Track>& tracks) {
  Problem problem;
  std::map<int64_t, size_t> lens_of;
  for (size_t i = 0; i < photographs.size(); ++i) {
    const auto [entry, is_new] = lens_of.try_emplace(photographs[i].lens, lens_of.size());
    if (is_new) {
      const double exif = exif_focal_length(photographs, photographs[i].lens);
      BundleLens lens;
      lens.focal_length = lens.expected_focal_length = exif > 0 ? exif : kUsualFocalLength;
      lens.focal_length_spread = exif > 0 ? kExifSpread : kUsualSpread;
      lens.k1_spread = kDistortionSpread;
      problem.searched = problem.searched || exif == 0;
      problem.seen.lenses.push_back(lens);
      problem.exif_focal_lengths.push_back(exif);
    }
    problem.seen.views.push_back({entry->second, std::max(kFewestPixels, pictures[i].searched_side)});
  }
  for (const Track& track : tracks) {
    std::vector<SeenPlace> seen;
    for (const Sighting& sighting : track) {
      seen.push_back(
          {sighting.picture, pictures[sighting.picture].points[static_cast<size_t>(sighting.feature)]});
    }
    problem.seen.tracks.push_back(std::move(seen));
  }
  return problem;
}

struct FocalLengthSearch {
  IncrementalResult best;
  std::string doubt;  // where other focal lengths explain the photographs nearly as well
};

// Finds the registration of a few views with the focal length that fits them best. Of distortion nothing is asked yet:
// it would stand in for a wrong focal length.
FocalLengthSearch search_focal_lengths(const Problem& problem) {
  struct Attempt {
    IncrementalResult result;
    double cost = 0;
    double focal_length = 0;  // of the first lens that is searched
  };
  const auto searched = static_cast<size_t>(
      std::find(problem.exif_focal_lengths.begin(), problem.exif_focal_lengths.end(), 0.0) -
      problem.exif_focal_lengths.begin());
  std::vector<Attempt> attempts;
  size_t best = 0;
  for (const double focal_length : kFirstFocalLengths) {
    SeenPlaces seen = problem.seen;
    for (size_t i = 0; i < seen.lenses.size(); ++i) {
      if (problem.exif_focal_lengths[i] == 0) seen.lenses[i].focal_length = focal_length;
      seen.lenses[i].k1_spread = 0;
    }
    IncrementalOptions options;
    options.most_views = kViewsOfSearch;
    options.most_observations = kObservationsOfSearch;
    Attempt attempt;
    attempt.result = register_incrementally(seen, options);
    attempt.cost = attempt.result.cost;
    attempt.focal_length = attempt.result.bundle.lenses[searched].focal_length;
    for (const BundleLens& lens : attempt.result.bundle.lenses) {
      const double off = std::log(lens.focal_length / lens.expected_focal_length) / lens.focal_length_spread;
      attempt.cost += 0.5 * off * off;
    }
    attempts.push_back(std::move(attempt));
    const Attempt &last = attempts.back(), &first = attempts[best];
    if (last.result.count() > first.result.count() ||
        (last.result.count() == first.result.count() && last.cost < first.cost)) {
      best = attempts.size() - 1;
    }
  }
  FocalLengthSearch found;
  for (const Attempt& other : attempts) {
    const double factor = other.focal_length / attempts[best].focal_length;
    if (other.result.count() < 2 || other.cost > kNearlyAsGood * attempts[best].cost ||
        std::abs(std::log(factor)) < std::log(kOtherFocalLength)) {
      continue;
    }
    found.doubt = fmt::format(
        "EXIF names no focal length, and {:.2f} of the longer side explains the photographs nearly as well as {:.2f}",
        other.focal_length, attempts[best].focal_length);
  }
  found.best = std::move(attempts[best].result);
  return found;
}

// Returns why a photograph has no part in the tracks at all; empty where it has.
std::string nothing_shared(size_t picture, const std::vector<PictureFeatures>& pictures,
                           const std::vector<MatchedPair>& pairs) {
  if (pictures[picture].size() < kFewestMatches) {
    return fmt::format("it shows too little to recognise ({} places with texture)", pictures[picture].size());
  }
  int64_t most_alike = 0;
  bool one_place = false;
  for (const MatchedPair& pair : pairs) {
    if (pair.first != picture && pair.second != picture) continue;
    if (!pair.matches.empty()) return "";
    one_place = one_place || pair.seen_from_one_place;
    most_alike = std::max(most_alike, pair.alike);
  }
  if (one_place) return "what it shares with others is seen from one place";
  return fmt::format(
      "it shows nothing that another one shows ({} of its {} features look like any of another's, and do not lie "
      "as there)",
      most_alike, pictures[picture].size());
}

Registration registration_of(const std::vector<UnregisteredPhotograph>& photographs,
                             const IncrementalResult& result) {
  Registration registration;
  registration.way = "features";
  registration.points_in_world = result.bundle.points_in_world;
  const size_t count = photographs.size();
  std::vector<double> square(count, 0), depths;
  std::vector<int64_t> shown(count, 0);
  double all = 0;
  for (const BundleObservation& observation : result.bundle.observations) {
    const BundleView& view = result.bundle.views[observation.view];
    const Eigen::Vector3d& point = result.bundle.points_in_world[observation.point];
    const double e =
        (projected(result.bundle.lenses[view.lens], view.camera_from_world, point) - observation.position)
            .norm() *
        photographs[observation.view].longer_side();
    square[observation.view] += e * e;
    all += e * e;
    ++shown[observation.view];
    depths.push_back((view.camera_from_world * point).z());
  }
  if (!result.bundle.observations.empty()) {
    registration.reprojection_error = std::sqrt(all / static_cast<double>(result.bundle.observations.size()));
  }
  for (size_t i = 0; i < count; ++i) {
    RegisteredPhotograph found;
    found.registered = result.registered[i] != 0;
    found.reason = result.reasons[i];
    if (found.registered) {
      const BundleView& view = result.bundle.views[i];
      const BundleLens& lens = result.bundle.lenses[view.lens];
      found.world_from_camera = view.camera_from_world.inverse();
      found.camera = lens_camera(photographs[i], lens.focal_length, lens.k1);
      found.points = shown[i];
      found.reprojection_error = std::sqrt(square[i] / static_cast<double>(std::max<int64_t>(1, shown[i])));
    }
    registration.photographs.push_back(std::move(found));
  }
  add_lenses(registration, photographs);
  normalise(registration, std::move(depths));
  return registration;
}

}  // namespace

Registration register_by_features(const std::vector<UnregisteredPhotograph>& photographs,
                                  const FeatureRegistrationOptions& options, const std::string& where) {
  cv::setNumThreads(options.threads);  // OpenCV's own, of SIFT, are as many as cores
  require_several(photographs, where);
  std::vector<PictureFeatures> pictures;
  for (const UnregisteredPhotograph& photograph : photographs) {
    stop_if_interrupted("while photographs were registered");
    // One at a time: as taken, they are much larger than what is kept of them.
    pictures.push_back(picture_features(read_image(photograph.file, ImageOrientation::kUpright),
                                        options.longest_side, options.most_features));
  }
  const auto wanted = pairs_to_match(pictures, static_cast<size_t>(options.most_neighbours), options.threads);
  std::vector<MatchedPair> pairs(wanted.size());
  // Nothing may be thrown out of the loop.
#pragma omp parallel for schedule(dynamic) num_threads(options.threads)
  for (size_t i = 0; i < wanted.size(); ++i) {
    if (!interrupt_requested()) pairs[i] = matched_pair(pictures, wanted[i].first, wanted[i].second);
  }
  stop_if_interrupted("while photographs were registered");
  const Problem problem = problem_of(photographs, pictures, joined_tracks(pictures, pairs));
  FocalLengthSearch few;
  IncrementalOptions all;
  if (problem.searched) {
    few = search_focal_lengths(problem);
    all.begin_with = &few.best;
  }
  IncrementalResult result = register_incrementally(problem.seen, all);
  for (size_t i = 0; i < photographs.size(); ++i) {
    if (result.registered[i] != 0) continue;
    const std::string reason = nothing_shared(i, pictures, pairs);
    if (!reason.empty()) result.reasons[i] = reason;
  }
  Registration registration = registration_of(photographs, result);
  require_registered(registration, photographs, where);
  add_doubts(registration);
  if (!few.doubt.empty()) registration.doubts.push_back(few.doubt);
  return registration;
}

}  // namespace gld
