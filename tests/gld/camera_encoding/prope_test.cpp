#include "gld/camera_encoding/prope.h"

#include "gld/attention/attention.h"
#include "tests/support/error_of.h"
#include "tests/support/random_cameras.h"

#include <cmath>

#include <torch/autograd.h>

#include <Eigen/LU>
#include <gtest/gtest.h>

namespace gld {
namespace {

constexpr int64_t kHeadDim = 24, kHeads = 2, kPrefix = 1;

struct Scene {
  Views views;
  LatentGrid grid{3, 2, 3};
  PropeLayout layout;

  explicit Scene(uint32_t seed, int64_t prefix = kPrefix) {
    views = test::RandomCameras(seed).ordinary_scene({grid.views, 2, 84, 56});
    layout.grid = grid;
    layout.prefix_tokens = prefix;
    layout.head_dim = kHeadDim;
  }
  torch::Tensor tokens(torch::Dtype dtype, uint64_t seed) const {
    torch::manual_seed(seed);
    return torch::randn({1, grid.views * (layout.prefix_tokens + grid.tokens_per_view()), kHeads, kHeadDim},
                        dtype);
  }
  PropeTables tables(PropeCameras which, torch::Dtype dtype = torch::kFloat64) const {
    return make_prope_tables(relative_cameras(views), layout, which, dtype);
  }
};

// It encodes one token at a time, straight from DESIGN.md.
torch::Tensor naive_encode(const Scene& scene, const torch::Tensor& x, const std::string& role) {
  auto y = x.clone();
  const auto cameras = relative_cameras(scene.views).views.cameras;
  const auto in = x.accessor<double, 4>();
  auto out = y.accessor<double, 4>();
  const int64_t per_view = scene.layout.prefix_tokens + scene.grid.tokens_per_view();
  for (int64_t token = 0; token < x.size(1); ++token) {
    const int64_t patch = token % per_view - scene.layout.prefix_tokens;
    if (patch < 0) continue;
    const Camera& camera = cameras[static_cast<size_t>(token / per_view)];
    const Eigen::Matrix4d k = lifted_intrinsics(camera.intrinsics, 84, 56);
    const Eigen::Matrix4d pose = camera.world_from_camera.inverse().matrix();
    Eigen::Matrix4d matrix = k * pose;
    if (role == "query") matrix.transposeInPlace();
    if (role == "key_value") {
      matrix = scene.layout.inverse == PropeInverse::kTrue ? Eigen::Matrix4d(matrix.inverse())
                                                           : Eigen::Matrix4d(pose.inverse() * k);
    }
    const int64_t column = patch % scene.grid.width, row = patch / scene.grid.width;
    const double position[2] = {static_cast<double>(column), static_cast<double>(row)};
    for (int64_t head = 0; head < kHeads; ++head) {
      for (int64_t group = 0; group < kHeadDim / 8; ++group) {
        for (int64_t i = 0; i < 4; ++i) {
          double sum = 0;
          for (int64_t j = 0; j < 4; ++j) sum += matrix(i, j) * in[0][token][head][4 * group + j];
          out[0][token][head][4 * group + i] = sum;
        }
      }
      for (int64_t part = 0; part < 2; ++part) {
        const int64_t first = kHeadDim / 2 + part * kHeadDim / 4, half = kHeadDim / 8;
        for (int64_t i = 0; i < half; ++i) {
          const double angle =
              position[part] * std::pow(100.0, -static_cast<double>(i) / static_cast<double>(half));
          const double sine = role == "output" ? -std::sin(angle) : std::sin(angle);
          const double a = in[0][token][head][first + i], b = in[0][token][head][first + half + i];
          out[0][token][head][first + i] = std::cos(angle) * a + sine * b;
          out[0][token][head][first + half + i] = std::cos(angle) * b - sine * a;
        }
      }
    }
  }
  return y;
}

double largest(const torch::Tensor& x) { return x.abs().max().item<double>(); }

TEST(Prope, EncodesAsTheFormulaSays) {
  for (const auto inverse : {PropeInverse::kPublished, PropeInverse::kTrue}) {
    Scene scene(1);
    scene.layout.inverse = inverse;
    const auto x = scene.tokens(torch::kFloat64, 2);
    const auto tables = scene.tables(PropeCameras::kScene);
    EXPECT_LT(largest(encode_query(tables, x) - naive_encode(scene, x, "query")), 1e-12);
    EXPECT_LT(largest(encode_key_value(tables, x) - naive_encode(scene, x, "key_value")), 1e-12);
    EXPECT_LT(largest(encode_output(tables, x) - naive_encode(scene, x, "output")), 1e-12);
  }
}

TEST(Prope, TrueInverseCancelsWithinAView) {
  Scene scene(3);
  scene.layout.inverse = PropeInverse::kTrue;
  const auto tables = scene.tables(PropeCameras::kScene);
  const auto product = torch::bmm(tables.output_matrix, tables.key_value_matrix);
  EXPECT_LT(largest(product - torch::eye(4, torch::kFloat64)), 1e-13);
  const auto x = scene.tokens(torch::kFloat64, 4);
  EXPECT_LT(largest(encode_output(tables, encode_key_value(tables, x)) - x), 1e-12);
}

TEST(Prope, PrefixTokensPassUnchanged) {
  const Scene scene(5, 2);
  const auto tables = scene.tables(PropeCameras::kScene);
  const auto x = scene.tokens(torch::kFloat64, 6);
  const auto shape =
      std::vector<int64_t>{scene.grid.views, 2 + scene.grid.tokens_per_view(), kHeads, kHeadDim};
  for (const auto& y : {encode_query(tables, x), encode_key_value(tables, x), encode_output(tables, x)}) {
    EXPECT_TRUE(torch::equal(y.view(shape).narrow(1, 0, 2), x.view(shape).narrow(1, 0, 2)));
    EXPECT_FALSE(torch::equal(y, x));
  }
}

TEST(Prope, ImageSizeNormalisesTheIntrinsics) {
  Scene scene(7);
  scene.layout.image_size = 504;
  const auto tables = scene.tables(PropeCameras::kIdentityPose);
  const Camera& camera = scene.views.cameras[1];
  EXPECT_DOUBLE_EQ(tables.output_matrix[1][0][0].item<double>(), camera.intrinsics(0, 0) / 504);
  EXPECT_DOUBLE_EQ(tables.output_matrix[1][1][2].item<double>(), camera.intrinsics(1, 2) / 504 - 0.5);
  const auto identity = scene.tables(PropeCameras::kIdentity);
  EXPECT_DOUBLE_EQ(identity.output_matrix[2][0][0].item<double>(), 1.0 / 504);
  EXPECT_DOUBLE_EQ(identity.output_matrix[2][0][2].item<double>(), -0.5);
}

TEST(Prope, FoldedTablesGiveTheSameAttention) {
  for (const auto inverse : {PropeInverse::kPublished, PropeInverse::kTrue}) {
    Scene scene(11, 0);
    scene.layout.inverse = inverse;
    const auto tables = scene.tables(PropeCameras::kIdentity);
    const auto folded = fold_shared_camera(tables);
    EXPECT_TRUE(torch::equal(folded.key_value_matrix,
                             torch::eye(4, torch::kFloat64).expand({scene.grid.views, 4, 4})));
    AttentionInputs inputs;
    inputs.query = scene.tokens(torch::kFloat64, 12);
    inputs.key = scene.tokens(torch::kFloat64, 13);
    inputs.value = scene.tokens(torch::kFloat64, 14);
    inputs.prope = &tables;
    const auto expected = attention(inputs);
    inputs.prope = &folded;
    EXPECT_LT(largest(attention(inputs) - expected), 1e-12);
  }
}

TEST(Prope, FoldingLeavesDifferentViewsAndPrefixTokensAlone) {
  const Scene different(15, 0);
  const auto tables = different.tables(PropeCameras::kScene);
  EXPECT_TRUE(torch::equal(fold_shared_camera(tables).key_value_matrix, tables.key_value_matrix));
  const Scene with_prefix(16, 1);
  const auto identity = with_prefix.tables(PropeCameras::kIdentity);
  EXPECT_TRUE(torch::equal(fold_shared_camera(identity).key_value_matrix, identity.key_value_matrix));
}

TEST(Prope, WorldFrameMattersToPrefixTokensOnly) {
  Scene scene(17, 0);
  scene.layout.frame = PropeFrame::kWorld;
  const auto relative = relative_cameras(scene.views);
  EXPECT_LT(largest(scene.tables(PropeCameras::kScene).output_matrix[2] -
                    scene.tables(PropeCameras::kIdentityPose).output_matrix[2]),
            1e-12);
  scene.layout.prefix_tokens = 1;
  const Eigen::Matrix4d expected = lifted_intrinsics(scene.views.cameras[2].intrinsics, 84, 56) *
                                   relative.world_views.cameras[2].world_from_camera.inverse().matrix();
  const auto matrix = scene.tables(PropeCameras::kScene).output_matrix[2];
  for (int row = 0; row < 4; ++row) {
    for (int column = 0; column < 4; ++column) {
      EXPECT_NEAR(matrix[row][column].item<double>(), expected(row, column), 1e-12);
    }
  }
}

TEST(Prope, GradientsAreThoseOfFiniteDifferences) {
  const Scene scene(18);
  const auto tables = scene.tables(PropeCameras::kScene);
  auto x = scene.tokens(torch::kFloat64, 19).requires_grad_();
  const auto weights = scene.tokens(torch::kFloat64, 20);
  (encode_key_value(tables, x) * weights).sum().backward();
  const auto direction = scene.tokens(torch::kFloat64, 21);
  const torch::NoGradGuard no_grad;
  const auto value = [&](double step) {
    return (encode_key_value(tables, x + step * direction) * weights).sum().item<double>();
  };
  EXPECT_NEAR((x.grad() * direction).sum().item<double>(), (value(1e-3) - value(-1e-3)) / 2e-3, 1e-8);
}

TEST(Prope, Refusals) {
  Scene scene(22);
  scene.layout.head_dim = 20;
  EXPECT_EQ(test::error_of([&] { scene.tables(PropeCameras::kScene); }),
            "camera encoding (PRoPE): expected a head size that is a multiple of 8, found 20; "
            "choose num_heads so that hidden_size / num_heads is a multiple of 8.");
  scene.layout.head_dim = kHeadDim;
  scene.layout.grid.views = 5;
  EXPECT_EQ(test::error_of([&] { scene.tables(PropeCameras::kScene); }),
            "camera encoding (PRoPE): expected one camera for each of 5 views, found 3; "
            "pass the cameras of the scene.");
}

}  // namespace
}  // namespace gld
