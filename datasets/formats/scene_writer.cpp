#include "datasets/formats/scene_writer.h"

#include "datasets/formats/scene_layouts.h"
#include "gld/base/atomic_folder.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"

namespace gld {
namespace {

struct Layout {
  const char* name;
  void (*write)(const Scene& scene, const std::filesystem::path& folder);
};

const std::vector<Layout>& layouts() {
  static const std::vector<Layout> known{
      {"cameras-json", write_cameras_json_layout}, {"npz", write_npz_layout},
      {"nerfstudio", write_nerfstudio_layout},     {"re10k", write_re10k_layout},
      {"tartanair", write_tartanair_layout},       {"colmap", write_colmap_layout},
      {"colmap-text", write_colmap_text_layout},   {"eth3d", write_eth3d_layout}};
  return known;
}

}  // namespace

std::vector<std::string> scene_layout_names() {
  std::vector<std::string> names;
  for (const Layout& layout : layouts()) names.emplace_back(layout.name);
  return names;
}

void write_scene(const Scene& scene, const std::string& layout, const std::filesystem::path& folder) {
  for (const Layout& known : layouts()) {
    if (layout != known.name) continue;
    const auto parent = std::filesystem::absolute(folder).lexically_normal().parent_path();
    std::filesystem::create_directories(parent);
    // Some layouts have no list of frames: half of one would be a shorter scene without any sign of it.
    AtomicFolder whole(folder);
    known.write(scene, whole.temporary());
    whole.commit();
    return;
  }
  const std::string nearest = nearest_name(layout, scene_layout_names());
  fail({"layout", "a layout that can be written", "\"" + layout + "\"",
        nearest.empty() ? "see gld synth --help" : "did you mean \"" + nearest + "\"?"});
}

}  // namespace gld
