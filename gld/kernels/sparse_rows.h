#pragma once

// Products of sparse matrices with tables of channels.

#include "gld/kernels/kernel_table.h"
#include "gld/kernels/simd.h"

namespace gld {
namespace {

// Computes one row's sums over some channels, which stay in registers. There are two sums a vector: an addition waits
// four cycles for the one before it.
template <int vectors>
void sum_sparse_row(const SparseRows& rows, int64_t row, int64_t channel) {
  Vector even[vectors], odd[vectors];
#pragma GCC unroll 8
  for (int v = 0; v < vectors; ++v) even[v] = odd[v] = Simd::zero();
  int64_t k = rows.first[row];
  const int64_t end = rows.first[row + 1];
  const auto add = [&](int64_t entry, Vector(&sum)[vectors]) {
    const Vector weight = Simd::broadcast(rows.values[entry]);
    const float* from = rows.table + rows.columns[entry] * rows.stride + channel;
#pragma GCC unroll 8
    for (int v = 0; v < vectors; ++v)
      sum[v] = Simd::multiply_add(weight, Simd::load(from + v * Simd::lanes), sum[v]);
  };
  for (; k + 2 <= end; k += 2) {
    add(k, even);
    add(k + 1, odd);
  }
  if (k < end) add(k, even);
  float* const sum = rows.sums + row * rows.stride + channel;
#pragma GCC unroll 8
  for (int v = 0; v < vectors; ++v) Simd::store(sum + v * Simd::lanes, Simd::add(even[v], odd[v]));
}

void sum_sparse_rows(const SparseRows& rows) {
  for (int64_t row = rows.begin; row < rows.end; ++row) {
    int64_t channel = 0;
    for (; channel + 4 * Simd::lanes <= rows.stride; channel += 4 * Simd::lanes)
      sum_sparse_row<4>(rows, row, channel);
    for (; channel + 2 * Simd::lanes <= rows.stride; channel += 2 * Simd::lanes)
      sum_sparse_row<2>(rows, row, channel);
    for (; channel < rows.stride; channel += Simd::lanes) sum_sparse_row<1>(rows, row, channel);
  }
}

}  // namespace
}  // namespace gld
