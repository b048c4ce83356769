#pragma once

#include "gld/base/atomic_file.h"
#include "gld/base/child_process.h"
#include "gld/base/work_folder.h"

#include <chrono>
#include <string>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

namespace gld::test {

struct ProgramOutput {
  int status = -1;
  std::string text;  // standard output and standard error
};

// Runs a program of the PATH to its end; fails the test where there is none (scripts/setup.sh --testing installs those
// that tests run).
inline ProgramOutput run_program(const std::string& name, const std::vector<std::string>& arguments) {
  ProgramOutput output;
  const auto program = found_program(name);
  EXPECT_FALSE(program.empty()) << name << " is not installed; run scripts/setup.sh --testing";
  if (program.empty()) return output;
  const WorkFolder folder("test");
  std::vector<std::string> command{program.string()};
  command.insert(command.end(), arguments.begin(), arguments.end());
  {
    ChildProcess process(command, folder.log(), -1);
    while (!process.poll()) std::this_thread::sleep_for(std::chrono::milliseconds(2));
    output.status = process.poll()->status;
  }
  output.text = read_file(folder.log());
  return output;
}

}  // namespace gld::test
