#pragma once

#include "datasets/splats/splat_fit.h"

#include <cstdint>
#include <string>

namespace gld {

// What a fit of Gaussians works on.
struct SplatWork {
  int64_t views = 0;
  int64_t held_out = 0;                           // views that are kept for comparison
  int64_t width = 0, height = 0;                  // of a picture
  int64_t gaussians = 0;                          // at most
  SplatStartFrom start = SplatStartFrom::kDepth;  // what it begins on
};
// Returns a Gaussian a pixel and view, under the cap; as many as the cap where some are added.
int64_t most_gaussians_of(const SplatWork& work, const SplatFitOptions& options);

// Returns the bytes of pictures, surface points, parameters with their moments and gradients, and lists of a view,
// where Gaussians are as small as pixels.
int64_t splat_fit_bytes(const SplatWork& work, const SplatFitOptions& options);

// Splatting's speed has little to do with that of matrix products: some steps of a fit of this size are run, on a wavy
// wall with random colours, in some tenths of a second. Returns the seconds of the whole fit, start included.
double splat_fit_seconds(const SplatWork& work, const SplatFitOptions& options, int threads);

// Throws Error, of `where`, if a fit needs more than the memory that is free (gld/machine's available_memory_bytes();
// 0: the system does not tell).
void require_memory_for_fit(const SplatWork& work, const SplatFitOptions& options, int64_t free_bytes,
                            const std::string& where);

}  // namespace gld
