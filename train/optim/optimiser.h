#pragma once

#include "gld/base/options.h"
#include "gld/kernels/adam_kernel.h"
#include "train/optim/flat_parameters.h"

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

enum class OptimiserAlgorithm { kAdamW, kAdam, kMuon };

// See DESIGN.md section 4, "Training numbers".
struct OptimiserOptions : OptionsGroup {
  OptimiserAlgorithm algorithm = OptimiserAlgorithm::kAdamW;
  std::vector<double> betas = {0.9, 0.95};
  double momentum = 0.95;  // muon's
  double epsilon = 1e-8;
  double weight_decay = 0.0;
  double clip_norm = 1.0;
  double ema_decay = 0.9995;

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// Elements of a flat tensor.
struct FlatRange {
  int64_t begin = 0;
  int64_t end = 0;  // behind the last

  int64_t length() const { return end - begin; }
};

// Adam (Kingma & Ba, algorithm 1) or AdamW (Loshchilov & Hutter, algorithm 2) with clipping by the global
// gradient norm and an exponential moving average of the values, over flat buffers.
//
// Muon (Jordan et al. 2024; update size of Liu et al. 2025, "Muon is scalable for LLM training", section 2.2): a matrix
// of a block, or a convolution's kernels as one of a row an output channel, moves by the orthogonal factor of its
// Nesterov momentum, approximated by five Newton-Schulz steps, times 0.2 sqrt(larger side), which gives an update the
// root mean square of AdamW's, so that one learning rate serves both.
// Everything else (embeddings, modulation, norms, biases, output layers) is moved by AdamW.
class Optimiser {
 public:
  // The average starts at the present values. own is what step() moves, and has moments and an average of; it is
  // everything where it is left out. Throws Error for a part of Muon's matrices, which move as a whole.
  Optimiser(FlatParameters& parameters, const OptimiserOptions& options, std::optional<FlatRange> own = {});

  const FlatRange& own() const { return own_; }

  // Returns the L2 norm of all gradients, not of the own ones alone, accumulated in double; it does not depend on the
  // number of threads.
  double gradient_norm() const;
  // Does one update with the gradients clipped from gradient_norm to clip_norm, then the moving average. Several
  // workers share Muon's matrices, where LibTorch's threads were divided among them; with a thread for each, their
  // number changes no bit.
  void step(double learning_rate, double gradient_norm, int64_t workers = 1);

  int64_t steps_taken() const { return steps_; }
  bool has_average() const { return average_.defined(); }
  const torch::Tensor& average() const { return average_; }  // flat, of own(); undefined without one

  // Returns whether that parameter is one of Muon's matrices.
  static bool is_block_matrix(const NamedParameter& item);

  // Returns everything step() depends on beside values and gradients: "steps", and flat tensors of own().
  std::map<std::string, torch::Tensor> state() const;
  // Returns what it is at the start of a run with the present values, of all parameters.
  std::map<std::string, torch::Tensor> whole_initial_state() const;
  // Takes its own part of such a state of all parameters. Throws Error naming the tensor that is missing or misshapen.
  void load_state(const std::map<std::string, torch::Tensor>& state, const std::string& where);

 private:
  void adam_step(const AdamStep& step, int64_t begin, int64_t end);
  void muon_step(double learning_rate, double gradient_scale, int64_t workers);
  void move_matrix(size_t index, double learning_rate, double gradient_scale);

  FlatParameters* parameters_;
  OptimiserOptions options_;
  FlatRange own_;
  int64_t steps_ = 0;
  torch::Tensor first_moment_;
  torch::Tensor second_moment_;
  torch::Tensor average_;
};

// Returns the orthogonal factor U V^T of a matrix U S V^T, roughly: singular values come out between about 0.7 and 1.2,
// whatever they were. It takes five steps of the quintic Newton-Schulz iteration of Muon.
torch::Tensor nearly_orthogonal(const torch::Tensor& matrix);

// Puts the moving average in the place of the parameters for as long as it lives (validation, export).
class AverageInPlace {
 public:
  // average is flat, of all parameters; undefined leaves them as they are.
  AverageInPlace(FlatParameters& parameters, const torch::Tensor& average);
  ~AverageInPlace();
  AverageInPlace(const AverageInPlace&) = delete;
  AverageInPlace& operator=(const AverageInPlace&) = delete;

 private:
  FlatParameters* parameters_;
  torch::Tensor trained_;  // undefined without an average
};

}  // namespace gld
