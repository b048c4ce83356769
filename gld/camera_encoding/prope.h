#pragma once

#include "gld/cameras/camera.h"
#include "gld/cameras/relative_cameras.h"

#include <cstdint>
#include <vector>

#include <torch/types.h>

namespace gld {

// The tables of PRoPE ("Cameras as Relative Positional Encoding"; DESIGN.md section 4) for one scene, computed
// once. Of each head's channels the first half is multiplied, in groups of 4, by a 4x4 matrix of the token's
// view; the third quarter rotates with the token's column and the last quarter with its row, split-half
// convention. Prefix (special) tokens in front of each view's patch tokens pass through unchanged.
struct PropeTables {
  LatentGrid grid;
  int64_t prefix_tokens = 0;       // per view
  torch::Tensor query_matrix;      // (views, 4, 4) P^T, float32
  torch::Tensor key_value_matrix;  // (views, 4, 4) P^-1
  torch::Tensor output_matrix;     // (views, 4, 4) P
  torch::Tensor column_cos;        // (grid width, head_dim / 8)
  torch::Tensor column_sin;
  torch::Tensor row_cos;  // (grid height, head_dim / 8)
  torch::Tensor row_sin;
};

// What stands for P^-1: the published code multiplies [R | t]^-1 by K_norm itself (a slip that its checkpoints
// were trained with); the true inverse multiplies by K_norm^-1.
enum class PropeInverse { kPublished, kTrue };

// Which cameras a branch of guidance sees: those of the scene; the identity as pose and as intrinsics in pixels,
// before they are normalised; or the identity as pose with the scene's intrinsics (the released cascade).
enum class PropeCameras { kScene, kIdentity, kIdentityPose };

// The frame that projections start from. Between patch tokens it cancels. It does not between a patch token and a
// special token, which is not encoded; the published code uses the world's frame as the dataset gives it.
enum class PropeFrame { kReferenceView, kWorld };

struct PropeLayout {
  LatentGrid grid;
  int64_t prefix_tokens = 0;
  int64_t head_dim = 0;  // a multiple of 8
  // The intrinsics are normalised by so many pixels; 0 is for each view's own size.
  int64_t image_size = 0;
  PropeInverse inverse = PropeInverse::kPublished;
  // Taken only where there are prefix tokens; otherwise always the reference view's, which loses no digits.
  PropeFrame frame = PropeFrame::kReferenceView;
};

// Returns the tables of a scene. Matrices and angles are computed in double and cast to the dtype of options (float32,
// or float64 for reference computations). Throws Error when head_dim is no multiple of 8 or the views are not those of
// the grid.
PropeTables make_prope_tables(const RelativeCameras& cameras, const PropeLayout& layout, PropeCameras which,
                              const torch::TensorOptions& options = torch::kFloat32);

// Gives the same encoding of scalar products and outputs with the key and value matrix moved into the query and output
// matrices; it is exact where every view has the same P, as in the unconditional branch of one intrinsics for all.
// Returns the tables unchanged where the views differ, or where there are prefix tokens, which meet keys and values
// without being encoded themselves.
PropeTables fold_shared_camera(const PropeTables& tables);

// Returns all of a table's tensors, in the order of their declaration.
std::vector<torch::Tensor*> table_tensors(PropeTables& tables);

PropeTables prope_tables_on(const PropeTables& tables, torch::Device device);

// x is (1, views * (prefix + grid), heads, head_dim), and the result has the same shape. It is differentiable in x.
torch::Tensor encode_query(const PropeTables& tables, const torch::Tensor& x);      // by P^T
torch::Tensor encode_key_value(const PropeTables& tables, const torch::Tensor& x);  // by P^-1
torch::Tensor encode_output(const PropeTables& tables, const torch::Tensor& x);     // by P, rotated back

}  // namespace gld
