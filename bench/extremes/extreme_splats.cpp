// 3D Gaussians at their ends: finite, and what the formulas say in double where every pixel is held against every
// Gaussian. Pixels near a place where the formulas jump are left out of the comparison.
#include "bench/extremes/extremes_benchmark.h"
#include "gld/base/error.h"
#include "gld/base/philox.h"
#include "gld/splatting/compositing.h"
#include "gld/splatting/naive_splatting.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr double kBroken = std::numeric_limits<double>::infinity();
constexpr const char* kArea = "splats";
// Of weights that are products of up to some hundred factors in float32, and of exponents of up to 8.
constexpr double kSplatRounding = 2e-6;
// Where u and v of a pixel are thousands of times what they are in a Gaussian's middle.
constexpr double kLongSplatRounding = 2e-5;

class Drawn {
 public:
  explicit Drawn(uint64_t seed) : key_(philox_key(seed, "extreme splats")) {}
  // Draws multiples of 2^-10, so that moving them by whole numbers is exact.
  float operator()(double low, double high) {
    const auto bits = philox4x32({next_++, 0, 0, 0}, key_)[0];
    const double value = low + (high - low) * static_cast<double>(bits) / 4294967296.0;
    return static_cast<float>(std::round(value * 1024) / 1024);
  }

 private:
  PhiloxKey key_;
  uint32_t next_ = 0;
};

// They lie in a box around (0, 0, 4), and are as large as a tenth of it or so.
GaussianSet some_gaussians(int64_t count = 20) {
  Drawn drawn(1);
  GaussianSet set = zero_gaussians(count, 0);
  for (size_t i = 0; i < static_cast<size_t>(count); ++i) {
    for (size_t k = 0; k < 3; ++k) {
      set.means[3 * i + k] = drawn(-1, 1) + (k == 2 ? 4 : 0);
      set.log_scales[3 * i + k] = drawn(-3, -0.9);
      set.colours[3 * i + k] = drawn(-1, 1.5);
    }
    for (size_t k = 0; k < 4; ++k) set.rotations[4 * i + k] = drawn(-1, 1) + (k == 0 ? 1.5F : 0);
    set.logit_opacities[i] = drawn(-2, 3);
  }
  return set;
}

GaussianSet with_scales(double low, double middle, double high) {
  GaussianSet set = some_gaussians();
  for (size_t i = 0; i < set.log_scales.size(); i += 3) {
    set.log_scales[i] = static_cast<float>(std::log(low));
    set.log_scales[i + 1] = static_cast<float>(std::log(middle));
    set.log_scales[i + 2] = static_cast<float>(std::log(high));
  }
  return set;
}

GaussianSet with_logits(float logit) {
  GaussianSet set = some_gaussians();
  for (float& value : set.logit_opacities) value = logit;
  return set;
}

// Equal depths go by index: the first few colours count.
GaussianSet at_one_place(int64_t count) {
  GaussianSet set = zero_gaussians(count, 0);
  for (size_t i = 0; i < static_cast<size_t>(count); ++i) {
    set.means[3 * i + 2] = 4;
    set.rotations[4 * i] = 1;
    for (size_t k = 0; k < 3; ++k) set.log_scales[3 * i + k] = -1;
    set.colours[3 * i] = i == 0 ? 1.7F : -1.0F;
  }
  return set;
}

// The camera is turned and moved a little, with K off centre.
Camera some_camera(int64_t width, int64_t height) {
  Camera camera;
  camera.width = width;
  camera.height = height;
  const auto w = static_cast<double>(width), h = static_cast<double>(height);
  camera.intrinsics << 1.7 * w, 0, 0.53 * w, 0, 1.6 * w, 0.46 * h, 0, 0, 1;
  camera.world_from_camera.linear() =
      (Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitY()) * Eigen::AngleAxisd(-0.07, Eigen::Vector3d::UnitZ()))
          .toRotationMatrix();
  camera.world_from_camera.translation() = Eigen::Vector3d(-0.4, 0.1, 0.2);
  return camera;
}

Camera with_focal(double widths) {
  Camera camera = some_camera(40, 30);
  camera.intrinsics(0, 0) = camera.intrinsics(1, 1) = widths * 40;
  camera.world_from_camera = Eigen::Isometry3d::Identity();
  return camera;
}

Camera off_centre() {
  Camera camera = some_camera(40, 30);
  camera.intrinsics(0, 2) = -90;
  return camera;
}

Camera inside() {
  Camera camera = some_camera(40, 30);
  camera.world_from_camera.translation() = Eigen::Vector3d(0.1, 0, 4);
  return camera;
}

SplatView view_of(const GaussianSet& set, const Camera& camera) {
  return view_of_splats(set, splat_camera(camera, set.origin, {}), {});
}

// Returns the same pictures in double, with these features or, where there are none, with colours.
NaiveScene naive_scene(const GaussianSet& set, const Camera& camera, const std::vector<float>& features,
                       int64_t channels, std::vector<int64_t>* drawn) {
  const SplatCamera splat = splat_camera(camera, set.origin, {});
  NaiveScene scene;
  scene.channels = channels;
  scene.width = camera.width;
  scene.height = camera.height;
  for (int64_t i = 0; i < set.size(); ++i) {
    ProjectedGaussian projected;
    if (!project_gaussian(gaussian_shape(set, i), splat, projected)) continue;
    scene.splats.push_back(naive_splat(projected));
    if (drawn != nullptr) drawn->push_back(i);
    if (!features.empty()) {
      scene.features.insert(scene.features.end(), features.begin() + i * channels,
                            features.begin() + (i + 1) * channels);
      continue;
    }
    SeenColour colour;
    seen_colour(set, i, projected.from_camera, colour);
    scene.features.insert(scene.features.end(), colour.rgb, colour.rgb + 3);
  }
  return scene;
}

bool all_finite(const std::vector<float>& values) {
  return std::all_of(values.begin(), values.end(), [](float value) { return std::isfinite(value); });
}

// Returns the largest difference of pictures; infinite where a pixel is not finite.
double picture_difference(const SplatImage& image, const NaiveImage& expected) {
  if (!all_finite(image.values)) return kBroken;
  constexpr double kNearJump = 1e-3;
  double worst = 0;
  const int64_t pixels = image.width * image.height;
  for (int64_t pixel = 0; pixel < pixels; ++pixel) {
    if (expected.to_jump[static_cast<size_t>(pixel)] < kNearJump) continue;
    for (int64_t c = 0; c < image.channels; ++c) {
      worst = std::max(worst, std::abs(image.row(c, pixel / image.width)[pixel % image.width] -
                                       expected.values[static_cast<size_t>(c * pixels + pixel)]));
    }
  }
  return worst;
}

// Returns how many gradients of a set's parameters are not finite, for a loss that is the sum of the picture.
double gradients_not_finite(const GaussianSet& set, const SplatView& view, const SplatImage& like) {
  SplatImage ones(like.channels, like.width, like.height);
  for (int64_t c = 0; c < ones.channels; ++c) {
    for (int64_t y = 0; y < ones.height; ++y) std::fill_n(ones.row(c, y), ones.width, 1.0F);
  }
  ColourGradients gradients;
  render_colours_backward(set, view, view_colours(set, view, {}), ones, SplatGradients::kFeaturesAndShapes,
                          {}, gradients);
  double count = 0;
  for (const GaussianArray& array : gaussian_arrays(gradients.of_set)) {
    for (const float value : gradients.of_set.*array.values) count += std::isfinite(value) ? 0 : 1;
  }
  return count;
}

struct Case {
  std::string situation;
  GaussianSet set;
  Camera camera;
  double limit = kSplatRounding;
};

std::vector<Case> splat_cases() {
  return {
      {"needles of 1e6 : 1, 1e3 long", with_scales(1e-3, 1e-3, 1e3), some_camera(40, 30), kLongSplatRounding},
      {"needles of 1e6 : 1, 1 long", with_scales(1e-6, 1e-2, 1), some_camera(40, 30)},
      {"scales of 1e-8", with_scales(1e-8, 1e-8, 1e-8), some_camera(40, 30)},
      {"scales of 1e3", with_scales(1e3, 1e3, 1e3), some_camera(40, 30)},
      {"scales of 1e-8, 1 and 1e3", with_scales(1e-8, 1, 1e3), some_camera(40, 30), kLongSplatRounding},
      {"camera among them", some_gaussians(), inside()},
      {"opacity 1", with_logits(80), some_camera(40, 30)},
      {"10,000 at one place", at_one_place(10000), some_camera(24, 24)},
      {"focal length of .1 widths", some_gaussians(), with_focal(0.1)},
      {"focal length of 50 widths", some_gaussians(), with_focal(50)},
      {"principal point 2 widths outside", some_gaussians(), off_centre()},
      {"1 x 1 pixel", some_gaussians(), some_camera(1, 1)},
      {"17 x 33 pixels", some_gaussians(), some_camera(17, 33)},
      {"49 x 7 pixels", some_gaussians(), some_camera(49, 7)}};
}

// Measures what nothing is seen of: how far pixels are from black and from letting everything through, and the
// gradients.
ExtremeRow unseen(const std::string& situation, const GaussianSet& set) {
  const SplatView view = view_of(set, some_camera(30, 20));
  const CompositedView picture = render_colours(set, view, {});
  double worst = static_cast<double>(view.size()) + gradients_not_finite(set, view, picture.image);
  for (int64_t y = 0; y < 20; ++y) {
    for (int64_t x = 0; x < 30; ++x) {
      worst = std::max<double>(worst, std::abs(picture.transmittance.row(0, y)[x] - 1));
      for (int64_t c = 0; c < 3; ++c) worst = std::max<double>(worst, std::abs(picture.image.row(c, y)[x]));
    }
  }
  return {kArea, situation, "seen Gaussians, other pixels than black, broken gradients", worst, 0};
}

void add_unseen(std::vector<ExtremeRow>& rows) {
  rows.push_back(unseen("no Gaussian", zero_gaussians(0, 3)));
  GaussianSet behind = some_gaussians();
  for (size_t i = 2; i < behind.means.size(); i += 3) behind.means[i] = -4;
  rows.push_back(unseen("all behind the camera", behind));
  rows.push_back(unseen("opacity 0", with_logits(-100)));
}

// The Gaussians are 1e6 away from the world's origin with the camera beside them.
ExtremeRow far_away() {
  GaussianSet set = some_gaussians();
  Camera camera = some_camera(40, 30);
  const SplatImage near = render_colours(set, view_of(set, camera), {}).image;
  const Eigen::Vector3d offset(1e6, -5e5, 2.5e5);
  camera.world_from_camera.translation() += offset;
  set.origin = offset;
  const SplatImage far = render_colours(set, view_of(set, camera), {}).image;
  double worst = all_finite(far.values) ? 0 : kBroken;
  for (size_t i = 0; i < near.values.size(); ++i)
    worst = std::max<double>(worst, std::abs(near.values[i] - far.values[i]));
  // A double at 1e6 has steps of 1e-10; no alpha lies that near to 1/255 here.
  return {kArea, "world offset 1e6", "largest change of the picture", worst, 1e-6};
}

void add_channels(std::vector<ExtremeRow>& rows, int64_t channels) {
  const GaussianSet set = some_gaussians();
  const Camera camera = some_camera(21, 13);
  Drawn drawn(7);
  std::vector<float> values(static_cast<size_t>(set.size() * channels));
  for (float& value : values) value = drawn(-1, 1);
  SplatFeatures features;
  features.values = values.data();
  features.channels = channels;
  features.by_index = true;
  const SplatView view = view_of(set, camera);
  std::vector<int64_t> numbers;
  const NaiveScene scene = naive_scene(set, camera, values, channels, &numbers);
  const NaiveImage expected = render_naively(scene);
  const std::string situation = fmt::format("{} channel{}", channels, channels == 1 ? "" : "s");
  rows.push_back({kArea, situation, "largest difference from double precision",
                  picture_difference(composite(view, features, {}).image, expected), kSplatRounding});
  // Gradients of features, for a loss of pixels away from jumps.
  SplatImage of_image(channels, camera.width, camera.height);
  std::vector<double> seeds(expected.values.size(), 0.0);
  const int64_t pixels = camera.width * camera.height;
  for (int64_t i = 0; i < static_cast<int64_t>(seeds.size()); ++i) {
    if (expected.to_jump[static_cast<size_t>(i % pixels)] < 1e-3) continue;
    const float seed = drawn(-1, 1);
    seeds[static_cast<size_t>(i)] = seed;
    of_image.row(i / pixels, i % pixels / camera.width)[i % camera.width] = seed;
  }
  const NaiveGradients gradients = render_naively_backward(scene, seeds);
  const auto found = composite_backward(view, features, of_image, SplatGradients::kFeaturesAndShapes, {});
  double worst = all_finite(found.moments) && all_finite(found.features) ? 0 : kBroken, largest = 0;
  for (int64_t i = 0; i < view.size(); ++i) {
    const auto at = std::find(numbers.begin(), numbers.end(), view.splats[static_cast<size_t>(i)].index);
    const auto number = static_cast<int64_t>(at - numbers.begin());
    for (int64_t c = 0; c < channels; ++c) {
      const double truth = gradients.features[static_cast<size_t>(number * channels + c)];
      largest = std::max(largest, std::abs(truth));
      worst = std::max(worst, std::abs(found.features[static_cast<size_t>(i * channels + c)] - truth));
    }
  }
  rows.push_back({kArea, situation, "gradients of features, relative to the largest", worst / largest, 1e-5});
}

// The value is 0 where the sentence names the Gaussian and the parameter.
ExtremeRow named_in_error(const std::string& parameter, float value) {
  GaussianSet set = some_gaussians();
  (parameter == "mean" ? set.means[3 * 7 + 1] : set.log_scales[3 * 7 + 1]) = value;
  double missing = 1;
  try {
    check_gaussians(set, "splats.ply");
  } catch (const Error& error) {
    const std::string text = error.what();
    missing =
        text.find("Gaussian 7") != std::string::npos && text.find(parameter) != std::string::npos ? 0 : 1;
  }
  return {kArea, fmt::format("{} {}", parameter, value), "not named in the error", missing, 0};
}

}  // namespace

std::vector<ExtremeRow> splat_extremes() {
  std::vector<ExtremeRow> rows;
  add_unseen(rows);
  for (const Case& one : splat_cases()) {
    const SplatView view = view_of(one.set, one.camera);
    const SplatImage image = render_colours(one.set, view, {}).image;
    rows.push_back(
        {kArea, one.situation, "largest difference from double precision",
         picture_difference(image, render_naively(naive_scene(one.set, one.camera, {}, 3, nullptr))),
         one.limit});
    rows.push_back({kArea, one.situation, "gradients that are not finite",
                    gradients_not_finite(one.set, view, image), 0});
  }
  rows.push_back(far_away());
  for (const int64_t channels : {1, 1537}) add_channels(rows, channels);
  rows.push_back(named_in_error("mean", std::numeric_limits<float>::infinity()));
  rows.push_back(named_in_error("log scale", std::numeric_limits<float>::quiet_NaN()));
  return rows;
}

}  // namespace gld
