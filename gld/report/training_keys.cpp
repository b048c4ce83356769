#include "gld/report/training_keys.h"

namespace gld {

bool is_course_of_run(const std::string& key) {
  return key == "samples_per_second" || key == "data_wait_fraction" || key == "communication_fraction" ||
         key == "skipped_steps" || key == "seconds";
}

bool is_sharpness(const std::string& key) {
  const std::string end = "sharpness";
  return key.size() >= end.size() && key.compare(key.size() - end.size(), end.size(), end) == 0;
}

}  // namespace gld
