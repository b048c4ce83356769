#include "models/bundle/conversion.h"

#include "gld/base/atomic_file.h"
#include "gld/base/atomic_folder.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "gld/base/run_journal.h"
#include "gld/tensors/weight_tensors.h"
#include "models/bundle/published_backbones.h"
#include "models/bundle/published_release.h"
#include "models/decoders/dpt_head.h"
#include "models/weights/weight_loading.h"

#include <algorithm>
#include <map>
#include <set>
#include <utility>
#include <vector>

#include <fmt/format.h>

namespace gld {
namespace {

using nlohmann::ordered_json;

namespace fs = std::filesystem;

const std::string kReportFile = "conversion.json";
const std::string kModelFile = "model.yaml";

// A part that a source file gives.
struct SourcePart {
  BundlePart part;
  std::string prefix;                                               // of its tensors in the file
  std::vector<IgnoredName> ignored;                                 // of this part alone, without the prefix
  std::vector<std::pair<std::string, std::string>> elsewhere = {};  // as in WeightSelection

  bool takes(const std::string& name) const {
    const auto starts = [&](const std::string& beginning) {
      return name.compare(0, beginning.size(), beginning) == 0;
    };
    return starts(prefix) || std::any_of(elsewhere.begin(), elsewhere.end(),
                                         [&](const auto& beginning) { return starts(beginning.first); });
  }
};

// A published file: what it gives, and which of its tensors no part takes, with the reason.
struct Source {
  std::string file;
  std::vector<SourcePart> parts;
  std::vector<IgnoredName> ignored;
  std::string network = {};  // "M1", where it is none of the backbones
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
  for (const auto& [published, file] : given_backbones(options.backbones)) {
    if (!published.with_head) continue;
    const auto& backbone_prefix = bundle.backbone.architecture().published_prefix();
    Source source = {
        file,
        {{BundlePart::backbone(), backbone_prefix, {}, bundle.backbone.architecture().published_elsewhere()}},
        published.ignored};
    if (published.left_out) {
      for (auto& name : published.left_out(bundle)) source.ignored.push_back(std::move(name));
    }
    SourcePart head = {BundlePart::geometry_head(),
                       bundle.geometry_head.architecture().published_prefix(),
                       {},
                       bundle.geometry_head.architecture().published_elsewhere()};
    if (head.prefix.empty()) head.ignored = {{backbone_prefix + "*", "the backbone, a part of its own"}};
    if (bundle.geometry_head.exists()) source.parts.push_back(head);
    sources.push_back(std::move(source));
  }
  if (!options.rgb_decoder.empty()) {
    auto unused = ignored;
    unused.push_back({prefix + "encoder.*", "the frozen backbone, which comes from the DA3 file"});
    sources.push_back({options.rgb_decoder,
                       {{BundlePart::rgb_decoder(), prefix + RgbDecoder::kPrefix, {}}},
                       unused,
                       "an RGB decoder"});
  }
  if (!options.level1.empty())
    sources.push_back({options.level1, {{BundlePart::of(level_model(1)), prefix, {}}}, ignored, "M1"});
  if (!options.cascade.empty())
    sources.push_back({options.cascade, {{BundlePart::of(cascade(1, 0)), prefix, {}}}, ignored, "a cascade"});
  const std::vector<IgnoredName> derived = {{"std", "the square root of var"}};
  const auto statistics = [&](const std::string& file, const BundlePart& part) {
    if (!file.empty()) sources.push_back({file, {{part, "", {}}}, derived});
  };
  statistics(options.statistics_level0, BundlePart::statistics(0));
  statistics(options.statistics_level1, BundlePart::statistics(1));
  statistics(options.special_statistics_level0, BundlePart::special_statistics(0));
  statistics(options.special_statistics_level1, BundlePart::special_statistics(1));
  return sources;
}

torch::Tensor converted(const WeightFile& file, const TensorEntry& entry, DType dtype) {
  const std::string where = file.path().string() + ": tensor " + printable_name(entry.name);
  auto tensor = read_tensor(file, entry);
  if (!tensor.is_floating_point()) return tensor;
  if (!tensor.isfinite().all().item<bool>()) {
    fail({where, "finite numbers", "NaN or infinity", "get the file again, its weights are broken"});
  }
  auto target = tensor.to(torch_dtype(dtype, where));
  if (!target.isfinite().all().item<bool>()) {
    fail({where, "numbers that fit " + dtype_name(dtype),
          fmt::format("{:g}", tensor.abs().max().to(torch::kFloat64).item<double>()),
          "choose --store bfloat16 or float32"});
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
    const bool used = std::any_of(source.parts.begin(), source.parts.end(),
                                  [&](const SourcePart& part) { return part.takes(entry.name); });
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

ParameterPlacement on_meta() {
  ParameterPlacement meta;
  meta.device = torch::kMeta;
  return meta;
}

// Statistics are few numbers that everything is divided by: they are never rounded.
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
  selection.elsewhere = part.elsewhere;
  selection.ignored.insert(selection.ignored.end(), part.ignored.begin(), part.ignored.end());
  const auto module = make_bundle_module(part.part, bundle, on_meta());
  if (module == nullptr) return convert_statistics(file, source, part.part, options, bundle);
  LoadReport report;
  const DType dtype = stored_dtype(options.store);
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

// Puts a part together from tensors in memory, strictly, and writes it.
ordered_json convert_tensors(const BundlePart& part, const std::map<std::string, torch::Tensor>& tensors,
                             const std::string& where, const ConversionOptions& options,
                             const BundleOptions& bundle) {
  const auto module = make_bundle_module(part, bundle, {});
  load_strict(*module, tensors, where);
  const auto made = named_tensors(*module);
  const DType dtype = stored_dtype(options.store);
  int64_t elements = 0;
  for (const auto& [name, tensor] : made) elements += tensor.numel();
  save_bundle_part(options.out, part, made, dtype);
  return {{"source", where},
          {"selection", ""},
          {"tensors", made.size()},
          {"elements", elements},
          {"from", ordered_json::object()},
          {"to", dtype_name(dtype)},
          {"bytes", std::filesystem::file_size(ModelBundle::open(options.out).file(part))}};
}

// Backbones without a head: the names of their files may be others than the module's, and two files may hold one half
// each.
void convert_renamed_backbone(const ConversionOptions& options, const BundleOptions& bundle,
                              ordered_json& report) {
  const auto module = make_bundle_module(BundlePart::backbone(), bundle, on_meta());
  const auto shapes = named_tensors(*module);
  std::map<std::string, torch::Tensor> tensors;
  std::string where;
  for (const auto& [published, path] : given_backbones(options.backbones)) {
    if (published.with_head) continue;
    where += (where.empty() ? "" : " and ") + path;
    const auto file = WeightFile::open(path);
    std::map<std::string, int64_t> ignored;
    for (const auto& entry : file->entries()) {
      std::string name = inner_name(published, entry.name);
      const auto* reason = ignored_name(published.ignored, entry.name);
      if (reason == nullptr) reason = ignored_name(published.ignored, name);
      if (reason != nullptr) {
        ++ignored[reason->name];
        continue;
      }
      name = published.module_prefix + (published.renamed ? published.renamed(name, bundle) : name);
      auto tensor = converted(*file, entry, stored_dtype(options.store));
      // Attention over pixels is a linear layer here, and was a 1 x 1 convolution in some files.
      const auto target = shapes.find(name);
      if (target != shapes.end() && tensor.dim() == 4 && target->second.dim() == 2 &&
          tensor.numel() == target->second.numel()) {
        tensor = tensor.view(target->second.sizes());
      }
      if (!tensors.emplace(name, tensor).second) {
        fail({path, "one tensor '" + name + "'", "a second one, here or in a file before it",
              "give one file of each half, or convert them into two folders"});
      }
    }
    for (const auto& name : published.ignored) {
      if (ignored.count(name.name) == 0) continue;
      report["ignored"].push_back(
          {{"source", path}, {"names", name.name}, {"tensors", ignored[name.name]}, {"reason", name.reason}});
    }
  }
  if (tensors.empty()) return;
  report["parts"]["backbone"] = convert_tensors(BundlePart::backbone(), tensors, where, options, bundle);
}

// GLD's dpt_decoder.pt holds, under model.decoder. and model.pred., tensors of a DA3 head that take the place of the
// published head's; the others stay.
void replace_head(const ConversionOptions& options, const BundleOptions& bundle, const fs::path& added_to,
                  ordered_json& report) {
  const auto file = WeightFile::open(options.dpt_decoder);
  const auto converted_now = ModelBundle::open(options.out);
  const auto there = converted_now.has(BundlePart::geometry_head()) || !fs::exists(added_to / kModelFile)
                         ? converted_now
                         : ModelBundle::open(added_to);
  if (const auto kind = bundle.geometry_head.architecture().kind(); kind != DptHeadOptions().kind()) {
    fail({options.dpt_decoder, "a model with DA3's head, of which it replaces tensors",
          bundle.geometry_head.exists() ? "one with a head of type " + kind : "one without a geometry head",
          "choose another --out or --description"});
  }
  std::map<std::string, torch::Tensor> tensors;
  if (there.has(BundlePart::geometry_head())) {
    const auto head = WeightFile::open(there.file(BundlePart::geometry_head()));
    for (const auto& entry : head->entries()) tensors[entry.name] = read_tensor(*head, entry).clone();
  }
  int64_t replaced = 0, others = 0;
  const std::vector<std::string> prefixes{"model.decoder.", "model.pred."};
  for (const auto& entry : file->entries()) {
    const auto prefix = std::find_if(prefixes.begin(), prefixes.end(), [&](const std::string& beginning) {
      return entry.name.rfind(beginning, 0) == 0;
    });
    if (prefix == prefixes.end()) {
      ++others;
      continue;
    }
    tensors[entry.name.substr(prefix->size())] = converted(*file, entry, stored_dtype(options.store));
    ++replaced;
  }
  if (others > 0) {
    report["ignored"].push_back({{"source", options.dpt_decoder},
                                 {"names", "all but model.decoder.* and model.pred.*"},
                                 {"tensors", others},
                                 {"reason", "not of the head that takes the place of the backbone's"}});
  }
  if (replaced == 0) {
    fail({options.dpt_decoder, "tensors model.decoder.* or model.pred.*", "none",
          "give the release's dpt_decoder.pt"});
  }
  auto part = convert_tensors(BundlePart::geometry_head(), tensors, options.dpt_decoder, options, bundle);
  part["replaced"] = replaced;
  part["kept"] = part["tensors"].get<int64_t>() - replaced;
  report["parts"]["dpt_head"] = std::move(part);
}

// Returns the options of what the weights are of.
BundleOptions described_bundle(const ConversionOptions& options) {
  if (!options.description.empty()) {
    BundleOptions bundle;
    load_yaml(bundle, options.description);
    return bundle;
  }
  const auto files = given_backbones(options.backbones);
  if (std::filesystem::exists(std::filesystem::path(options.out) / "model.yaml")) {
    return ModelBundle::open(options.out).options();
  }
  if (!files.empty()) {
    const auto& published = files.front().published;
    BundleOptions bundle = published.options();
    if (published.take_optional_parts) {
      published.take_optional_parts(*WeightFile::open(files.front().path), bundle);
    }
    return bundle;
  }
  return released_da3_options();
}

// Two models may be of one network, whose files have the same tensors, and differ by a number in model.yaml alone:
// SD's and SDXL's autoencoders by the scale of their latents.
void require_no_other_model(const PublishedBackbone& published, const std::string& path,
                            const BundleOptions& bundle) {
  const std::string described = to_yaml(bundle.backbone);
  const auto is_described = [&](const PublishedBackbone& known) {
    return known.kind == published.kind && to_yaml(known.options().backbone) == described;
  };
  if (is_described(published)) return;
  for (const PublishedBackbone& other : published_backbones()) {
    if (!is_described(other)) continue;
    fail({path, "weights of " + other.name + ", which model.yaml describes", "weights of " + published.name,
          "choose another --out or --description"});
  }
}

void check_backbone_files(const ConversionOptions& options, const BundleOptions& bundle) {
  for (const auto& [published, path] : given_backbones(options.backbones)) {
    if (bundle.backbone.architecture().kind() != published.kind) {
      fail({path, "weights of the model's backbone, of kind " + bundle.backbone.architecture().kind(),
            "weights of " + published.name, "choose another --out or --description"});
    }
    require_no_other_model(published, path, bundle);
    if (published.require_whole) published.require_whole(*WeightFile::open(path), bundle);
  }
}

// Parts are added to a bundle one after the other, but none is taken away without a word.
void refuse_part_that_is_there(const ConversionOptions& options, const BundlePart& part) {
  const auto file = std::filesystem::path(options.out) / (bundle_part_name(part) + ".safetensors");
  if (options.overwrite || !std::filesystem::exists(file)) return;
  fail({file.string(), "no such part in the bundle yet", "one that is there",
        "choose another --out, or add --overwrite to replace it"});
}

// Throws Error unless the folder is a bundle, or has nothing but what killed conversions left.
void refuse_other_folder(const std::filesystem::path& folder) {
  if (RunJournal::find(folder)) {
    fail({folder.string(), "a bundle, or a new or empty folder", "a run folder", "choose another --out"});
  }
  std::error_code none;
  if (std::filesystem::exists(folder / "model.yaml", none)) return;
  for (const auto& item : std::filesystem::directory_iterator(folder, none)) {
    if (process_of_temporary_name(item.path().filename().string()) != 0) continue;
    fail({folder.string(), "a bundle, or a new or empty folder",
          "a folder with other files and no model.yaml", "choose another --out"});
  }
}

// Returns the report of the conversions before, of other parts and files than these.
ordered_json earlier_report(const ConversionOptions& options, const ordered_json& report) {
  const fs::path file = fs::path(options.out) / kReportFile;
  ordered_json earlier{{"parts", ordered_json::object()}, {"ignored", ordered_json::array()}};
  if (!fs::is_regular_file(file)) return earlier;
  const nlohmann::json before = parse_json(read_file(file), file.string());
  std::set<std::string> sources;
  for (const auto& part : report.at("parts")) sources.insert(part.value("source", ""));
  if (before.contains("parts") && before.at("parts").is_object()) {
    for (const auto& [name, part] : before.at("parts").items()) {
      if (!report["parts"].contains(name)) earlier["parts"][name] = part;
    }
  }
  if (before.contains("ignored") && before.at("ignored").is_array()) {
    for (const auto& entry : before.at("ignored")) {
      if (sources.count(entry.value("source", "")) == 0) earlier["ignored"].push_back(ordered_json(entry));
    }
  }
  return earlier;
}

// options.out is where the parts are written to, added_to where they come to lie at last, beside those that are there.
ordered_json convert_files(const ConversionOptions& options, const fs::path& added_to,
                           const BundleOptions& bundle, const std::vector<Source>& sources) {
  save_bundle_options(options.out, bundle);
  ordered_json report = {
      {"bundle", added_to.string()}, {"parts", ordered_json::object()}, {"ignored", ordered_json::array()}};
  for (const auto& source : sources) {
    const auto file = WeightFile::open(source.file);
    account_for_all(*file, source, report["ignored"]);
    for (const auto& part : source.parts) {
      report["parts"][bundle_part_name(part.part)] = convert_part(*file, source, part, options, bundle);
    }
  }
  convert_renamed_backbone(options, bundle, report);
  if (!options.dpt_decoder.empty()) replace_head(options, bundle, added_to, report);
  report["missing"] = ordered_json::array();
  const auto written = ModelBundle::open(options.out);
  for (const BundlePart& part : bundle_parts(bundle)) {
    const bool is_there = fs::is_regular_file(added_to / written.file(part).filename());
    if (!written.has(part) && !is_there) report["missing"].push_back(bundle_part_name(part));
  }
  return report;
}

// All parts are written beside the bundle before any takes its place in it: a conversion that fails leaves the bundle
// as it was.
ordered_json convert_into(const ConversionOptions& options, const BundleOptions& bundle,
                          const std::vector<Source>& sources) {
  const fs::path folder = options.out;
  const AtomicFolder beside(folder / "converted");
  ConversionOptions written = options;
  written.out = beside.temporary().string();
  ordered_json report = convert_files(written, folder, bundle, sources);
  const ordered_json earlier = earlier_report(options, report);
  ordered_json whole = report;
  for (const auto& [name, part] : earlier["parts"].items()) whole["parts"][name] = part;
  for (const auto& entry : earlier["ignored"]) whole["ignored"].push_back(entry);
  std::vector<fs::path> made;
  for (const auto& file : fs::directory_iterator(beside.temporary())) made.push_back(file.path());
  for (const auto& file : made) fs::rename(file, folder / file.filename());
  write_file_atomically(folder / kReportFile, json_text(whole, 2) + "\n");
  return report;
}

}  // namespace

ordered_json convert(const ConversionOptions& given) {
  const ConversionOptions options = with_release(given);
  refuse_other_folder(options.out);
  for (const auto& [published, path] : given_backbones(options.backbones)) {
    require_published(*WeightFile::open(path), published.option);
  }
  const BundleOptions bundle = described_bundle(options);
  check_backbone_files(options, bundle);
  const auto sources = sources_of(options, bundle);
  // Everything that can be told beforehand is checked here, so that a mistake leaves nothing behind.
  for (const auto& source : sources) {
    const auto file = WeightFile::open(source.file);
    if (!source.network.empty()) require_no_backbone(*file, source.network);
    for (const auto& part : source.parts) refuse_part_that_is_there(options, part.part);
  }
  for (const auto& [published, path] : given_backbones(options.backbones)) {
    if (!published.with_head) refuse_part_that_is_there(options, BundlePart::backbone());
  }
  remove_abandoned_files(options.out);
  const bool was_there = fs::exists(options.out);
  fs::create_directories(options.out);
  try {
    return convert_into(options, bundle, sources);
  } catch (...) {  // an interruption, and what LibTorch throws, too
    std::error_code ignored;
    if (!was_there) fs::remove(options.out, ignored);  // only when it is empty
    throw;
  }
}

std::string conversion_text(const ordered_json& report) {
  std::string text;
  for (const auto& [name, part] : report["parts"].items()) {
    const int64_t kept = part.value("kept", int64_t{0});
    text += fmt::format("{:<17}  {} tensors, {} numbers in {}, from {}{}\n", name,
                        part["tensors"].get<int64_t>(), part["elements"].get<int64_t>(),
                        part["to"].get<std::string>(), part["source"].get<std::string>(),
                        kept == 0 ? "" : fmt::format("; {} of them as they were", kept));
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
