#include "train/page/training_page.h"

#include "gld/base/atomic_file.h"
#include "gld/base/json_text.h"
#include "gld/page/results.h"
#include "gld/page/run_report.h"
#include "gld/report/progress.h"
#include "gld/report/run_folder.h"
#include "gld/report/table.h"
#include "gld/report/training_keys.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

namespace gld {
namespace {

using Points = std::vector<std::pair<double, double>>;
using Courses = std::vector<std::pair<std::string, Points>>;

constexpr const char* kHeldOut = "validation_";

// A browser draws no more than this of one curve.
constexpr size_t kMostPoints = 600;

// Returns means of neighbours, so that there are at most so many.
Points fewer(const Points& points) {
  if (points.size() <= kMostPoints) return points;
  Points result;
  for (size_t i = 0; i < kMostPoints; ++i) {
    const size_t first = i * points.size() / kMostPoints, last = (i + 1) * points.size() / kMostPoints;
    double x = 0, y = 0;
    for (size_t k = first; k < last; ++k) {
      x += points[k].first;
      y += points[k].second;
    }
    const auto count = static_cast<double>(last - first);
    result.emplace_back(x / count, y / count);
  }
  return result;
}

// Returns the course of every number of metrics.jsonl, in the order in which they first appear.
Courses read_courses(const std::filesystem::path& run, Page& page) {
  Courses courses;
  const auto file = run / "metrics.jsonl";
  std::error_code error;
  if (!std::filesystem::is_regular_file(file, error)) {
    page.doubts.emplace_back("metrics.jsonl is left out of this page: the file is missing.");
    return courses;
  }
  std::istringstream stream(read_file(file));
  std::string line;
  std::map<std::string, size_t> numbers;
  for (int64_t number = 1; std::getline(stream, line); ++number) {
    if (line.empty()) continue;
    const auto values = parse_ordered_json(line, file.string() + ", line " + std::to_string(number));
    const auto& step = report_value(values, "/step");
    if (!step.is_number()) continue;
    for (const auto& [key, value] : values.items()) {
      if (key == "step" || !value.is_number()) continue;
      const auto [place, is_new] = numbers.emplace(key, courses.size());
      if (is_new) courses.emplace_back(key, Points());
      courses[place->second].second.emplace_back(step.get<double>(), value.get<double>());
    }
  }
  return courses;
}

bool all_positive(const Points& points) {
  return std::all_of(points.begin(), points.end(), [](const auto& point) { return point.second > 0; });
}

// Numbers of one magnitude belong into one panel.
std::vector<PlotPanel> panels_of(const Courses& courses) {
  std::vector<PlotPanel> panels(6);
  const char* titles[] = {"Losses",
                          "Held-out losses",
                          "Held-out PSNR, dB",
                          "Learning rate and gradient norm",
                          "Scenes a second",
                          "Held-out sharpness, of the truth's"};
  for (size_t i = 0; i < panels.size(); ++i) {
    panels[i].title = titles[i];
    panels[i].x.label = "step";
    panels[i].y.scale = AxisScale::kLog;
  }
  for (const size_t panel : {2, 4, 5}) panels[panel].y.scale = AxisScale::kLinear;
  const std::string held_out = kHeldOut;
  for (const auto& [key, points] : courses) {
    size_t panel = 0;
    if (key == "samples_per_second") {
      panel = 4;
    } else if (is_course_of_run(key)) {
      continue;
    } else if (key == "learning_rate" || key == "gradient_norm") {
      panel = 3;
    } else if (key.rfind(held_out, 0) == 0) {
      panel = key.find("psnr") != std::string::npos ? 2 : is_sharpness(key) ? 5 : 1;
    }
    PlotSeries series;
    series.name = key.rfind(held_out, 0) == 0 ? key.substr(held_out.size()) : key;
    std::replace(series.name.begin(), series.name.end(), '_', ' ');
    series.points = fewer(points);
    // A loss with a reward may be negative, which a logarithmic axis cannot show.
    if (!all_positive(points)) panels[panel].y.scale = AxisScale::kLinear;
    panels[panel].series.push_back(std::move(series));
  }
  return panels;
}

// Returns validation.png, or the first one and the last two of validation/.
std::vector<std::pair<std::string, std::string>> validation_pictures(const std::filesystem::path& run) {
  std::error_code error;
  std::vector<std::string> names;
  for (const auto& item : std::filesystem::directory_iterator(run / "validation", error)) {
    if (item.path().extension() == ".png") names.push_back(item.path().stem().string());
  }
  std::sort(names.begin(), names.end());
  if (names.size() > 3) names.erase(names.begin() + 1, names.end() - 2);
  std::vector<std::pair<std::string, std::string>> pictures;
  for (const std::string& name : names) {
    const size_t digits = name.find_first_not_of('0', name.find('_') + 1);
    const std::string step = digits == std::string::npos ? name : name.substr(digits);
    pictures.emplace_back(digits == std::string::npos ? "before the first step" : "after step " + step,
                          "validation/" + name + ".png");
  }
  if (pictures.empty() && std::filesystem::is_regular_file(run / "validation.png", error)) {
    pictures.emplace_back("the last validation", "validation.png");
  }
  return pictures;
}

ResultTable validation_table(const Courses& courses) {
  ResultTable table;
  table.title = "Held-out scenes";
  table.columns = {"", "first", "best", "last", "step of the last"};
  for (const auto& [key, points] : courses) {
    if (key.rfind(kHeldOut, 0) != 0) continue;
    const bool higher = key.find("psnr") != std::string::npos;
    const bool near_one = is_sharpness(key);
    const auto badness = [&](double value) {
      return higher ? -value : near_one ? std::abs(value - 1) : value;
    };
    const auto best = std::min_element(points.begin(), points.end(), [&](const auto& a, const auto& b) {
      return badness(a.second) < badness(b.second);
    });
    std::string name = key.substr(11);
    std::replace(name.begin(), name.end(), '_', ' ');
    table.rows.push_back({name + (higher ? ", dB" : ""), short_number(points.front().second),
                          short_number(best->second), short_number(points.back().second),
                          std::to_string(static_cast<int64_t>(points.back().first))});
  }
  return table;
}

const Points* course_of(const Courses& courses, const std::string& key) {
  const auto found =
      std::find_if(courses.begin(), courses.end(), [&](const auto& course) { return course.first == key; });
  return found == courses.end() || found->second.empty() ? nullptr : &found->second;
}

// Returns the losses at the first and the last lines of the log, of held-out scenes where it was measured there twice.
std::string course_of_loss(const Courses& courses) {
  std::string text;
  if (const Points* loss = course_of(courses, "loss")) {
    text += "; the loss ended at " + short_number(loss->back().second);
    if (loss->size() > 1) text += ", from " + short_number(loss->front().second);
  }
  // The first number of a validation is what chooses the best checkpoint; less is better.
  const auto held_out = std::find_if(courses.begin(), courses.end(), [](const auto& course) {
    return course.first.rfind(kHeldOut, 0) == 0 && course.second.size() > 1;
  });
  if (held_out == courses.end()) return text;
  std::string name = held_out->first.substr(std::string(kHeldOut).size());
  std::replace(name.begin(), name.end(), '_', ' ');
  const double first = held_out->second.front().second, last = held_out->second.back().second;
  return text + "; on held-out scenes " + name + " went from " + short_number(first) + " to " +
         short_number(last) + (last < first ? "" : ": no better there than at first");
}

void add_courses(Page& page, const std::filesystem::path& run, const Courses& courses) {
  add_charts(page, "How it went", panels_of(courses));
  add_table(page, validation_table(courses));
  add_pictures(page, "Pictures of held-out scenes", "Scenes that it was not trained on.", run,
               validation_pictures(run));
}

}  // namespace

Page training_page(const std::filesystem::path& run) {
  const auto report = read_run_report(run);
  const std::string command = report_text_at(report, "/command");
  Page page = results_page("gld " + (command.empty() ? "train" : command), report);
  const auto courses = read_courses(run, page);
  const std::string steps = report_number_at(report, "/steps"),
                    parameters = report_number_at(report, "/parameters");
  const auto& seconds = report_value(report, "/seconds");
  page.verdict =
      steps.empty() ? "The report does not say how many steps were done." : steps + " steps were done";
  if (!steps.empty()) {
    if (!parameters.empty()) page.verdict += " with " + parameters + " parameters";
    if (seconds.is_number()) {
      page.verdict += ", in " + short_number(seconds.get<double>() / 60) + " minutes";
    }
    page.verdict += course_of_loss(courses) + ".";
  }
  const auto& skipped = report_value(report, "/skipped_steps");
  if (skipped.is_number() && skipped.get<double>() > 0) {
    page.doubts.push_back(skipped.dump() + " steps were left out because their loss was not finite.");
  }
  for (const auto& message : report_value(report, "/messages")) {
    if (message.is_string()) page.doubts.push_back(message.get<std::string>());
  }
  if (const auto problem = report_text_at(report, "/data/last_problem"); !problem.empty()) {
    page.doubts.push_back("The data had problems, the last one: " + problem);
  }
  add_courses(page, run, courses);
  add_fact(page, "Command", command.empty() ? "" : "gld " + command);
  add_fact(page, "Steps", steps);
  add_fact(page, "Parameters", parameters);
  add_fact(page, "Precision", report_text_at(report, "/precision"));
  add_fact(page, "Broken samples", report_number_at(report, "/data/broken_samples"));
  return page;
}

Page unfinished_training_page(const std::filesystem::path& run, UnfinishedTraining state) {
  const std::string command = command_of_run(run);
  Page page = results_page("gld " + (command.empty() ? "train" : command), nlohmann::ordered_json::object());
  // Its first line may be yet to come.
  const bool has_metrics = std::filesystem::is_regular_file(run / "metrics.jsonl");
  const auto courses =
      state == UnfinishedTraining::kStopped || has_metrics ? read_courses(run, page) : Courses();
  const auto progress = read_run_progress(run);
  const auto& done = report_value(progress, "/done");
  const auto& total = report_value(progress, "/total");
  std::string steps;
  if (done.is_number_integer() && total.is_number_integer())
    steps = done.dump() + " of " + total.dump() + " steps";
  if (state == UnfinishedTraining::kStopped) {
    page.verdict = "The training ended before its last step";
    if (!steps.empty()) page.verdict += "; what it said last was at " + steps;
    page.verdict += ". The same command with --resume goes on from its last checkpoint.";
  } else {
    page.reload_seconds = kTrainingPageSeconds;
    page.verdict = steps.empty() ? "The training has begun." : steps + " are done";
    if (const auto& left = report_value(progress, "/seconds_left"); !steps.empty()) {
      page.verdict += left.is_number() ? "; " + duration_text(left.get<double>()) + " are left." : ".";
    }
    page.verdict += " This page loads itself again every minute until the training ends.";
  }
  add_courses(page, run, courses);
  add_fact(page, "Command", command.empty() ? "" : "gld " + command);
  add_fact(page, "Now", report_text_at(progress, "/note"));
  return page;
}

}  // namespace gld
