#include "infer/export/ray_export.h"

#include "datasets/images/image.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "gld/files/npy.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <string>

#include <nlohmann/json.hpp>

namespace gld {
namespace {

bool all_finite(const float* values, int count) {
  return std::all_of(values, values + count, [](float value) { return std::isfinite(value); });
}

NpyArray provenance_array(const Provenance& provenance) {
  nlohmann::ordered_json object;
  for (const auto& [name, text] : provenance_items(provenance)) object[name] = text;
  const std::string text = json_text(object);
  NpyArray array;
  array.dtype = DType::kUInt8;
  array.shape = {static_cast<int64_t>(text.size())};
  array.bytes.assign(text.begin(), text.end());
  return array;
}

}  // namespace

int64_t export_rays(const std::filesystem::path& file, const RayMap& rays, const ConfidenceMap& confidence,
                    const Provenance& provenance) {
  if (rays.empty()) fail({file.string(), "a ray map with values", "an empty one", "check what made it"});
  if (!confidence.empty() && (confidence.width != rays.width || confidence.height != rays.height)) {
    fail({file.string(), "confidences of the rays' size " + size_text(rays.width, rays.height),
          size_text(confidence.width, confidence.height), "check what made them"});
  }
  RayMap written = rays;
  ConfidenceMap weights = confidence;
  if (weights.empty()) {
    weights = ConfidenceMap(rays.width, rays.height);
    std::fill(weights.values.begin(), weights.values.end(), 1.0F);
  }
  int64_t not_finite = 0;
  for (int64_t y = 0; y < rays.height; ++y) {
    for (int64_t x = 0; x < rays.width; ++x) {
      if (all_finite(written.ray(x, y), 6) && std::isfinite(weights.at(x, y))) continue;
      std::fill_n(written.ray(x, y), 6, 0.0F);
      weights.at(x, y) = 0;
      ++not_finite;
    }
  }
  std::map<std::string, NpyArray> arrays;
  arrays["rays"] = npy_from_floats({rays.height, rays.width, 6}, written.values.data());
  arrays["confidence"] = npy_from_floats({rays.height, rays.width}, weights.values.data());
  arrays["provenance"] = provenance_array(provenance);
  write_npz(file, arrays);
  return not_finite;
}

}  // namespace gld
