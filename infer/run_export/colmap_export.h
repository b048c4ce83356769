#pragma once

#include "gld/report/provenance.h"
#include "infer/export/point_cloud.h"
#include "infer/run_export/finished_run.h"

#include <cstdint>
#include <filesystem>

namespace gld {

// What a COLMAP model of a run says of a cloud: which views see each point, and where.
struct ColmapCounts {
  int64_t points = 0;
  int64_t sightings = 0;
  int64_t seen_once = 0;     // points that one view sees alone
  int64_t seen_nowhere = 0;  // points without a track
};

// Writes folder/images/view_XX.png (the run's own files), folder/sparse/0/*.bin and folder/sparse_txt/*.txt: a PINHOLE
// camera a view, and the cloud, each point with the views whose depth shows it. A point is seen in a view where it lies
// inside of the picture and at the depth that the view has there, within 5 %. It is sighted exactly where it projects
// to, so the error of a point is not that of its sightings but how far the views' own depths disagree about them: the
// mean distance in pixels from where one of its views sees it to where another one's depth carries it; -1 (COLMAP's
// "not known") where fewer than two views see it. The folder has to exist.
ColmapCounts export_colmap(const std::filesystem::path& folder, const FinishedRun& run,
                           const PointCloud& cloud, const TextItems& provenance);

}  // namespace gld
