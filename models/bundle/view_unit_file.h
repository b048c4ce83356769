#pragma once

#include "models/bundle/bundle.h"
#include "models/decoders/single_view_unit.h"

#include <memory>

namespace gld {

// How a geometry head's unit is guessed of one view alone, as gld stats fits it beside the statistics:
// single_view_unit.safetensors in the bundle's folder, beside its parts and in its content hash. A bundle may lack it:
// the unit is the usual one then (BundleOptions::single_source_unit).
constexpr const char* kSingleViewUnitFile = "single_view_unit.safetensors";

// Names the backbone and the head, which the bundle has, by the SHA-256 of their files.
void write_single_view_unit(const ModelBundle& bundle, const SingleViewUnit& unit);

// Returns null where the bundle has no such file, or one of another backbone or head. Throws Error, naming the file,
// for a damaged one.
std::shared_ptr<const SingleViewUnit> read_single_view_unit(const ModelBundle& bundle);

}  // namespace gld
