#include "models/bundle/conversion.h"

#include "gld/base/atomic_file.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "gld/tensors/weight_tensors.h"
#include "models/weights/weight_loading.h"

#include <algorithm>
#include <map>
#include <utility>
#include <vector>

#include <fmt/format.h>

namespace gld {
namespace {

using nlohmann::ordered_json;

const std::string kReportFile = "conversion.json";

// A part that a source file gives.
struct SourcePart {
  BundlePart part;
  std::string prefix;  // of its tensors in the file
};

// A published file: what it gives, and which of its tensors no part takes, with the reason.
struct Source {
  std::string file;
  std::vector<SourcePart> parts;
  std::vector<IgnoredName> ignored;
};

std::string checkpoint_prefix(CheckpointWeights weights) {
  switch (weights) {
    case CheckpointWeights::kEma:
      return "ema.";
    case CheckpointWeights::kModel:
      return "model.";
    case CheckpointWeights::kPlain:
      break;
  }
  return "";
}

std::vector<IgnoredName> ignored_in_checkpoint(CheckpointWeights weights) {
  if (weights == CheckpointWeights::kPlain) return {};
  std::vector<IgnoredName> ignored = {{"opt.*", "state of the optimiser"},
                                      {"optimizer*", "state of the optimiser"},
                                      {"disc*", "the discriminator, which only training needs"},
                                      {"scheduler*", "state of the learning rate"}};
  if (weights == CheckpointWeights::kEma) {
    ignored.push_back({"model.*", "the weights before averaging"});
  } else {
    ignored.push_back({"ema.*", "the averaged weights"});
  }
  return ignored;
}

std::vector<Source> sources_of(const ConversionOptions& options, const BundleOptions& bundle) {
  const std::string prefix = checkpoint_prefix(options.weights);
  const auto ignored = ignored_in_checkpoint(options.weights);
  std::vector<Source> sources;
  if (!options.da3.empty()) {
    sources.push_back({options.da3,
                       {{BundlePart::backbone(), bundle.backbone.architecture().published_prefix()},
                        {BundlePart::dpt_head(), DptHead::kPrefix}},
                       {{"model.cam_dec.*", "DA3's pose decoder, which GLD does not use"},
                        {"model.cam_enc.*", "DA3's pose encoder, which GLD does not use"}}});
  }
  if (!options.rgb_decoder.empty()) {
    auto unused = ignored;
    unused.push_back({prefix + "encoder.*", "the frozen backbone, which comes from the DA3 file"});
    sources.push_back(
        {options.rgb_decoder, {{BundlePart::rgb_decoder(), prefix + RgbDecoder::kPrefix}}, unused});
  }
  if (!options.level1.empty())
    sources.push_back({options.level1, {{BundlePart::of(level_model(1)), prefix}}, ignored});
  if (!options.cascade.empty())
    sources.push_back({options.cascade, {{BundlePart::of(cascade(1, 0)), prefix}}, ignored});
  const std::vector<IgnoredName> derived = {{"std", "the square root of var"}};
  if (!options.statistics_level0.empty()) {
    sources.push_back({options.statistics_level0, {{BundlePart::statistics(0), ""}}, derived});
  }
  if (!options.statistics_level1.empty()) {
    sources.push_back({options.statistics_level1, {{BundlePart::statistics(1), ""}}, derived});
  }
  return sources;
}

DType stored_dtype(StoredPrecision precision) {
  switch (precision) {
    case StoredPrecision::kFloat16:
      return DType::kFloat16;
    case StoredPrecision::kBFloat16:
      return DType::kBFloat16;
    case StoredPrecision::kFloat32:
      break;
  }
  return DType::kFloat32;
}

torch::Tensor converted(const WeightFile& file, const TensorEntry& entry, DType dtype) {
  const std::string where = file.path().string() + ": tensor " + printable_name(entry.name);
  const auto tensor = read_tensor(file, entry);
  if (!tensor.is_floating_point()) return tensor;
  if (!tensor.isfinite().all().item<bool>()) {
    fail({where, "finite numbers", "NaN or infinity", "get the file again, its weights are broken"});
  }
  const auto target = tensor.to(torch_dtype(dtype, where));
  if (!target.isfinite().all().item<bool>()) {
    fail({where, "numbers that fit " + dtype_name(dtype),
          fmt::format("{:g}", tensor.abs().max().to(torch::kFloat64).item<double>()),
          "choose --precision bf16 or fp32"});
  }
  return target;
}

// Every tensor of the file belongs to a part or to the ignored ones; the latter go into the report.
void account_for_all(const WeightFile& file, const Source& source, ordered_json& ignored) {
  std::map<std::string, int64_t> counts;
  for (const auto& entry : file.entries()) {
    const auto* reason = ignored_name(source.ignored, entry.name);
    if (reason != nullptr) {
      ++counts[reason->name];
      continue;
    }
    const bool used = std::any_of(source.parts.begin(), source.parts.end(), [&](const SourcePart& part) {
      return entry.name.compare(0, part.prefix.size(), part.prefix) == 0;
    });
    if (!used) {
      fail({file.path().string(), "only tensors of the model",
            "the unexpected tensor " + printable_name(entry.name),
            "check that the file is the one meant and that --weights chooses the right copy"});
    }
  }
  for (const auto& name : source.ignored) {
    if (counts.count(name.name) == 0) continue;
    ignored.push_back({{"source", source.file},
                       {"names", name.name},
                       {"tensors", counts[name.name]},
                       {"reason", name.reason}});
  }
}

struct PlannedTensor {
  const TensorEntry* source = nullptr;
  DType dtype = DType::kFloat32;
};

// Statistics are few numbers that everything is divided by: never rounded.
ordered_json convert_statistics(const WeightFile& file, const Source& source, const BundlePart& part,
                                const ConversionOptions& options, const BundleOptions& bundle) {
  const auto statistics = read_latent_statistics(file);
  if (statistics.channels() != bundle.backbone.level_channels()) {
    fail({source.file, std::to_string(bundle.backbone.level_channels()) + " channels",
          std::to_string(statistics.channels()), "check that the file belongs to this backbone"});
  }
  const auto tensors = statistics_tensors(statistics);
  save_bundle_part(options.out, part, tensors);
  return {{"source", source.file},
          {"selection", ""},
          {"tensors", tensors.size()},
          {"elements", 2 * statistics.channels()},
          {"from", {{dtype_name(file.entry("mean").dtype), tensors.size()}}},
          {"to", dtype_name(DType::kFloat32)},
          {"bytes", std::filesystem::file_size(ModelBundle::open(options.out).file(part))}};
}

ordered_json convert_part(const WeightFile& file, const Source& source, const SourcePart& part,
                          const ConversionOptions& options, const BundleOptions& bundle) {
  WeightSelection selection;
  selection.prefix = part.prefix;
  selection.ignored = source.ignored;
  ParameterPlacement meta;
  meta.device = torch::kMeta;
  const auto module = make_bundle_module(part.part, bundle, meta);
  if (module == nullptr) return convert_statistics(file, source, part.part, options, bundle);
  LoadReport report;
  const DType dtype = stored_dtype(options.precision);
  std::map<std::string, PlannedTensor> planned;
  std::vector<TensorEntry> entries;
  std::map<std::string, int64_t> from;
  int64_t elements = 0;
  for (const auto& matched : match_strict(*module, file, selection, report)) {
    TensorEntry entry;
    entry.name = matched.name;
    entry.shape = matched.source->shape;
    entry.dtype = is_floating(matched.source->dtype) ? dtype : matched.source->dtype;
    planned[entry.name] = {matched.source, entry.dtype};
    elements += entry.element_count();
    from[dtype_name(matched.source->dtype)] += 1;
    entries.push_back(std::move(entry));
  }
  const size_t tensors = entries.size();
  const auto target = std::filesystem::path(options.out) / (bundle_part_name(part.part) + ".safetensors");
  save_safetensors(target, std::move(entries), [&](const TensorEntry& entry) {
    const auto& plan = planned.at(entry.name);
    return converted(file, *plan.source, plan.dtype);
  });
  return {{"source", source.file},
          {"selection", part.prefix},
          {"tensors", tensors},
          {"elements", elements},
          {"from", from},
          {"to", dtype_name(dtype)},
          {"bytes", std::filesystem::file_size(target)}};
}

}  // namespace

void ConversionOptions::visit(FieldVisitor& visitor) {
  visitor.text({"da3", "DA3-Base safetensors: gives the backbone and the DPT head"}, da3);
  visitor.text({"rgb_decoder", "GLD's .pt file of the RGB decoder"}, rgb_decoder);
  visitor.text({"level1", "GLD's .pt file of M1"}, level1);
  visitor.text({"cascade", "GLD's .pt file of the cascade"}, cascade);
  visitor.text({"statistics_level0", ".pt file with mean and var of level 0"}, statistics_level0);
  visitor.text({"statistics_level1", ".pt file with mean and var of level 1"}, statistics_level1);
  visitor.text({"description", "model.yaml that describes the weights; empty: the released DA3-Base model"},
               description);
  visit_choice(visitor, {"weights", "copy in a PyTorch checkpoint; plain: the file is a state_dict itself"},
               weights, {"ema", "model", "plain"});
  visit_choice(visitor, {"precision", "how floating-point weights are stored"}, precision,
               {"fp32", "fp16", "bf16"});
  visit_out(visitor, out);
}

void ConversionOptions::check() const {
  check_out(out, "models/gld");
  if (sources_of(*this, BundleOptions()).empty()) {
    fail({"gld convert", "at least one file to convert", "none",
          "give --da3, --level1, ... (see gld convert --help)"});
  }
}

ordered_json convert(const ConversionOptions& options) {
  BundleOptions bundle = released_da3_options();
  if (!options.description.empty()) {
    bundle = BundleOptions();
    load_yaml(bundle, options.description);
  }
  save_bundle_options(options.out, bundle);
  ordered_json report = {
      {"bundle", options.out}, {"parts", ordered_json::object()}, {"ignored", ordered_json::array()}};
  for (const auto& source : sources_of(options, bundle)) {
    const auto file = WeightFile::open(source.file);
    account_for_all(*file, source, report["ignored"]);
    for (const auto& part : source.parts) {
      report["parts"][bundle_part_name(part.part)] = convert_part(*file, source, part, options, bundle);
    }
  }
  report["missing"] = ordered_json::array();
  const auto written = ModelBundle::open(options.out);
  for (const BundlePart& part : bundle_parts(bundle)) {
    if (!written.has(part)) report["missing"].push_back(bundle_part_name(part));
  }
  write_file_atomically(std::filesystem::path(options.out) / kReportFile, json_text(report, 2) + "\n");
  return report;
}

std::string conversion_text(const ordered_json& report) {
  std::string text;
  for (const auto& [name, part] : report["parts"].items()) {
    text += fmt::format("{:<17}  {} tensors, {} numbers in {}, from {}\n", name,
                        part["tensors"].get<int64_t>(), part["elements"].get<int64_t>(),
                        part["to"].get<std::string>(), part["source"].get<std::string>());
  }
  for (const auto& entry : report["ignored"]) {
    text += fmt::format("left out           {} tensors {} of {}: {}\n", entry["tensors"].get<int64_t>(),
                        entry["names"].get<std::string>(), entry["source"].get<std::string>(),
                        entry["reason"].get<std::string>());
  }
  for (const auto& name : report["missing"]) {
    text += fmt::format("{:<17}  missing; convert it into the same folder\n", name.get<std::string>());
  }
  return text + "bundle: " + report["bundle"].get<std::string>() + "\n";
}

}  // namespace gld
