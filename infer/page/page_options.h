#pragma once

#include "gld/base/options.h"

#include <cstdint>

namespace gld {

// How much a page holds.
struct PageOptions : OptionsGroup {
  int64_t page_points = 300'000;
  double page_megabytes = 8;

  void visit(FieldVisitor& visitor) override;
};

}  // namespace gld
