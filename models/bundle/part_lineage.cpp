#include "models/bundle/part_lineage.h"

#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/option_differences.h"
#include "gld/base/sha256.h"
#include "gld/files/weight_file.h"
#include "gld/tensors/weight_tensors.h"

#include <algorithm>
#include <filesystem>
#include <map>
#include <utility>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

constexpr const char* kTrainedOn = "gld:trained_on";
constexpr const char* kTrainedAs = "gld:trained_as";

// Hashes each file once, however many parts were trained on it.
class PartHashes {
 public:
  explicit PartHashes(const ModelBundle& bundle) : bundle_(bundle) {}
  // Returns empty text for a part that is not there.
  const std::string& of(const BundlePart& part) {
    const auto [entry, added] = hashes_.try_emplace(bundle_part_name(part));
    if (added && bundle_.has(part)) entry->second = sha256_of_file(bundle_.file(part));
    return entry->second;
  }

 private:
  const ModelBundle& bundle_;
  std::map<std::string, std::string> hashes_;
};

// Returns what a flow model's file says otherwise about it than model.yaml, and how: nothing where they agree or the
// file says nothing, as one of an earlier program, or a published one.
std::vector<OptionDifference> differences_from_training(const ModelBundle& bundle, const BundlePart& part,
                                                        const std::map<std::string, std::string>& metadata) {
  const auto noted = metadata.find(kTrainedAs);
  if (part.kind != BundlePart::Kind::kGenerator || noted == metadata.end()) return {};
  const DitOptions defaults;
  return differences_from(noted->second, bundle.file(part).string() + " (" + kTrainedAs + ")",
                          bundle.options().generator(part.generator).dit, &defaults);
}

}  // namespace

std::vector<BundlePart> trained_on(const BundlePart& part, const BundleOptions& options) {
  if (part.kind == BundlePart::Kind::kBackbone) return {};
  std::vector<BundlePart> parts = {BundlePart::backbone()};
  if (part.kind == BundlePart::Kind::kBlending || part.kind == BundlePart::Kind::kDepthRefinement)
    parts.push_back(BundlePart::geometry_head());
  if (part.kind == BundlePart::Kind::kBlending && options.depth_refinement.exists())
    parts.push_back(BundlePart::depth_refinement());
  if (part.kind == BundlePart::Kind::kRefiner) {
    for (const auto& statistics : bundle_parts(options)) {
      if (statistics.kind == BundlePart::Kind::kStatistics) parts.push_back(statistics);
    }
    if (options.refiner.degraded == DegradedLatents::kGenerated) {
      for (const auto& generated : options.generators) parts.push_back(BundlePart::of(generated.generator));
    }
  }
  if (part.kind != BundlePart::Kind::kGenerator) return parts;
  if (options.generator(part.generator).dit.warped_sources > 0) parts.push_back(BundlePart::geometry_head());
  std::vector<int64_t> levels = {part.generator.level};
  if (part.generator.is_cascade()) levels.push_back(*part.generator.deeper);
  for (const auto& statistics : bundle_parts(options)) {
    const bool of_latents = statistics.kind == BundlePart::Kind::kStatistics ||
                            statistics.kind == BundlePart::Kind::kSpecialStatistics;
    for (const int64_t level : levels) {
      if (of_latents && statistics.level == level) parts.push_back(statistics);
    }
  }
  return parts;
}

void note_in_metadata(const ModelBundle& bundle, const BundlePart& part,
                      const std::map<std::string, std::string>& notes) {
  const auto file = WeightFile::open(bundle.file(part));
  auto metadata = file->metadata();
  for (const auto& [key, value] : notes) metadata[key] = value;
  save_safetensors(
      bundle.file(part), file->entries(),
      [&](const TensorEntry& entry) { return read_tensor(*file, entry.name); }, metadata);
}

std::map<std::string, std::string> hashes_of_trained_on(const ModelBundle& bundle,
                                                        const std::vector<BundlePart>& parts) {
  PartHashes hashes(bundle);
  std::map<std::string, std::string> result;
  for (const auto& part : parts) {
    for (const auto& other : trained_on(part, bundle.options())) {
      const bool made_too = std::find(parts.begin(), parts.end(), other) != parts.end();
      if (bundle.has(other) && !made_too) result[bundle_part_name(other)] = hashes.of(other);
    }
  }
  return result;
}

void note_trained_on(const ModelBundle& bundle, const BundlePart& part) {
  const nlohmann::json made_of = hashes_of_trained_on(bundle, {part});
  std::map<std::string, std::string> notes{{kTrainedOn, made_of.dump()}};
  if (part.kind == BundlePart::Kind::kGenerator)
    notes[kTrainedAs] = to_yaml(bundle.options().generator(part.generator).dit);
  note_in_metadata(bundle, part, notes);
}

std::vector<std::string> mixed_parts(const ModelBundle& bundle, const std::vector<BundlePart>& parts,
                                     bool allow_mixed) {
  std::vector<std::string> warnings;
  std::string silent;
  PartHashes hashes(bundle);
  for (const auto& part : parts) {
    if (trained_on(part, bundle.options()).empty()) continue;
    const auto metadata = WeightFile::open(bundle.file(part))->metadata();
    const std::string name = bundle_part_name(part);
    for (const auto& difference : differences_from_training(bundle, part, metadata)) {
      const std::string changed = fmt::format("{}.{}", name, difference_text(difference));
      if (!allow_mixed) {
        fail({bundle.file(part).string(), "a part that was trained as model.yaml says", changed,
              "put into model.yaml what it was, train " + name +
                  " again, or take it as it is with --allow-mixed"});
      }
      warnings.push_back(fmt::format("{} was trained otherwise than model.yaml says: {}.", name, changed));
    }
    const auto noted = metadata.find(kTrainedOn);
    if (noted == metadata.end()) {
      silent += (silent.empty() ? "" : ", ") + name;
      continue;
    }
    const auto made_of = nlohmann::json::parse(noted->second, nullptr, /*allow_exceptions=*/false);
    for (const auto& other : trained_on(part, bundle.options())) {
      const std::string other_name = bundle_part_name(other);
      if (!made_of.is_object() || !bundle.has(other)) continue;
      // What mends depth may have been trained after what was trained on depth that was not mended; of other parts an
      // earlier program noted fewer.
      const bool came_later = other.kind == BundlePart::Kind::kDepthRefinement;
      const auto noted_hash = made_of.find(other_name);
      if (noted_hash == made_of.end() && !came_later) continue;
      // What is no text is no hash of anything.
      if (noted_hash != made_of.end() && *noted_hash == hashes.of(other)) continue;
      if (!allow_mixed) {
        fail({bundle.file(part).string(), "a part that was trained on the " + other_name + " beside it",
              "one of another " + other_name,
              "train " + name + " again, or take it as it is with --allow-mixed"});
      }
      std::string warning = name;
      warning += " was trained on another ";
      warning += other_name;
      warning += " than the model has.";
      warnings.push_back(std::move(warning));
    }
  }
  if (!silent.empty() && !std::filesystem::exists(bundle.folder() / "conversion.json")) {
    warnings.push_back(
        "Whether these parts belong to their backbone is not known, an earlier program wrote them: " +
        silent + ".");
  }
  return warnings;
}

}  // namespace gld
