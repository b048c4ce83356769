#include "gld/splatting/splat_view.h"

#include "gld/base/error.h"
#include "gld/kernels/kernel_table.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <string>

namespace gld {
namespace {

constexpr int64_t kChunk = 512;  // Gaussians that a thread takes at a time

// Finds the pixels whose middles lie within reach of mean, cut to the picture; both ends are in [0, side].
void covered_pixels(double mean, double reach, int64_t side, int32_t& first, int32_t& end) {
  const double limit = static_cast<double>(side);
  first = static_cast<int32_t>(std::clamp(std::ceil(mean - reach - 0.5), 0.0, limit));
  end = static_cast<int32_t>(std::clamp(std::floor(mean + reach - 0.5) + 1, 0.0, limit));
}

bool visible_splat(const GaussianSet& set, int64_t i, const SplatCamera& camera, VisibleSplat& splat) {
  ProjectedGaussian projected;
  if (!project_gaussian(gaussian_shape(set, i), camera, projected)) return false;
  const double height = std::log2(projected.opacity);
  // alpha >= least_alpha up to q = d^T S2^-1 d = 2 ln(opacity / least_alpha).
  const double q = (height - static_cast<double>(camera.least_alpha_power)) / kExponentUnit;
  const double xx = projected.covariance[0], xy = projected.covariance[1], yy = projected.covariance[2];
  covered_pixels(projected.mean[0], std::sqrt(std::max(0.0, q) * xx), camera.width, splat.first_column,
                 splat.end_column);
  covered_pixels(projected.mean[1], std::sqrt(std::max(0.0, q) * yy), camera.height, splat.first_row,
                 splat.end_row);
  if (splat.first_column >= splat.end_column || splat.first_row >= splat.end_row) return false;
  const double unit = std::sqrt(kExponentUnit), root = std::sqrt(yy / projected.determinant);
  splat.index = static_cast<int32_t>(i);
  splat.depth = static_cast<float>(projected.x_in_camera[2]);
  if (!(splat.depth > 0) || !(splat.depth <= std::numeric_limits<float>::max())) return false;
  splat.mean[0] = projected.mean[0];
  splat.mean[1] = projected.mean[1];
  splat.along_x = unit * root;
  splat.along_y = -unit * root * xy / yy;
  splat.across_y = unit / std::sqrt(yy);
  splat.height = height;
  return true;
}

struct TileRect {
  int64_t first_column, end_column, first_row, end_row;
  int64_t count() const { return (end_column - first_column) * (end_row - first_row); }
};

TileRect tiles_of(const VisibleSplat& splat) {
  return {splat.first_column / kSplatTile, (splat.end_column - 1) / kSplatTile + 1,
          splat.first_row / kSplatTile, (splat.end_row - 1) / kSplatTile + 1};
}

void list_tiles(SplatView& view) {
  int64_t pairs = 0;
  for (const VisibleSplat& splat : view.splats) pairs += tiles_of(splat).count();
  if (pairs > std::numeric_limits<int32_t>::max()) {
    fail({"the Gaussians of a view", "at most 2^31 - 1 pairs of a Gaussian and a tile that it covers",
          std::to_string(pairs), "make the picture smaller, or look at the scales of the Gaussians"});
  }
  const auto tiles = static_cast<size_t>(view.tiles());
  view.tile_first.assign(tiles + 1, 0);
  view.splat_first.assign(1, 0);
  view.splat_first.reserve(view.splats.size() + 1);
  for (const VisibleSplat& splat : view.splats) {
    const TileRect rect = tiles_of(splat);
    view.splat_first.push_back(view.splat_first.back() + static_cast<int32_t>(rect.count()));
    for (int64_t row = rect.first_row; row < rect.end_row; ++row) {
      for (int64_t column = rect.first_column; column < rect.end_column; ++column)
        ++view.tile_first[static_cast<size_t>(row * view.tile_columns + column) + 1];
    }
  }
  for (size_t tile = 0; tile < tiles; ++tile) view.tile_first[tile + 1] += view.tile_first[tile];
  std::vector<int32_t> next(view.tile_first.begin(), view.tile_first.end() - 1);
  const auto entries = static_cast<size_t>(view.splat_first.back());
  view.tile_splats.resize(entries);
  view.splat_entries.resize(entries);
  size_t entry = 0;
  for (size_t i = 0; i < view.splats.size(); ++i) {
    const TileRect rect = tiles_of(view.splats[i]);
    for (int64_t row = rect.first_row; row < rect.end_row; ++row) {
      for (int64_t column = rect.first_column; column < rect.end_column; ++column) {
        const int32_t place = next[static_cast<size_t>(row * view.tile_columns + column)]++;
        view.tile_splats[static_cast<size_t>(place)] = static_cast<int32_t>(i);
        view.splat_entries[entry++] = place;
      }
    }
  }
}

}  // namespace

std::vector<int32_t> sorted_by_depth(const std::vector<float>& depths) {
  constexpr int kBits = 11;
  constexpr size_t kBuckets = size_t{1} << kBits;
  struct Keyed {
    uint32_t key;  // a positive float's bits have its order
    int32_t number;
  };
  std::vector<Keyed> from(depths.size()), to(depths.size());
  std::array<std::vector<uint32_t>, 3> counts;
  for (auto& count : counts) count.assign(kBuckets, 0);
  for (size_t i = 0; i < depths.size(); ++i) {
    std::memcpy(&from[i].key, &depths[i], sizeof(uint32_t));
    from[i].number = static_cast<int32_t>(i);
    for (int pass = 0; pass < 3; ++pass)
      ++counts[static_cast<size_t>(pass)][(from[i].key >> (kBits * pass)) % kBuckets];
  }
  for (int pass = 0; pass < 3; ++pass) {
    auto& count = counts[static_cast<size_t>(pass)];
    uint32_t sum = 0;
    for (uint32_t& bucket : count) {
      const uint32_t here = bucket;
      bucket = sum;
      sum += here;
    }
    for (const Keyed& one : from) to[count[(one.key >> (kBits * pass)) % kBuckets]++] = one;
    from.swap(to);
  }
  std::vector<int32_t> order(depths.size());
  for (size_t i = 0; i < order.size(); ++i) order[i] = from[i].number;
  return order;
}

SplatView view_of_splats(const GaussianSet& set, const SplatCamera& camera, const KernelSettings& settings) {
  SplatView view;
  view.camera = camera;
  view.tile_columns = (camera.width + kSplatTile - 1) / kSplatTile;
  view.tile_rows = (camera.height + kSplatTile - 1) / kSplatTile;
  const int64_t chunks = (set.size() + kChunk - 1) / kChunk;
  std::vector<std::vector<VisibleSplat>> found(static_cast<size_t>(chunks));
#pragma omp parallel for num_threads(settings.threads) schedule(dynamic)
  for (int64_t chunk = 0; chunk < chunks; ++chunk) {
    auto& here = found[static_cast<size_t>(chunk)];
    here.reserve(kChunk);
    VisibleSplat splat;
    for (int64_t i = chunk * kChunk; i < std::min((chunk + 1) * kChunk, set.size()); ++i) {
      if (visible_splat(set, i, camera, splat)) here.push_back(splat);
    }
  }
  std::vector<VisibleSplat> all;
  std::vector<float> depths;
  for (const auto& here : found) {
    all.insert(all.end(), here.begin(), here.end());
    for (const VisibleSplat& splat : here) depths.push_back(splat.depth);
  }
  view.splats.reserve(all.size());
  view.in_set_order.resize(all.size());
  for (const int32_t i : sorted_by_depth(depths)) {
    view.in_set_order[static_cast<size_t>(i)] = static_cast<int32_t>(view.splats.size());
    view.splats.push_back(all[static_cast<size_t>(i)]);
  }
  list_tiles(view);
  return view;
}

std::vector<float> view_colours(const GaussianSet& set, const SplatView& view,
                                const KernelSettings& settings) {
  std::vector<float> colours(view.splats.size() * 3);
#pragma omp parallel for num_threads(settings.threads) schedule(static)
  for (int64_t place = 0; place < view.size(); ++place) {
    const int64_t i = view.splat_in_order(place), index = view.splats[static_cast<size_t>(i)].index;
    Eigen::Vector3d mean;
    for (int k = 0; k < 3; ++k) mean[k] = set.means[static_cast<size_t>(3 * index + k)];
    SeenColour colour;
    seen_colour(set, index, mean + view.camera.offset, colour);
    for (int c = 0; c < 3; ++c) colours[static_cast<size_t>(3 * i + c)] = static_cast<float>(colour.rgb[c]);
  }
  return colours;
}

}  // namespace gld
