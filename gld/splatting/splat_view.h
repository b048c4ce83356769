#pragma once

#include "gld/kernels/attention_kernel.h"
#include "gld/splatting/projection.h"

#include <cstdint>
#include <vector>

namespace gld {

// Sides of a tile in pixels.
constexpr int64_t kSplatTile = 16;

// log2(e) / 2: u^2 + v^2 of VisibleSplat over d^T S2^-1 d.
constexpr double kExponentUnit = 0.7213475204444817;

// A Gaussian that a view may show. alpha = 2^(height - u^2 - v^2) with u = along_x dx + along_y dy and v = across_y
// dy of d = pixel - mean: the Cholesky factor of S2^-1 times sqrt(kExponentUnit), so that a needle's exponent is a
// sum of squares and not a difference of large terms.
struct VisibleSplat {
  int32_t index;  // in the set
  float depth;
  double mean[2];  // pixels
  double along_x, along_y, across_y;
  double height;                                         // log2 of the opacity
  int32_t first_column, end_column, first_row, end_row;  // pixels that it may cover: alpha >= least_alpha
};

// Fetches a splat that is read soon, and lies anywhere.
inline void fetch(const VisibleSplat& splat) {
  const char* const begin = reinterpret_cast<const char*>(&splat);
  __builtin_prefetch(begin);
  __builtin_prefetch(begin + sizeof(VisibleSplat) - 1);
}
// So many are read before it.
constexpr int64_t kFetchedAhead = 6;

// What a view shows of a set: Gaussians front to back, those at one depth by index, and for each tile those that reach
// it, in the same order.
struct SplatView {
  SplatCamera camera;
  int64_t tile_columns = 0, tile_rows = 0;
  std::vector<VisibleSplat> splats;
  std::vector<int32_t> in_set_order;   // numbers of splats: what reads the set by it reads it in a row
  std::vector<int32_t> tile_first;     // (tiles + 1) into tile_splats
  std::vector<int32_t> tile_splats;    // numbers of splats
  std::vector<int32_t> splat_first;    // (splats + 1) into splat_entries
  std::vector<int32_t> splat_entries;  // where the Gaussian stands in tile_splats, tile by tile

  int64_t size() const { return static_cast<int64_t>(splats.size()); }
  int64_t tiles() const { return tile_columns * tile_rows; }
  // A tile's first column and row of pixels.
  int64_t tile_left(int64_t tile) const { return tile % tile_columns * kSplatTile; }
  int64_t tile_top(int64_t tile) const { return tile / tile_columns * kSplatTile; }
  // Returns in_set_order[place], while the one that is some places ahead is fetched.
  int64_t splat_in_order(int64_t place) const {
    if (place + kFetchedAhead < size())
      fetch(splats[static_cast<size_t>(in_set_order[static_cast<size_t>(place + kFetchedAhead)])]);
    return in_set_order[static_cast<size_t>(place)];
  }
};

// Projects, sorts and lists. The result does not depend on settings.threads.
SplatView view_of_splats(const GaussianSet& set, const SplatCamera& camera, const KernelSettings& settings);

// Returns the numbers of keys in rising order, equal ones in their own: a radix sort. Keys are positive and finite.
std::vector<int32_t> sorted_by_depth(const std::vector<float>& depths);

// Returns max(0, 1/2 + harmonics) of every splat of the view, (splats, 3).
std::vector<float> view_colours(const GaussianSet& set, const SplatView& view,
                                const KernelSettings& settings);

}  // namespace gld
