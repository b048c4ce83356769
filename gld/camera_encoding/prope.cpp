#include "gld/camera_encoding/prope.h"

#include "gld/base/error.h"

#include <cmath>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {
namespace {

constexpr double kRotationBase = 100.0;

torch::Tensor to_tensor(const std::vector<Eigen::Matrix4d>& matrices, const torch::TensorOptions& options) {
  auto tensor = torch::empty({static_cast<int64_t>(matrices.size()), 4, 4}, torch::kFloat64);
  auto* out = tensor.data_ptr<double>();
  for (const Eigen::Matrix4d& matrix : matrices) {
    for (int row = 0; row < 4; ++row) {
      for (int column = 0; column < 4; ++column) *out++ = matrix(row, column);
    }
  }
  return tensor.to(options);
}

// Returns the angles position * 100^(-i / (head_dim / 8)), (positions, head_dim / 8), in double.
torch::Tensor rotation_angles(int64_t positions, int64_t head_dim) {
  const int64_t frequencies = head_dim / 8;
  auto angles = torch::empty({positions, frequencies}, torch::kFloat64);
  auto* out = angles.data_ptr<double>();
  for (int64_t position = 0; position < positions; ++position) {
    for (int64_t i = 0; i < frequencies; ++i) {
      *out++ = static_cast<double>(position) *
               std::pow(kRotationBase, -static_cast<double>(i) / static_cast<double>(frequencies));
    }
  }
  return angles;
}

Eigen::Matrix4d inverse_lifted(const Eigen::Matrix4d& lifted) {
  Eigen::Matrix4d inverse = Eigen::Matrix4d::Identity();
  inverse(0, 0) = 1.0 / lifted(0, 0);
  inverse(1, 1) = 1.0 / lifted(1, 1);
  inverse(0, 2) = -lifted(0, 2) / lifted(0, 0);
  inverse(1, 2) = -lifted(1, 2) / lifted(1, 1);
  return inverse;
}

void check_layout(const RelativeCameras& cameras, const PropeLayout& layout) {
  if (layout.head_dim <= 0 || layout.head_dim % 8 != 0) {
    fail({"camera encoding (PRoPE)", "a head size that is a multiple of 8", std::to_string(layout.head_dim),
          "choose num_heads so that hidden_size / num_heads is a multiple of 8"});
  }
  if (cameras.views.size() != layout.grid.views) {
    fail({"camera encoding (PRoPE)", "one camera for each of " + std::to_string(layout.grid.views) + " views",
          std::to_string(cameras.views.size()), "pass the cameras of the scene"});
  }
}

// Rotates x (views, height, width, heads, channels) by halves; cosine and sine broadcast to half of it.
torch::Tensor rotate(const torch::Tensor& x, const torch::Tensor& cosine, const torch::Tensor& sine) {
  const int64_t half = x.size(-1) / 2;
  const auto a = x.narrow(-1, 0, half);
  const auto b = x.narrow(-1, half, half);
  return torch::cat({cosine * a + sine * b, cosine * b - sine * a}, -1);
}

torch::Tensor encode(const PropeTables& tables, const torch::Tensor& x, const torch::Tensor& matrix,
                     double rotation_sign) {
  const auto& grid = tables.grid;
  const int64_t per_view = tables.prefix_tokens + grid.tokens_per_view();
  const int64_t head_dim = tables.column_cos.size(1) * 8;
  if (x.dim() != 4 || x.size(0) != 1 || x.size(1) != grid.views * per_view || x.size(3) != head_dim) {
    fail({"camera encoding (PRoPE)",
          c10::str("(1, ", grid.views, " views of ", per_view, " tokens, heads, ", head_dim, ")"),
          c10::str(x.sizes()), "build the tables for this token grid and head size"});
  }
  const int64_t heads = x.size(2);
  const auto by_view = x.reshape({grid.views, per_view, heads, head_dim});
  const auto patches = by_view.narrow(1, tables.prefix_tokens, grid.tokens_per_view());
  const int64_t half = head_dim / 2, quarter = head_dim / 4;

  const auto projected =
      torch::bmm(patches.narrow(3, 0, half).reshape({grid.views, -1, 4}), matrix.transpose(1, 2))
          .view({grid.views, grid.tokens_per_view(), heads, half});
  const auto on_grid = patches.unflatten(1, std::vector<int64_t>{grid.height, grid.width});
  const auto columns = rotate(on_grid.narrow(4, half, quarter), tables.column_cos.unsqueeze(1),
                              rotation_sign * tables.column_sin.unsqueeze(1));
  const auto rows =
      rotate(on_grid.narrow(4, half + quarter, quarter), tables.row_cos.unsqueeze(1).unsqueeze(1),
             rotation_sign * tables.row_sin.unsqueeze(1).unsqueeze(1));
  auto encoded = torch::cat({projected, columns.flatten(1, 2), rows.flatten(1, 2)}, -1);
  if (tables.prefix_tokens > 0) {
    encoded = torch::cat({by_view.narrow(1, 0, tables.prefix_tokens), encoded}, 1);
  }
  return encoded.view({1, grid.views * per_view, heads, head_dim});
}

}  // namespace

PropeTables make_prope_tables(const RelativeCameras& cameras, const PropeLayout& layout, PropeCameras which,
                              const torch::TensorOptions& options) {
  check_layout(cameras, layout);
  std::vector<Eigen::Matrix4d> query, key_value, output;
  const bool world = layout.frame == PropeFrame::kWorld && layout.prefix_tokens > 0;
  for (const Camera& camera : (world ? cameras.world_views : cameras.views).cameras) {
    const bool scene_pose = which == PropeCameras::kScene;
    const Eigen::Isometry3d reference_from_camera =
        scene_pose ? camera.world_from_camera : Eigen::Isometry3d::Identity();
    const Eigen::Matrix3d intrinsics =
        which == PropeCameras::kIdentity ? Eigen::Matrix3d::Identity() : camera.intrinsics;
    const auto size = [&](int64_t own) {
      return static_cast<double>(layout.image_size > 0 ? layout.image_size : own);
    };
    const Eigen::Matrix4d lifted = lifted_intrinsics(intrinsics, size(camera.width), size(camera.height));
    const Eigen::Matrix4d projection = lifted * reference_from_camera.inverse().matrix();
    const Eigen::Matrix4d last = layout.inverse == PropeInverse::kPublished ? lifted : inverse_lifted(lifted);
    query.emplace_back(projection.transpose());
    key_value.emplace_back(reference_from_camera.matrix() * last);
    output.push_back(projection);
  }
  PropeTables tables;
  tables.grid = layout.grid;
  tables.prefix_tokens = layout.prefix_tokens;
  tables.query_matrix = to_tensor(query, options);
  tables.key_value_matrix = to_tensor(key_value, options);
  tables.output_matrix = to_tensor(output, options);
  const auto columns = rotation_angles(layout.grid.width, layout.head_dim);
  const auto rows = rotation_angles(layout.grid.height, layout.head_dim);
  tables.column_cos = columns.cos().to(options);
  tables.column_sin = columns.sin().to(options);
  tables.row_cos = rows.cos().to(options);
  tables.row_sin = rows.sin().to(options);
  return tables;
}

PropeTables fold_shared_camera(const PropeTables& tables) {
  const auto same_for_all = [](const torch::Tensor& matrices) {
    return torch::equal(matrices, matrices.narrow(0, 0, 1).expand_as(matrices));
  };
  if (tables.prefix_tokens > 0) return tables;
  if (!same_for_all(tables.output_matrix) || !same_for_all(tables.key_value_matrix)) return tables;
  // (P^T q) . (P^-1 k) = (M^T q) . k and P sum(w P^-1 v) = M sum(w v), with M = P P^-1, which is the identity for
  // the true inverse only.
  PropeTables folded = tables;
  const auto product =
      torch::bmm(tables.output_matrix.to(torch::kFloat64), tables.key_value_matrix.to(torch::kFloat64))
          .to(tables.output_matrix.options());
  folded.query_matrix = product.transpose(1, 2).contiguous();
  folded.output_matrix = product;
  folded.key_value_matrix = torch::eye(4, product.options()).expand({tables.grid.views, 4, 4}).contiguous();
  return folded;
}

std::vector<torch::Tensor*> table_tensors(PropeTables& tables) {
  return {&tables.query_matrix, &tables.key_value_matrix, &tables.output_matrix, &tables.column_cos,
          &tables.column_sin,   &tables.row_cos,          &tables.row_sin};
}

PropeTables prope_tables_on(const PropeTables& tables, torch::Device device) {
  PropeTables moved = tables;
  for (torch::Tensor* table : table_tensors(moved)) *table = table->to(device);
  return moved;
}

torch::Tensor encode_query(const PropeTables& tables, const torch::Tensor& x) {
  return encode(tables, x, tables.query_matrix, 1.0);
}

torch::Tensor encode_key_value(const PropeTables& tables, const torch::Tensor& x) {
  return encode(tables, x, tables.key_value_matrix, 1.0);
}

torch::Tensor encode_output(const PropeTables& tables, const torch::Tensor& x) {
  return encode(tables, x, tables.output_matrix, -1.0);
}

}  // namespace gld
