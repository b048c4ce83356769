#include "infer/verify/reference_runners.h"
#include "models/decoders/dpt_head.h"
#include "models/weights/weight_loading.h"

#include <string>
#include <vector>

namespace gld {
namespace {

// The module's configuration and the size of the case's images.
struct DptHeadCaseOptions : DptHeadOptions {
  int64_t height = 504;
  int64_t width = 504;

  void visit(FieldVisitor& visitor) override {
    DptHeadOptions::visit(visitor);
    visitor.integer({"height", "image height in pixels"}, height, {1, 1 << 16});
    visitor.integer({"width", "image width in pixels"}, width, {1, 1 << 16});
  }
};

}  // namespace

NamedTensors run_dpt_head_case(const ReferenceCase& reference) {
  DptHeadCaseOptions options;
  reference.read_config(options);
  DptHead head(options, {});
  WeightSelection selection;
  selection.prefix = DptHead::kPrefix;
  load_strict(head, reference.weight_file(), selection);

  LatentGrid grid;
  grid.height = options.height / options.patch_size;
  grid.width = options.width / options.patch_size;
  std::vector<torch::Tensor> levels;
  for (int level = 0; level < 4; ++level) {
    levels.push_back(
        reference.input("level" + std::to_string(level), {-1, grid.tokens_per_view(), options.dim_in}));
  }
  grid.views = levels[0].size(0);
  const auto maps = head.forward(levels, grid, GeometryMaps::kDepthAndRays);
  return {{"depth", maps.depth},
          {"depth_conf", maps.depth_confidence},
          {"ray", maps.rays},
          {"ray_conf", maps.ray_confidence}};
}

}  // namespace gld
