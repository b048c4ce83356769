#include "datasets/check/data_check.h"
#include "datasets/images/image_file.h"
#include "datasets/pictures/camera_layout_picture.h"
#include "gld/base/json_text.h"
#include "gld/base/printable_text.h"
#include "gld/report/progress.h"
#include "gld/report/report_text.h"
#include "gld/report/run_folder.h"

#include <algorithm>
#include <iostream>
#include <memory>

#include <fmt/format.h>

namespace gld {
namespace {

std::string span_text(const Span& span, const char* unit) {
  if (span.high - span.low <= 1e-9 * span.high) return fmt::format("{:.6g}{}", span.low, unit);
  return fmt::format("{:.6g} to {:.6g}{}", span.low, span.high, unit);
}

nlohmann::ordered_json span_json(const Span& span) { return {span.low, span.high}; }

// Only one scene is asked for when the path is one.
std::vector<SceneLocation> scenes_at(const std::filesystem::path& path, const DataCheckOptions& options) {
  if (!options.reading.part.empty()) return {{path, options.reading.part}};
  return list_scenes(path, options.reading);
}

// Returns numbers and names as many as fit a line of a terminal each; of a long scene it has the first and last frames,
// report.json has all. The size stands with a name where not all frames have one.
std::string frame_lines(const std::vector<CheckedFrame>& frames) {
  constexpr size_t kMostShown = 24, kColumns = 100, kIndent = 17;
  const bool one_size = std::all_of(frames.begin(), frames.end(), [&](const CheckedFrame& frame) {
    return frame.width == frames[0].width && frame.height == frames[0].height;
  });
  std::vector<std::string> words;
  for (size_t i = 0; i < frames.size(); ++i) {
    if (frames.size() > kMostShown && i == kMostShown / 2) {
      const size_t left_out = frames.size() - kMostShown;
      words.push_back(fmt::format("... {} frames more ...", left_out));
      i += left_out;
    }
    words.push_back(fmt::format("{} {}", i, printable_text(frames[i].name)));
    if (!one_size) words.back() += fmt::format(" {}x{}", frames[i].width, frames[i].height);
  }
  std::string text, line;
  for (size_t i = 0; i < words.size(); ++i) {
    line += (line.empty() ? "" : ", ") + words[i];
    const bool last = i + 1 == words.size();
    if (!last && kIndent + line.size() + 2 + words[i + 1].size() <= kColumns) continue;
    text += fmt::format("  {:<14} {}{}\n", text.empty() ? "frames by name" : "", line, last ? "" : ",");
    line.clear();
  }
  return text;
}

std::string problem_summary(const std::vector<std::string>& scenes, size_t checked) {
  constexpr size_t kMostNamed = 10;
  std::string text = fmt::format("{} of {} scenes {} problems: ", scenes.size(), checked,
                                 scenes.size() == 1 ? "has" : "have");
  for (size_t i = 0; i < std::min(scenes.size(), kMostNamed); ++i) {
    text += (i == 0 ? "" : ", ") + printable_text(scenes[i]);
  }
  if (scenes.size() > kMostNamed) text += fmt::format(" and {} more", scenes.size() - kMostNamed);
  return text;
}

}  // namespace

std::string data_check_text(const DataCheck& check) {
  std::string text = fmt::format("{} ({})\n", printable_text(check.scene), check.format);
  const auto line = [&](const char* name, const std::string& value) {
    text += fmt::format("  {:<14} {}\n", name, printable_text(value));
  };
  if (check.frames > 0) {
    line("frames", fmt::format("{} ({} listed files missing, {} broken)", check.frames, check.missing_files,
                               check.broken_frames));
    line("size", span_text(check.width, "") + " x " + span_text(check.height, " pixels"));
    line("focal length", span_text(check.focal_x, "") + " / " + span_text(check.focal_y, " pixels") +
                             ", field of view " + span_text(check.field_of_view, " degrees"));
    line("cameras", fmt::format("within {:.4g} of their middle, {:.4g} apart, at most {:.4g} from the origin",
                                check.extent, check.median_step, check.largest_norm));
    line("depth", check.frames_with_depth == 0
                      ? std::string("none")
                      : fmt::format("{} frames, {}", check.frames_with_depth, span_text(check.depth, "")));
    line("overlap", check.mean_overlap < 0 ? std::string("unknown")
                                           : fmt::format("{:.0f} % between neighbours ({})",
                                                         100 * check.mean_overlap, check.overlap_method));
    for (const PoseEvidence& evidence : check.poses.evidence) {
      line(evidence.meaning == PoseMeaning::kAsRead ? "poses" : "",
           fmt::format("{:3.0f} % agree as {}", 100 * evidence.agreement,
                       pose_meaning_text(evidence.meaning)));
    }
    if (!check.poses.method.empty()) {
      line("", fmt::format("({} comparisons: {})", check.poses.comparisons, check.poses.method));
    }
  }
  text += frame_lines(check.list);
  const bool by_files = check.depth_of_check == CheckDepth::kFiles;
  if (check.decoded_images < check.frames && (check.decoded_images > 0 || by_files)) {
    line("decoded",
         fmt::format("{} of {} images ({}); of {} files the header and the end", check.decoded_images,
                     check.frames, by_files ? "--most-scenes" : "--most-images", check.image_files));
  }
  for (const std::string& note : check.notes) line("note", note);
  for (const std::string& problem : check.problems) line("PROBLEM", problem);
  if (check.problems.empty()) line("result", "no mistakes found");
  return text;
}

nlohmann::ordered_json data_check_json(const DataCheck& check) {
  nlohmann::ordered_json object;
  object["scene"] = check.scene;
  object["format"] = check.format;
  const bool by_files = check.depth_of_check == CheckDepth::kFiles;
  object["checked"] = by_files ? "files" : "pixels";
  object["frames"] = check.frames;
  // There may be thousands of scenes that nobody has to look at.
  if (!by_files || !check.problems.empty()) {
    object["list"] = nlohmann::ordered_json::array();
    for (size_t i = 0; i < check.list.size(); ++i) {
      const CheckedFrame& frame = check.list[i];
      object["list"].push_back(
          {{"number", i}, {"name", frame.name}, {"width", frame.width}, {"height", frame.height}});
    }
  }
  object["decoded_images"] = check.decoded_images;
  object["image_files"] = check.image_files;
  object["missing_files"] = check.missing_files;
  object["broken_frames"] = check.broken_frames;
  object["frames_with_depth"] = check.frames_with_depth;
  object["width"] = span_json(check.width);
  object["height"] = span_json(check.height);
  object["focal_x"] = span_json(check.focal_x);
  object["focal_y"] = span_json(check.focal_y);
  object["field_of_view"] = span_json(check.field_of_view);
  object["depth"] = span_json(check.depth);
  object["extent"] = check.extent;
  object["largest_norm"] = check.largest_norm;
  object["median_step"] = check.median_step;
  if (check.mean_overlap >= 0) object["mean_overlap"] = check.mean_overlap;
  object["turned_images"] = check.turned_images;
  object["pose_method"] = check.poses.method;
  object["pose_comparisons"] = check.poses.comparisons;
  for (const PoseEvidence& evidence : check.poses.evidence) {
    object["pose_agreement"][pose_meaning_text(evidence.meaning)] = evidence.agreement;
  }
  object["notes"] = check.notes;
  object["problems"] = check.problems;
  return object;
}

int run_data_check(const std::filesystem::path& path, const DataCheckOptions& options) {
  const auto scenes = scenes_at(path, options);
  const size_t to_pixels = std::min<size_t>(scenes.size(), static_cast<size_t>(options.most_scenes));
  std::unique_ptr<RunFolder> run;
  if (!options.out.empty())
    run = std::make_unique<RunFolder>(options.out, "check-data", options, earlier_run(options.overwrite));
  nlohmann::ordered_json report;
  report["scenes"] = nlohmann::ordered_json::array();
  std::vector<std::string> with_problems;
  int64_t files_alone = 0;
  size_t seen_to_pixels = 0;
  std::unique_ptr<Progress> progress;  // checks that are printed show it themselves
  if (scenes.size() > to_pixels) {
    progress = std::make_unique<Progress>("checking scenes", static_cast<int64_t>(scenes.size()));
  }
  for (size_t i = 0; i < scenes.size(); ++i) {
    // Evenly spread: neighbours in a folder are alike.
    const bool pixels = i == seen_to_pixels * scenes.size() / to_pixels && seen_to_pixels < to_pixels;
    if (pixels) ++seen_to_pixels;
    const DataCheck check =
        check_scene(scenes[i], options, pixels ? CheckDepth::kPixels : CheckDepth::kFiles);
    if (!pixels) files_alone += check.image_files;
    const bool shown = pixels || !check.problems.empty();
    if (!options.json && shown) std::cout << data_check_text(check) << std::flush;
    if (!check.problems.empty()) with_problems.push_back(check.scene);
    report["scenes"].push_back(data_check_json(check));
    if (progress) progress->update(static_cast<int64_t>(i + 1));
    if (run == nullptr || check.frames == 0 || !pixels) continue;
    SceneReading reading = options.reading;
    reading.part = scenes[i].part;
    const std::string name = fmt::format("cameras_{:03}.png", i);
    write_png(run->path() / name, draw_camera_layout(open_scene(scenes[i].path, reading)));
    run->note("cameras of " + check.scene, name);
  }
  if (progress) progress->finish();
  report["scenes_found"] = scenes.size();
  report["scenes_checked_to_pixels"] = to_pixels;
  if (run != nullptr) {
    run->write_report(report);
    run->note("report", "report.json");
  }
  if (options.json) {
    std::cout << json_text(report, 2) << "\n";
  } else {
    if (scenes.size() > to_pixels) {
      std::cout << fmt::format(
          "{0} scenes were checked: {1} to their pixels (--most-scenes {0} takes all), {2} by their cameras and "
          "the headers and ends of their {3} image files\n",
          scenes.size(), to_pixels, scenes.size() - to_pixels, files_alone);
    }
    if (run != nullptr) std::cout << run->closing_box();
  }
  if (!with_problems.empty()) print_warnings({problem_summary(with_problems, scenes.size())});
  return with_problems.empty() ? 0 : 1;
}

}  // namespace gld
