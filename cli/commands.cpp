#include "cli/commands.h"

#include "cli/ablate_command.h"
#include "cli/check_data_command.h"
#include "cli/completion_command.h"
#include "cli/convert_command.h"
#include "cli/doctor_command.h"
#include "cli/eval_command.h"
#include "cli/export_command.h"
#include "cli/inspect_command.h"
#include "cli/plan_command.h"
#include "cli/report_command.h"
#include "cli/sample_command.h"
#include "cli/splat_command.h"
#include "cli/stats_command.h"
#include "cli/synth_command.h"
#include "cli/train_command.h"
#include "cli/verify_command.h"
#ifdef GLD_BENCHMARKS
#include "cli/bench_command.h"
#endif

namespace gld {

std::vector<Command> all_commands() {
  std::vector<Command> commands = {make_sample_command(),  make_report_command(), make_export_command(),
                                   make_plan_command(),    make_doctor_command(), make_convert_command(),
                                   make_inspect_command(), make_verify_command(), make_check_data_command(),
                                   make_synth_command(),   make_train_command(),  make_stats_command(),
                                   make_eval_command(),    make_splat_command(),  make_ablate_command()};
#ifdef GLD_BENCHMARKS
  commands.push_back(make_bench_command());
#endif
  commands.push_back(make_completion_command(all_commands));
  return commands;
}

}  // namespace gld
