#include "cli/doctor_command.h"

#include "gld/distributed/process_team.h"
#include "gld/report/report_text.h"
#include "infer/forecast/doctor.h"

namespace gld {

Command make_doctor_command() {
  auto options = std::make_shared<DoctorOptions>();
  Command command;
  command.name = "doctor";
  command.summary = "Examine this machine, and forecast time and memory for a model";
  command.options = options;
  command.run = [options](const std::vector<std::string>&) {
    print_report(doctor_report(*options, process_engines()));
    return 0;
  };
  return command;
}

}  // namespace gld
