#include "cli/ablate_command.h"

#include "ablate/report/ablation_run.h"
#include "cli/commands.h"
#include "gld/base/error.h"
#include "gld/base/sha256.h"
#include "gld/report/provenance.h"

#include <filesystem>
#include <iostream>
#include <memory>
#include <string>

namespace gld {
namespace {

constexpr const char* kThisProgram = "/proc/self/exe";

void list_stage_commands(const std::vector<Command>& commands, std::vector<Command>& found) {
  for (const Command& command : commands) {
    list_stage_commands(command.subcommands, found);
    if (command.options && command.subcommands.empty() && command.name != "ablate") found.push_back(command);
  }
}

std::vector<Command> stage_commands() {
  std::vector<Command> found;
  list_stage_commands(all_commands(), found);
  return found;
}

}  // namespace

ProgramCommands this_program() {
  ProgramCommands program;
  // In the child this is the parent's file, until the child has become that: a program that is built anew meanwhile
  // does not take its place.
  program.program = kThisProgram;
  constexpr size_t kHashDigits = 12;
  program.version = program_version() + ", executable " + sha256_of_file(kThisProgram).substr(0, kHashDigits);
  for (const Command& command : stage_commands()) program.names.push_back(command.name);
  program.options = [](const std::string& name) -> std::shared_ptr<OptionsGroup> {
    for (const Command& command : stage_commands()) {
      if (command.name == name) return command.options;
    }
    return nullptr;
  };
  return program;
}

Command make_ablate_command() {
  auto options = std::make_shared<AblateOptions>();
  auto file = std::make_shared<std::string>();
  Command command;
  command.name = "ablate";
  command.summary = "Train, measure and compare variants of a model, as a file describes them";
  command.description =
      "Example: gld ablate --config configs/ablations/sources.yaml --out runs/ablations/sources\n"
      "--config names the description: stages, each a command of gld, the variants' options, metrics, and what is claimed "
      "(docs/ABLATIONS.md). Stages that variants have in common run once and are kept in cache/; the same command goes on "
      "with an ablation that was stopped or killed. Writes ablation.md, ablation.csv, ablation.png, report.json and report.html: means with "
      "95 % intervals, and a verdict a claim, paired by scene, noise and seed. --plan says what would run and what it takes.";
  command.options = options;
  command.read_config = [options, file](const std::string& config) {
    *file = config;
    read_ablate_options(config, *options);
  };
  command.run = [options, file](const std::vector<std::string>&) {
    if (file->empty()) {
      fail({"--config", "the description of an ablation", "nothing",
            "add for example --config configs/ablations/sources.yaml"});
    }
    const AblationOutcome outcome = run_ablation(read_ablation(*file, *options), this_program());
    std::cout << outcome.text;
    return outcome.complete ? 0 : 1;
  };
  return command;
}

}  // namespace gld
