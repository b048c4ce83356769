#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// metrics.jsonl of a training run: one JSON object a line, each with a "step". Lines are appended and flushed.
class MetricsLog {
 public:
  // Lines of steps behind last_step (written after the checkpoint that the run resumes from) are removed. A file that
  // is not there is made with the first line.
  MetricsLog(std::filesystem::path file, int64_t last_step);

  void append(const nlohmann::ordered_json& line);

  // Returns (step, value) of every line that has the key, in order.
  std::vector<std::pair<double, double>> series(const std::string& key) const;
  // Returns name and value of every key of that step that begins with prefix, without it, as the line has them; null,
  // as which lines keep what is not finite, is infinity (the PSNR of equal images).
  std::vector<std::pair<std::string, double>> values_at(int64_t step, const std::string& prefix) const;
  // Returns the keys with numbers, sorted, beside "step".
  std::vector<std::string> keys() const;

 private:
  std::filesystem::path file_;
  std::vector<nlohmann::ordered_json> lines_;
};

}  // namespace gld
