// Depth and point clouds at the ends of what they can hold.
#include "bench/extremes/extremes_benchmark.h"
#include "datasets/images/image_file.h"
#include "infer/export/depth_export.h"
#include "infer/export/ply_file.h"
#include "infer/export/point_cloud.h"
#include "models/bundle/random_bundle.h"
#include "models/decoders/dpt_head.h"
#include "models/weights/weight_loading.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/types.h>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr float kNoDepth = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();

// A DPT head with random weights whose exponentials are driven to their ends by the biases of its last layers.
class ExtremeHead {
 public:
  ExtremeHead()
      : options_(small_bundle_options().geometry_head.as<DptHeadOptions>()),
        head_(options_, ParameterPlacement{}) {
    head_.initialise(at::detail::createCPUGenerator(3));
    for (int level = 0; level < 4; ++level) {
      levels_.push_back(torch::randn({1, 4, options_.dim_in}, at::detail::createCPUGenerator(level),
                                     torch::TensorOptions(torch::kFloat32)));
    }
  }

  GeometryOutput maps(double bias) {
    auto tensors = named_tensors(head_);
    tensors.at("scratch.output_conv2.2.bias").fill_(bias);
    tensors.at("scratch.output_conv2_aux.3.5.bias").fill_(bias);
    return head_.forward(levels_, {1, 2, 2}, GeometryMaps::kDepthAndRays);
  }

 private:
  DptHeadOptions options_;
  DptHead head_;
  std::vector<torch::Tensor> levels_;
};

double count(const torch::Tensor& condition) { return condition.sum().item<double>(); }

void add_head_extremes(std::vector<ExtremeRow>& rows) {
  ExtremeHead head;
  for (const double bias : {-1e30, -1e4, 1e4, 1e30}) {
    const auto maps = head.maps(bias);
    double non_finite = 0;
    for (const auto& map :
         {maps.depth, maps.depth.reciprocal(), maps.depth_confidence, maps.ray_confidence}) {
      non_finite += count(torch::isfinite(map).logical_not());
    }
    rows.push_back({"depth", fmt::format("logits of about {:g}", bias),
                    "depths, inverse depths and confidences that are not finite", non_finite, 0});
    rows.push_back({"depth", fmt::format("logits of about {:g}", bias), "depths that are not positive",
                    count(maps.depth.le(0)), 0});
    rows.push_back({"depth", fmt::format("logits of about {:g}", bias), "ray confidences below 1",
                    count(maps.ray_confidence.lt(1)), 0});
  }
}

PointView extreme_view(const std::vector<float>& depths, const std::vector<float>& confidences) {
  PointView view;
  view.camera.width = 16;
  view.camera.height = 32;
  view.camera.intrinsics << 20, 0, 8, 0, 20, 16, 0, 0, 1;
  view.image = Image(16, 32);
  view.depth = DepthMap(16, 32);
  view.confidence = ConfidenceMap(16, 32);
  for (size_t i = 0; i < view.depth.metres.size(); ++i) {
    view.depth.metres[i] = depths[i % depths.size()];
    view.confidence.values[i] = confidences[i % confidences.size()];
  }
  return view;
}

// Returns how many numbers of a cloud are not finite after it was written to a file and read again.
double non_finite_after_export(const PointCloud& cloud, const std::filesystem::path& file) {
  export_ply(file, cloud, Provenance());
  const PointCloud read = read_ply(file).cloud;
  double non_finite = read.size() == cloud.size() ? 0 : 1;
  for (const auto& point : read.x_in_world) non_finite += point.allFinite() ? 0 : 1;
  for (const float confidence : read.confidences) non_finite += std::isfinite(confidence) ? 0 : 1;
  return non_finite;
}

void add_clouds(std::vector<ExtremeRow>& rows, const std::filesystem::path& folder) {
  PointCloudOptions keep_all;
  keep_all.confidence_quantile = 0;
  keep_all.far_limit = 0;
  keep_all.edge_step = 1e6;
  const std::vector<float> depths{kNoDepth, kInfinity, -kInfinity, -1, 0, 1e-45F, 3.4e38F, 1};
  const std::vector<float> confidences{kNoDepth, kInfinity, -1, 0, 1e-45F, 3.4e38F, 1};
  for (const double scale : {1e-30, 1.0, 1e30}) {
    auto view = extreme_view(depths, confidences);
    for (const double offset : {0.0, 1e6}) {
      view.camera.world_from_camera.translation().setConstant(offset);
      rows.push_back(
          {"clouds",
           fmt::format("depth and confidence up to overflow, times {:g}, offset {:g}", scale, offset),
           "numbers in the file that are not finite",
           non_finite_after_export(build_point_cloud({view}, scale, keep_all), folder / "cloud.ply"), 0});
    }
  }
  const auto unsure = build_point_cloud({extreme_view({1, 2, 3}, {0})}, 1, {});
  rows.push_back({"clouds", "zero confidence everywhere", "points", static_cast<double>(unsure.size()), 0});
  rows.push_back({"clouds", "no point at all", "numbers in the file that are not finite",
                  non_finite_after_export(unsure, folder / "cloud.ply"), 0});
}

// Returns the largest rounding of depths between 1 and 3 in a 16-bit file beside one that overflowed, relative to the
// depth.
double rounding_beside_overflow(const std::filesystem::path& file) {
  DepthMap depth(40, 50);
  for (size_t i = 0; i < depth.metres.size(); ++i) depth.metres[i] = 1 + static_cast<float>(i) * 0.9973e-3F;
  depth.metres[777] = 3e38F;
  const double unit = choose_depth_unit({depth});
  export_depth_png(file, depth, unit, Provenance());
  const DepthMap read = read_depth_png(file, unit);
  double largest = 0;
  for (size_t i = 0; i < depth.metres.size(); ++i) {
    if (i == 777) continue;
    largest =
        std::max(largest, std::abs(static_cast<double>(read.metres[i]) - depth.metres[i]) / depth.metres[i]);
  }
  return largest;
}

}  // namespace

std::vector<ExtremeRow> depth_extremes(const std::filesystem::path& folder) {
  std::vector<ExtremeRow> rows;
  add_head_extremes(rows);
  add_clouds(rows, folder);
  rows.push_back({"depth", "one overflow in a 16-bit file", "relative rounding of the other depths",
                  rounding_beside_overflow(folder / "depth.png"), 1e-4});
  return rows;
}

}  // namespace gld
