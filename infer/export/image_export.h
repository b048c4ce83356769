#pragma once

#include "datasets/images/image.h"
#include "gld/report/provenance.h"

#include <cstdint>
#include <filesystem>
#include <string>

namespace gld {

// Returns "view_03", the name of a view in every output folder; it has three digits from 100 views on.
std::string view_name(int64_t view, int64_t num_views);

// Writes a PNG with its provenance and further texts; the file appears whole or not at all.
void export_image(const std::filesystem::path& file, const Image& image, const Provenance& provenance,
                  const TextItems& more = {});

}  // namespace gld
