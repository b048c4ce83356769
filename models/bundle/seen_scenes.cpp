#include "models/bundle/seen_scenes.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "gld/base/sha256.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <string>
#include <utility>

#include <nlohmann/json.hpp>

namespace gld {
namespace {

constexpr const char* kSeenFormat = "gld seen scenes 1";

// Returns the hash of the statistics of that level; empty where the bundle has none.
std::string statistics_hash(const ModelBundle& bundle, int64_t level) {
  const BundlePart part = BundlePart::statistics(level);
  return bundle.has(part) ? sha256_of_file(bundle.file(part)) : std::string();
}

}  // namespace

SeenLevel seen_level(int64_t level, std::vector<double> divergences) {
  std::sort(divergences.begin(), divergences.end());
  const auto at = [&](double share) {
    return divergences[static_cast<size_t>(std::lround(share * static_cast<double>(divergences.size() - 1)))];
  };
  return {level, at(0.5), at(0.99), divergences.back()};
}

void write_seen_scenes(const ModelBundle& bundle, const SeenScenes& seen) {
  auto levels = nlohmann::ordered_json::array();
  for (const SeenLevel& level : seen.levels) {
    levels.push_back({{"level", level.level},
                      {"statistics", statistics_hash(bundle, level.level)},
                      {"median", level.median},
                      {"usual", level.usual},
                      {"largest", level.largest}});
  }
  const nlohmann::ordered_json document{
      {"format", kSeenFormat}, {"drawn", seen.drawn}, {"scenes", seen.scenes}, {"latent_divergence", levels}};
  write_file_atomically(bundle.folder() / kSeenScenesFile, json_text(document, 2) + "\n");
}

std::optional<SeenScenes> read_seen_scenes(const ModelBundle& bundle) {
  const auto file = bundle.folder() / kSeenScenesFile;
  if (!std::filesystem::is_regular_file(file)) return std::nullopt;
  constexpr uint64_t kLimit = uint64_t{1} << 20;
  const std::string remedy = "remove it, or make it anew with gld stats";
  const nlohmann::json document = parse_json(read_file(file, kLimit), file.string());
  try {
    if (document.at("format") != kSeenFormat) {
      fail({file.string(), kSeenFormat, document.at("format").dump(), remedy});
    }
    SeenScenes seen;
    seen.drawn = document.at("drawn").get<bool>();
    seen.scenes = document.at("scenes").get<int64_t>();
    for (const auto& level : document.at("latent_divergence")) {
      const auto number = level.at("level").get<int64_t>();
      if (level.at("statistics") != statistics_hash(bundle, number)) return std::nullopt;
      seen.levels.push_back({number, level.at("median").get<double>(), level.at("usual").get<double>(),
                             level.at("largest").get<double>()});
    }
    return seen;
  } catch (const nlohmann::json::exception&) {
    fail({file.string(), "what gld stats notes of the scenes",
          "a key that is missing or has a value of another kind", remedy});
  }
}

}  // namespace gld
