#include "models/bundle/view_unit_file.h"

#include "gld/base/error.h"
#include "gld/base/sha256.h"
#include "gld/tensors/weight_tensors.h"

#include <array>
#include <map>
#include <string>

namespace gld {
namespace {

constexpr const char* kFormat = "gld single view unit 1";
constexpr int64_t kNumbers = 4;  // offset, least, largest, log_deviation

// Returns what the guess is of: {part's name, SHA-256 of its file}, empty for one that the bundle lacks.
std::map<std::string, std::string> frozen_parts_of(const ModelBundle& bundle) {
  std::map<std::string, std::string> parts;
  for (const BundlePart& part : {BundlePart::backbone(), BundlePart::geometry_head()})
    parts[bundle_part_name(part)] = bundle.has(part) ? sha256_of_file(bundle.file(part)) : std::string();
  return parts;
}

}  // namespace

void write_single_view_unit(const ModelBundle& bundle, const SingleViewUnit& unit) {
  auto text = frozen_parts_of(bundle);
  text["format"] = kFormat;
  save_safetensors(bundle.folder() / kSingleViewUnitFile,
                   {{"mean", unit.mean},
                    {"deviation", unit.deviation},
                    {"weights", unit.weights},
                    {"numbers", torch::tensor({unit.offset, unit.least, unit.largest, unit.log_deviation},
                                              torch::kFloat64)}},
                   text);
}

std::shared_ptr<const SingleViewUnit> read_single_view_unit(const ModelBundle& bundle) {
  const auto path = bundle.folder() / kSingleViewUnitFile;
  if (!std::filesystem::is_regular_file(path)) return nullptr;
  const auto file = WeightFile::open(path);
  const std::string remedy = "remove it, or make it anew with gld stats";
  const auto format = file->metadata().find("format");
  if (format == file->metadata().end() || format->second != kFormat) {
    fail({path.string(), kFormat, format == file->metadata().end() ? "no format" : format->second, remedy});
  }
  for (const auto& [name, hash] : frozen_parts_of(bundle)) {
    const auto of = file->metadata().find(name);
    if (of == file->metadata().end() || of->second != hash) return nullptr;
  }
  auto unit = std::make_shared<SingleViewUnit>();
  unit->mean = read_tensor(*file, "mean");
  unit->deviation = read_tensor(*file, "deviation");
  unit->weights = read_tensor(*file, "weights");
  auto numbers = read_tensor(*file, "numbers");
  for (torch::Tensor* part : {&unit->mean, &unit->deviation, &unit->weights, &numbers}) {
    const bool fits = part->scalar_type() == torch::kFloat64 && part->dim() == 1 &&
                      part->numel() == (part == &numbers ? kNumbers : unit->mean.numel()) &&
                      torch::isfinite(*part).all().item<bool>();
    if (!fits)
      fail(
          {path.string(), "vectors of finite 64-bit numbers, as many weights as features", "others", remedy});
  }
  unit->offset = numbers[0].item<double>();
  unit->least = numbers[1].item<double>();
  unit->largest = numbers[2].item<double>();
  unit->log_deviation = numbers[3].item<double>();
  return unit;
}

}  // namespace gld
