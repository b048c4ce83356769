#include "gld/distributed/process_placement.h"

#include "gld/base/error.h"

#include <cstdlib>

namespace gld {
namespace {

constexpr int64_t kMostProcesses = 100000;
constexpr int64_t kLargestPort = 65535;

// Returns the option where it is given (not below least), else the variable, else nothing.
std::optional<int64_t> number_of(int64_t option, int64_t least, const char* variable, int64_t largest,
                                 const Environment& environment) {
  if (option >= least) return option;
  const auto text = environment(variable);
  if (!text) return std::nullopt;
  const bool plain =
      text->size() < 10 && text->find_first_not_of("0123456789") == std::string::npos && !text->empty();
  const int64_t value = plain ? std::stoll(*text) : -1;
  if (value < least || value > largest) {
    fail({std::string("the environment's ") + variable,
          "a number from " + std::to_string(least) + " to " + std::to_string(largest), "'" + *text + "'",
          "correct or unset it; without these variables one process works alone"});
  }
  return value;
}

template <class Value>
Value required(const std::optional<Value>& value, const char* flag, const char* variable,
               const std::string& expected) {
  if (value) return *value;
  fail(
      {flag, expected + " (or " + variable + " in the environment)", "neither",
       "start the processes with torchrun --no_python, or give each all of --processes.rank, --processes.count, "
       "--processes.master-address and --processes.master-port"});
}

}  // namespace

void ProcessesOptions::visit(FieldVisitor& visitor) {
  visitor.integer(
      {"count", "processes that work together; 0: the environment's WORLD_SIZE, or this one alone"}, count,
      {0, kMostProcesses});
  visitor.integer({"rank", "which of them this is, from 0; -1: the environment's RANK"}, rank,
                  {-1, kMostProcesses - 1});
  visitor.integer(
      {"local_rank", "which of those on this machine, for --device cuda; -1: the environment's LOCAL_RANK"},
      local_rank, {-1, kMostProcesses - 1});
  visitor.text({"master_address", "where the process of rank 0 is; empty: the environment's MASTER_ADDR"},
               master_address);
  visitor.integer({"master_port", "a free TCP port there; 0: the environment's MASTER_PORT"}, master_port,
                  {0, kLargestPort});
  visitor.integer({"join_seconds", "how long to wait for the other processes at the start"}, join_seconds,
                  {1, 86400});
}

std::optional<std::string> variable_of_this_process(const std::string& name) {
  const char* value = std::getenv(name.c_str());
  if (value == nullptr || *value == '\0') return std::nullopt;
  return std::string(value);
}

ProcessPlacement process_placement(const ProcessesOptions& options, const Environment& environment) {
  ProcessPlacement placement;
  placement.join_seconds = static_cast<double>(options.join_seconds);
  placement.count = number_of(options.count, 1, "WORLD_SIZE", kMostProcesses, environment).value_or(1);
  const auto rank = number_of(options.rank, 0, "RANK", kMostProcesses - 1, environment);
  placement.local_rank =
      number_of(options.local_rank, 0, "LOCAL_RANK", kMostProcesses - 1, environment).value_or(0);
  if (rank && *rank >= placement.count) {
    fail({"--processes.rank",
          "a rank from 0 to " + std::to_string(placement.count - 1) + ", for " +
              std::to_string(placement.count) + " processes",
          std::to_string(*rank),
          "give every process the same count (WORLD_SIZE) and a rank of its own (RANK)"});
  }
  if (placement.count == 1) return placement;
  placement.rank = required(rank, "--processes.rank", "RANK", "the rank of this process");
  auto address = options.master_address.empty() ? environment("MASTER_ADDR")
                                                : std::optional<std::string>(options.master_address);
  placement.master_address =
      required(address, "--processes.master-address", "MASTER_ADDR", "the address of the machine of rank 0");
  placement.master_port =
      required(number_of(options.master_port, 1, "MASTER_PORT", kLargestPort, environment),
               "--processes.master-port", "MASTER_PORT", "a free port on the machine of rank 0");
  placement.store_is_hosted = environment("TORCHELASTIC_USE_AGENT_STORE") == "True";
  placement.attempt = environment("TORCHELASTIC_RESTART_COUNT").value_or("0");
  return placement;
}

}  // namespace gld
