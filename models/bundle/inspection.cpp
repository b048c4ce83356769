#include "models/bundle/inspection.h"

#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "models/bundle/bundle.h"

#include <algorithm>
#include <map>
#include <vector>

#include <fmt/format.h>

namespace gld {
namespace {

using nlohmann::ordered_json;

struct Totals {
  int64_t tensors = 0;
  int64_t elements = 0;
  int64_t bytes = 0;
  std::map<std::string, int64_t> dtypes;  // elements by dtype

  void add(const TensorEntry& entry) {
    tensors += 1;
    elements += entry.element_count();
    bytes += entry.byte_count();
    dtypes[dtype_name(entry.dtype)] += entry.element_count();
  }

  ordered_json json() const {
    return {{"tensors", tensors}, {"elements", elements}, {"bytes", bytes}, {"dtypes", dtypes}};
  }
};

// Text of a PyTorch file may be any bytes, JSON is UTF-8: what is not is replaced.
std::string valid_text(const std::string& text) { return ordered_json::parse(json_text(ordered_json(text))); }

ordered_json scalar_json(const ScalarEntry& value) {
  if (const auto* text = std::get_if<std::string>(&value)) return valid_text(*text);
  return std::visit([](const auto& held) { return ordered_json(held); }, value);
}

ordered_json file_summary(const WeightFile& file, Totals& totals) {
  Totals own;
  for (const auto& entry : file.entries()) {
    own.add(entry);
    totals.add(entry);
  }
  ordered_json summary = {{"file", file.path().string()},
                          {"format", file.format()},
                          {"bytes", std::filesystem::file_size(file.path())}};
  summary["totals"] = own.json();
  return summary;
}

ordered_json inspect_file(const std::filesystem::path& path) {
  const auto file = WeightFile::open(path);
  Totals totals;
  ordered_json inspection = file_summary(*file, totals);
  ordered_json tensors = ordered_json::array();
  for (const auto& entry : file->entries()) {
    tensors.push_back(
        {{"name", valid_text(entry.name)}, {"dtype", dtype_name(entry.dtype)}, {"shape", entry.shape}});
  }
  inspection["tensors"] = std::move(tensors);
  inspection["values"] = ordered_json::object();
  for (const auto& [name, value] : file->scalars())
    inspection["values"][valid_text(name)] = scalar_json(value);
  inspection["metadata"] = file->metadata();
  return inspection;
}

void check_part(const ModelBundle& bundle, const BundlePart& part, const WeightFile& file) {
  ParameterPlacement meta;
  meta.device = torch::kMeta;
  const auto module = make_bundle_module(part, bundle.options(), meta);
  if (module == nullptr) return;
  LoadReport report;
  match_strict(*module, file, {}, report);
}

ordered_json inspect_bundle(const std::filesystem::path& folder) {
  const auto bundle = ModelBundle::open(folder);
  Totals totals;
  ordered_json parts = ordered_json::object(), missing = ordered_json::array();
  for (const BundlePart& part : bundle_parts(bundle.options())) {
    if (!bundle.has(part)) {
      missing.push_back(bundle_part_name(part));
      continue;
    }
    const auto file = WeightFile::open(bundle.file(part));
    check_part(bundle, part, *file);
    parts[bundle_part_name(part)] = file_summary(*file, totals);
  }
  return {{"bundle", folder.string()},     {"name", bundle.options().name},
          {"hash", bundle.content_hash()}, {"options", to_json(bundle.options())},
          {"parts", std::move(parts)},     {"missing", std::move(missing)},
          {"totals", totals.json()}};
}

std::string size_text(int64_t bytes) {
  constexpr double kKibi = 1024;
  const char* const units[] = {"B", "KiB", "MiB", "GiB", "TiB"};
  auto size = static_cast<double>(bytes);
  size_t unit = 0;
  while (size >= kKibi && unit + 1 < std::size(units)) {
    size /= kKibi;
    ++unit;
  }
  return unit == 0 ? fmt::format("{} B", bytes) : fmt::format("{:.1f} {}", size, units[unit]);
}

std::string totals_text(const ordered_json& totals) {
  std::string dtypes;
  for (const auto& [name, elements] : totals["dtypes"].items()) {
    dtypes += (dtypes.empty() ? "" : ", ") + fmt::format("{} {}", elements.get<int64_t>(), name);
  }
  return fmt::format("{} tensors, {} elements, {}{}", totals["tensors"].get<int64_t>(),
                     totals["elements"].get<int64_t>(), size_text(totals["bytes"].get<int64_t>()),
                     dtypes.empty() ? "" : " (" + dtypes + ")");
}

std::string file_text(const ordered_json& inspection) {
  size_t width = 0;
  for (const auto& tensor : inspection["tensors"]) {
    width = std::max(width, printable_name(tensor["name"].get<std::string>()).size());
  }
  std::string text = fmt::format("{} ({})\n", inspection["file"].get<std::string>(),
                                 inspection["format"].get<std::string>());
  for (const auto& tensor : inspection["tensors"]) {
    text += fmt::format("  {:<{}}  {:<8}  {}\n", printable_name(tensor["name"].get<std::string>()), width,
                        tensor["dtype"].get<std::string>(),
                        shape_text(tensor["shape"].get<std::vector<int64_t>>()));
  }
  for (const auto& [name, value] : inspection["values"].items()) {
    text += fmt::format("  {} = {}\n", printable_name(name), printable_name(json_text(value)));
  }
  for (const auto& [name, value] : inspection["metadata"].items()) {
    text +=
        fmt::format("  metadata {} = {}\n", printable_name(name), printable_name(value.get<std::string>()));
  }
  return text + totals_text(inspection["totals"]) + "\n";
}

std::string bundle_text(const ordered_json& inspection) {
  std::string text =
      fmt::format("{}: {}\n", inspection["bundle"].get<std::string>(), inspection["name"].get<std::string>());
  for (const auto& [name, part] : inspection["parts"].items()) {
    text += fmt::format("  {:<17}  {}\n", name, totals_text(part["totals"]));
  }
  for (const auto& name : inspection["missing"]) {
    text += fmt::format("  {:<17}  missing\n", name.get<std::string>());
  }
  text += "total: " + totals_text(inspection["totals"]) + "\n";
  return text + "hash: " + inspection["hash"].get<std::string>() + "\n";
}

}  // namespace

ordered_json inspect(const std::filesystem::path& file_or_bundle) {
  return std::filesystem::is_directory(file_or_bundle) ? inspect_bundle(file_or_bundle)
                                                       : inspect_file(file_or_bundle);
}

std::string inspection_text(const ordered_json& inspection) {
  return inspection.contains("bundle") ? bundle_text(inspection) : file_text(inspection);
}

}  // namespace gld
