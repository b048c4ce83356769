#pragma once

#include "datasets/registration/bundle_adjustment.h"

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace gld {

// Where a place lies in a view: from the picture's middle, over its longer side.
struct SeenPlace {
  size_t view = 0;
  Eigen::Vector2d position = Eigen::Vector2d::Zero();
};

// What registration is asked: views, each with its lens and the longer side in whose pixels errors count, and places
// that several of them show (some of them mistaken).
struct SeenPlaces {
  struct View {
    size_t lens = 0;
    double pixels = 1;
  };
  std::vector<BundleLens> lenses;  // focal_length and k1: what to begin with
  std::vector<View> views;
  std::vector<std::vector<SeenPlace>> tracks;
};

struct IncrementalResult {
  std::vector<uint8_t> registered;   // one a view
  std::vector<std::string> reasons;  // why not, as phrases; empty where registered
  // Views that did not register have no observation. Points and observations are those that fit.
  Bundle bundle;
  size_t first = 0, second = 0;  // the pair that it began with
  // Sum over all sightings of the least of the squared error and the square of what is too far, pixels: so that
  // registrations of the same places, begun with other lenses, can be compared.
  double cost = 0;

  size_t count() const;
};

struct IncrementalOptions {
  size_t most_views = 0;             // stops there; 0 for none
  size_t most_observations = 60000;  // of the last adjustment; the others have a tenth
  const IncrementalResult* begin_with =
      nullptr;  // of the same places: its registered views stay, others are added
};

// Begins with the pair of views that share most under a wide enough angle (essential matrix, 5 points), adds the views
// one by one that show most known points (3 points, RANSAC), and adjusts the bundle after each. It is deterministic.
IncrementalResult register_incrementally(const SeenPlaces& seen, const IncrementalOptions& options);

}  // namespace gld
