#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// What one stage of a command took.
struct StageRecord {
  std::string name;
  double seconds = 0;
  int64_t peak_bytes = 0;  // largest resident memory of the process while the stage ran; 0 where unknown
  // The most of a GPU's memory that tensors had while the stage ran; 0 without a GPU or where unknown.
  int64_t device_bytes = 0;
};

// What is asked of a GPU around a stage; nothing where there is none.
struct StageDevice {
  std::function<void()> begin;
  // Within the stage's time it waits for what is still computed, and returns device_bytes.
  std::function<int64_t()> end;
};

// Runs stages one after another and keeps their records.
class StageRecords {
 public:
  // Runs work as the stage of that name. The record is kept also when work throws.
  void run(const std::string& name, const std::function<void()>& work);
  // The function is called with the name of each stage before it begins.
  void on_start(std::function<void(const std::string& name)> called) { on_start_ = std::move(called); }
  // Has a GPU asked at the beginning and the end of each stage.
  void set_device(StageDevice device) { device_ = std::move(device); }

  const std::vector<StageRecord>& records() const { return records_; }
  nlohmann::ordered_json to_json() const;

 private:
  std::vector<StageRecord> records_;
  std::function<void(const std::string& name)> on_start_;
  StageDevice device_;
};

// Returns the largest resident memory of this process since the last reset, in bytes; it is 0 where the system does not
// tell (it comes from Linux's /proc).
int64_t peak_resident_bytes();
// Starts a new maximum. Where the system refuses, the maximum stays that of the whole process.
void reset_peak_resident_bytes();

// These return the memory that the machine has and that is free for use, in bytes.
int64_t total_memory_bytes();
int64_t available_memory_bytes();

// Returns "1.25 GB", for example (powers of 1000).
std::string bytes_text(int64_t bytes);

}  // namespace gld
