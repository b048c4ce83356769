#pragma once

// The one precompiled header of everything that includes LibTorch: its headers cost 25 s a file otherwise.
// Sources still include what they use.
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
