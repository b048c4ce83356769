#include "infer/run_export/nerfstudio_export.h"

#include "datasets/formats/nerfstudio_writer.h"
#include "gld/base/atomic_folder.h"
#include "infer/export/image_export.h"

namespace gld {

void export_nerfstudio(const std::filesystem::path& folder, const FinishedRun& run,
                       const TextItems& provenance) {
  std::filesystem::create_directories(folder / "images");
  Transforms transforms;
  transforms.comments = provenance;
  const auto count = static_cast<int64_t>(run.views.size());
  for (const RunView& view : run.views) {
    const std::string name = view_name(static_cast<int64_t>(transforms.frames.size()), count) + ".png";
    TransformsFrame frame;
    frame.image = "images/" + name;
    frame.camera = view.camera;
    copy_file_atomically(view.image, folder / frame.image);
    if (view.has_depth()) {
      std::filesystem::create_directories(folder / "depth");
      frame.depth = "depth/" + name;
      transforms.depth_unit = view.depth_unit;
      copy_file_atomically(view.depth, folder / frame.depth);
    }
    transforms.frames.push_back(frame);
  }
  if (!run.cloud.empty()) {
    transforms.point_cloud = "points.ply";
    copy_file_atomically(run.cloud, folder / transforms.point_cloud);
  }
  write_transforms_json(folder / "transforms.json", transforms);
}

}  // namespace gld
