#include "gld/splatting/compositing.h"

#include "gld/kernels/kernel_table.h"
#include "tests/gld/splatting/naive_view.h"
#include "tests/gld/splatting/random_gaussians.h"
#include "tests/support/error_of.h"
#include "tests/support/worst_of.h"

#include <algorithm>
#include <cmath>
#include <random>

#include <gtest/gtest.h>

namespace gld {
namespace {

KernelSettings settings_of(InstructionSet set, int threads = 2) {
  KernelSettings settings;
  settings.threads = threads;
  settings.instruction_set = set;
  return settings;
}

std::vector<float> random_values(size_t count, unsigned seed) {
  std::mt19937 engine(seed);
  std::uniform_real_distribution<float> distribution(-1, 1);
  std::vector<float> values(count);
  for (float& value : values) value = distribution(engine);
  return values;
}

// What float32 may change of a picture, whatever a vector's width, u = 2^-24. alpha = 2^(height - a^2) with
// a = slope i + shift, at most r = sqrt(8) where it is seen. The antialiasing variance of 0.3 keeps slopes below
// sqrt(log2(e) / 0.6) = 1.55 a pixel, so over a strip of 16 pixels both terms of a are below 24 + r: a is off by
// 2 (24 + r) u, the exponent by 2 r times that and 3 r^2 u of its own, alpha with exp2's 2.5 u by
// ln 2 (304 + 24) u + 2.5 u = 230 u of itself. A change d of alpha behind a transmittance T moves the weights by 2 T d
// in sum, the T alpha sum to 1 at most, and features are at most 1: 460 u. Up to 100 Gaussians that count in a pixel
// round T and the sum, 2 u each: 660 u = 4e-5. As near to a jump of alpha, which side of it a pixel is on is open.
constexpr double kRounding = 4e-5;

class Compositing : public testing::TestWithParam<InstructionSet> {};

struct Comparison {
  int64_t count = 60;
  int64_t channels = 3;
  int64_t width = 37, height = 29;
  double smallest = 0.02, largest = 0.3;
  bool background = true;
};

// Compares the fast picture with the naive one, in pixels that are not next to a jump; they must be nearly all.
void expect_picture_of_naive(const Comparison& c, InstructionSet set_of_instructions) {
  RandomGaussians wanted;
  wanted.count = c.count;
  wanted.smallest = c.smallest;
  wanted.largest = c.largest;
  const GaussianSet set = random_gaussians(wanted);
  const SplatCamera camera = splat_camera(splat_test_camera(c.width, c.height), set.origin, {});
  const std::vector<float> values = random_values(static_cast<size_t>(c.count * c.channels), 5);
  SplatFeatures features;
  features.values = values.data();
  features.channels = c.channels;
  features.by_index = true;
  if (c.background) features.background = random_values(static_cast<size_t>(c.channels), 6);
  const KernelSettings settings = settings_of(set_of_instructions);
  const SplatView view = view_of_splats(set, camera, settings);
  const CompositedView fast = composite(view, features, settings);
  NaiveView naive = naive_view(shapes_of(set), camera);
  give_features(naive, values, c.channels);
  naive.scene.background.assign(features.background.begin(), features.background.end());
  const NaiveImage expected = render_naively(naive.scene);
  int64_t compared = 0;
  double worst = 0, squares = 0, covered = 0;
  for (int64_t y = 0; y < c.height; ++y) {
    for (int64_t x = 0; x < c.width; ++x) {
      const auto pixel = static_cast<size_t>(y * c.width + x);
      if (expected.to_jump[pixel] < kRounding) continue;
      ++compared;
      covered += 1 - expected.transmittance[pixel];
      worst =
          test::worst_of(worst, std::abs(fast.transmittance.row(0, y)[x] - expected.transmittance[pixel]));
      for (int64_t k = 0; k < c.channels; ++k) {
        const double off =
            fast.image.row(k, y)[x] - expected.values[static_cast<size_t>(k * c.width * c.height) + pixel];
        worst = test::worst_of(worst, std::abs(off));
        squares += off * off;
      }
    }
  }
  EXPECT_LT(worst, kRounding);
  EXPECT_LT(std::sqrt(squares / static_cast<double>(compared * c.channels)), 1e-6);
  EXPECT_GT(compared, c.width * c.height * 97 / 100);
  EXPECT_GT(covered, 0.2 * static_cast<double>(compared));
}

TEST_P(Compositing, IsTheNaiveOne) {
  expect_picture_of_naive({}, GetParam());
  Comparison many;
  many.count = 900;
  many.smallest = 0.005;
  many.largest = 0.05;
  expect_picture_of_naive(many, GetParam());
  Comparison opaque;  // many pixels are done before the last Gaussian
  opaque.count = 300;
  opaque.smallest = 0.3;
  opaque.largest = 2;
  opaque.background = false;
  expect_picture_of_naive(opaque, GetParam());
}

TEST_P(Compositing, OfAnyNumberOfChannels) {
  for (const int64_t channels : {1, 4, 7, 8, 9, 64, 1537}) {
    SCOPED_TRACE(channels);
    Comparison c;
    c.channels = channels;
    c.width = 19;
    c.height = 17;
    c.count = 30;
    expect_picture_of_naive(c, GetParam());
  }
}

TEST_P(Compositing, OfOddPictures) {
  for (const auto& [width, height] :
       {std::pair<int64_t, int64_t>{1, 1}, {16, 1}, {1, 33}, {17, 16}, {31, 7}}) {
    SCOPED_TRACE(std::to_string(width) + "x" + std::to_string(height));
    const GaussianSet set = random_gaussians({});
    Camera full = splat_test_camera(40, 40);
    full.width = width;  // a corner of the picture
    full.height = height;
    full.intrinsics(0, 2) = full.intrinsics(1, 2) = 3;
    const SplatCamera camera = splat_camera(full, set.origin, {});
    const KernelSettings settings = settings_of(GetParam());
    const SplatView view = view_of_splats(set, camera, settings);
    const CompositedView fast = render_colours(set, view, settings);
    const std::vector<float> colours = view_colours(set, view, settings);
    NaiveView naive = naive_view(shapes_of(set), camera);
    naive.scene.channels = 3;
    for (const int64_t index : naive.index) {
      SeenColour colour;
      seen_colour(set, index, gaussian_shape(set, index).mean + camera.offset, colour);
      naive.scene.features.insert(naive.scene.features.end(), colour.rgb, colour.rgb + 3);
    }
    const NaiveImage expected = render_naively(naive.scene);
    for (int64_t pixel = 0; pixel < width * height; ++pixel) {
      if (expected.to_jump[static_cast<size_t>(pixel)] < kRounding) continue;
      for (int64_t c = 0; c < 3; ++c) {
        EXPECT_NEAR(fast.image.row(c, pixel / width)[pixel % width],
                    expected.values[static_cast<size_t>(c * width * height + pixel)], kRounding);
      }
    }
  }
}

// d loss / d parameters in float beside the naive double, for a loss that is linear in the picture. The pixels next to
// a jump do not count. Opaque Gaussians have pixels whose alpha is held, other bounds more pixels that end.
TEST_P(Compositing, GradientsAreTheNaiveOnes) {
  RandomGaussians wanted;
  wanted.count = 150;
  wanted.smallest = 0.02;
  wanted.degree = 3;
  struct Drawn {
    ProjectionOptions projection;
    HeldAlphaGradient held = HeldAlphaGradient::kNone;
    float more_opaque = 0;  // in logits
  };
  std::vector<Drawn> variants(4);
  variants[1].projection.antialias = true;
  variants[2].held = HeldAlphaGradient::kPublished;
  variants[3].projection.least_alpha = 0.03;
  variants[3].projection.least_transmittance = 0.02;
  for (const size_t opaque : {size_t{2}, size_t{3}}) variants[opaque].more_opaque = 4;
  for (const Drawn& drawn : variants) {
    const ProjectionOptions& projection = drawn.projection;
    GaussianSet set = random_gaussians(wanted);
    for (float& logit : set.logit_opacities) logit += drawn.more_opaque;
    SplatCamera camera = splat_camera(splat_test_camera(45, 33), set.origin, projection);
    camera.held_alpha_gradient = drawn.held;
    NaiveView naive = naive_view(shapes_of(set), camera);
    naive.scene.options = projection;
    naive.scene.held_alpha_gradient = drawn.held;
    naive.scene.channels = 3;
    std::vector<SeenColour> colours(naive.index.size());
    for (size_t k = 0; k < naive.index.size(); ++k) {
      seen_colour(set, naive.index[k], naive.projected[k].from_camera, colours[k]);
      naive.scene.features.insert(naive.scene.features.end(), colours[k].rgb, colours[k].rgb + 3);
    }
    const NaiveImage picture = render_naively(naive.scene);
    std::vector<float> of_picture = random_values(picture.values.size(), 9);
    const size_t pixels = picture.transmittance.size();
    SplatImage of_image(3, camera.width, camera.height);
    for (size_t i = 0; i < of_picture.size(); ++i) {
      const size_t pixel = i % pixels;
      if (picture.to_jump[pixel] < 1e-4) of_picture[i] = 0;
      of_image.row(static_cast<int64_t>(i / pixels),
                   static_cast<int64_t>(pixel) / camera.width)[static_cast<int64_t>(pixel) % camera.width] =
          of_picture[i];
    }
    const NaiveGradients expected =
        render_naively_backward(naive.scene, std::vector<double>(of_picture.begin(), of_picture.end()));
    GaussianSet of_expected = zero_gaussians(set.size(), set.degree);
    for (size_t k = 0; k < naive.index.size(); ++k) {
      ProjectedGradient gradient;
      gradient.mean = {expected.splats[k].mean[0], expected.splats[k].mean[1]};
      std::copy(expected.splats[k].covariance, expected.splats[k].covariance + 3, gradient.covariance);
      gradient.log_opacity = expected.splats[k].opacity;
      gradient.direction_mean = seen_colour_backward(set, naive.index[k], colours[k],
                                                     expected.features.data() + 3 * k, of_expected);
      GaussianShape shape;
      project_gaussian_backward(gaussian_shape(set, naive.index[k]), camera, naive.projected[k], gradient,
                                shape);
      const auto i = static_cast<size_t>(naive.index[k]);
      for (int a = 0; a < 3; ++a) {
        of_expected.means[3 * i + static_cast<size_t>(a)] = static_cast<float>(shape.mean[a]);
        of_expected.log_scales[3 * i + static_cast<size_t>(a)] = static_cast<float>(shape.log_scale[a]);
      }
      for (int a = 0; a < 4; ++a)
        of_expected.rotations[4 * i + static_cast<size_t>(a)] = static_cast<float>(shape.rotation[a]);
      of_expected.logit_opacities[i] = static_cast<float>(shape.logit_opacity);
    }
    const KernelSettings settings = settings_of(GetParam());
    const SplatView view = view_of_splats(set, camera, settings);
    ColourGradients gradients;
    render_colours_backward(set, view, view_colours(set, view, settings), of_image,
                            SplatGradients::kFeaturesAndShapes, settings, gradients);
    for (const GaussianArray& array : gaussian_arrays(set)) {
      if (array.each == 0) continue;
      const std::vector<float>&fast = gradients.of_set.*array.values, &slow = of_expected.*array.values;
      ASSERT_EQ(fast.size(), slow.size());
      double largest = 0, worst = 0;
      for (size_t i = 0; i < slow.size(); ++i) {
        largest = std::max(largest, std::abs(static_cast<double>(slow[i])));
        worst = test::worst_of(worst, std::abs(static_cast<double>(fast[i]) - slow[i]));
      }
      EXPECT_GT(largest, 0) << array.name;
      // The bound. Sums of some hundred pixels of either sign, each off by about 1e-6 of itself.
      EXPECT_LT(worst, 1e-4 * largest) << array.name;
    }
  }
}

TEST_P(Compositing, FeatureGradientsWithoutShapesAreTheSame) {
  const GaussianSet set = random_gaussians({});
  const SplatCamera camera = splat_camera(splat_test_camera(45, 33), set.origin, {});
  const std::vector<float> values = random_values(static_cast<size_t>(set.size() * 11), 5);
  SplatFeatures features;
  features.values = values.data();
  features.channels = 11;
  features.by_index = true;
  SplatImage of_image(11, 45, 33);
  const std::vector<float> random = random_values(of_image.values.size(), 8);
  for (int64_t c = 0; c < 11; ++c) {
    for (int64_t y = 0; y < 33; ++y) std::copy_n(random.data() + (c * 33 + y) * 45, 45, of_image.row(c, y));
  }
  const KernelSettings settings = settings_of(GetParam());
  const SplatView view = view_of_splats(set, camera, settings);
  const auto with =
      composite_backward(view, features, of_image, SplatGradients::kFeaturesAndShapes, settings);
  const auto without = composite_backward(view, features, of_image, SplatGradients::kFeatures, settings);
  EXPECT_EQ(with.features, without.features);
  EXPECT_TRUE(without.moments.empty());
  // Lists that are kept are those that would be found, and of nothing else.
  TileLists lists;
  const CompositedView kept = composite(view, features, settings, &lists);
  EXPECT_EQ(kept.image.values, composite(view, features, settings).image.values);
  for (const int threads : {1, 3}) {
    KernelSettings others = settings;
    others.threads = threads;
    const auto again =
        composite_backward(view, features, of_image, SplatGradients::kFeaturesAndShapes, others, &lists);
    EXPECT_EQ(again.features, with.features) << threads;
    EXPECT_EQ(again.moments, with.moments) << threads;
  }
  SplatFeatures other_rows = features;
  other_rows.by_index = false;
  EXPECT_EQ(
      test::error_of([&] {
        composite_backward(view, other_rows, of_image, SplatGradients::kFeatures, settings, &lists);
      }),
      "lists of tiles: expected those of this view, 9 tiles, found 9 tiles of another; composite again with the "
      "same view, features and settings.");
  // The picture is linear in the features: <picture(f), g> = <f, gradient>.
  const CompositedView picture = composite(view, features, settings);
  double of_picture = 0, of_features = 0;
  for (size_t i = 0; i < picture.image.values.size(); ++i)
    of_picture += static_cast<double>(picture.image.values[i]) * of_image.values[i];
  for (int64_t i = 0; i < view.size(); ++i) {
    for (int64_t c = 0; c < 11; ++c) {
      of_features += static_cast<double>(
                         values[static_cast<size_t>(view.splats[static_cast<size_t>(i)].index * 11 + c)]) *
                     with.features[static_cast<size_t>(i * 11 + c)];
    }
  }
  EXPECT_NEAR(of_picture, of_features, 1e-4 * std::abs(of_picture) + 1e-4);
}

// Features that are the colours move geometry as those do, and geometry that colours do not move has no gradient.
TEST_P(Compositing, FeaturesMoveGeometryAsColoursDo) {
  RandomGaussians wanted;
  wanted.degree = 0;
  GaussianSet set = random_gaussians(wanted);
  const SplatCamera camera = splat_camera(splat_test_camera(45, 33), set.origin, {});
  const KernelSettings settings = settings_of(GetParam());
  const SplatView view = view_of_splats(set, camera, settings);
  const std::vector<float> colours = view_colours(set, view, settings);
  set.channels = 3;
  set.features.assign(static_cast<size_t>(set.size()) * 3, 0.0F);
  for (size_t i = 0; i < view.splats.size(); ++i)
    std::copy_n(colours.data() + 3 * i, 3,
                set.features.data() + 3 * static_cast<size_t>(view.splats[i].index));
  EXPECT_EQ(render_features(set, view, settings).image.values,
            render_colours(set, view, settings).image.values);
  SplatImage of_image(3, 45, 33);
  for (int64_t row = 0; row < 3 * 33; ++row) {
    const auto random = random_values(45, static_cast<unsigned>(row));
    std::copy(random.begin(), random.end(), of_image.row(row / 33, row % 33));
  }
  ColourGradients by_colours, without_shapes;
  render_colours_backward(set, view, colours, of_image, SplatGradients::kFeaturesAndShapes, settings,
                          by_colours);
  render_colours_backward(set, view, colours, of_image, SplatGradients::kFeatures, settings, without_shapes);
  EXPECT_EQ(without_shapes.of_set.colours, by_colours.of_set.colours);
  EXPECT_TRUE(without_shapes.of_means_in_picture.empty());
  GaussianSet by_features = zero_gaussians_like(set, set.size());
  render_features_backward(set, view, of_image, settings, by_features);
  for (const auto values : {&GaussianSet::means, &GaussianSet::log_scales, &GaussianSet::rotations,
                            &GaussianSet::logit_opacities}) {
    EXPECT_EQ(by_features.*values, by_colours.of_set.*values);
    EXPECT_EQ(without_shapes.of_set.*values, std::vector<float>((set.*values).size(), 0.0F));
  }
  // Twice: gradients are added.
  const float once = by_features.features[3 * static_cast<size_t>(view.splats.front().index)];
  EXPECT_NE(once, 0);
  render_features_backward(set, view, of_image, settings, by_features);
  EXPECT_EQ(by_features.features[3 * static_cast<size_t>(view.splats.front().index)], 2 * once);
}

TEST_P(Compositing, BitsDoNotDependOnThreads) {
  RandomGaussians wanted;
  wanted.count = 3000;
  wanted.smallest = 0.005;
  wanted.largest = 0.1;
  wanted.degree = 2;
  const GaussianSet set = random_gaussians(wanted);
  const SplatCamera camera = splat_camera(splat_test_camera(90, 70), set.origin, {});
  SplatImage of_image(3, 90, 70);
  for (int64_t y = 0; y < 70; ++y) {
    for (int64_t c = 0; c < 3; ++c) {
      const auto random = random_values(90, static_cast<unsigned>(3 * y + c));
      std::copy(random.begin(), random.end(), of_image.row(c, y));
    }
  }
  CompositedView first;
  ColourGradients first_gradients;
  for (const int threads : {1, 2, 8}) {
    const KernelSettings settings = settings_of(GetParam(), threads);
    const SplatView view = view_of_splats(set, camera, settings);
    const CompositedView picture = render_colours(set, view, settings);
    ColourGradients gradients;
    render_colours_backward(set, view, view_colours(set, view, settings), of_image,
                            SplatGradients::kFeaturesAndShapes, settings, gradients);
    if (threads == 1) {
      first = picture;
      first_gradients = gradients;
      continue;
    }
    EXPECT_EQ(picture.image.values, first.image.values);
    for (const GaussianArray& array : gaussian_arrays(set))
      EXPECT_EQ(gradients.of_set.*array.values, first_gradients.of_set.*array.values) << array.name;
  }
}

INSTANTIATE_TEST_SUITE_P(all, Compositing, testing::ValuesIn(available_instruction_sets()),
                         [](const auto& info) {
                           std::string name = instruction_set_name(info.param);
                           name.erase(std::remove(name.begin(), name.end(), '-'), name.end());
                           return name;
                         });

// The whole chain from every kind of parameter to a number of the picture, in double, by differences.
TEST(NaiveSplatting, GradientsAreThoseOfDifferences) {
  RandomGaussians wanted;
  wanted.count = 14;
  wanted.degree = 3;
  GaussianSet set = random_gaussians(wanted);
  const SplatCamera camera = splat_camera(splat_test_camera(22, 17), set.origin, {});
  std::vector<GaussianShape> shapes = shapes_of(set);
  std::vector<double> of_image;
  NaiveView view;
  std::vector<SeenColour> colours;
  const auto render = [&] {
    view = naive_view(shapes, camera);
    EXPECT_EQ(view.index.size(), shapes.size());
    view.scene.channels = 3;
    view.scene.background = {0.3, 0.6, 0.1};
    colours.assign(shapes.size(), {});
    for (size_t k = 0; k < shapes.size(); ++k) {
      seen_colour(set, static_cast<int64_t>(k), view.projected[k].from_camera, colours[k]);
      view.scene.features.insert(view.scene.features.end(), colours[k].rgb, colours[k].rgb + 3);
    }
    return render_naively(view.scene);
  };
  const NaiveImage picture = render();
  int64_t counted = 0;
  const size_t pixels = picture.transmittance.size();
  for (const float value : random_values(picture.values.size(), 4)) {
    const bool counts = picture.to_jump[of_image.size() % pixels] > 1e-3;
    counted += counts;
    of_image.push_back(counts ? static_cast<double>(value) : 0);
  }
  EXPECT_GT(counted, static_cast<int64_t>(of_image.size() / 2));
  const auto number = [&] {
    const NaiveImage now = render();
    double sum = 0;
    for (size_t i = 0; i < of_image.size(); ++i) sum += of_image[i] * now.values[i];
    return sum;
  };
  const auto difference = [&](auto& parameter, double step) {
    const auto here = parameter;
    parameter = static_cast<std::decay_t<decltype(parameter)>>(here + step);
    const double above = number();
    parameter = static_cast<std::decay_t<decltype(parameter)>>(here - step);
    const double below = number();
    parameter = here;
    return (above - below) / (2 * step);
  };
  render();
  const NaiveGradients gradients = render_naively_backward(view.scene, of_image);
  const auto projected = view.projected;
  const auto seen = colours;
  GaussianSet of_set = zero_gaussians(set.size(), set.degree);
  // Central differences of 1e-5 are good to 1e-9 of these numbers; 1e-6 is what the issue asks for.
  constexpr double kStep = 1e-5, kTolerance = 1e-6;
  for (size_t i = 0; i < shapes.size(); ++i) {
    SCOPED_TRACE(i);
    ProjectedGradient gradient;
    gradient.mean = {gradients.splats[i].mean[0], gradients.splats[i].mean[1]};
    std::copy(gradients.splats[i].covariance, gradients.splats[i].covariance + 3, gradient.covariance);
    gradient.log_opacity = gradients.splats[i].opacity;
    gradient.direction_mean = seen_colour_backward(set, static_cast<int64_t>(i), seen[i],
                                                   gradients.features.data() + 3 * i, of_set);
    GaussianShape expected;
    project_gaussian_backward(shapes[i], camera, projected[i], gradient, expected);
    const double scale =
        std::max({1.0, expected.mean.norm(), expected.log_scale.norm(), expected.rotation.norm()});
    for (int k = 0; k < 3; ++k) {
      EXPECT_NEAR(expected.mean[k], difference(shapes[i].mean[k], kStep), kTolerance * scale) << "mean " << k;
      EXPECT_NEAR(expected.log_scale[k], difference(shapes[i].log_scale[k], kStep), kTolerance * scale);
    }
    for (int k = 0; k < 4; ++k)
      EXPECT_NEAR(expected.rotation[k], difference(shapes[i].rotation[k], kStep), kTolerance * scale);
    EXPECT_NEAR(expected.logit_opacity, difference(shapes[i].logit_opacity, kStep), kTolerance * scale);
    // Colours are linear in the coefficients, which are floats on a grid of 2^-10, where max(0, ..) does not act.
    for (size_t c = 0; c < 3; ++c) {
      if (seen[i].rgb[c] < 0.01) continue;
      constexpr double kExact = 1.0 / 1024;
      EXPECT_NEAR(of_set.colours[3 * i + c], difference(set.colours[3 * i + c], kExact),
                  kTolerance * scale * 4);
      for (size_t k = 0; k < 15; ++k) {
        EXPECT_NEAR(of_set.harmonics[45 * i + 3 * k + c],
                    difference(set.harmonics[45 * i + 3 * k + c], kExact), kTolerance * scale * 4)
            << "harmonic " << k + 1;
      }
    }
  }
}

}  // namespace
}  // namespace gld
