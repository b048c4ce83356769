#pragma once

#include "gld/metrics/metric.h"

#include <string>
#include <vector>

namespace gld {

// Returns every metric of the program, in the order of tables: gld eval, benchmarks and the rest take them from here. A
// new one is an entry of its file's list, and a new file a line in metric_list.cpp.
const std::vector<Metric>& metric_list();

// Returns those that compare images.
const std::vector<Metric>& image_metric_list();

// Throws Error for a name that is none.
const Metric& metric_named(const std::string& name);

}  // namespace gld
