#include "cli/doctor_command.h"

#include "infer/forecast/doctor.h"
#include "train/distributed/process_team.h"

#include <iostream>

namespace gld {

Command make_doctor_command() {
  auto options = std::make_shared<DoctorOptions>();
  Command command;
  command.name = "doctor";
  command.summary = "Examine this machine, and forecast time and memory for a model";
  command.options = options;
  command.run = [options](const std::vector<std::string>&) {
    std::cout << doctor_report(*options, process_engines());
    return 0;
  };
  return command;
}

}  // namespace gld
