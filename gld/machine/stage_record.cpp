#include "gld/machine/stage_record.h"

#include "gld/machine/block_memory.h"

#include <algorithm>
#include <fstream>

#include <fmt/format.h>
#include <sys/resource.h>

namespace gld {
namespace {

// Reads a "Name:   123 kB" line of a /proc file, in bytes.
int64_t proc_bytes(const char* file, const std::string& name) {
  std::ifstream stream(file);
  for (std::string line; std::getline(stream, line);) {
    if (line.rfind(name + ":", 0) == 0) return std::stoll(line.substr(name.size() + 1)) * 1024;
  }
  return 0;
}

// Appends the record when the stage ends, however it ends.
class RecordOnExit {
 public:
  RecordOnExit(std::vector<StageRecord>& records, std::string name)
      : records_(records), name_(std::move(name)) {
    release_kept_blocks();  // of what ran between two stages
    reset_peak_resident_bytes();
    start_ = std::chrono::steady_clock::now();
  }
  ~RecordOnExit() {
    StageRecord record;
    record.name = name_;
    record.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
    record.peak_bytes = peak_resident_bytes();
    record.device_bytes = device_bytes_;
    records_.push_back(record);
    release_kept_blocks();  // the next stage's tensors have other sizes
  }
  RecordOnExit(const RecordOnExit&) = delete;
  RecordOnExit& operator=(const RecordOnExit&) = delete;
  void set_device_bytes(int64_t bytes) { device_bytes_ = bytes; }

 private:
  std::vector<StageRecord>& records_;
  std::string name_;
  std::chrono::steady_clock::time_point start_;
  int64_t device_bytes_ = 0;
};

}  // namespace

void StageRecords::run(const std::string& name, const std::function<void()>& work) {
  if (on_start_) on_start_(name);
  RecordOnExit record(records_, name);
  if (device_.begin) device_.begin();
  work();
  if (device_.end) record.set_device_bytes(device_.end());
}

nlohmann::ordered_json StageRecords::to_json() const {
  auto list = nlohmann::ordered_json::array();
  for (const auto& record : records_) {
    list.push_back({{"stage", record.name}, {"seconds", record.seconds}, {"peak_bytes", record.peak_bytes}});
    if (record.device_bytes > 0) list.back()["device_bytes"] = record.device_bytes;
  }
  return list;
}

int64_t peak_resident_bytes() { return proc_bytes("/proc/self/status", "VmHWM"); }

void reset_peak_resident_bytes() {
  std::ofstream stream("/proc/self/clear_refs");
  stream << "5";  // proc(5): resets the peak resident set size
}

int64_t total_memory_bytes() { return proc_bytes("/proc/meminfo", "MemTotal"); }
int64_t available_memory_bytes() {
  const int64_t available = proc_bytes("/proc/meminfo", "MemAvailable");
  rlimit limit{};
  if (::getrlimit(RLIMIT_AS, &limit) != 0 || limit.rlim_cur == RLIM_INFINITY) return available;
  // What this process may still map, of ulimit -v.
  const int64_t left = static_cast<int64_t>(limit.rlim_cur) - proc_bytes("/proc/self/status", "VmSize");
  return std::min(available, std::max<int64_t>(left, 1));
}

std::string bytes_text(int64_t bytes) {
  const auto value = static_cast<double>(bytes);
  if (value < 1e6) return fmt::format("{:.1f} kB", value / 1e3);
  if (value < 1e9) return fmt::format("{:.1f} MB", value / 1e6);
  return fmt::format("{:.2f} GB", value / 1e9);
}

}  // namespace gld
