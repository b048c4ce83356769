#pragma once

#include "datasets/scenes/scene.h"

#include <filesystem>

namespace gld {

// One function a layout; write_scene (datasets/formats/scene_writer.h) says what they write. The folder exists.
void write_cameras_json_layout(const Scene& scene, const std::filesystem::path& folder);
void write_npz_layout(const Scene& scene, const std::filesystem::path& folder);
void write_nerfstudio_layout(const Scene& scene, const std::filesystem::path& folder);
void write_re10k_layout(const Scene& scene, const std::filesystem::path& folder);
void write_tartanair_layout(const Scene& scene, const std::filesystem::path& folder);
void write_colmap_layout(const Scene& scene, const std::filesystem::path& folder);
void write_colmap_text_layout(const Scene& scene, const std::filesystem::path& folder);
void write_eth3d_layout(const Scene& scene, const std::filesystem::path& folder);

}  // namespace gld
