#include "gld/splatting/compositing.h"

#include "gld/base/error.h"
#include "gld/kernels/kernel_table.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

namespace gld {
namespace {

// What a thread needs for a tile.
struct TileScratch {
  RecordScratch listed;
  TileRecords records;
  std::vector<float> alpha, weight, scratch, record_weight, slope;
};

struct Tile {
  const SplatView* view;
  ListedTile listed;

  int64_t left() const { return view->tile_left(listed.number); }
  int64_t top() const { return view->tile_top(listed.number); }
  int64_t strips_a_row() const { return kSplatTile / listed.strip; }
  int64_t strips() const { return kSplatTile * strips_a_row(); }
};

struct Strip {
  int64_t first, count;  // in the tile's lists
  int64_t pixel;         // offset in a plane
  bool inside;           // its row is one of the picture
};

Strip strip_of_tile(const Tile& tile, const TileRecords& records, int64_t number) {
  const int64_t y = tile.top() + number / tile.strips_a_row();
  const int64_t first = records.strip_first[static_cast<size_t>(number)];
  return {first, records.strip_first[static_cast<size_t>(number) + 1] - first,
          y * tile.listed.stride + tile.left() + number % tile.strips_a_row() * tile.listed.strip,
          y < tile.view->camera.height};
}

int64_t weigh(const Tile& tile, const TileRecords& records, const Strip& strip, const KernelTable& kernels,
              TileScratch& scratch, float* transmittance) {
  const auto numbers = static_cast<size_t>(strip.count * tile.listed.strip);
  if (scratch.alpha.size() < numbers) {
    scratch.alpha.resize(numbers);
    scratch.weight.resize(numbers);
    scratch.scratch.resize(numbers);
  }
  const SplatCamera& camera = tile.view->camera;
  return kernels.splat_weights({records.rows.data(), records.strip_records.data() + strip.first, strip.count,
                                camera.least_alpha_power, camera.least_transmittance, scratch.alpha.data(),
                                scratch.weight.data(), transmittance});
}

// Calls work(tile, its records, kernels, scratch) for every tile, each thread with a scratch of its own. Records are
// those of `kept` where there are some, else they are found, and go to `keep` where it is there.
template <class Work>
void for_each_tile(const SplatView& view, const SplatFeatures& features, int64_t stride,
                   const KernelSettings& settings, const TileLists* kept, TileLists* keep, const Work& work) {
  const KernelTable& kernels = kernel_table(settings.instruction_set);
  if (kept != nullptr &&
      (static_cast<int64_t>(kept->tiles.size()) != view.tiles() || kept->strip != kernels.splat_strip ||
       kept->stride != stride || kept->by_index != features.by_index)) {
    fail({"lists of tiles", fmt::format("those of this view, {} tiles", view.tiles()),
          fmt::format("{} tiles of another", kept->tiles.size()),
          "composite again with the same view, features and settings"});
  }
  if (keep != nullptr) {
    *keep = TileLists();
    keep->tiles.resize(static_cast<size_t>(view.tiles()));
    keep->strip = kernels.splat_strip;
    keep->stride = stride;
    keep->by_index = features.by_index;
  }
#pragma omp parallel num_threads(settings.threads)
  {
    TileScratch scratch;
#pragma omp for schedule(dynamic)
    for (int64_t number = 0; number < view.tiles(); ++number) {
      const Tile tile{&view, {number, kernels.splat_strip, stride, features.by_index}};
      if (kept != nullptr) {
        work(tile, kept->tiles[static_cast<size_t>(number)], kernels, scratch);
        continue;
      }
      TileRecords& records = keep == nullptr ? scratch.records : keep->tiles[static_cast<size_t>(number)];
      list_records(view, tile.listed, scratch.listed, records);
      work(tile, records, kernels, scratch);
    }
  }
}

const float* background_of(const SplatFeatures& features) {
  return features.background.empty() ? nullptr : features.background.data();
}

}  // namespace

SplatImage::SplatImage(int64_t image_channels, int64_t image_width, int64_t image_height)
    : channels(image_channels),
      width(image_width),
      height(image_height),
      stride((image_width + kSplatTile - 1) / kSplatTile * kSplatTile),
      values(static_cast<size_t>(channels * height * stride), 0.0F) {}

CompositedView composite(const SplatView& view, const SplatFeatures& features, const KernelSettings& settings,
                         TileLists* keep) {
  CompositedView result;
  result.image = SplatImage(features.channels, view.camera.width, view.camera.height);
  result.transmittance = SplatImage(1, view.camera.width, view.camera.height);
  const int64_t stride = result.image.stride;
  for_each_tile(
      view, features, stride, settings, nullptr, keep,
      [&](const Tile& tile, const TileRecords& records, const KernelTable& kernels, TileScratch& scratch) {
        for (int64_t number = 0; number < tile.strips(); ++number) {
          const Strip strip = strip_of_tile(tile, records, number);
          if (!strip.inside) break;
          float* const transmittance = result.transmittance.values.data() + strip.pixel;
          const int64_t used = weigh(tile, records, strip, kernels, scratch, transmittance);
          kernels.splat_channels({scratch.weight.data(), transmittance,
                                  records.strip_rows.data() + strip.first, used, features.values,
                                  features.channels, background_of(features),
                                  result.image.values.data() + strip.pixel, result.image.plane()});
        }
      });
  return result;
}

PixelWeights pixel_weights(const SplatView& view, const KernelSettings& settings) {
  const int64_t width = view.camera.width, height = view.camera.height;
  PixelWeights result;
  result.first.assign(static_cast<size_t>(width * height) + 1, 0);
  SplatFeatures features;
  features.by_index = true;  // so that lists name Gaussians of the set
  const int64_t stride = SplatImage(0, width, 0).stride;
  // Calls entry(pixel, Gaussian, weight) for all that is not 0, those of a pixel front to back.
  const auto for_each_weight = [&](const auto& entry) {
    for_each_tile(
        view, features, stride, settings, nullptr, nullptr,
        [&](const Tile& tile, const TileRecords& records, const KernelTable& kernels, TileScratch& scratch) {
          float transmittance[kSplatTile];
          for (int64_t number = 0; number < tile.strips(); ++number) {
            const Strip strip = strip_of_tile(tile, records, number);
            if (!strip.inside) break;
            const int64_t used = weigh(tile, records, strip, kernels, scratch, transmittance);
            const int64_t row = strip.pixel / stride, column = strip.pixel % stride;
            for (int64_t lane = 0; lane < std::min(tile.listed.strip, width - column); ++lane) {
              for (int64_t i = 0; i < used; ++i) {
                const float weight = scratch.weight[static_cast<size_t>(i * tile.listed.strip + lane)];
                if (weight > 0) {
                  entry(static_cast<size_t>(row * width + column + lane),
                        records.strip_rows[static_cast<size_t>(strip.first + i)], weight);
                }
              }
            }
          }
        });
  };
  for_each_weight([&](size_t pixel, int32_t, float) { ++result.first[pixel + 1]; });
  for (size_t pixel = 0; pixel + 1 < result.first.size(); ++pixel)
    result.first[pixel + 1] += result.first[pixel];
  const auto entries = static_cast<size_t>(result.first.back());
  result.columns.resize(entries);
  result.values.resize(entries);
  std::vector<int64_t> next(result.first.begin(), result.first.end() - 1);
  for_each_weight([&](size_t pixel, int32_t gaussian, float weight) {
    const auto place = static_cast<size_t>(next[pixel]++);
    result.columns[place] = gaussian;
    result.values[place] = weight;
  });
  return result;
}

CompositingGradients composite_backward(const SplatView& view, const SplatFeatures& features,
                                        const SplatImage& of_image, SplatGradients wanted,
                                        const KernelSettings& settings, const TileLists* kept) {
  const bool shapes = wanted == SplatGradients::kFeaturesAndShapes;
  const int64_t channels = features.channels, moments_each = shapes ? kSplatMoments : 0;
  const auto entries = view.tile_splats.size();
  // By entry of the tiles' lists.
  std::vector<float> of_features(entries * static_cast<size_t>(channels)),
      moments(entries * static_cast<size_t>(moments_each));
  for_each_tile(
      view, features, of_image.stride, settings, kept, nullptr,
      [&](const Tile& tile, const TileRecords& records, const KernelTable& kernels, TileScratch& scratch) {
        const auto numbers = records.size() * static_cast<size_t>(tile.listed.strip);
        if (scratch.record_weight.size() < numbers) {
          scratch.record_weight.resize(numbers);
          scratch.slope.resize(numbers);
        }
        float* const slope = shapes ? scratch.slope.data() : nullptr;
        float transmittance[kSplatTile];
        for (int64_t number = 0; number < tile.strips(); ++number) {
          const Strip strip = strip_of_tile(tile, records, number);
          if (!strip.inside) break;
          const int64_t used = weigh(tile, records, strip, kernels, scratch, transmittance);
          kernels.splat_slopes(
              {scratch.alpha.data(), scratch.weight.data(), transmittance,
               records.strip_records.data() + strip.first, records.strip_rows.data() + strip.first,
               strip.count, used, view.camera.held_alpha_gradient, features.values, channels,
               background_of(features), of_image.values.data() + strip.pixel, of_image.plane(),
               scratch.scratch.data(), scratch.record_weight.data(), slope});
        }
        const auto first = static_cast<size_t>(view.tile_first[static_cast<size_t>(tile.listed.number)]);
        kernels.splat_sums({static_cast<int64_t>(records.first_record.size()) - 1,
                            records.first_record.data(), records.rows.data(), records.pixel.data(),
                            scratch.record_weight.data(), slope, of_image.values.data(), channels,
                            of_image.plane(), moments.data() + first * static_cast<size_t>(moments_each),
                            of_features.data() + first * static_cast<size_t>(channels)});
      });
  CompositingGradients result;
  result.features.assign(view.splats.size() * static_cast<size_t>(channels), 0.0F);
  result.moments.assign(view.splats.size() * static_cast<size_t>(moments_each), 0.0F);
  const auto add = [](const std::vector<float>& from, int64_t each, size_t entry, size_t splat,
                      std::vector<float>& to) {
    const float* source = from.data() + entry * static_cast<size_t>(each);
    float* sum = to.data() + splat * static_cast<size_t>(each);
    for (int64_t k = 0; k < each; ++k) sum[k] += source[k];
  };
#pragma omp parallel for num_threads(settings.threads) schedule(static)
  for (int64_t i = 0; i < view.size(); ++i) {
    const auto splat = static_cast<size_t>(i);
    for (int32_t place = view.splat_first[splat]; place < view.splat_first[splat + 1]; ++place) {
      const auto entry = static_cast<size_t>(view.splat_entries[static_cast<size_t>(place)]);
      add(of_features, channels, entry, splat, result.features);
      add(moments, moments_each, entry, splat, result.moments);
    }
  }
  return result;
}

ProjectedGradient projected_gradient(const VisibleSplat& splat, const float* moments) {
  // With U the upper factor of u and v (U^T U = kExponentUnit S2^-1): sum a S2^-1 d = U^T sum a (u, v) /
  // kExponentUnit, and S2^-1 (sum a d d^T) S2^-1 / 2 likewise with the square of that factor.
  constexpr double kPerUnit = 1 / kExponentUnit;
  ProjectedGradient gradient;
  gradient.log_opacity = moments[0];
  const double x = splat.along_x, y = splat.along_y, v = splat.across_y;
  const double au = moments[1], av = moments[2], auu = moments[3], auv = moments[4], avv = moments[5];
  gradient.mean[0] = kPerUnit * x * au;
  gradient.mean[1] = kPerUnit * (y * au + v * av);
  constexpr double kHalf = 0.5 * kPerUnit * kPerUnit;
  gradient.covariance[0] = kHalf * x * x * auu;
  gradient.covariance[1] = kHalf * x * (y * auu + v * auv);
  gradient.covariance[2] = kHalf * (y * y * auu + 2 * y * v * auv + v * v * avv);
  return gradient;
}

CompositedView render_colours(const GaussianSet& set, const SplatView& view, const KernelSettings& settings) {
  const std::vector<float> colours = view_colours(set, view, settings);
  SplatFeatures features;
  features.values = colours.data();
  features.channels = 3;
  return composite(view, features, settings);
}

namespace {

// Adds what a splat's place, covariance and opacity say to the gradients of its Gaussian's geometry.
void add_geometry_gradient(const GaussianShape& shape, const SplatView& view, int64_t index,
                           const ProjectedGaussian& projected, const ProjectedGradient& of_projected,
                           GaussianSet& of_set) {
  GaussianShape gradient;
  project_gaussian_backward(shape, view.camera, projected, of_projected, gradient);
  for (int k = 0; k < 3; ++k) {
    of_set.means[static_cast<size_t>(3 * index + k)] += static_cast<float>(gradient.mean[k]);
    of_set.log_scales[static_cast<size_t>(3 * index + k)] += static_cast<float>(gradient.log_scale[k]);
  }
  for (int k = 0; k < 4; ++k)
    of_set.rotations[static_cast<size_t>(4 * index + k)] += static_cast<float>(gradient.rotation[k]);
  of_set.logit_opacities[static_cast<size_t>(index)] += static_cast<float>(gradient.logit_opacity);
}

SplatFeatures features_of(const GaussianSet& set) {
  SplatFeatures features;
  features.values = set.features.data();
  features.channels = set.channels;
  features.by_index = true;
  return features;
}

}  // namespace

void render_colours_backward(const GaussianSet& set, const SplatView& view, const std::vector<float>& colours,
                             const SplatImage& of_image, SplatGradients wanted,
                             const KernelSettings& settings, ColourGradients& gradients,
                             const TileLists* kept) {
  const bool shapes = wanted == SplatGradients::kFeaturesAndShapes;
  SplatFeatures features;
  features.values = colours.data();
  features.channels = 3;
  const CompositingGradients composited =
      composite_backward(view, features, of_image, wanted, settings, kept);
  GaussianSet& of_set = gradients.of_set;
  of_set.degree = set.degree;
  of_set.channels = set.channels;
  for (const GaussianArray& array : gaussian_arrays(set))
    (of_set.*array.values).assign((set.*array.values).size(), 0.0F);
  gradients.of_means_in_picture.resize(shapes ? view.splats.size() * 2 : 0);
#pragma omp parallel for num_threads(settings.threads) schedule(static)
  for (int64_t place = 0; place < view.size(); ++place) {
    const int64_t i = view.splat_in_order(place);
    const auto number = static_cast<size_t>(i);
    const VisibleSplat& splat = view.splats[number];
    const int64_t index = splat.index;
    const GaussianShape shape = gaussian_shape(set, index);
    ProjectedGaussian projected;
    project_gaussian(shape, view.camera, projected);
    SeenColour colour;
    seen_colour(set, index, projected.from_camera, colour);
    double of_rgb[3];
    for (int c = 0; c < 3; ++c) of_rgb[c] = composited.features[3 * number + static_cast<size_t>(c)];
    const Eigen::Vector3d direction_mean = seen_colour_backward(set, index, colour, of_rgb, of_set);
    if (!shapes) continue;
    ProjectedGradient of_projected = projected_gradient(splat, composited.moments.data() + kSplatMoments * i);
    for (int axis = 0; axis < 2; ++axis)
      gradients.of_means_in_picture[2 * number + static_cast<size_t>(axis)] =
          static_cast<float>(of_projected.mean[axis]);
    of_projected.direction_mean = direction_mean;
    add_geometry_gradient(shape, view, index, projected, of_projected, of_set);
  }
}

CompositedView render_features(const GaussianSet& set, const SplatView& view,
                               const KernelSettings& settings) {
  return composite(view, features_of(set), settings);
}

void render_features_backward(const GaussianSet& set, const SplatView& view, const SplatImage& of_image,
                              const KernelSettings& settings, GaussianSet& of_set) {
  const CompositingGradients composited =
      composite_backward(view, features_of(set), of_image, SplatGradients::kFeaturesAndShapes, settings);
  const auto channels = static_cast<size_t>(set.channels);
#pragma omp parallel for num_threads(settings.threads) schedule(static)
  for (int64_t place = 0; place < view.size(); ++place) {
    const int64_t i = view.splat_in_order(place);
    const VisibleSplat& splat = view.splats[static_cast<size_t>(i)];
    const int64_t index = splat.index;
    const float* from = composited.features.data() + static_cast<size_t>(i) * channels;
    float* to = of_set.features.data() + static_cast<size_t>(index) * channels;
    for (size_t c = 0; c < channels; ++c) to[c] += from[c];
    const GaussianShape shape = gaussian_shape(set, index);
    ProjectedGaussian projected;
    project_gaussian(shape, view.camera, projected);
    add_geometry_gradient(shape, view, index, projected,
                          projected_gradient(splat, composited.moments.data() + kSplatMoments * i), of_set);
  }
}

}  // namespace gld
