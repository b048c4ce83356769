#include "gld/base/command_options.h"

#include "gld/base/error.h"

#include <algorithm>
#include <filesystem>
#include <thread>

namespace gld {

void visit_out(FieldVisitor& visitor, std::string& out) {
  visitor.text({"out", "folder to write into: a new one, or see --overwrite"}, out);
}

void visit_out(FieldVisitor& visitor, std::string& out, bool& overwrite) {
  visit_out(visitor, out);
  visitor.boolean(
      {"overwrite", "begin anew: what an earlier run of this command wrote goes with the first result"},
      overwrite);
}

void check_out(const std::string& out, const std::string& example) {
  if (out.empty()) fail({"--out", "a folder to write into", "nothing", "add for example --out " + example});
}

void check_input_survives(const std::string& option, const std::string& input, const std::string& out,
                          bool overwrite) {
  if (!overwrite) return;
  const auto place = [](const std::string& path) {  // without the slash at its end
    const auto canonical = std::filesystem::weakly_canonical(std::filesystem::absolute(path));
    return canonical.has_filename() ? canonical : canonical.parent_path();
  };
  const auto from_out = place(input).lexically_relative(place(out));
  if (from_out.empty() || *from_out.begin() == "..") return;
  fail({option, "a folder outside " + out + ", where --overwrite removes what an earlier run wrote", input,
        "write into another --out"});
}

const std::vector<std::string>& options_beside_the_result() {
  static const std::vector<std::string> names{"out",  "overwrite", "resume",  "threads",
                                              "json", "processes", "preview", "kept_scenes"};
  return names;
}

void visit_threads(FieldVisitor& visitor, int64_t& threads) {
  visitor.integer({"threads", "threads that compute; 0: one a core"}, threads, {0, kMostThreads});
}

int64_t threads_to_use(int64_t threads) {
  // The system may not tell, which is 0 too.
  return threads > 0 ? threads : std::max<int64_t>(1, std::thread::hardware_concurrency());
}

void visit_json(FieldVisitor& visitor, bool& json) {
  visitor.boolean({"json", "print the report as JSON in the place of text"}, json);
}

void visit_device(FieldVisitor& visitor, std::string& device) {
  visitor.text({"device", "cpu, cuda or cuda:N"}, device);
}

void visit_seed(FieldVisitor& visitor, int64_t& seed, const std::string& of) {
  visitor.integer({"seed", "seed of " + of + "; the same seed gives the same bytes"}, seed, {0});
}

void visit_scene(FieldVisitor& visitor, std::string& scene) {
  visitor.text({"scene", "folder that is one scene: images with cameras, in any layout of gld check-data"},
               scene);
}

void visit_scenes(FieldVisitor& visitor, std::vector<std::string>& scenes, const std::string& instead_of) {
  visitor.texts({"scenes", "folders of scenes, in any layout of gld check-data; none: " + instead_of},
                scenes);
}

}  // namespace gld
