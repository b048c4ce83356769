#include "datasets/registration/incremental_registration.h"

#include "gld/base/interrupt.h"
#include "gld/cameras/angles.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <optional>

#include <Eigen/Dense>
#include <fmt/format.h>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>

namespace gld {
namespace {

constexpr double kTooFar = 4;  // pixels: what lies further from where a point is seen shows something else
constexpr double kTooFarAtLast = 2.5;
// Degrees between two rays to a point, for its depth to be known: some four pixels of a wide lens.
constexpr double kSmallestAngle = 0.75;
constexpr double kWideAngle = 6;            // more than this makes no better first pair
constexpr size_t kTriedPairs = 30;          // for the first
constexpr size_t kMostForPair = 1500;       // matches of an essential matrix
constexpr size_t kFewestPoints = 20;        // of a first pair, and for a further view
constexpr double kEssentialError = 2;       // pixels, of matches with an essential matrix
constexpr double kSmallestPairShare = 0.2;  // of matches, whose depth a first pair must tell
constexpr double kSmallestShare = 0.3;    // of the known points that a further view must show where they are
constexpr size_t kSightingsForPoint = 8;  // of a track, of which each pair is tried
constexpr int kIterations = 25, kLastIterations = 60;

struct Point {
  size_t track = 0;
  Eigen::Vector3d in_world = Eigen::Vector3d::Zero();
  std::vector<SeenPlace> seen;  // where it lies as seen, in registered views
};

struct ViewPair {
  size_t first = 0, second = 0;
  std::vector<size_t> tracks;
};

Eigen::Vector2d undistorted(const BundleLens& lens, const Eigen::Vector2d& position) {
  const Eigen::Vector2d distorted = position / lens.focal_length;
  Eigen::Vector2d p = distorted;
  for (int i = 0; i < 8; ++i) p = distorted / std::max(0.2, 1 + lens.k1 * p.squaredNorm());
  return p;
}

double cosine(double degrees) { return std::cos(degrees / kDegreesPerRadian); }

cv::Point2d to_cv(const Eigen::Vector2d& p) { return {p.x(), p.y()}; }

double median_of(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

class Incremental {
 public:
  Incremental(const SeenPlaces& seen, const IncrementalOptions& options);
  IncrementalResult run();

 private:
  const SeenPlace* sighting(size_t track, size_t view) const;
  Eigen::Vector2d ideal(const SeenPlace& seen) const {
    return undistorted(lenses_[seen_.views[seen.view].lens], seen.position);
  }
  double error(const SeenPlace& seen,
               const Eigen::Vector3d& point) const;  // pixels; infinite behind the camera
  std::optional<Point> triangulated(size_t track, double too_far, double smallest_angle) const;
  double cost_of(size_t track) const;
  void continue_from(const IncrementalResult& earlier);
  std::vector<Point> triangulate(double too_far) const;
  double widest_angle(const Point& point) const;  // degrees
  bool begin();
  std::optional<std::vector<Point>> try_pair(const ViewPair& pair,
                                             Eigen::Isometry3d& second_from_first) const;
  bool add_view();
  bool locate(size_t view, const std::vector<std::pair<SeenPlace, Eigen::Vector3d>>& known);
  void adjust_all(std::vector<Point>& points, size_t most_observations, int iterations);
  IncrementalResult finish();

  const SeenPlaces& seen_;
  const IncrementalOptions& options_;
  std::vector<BundleLens> lenses_;
  std::vector<uint8_t> lens_known_;  // by a registered view, or beforehand
  std::vector<Eigen::Isometry3d> camera_from_world_;
  std::vector<uint8_t> registered_;
  std::vector<std::string> reasons_;
  std::vector<size_t> refused_at_;  // known points with which a view did not register
  std::vector<std::vector<size_t>> tracks_of_view_;
  size_t first_ = 0, second_ = 0;  // of the first pair: at the origin, and a unit away from it
};

Incremental::Incremental(const SeenPlaces& seen, const IncrementalOptions& options)
    : seen_(seen),
      options_(options),
      lenses_(seen.lenses),
      lens_known_(seen.lenses.size(), 0),
      camera_from_world_(seen.views.size(), Eigen::Isometry3d::Identity()),
      registered_(seen.views.size(), 0),
      reasons_(seen.views.size()),
      refused_at_(seen.views.size(), 0),
      tracks_of_view_(seen.views.size()) {
  for (size_t track = 0; track < seen.tracks.size(); ++track) {
    for (const SeenPlace& place : seen.tracks[track]) tracks_of_view_[place.view].push_back(track);
  }
}

const SeenPlace* Incremental::sighting(size_t track, size_t view) const {
  for (const SeenPlace& place : seen_.tracks[track]) {
    if (place.view == view) return &place;
  }
  return nullptr;
}

double Incremental::error(const SeenPlace& seen, const Eigen::Vector3d& point) const {
  const Eigen::Isometry3d& camera_from_world = camera_from_world_[seen.view];
  if ((camera_from_world * point).z() <= 0) return std::numeric_limits<double>::infinity();
  const auto& view = seen_.views[seen.view];
  return (projected(lenses_[view.lens], camera_from_world, point) - seen.position).norm() * view.pixels;
}

double Incremental::widest_angle(const Point& point) const {
  std::vector<Eigen::Vector3d> rays;
  for (const SeenPlace& place : point.seen) {
    rays.push_back((camera_from_world_[place.view].inverse().translation() - point.in_world).normalized());
  }
  double smallest_cosine = 1;
  for (size_t i = 0; i < rays.size(); ++i) {
    for (size_t j = i + 1; j < rays.size(); ++j)
      smallest_cosine = std::min(smallest_cosine, rays[i].dot(rays[j]));
  }
  return std::acos(std::clamp(smallest_cosine, -1.0, 1.0)) * kDegreesPerRadian;
}

// Returns the point that most sightings agree on, of those that two of them make; then the least squares of these.
std::optional<Point> Incremental::triangulated(size_t track, double too_far, double smallest_angle) const {
  struct Ray {
    const SeenPlace* seen;
    Eigen::Vector2d ideal;
    Eigen::Vector3d origin, direction;
  };
  std::vector<Ray> rays;
  for (const SeenPlace& place : seen_.tracks[track]) {
    if (registered_[place.view] == 0) continue;
    const Eigen::Isometry3d world_from_camera = camera_from_world_[place.view].inverse();
    const Eigen::Vector2d p = ideal(place);
    rays.push_back({&place, p, world_from_camera.translation(),
                    (world_from_camera.linear() * p.homogeneous()).normalized()});
  }
  Point best;
  best.track = track;
  double best_error = 0;
  const size_t tried = std::min(rays.size(), kSightingsForPoint);
  for (size_t i = 0; i < tried; ++i) {
    for (size_t j = i + 1; j < tried; ++j) {
      const double along = rays[i].direction.dot(rays[j].direction);
      if (along > cosine(smallest_angle)) continue;
      // The middle between the rays where they come closest.
      const Eigen::Vector3d between = rays[j].origin - rays[i].origin;
      const double across = 1 - along * along;
      const double s = (between.dot(rays[i].direction) - along * between.dot(rays[j].direction)) / across;
      const double t = (along * between.dot(rays[i].direction) - between.dot(rays[j].direction)) / across;
      if (s <= 0 || t <= 0) continue;
      Point point;
      point.track = track;
      point.in_world =
          0.5 * (rays[i].origin + s * rays[i].direction + rays[j].origin + t * rays[j].direction);
      double sum = 0;
      for (const Ray& ray : rays) {
        const double e = error(*ray.seen, point.in_world);
        if (e > too_far) continue;
        point.seen.push_back(*ray.seen);
        sum += e;
      }
      if (point.seen.size() < 2) continue;
      if (point.seen.size() > best.seen.size() ||
          (point.seen.size() == best.seen.size() && sum < best_error)) {
        best = point;
        best_error = sum;
      }
    }
  }
  if (best.seen.size() < 2) return std::nullopt;
  // Two steps of Gauss and Newton on where ideal lenses see it.
  for (int step = 0; step < 2; ++step) {
    Eigen::Matrix3d square = Eigen::Matrix3d::Zero();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    for (const SeenPlace& place : best.seen) {
      const Eigen::Isometry3d& camera = camera_from_world_[place.view];
      const Eigen::Vector3d p = camera * best.in_world;
      if (p.z() <= 0) return std::nullopt;
      Eigen::Matrix<double, 2, 3> slope;
      slope << 1 / p.z(), 0, -p.x() / (p.z() * p.z()), 0, 1 / p.z(), -p.y() / (p.z() * p.z());
      slope = slope * camera.linear();
      const auto& view = seen_.views[place.view];
      slope *= lenses_[view.lens].focal_length * view.pixels;
      const Eigen::Vector2d residual =
          (ideal(place) - p.hnormalized()) * lenses_[view.lens].focal_length * view.pixels;
      square += slope.transpose() * slope;
      right += slope.transpose() * residual;
    }
    const Eigen::Vector3d moved = best.in_world + square.ldlt().solve(right);
    if (!moved.allFinite()) break;
    best.in_world = moved;
  }
  const auto gone = std::remove_if(best.seen.begin(), best.seen.end(), [&](const SeenPlace& place) {
    return error(place, best.in_world) > too_far;
  });
  best.seen.erase(gone, best.seen.end());
  if (best.seen.size() < 2 || widest_angle(best) < smallest_angle) return std::nullopt;
  return best;
}

// It takes what explains the track best, a point or a direction without depth: what hardly moves between the views fits
// too.
double Incremental::cost_of(size_t track) const {
  constexpr double kNearlyParallel = 0.05;  // degrees
  constexpr double kFarAway = 1e4;          // distances of the first two views
  const auto sum = [&](const Eigen::Vector3d& point) {
    double cost = 0;
    for (const SeenPlace& place : seen_.tracks[track]) {
      const double e = registered_[place.view] == 0 ? kTooFar : std::min(kTooFar, error(place, point));
      cost += e * e;
    }
    return cost;
  };
  double least = kTooFar * kTooFar * static_cast<double>(seen_.tracks[track].size());
  if (const auto point = triangulated(track, kTooFar, kNearlyParallel))
    least = std::min(least, sum(point->in_world));
  for (const SeenPlace& place : seen_.tracks[track]) {
    if (registered_[place.view] == 0) continue;
    least = std::min(least,
                     sum(camera_from_world_[place.view].inverse() * (kFarAway * ideal(place).homogeneous())));
  }
  return least;
}

std::vector<Point> Incremental::triangulate(double too_far) const {
  std::vector<Point> points;
  for (size_t track = 0; track < seen_.tracks.size(); ++track) {
    if (auto point = triangulated(track, too_far, kSmallestAngle)) points.push_back(std::move(*point));
  }
  return points;
}

// Writes lenses, cameras and points back. Of more observations than wanted it takes those of the longest tracks.
void Incremental::adjust_all(std::vector<Point>& points, size_t most_observations, int iterations) {
  std::vector<size_t> order(points.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](size_t a, size_t b) { return points[a].seen.size() > points[b].seen.size(); });
  // Those of two views alone tie only these; each view gets its share of them all the same, since tracks are in no
  // order of views.
  size_t observations = 0, taken = 0;
  while (taken < order.size() && observations < most_observations)
    observations += points[order[taken++]].seen.size();
  Bundle bundle;
  bundle.lenses = lenses_;
  for (size_t i = 0; i < seen_.views.size(); ++i) {
    BundleView view;
    view.camera_from_world = camera_from_world_[i];
    view.lens = seen_.views[i].lens;
    view.pixels = seen_.views[i].pixels;
    if (i == first_) view.freedom = BundleFreedom::kFixed;
    if (i == second_) view.freedom = BundleFreedom::kUnit;
    bundle.views.push_back(view);
  }
  for (size_t n = 0; n < taken; ++n) {
    const Point& point = points[order[n]];
    bundle.points_in_world.push_back(point.in_world);
    for (const SeenPlace& place : point.seen) bundle.observations.push_back({place.view, n, place.position});
  }
  adjust(bundle, iterations);
  lenses_ = bundle.lenses;
  for (size_t i = 0; i < seen_.views.size(); ++i) {
    if (registered_[i] != 0) camera_from_world_[i] = bundle.views[i].camera_from_world;
  }
  for (size_t n = 0; n < taken; ++n) points[order[n]].in_world = bundle.points_in_world[n];
}

// Returns the points of two views alone, the first one's camera at the origin; nothing where no essential matrix fits.
std::optional<std::vector<Point>> Incremental::try_pair(const ViewPair& pair,
                                                        Eigen::Isometry3d& second_from_first) const {
  std::vector<cv::Point2d> first, second;
  for (const size_t track : pair.tracks) {
    if (first.size() == kMostForPair) break;
    first.push_back(to_cv(ideal(*sighting(track, pair.first))));
    second.push_back(to_cv(ideal(*sighting(track, pair.second))));
  }
  const auto scale = [&](size_t view) {
    return lenses_[seen_.views[view].lens].focal_length * seen_.views[view].pixels;
  };
  const cv::Mat identity = cv::Mat::eye(3, 3, CV_64F);
  const double threshold = kEssentialError / std::sqrt(scale(pair.first) * scale(pair.second));
  cv::Mat fits, rotation, translation;
  const cv::Mat essential =
      cv::findEssentialMat(first, second, identity, cv::RANSAC, 0.9999, threshold, 1000, fits);
  if (essential.rows != 3) return std::nullopt;
  constexpr double kFurthest = 1e4;  // baselines
  cv::recoverPose(essential, first, second, identity, rotation, translation, kFurthest, fits);
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) second_from_first.linear()(i, j) = rotation.at<double>(i, j);
    second_from_first.translation()(i) = translation.at<double>(i);
  }
  Incremental two(*this);
  two.registered_.assign(seen_.views.size(), 0);
  two.registered_[pair.first] = two.registered_[pair.second] = 1;
  two.camera_from_world_[pair.first] = Eigen::Isometry3d::Identity();
  two.camera_from_world_[pair.second] = second_from_first;
  std::vector<Point> points;
  for (const size_t track : pair.tracks) {
    if (auto point = two.triangulated(track, kTooFar, kSmallestAngle)) points.push_back(std::move(*point));
  }
  return points;
}

bool Incremental::begin() {
  std::vector<ViewPair> pairs;
  const size_t count = seen_.views.size();
  std::vector<size_t> place(count * count, count * count);
  for (size_t track = 0; track < seen_.tracks.size(); ++track) {
    const auto& seen = seen_.tracks[track];
    for (size_t i = 0; i < seen.size(); ++i) {
      for (size_t j = i + 1; j < seen.size(); ++j) {
        size_t& at = place[seen[i].view * count + seen[j].view];
        if (at == count * count) {
          at = pairs.size();
          pairs.push_back({seen[i].view, seen[j].view, {}});
        }
        pairs[at].tracks.push_back(track);
      }
    }
  }
  std::stable_sort(pairs.begin(), pairs.end(),
                   [](const ViewPair& a, const ViewPair& b) { return a.tracks.size() > b.tracks.size(); });
  double best_score = 0;
  size_t best = 0, most_shared = 0, most_with_angle = 0;
  Eigen::Isometry3d best_pose = Eigen::Isometry3d::Identity();
  for (size_t i = 0; i < std::min(pairs.size(), kTriedPairs); ++i) {
    stop_if_interrupted("while photographs were registered");
    most_shared = std::max(most_shared, pairs[i].tracks.size());
    if (pairs[i].tracks.size() < kFewestPoints) break;
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    const auto points = try_pair(pairs[i], pose);
    if (!points) continue;
    most_with_angle = std::max(most_with_angle, points->size());
    // Where few of the matches have a depth, the camera was turned and hardly moved.
    if (points->size() < kFewestPoints ||
        static_cast<double>(points->size()) <
            kSmallestPairShare * static_cast<double>(pairs[i].tracks.size())) {
      continue;
    }
    Incremental two(*this);
    two.camera_from_world_[pairs[i].first] = Eigen::Isometry3d::Identity();
    two.camera_from_world_[pairs[i].second] = pose;
    std::vector<double> angles;
    for (const Point& point : *points) angles.push_back(two.widest_angle(point));
    const double score = static_cast<double>(points->size()) * std::min(1.0, median_of(angles) / kWideAngle);
    if (score <= best_score) continue;
    best_score = score;
    best = i;
    best_pose = pose;
  }
  if (best_score == 0) {
    const std::string reason =
        most_shared < kFewestPoints
            ? "it shares too little with any other"
            : fmt::format("what it shares with others is seen from one place ({} of {} places have a depth)",
                          most_with_angle, most_shared);
    std::fill(reasons_.begin(), reasons_.end(), reason);
    return false;
  }
  const ViewPair& pair = pairs[best];
  registered_[pair.first] = registered_[pair.second] = 1;
  camera_from_world_[pair.second] = best_pose;
  first_ = pair.first;
  second_ = pair.second;
  lens_known_[seen_.views[pair.first].lens] = lens_known_[seen_.views[pair.second].lens] = 1;
  // The lens may be far from what it began as: what was too far at first is looked at again.
  for (int round = 0; round < 3; ++round) {
    auto points = triangulate(kTooFar);
    if (points.size() < kFewestPoints) {
      std::fill(registered_.begin(), registered_.end(), uint8_t{0});
      std::fill(reasons_.begin(), reasons_.end(), "what it shares with others is seen from one place");
      return false;
    }
    adjust_all(points, options_.most_observations / 10, kIterations);
  }
  return true;
}

// Finds the camera of a view by points that are known, for several focal lengths where its lens is new.
bool Incremental::locate(size_t view, const std::vector<std::pair<SeenPlace, Eigen::Vector3d>>& known) {
  BundleLens& lens = lenses_[seen_.views[view].lens];
  const BundleLens as_it_was = lens;
  std::vector<double> focal_lengths{lens.focal_length};
  if (lens_known_[seen_.views[view].lens] == 0 && lens.focal_length_spread > 0.2) {
    for (double factor = 0.5; factor < 2.6; factor *= 1.25)
      focal_lengths.push_back(lens.focal_length * factor);
  }
  std::vector<cv::Point3d> points;
  points.reserve(known.size());
  for (const auto& [place, point] : known) points.emplace_back(point.x(), point.y(), point.z());
  std::vector<int> best;
  double best_focal_length = 0;
  for (const double focal_length : focal_lengths) {
    lens.focal_length = focal_length;
    std::vector<cv::Point2d> positions;
    positions.reserve(known.size());
    for (const auto& [place, point] : known) positions.push_back(to_cv(ideal(place)));
    cv::Mat rotation, translation;
    std::vector<int> fits;
    const auto threshold = static_cast<float>(2 * kTooFar / (focal_length * seen_.views[view].pixels));
    const bool solved =
        cv::solvePnPRansac(points, positions, cv::Mat::eye(3, 3, CV_64F), cv::noArray(), rotation,
                           translation, false, 1000, threshold, 0.9999, fits, cv::SOLVEPNP_AP3P);
    if (!solved || fits.size() <= best.size()) continue;
    cv::Mat matrix;
    cv::Rodrigues(rotation, matrix);
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) pose.linear()(i, j) = matrix.at<double>(i, j);
      pose.translation()(i) = translation.at<double>(i);
    }
    if (!pose.matrix().allFinite()) continue;
    best = fits;
    best_focal_length = focal_length;
    camera_from_world_[view] = pose;
  }
  const double needed =
      std::max(static_cast<double>(kFewestPoints), kSmallestShare * static_cast<double>(known.size()));
  if (static_cast<double>(best.size()) < needed) {
    lens = as_it_was;
    refused_at_[view] = known.size();
    reasons_[view] = fmt::format("only {} of the {} known points in it lie where one camera sees them",
                                 best.size(), known.size());
    return false;
  }
  lens.focal_length = best_focal_length;
  Bundle alone;
  alone.lenses = {lens};
  if (lens_known_[seen_.views[view].lens] != 0)
    alone.lenses[0].focal_length_spread = alone.lenses[0].k1_spread = 0;
  BundleView moved;
  moved.camera_from_world = camera_from_world_[view];
  moved.pixels = seen_.views[view].pixels;
  alone.views = {moved};
  for (const int i : best) {
    const auto& [place, point] = known[static_cast<size_t>(i)];
    if ((moved.camera_from_world * point).z() <= 0) continue;
    alone.points_in_world.push_back(point);
    alone.observations.push_back({0, alone.points_in_world.size() - 1, place.position});
  }
  if (alone.observations.size() < kFewestPoints) {
    lens = as_it_was;
    refused_at_[view] = known.size();
    reasons_[view] = "the known points in it lie behind its camera";
    return false;
  }
  adjust(alone, kIterations, BundlePoints::kFixed);
  lens.focal_length = alone.lenses[0].focal_length;
  lens.k1 = alone.lenses[0].k1;
  camera_from_world_[view] = alone.views[0].camera_from_world;
  return true;
}

// Adds the view that shows most known points. Returns false where none can be added.
bool Incremental::add_view() {
  const auto points = triangulate(kTooFar);
  std::vector<const Point*> point_of(seen_.tracks.size(), nullptr);
  for (const Point& point : points) point_of[point.track] = &point;
  struct Candidate {
    size_t view;
    std::vector<std::pair<SeenPlace, Eigen::Vector3d>> known;
  };
  std::vector<Candidate> candidates;
  for (size_t view = 0; view < seen_.views.size(); ++view) {
    if (registered_[view] != 0) continue;
    Candidate candidate{view, {}};
    for (const size_t track : tracks_of_view_[view]) {
      if (point_of[track] != nullptr)
        candidate.known.emplace_back(*sighting(track, view), point_of[track]->in_world);
    }
    if (candidate.known.size() < kFewestPoints) {
      reasons_[view] = candidate.known.empty()
                           ? "it shows nothing that the registered ones show"
                           : fmt::format("it shows only {} of the known points", candidate.known.size());
      continue;
    }
    // With hardly more points than last time the answer is the same.
    if (candidate.known.size() * 5 <= refused_at_[view] * 6) continue;
    candidates.push_back(std::move(candidate));
  }
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const Candidate& a, const Candidate& b) { return a.known.size() > b.known.size(); });
  for (const Candidate& candidate : candidates) {
    stop_if_interrupted("while photographs were registered");
    if (!locate(candidate.view, candidate.known)) continue;
    registered_[candidate.view] = 1;
    reasons_[candidate.view].clear();
    lens_known_[seen_.views[candidate.view].lens] = 1;
    auto all = triangulate(kTooFar);
    adjust_all(all, options_.most_observations / 10, kIterations);
    return true;
  }
  return false;
}

IncrementalResult Incremental::finish() {
  IncrementalResult result;
  std::vector<Point> points;
  // Once with all that fit loosely, then with what fits closely; a view that is left with too little goes.
  for (const double too_far : {kTooFar, kTooFarAtLast}) {
    while (true) {
      points = triangulate(too_far);
      std::vector<size_t> shown(seen_.views.size(), 0);
      for (const Point& point : points) {
        for (const SeenPlace& place : point.seen) ++shown[place.view];
      }
      bool left = false;
      for (size_t view = 0; view < seen_.views.size(); ++view) {
        if (registered_[view] == 0 || shown[view] >= kFewestPoints) continue;
        registered_[view] = 0;
        reasons_[view] = fmt::format("only {} points in it fit in the end", shown[view]);
        left = true;
      }
      if (!left) break;
    }
    if (!points.empty()) adjust_all(points, options_.most_observations, kLastIterations);
  }
  result.registered = registered_;
  result.reasons = reasons_;
  result.bundle.lenses = lenses_;
  for (size_t i = 0; i < seen_.views.size(); ++i) {
    result.bundle.views.push_back(
        {camera_from_world_[i], seen_.views[i].lens, seen_.views[i].pixels, BundleFreedom::kFree});
  }
  for (const Point& point : points) {
    const size_t number = result.bundle.points_in_world.size();
    size_t kept = 0;
    for (const SeenPlace& place : point.seen) {
      if (error(place, point.in_world) > kTooFarAtLast) continue;
      ++kept;
      result.bundle.observations.push_back({place.view, number, place.position});
    }
    if (kept < 2) {
      result.bundle.observations.resize(result.bundle.observations.size() - kept);
    } else {
      result.bundle.points_in_world.push_back(point.in_world);
    }
  }
  for (size_t track = 0; track < seen_.tracks.size(); ++track) result.cost += cost_of(track);
  result.first = first_;
  result.second = second_;
  return result;
}

void Incremental::continue_from(const IncrementalResult& earlier) {
  registered_ = earlier.registered;
  first_ = earlier.first;
  second_ = earlier.second;
  for (size_t i = 0; i < seen_.lenses.size(); ++i) {
    lenses_[i].focal_length = earlier.bundle.lenses[i].focal_length;
    lenses_[i].k1 = earlier.bundle.lenses[i].k1;
  }
  for (size_t i = 0; i < seen_.views.size(); ++i) {
    camera_from_world_[i] = earlier.bundle.views[i].camera_from_world;
    if (registered_[i] != 0) lens_known_[seen_.views[i].lens] = 1;
  }
}

IncrementalResult Incremental::run() {
  if (options_.begin_with != nullptr && options_.begin_with->count() >= 2)
    continue_from(*options_.begin_with);
  size_t count = static_cast<size_t>(std::count(registered_.begin(), registered_.end(), uint8_t{1}));
  if (count >= 2 || begin()) {
    count = std::max<size_t>(count, 2);
    while ((options_.most_views == 0 || count < options_.most_views) && add_view()) ++count;
  }
  return finish();
}

}  // namespace

size_t IncrementalResult::count() const {
  return static_cast<size_t>(std::count(registered.begin(), registered.end(), uint8_t{1}));
}

IncrementalResult register_incrementally(const SeenPlaces& seen, const IncrementalOptions& options) {
  return Incremental(seen, options).run();
}

}  // namespace gld
