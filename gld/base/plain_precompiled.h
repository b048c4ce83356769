#pragma once

// The precompiled header of sources without LibTorch (gld/tensors/torch_precompiled.h is the other's). Sources still
// include what they use.
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

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
