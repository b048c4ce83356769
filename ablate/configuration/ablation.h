#pragma once

#include "gld/base/options.h"
#include "gld/metrics/metric.h"

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

namespace gld {

// gld ablate: what is compared stands in a YAML file (docs/ABLATIONS.md), how it is run in these options; the file may
// give them too, at its outermost level.
struct AblateOptions : OptionsGroup {
  std::string out;
  bool overwrite = false;
  std::string cache;  // empty: cache/ in the run folder
  std::string model = "configs/tiny";
  std::vector<int64_t> seeds{0, 1, 2};
  std::vector<std::string> with_runs;  // folders of this ablation under other seeds, which count as well
  std::vector<std::string> only;       // variants; empty: all
  std::vector<std::string> overrides;  // "STAGE.KEY=VALUE"
  bool smoke = false;
  bool plan = false;
  int64_t jobs = 0;     // 0: as many as the cores hold
  int64_t threads = 1;  // of each
  std::string device = "cpu";
  int64_t bootstrap = 10'000;
  bool json = false;

  void visit(FieldVisitor& visitor) override;
  void check() const override;

  int64_t jobs_to_use() const;
};

// A value that the description gives to an option of a stage: the leaf of nested maps.
struct OptionSetting {
  std::string key;    // "views.most_sources"
  std::string value;  // YAML on one line
  std::string where;  // "configs/ablations/sources.yaml:14, variant 'n1', stage 'eval'"
};

// The command of the one kind of stage that is no command of the program: a bundle put together of others, with
// settings of its model.yaml.
constexpr const char* kAssembleCommand = "assemble";
// `model` of a stage says this for the bundle of the ablation or its variant.
constexpr const char* kBaseModel = "base";

bool trains(const std::string& command);  // "train level"
bool makes_bundle(const std::string& command);

struct StageDescription : OptionsGroup {
  std::string name;
  std::string command;  // "train level", "eval", "assemble"
  std::string config;   // YAML file of the command's options
  std::string model;    // a stage, "base", or empty: the stage before that makes a bundle, else base
  std::vector<std::string> parts;  // assemble: stages whose trained parts are taken
  std::string resume;              // stage whose run this one goes on with
  std::string results =
      "eval.csv";       // file of its run folder whose rows count, where it is a variant's result
  int64_t repeat = 1;   // runs of it, each with a ${number} of its own in its options, 000000 the first
  std::string seed;     // option that seeds change; empty: loop.seed, else seed
  bool shared = false;  // by all seeds: its own seed stays as the configuration says
  bool alone = false;   // nothing else runs beside it
  std::vector<OptionSetting> settings;

  void visit(FieldVisitor& visitor) override;
};

struct VariantDescription : OptionsGroup {
  std::string name;
  std::string label;                // as tables call it
  std::string model;                // bundle folder; empty: the ablation's
  std::vector<std::string> stages;  // that it takes; empty: all
  std::string result;               // stage whose rows count; empty: its last one
  std::string series;               // of the plot, with x
  double x = 0;
  std::map<std::string, std::vector<OptionSetting>> settings;  // by stage
  std::map<std::string, std::string> rows;                     // columns that a row must have this text in
  std::map<std::string, std::string> columns;  // metric -> column, where it is not the metric's own

  void visit(FieldVisitor& visitor) override;
};

// A number of every row that variants are compared by.
struct MetricDescription : OptionsGroup {
  std::string name;
  std::string column;  // of the rows; empty: the name
  std::string better;  // "higher", "lower", "near 1"; empty where gld/metrics has a metric of that name
  std::string unit;

  void visit(FieldVisitor& visitor) override;
  Better direction() const;  // after reading it is known
};

struct ClaimDescription : OptionsGroup {
  std::string name;
  std::string metric;
  std::string better;  // variant
  std::string worse;   // variant
  // Two variants, or none: claimed is that `better` is above `worse` by more than the first of them is above the
  // second.
  std::vector<std::string> beyond;
  std::string paper;  // what the paper reports, for reference

  void visit(FieldVisitor& visitor) override;
};

struct Ablation {
  AblateOptions options;
  std::filesystem::path file;
  std::string title;
  std::string text;  // of the file
  std::vector<StageDescription> stages;
  std::vector<VariantDescription> variants;  // those of options.only, in the file's order
  std::vector<MetricDescription> metrics;
  std::vector<ClaimDescription> claims;
  std::map<std::string, std::vector<OptionSetting>> smoke;  // by stage: what makes a smoke run of it

  const StageDescription& stage(const std::string& name) const;
  const VariantDescription* variant(const std::string& name) const;  // null where it is not among those
  const MetricDescription& metric(const std::string& name) const;
  // Returns what a variant's stage is given beyond its configuration, in the order of application: of the stage, of the
  // variant, of a smoke run, of options.overrides.
  std::vector<OptionSetting> settings_of(const VariantDescription& variant,
                                         const StageDescription& stage) const;
};

// Applies the options that the file gives to `options`. Throws Error for a file that is no ablation.
void read_ablate_options(const std::filesystem::path& file, AblateOptions& options);
// Reads the whole description under options that are complete. Throws Error, with line and section, for unknown keys,
// stages, variants and metrics, and for a description that could not be run.
Ablation read_ablation(const std::filesystem::path& file, const AblateOptions& options);

// Returns how much better `first` is than `second` by a metric of that direction: what a claim is about. Values near 1
// are compared by their distance from it.
double gain(Better better, double first, double second);

}  // namespace gld
