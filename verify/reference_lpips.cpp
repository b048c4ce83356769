#include "models/losses/lpips.h"
#include "models/weights/weight_loading.h"
#include "verify/reference_runners.h"

namespace gld {

NamedTensors run_lpips_case(const ReferenceCase& reference) {
  LpipsOptions options;
  reference.read_config(options);
  Lpips lpips(options, reference.placement());
  WeightSelection selection;
  selection.ignored = {{"classifier.*", "torchvision's classifier, which LPIPS does not use"}};
  load_strict(lpips, reference.weight_file(), selection);
  const auto image = reference.module_input("image", {-1, 3, -1, -1});
  const auto prediction = reference.module_input("prediction", image.sizes().vec());
  return {{"lpips", lpips.forward(image, prediction)}};
}

}  // namespace gld
