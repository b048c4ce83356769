#pragma once

#include "datasets/images/image.h"
#include "datasets/scenes/scene.h"
#include "gld/cameras/image_size.h"
#include "gld/machine/stage_record.h"
#include "gld/report/provenance.h"
#include "gld/report/run_folder.h"
#include "infer/pipeline/photo_cameras.h"
#include "infer/pipeline/photo_selection.h"
#include "infer/pipeline/sampling_pipeline.h"

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// A photograph as its file's header tells, turned upright as EXIF says.
struct Photograph {
  std::string name;
  std::filesystem::path file;
  int64_t width = 0, height = 0;  // pixels
};

// Image files, and folders whose image files are taken in natural order. Decodes nothing. Throws Error for no
// photograph and for two of one name.
std::vector<Photograph> list_photographs(const std::vector<std::string>& files_and_folders);

// What can be said of a scene before its cameras are known: names, numbers and sizes of its frames. The cameras, side
// by side, only stand in for those that follow; there are no pixels.
Scene scene_before_cameras(const std::vector<Photograph>& photographs);

// Photographs without cameras, made a scene by a geometry model (gld sample --photos).
struct PhotoScene {
  Scene scene;                // a frame a photograph, at the model's size, with its estimated camera
  std::vector<Image> images;  // the same pictures
  PhotoCameras found;
  std::string text;  // what was found and how sure it is, for people
};

// size: that of the pictures which the model sees. geometry: the models that see the cameras (bundle_models.h). Records
// what the model takes as kPhotoCamerasStage and apart from it the fitting of cameras to what it sees. Throws Error for
// a photograph that no camera fits.
PhotoScene photo_scene(const std::vector<Photograph>& photographs, PhotoLens lens, const ImageSize& size,
                       const PipelineModels& geometry, const torch::Device& device, StageRecords& stages);

// photo_scene/ in the run folder: a scene that every command reads, cameras.json beside the pictures.
void write_photo_scene(RunFolder& run, const PhotoScene& photos, const Provenance& provenance);

// For report.json.
nlohmann::ordered_json photo_scene_json(const PhotoScene& photos);

}  // namespace gld
