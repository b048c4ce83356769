#include "cli/export_command.h"

#include "gld/base/error.h"
#include "infer/run_export/run_export.h"

#include <memory>

namespace gld {

Command make_export_command() {
  auto options = std::make_shared<ExportOptions>();
  Command command;
  command.name = "export";
  command.summary = "Hand a run of gld sample on: GLB, COLMAP, nerfstudio, WebP, MP4";
  command.description =
      "Example: gld export runs/first --as glb,colmap,nerfstudio,webp,mp4 --out runs/first_exported\n"
      "It reads the run folder alone. What each file holds is in docs/EXPORT.md.";
  command.arguments = {"RUN", 0, 1};
  command.options = options;
  command.on_named = [options](const std::vector<std::string>& keys) { options->named = keys; };
  command.run = [options](const std::vector<std::string>& arguments) {
    if (!arguments.empty()) {
      if (!options->run.empty() && options->run != arguments[0])
        fail({"--run", "one run folder", "two", "name it once"});
      options->run = arguments[0];
    }
    run_export(*options);
    return 0;
  };
  return command;
}

}  // namespace gld
