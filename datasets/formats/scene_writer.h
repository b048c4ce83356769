#pragma once

#include "datasets/scenes/scene.h"

#include <filesystem>
#include <string>
#include <vector>

namespace gld {

// Writes a scene with images (PNG where the layout allows it) in one of the layouts that the readers know (all but
// HyperSim's, whose files are HDF5, and ScanNet's two, which are only read), so that they can be tested end to end and
// other programs can use generated scenes. The folder is created; files appear whole or not at all.
//   cameras-json  cameras.json, images/, depth/*.npy
//   npz           nerfstudio/images_4/frame_*.png + .npz
//   nerfstudio    transforms.json, images/, depth/*.npy
//   re10k         CLIP.txt, CLIP/TIME.png
//   tartanair     image_left/, depth_left/, pose_left.txt
//   colmap        sparse/0/*.bin, images/
//   colmap-text   sparse/0/*.txt, images/
//   eth3d         dslr_calibration_jpg/, images/dslr_images/, ground_truth_depth/
// Throws Error when the layout cannot hold the scene's cameras (TartanAir has one lens) or the name is unknown.
void write_scene(const Scene& scene, const std::string& layout, const std::filesystem::path& folder);

std::vector<std::string> scene_layout_names();

}  // namespace gld
