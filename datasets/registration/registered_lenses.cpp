#include "datasets/registration/registered_lenses.h"

#include <algorithm>
#include <map>

namespace gld {

double exif_focal_length(const std::vector<UnregisteredPhotograph>& photographs, int64_t lens) {
  std::vector<double> known;
  for (const UnregisteredPhotograph& photograph : photographs) {
    if (photograph.lens == lens && photograph.focal_length > 0) known.push_back(photograph.focal_length);
  }
  if (known.empty()) return 0;
  const auto middle = known.begin() + static_cast<std::ptrdiff_t>(known.size() / 2);
  std::nth_element(known.begin(), middle, known.end());
  return *middle;
}

LensCamera lens_camera(const UnregisteredPhotograph& photograph, double focal_length, double k1) {
  LensCamera camera;
  camera.width = photograph.width;
  camera.height = photograph.height;
  camera.intrinsics(0, 0) = camera.intrinsics(1, 1) = focal_length * photograph.longer_side();
  camera.intrinsics(0, 2) = static_cast<double>(photograph.width) / 2;
  camera.intrinsics(1, 2) = static_cast<double>(photograph.height) / 2;
  if (k1 != 0) {
    camera.lens.model = LensModel::kRadialTangential;
    camera.lens.k1 = k1;
  }
  return camera;
}

void add_lenses(Registration& registration, const std::vector<UnregisteredPhotograph>& photographs) {
  std::map<int64_t, RegisteredLens> by_number;
  for (size_t i = 0; i < photographs.size(); ++i) {
    const RegisteredPhotograph& found = registration.photographs[i];
    if (!found.registered) continue;
    const int64_t number = photographs[i].lens;
    RegisteredLens& lens = by_number[number];
    if (++lens.photographs > 1) continue;
    lens.number = number;
    lens.focal_length = found.camera.intrinsics(0, 0) / photographs[i].longer_side();
    lens.exif_focal_length = exif_focal_length(photographs, number);
    lens.distortion = found.camera.lens;
  }
  for (const auto& [number, lens] : by_number) registration.lenses.push_back(lens);
}

}  // namespace gld
