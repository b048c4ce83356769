#include "datasets/synthetic/synth.h"

#include "datasets/formats/scene_writer.h"
#include "gld/base/command_options.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/report/progress.h"
#include "gld/report/run_folder.h"

#include <algorithm>
#include <atomic>
#include <exception>
#include <iostream>
#include <mutex>
#include <thread>
#include <vector>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace gld {

SynthOptions::SynthOptions() { scene.scene_count = 4; }

void SynthOptions::visit(FieldVisitor& visitor) {
  visitor.group({"scene", "what is generated"}, scene);
  visitor.text({"layout", fmt::format("on disk: {}", fmt::join(scene_layout_names(), ", "))}, layout);
  visit_out(visitor, out, overwrite);
  visit_threads(visitor, threads);
}

void SynthOptions::check() const {
  check_out(out, "runs/synth");
  const auto known = scene_layout_names();
  if (std::find(known.begin(), known.end(), layout) == known.end()) {
    fail({"--layout", fmt::format("one of {}", fmt::join(known, ", ")), "\"" + layout + "\"",
          "choose one of them"});
  }
  scene.check();
}

void run_synth(const SynthOptions& options) {
  options.check();
  RunFolder run(options.out, "synth", options, earlier_run(options.overwrite));
  const auto folder = run.subfolder("scenes");
  Progress progress("scenes", options.scene.scene_count);
  std::atomic<int64_t> next{0};
  std::atomic<int64_t> done{0};
  std::mutex mutex;
  std::exception_ptr problem;
  const auto work = [&] {
    for (int64_t i = next++; i < options.scene.scene_count && !interrupt_requested(); i = next++) {
      try {
        const Scene scene = make_synthetic_scene(options.scene, i);
        write_scene(scene, options.layout, folder / scene.name);
      } catch (...) {
        const std::lock_guard<std::mutex> lock(mutex);
        if (!problem) problem = std::current_exception();
        return;
      }
      const std::lock_guard<std::mutex> lock(mutex);
      progress.update(++done);
    }
  };
  std::vector<std::thread> threads;
  const int64_t count = std::min(threads_to_use(options.threads), options.scene.scene_count);
  for (int64_t i = 0; i < count; ++i) threads.emplace_back(work);
  for (std::thread& thread : threads) thread.join();
  progress.finish();
  if (problem) std::rethrow_exception(problem);
  stop_if_interrupted(fmt::format("{} of {} scenes are written in {}", done.load(), options.scene.scene_count,
                                  folder.string()));
  nlohmann::ordered_json report;
  report["scenes"] = options.scene.scene_count;
  report["frames_each"] = options.scene.frames;
  report["layout"] = options.layout;
  run.write_report(report);
  run.note("scenes", "scenes/");
  run.note("report", "report.json");
  std::cout << run.closing_box();
}

}  // namespace gld
