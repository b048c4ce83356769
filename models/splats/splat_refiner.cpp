#include "models/splats/splat_refiner.h"

namespace gld {

bool has_splat_refiner(const ModelBundle& bundle) {
  // Such refiners are of autoencoders, which have one level.
  return bundle.options().refiner.repairs_splats() && bundle.has(BundlePart::refiner()) &&
         bundle.has(BundlePart::statistics(0));
}

}  // namespace gld
