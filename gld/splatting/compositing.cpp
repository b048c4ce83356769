#include "gld/splatting/compositing.h"

#include "gld/kernels/kernel_table.h"

#include <algorithm>
#include <cmath>

namespace gld {
namespace {

// Which Gaussians reach which strips of a tile. Records are those of one Gaussian after another; lists by strip are
// front to back, since the Gaussians are.
struct TileRecords {
  size_t count = 0;  // of records; the first four arrays are as long as any tile before needed
  std::vector<SplatRow> rows;
  std::vector<int16_t> strip_of;
  std::vector<int64_t> pixel;          // offset of the strip in a plane
  std::vector<int32_t> feature_row;    // of the record's Gaussian
  std::vector<int32_t> first_record;   // (Gaussians + 1)
  std::vector<int32_t> strip_first;    // (strips + 1)
  std::vector<int32_t> strip_records;  // numbers of rows
  std::vector<int32_t> strip_features;

  void make_room(size_t most) {
    count = 0;
    if (rows.size() >= most) return;
    rows.resize(most);
    strip_of.resize(most);
    pixel.resize(most);
    feature_row.resize(most);
  }
};

// What a thread needs for a tile.
struct TileScratch {
  TileRecords records;
  std::vector<float> alpha, weight, scratch, record_weight, slope, moments, features;
};

struct Tile {
  const SplatView* view;
  const SplatFeatures* features;
  int64_t number;
  int64_t stride;  // of a plane's rows
  int64_t strip;   // pixels

  int64_t left() const { return number % view->tile_columns * kSplatTile; }
  int64_t top() const { return number / view->tile_columns * kSplatTile; }
  const int32_t* begin() const {
    return view->tile_splats.data() + view->tile_first[static_cast<size_t>(number)];
  }
  int64_t count() const {
    return view->tile_first[static_cast<size_t>(number) + 1] - view->tile_first[static_cast<size_t>(number)];
  }
  int64_t strips_a_row() const { return kSplatTile / strip; }
  int64_t strips() const { return kSplatTile * strips_a_row(); }
};

// Columns of a tile and one to either side; -1 of what is no number.
double held_in_tile(double value) {
  return value > -1 ? std::min(value, static_cast<double>(kSplatTile)) : -1;
}

// std::ceil and std::floor of it, without a call.
int ceiling_in_tile(double value) {
  const double held = held_in_tile(value);
  const int whole = static_cast<int>(held);
  return whole + static_cast<int>(static_cast<double>(whole) < held);
}
int floor_in_tile(double value) {
  const double held = held_in_tile(value);
  const int whole = static_cast<int>(held);
  return whole - static_cast<int>(static_cast<double>(whole) > held);
}

void list_records(const Tile& tile, TileRecords& records) {
  records.make_room(static_cast<size_t>(tile.count() * tile.strips()));
  records.first_record.assign(1, 0);
  records.strip_first.assign(static_cast<size_t>(tile.strips()) + 1, 0);
  const int64_t left = tile.left(), top = tile.top();
  for (int64_t j = 0; j < tile.count(); ++j) {
    const int32_t number = tile.begin()[j];
    const VisibleSplat& splat = tile.view->splats[static_cast<size_t>(number)];
    const int64_t first_row = std::max<int64_t>(splat.first_row, top),
                  end_row = std::min<int64_t>(splat.end_row, top + kSplatTile);
    const auto first_column = static_cast<int>(std::max<int64_t>(splat.first_column, left) - left),
               last_column =
                   static_cast<int>(std::min<int64_t>(splat.end_column, left + kSplatTile) - 1 - left);
    const int32_t feature_row = tile.features->by_index ? splat.index : number;
    const double begin_x = static_cast<double>(left) + 0.5 - splat.mean[0], inverse = 1 / splat.along_x;
    for (int64_t y = first_row; y < end_row; ++y) {
      const double dy = static_cast<double>(y) + 0.5 - splat.mean[1], across = splat.across_y * dy;
      const double height = splat.height - across * across;
      const double room = height - static_cast<double>(kFaintestSplat);
      if (room < 0) continue;
      // u of the tile's first pixel, and the pixels from it for which u^2 <= room.
      const double shift = splat.along_x * begin_x + splat.along_y * dy;
      // A pixel that the kernel's rounding lets in is listed: it decides.
      const double reach = std::sqrt(room) * (1 + 1e-5) + 1e-5;
      const int first = std::max(first_column, ceiling_in_tile((-reach - shift) * inverse)),
                last = std::min(last_column, floor_in_tile((reach - shift) * inverse));
      if (first > last) continue;
      const int side = static_cast<int>(tile.strip);
      for (int strip = first / side; strip <= last / side; ++strip) {
        const size_t record = records.count++;
        records.rows[record] = {static_cast<float>(splat.along_x),
                                static_cast<float>(shift + splat.along_x * static_cast<double>(strip * side)),
                                static_cast<float>(height), static_cast<float>(across)};
        const int64_t which = (y - top) * tile.strips_a_row() + strip;
        records.strip_of[record] = static_cast<int16_t>(which);
        ++records.strip_first[static_cast<size_t>(which) + 1];
        records.pixel[record] = y * tile.stride + left + strip * side;
        records.feature_row[record] = feature_row;
      }
    }
    records.first_record.push_back(static_cast<int32_t>(records.count));
  }
  for (size_t strip = 0; strip + 1 < records.strip_first.size(); ++strip)
    records.strip_first[strip + 1] += records.strip_first[strip];
  records.strip_records.resize(records.count);
  records.strip_features.resize(records.count);
  int32_t next[kSplatTile * kSplatTile];
  std::copy(records.strip_first.begin(), records.strip_first.end() - 1, next);
  for (size_t r = 0; r < records.count; ++r) {
    const auto place = static_cast<size_t>(next[records.strip_of[r]]++);
    records.strip_records[place] = static_cast<int32_t>(r);
    records.strip_features[place] = records.feature_row[r];
  }
}

struct Strip {
  int64_t first, count;  // in the tile's lists
  int64_t pixel;         // offset in a plane
  bool inside;           // its row is one of the picture
};

Strip strip_of_tile(const Tile& tile, const TileRecords& records, int64_t number) {
  const int64_t y = tile.top() + number / tile.strips_a_row();
  const int64_t first = records.strip_first[static_cast<size_t>(number)];
  return {first, records.strip_first[static_cast<size_t>(number) + 1] - first,
          y * tile.stride + tile.left() + number % tile.strips_a_row() * tile.strip,
          y < tile.view->camera.height};
}

int64_t weigh(const Tile& tile, const Strip& strip, const KernelTable& kernels, TileScratch& scratch,
              float* transmittance) {
  const auto numbers = static_cast<size_t>(strip.count * tile.strip);
  if (scratch.alpha.size() < numbers) {
    scratch.alpha.resize(numbers);
    scratch.weight.resize(numbers);
    scratch.scratch.resize(numbers);
  }
  return kernels.splat_weights({scratch.records.rows.data(),
                                scratch.records.strip_records.data() + strip.first, strip.count,
                                scratch.alpha.data(), scratch.weight.data(), transmittance});
}

// Calls work(tile, scratch) for every tile, each thread with a scratch of its own.
template <class Work>
void for_each_tile(const SplatView& view, const SplatFeatures& features, int64_t stride,
                   const KernelSettings& settings, const Work& work) {
  const KernelTable& kernels = kernel_table(settings.instruction_set);
#pragma omp parallel num_threads(settings.threads)
  {
    TileScratch scratch;
#pragma omp for schedule(dynamic)
    for (int64_t number = 0; number < view.tiles(); ++number) {
      const Tile tile{&view, &features, number, stride, kernels.splat_strip};
      list_records(tile, scratch.records);
      work(tile, kernels, scratch);
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

CompositedView composite(const SplatView& view, const SplatFeatures& features,
                         const KernelSettings& settings) {
  CompositedView result;
  result.image = SplatImage(features.channels, view.camera.width, view.camera.height);
  result.transmittance = SplatImage(1, view.camera.width, view.camera.height);
  const int64_t stride = result.image.stride;
  for_each_tile(view, features, stride, settings,
                [&](const Tile& tile, const KernelTable& kernels, TileScratch& scratch) {
                  for (int64_t number = 0; number < tile.strips(); ++number) {
                    const Strip strip = strip_of_tile(tile, scratch.records, number);
                    if (!strip.inside) break;
                    float* const transmittance = result.transmittance.values.data() + strip.pixel;
                    const int64_t used = weigh(tile, strip, kernels, scratch, transmittance);
                    kernels.splat_channels({scratch.weight.data(), transmittance,
                                            scratch.records.strip_features.data() + strip.first, used,
                                            features.values, features.channels, background_of(features),
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
    for_each_tile(view, features, stride, settings,
                  [&](const Tile& tile, const KernelTable& kernels, TileScratch& scratch) {
                    float transmittance[kSplatTile];
                    for (int64_t number = 0; number < tile.strips(); ++number) {
                      const Strip strip = strip_of_tile(tile, scratch.records, number);
                      if (!strip.inside) break;
                      const int64_t used = weigh(tile, strip, kernels, scratch, transmittance);
                      const int64_t row = strip.pixel / stride, column = strip.pixel % stride;
                      for (int64_t lane = 0; lane < std::min(tile.strip, width - column); ++lane) {
                        for (int64_t i = 0; i < used; ++i) {
                          const float weight = scratch.weight[static_cast<size_t>(i * tile.strip + lane)];
                          if (weight > 0) {
                            entry(static_cast<size_t>(row * width + column + lane),
                                  scratch.records.strip_features[static_cast<size_t>(strip.first + i)],
                                  weight);
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
                                        const KernelSettings& settings) {
  const bool shapes = wanted == SplatGradients::kFeaturesAndShapes;
  const int64_t channels = features.channels, moments_each = shapes ? kSplatMoments : 0;
  const auto entries = view.tile_splats.size();
  // By entry of the tiles' lists.
  std::vector<float> of_features(entries * static_cast<size_t>(channels)),
      moments(entries * static_cast<size_t>(moments_each));
  for_each_tile(view, features, of_image.stride, settings,
                [&](const Tile& tile, const KernelTable& kernels, TileScratch& scratch) {
                  const TileRecords& records = scratch.records;
                  const auto numbers = records.count * static_cast<size_t>(tile.strip);
                  if (scratch.record_weight.size() < numbers) {
                    scratch.record_weight.resize(numbers);
                    scratch.slope.resize(numbers);
                  }
                  float* const slope = shapes ? scratch.slope.data() : nullptr;
                  float transmittance[kSplatTile];
                  for (int64_t number = 0; number < tile.strips(); ++number) {
                    const Strip strip = strip_of_tile(tile, records, number);
                    if (!strip.inside) break;
                    const int64_t used = weigh(tile, strip, kernels, scratch, transmittance);
                    kernels.splat_slopes({scratch.alpha.data(), scratch.weight.data(), transmittance,
                                          records.strip_records.data() + strip.first,
                                          records.strip_features.data() + strip.first, strip.count, used,
                                          features.values, channels, background_of(features),
                                          of_image.values.data() + strip.pixel, of_image.plane(),
                                          scratch.scratch.data(), scratch.record_weight.data(), slope});
                  }
                  const auto first = static_cast<size_t>(view.tile_first[static_cast<size_t>(tile.number)]);
                  kernels.splat_sums({tile.count(), records.first_record.data(), records.rows.data(),
                                      records.pixel.data(), scratch.record_weight.data(), slope,
                                      of_image.values.data(), channels, of_image.plane(),
                                      moments.data() + first * static_cast<size_t>(moments_each),
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
                             const KernelSettings& settings, ColourGradients& gradients) {
  const bool shapes = wanted == SplatGradients::kFeaturesAndShapes;
  SplatFeatures features;
  features.values = colours.data();
  features.channels = 3;
  const CompositingGradients composited = composite_backward(view, features, of_image, wanted, settings);
  GaussianSet& of_set = gradients.of_set;
  of_set.degree = set.degree;
  of_set.channels = set.channels;
  for (const GaussianArray& array : gaussian_arrays(set))
    (of_set.*array.values).assign((set.*array.values).size(), 0.0F);
  gradients.of_means_in_picture.resize(shapes ? view.splats.size() * 2 : 0);
#pragma omp parallel for num_threads(settings.threads) schedule(static)
  for (int64_t i = 0; i < view.size(); ++i) {
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
  for (int64_t i = 0; i < view.size(); ++i) {
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
