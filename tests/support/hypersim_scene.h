#pragma once

#include "datasets/scenes/scene.h"
#include "gld/files/hdf5_array.h"

#include <filesystem>
#include <string>

namespace gld::test {

// Writes one float32 dataset with libhdf5.
void write_hdf5(const std::filesystem::path& file, const std::string& dataset, const Hdf5Array& array);

// Writes a scene as HyperSim has them: _detail/, images/, metadata_camera_parameters.csv. All frames have the first
// one's lens. The folder is created.
void write_hypersim_scene(const Scene& scene, const std::filesystem::path& folder);

}  // namespace gld::test
