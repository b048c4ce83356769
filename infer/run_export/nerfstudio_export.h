#pragma once

#include "gld/report/provenance.h"
#include "infer/run_export/finished_run.h"

#include <filesystem>

namespace gld {

// Writes folder/transforms.json with what it names: images/view_XX.png, depth/view_XX.png (16 bit, their unit as
// "depth_unit_scale_factor") and points.ply ("ply_file_path"), the run's own files. Depth and cloud are left out where
// the run has none; depth units of one run are one. The folder has to exist.
void export_nerfstudio(const std::filesystem::path& folder, const FinishedRun& run,
                       const TextItems& provenance);

}  // namespace gld
