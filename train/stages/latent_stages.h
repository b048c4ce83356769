#pragma once

#include "train/objectives/cascade_objective.h"
#include "train/objectives/flow_objective.h"
#include "train/stages/training_stage.h"

#include <cstdint>
#include <string>

namespace gld {

struct TrainLevelOptions : TrainOptions {
  int64_t level = 1;
  FlowObjectiveOptions objective;
  void visit(FieldVisitor& visitor) override;
};

struct TrainCascadeOptions : TrainOptions {
  std::string cascade = "1->0";
  CascadeObjectiveOptions objective;
  void visit(FieldVisitor& visitor) override;
};

struct StatsOptions : OptionsGroup {
  std::string model;
  std::string out;
  bool overwrite = false;
  std::string device = "cpu";
  int64_t threads = 0;
  int64_t scene_count = 512;
  ProcessesOptions processes;
  TrainingDataOptions data;

  StatsOptions();
  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// Returns what sampling takes of a bundle beside its generators, which are shown so many photographs in each target
// view; no statistics.
FrozenParts frozen_parts_of_sampling(const ModelBundle& bundle, int64_t warped_sources,
                                     const ParameterPlacement& placement, CarryingDepth carried_by);
// Returns what the training of that part needs of a bundle.
FrozenParts frozen_parts(const ModelBundle& bundle, const LevelGenerator& generator,
                         const ParameterPlacement& placement,
                         CarryingDepth carried_by = CarryingDepth::kHead);

// gld train level and gld train cascade; see run_training_stage.
std::string train_level(const TrainLevelOptions& options, const DrawValidation& draw);
std::string train_cascade(const TrainCascadeOptions& options, const DrawValidation& draw);

// gld stats: latent statistics of every level that the model generates over training scenes, all views of a scene
// encoded together; of special tokens too where it generates them; and of drawn scenes, which are in metres, the unit
// of the geometry head (BundleOptions::single_source_unit and its deviation). model/ in the run folder is a copy of
// the bundle with them, and with single_view_unit.safetensors where 16 scenes or more have a view that tells a unit
// (models/bundle/view_unit_file.h). Several processes take a batch each in turns; the result is the same to the bit,
// but for that file, whose last digits follow the head's. Returns the closing box as text, an empty one where another
// process writes the run folder.
std::string compute_statistics(const StatsOptions& options);

}  // namespace gld
