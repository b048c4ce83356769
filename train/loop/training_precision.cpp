#include "train/loop/training_precision.h"

#include "gld/base/error.h"
#include "gld/tensors/torch_version.h"

namespace gld {

void set_training_precision(Objective& objective, ComputePrecision precision) {
  const torch::Device device = objective.device();
  const bool reduced = precision != ComputePrecision::kFloat32;
  const bool autocast = precision == ComputePrecision::kBFloat16 && has_bfloat16_autocast(device);
  if (reduced && !device.is_cpu() && !autocast) {
    fail({"loop.precision", "one that is computed on " + device.str(), compute_precision_name(precision),
          "set loop.precision to float32, or to bfloat16 on CUDA"});
  }
  if (!device.is_cpu()) return;  // autocast, of the loss alone
  const int64_t following = objective.learn_in(precision);
  if (reduced && following == 0) {
    fail({"loop.precision", "float32: nothing that is trained here has linear layers of blocks",
          compute_precision_name(precision), "leave it out"});
  }
}

}  // namespace gld
