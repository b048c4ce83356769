#include "cli/check_data_command.h"

#include "datasets/check/data_check.h"

namespace gld {

Command make_check_data_command() {
  auto options = std::make_shared<DataCheckOptions>();
  Command command;
  command.name = "check-data";
  command.summary = "Say what a scene or dataset holds, and name the usual mistakes with evidence";
  command.description =
      "Example: gld check-data my_photos --out runs/check\n"
      "Recognises the layout, counts frames, measures intrinsics, poses and overlap, "
      "and tests on the pixels whether poses are OpenGL instead of OpenCV or camera_from_world instead of "
      "world_from_camera. Normalised intrinsics, EXIF rotation, outliers and damaged files are named too. "
      "The exit status is 1 when there is a problem.";
  command.arguments = {"DIR", 1, 1};
  command.options = options;
  command.run = [options](const std::vector<std::string>& arguments) {
    return run_data_check(arguments[0], *options);
  };
  return command;
}

}  // namespace gld
