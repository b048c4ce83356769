#include "models/bundle/published_release.h"

#include "gld/base/error.h"
#include "gld/base/printable_text.h"

namespace gld {
namespace {

constexpr const char* kDa3 = "da3";
constexpr const char* kVggt = "vggt";

bool is_given(const ConversionOptions& options, const char* backbone) {
  const auto found = options.backbones.find(backbone);
  return found != options.backbones.end() && !found->second.empty();
}

// Returns where a file of the release may lie in a folder: at its own path, or without the folders that hold nothing
// else of its name. Both decoders are called mae_decoder.pt, and the statistics of both models share a name as well.
std::vector<std::filesystem::path> places_of(const std::filesystem::path& path) {
  std::vector<std::filesystem::path> places{path};
  const std::filesystem::path inner = path.lexically_relative(*path.begin());
  places.push_back(inner);
  const std::string name = path.filename().string();
  const bool is_of_one_model = name.rfind("da3_", 0) == 0 || name.rfind("vggt_", 0) == 0 ||
                               name == "dpt_decoder.pt" || name == "model.safetensors";
  if (is_of_one_model && inner != name) places.emplace_back(name);
  return places;
}

// Returns an empty path where it is in none of its places.
std::string find_file(const std::filesystem::path& folder, const std::string& path) {
  std::error_code none;
  for (const auto& place : places_of(path)) {
    const auto file = folder / place;
    if (std::filesystem::is_regular_file(file, none)) return file.string();
  }
  return "";
}

}  // namespace

const std::vector<ReleaseFile>& release_files(ReleasedModel model) {
  using Options = ConversionOptions;
  static const std::vector<ReleaseFile> da3{
      {"pretrained_models/da3/model.safetensors", nullptr},
      {"pretrained_models/da3/dpt_decoder.pt", &Options::dpt_decoder},
      {"pretrained_models/mae_decoder.pt", &Options::rgb_decoder},
      {"checkpoints/da3_level1.pt", &Options::level1},
      {"checkpoints/da3_cascade.pt", &Options::cascade},
      {"model_stats/da3/normalization_stats_level0.pt", &Options::statistics_level0},
      {"model_stats/da3/normalization_stats_level1.pt", &Options::statistics_level1}};
  static const std::vector<ReleaseFile> vggt{
      {"pretrained_models/vggt/mae_decoder.pt", &Options::rgb_decoder},
      {"checkpoints/vggt_level1.pt", &Options::level1},
      {"checkpoints/vggt_cascade.pt", &Options::cascade},
      {"model_stats/vggt/normalization_stats_level0.pt", &Options::statistics_level0},
      {"model_stats/vggt/normalization_stats_level1.pt", &Options::statistics_level1},
      {"model_stats/vggt/special_stats_level0.pt", &Options::special_statistics_level0},
      {"model_stats/vggt/special_stats_level1.pt", &Options::special_statistics_level1}};
  return model == ReleasedModel::kVggt ? vggt : da3;
}

ConversionOptions with_release(const ConversionOptions& options) {
  ConversionOptions filled = options;
  if (options.release.empty()) return filled;
  const std::filesystem::path folder = options.release;
  std::error_code none;
  if (!std::filesystem::is_directory(folder, none)) {
    fail({"--release", "the folder of the published snapshot", "'" + printable_text(options.release) + "'",
          "name the folder that holds checkpoints/ and pretrained_models/"});
  }
  const bool on_vggt = is_given(options, kVggt);
  std::string missing;
  bool statistics_are_missing = false;
  for (const auto& file : release_files(on_vggt ? ReleasedModel::kVggt : ReleasedModel::kDa3)) {
    std::string& given = file.option == nullptr ? filled.backbones[kDa3] : filled.*file.option;
    if (!given.empty()) continue;
    given = find_file(folder, file.path);
    if (!given.empty()) continue;
    missing += (missing.empty() ? "" : ", ") + file.path;
    statistics_are_missing = statistics_are_missing || file.path.rfind("model_stats/", 0) == 0;
  }
  if (missing.empty()) return filled;
  fail(
      {printable_text(folder.string()),
       std::string("the files of the published model on ") + (on_vggt ? "VGGT" : "DA3"),
       "none of the name " + missing,
       statistics_are_missing
           ? "model_stats/ is in the Git repository of the release, not in its snapshot: copy it beside checkpoints/"
           : "download the snapshot whole, or give the file by its own option (see gld convert --help)"});
}

}  // namespace gld
