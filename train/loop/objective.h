#pragma once

#include "gld/base/options.h"
#include "gld/files/dtype.h"
#include "gld/machine/matrix_unit.h"
#include "train/data/training_scene.h"
#include "train/optim/flat_parameters.h"

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <torch/types.h>

namespace gld {

// What a model is trained from.
enum class ModelStart {
  kRandom,  // from nothing
  kBundle,  // from the weights that the bundle holds: fine-tuning, or going on where checkpoints are lost
};
void visit_start(FieldVisitor& visitor, ModelStart& start);

struct StepContext {
  int64_t step = 0;            // from 0
  int64_t total_steps = 0;     // of the run
  torch::Generator generator;  // on the CPU; its state is part of the checkpoint
};

struct Losses {
  torch::Tensor total;                                       // scalar that backward() is called on
  std::vector<std::pair<std::string, torch::Tensor>> parts;  // detached scalars for the log
};

// Pictures of one validation scene, one row of a contact sheet: (3, height, width) in [0, 1] each.
struct PictureRow {
  std::string name;
  std::vector<std::pair<std::string, torch::Tensor>> pictures;
};

struct Validation {
  std::vector<std::pair<std::string, double>> values;  // the first is what the best checkpoint minimises
  std::vector<PictureRow> rows;
};

// A training run optimises this. The loop (train/loop/training_loop.h) owns the order of things; an objective owns its
// models.
class Objective {
 public:
  virtual ~Objective() = default;
  virtual std::string kind() const = 0;
  virtual torch::Device device() const = 0;
  // Returns the parameters that the loop's optimiser moves, in a fixed order.
  virtual std::vector<NamedParameter> parameters() const = 0;
  // Returns the other tensors of the trained model: no step moves them (the frequencies of a time embedding, an
  // encoder of cameras that no loss reaches), and weights that were learnt beside others are worth nothing, so that a
  // checkpoint has them too.
  virtual std::vector<NamedParameter> untrained() const = 0;
  // Returns whether losses() may be called from several threads at the same time.
  virtual bool concurrent() const { return false; }
  // Returns whether micro-batches may be computed in different processes: losses() leaves nothing that after_step()
  // takes.
  virtual bool spreads_over_processes() const { return true; }
  // Sets what the trained model multiplies in while it learns (models/layers/layer_precision.h); it is called once,
  // before the first step. Returns how many of its layers follow. On a GPU autocast sees to it.
  virtual int64_t learn_in(ComputePrecision precision) = 0;
  // Returns losses averaged over the scenes of a micro-batch, with gradients.
  virtual Losses losses(const TrainingBatch& batch, const StepContext& context) = 0;
  // Called after the optimiser's step (the discriminator of a GAN moves here). Returns more for the log.
  virtual std::vector<std::pair<std::string, double>> after_step(const StepContext& context);
  // Validates without gradients, with the moving average in place.
  virtual Validation validate(const std::vector<TrainingScene>& scenes) = 0;
  // Returns the state beside the parameters: discriminator, its optimiser.
  virtual std::map<std::string, torch::Tensor> state() const;
  virtual void load_state(const std::map<std::string, torch::Tensor>& state, const std::string& where);
  // Writes the trained model as a bundle into folder, with the moving average in place, in that precision.
  virtual void export_model(const std::filesystem::path& folder, DType dtype) const = 0;
};

}  // namespace gld
