#pragma once

#include "gld/photogrammetry/view_maps.h"
#include "gld/report/provenance.h"

#include <cstdint>
#include <filesystem>

namespace gld {

// Writes an npz file (docs/FILES.md) with the arrays
//   rays        float32 (height, width, 6): direction, origin, in the frame of the geometry head
//   confidence  float32 (height, width); 0 marks a ray that is not known
//   provenance  uint8, UTF-8 text: a JSON object of the provenance's items
// A ray or confidence with a value that is not finite becomes a ray of zeros with confidence 0. confidence may be
// empty: it is then 1 everywhere. Returns the number of rays that were not finite. Writing is atomic. Throws Error when
// the sizes differ.
int64_t export_rays(const std::filesystem::path& file, const RayMap& rays, const ConfidenceMap& confidence,
                    const Provenance& provenance);

}  // namespace gld
