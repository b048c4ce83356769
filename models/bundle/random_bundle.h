#pragma once

#include "gld/files/dtype.h"
#include "models/bundle/bundle.h"

#include <cstdint>
#include <filesystem>

namespace gld {

// Writes a bundle with random weights: for tests, benchmarks and for trying the program without trained weights. Unlike
// with the modules' own initialisation no layer is zero, so every part changes the result. Tensors are written one at a
// time; each depends on the seed, its part and its name alone.
void write_random_bundle(const std::filesystem::path& folder, const BundleOptions& options, uint64_t seed,
                         DType dtype = DType::kFloat32);

// Returns a model that runs in seconds on one core; its layout is that of DA3-Base and its DiTs.
BundleOptions small_bundle_options();

}  // namespace gld
