#pragma once

#include "datasets/registration/registration.h"

#include <cstdint>
#include <vector>

namespace gld {

struct FeatureRegistrationOptions {
  int64_t longest_side = 1600;   // pixels: larger photographs are searched at this size
  int64_t most_features = 4096;  // a photograph
  int64_t most_neighbours = 24;  // of many photographs, each is compared closely with this many
  int threads = 1;
};

// Finds cameras by SIFT features, essential matrices and bundle adjustment. Where EXIF names no focal length,
// registrations from several are compared. The same photographs give the same cameras every time. Throws Error where
// fewer than two register; where names the option in it.
Registration register_by_features(const std::vector<UnregisteredPhotograph>& photographs,
                                  const FeatureRegistrationOptions& options, const std::string& where);

}  // namespace gld
