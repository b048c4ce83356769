// write_drawn_run FOLDER [WIDTHxHEIGHT SOURCES TARGETS plain|odd|splats|splats_without_points SCENE_NAME FRAME_NAME]
// writes a run folder of a drawn room with its page, for the test in a browser.
#include "gld/base/error.h"
#include "infer/page/report_command.h"
#include "tests/support/drawn_run.h"

#include <cstdio>
#include <filesystem>
#include <string>

int main(int count, char** words) {
  using namespace gld;
  if (count < 2) {
    std::fputs("write_drawn_run: expected a folder, found nothing; name one.\n", stderr);
    return 2;
  }
  try {
    test::DrawnRun drawn;
    if (count > 2) {
      const std::string size = words[2];
      drawn.width = std::stol(size);
      drawn.height = std::stol(size.substr(size.find('x') + 1));
    }
    if (count > 3) drawn.sources = std::stol(words[3]);
    if (count > 4) drawn.targets = std::stol(words[4]);
    if (count > 5) {
      const std::string kind = words[5];
      drawn.odd_pixels = kind == "odd";
      drawn.points = kind != "splats_without_points";
      drawn.splats = kind == "splats" || kind == "splats_without_points";
    }
    if (count > 6) drawn.scene_name = words[6];
    if (count > 7) drawn.first_name = words[7];
    std::filesystem::create_directories(words[1]);
    test::write_drawn_run(words[1], drawn);
    std::printf("%zu\n", write_run_page(words[1], PageOptions()));
  } catch (const Error& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
  return 0;
}
