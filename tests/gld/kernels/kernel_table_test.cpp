#include "gld/kernels/kernel_table.h"

#include "gld/kernels/matrix_unit_kernels.h"
#include "gld/machine/matrix_unit.h"

#include <array>
#include <cstdint>
#include <cstring>

#include <gtest/gtest.h>

namespace gld {
namespace {

// Every entry but the first, which says of what the table is, is a function or a count of eight bytes: none may be 0.
template <class Table>
void expect_filled(const Table& table) {
  std::array<uint64_t, sizeof(Table) / sizeof(uint64_t)> entries{};
  static_assert(sizeof(entries) == sizeof(Table));
  std::memcpy(entries.data(), &table, sizeof(table));
  for (size_t i = 1; i < entries.size(); ++i) EXPECT_NE(entries[i], 0U) << "entry " << i;
}

TEST(KernelTable, OfEveryInstructionSetHasEveryEntry) {
  for (const InstructionSet set : available_instruction_sets()) {
    SCOPED_TRACE(instruction_set_name(set));
    EXPECT_EQ(kernel_table(set).instruction_set, set);
    expect_filled(kernel_table(set));
  }
}

TEST(KernelTable, OfEveryMatrixUnitHasEveryEntry) {
  for (const MatrixUnit unit : available_matrix_units(ComputePrecision::kBFloat16)) {
    EXPECT_EQ(matrix_unit_kernels(unit, ComputePrecision::kBFloat16).unit, unit);
    expect_filled(matrix_unit_kernels(unit, ComputePrecision::kBFloat16));
  }
}

}  // namespace
}  // namespace gld
