#include "ablate/configuration/ablation.h"

#include "gld/base/atomic_file.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/yaml_text.h"
#include "gld/metrics/metric_list.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <set>

#include <yaml-cpp/yaml.h>

namespace gld {
namespace {

constexpr uint64_t kLargestDescription = 1 << 20;

std::string quoted_text(const std::string& text) { return "'" + text + "'"; }

std::string joined_names(const std::vector<std::string>& names) {
  std::string text;
  for (const std::string& name : names) text += (text.empty() ? "" : ", ") + name;
  return text;
}

// Where a node stands: "sources.yaml:12, stage 'eval'".
struct YamlPlace {
  std::string file;
  std::string section;  // "stage 'eval'"

  std::string of(const YAML::Node& node) const {
    std::string text = file;
    if (node.Mark().line >= 0) text += ":" + std::to_string(node.Mark().line + 1);
    return text + (section.empty() ? "" : ", " + section);
  }
  YamlPlace inner(const std::string& name) const {
    return {file, section.empty() ? name : section + ", " + name};
  }
};

std::string one_line(const YAML::Node& node) {
  YAML::Emitter emitter;
  emitter << YAML::Flow << node;
  return emitter.c_str();
}

void require_map(const YAML::Node& node, const YamlPlace& place) {
  if (node.IsMap()) return;
  fail({place.of(node), "a map", node.IsSequence() ? "a list" : "a single value",
        "write one 'key: value' a line, indented"});
}

std::string key_text(const YAML::Node& key, const YamlPlace& place) {
  if (!key.IsScalar()) fail({place.of(key), "a name", "something else", "correct the text"});
  return key.Scalar();
}

// Names become keys of tables and of further options.
std::string item_name(const YAML::Node& key, const YamlPlace& place) {
  std::string name = key_text(key, place);
  const bool right = !name.empty() && std::all_of(name.begin(), name.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '_';
  });
  if (!right) {
    fail({place.of(key), "a name of small letters, digits and underscores", quoted_text(name), "rename it"});
  }
  return name;
}

void read_settings(const YAML::Node& node, const YamlPlace& place, const std::string& prefix,
                   std::vector<OptionSetting>& settings) {
  require_map(node, place);
  for (const auto& entry : node) {
    const std::string key = prefix + key_text(entry.first, place);
    if (entry.second.IsMap()) {
      read_settings(entry.second, place, key + ".", settings);
    } else {
      settings.push_back({key, one_line(entry.second), place.of(entry.first)});
    }
  }
}

std::map<std::string, std::string> read_texts(const YAML::Node& node, const YamlPlace& place) {
  require_map(node, place);
  std::map<std::string, std::string> texts;
  for (const auto& entry : node) {
    if (!entry.second.IsScalar()) {
      fail({place.of(entry.first), "a text", "a list or a map", "write one 'column: text' a line"});
    }
    texts[key_text(entry.first, place)] = entry.second.Scalar();
  }
  return texts;
}

// Returns what to do about a name that is not among those: the nearest, or all.
std::string remedy_for(const std::string& name, const std::vector<std::string>& known) {
  const auto near = nearest_name(name, known);
  return near.empty() ? "choose among " + joined_names(known) : "did you mean " + quoted_text(near) + "?";
}

// A key that is no field of an item, and what reads its value.
struct KeyReader {
  std::string key;
  std::function<void(const YAML::Node& value, const YamlPlace& place)> read;
};

// Throws Error for a key that is neither a field of the group nor among `others`, naming all that are.
void require_key(const OptionsGroup& group, const std::vector<std::string>& others, const std::string& key,
                 const std::string& where) {
  std::vector<std::string> known = others;
  for (const auto& field : describe_options(group)) {
    // A section and an option may have one name: smoke.
    if (std::find(known.begin(), known.end(), field.key) == known.end()) known.push_back(field.key);
  }
  if (std::find(known.begin(), known.end(), key) != known.end()) return;
  fail({where + ", key " + quoted_text(key), "a known key", "an unknown one", remedy_for(key, known)});
}

// Every entry goes to the reader of its key, where there is one, else to the fields of the item.
void read_item(OptionsGroup& item, const YAML::Node& node, const YamlPlace& place,
               const std::vector<KeyReader>& readers) {
  require_map(node, place);
  std::vector<std::string> keys;
  keys.reserve(readers.size());
  for (const KeyReader& reader : readers) keys.push_back(reader.key);
  for (const auto& entry : node) {
    const std::string key = key_text(entry.first, place);
    require_key(item, keys, key, place.of(entry.first));
    const auto own = std::find_if(readers.begin(), readers.end(),
                                  [&](const KeyReader& reader) { return reader.key == key; });
    if (own != readers.end()) {
      own->read(entry.second, place);
    } else {
      apply_setting(item, key, one_line(entry.second), place.of(entry.first));
    }
  }
}

std::map<std::string, std::vector<OptionSetting>> read_stage_settings(const YAML::Node& node,
                                                                      const YamlPlace& place) {
  require_map(node, place);
  std::map<std::string, std::vector<OptionSetting>> settings;
  for (const auto& entry : node) {
    const std::string stage = key_text(entry.first, place);
    read_settings(entry.second, place.inner("stage " + quoted_text(stage)), "", settings[stage]);
  }
  return settings;
}

StageDescription read_stage(const std::string& name, const YAML::Node& node, const YamlPlace& place) {
  StageDescription stage;
  stage.name = name;
  read_item(stage, node, place, {{"options", [&](const YAML::Node& value, const YamlPlace& at) {
                                    read_settings(value, at, "", stage.settings);
                                  }}});
  return stage;
}

VariantDescription read_variant(const std::string& name, const YAML::Node& node, const YamlPlace& place) {
  VariantDescription variant;
  variant.name = name;
  variant.label = name;
  if (node.IsNull()) return variant;
  read_item(variant, node, place,
            {{"options", [&](const YAML::Node& value,
                             const YamlPlace& at) { variant.settings = read_stage_settings(value, at); }},
             {"rows", [&](const YAML::Node& value,
                          const YamlPlace& at) { variant.rows = read_texts(value, at.inner("rows")); }},
             {"columns", [&](const YAML::Node& value, const YamlPlace& at) {
                variant.columns = read_texts(value, at.inner("columns"));
              }}});
  return variant;
}

template <class Item, class Read>
std::vector<Item> read_items(const YAML::Node& node, const YamlPlace& place, const std::string& kind,
                             const Read& read) {
  require_map(node, place);
  std::vector<Item> items;
  for (const auto& entry : node) {
    const std::string name = item_name(entry.first, place);
    items.push_back(read(name, entry.second, place.inner(kind + " " + quoted_text(name))));
  }
  if (items.empty()) fail({place.of(node), "at least one " + kind, "none", "add one"});
  return items;
}

template <class Item>
std::vector<std::string> names_of(const std::vector<Item>& items) {
  std::vector<std::string> names;
  names.reserve(items.size());
  for (const Item& item : items) names.push_back(item.name);
  return names;
}

// one_of is what the name should be of, for example "stage".
void require_name(const std::string& name, const std::vector<std::string>& known, const std::string& where,
                  const std::string& one_of) {
  if (std::find(known.begin(), known.end(), name) != known.end()) return;
  fail({where, "a " + one_of + " of this ablation", name.empty() ? "nothing" : quoted_text(name),
        remedy_for(name, known)});
}

const std::vector<std::string>& section_names() {
  static const std::vector<std::string> names{"title", "stages", "variants", "metrics", "claims", "smoke"};
  return names;
}

bool is_section(const std::string& key) {
  return std::find(section_names().begin(), section_names().end(), key) != section_names().end();
}

void check_stages(const Ablation& ablation, const std::string& file) {
  std::vector<std::string> before;
  for (const StageDescription& stage : ablation.stages) {
    const std::string where = file + ", stage " + quoted_text(stage.name);
    const auto require_before = [&](const std::string& name, const std::string& key) {
      if (std::find(before.begin(), before.end(), name) != before.end()) return;
      fail({where + ", key " + quoted_text(key), "a stage that stands before it", quoted_text(name),
            before.empty() ? "it is the first one" : "choose among " + joined_names(before)});
    };
    if (stage.name == kBaseModel)
      fail({where, "another name", "'base', which is the given bundle", "rename it"});
    if (stage.command.empty()) {
      fail({where, "a command", "none", "add for example 'command: eval'"});
    }
    if (!stage.model.empty() && stage.model != kBaseModel) require_before(stage.model, "model");
    if (!stage.resume.empty()) require_before(stage.resume, "resume");
    for (const std::string& part : stage.parts) require_before(part, "parts");
    if (!stage.parts.empty() && stage.command != kAssembleCommand) {
      fail({where + ", key 'parts'", "a stage with command: assemble", quoted_text(stage.command),
            "remove parts, or put the parts together in a stage of its own"});
    }
    if (stage.repeat > 1 && makes_bundle(stage.command)) {
      fail({where + ", key 'repeat'", "a stage that makes rows", quoted_text(stage.command), "remove it"});
    }
    before.push_back(stage.name);
  }
}

void check_variants(const Ablation& ablation, const std::string& file) {
  const auto stages = names_of(ablation.stages);
  const auto metrics = names_of(ablation.metrics);
  for (const VariantDescription& variant : ablation.variants) {
    const std::string where = file + ", variant " + quoted_text(variant.name);
    for (const std::string& stage : variant.stages)
      require_name(stage, stages, where + ", key 'stages'", "stage");
    if (!variant.result.empty()) require_name(variant.result, stages, where + ", key 'result'", "stage");
    for (const auto& [stage, settings] : variant.settings)
      require_name(stage, stages, where + ", options", "stage");
    for (const auto& [metric, column] : variant.columns)
      require_name(metric, metrics, where + ", columns", "metric");
  }
  for (const auto& [stage, settings] : ablation.smoke) require_name(stage, stages, file + ", smoke", "stage");
}

void check_metrics(const Ablation& ablation, const std::string& file) {
  for (const MetricDescription& metric : ablation.metrics) {
    const std::string where = file + ", metric " + quoted_text(metric.name) + ", key 'better'";
    static const std::vector<std::string> directions{"higher", "lower", "near 1"};
    if (metric.better.empty()) {
      fail({where, "higher, lower or near 1", "nothing, and it is no column that gld knows",
            "add it, for example " + quoted_text(metric.name + ": {better: higher}")});
    }
    if (std::find(directions.begin(), directions.end(), metric.better) == directions.end()) {
      fail({where, "higher, lower or near 1", quoted_text(metric.better), "choose one of them"});
    }
  }
}

// all has the names of all variants, also of those that --only leaves out.
void check_claims(const Ablation& ablation, const std::vector<std::string>& all, const std::string& file) {
  const auto metrics = names_of(ablation.metrics);
  for (const ClaimDescription& claim : ablation.claims) {
    const std::string where = file + ", claim " + quoted_text(claim.name);
    require_name(claim.metric, metrics, where + ", key 'metric'", "metric");
    require_name(claim.better, all, where + ", key 'better'", "variant");
    require_name(claim.worse, all, where + ", key 'worse'", "variant");
    if (claim.better == claim.worse) {
      fail({where, "two variants", quoted_text(claim.better) + " twice", "compare it with another one"});
    }
    if (claim.beyond.empty()) continue;
    const std::string margin = where + ", key 'beyond'";
    if (claim.beyond.size() != 2 || claim.beyond[0] == claim.beyond[1]) {
      fail({margin, "two different variants, [BETTER, WORSE]",
            claim.beyond.size() == 2 ? quoted_text(claim.beyond[0]) + " twice"
                                     : std::to_string(claim.beyond.size()) + " names",
            "name those whose margin is the smaller one"});
    }
    if (claim.beyond == std::vector<std::string>{claim.better, claim.worse}) {
      fail({margin, "another margin than the claim's own", "the same two variants",
            "name those whose margin is the smaller one"});
    }
    for (const std::string& variant : claim.beyond) require_name(variant, all, margin, "variant");
  }
}

// A metric is known by its name, or by that of a column of gld eval that ends so, "generated_psnr": then the longest
// such name counts.
const Metric* known_metric(const std::string& name) {
  const Metric* found = nullptr;
  for (const Metric& metric : metric_list()) {
    if (metric.name == name) return &metric;
    const std::string end = "_" + metric.name;
    const bool ends_so =
        name.size() > end.size() && name.compare(name.size() - end.size(), end.size(), end) == 0;
    if (ends_so && (found == nullptr || metric.name.size() > found->name.size())) found = &metric;
  }
  return found;
}

}  // namespace

void AblateOptions::visit(FieldVisitor& visitor) {
  visit_out(visitor, out, overwrite);  // without --overwrite, an ablation that is there is gone on with
  visitor.text(
      {"cache", "folder of finished stages, which ablations may share; none: cache in the run folder"},
      cache);
  visitor.text({"model", "bundle folder of the base"}, model);
  visitor.integers({"seeds", "each stage with random numbers runs once for each"}, seeds, {0, 1'000'000});
  visitor.texts(
      {"with_runs",
       "run folders of the same question under other seeds, of another day or machine: their rows count as well"},
      with_runs);
  visitor.texts({"only", "variants to run; none: all"}, only);
  visitor.texts(
      {"overrides", "options of stages, STAGE.KEY=VALUE, for all variants and above everything else"},
      overrides);
  visitor.boolean({"smoke", "run with the description's smoke settings and the first seed only"}, smoke);
  visitor.boolean({"plan", "show what would run and what it needs, then stop"}, plan);
  visitor.integer({"jobs",
                   "stages that run at a time; 0: as many as the cores hold with --threads each, which is 1: "
                   "the cores go to stages side by side"},
                  jobs, {0, kMostThreads});
  visit_threads(visitor, threads);
  visit_device(visitor, device);
  visitor.integer({"bootstrap", "replicates of the bootstrap"}, bootstrap, {100, 10'000'000});
  visit_json(visitor, json);
}

void AblateOptions::check() const {
  check_out(out, "runs/ablation");
  if (seeds.empty()) fail({"--seeds", "at least one seed", "none", "add for example --seeds 0,1,2"});
  if (std::set<int64_t>(seeds.begin(), seeds.end()).size() != seeds.size()) {
    fail({"--seeds", "every seed once", "one a second time", "remove one of the two"});
  }
  for (const std::string& setting : overrides) {
    const size_t dot = setting.find('.');
    const size_t equals = setting.find('=');
    if (dot == std::string::npos || equals == std::string::npos || dot == 0 || equals < dot + 2) {
      fail({"--overrides", "STAGE.KEY=VALUE", quoted_text(setting),
            "write for example --overrides eval.synthetic=16"});
    }
  }
}

int64_t AblateOptions::jobs_to_use() const {
  if (jobs > 0) return jobs;
  return std::max<int64_t>(1, threads_to_use(0) / threads_to_use(threads));
}

void StageDescription::visit(FieldVisitor& visitor) {
  visitor.text({"command", "a command of gld that makes a bundle or rows, or assemble"}, command);
  visitor.text({"config", "YAML file of the command's options"}, config);
  visitor.text({"model", "stage whose bundle it takes, or base; none: the stage before that makes one"},
               model);
  visitor.texts({"parts", "assemble: stages whose trained parts are taken"}, parts);
  visitor.text({"resume", "stage whose training this one goes on with"}, resume);
  visitor.text({"results", "CSV file of its run folder with a row a scene"}, results);
  visitor.integer({"repeat", "runs of it, each with its own ${number} in its options"}, repeat, {1, 100'000});
  visitor.text({"seed", "option that seeds change; none: loop.seed of trainings, else seed"}, seed);
  visitor.boolean({"shared", "one run for all seeds"}, shared);
  visitor.boolean({"alone", "nothing else runs beside it: it is timed"}, alone);
}

void VariantDescription::visit(FieldVisitor& visitor) {
  visitor.text({"label", "as tables call it"}, label);
  visitor.text({"model", "bundle folder of its base"}, model);
  visitor.texts({"stages", "those that it takes; none: all"}, stages);
  visitor.text({"result", "stage whose rows count; none: its last one"}, result);
  visitor.text({"series", "line of the plot that it is a point of"}, series);
  visitor.real({"x", "where on that line"}, x);
}

void MetricDescription::visit(FieldVisitor& visitor) {
  visitor.text({"column", "of the rows; none: the metric's name"}, column);
  visitor.text({"better", "higher, lower or near 1"}, better);
  visitor.text({"unit", "of its numbers"}, unit);
}

Better MetricDescription::direction() const {
  for (const Better direction : {Better::kHigher, Better::kLower}) {
    if (better == better_name(direction)) return direction;
  }
  return Better::kNearOne;
}

void ClaimDescription::visit(FieldVisitor& visitor) {
  visitor.text({"metric", "by which"}, metric);
  visitor.text({"better", "the variant that is claimed to be better"}, better);
  visitor.text({"worse", "than this variant"}, worse);
  visitor.texts({"beyond", "by more than the first of these two variants is better than the second"}, beyond);
  visitor.text({"paper", "what the paper reports, for reference"}, paper);
}

const StageDescription& Ablation::stage(const std::string& name) const {
  return *std::find_if(stages.begin(), stages.end(),
                       [&](const StageDescription& item) { return item.name == name; });
}

const VariantDescription* Ablation::variant(const std::string& name) const {
  for (const VariantDescription& item : variants) {
    if (item.name == name) return &item;
  }
  return nullptr;
}

const MetricDescription& Ablation::metric(const std::string& name) const {
  return *std::find_if(metrics.begin(), metrics.end(),
                       [&](const MetricDescription& item) { return item.name == name; });
}

std::vector<OptionSetting> Ablation::settings_of(const VariantDescription& variant,
                                                 const StageDescription& stage) const {
  std::vector<OptionSetting> settings = stage.settings;
  const auto add = [&](const std::map<std::string, std::vector<OptionSetting>>& by_stage) {
    const auto found = by_stage.find(stage.name);
    if (found != by_stage.end()) settings.insert(settings.end(), found->second.begin(), found->second.end());
  };
  add(variant.settings);
  if (options.smoke) add(smoke);
  for (const std::string& text : options.overrides) {
    const size_t dot = text.find('.');
    const size_t equals = text.find('=');
    if (text.substr(0, dot) != stage.name) continue;
    settings.push_back({text.substr(dot + 1, equals - dot - 1), text.substr(equals + 1),
                        "--overrides, stage " + quoted_text(stage.name)});
  }
  return settings;
}

void read_ablate_options(const std::filesystem::path& file, AblateOptions& options) {
  const YamlPlace place{file.string(), ""};
  const YAML::Node document = parse_yaml(read_file(file, kLargestDescription), file.string());
  require_map(document, place);
  for (const auto& entry : document) {
    const std::string key = key_text(entry.first, place);
    if (is_section(key)) continue;
    require_key(options, section_names(), key, place.of(entry.first));
    apply_setting(options, key, one_line(entry.second), place.of(entry.first));
  }
}

Ablation read_ablation(const std::filesystem::path& file, const AblateOptions& options) {
  Ablation ablation;
  ablation.options = options;
  ablation.file = file;
  ablation.text = read_file(file, kLargestDescription);
  const YamlPlace place{file.string(), ""};
  const YAML::Node document = parse_yaml(ablation.text, file.string());
  require_map(document, place);
  for (const char* needed : {"title", "stages", "variants", "metrics"}) {
    if (!document[needed])
      fail({file.string(), std::string("a section ") + needed, "none", "see docs/ABLATIONS.md"});
  }
  if (!document["title"].IsScalar()) {
    fail({place.of(document["title"]) + ", key 'title'", "text", "a list or a map", "write it on one line"});
  }
  ablation.title = document["title"].Scalar();
  ablation.stages = read_items<StageDescription>(document["stages"], place, "stage", read_stage);
  auto variants = read_items<VariantDescription>(document["variants"], place, "variant", read_variant);
  ablation.metrics =
      read_items<MetricDescription>(document["metrics"], place, "metric",
                                    [](const std::string& name, const YAML::Node& node, const YamlPlace& at) {
                                      MetricDescription metric;
                                      metric.name = metric.column = name;
                                      if (const Metric* known = known_metric(name)) {
                                        metric.better = better_name(known->better);
                                        metric.unit = known->unit;
                                      }
                                      if (!node.IsNull()) read_item(metric, node, at, {});
                                      return metric;
                                    });
  if (const YAML::Node claims = document["claims"]) {
    ablation.claims = read_items<ClaimDescription>(
        claims, place, "claim", [](const std::string& name, const YAML::Node& node, const YamlPlace& at) {
          ClaimDescription claim;
          claim.name = name;
          read_item(claim, node, at, {});
          return claim;
        });
  }
  if (const YAML::Node smoke = document["smoke"])
    ablation.smoke = read_stage_settings(smoke, {file.string(), "smoke"});

  const auto all = names_of(variants);
  for (const std::string& name : options.only) require_name(name, all, "--only", "variant");
  for (auto& variant : variants) {
    const bool wanted = options.only.empty() || std::find(options.only.begin(), options.only.end(),
                                                          variant.name) != options.only.end();
    if (wanted) ablation.variants.push_back(std::move(variant));
  }
  for (const std::string& text : options.overrides) {
    require_name(text.substr(0, text.find('.')), names_of(ablation.stages), "--overrides", "stage");
  }
  if (options.smoke) ablation.options.seeds.resize(1);
  check_stages(ablation, file.string());
  check_metrics(ablation, file.string());
  check_variants(ablation, file.string());
  check_claims(ablation, all, file.string());
  return ablation;
}

bool trains(const std::string& command) { return command.rfind("train ", 0) == 0; }

bool makes_bundle(const std::string& command) {
  return trains(command) || command == "stats" || command == kAssembleCommand;
}

double gain(Better better, double first, double second) {
  switch (better) {
    case Better::kHigher:
      return first - second;
    case Better::kLower:
      return second - first;
    case Better::kNearOne:
      break;
  }
  return std::abs(second - 1) - std::abs(first - 1);
}

}  // namespace gld
