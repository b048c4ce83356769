#include "train/loop/metrics_log.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"

#include <fstream>
#include <limits>
#include <optional>
#include <set>
#include <sstream>

namespace gld {
namespace {

// Returns a line with its step; nothing for half a line at the end, as a killed run leaves it, and for any damaged one:
// what is drawn from the log is not worth a training run.
std::optional<nlohmann::ordered_json> read_line(const std::string& line) {
  try {
    auto object = parse_ordered_json(line, "metrics");
    const bool has_step = object.is_object() && object.contains("step") && object["step"].is_number_integer();
    if (has_step && object["step"].get<int64_t>() >= 0) return object;
  } catch (const Error&) {
    // The line is no JSON.
  }
  return std::nullopt;
}

}  // namespace

MetricsLog::MetricsLog(std::filesystem::path file, int64_t last_step) : file_(std::move(file)) {
  // A run that is refused before its first line leaves nothing behind.
  if (!std::filesystem::exists(file_)) return;
  std::string kept;
  std::istringstream text(read_file(file_));
  for (std::string line; std::getline(text, line);) {
    auto object = read_line(line);
    if (!object || object->at("step").get<int64_t>() > last_step) continue;
    kept += json_text(*object) + "\n";
    lines_.push_back(*std::move(object));
  }
  write_file_atomically(file_, kept);
}

void MetricsLog::append(const nlohmann::ordered_json& line) {
  const std::string text = line.dump();
  // So that it is noted among what the run wrote, which --overwrite removes.
  if (!std::filesystem::exists(file_)) write_file_atomically(file_, "");
  std::ofstream stream(file_, std::ios::app);
  stream << text << '\n' << std::flush;
  if (!stream) {
    fail({file_.string(), "to append a line", "a write that failed", "check the disk and its free space"});
  }
  // Lines are kept as a resumed run reads them: numbers that are not finite (the PSNR of equal images) are null and not
  // drawn.
  lines_.push_back(nlohmann::ordered_json::parse(text));
}

std::vector<std::pair<double, double>> MetricsLog::series(const std::string& key) const {
  std::vector<std::pair<double, double>> points;
  for (const auto& line : lines_) {
    const auto found = line.find(key);
    if (found != line.end() && found->is_number()) {
      points.emplace_back(line.at("step").get<double>(), found->get<double>());
    }
  }
  return points;
}

std::vector<std::pair<std::string, double>> MetricsLog::values_at(int64_t step,
                                                                  const std::string& prefix) const {
  std::vector<std::pair<std::string, double>> values;
  for (const auto& line : lines_) {
    if (line.at("step").get<int64_t>() != step) continue;
    for (const auto& [key, value] : line.items()) {
      if (key.rfind(prefix, 0) != 0 || !(value.is_number() || value.is_null())) continue;
      values.emplace_back(key.substr(prefix.size()),
                          value.is_null() ? std::numeric_limits<double>::infinity() : value.get<double>());
    }
  }
  return values;
}

std::vector<std::string> MetricsLog::keys() const {
  std::set<std::string> names;
  for (const auto& line : lines_) {
    for (const auto& item : line.items()) {
      if (item.value().is_number() && item.key() != "step") names.insert(item.key());
    }
  }
  return {names.begin(), names.end()};
}

}  // namespace gld
