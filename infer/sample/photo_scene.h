#pragma once

#include "datasets/images/image.h"
#include "datasets/registration/registration.h"
#include "datasets/scenes/scene.h"
#include "gld/cameras/image_size.h"
#include "gld/machine/stage_record.h"
#include "gld/photogrammetry/source_depth.h"
#include "gld/report/provenance.h"
#include "gld/report/run_folder.h"
#include "infer/pipeline/sampling_pipeline.h"
#include "infer/request/photo_cameras.h"
#include "infer/request/photo_selection.h"

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// A photograph as its file's header tells, turned upright as EXIF says.
struct Photograph {
  std::string name;
  std::filesystem::path file;
  int64_t width = 0, height = 0;  // pixels
  double focal_length = 0;        // by EXIF, over the longer side; 0 where nothing tells
};

// Lists image files, folders whose image files are taken in natural order, and videos, whose chosen pictures are put
// into frames_folder. It decodes nothing but these. Throws Error for no photograph and for two of one name.
std::vector<Photograph> list_photographs(const PhotoSelection& selection,
                                         const std::filesystem::path& frames_folder);

// Returns what can be said of a scene before its cameras are known: names, numbers and sizes of its frames. The
// cameras, side by side, only stand in for those that follow; there are no pixels.
Scene scene_before_cameras(const std::vector<Photograph>& photographs);

// Photographs without cameras, made a scene (gld sample --photos).
struct PhotoScene {
  // A frame a photograph with its camera, at a whole multiple of the model's size; those without a camera are left out.
  Scene scene;
  std::vector<Image> images;  // the same pictures
  // One of the two is there: cameras from what photographs share, or from what a geometry model sees.
  std::optional<Registration> registration;
  std::optional<PhotoCameras> seen;
  std::vector<UnregisteredPhotograph> photographs;  // all that were given
  std::vector<std::string> passed_over;  // ways that were tried before and found nothing, a sentence each
  double median_depth = 0;               // of what the photographs show
  // Of a single photograph it is what the model that saw its camera sees, whose unit is the camera's. Of more, they
  // tell it.
  std::optional<SourceDepth> depth;
  std::string text;  // what was found and how sure it is, for people
};

// Returns whether the cameras of so many photographs can come from a geometry model alone.
bool only_rays(const PhotoSelection& selection, size_t photographs);

struct PhotoSceneRequest {
  PhotoSelection selection;
  ImageSize size;  // that the models see
  // Photographs are kept as large as they were taken, in whole multiples of the size, of which the longer side is at
  // most so many pixels.
  int64_t largest_side = 0;
  // It gives the models that see cameras (bundle_models.h), when they are needed; it is empty where there are none.
  std::function<PipelineModels()> geometry;
  torch::Device device = torch::kCPU;
  int threads = 1;
};

// Records registration as one stage; or what the model takes as kPhotoCamerasStage and apart from it the fitting of
// cameras to what it sees. Throws Error where nothing that the selection allows finds cameras.
PhotoScene photo_scene(const std::vector<Photograph>& photographs, const PhotoSceneRequest& request,
                       StageRecords& stages);

// Writes photo_scene/ in the run folder: a scene that every command reads, cameras.json beside the pictures and, where
// there are any, the sparse points.
void write_photo_scene(RunFolder& run, const PhotoScene& photos, const Provenance& provenance);

// Returns what report.json has of it.
nlohmann::ordered_json photo_scene_json(const PhotoScene& photos);

}  // namespace gld
