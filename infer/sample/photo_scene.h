#pragma once

#include "datasets/images/image.h"
#include "datasets/scenes/scene.h"
#include "gld/cameras/image_size.h"
#include "gld/report/provenance.h"
#include "gld/report/run_folder.h"
#include "infer/pipeline/photo_cameras.h"
#include "infer/pipeline/photo_selection.h"
#include "infer/pipeline/sampling_pipeline.h"
#include "models/bundle/bundle_options.h"

#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// Photographs without cameras, made a scene by a geometry model (gld sample --photos).
struct PhotoScene {
  Scene scene;                // a frame a photograph, at the model's size, with its estimated camera
  std::vector<Image> images;  // the same pictures
  PhotoCameras found;
  std::string text;  // what was found and how sure it is, for people
};

// Image files, and folders whose image files are taken in natural order; turned upright as EXIF says. size is that
// of --size. Throws Error for no photograph, two of one name, and one that no camera fits.
// geometry: the models that see the cameras (bundle_models.h).
PhotoScene photo_scene(const PhotoSelection& selection, const std::string& size, const BundleOptions& bundle,
                       const PipelineModels& geometry, const torch::Device& device);

// photo_scene/ in the run folder: a scene that every command reads, cameras.json beside the pictures.
void write_photo_scene(RunFolder& run, const PhotoScene& photos, const Provenance& provenance);

// For report.json.
nlohmann::ordered_json photo_scene_json(const PhotoScene& photos);

}  // namespace gld
