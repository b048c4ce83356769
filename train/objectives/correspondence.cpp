#include "train/objectives/correspondence.h"

#include "gld/base/error.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace gld {
namespace {

constexpr int64_t kPointsASide = 4;       // of a token
constexpr double kDepthAgreement = 0.03;  // relative

}  // namespace

TokenCorrespondence token_correspondence(const TrainingScene& scene, int64_t patch_size) {
  if (!scene.depth.defined()) {
    fail({"scene " + scene.name, "depth to find correspondences with", "none",
          "use scenes with depth, such as those of gld synth, or set correspondence_weight to 0"});
  }
  const int64_t views = scene.views.size(), height = scene.height(), width = scene.width();
  const int64_t columns = width / patch_size, tokens = height / patch_size * columns;
  const auto depth = scene.depth.to(torch::kCPU).to(torch::kFloat32).contiguous();
  const auto* metres = depth.data_ptr<float>();
  const auto depth_at = [&](int64_t view, int64_t row, int64_t column) {
    return static_cast<double>(metres[(view * height + row) * width + column]);
  };
  TokenCorrespondence result;
  result.shares = torch::zeros({views, tokens, views, tokens});
  auto* shares = result.shares.data_ptr<float>();
  constexpr float kShare = 1.0F / static_cast<float>(kPointsASide * kPointsASide);
  for (int64_t from = 0; from < views; ++from) {
    const Camera& camera = scene.views.cameras[static_cast<size_t>(from)];
    const Eigen::Matrix3d back = camera.intrinsics.inverse();
    for (int64_t to = 0; to < views; ++to) {
      if (to == from) continue;
      const Camera& other = scene.views.cameras[static_cast<size_t>(to)];
      const Eigen::Isometry3d other_from_camera = other.camera_from_world() * camera.world_from_camera;
      for (int64_t token = 0; token < tokens; ++token) {
        for (int64_t point = 0; point < kPointsASide * kPointsASide; ++point) {
          const int64_t row = token / columns * patch_size +
                              (2 * (point / kPointsASide) + 1) * patch_size / (2 * kPointsASide);
          const int64_t column = token % columns * patch_size +
                                 (2 * (point % kPointsASide) + 1) * patch_size / (2 * kPointsASide);
          const double distance = depth_at(from, row, column);
          if (distance <= 0) continue;
          const Eigen::Vector3d ray =
              back * Eigen::Vector3d(static_cast<double>(column) + 0.5, static_cast<double>(row) + 0.5, 1);
          const Eigen::Vector3d seen = other.intrinsics * (other_from_camera * (ray * distance));
          if (seen.z() <= 0) continue;
          const double x = seen.x() / seen.z(), y = seen.y() / seen.z();
          if (!(x >= 0 && y >= 0 && x < static_cast<double>(width) && y < static_cast<double>(height))) {
            continue;
          }
          const auto hit_row = static_cast<int64_t>(y), hit_column = static_cast<int64_t>(x);
          const double there = depth_at(to, hit_row, hit_column);
          if (std::abs(there - seen.z()) > kDepthAgreement * seen.z()) continue;
          const int64_t hit = std::min(hit_row / patch_size * columns + hit_column / patch_size, tokens - 1);
          shares[((from * tokens + token) * views + to) * tokens + hit] += kShare;
        }
      }
    }
  }
  return result;
}

torch::Tensor correspondence_loss(const AttentionTap& tap, const TokenCorrespondence& truth,
                                  const CorrespondenceKeys& keys) {
  const int64_t views = truth.shares.size(0), tokens = truth.shares.size(1);
  const int64_t heads = tap.query.size(2), head_dim = tap.query.size(3);
  const auto patches = [&](const torch::Tensor& x, int64_t of_views) {
    return x.view({views, keys.prefix_tokens + tokens, heads, head_dim})
        .narrow(0, 0, of_views)
        .narrow(1, keys.prefix_tokens, tokens)
        .reshape({of_views * tokens, heads, head_dim});
  };
  const auto device = tap.query.device();
  // (queries, keys): own view left out (its shares are zero), the rest made to sum to 1.
  const auto shares =
      truth.shares.narrow(2, 0, keys.views).reshape({views * tokens, keys.views * tokens}).to(device);
  const auto seen = shares.sum(1);
  const auto rows = torch::nonzero(seen > 0).squeeze(1);
  if (rows.numel() == 0) return {};
  const auto wanted = shares.index_select(0, rows) / seen.index_select(0, rows).unsqueeze(1);
  const auto view_of = torch::arange(views, torch::TensorOptions().dtype(torch::kInt64).device(device))
                           .repeat_interleave(tokens);
  const auto own =
      view_of.index_select(0, rows).unsqueeze(1) == view_of.narrow(0, 0, keys.views * tokens).unsqueeze(0);
  const auto query = patches(tap.query, views).index_select(0, rows).transpose(0, 1);
  const auto key = patches(tap.key, keys.views).permute({1, 2, 0});
  const auto logits = torch::matmul(query, key) / std::sqrt(static_cast<double>(head_dim));
  // (heads, rows, keys); a finite stand-in for -inf, because wanted is 0 there and 0 * -inf is not a number.
  const auto log_shares = torch::log_softmax(logits.masked_fill(own, -1e9), 2).logsumexp(0) -
                          std::log(static_cast<double>(heads));
  return -(wanted * log_shares).sum() / static_cast<double>(rows.numel());
}

}  // namespace gld
