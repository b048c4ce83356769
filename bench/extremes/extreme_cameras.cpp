// Camera conditioning and PRoPE at the ends of what cameras can be.
#include "bench/extremes/extremes_benchmark.h"
#include "gld/base/error.h"
#include "gld/camera_encoding/camera_conditioning.h"
#include "gld/camera_encoding/prope.h"
#include "gld/cameras/camera_checks.h"

#include <cmath>
#include <functional>
#include <random>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/types.h>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr int64_t kPropeHeadDim = 48;
constexpr int64_t kPixels = 28;  // a side; a token grid of 2 x 2

// Returns views on an arc of that radius around `centre`, looking at a point in front of it.
Views arc_of_views(int64_t count, int64_t sources, double radius, const Eigen::Vector3d& centre) {
  Views views;
  views.num_sources = sources;
  for (int64_t i = 0; i < count; ++i) {
    const double angle = 0.15 * static_cast<double>(i);
    Camera camera;
    camera.width = camera.height = kPixels;
    camera.intrinsics << kPixels, 0, kPixels / 2.0, 0, kPixels, kPixels / 2.0, 0, 0, 1;
    camera.world_from_camera.linear() = Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitY()).toRotationMatrix();
    camera.world_from_camera.translation() =
        centre + radius * Eigen::Vector3d(std::sin(angle), 0.1 * std::cos(3 * angle), std::cos(angle));
    views.cameras.push_back(camera);
  }
  return views;
}

Views ordinary_views() { return arc_of_views(8, 4, 1, Eigen::Vector3d::Zero()); }

PropeTables tables_of(const RelativeCameras& cameras, PropeInverse inverse, torch::Dtype dtype) {
  PropeLayout layout;
  layout.grid = {cameras.views.size(), 2, 2};
  layout.head_dim = kPropeHeadDim;
  layout.inverse = inverse;
  return make_prope_tables(cameras, layout, PropeCameras::kScene, dtype);
}

torch::Tensor random_tokens(int64_t views, uint64_t seed) {
  return torch::randn({1, views * 4, 3, kPropeHeadDim}, at::detail::createCPUGenerator(seed),
                      torch::kFloat64);
}

// Returns the logits of all token pairs, in double from encodings in dtype.
torch::Tensor logits(const Views& views, torch::Dtype dtype) {
  const auto tables = tables_of(relative_cameras(views), PropeInverse::kTrue, dtype);
  const auto query = encode_query(tables, random_tokens(views.size(), 1).to(dtype)).to(torch::kFloat64);
  const auto key = encode_key_value(tables, random_tokens(views.size(), 2).to(dtype)).to(torch::kFloat64);
  return torch::einsum("bqhc,bkhc->bhqk", {query, key}) / std::sqrt(static_cast<double>(kPropeHeadDim));
}

double largest_camera_error(const torch::Tensor& x) { return x.abs().max().item<double>(); }

// Returns how many numbers of the conditioning and the PRoPE tables are not finite.
double non_finite_numbers(const Views& views) {
  const auto cameras = relative_cameras(views);
  double count = torch::isfinite(camera_conditioning(cameras, {})).logical_not().sum().item<double>();
  for (const PropeInverse inverse : {PropeInverse::kTrue, PropeInverse::kPublished}) {
    const auto tables = tables_of(cameras, inverse, torch::kFloat32);
    for (const auto& matrix : {tables.query_matrix, tables.key_value_matrix, tables.output_matrix}) {
      count += torch::isfinite(matrix).logical_not().sum().item<double>();
    }
  }
  return count;
}

// Returns how far P P^-1 is from the identity, relative to the sizes of the two, for the true inverse in float32.
double inverse_error(const Views& views) {
  const auto tables = tables_of(relative_cameras(views), PropeInverse::kTrue, torch::kFloat32);
  const auto p = tables.output_matrix.to(torch::kFloat64),
             inverse = tables.key_value_matrix.to(torch::kFloat64);
  const auto sizes = p.flatten(1).norm(2, 1) * inverse.flatten(1).norm(2, 1);
  return ((torch::matmul(p, inverse) - torch::eye(4, torch::kFloat64)).flatten(1).norm(2, 1) / sizes)
      .max()
      .item<double>();
}

Views with_focal_length(double over_width) {
  auto views = ordinary_views();
  for (auto& camera : views.cameras) {
    camera.intrinsics(0, 0) = over_width * kPixels;
    camera.intrinsics(1, 1) = over_width * kPixels;
  }
  return views;
}

void add_offsets_and_scales(std::vector<ExtremeRow>& rows) {
  const auto exact = logits(ordinary_views(), torch::kFloat64);
  for (const double offset : {0.0, 1e2, 1e3, 1e6}) {
    const auto moved = arc_of_views(8, 4, 1, offset * Eigen::Vector3d(1, -0.5, 0.25));
    rows.push_back(
        {"cameras", fmt::format("world offset {:g}", offset), "relative change of fp32 logits",
         largest_camera_error(logits(moved, torch::kFloat32) - exact) / largest_camera_error(exact), 1e-6});
  }
  for (const double scale : {1e-8, 1e-4, 1e4, 1e8}) {
    const auto views = arc_of_views(8, 4, scale, Eigen::Vector3d::Zero());
    rows.push_back({"cameras", fmt::format("scene scale {:g}", scale), "non-finite numbers",
                    non_finite_numbers(views), 0});
  }
}

void add_degenerate_baselines(std::vector<ExtremeRow>& rows) {
  auto rotation = arc_of_views(8, 4, 1, Eigen::Vector3d::Zero());
  for (auto& camera : rotation.cameras) camera.world_from_camera.translation() = Eigen::Vector3d(3, -2, 1e3);
  const auto relative = relative_cameras(rotation);
  double translation = 0;
  for (const auto& camera : relative.views.cameras) {
    translation = std::max(translation, camera.world_from_camera.translation().cwiseAbs().maxCoeff());
  }
  rows.push_back({"cameras", "pure rotation", "largest translation", translation, 0});
  rows.push_back({"cameras", "pure rotation", "scale - 1", std::abs(relative.translation_scale - 1), 0});
  rows.push_back({"cameras", "pure rotation", "missing warnings", relative.warnings.empty() ? 1.0 : 0.0, 0});
  rows.push_back({"cameras", "pure rotation", "non-finite numbers", non_finite_numbers(rotation), 0});
  auto coincident = ordinary_views();
  coincident.cameras[5] = coincident.cameras[1];
  rows.push_back(
      {"cameras", "a target equal to a source", "non-finite numbers", non_finite_numbers(coincident), 0});
}

void add_intrinsics(std::vector<ExtremeRow>& rows) {
  for (const double focal : {0.05, 10.0, 50.0}) {
    const auto views = with_focal_length(focal);
    const auto situation = fmt::format("focal length {:g} widths", focal);
    rows.push_back({"cameras", situation, "non-finite numbers", non_finite_numbers(views), 0});
    rows.push_back({"cameras", situation, "|P P^-1 - I| / (|P| |P^-1|)", inverse_error(views), 1e-6});
  }
  auto views = ordinary_views();
  for (auto& camera : views.cameras) {
    camera.intrinsics(0, 2) = -3 * kPixels;
    camera.intrinsics(0, 0) = 2 * camera.intrinsics(1, 1);
  }
  rows.push_back(
      {"cameras", "principal point outside, fx = 2 fy", "non-finite numbers", non_finite_numbers(views), 0});
  const auto directions = camera_conditioning(relative_cameras(views), {}).slice(1, 1, 4).to(torch::kFloat64);
  rows.push_back({"cameras", "principal point outside, fx = 2 fy", "| |d| - 1 |",
                  largest_camera_error(directions.norm(2, 1) - 1), 1e-6});
}

void add_refusals_and_counts(std::vector<ExtremeRow>& rows) {
  auto mirrored = ordinary_views();
  mirrored.cameras[2].world_from_camera.linear().col(0) *= -1;
  auto sheared = ordinary_views();
  sheared.cameras[2].world_from_camera.linear()(0, 1) += 0.05;
  rows.push_back({"cameras", "left-handed rotation", "accepted",
                  accepted([&] { check_cameras(mirrored, "scene"); }), 0});
  rows.push_back({"cameras", "non-orthonormal rotation", "accepted",
                  accepted([&] { check_cameras(sheared, "scene"); }), 0});
  for (const auto& [count, sources] : {std::pair<int64_t, int64_t>{2, 1}, {8, 1}, {8, 7}}) {
    rows.push_back({"cameras", fmt::format("{} views, {} sources", count, sources), "non-finite numbers",
                    non_finite_numbers(arc_of_views(count, sources, 1, Eigen::Vector3d::Zero())), 0});
  }
}

// Returns cameras whose every property is drawn from the whole range that check_cameras accepts.
Views random_extreme_views(std::mt19937_64& random) {
  const auto uniform = [&](double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random);
  };
  const auto log_uniform = [&](double low, double high) {
    return std::exp(uniform(std::log(low), std::log(high)));
  };
  const auto direction = [&] { return Eigen::Vector3d(uniform(-1, 1), uniform(-1, 1), uniform(-1, 1)); };
  const int64_t count = std::uniform_int_distribution<int64_t>(2, 8)(random);
  Views views = arc_of_views(count, std::uniform_int_distribution<int64_t>(1, count - 1)(random), 1,
                             Eigen::Vector3d::Zero());
  const double spread = uniform(0, 1) < 0.1 ? 0 : log_uniform(1e-8, 1e8);
  const Eigen::Vector3d offset = (uniform(0, 1) < 0.3 ? 0 : log_uniform(1e-3, 1e6)) * direction();
  for (auto& camera : views.cameras) {
    camera.intrinsics(0, 0) = log_uniform(0.05, 50) * kPixels;
    camera.intrinsics(1, 1) = log_uniform(0.05, 50) * kPixels;
    camera.intrinsics(0, 2) = uniform(-2, 3) * kPixels;
    camera.intrinsics(1, 2) = uniform(-2, 3) * kPixels;
    const Eigen::Vector3d axis = direction().normalized();
    camera.world_from_camera.linear() = Eigen::AngleAxisd(uniform(0, 2 * M_PI), axis).toRotationMatrix();
    camera.world_from_camera.translation() = offset + spread * direction();
  }
  return views;
}

}  // namespace

std::vector<ExtremeRow> camera_extremes(int64_t random_sets) {
  std::vector<ExtremeRow> rows;
  add_offsets_and_scales(rows);
  add_degenerate_baselines(rows);
  add_intrinsics(rows);
  add_refusals_and_counts(rows);
  std::mt19937_64 random(20240607);
  double non_finite = 0;
  for (int64_t i = 0; i < random_sets; ++i) non_finite += non_finite_numbers(random_extreme_views(random));
  rows.push_back({"cameras", fmt::format("{} random extreme camera sets", random_sets), "non-finite numbers",
                  non_finite, 0});
  return rows;
}

}  // namespace gld
