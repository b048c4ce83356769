#include "cli/bench_command.h"

#include "bench/device/device_benchmark.h"
#include "bench/extremes/extremes_benchmark.h"
#include "bench/kernels/attention_benchmark.h"
#include "bench/kernels/forward_benchmark.h"
#include "bench/photogrammetry/stereo_benchmark.h"
#include "bench/processes/process_benchmark.h"
#include "bench/sampling/sample_benchmark.h"
#include "bench/solvers/solver_benchmark.h"
#include "bench/solvers/stiff_benchmark.h"
#include "bench/splatting/splat_benchmark.h"
#include "bench/training/train_benchmark.h"

#include <memory>
#include <string>
#include <vector>

namespace gld {
namespace {

// A report that takes no arguments, only options.
template <class Options>
Command report_command(const std::string& name, const std::string& summary, int (*run)(const Options&)) {
  auto options = std::make_shared<Options>();
  Command command;
  command.name = "bench " + name;
  command.summary = summary;
  command.options = options;
  command.run = [options, run](const std::vector<std::string>&) { return run(*options); };
  return command;
}

}  // namespace

Command make_bench_command() {
  Command command;
  command.name = "bench";
  command.summary = "Measure error against run time, and numerical stability";
  command.description =
      "Examples: gld bench solvers --out runs/solvers\n"
      "          gld bench sample --synthetic 16 --precisions bfloat16,int8 --write-table --out runs/sample\n"
      "Each writes tables (CSV and Markdown), plots and report.json into its run folder.";
  command.subcommands = {
      report_command("solvers", "Solvers and schedules on flows whose solution is known",
                     run_solver_benchmark),
      report_command("stiff", "Solvers on stiff problems: which finish, which fail and how",
                     run_stiff_benchmark),
      report_command(
          "sample",
          "Every way to sample a scene, by solver, count, savings and precision: error against run time",
          run_sample_benchmark),
      report_command("extremes", "Cameras, logits, norms and flows at the ends of their range",
                     run_extremes_benchmark),
      report_command("attention", "Attention kernels beside LibTorch's composition, as fractions of peak",
                     run_attention_benchmark),
      report_command("forward", "One evaluation of M1 beside LibTorch's composition, as fractions of peak",
                     run_forward_benchmark),
      report_command("stereo",
                     "Depth that photographs agree on: seconds, and its loops beside the machine's peaks",
                     run_stereo_benchmark),
      report_command("splat",
                     "Splatting beside a dense rendering by LibTorch, and error of fits against time",
                     run_splat_benchmark),
      report_command("train", "Training steps, their memory and the optimiser, as fractions of peak",
                     run_train_benchmark),
      report_command("device",
                     "M1 on a GPU: an evaluation, training steps and memory, as fractions of its products",
                     run_device_benchmark),
      report_command(
          "processes",
          "What working together costs training, and a forecast for more; started in every process",
          run_process_benchmark)};
  return command;
}

}  // namespace gld
