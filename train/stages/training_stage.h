#pragma once

#include "gld/base/options.h"
#include "gld/distributed/process_placement.h"
#include "gld/files/stored_precision.h"
#include "models/bundle/bundle.h"
#include "train/data/training_data.h"
#include "train/loop/objective.h"
#include "train/loop/training_loop.h"

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <torch/types.h>

#include <nlohmann/json.hpp>

namespace gld {

// Every kind of gld train has these. model is a bundle: its model.yaml is the architecture, and the parts trained
// before are taken from it. The run's own bundle, model/ in the run folder, is a copy with the trained part.
struct StageOptions : OptionsGroup {
  std::string model;
  std::string out;
  bool overwrite = false;
  bool resume = false;
  std::vector<std::string> may_change;
  bool allow_mixed = false;
  std::string device = "cpu";
  int64_t threads = 0;
  StoredPrecision store = StoredPrecision::kFloat32;  // of the exported model
  ProcessesOptions processes;
  TrainingLoopOptions loop;

  void visit(FieldVisitor& visitor) override;
  void check() const override;

 protected:
  virtual void visit_data(FieldVisitor& visitor) = 0;
};

// Of those that train on scenes.
struct TrainOptions : StageOptions {
  TrainingDataOptions data;
  std::string
      kept_scenes;  // folder of drawn rooms and what frozen parts make of scenes, for other runs; may be empty

 protected:
  void visit_data(FieldVisitor& visitor) override;
};

using DrawValidation = std::function<void(const Validation& validation, const std::filesystem::path& file)>;

// What a stage trains on.
struct StageData {
  std::shared_ptr<const TrainingBatchSource> batches;
  std::function<std::vector<TrainingScene>()> validation;  // the scenes that it is validated on
  std::function<nlohmann::ordered_json()> report;          // what was wrong with the data; may be empty
};

// One kind of training: its data and how its objective is made.
struct TrainingStage {
  std::string command;  // "train backbone"
  std::function<StageData(const ModelBundle&)> data;
  int64_t views = 0;             // of a training scene, which flow models note
  std::vector<BundlePart> made;  // what the run trains; the other parts are copied
  ModelStart start = ModelStart::kRandom;
  std::function<std::unique_ptr<Objective>(const ModelBundle&, const ParameterPlacement&)> objective;
};

// Returns the folder where what these parts of the bundle make of scenes is kept (TrainOptions::kept_scenes), or null
// where that is empty. use: what is made, with every option that it depends on but those of these parts.
// Scenes that do not come again (data.distinct_batches: 0) are not kept.
std::shared_ptr<const KeptFolder> kept_scene_folder(const TrainOptions& options, const ModelBundle& bundle,
                                                    const std::vector<BundlePart>& frozen,
                                                    const torch::Device& device, const std::string& use);

// Returns a stage that trains on scenes with these parts.
TrainingStage scene_stage(const std::string& command, const TrainOptions& options, FrameParts parts);

// Throws Error where `now` differs from the options that the run in the folder was begun with, naming each: the run
// would go on as something that neither of them describes. What a run may go on with is left out: where it writes, how
// it computes, how far and how often, the course of its learning rate (not its height), and how its first weights were
// made; so is what may_change names.
// What an earlier program did not have is as in defaults, the same options as constructed.
void refuse_changed_options(const std::filesystem::path& folder, const OptionsGroup& now,
                            const OptionsGroup& defaults, const std::vector<std::string>& may_change);

// Runs a stage: run folder with the resolved configuration (all_options), loop, model/, report.json. Returns the
// closing box as text, an empty one where another process writes the run folder. draw may be empty.
std::string run_training_stage(const StageOptions& options, const OptionsGroup& all_options,
                               const OptionsGroup& defaults, const TrainingStage& stage,
                               const DrawValidation& draw);

// Writes into parts that a run made what they were trained on (models/bundle/part_lineage.h); the other parts are
// there.
void note_what_was_trained_on(const ModelBundle& bundle, const std::vector<BundlePart>& made);

// Copies the parts that a run did not make itself.
void copy_other_parts(const ModelBundle& from, const std::filesystem::path& to,
                      const std::vector<BundlePart>& made);

}  // namespace gld
