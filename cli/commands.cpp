#include "cli/commands.h"

#include "cli/bench_command.h"
#include "cli/convert_command.h"
#include "cli/doctor_command.h"
#include "cli/inspect_command.h"
#include "cli/verify_command.h"

namespace gld {

std::vector<Command> all_commands() {
  return {make_bench_command(), make_convert_command(), make_doctor_command(), make_inspect_command(),
          make_verify_command()};
}

}  // namespace gld
