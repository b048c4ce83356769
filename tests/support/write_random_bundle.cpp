// gld_write_random_bundle FOLDER small|released|released-vggt|MODEL.yaml [SEED] writes a model bundle with random
// weights, for measurements and tests. "released" has the published sizes, 7.5 GB written tensor by tensor,
// "released-vggt" has those with VGGT (10 GB).

#include "gld/base/configuration.h"
#include "models/bundle/published_backbones.h"
#include "models/bundle/random_bundle.h"

#include <exception>
#include <iostream>
#include <string>

namespace {

gld::BundleOptions options_from(const std::string& sizes) {
  if (sizes == "small") return gld::small_bundle_options();
  if (sizes == "released") return gld::released_da3_options();
  if (sizes == "released-vggt") return gld::released_vggt_options();
  gld::BundleOptions options;
  gld::load_yaml(options, sizes);
  gld::check_options(options, sizes);
  return options;
}

}  // namespace

int main(int count, char** words) {
  if (count < 3 || count > 4) {
    std::cerr << "usage: gld_write_random_bundle FOLDER small|released|released-vggt|MODEL.yaml [SEED]\n";
    return 2;
  }
  try {
    const uint64_t seed = count == 4 ? std::stoull(words[3]) : 0;
    gld::write_random_bundle(words[1], options_from(words[2]), seed);
  } catch (const std::exception& error) {
    std::cerr << error.what() << "\n";
    return 1;
  }
  return 0;
}
