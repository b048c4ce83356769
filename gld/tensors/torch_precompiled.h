#pragma once

// The one precompiled header of everything that includes LibTorch: its headers cost 25 s a file otherwise. The headers
// of other libraries that most of these files include are in it too. Sources still include what they use.
#include "gld/base/json_instances.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <ATen/Parallel.h>
#include <torch/autograd.h>
#include <torch/nn/module.h>
#include <torch/types.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
