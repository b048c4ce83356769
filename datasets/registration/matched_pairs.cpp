#include "datasets/registration/matched_pairs.h"

#include "gld/cameras/nearest_rotation.h"

#include <algorithm>
#include <numeric>
#include <set>
#include <utility>

#include <Eigen/Core>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>

namespace gld {
namespace {

constexpr double kEpipolarError = 2;            // pixels of the searched pictures
constexpr double kSmallestFittingShare = 0.25;  // of features that look alike
constexpr int kTrials = 10000;
constexpr int64_t kStrongest = 512;  // features by which many pictures are compared first

PictureFeatures strongest(const PictureFeatures& picture) {
  PictureFeatures few;
  const auto count = static_cast<size_t>(std::min(picture.size(), kStrongest));
  few.points.assign(picture.points.begin(), picture.points.begin() + static_cast<std::ptrdiff_t>(count));
  const size_t length = picture.points.empty() ? 0 : picture.descriptors.size() / picture.points.size();
  few.descriptors.assign(picture.descriptors.begin(),
                         picture.descriptors.begin() + static_cast<std::ptrdiff_t>(count * length));
  few.searched_side = picture.searched_side;
  return few;
}

// Returns directions of features, columns of length 1, for a lens of that focal length over the longer side.
Eigen::Matrix3Xd directions(const PictureFeatures& picture, const std::vector<int32_t>& features,
                            double focal_length) {
  Eigen::Matrix3Xd rays(3, static_cast<Eigen::Index>(features.size()));
  for (size_t i = 0; i < features.size(); ++i) {
    const Eigen::Vector2d& point = picture.points[static_cast<size_t>(features[i])];
    rays.col(static_cast<Eigen::Index>(i)) = Eigen::Vector3d(point.x(), point.y(), focal_length).normalized();
  }
  return rays;
}

// Returns how many of the matches one rotation explains within that angle, radians: the best rotation of all of them
// (Kabsch), and again of those that lie nearest to it, so that up to a half of wrong matches does little.
int64_t explained_by_turning(const Eigen::Matrix3Xd& first, const Eigen::Matrix3Xd& second, double angle) {
  const Eigen::Index count = first.cols();
  Eigen::VectorXd weights = Eigen::VectorXd::Ones(count);
  Eigen::VectorXd off(count);
  constexpr int kRounds = 8;
  for (int round = 0; round < kRounds; ++round) {
    const Eigen::Matrix3d turned = nearest_rotation(second * weights.asDiagonal() * first.transpose());
    off = (turned * first - second).colwise().norm();
    std::vector<double> sorted(off.data(), off.data() + count);
    const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
    std::nth_element(sorted.begin(), middle, sorted.end());
    const double near = std::max(*middle, angle);
    weights = (off.array() <= 1.5 * near).cast<double>();
  }
  return (off.array() <= angle).count();
}

// Returns whether a turned camera explains as many of the matches, within a share, as `rigid`, with some usual lens.
bool only_turned(const PictureFeatures& first, const PictureFeatures& second,
                 const std::vector<FeatureMatch>& matches, int64_t rigid) {
  constexpr double kAsWell = 0.9, kPixels = 1.5;
  std::vector<int32_t> of_first, of_second;
  for (const FeatureMatch& match : matches) {
    of_first.push_back(match.first);
    of_second.push_back(match.second);
  }
  const double pixels = std::max(first.searched_side, second.searched_side);
  for (const double focal_length : {0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.35, 1.5, 1.75, 2.0, 2.5, 3.0}) {
    const int64_t explained =
        explained_by_turning(directions(first, of_first, focal_length),
                             directions(second, of_second, focal_length), kPixels / (pixels * focal_length));
    if (explained >= kFewestMatches && static_cast<double>(explained) >= kAsWell * static_cast<double>(rigid))
      return true;
  }
  return false;
}

// Which features are one place.
class Joined {
 public:
  explicit Joined(size_t count) : parent_(count) { std::iota(parent_.begin(), parent_.end(), size_t{0}); }
  size_t root(size_t i) {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }
  void join(size_t a, size_t b) { parent_[std::max(root(a), root(b))] = std::min(root(a), root(b)); }

 private:
  std::vector<size_t> parent_;
};

}  // namespace

MatchedPair matched_pair(const std::vector<PictureFeatures>& pictures, size_t first, size_t second) {
  MatchedPair pair;
  pair.first = first;
  pair.second = second;
  const auto alike = match_features(pictures[first], pictures[second], 1);
  pair.alike = static_cast<int64_t>(alike.size());
  if (pair.alike < kFewestMatches) return pair;
  const double pixels = std::max(pictures[first].searched_side, pictures[second].searched_side);
  std::vector<cv::Point2d> places[2];
  for (const FeatureMatch& match : alike) {
    const Eigen::Vector2d a = pixels * pictures[first].points[static_cast<size_t>(match.first)];
    const Eigen::Vector2d b = pixels * pictures[second].points[static_cast<size_t>(match.second)];
    places[0].emplace_back(a.x(), a.y());
    places[1].emplace_back(b.x(), b.y());
  }
  cv::Mat fits;
  // Its generator begins at one state every time.
  const cv::Mat fundamental =
      cv::findFundamentalMat(places[0], places[1], cv::USAC_MAGSAC, kEpipolarError, 0.9999, kTrials, fits);
  // Of one and the same picture there is none, or any.
  const bool any = !fundamental.empty() && fits.total() == alike.size();
  for (size_t i = 0; i < alike.size() && any; ++i) {
    if (fits.at<uchar>(static_cast<int>(i)) != 0) pair.matches.push_back(alike[i]);
  }
  const auto found = static_cast<int64_t>(pair.matches.size());
  const auto most =
      std::max(found, static_cast<int64_t>(kSmallestFittingShare * static_cast<double>(pair.alike)));
  if (only_turned(pictures[first], pictures[second], alike, most)) {
    pair.seen_from_one_place = true;
    pair.matches.clear();
    return pair;
  }
  if (found < kFewestMatches ||
      static_cast<double>(found) < kSmallestFittingShare * static_cast<double>(pair.alike)) {
    pair.matches.clear();
  }
  return pair;
}

std::vector<std::pair<size_t, size_t>> pairs_to_match(const std::vector<PictureFeatures>& pictures,
                                                      size_t most_neighbours, int threads) {
  const size_t count = pictures.size();
  std::set<std::pair<size_t, size_t>> chosen;
  if (count <= most_neighbours + 1) {
    for (size_t i = 0; i < count; ++i) {
      for (size_t j = i + 1; j < count; ++j) chosen.emplace(i, j);
    }
    return {chosen.begin(), chosen.end()};
  }
  std::vector<PictureFeatures> few;
  few.reserve(count);
  for (const PictureFeatures& picture : pictures) few.push_back(strongest(picture));
  std::vector<std::vector<std::pair<int64_t, size_t>>> neighbours(count);  // (minus matches, picture)
  for (size_t i = 0; i < count; ++i) {
    for (size_t j = i + 1; j < count; ++j) {
      const auto matches = static_cast<int64_t>(match_features(few[i], few[j], threads).size());
      neighbours[i].emplace_back(-matches, j);
      neighbours[j].emplace_back(-matches, i);
    }
  }
  for (size_t i = 0; i < count; ++i) {
    std::sort(neighbours[i].begin(), neighbours[i].end());
    for (size_t n = 0; n < most_neighbours; ++n) {
      const size_t j = neighbours[i][n].second;
      chosen.emplace(std::min(i, j), std::max(i, j));
    }
  }
  return {chosen.begin(), chosen.end()};
}

std::vector<Track> joined_tracks(const std::vector<PictureFeatures>& pictures,
                                 const std::vector<MatchedPair>& pairs) {
  std::vector<size_t> first_of;
  size_t features = 0;
  for (const PictureFeatures& picture : pictures) {
    first_of.push_back(features);
    features += picture.points.size();
  }
  Joined joined(features);
  for (const MatchedPair& pair : pairs) {
    for (const FeatureMatch& match : pair.matches) {
      joined.join(first_of[pair.first] + static_cast<size_t>(match.first),
                  first_of[pair.second] + static_cast<size_t>(match.second));
    }
  }
  std::vector<Track> by_root(features);
  for (size_t picture = 0; picture < pictures.size(); ++picture) {
    for (size_t i = 0; i < pictures[picture].points.size(); ++i) {
      by_root[joined.root(first_of[picture] + i)].push_back({picture, static_cast<int32_t>(i)});
    }
  }
  std::vector<Track> tracks;
  for (Track& track : by_root) {
    if (track.size() < 2) continue;
    // Sightings are in the order of pictures, so that two of one picture stand side by side.
    const bool twice =
        std::adjacent_find(track.begin(), track.end(), [](const Sighting& a, const Sighting& b) {
          return a.picture == b.picture;
        }) != track.end();
    if (!twice) tracks.push_back(std::move(track));
  }
  return tracks;
}

}  // namespace gld
