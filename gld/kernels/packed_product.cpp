#include "gld/kernels/packed_product.h"

#include "gld/base/error.h"
#include "gld/kernels/kernel_table.h"
#include "gld/kernels/matrix_product.h"
#include "gld/kernels/matrix_unit_kernels.h"
#include "gld/kernels/multiply_add_peak.h"
#include "gld/kernels/product_shares.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <string>

#include <omp.h>

namespace gld {
namespace {

// How rows of one precision lie in words.
struct WordLayout {
  int64_t words;  // of a row, whole steps
  int64_t block;  // words of a block, whole steps
};

int64_t numbers_a_word(ComputePrecision precision) { return precision == ComputePrecision::kInt8 ? 4 : 2; }

WordLayout word_layout(int64_t inputs, ComputePrecision precision, const MatrixUnitKernels& unit) {
  WordLayout layout = {};
  layout.words = rounded_up(parts_of(inputs, numbers_a_word(precision)), kStepWords);
  layout.block = equal_share(layout.words, unit.block_words, kStepWords);
  return layout;
}

// Returns an odd number of cache lines: an even one would put the same words of all rows into a fraction of the cache's
// sets.
int64_t row_stride(const WordLayout& layout) {
  const int64_t lines = layout.words / kStepWords;
  return kStepWords * (lines % 2 == 0 ? lines + 1 : lines);
}

template <class Number>
Number* numbers(uint32_t* words) {
  return reinterpret_cast<Number*>(words);
}

// Writes one output's weights as signed bytes and returns their scale.
float weight_bytes(const float* x, int64_t count, const WordLayout& layout, uint32_t* words) {
  constexpr float kMostByte = 127;
  float largest = 0, unfinite = 0;
  for (int64_t i = 0; i < count; ++i) {
    largest = std::max(largest, std::abs(x[i]));
    unfinite += x[i] * 0.0f;
  }
  const float scale = largest / kMostByte;
  const float inverse = scale >= std::numeric_limits<float>::min() ? 1 / scale : 0;
  auto* bytes = numbers<int8_t>(words);
  for (int64_t i = 0; i < count; ++i) {
    const float scaled = x[i] * inverse;
    bytes[i] = static_cast<int8_t>(std::isfinite(scaled) ? std::nearbyint(scaled) : 0);
  }
  std::fill(bytes + count, bytes + 4 * layout.words, int8_t{0});
  return inverse == 0 && unfinite == 0 ? 0 : scale + unfinite;
}

void check_weights(const WeightMatrix& weights, const PackingSettings& settings) {
  if (weights.outputs >= 1 && weights.inputs >= 1 && weights.stride >= weights.inputs &&
      settings.threads >= 1)
    return;
  fail({"packed weights", "inputs and outputs that fit their stride, and at least one thread",
        std::to_string(weights.outputs) + " x " + std::to_string(weights.inputs) + " with a stride of " +
            std::to_string(weights.stride),
        ""});
}

void check_product(const PackedProduct& product, int threads) {
  const auto refuse = [&](const std::string& found) {
    fail({"packed product",
          "targets of equal inputs, precision and unit that fit their strides, and a thread", found, ""});
  };
  if (product.targets.empty() || threads < 1 || product.rows < 0) refuse("no target, thread or row");
  const PackedWeights& first = *product.targets.front().weights;
  for (const ProductTarget& target : product.targets) {
    const PackedWeights& weights = *target.weights;
    if (weights.inputs() != first.inputs() || weights.settings().precision != first.settings().precision ||
        weights.settings().unit != first.settings().unit || product.x_stride < weights.inputs() ||
        product.y_stride < weights.outputs()) {
      refuse(std::to_string(weights.outputs()) + " x " + std::to_string(weights.inputs()) + " in " +
             compute_precision_name(weights.settings().precision));
    }
  }
}

KernelSettings float_settings(const PackingSettings& settings, int threads) {
  return {threads, settings.instruction_set, settings.second_level_cache};
}

void float_product(const PackedProduct& product, int threads) {
  for (const ProductTarget& target : product.targets) {
    LinearProduct one;
    one.rows = product.rows;
    one.inputs = target.weights->inputs();
    one.outputs = target.weights->outputs();
    one.x = product.x;
    one.x_stride = product.x_stride;
    one.packed_weight = target.weights->floats();
    one.weight_stride = one.inputs;
    one.bias = target.bias;
    one.y = target.y;
    one.y_stride = product.y_stride;
    linear_product(one, float_settings(target.weights->settings(), threads));
  }
}

// Some rows in words, whole strips of them.
struct RowWords {
  RowWords(int64_t rows, int64_t stride)
      : stride(stride), words(rows * stride), scales(static_cast<std::size_t>(rows)), zeros(scales.size()) {}

  uint32_t* row(int64_t r) const { return reinterpret_cast<uint32_t*>(words.data()) + r * stride; }

  int64_t stride;
  AlignedFloats words;
  std::vector<float> scales;
  std::vector<int32_t> zeros;
};

void fill_row(const PackedProduct& product, const MatrixUnitKernels& unit, const WordLayout& layout,
              int64_t from, int64_t to, RowWords& rows) {
  const PackedWeights& weights = *product.targets.front().weights;
  uint32_t* words = rows.row(to);
  if (from >= product.rows) {
    std::fill_n(words, layout.words, 0U);
    return;
  }
  const float* x = product.x + from * product.x_stride;
  if (weights.settings().precision != ComputePrecision::kInt8) {
    unit.to_bfloat16(x, weights.inputs(), 2 * layout.words, numbers<uint16_t>(words));
    return;
  }
  const ByteScale scale = unit.byte_scale(x, weights.inputs());
  unit.to_bytes(x, weights.inputs(), 4 * layout.words, scale, numbers<uint8_t>(words));
  rows.scales[static_cast<std::size_t>(to)] = scale.scale;
  rows.zeros[static_cast<std::size_t>(to)] = scale.zero;
}

// Some outputs of one target.
struct ColumnBlock {
  const ProductTarget* target;
  int64_t first;
  int64_t count;
};

std::vector<ColumnBlock> column_blocks(const PackedProduct& product, const MatrixUnitKernels& unit,
                                       const WordLayout& layout) {
  const int64_t cached = product.targets.front().weights->settings().second_level_cache / 16 * 9 /
                         (layout.block * int64_t{sizeof(uint32_t)});
  const int64_t most = std::clamp(cached / unit.lanes * unit.lanes, unit.lanes, unit.block_columns);
  std::vector<ColumnBlock> blocks;
  for (const ProductTarget& target : product.targets) {
    const int64_t outputs = target.weights->outputs(), columns = equal_share(outputs, most, unit.lanes);
    for (int64_t first = 0; first < outputs; first += columns) {
      blocks.push_back({&target, first, std::min(columns, outputs - first)});
    }
  }
  return blocks;
}

void unit_product_of(const PackedProduct& product, int threads) {
  const PackedWeights& weights = *product.targets.front().weights;
  const ComputePrecision precision = weights.settings().precision;
  const MatrixUnitKernels& unit = matrix_unit_kernels(weights.settings().unit, precision);
  const bool int8 = precision == ComputePrecision::kInt8;
  const auto multiply = int8 ? unit.int8_product : unit.bfloat16_product;
  const WordLayout layout = word_layout(weights.inputs(), precision, unit);
  const auto blocks = column_blocks(product, unit, layout);
  const auto num_blocks = static_cast<int64_t>(blocks.size());

  const int64_t rows_at_once = equal_share(product.rows, kRowsPackedAtOnce, unit.rows);
  const int64_t wanted = parts_of(kPartsAThread * threads, num_blocks);
  const int64_t row_parts =
      threads == 1 ? 1 : std::clamp<int64_t>(wanted, 1, parts_of(rows_at_once, kRowsAPart));
  const int64_t rows_a_part = equal_share(rows_at_once, parts_of(rows_at_once, row_parts), unit.rows);
  RowWords row_words(rows_at_once, row_stride(layout));
  for (int64_t first_row = 0; first_row < product.rows; first_row += rows_at_once) {
    const int64_t rows = std::min(rows_at_once, product.rows - first_row);
#pragma omp parallel num_threads(threads)
    {
#pragma omp for schedule(static)
      for (int64_t row = 0; row < rounded_up(rows, unit.rows); ++row) {
        fill_row(product, unit, layout, first_row + row, row, row_words);
      }
#pragma omp for schedule(dynamic, 1)
      for (int64_t item = 0; item < num_blocks * row_parts; ++item) {
        const ColumnBlock& block = blocks[static_cast<std::size_t>(item / row_parts)];
        const PackedWeights& packed = *block.target->weights;
        const int64_t padded = rounded_up(packed.outputs(), unit.lanes);
        const int64_t first = item % row_parts * rows_a_part, last = std::min(first + rows_a_part, rows);
        for (int64_t k = 0; k < layout.words && first < last; k += layout.block) {
          UnitProductTile tile = {};
          tile.a_stride = row_words.stride;
          tile.words = std::min(layout.block, layout.words - k);
          tile.b = packed.words() + padded * k + block.first * tile.words;
          tile.columns = block.count;
          tile.first = k == 0;
          tile.bias = block.target->bias == nullptr ? nullptr : block.target->bias + block.first;
          tile.y_stride = product.y_stride;
          if (int8) {
            tile.column_scales = packed.column_scales() + block.first;
            tile.column_sums = packed.column_sums() + k / layout.block * padded + block.first;
          }
          for (int64_t row = first; row < last; row += unit.rows) {
            tile.a = row_words.row(row) + k;
            tile.rows = std::min(unit.rows, last - row);
            tile.row_scales = row_words.scales.data() + row;
            tile.row_zeros = row_words.zeros.data() + row;
            tile.y = block.target->y + (first_row + row) * product.y_stride + block.first;
            multiply(tile);
          }
        }
      }
    }
  }
}

int64_t data_floats(int64_t outputs, int64_t inputs, const PackingSettings& settings) {
  if (settings.precision == ComputePrecision::kFloat32) {
    return packed_weight_floats(outputs, inputs, float_settings(settings, 1));
  }
  const MatrixUnitKernels& unit = matrix_unit_kernels(settings.unit, settings.precision);
  return rounded_up(outputs, unit.lanes) * word_layout(inputs, settings.precision, unit).words;
}

}  // namespace

PackingSettings packing_settings(ComputePrecision precision, int threads) {
  PackingSettings settings;
  settings.precision = precision;
  settings.unit = best_matrix_unit(precision);
  settings.threads = threads;
  return settings;
}

int64_t PackedWeights::bytes(int64_t outputs, int64_t inputs, const PackingSettings& settings) {
  return data_floats(outputs, inputs, settings) * int64_t{sizeof(float)};
}

int64_t PackedWeights::bytes() const {
  return bytes(outputs_, inputs_, settings_) +
         static_cast<int64_t>((column_scales_.size() + column_sums_.size()) * sizeof(float));
}

PackedWeights::PackedWeights(const WeightMatrix& weights, const PackingSettings& settings)
    : settings_(settings),
      outputs_(weights.outputs),
      inputs_(weights.inputs),
      data_((check_weights(weights, settings), data_floats(weights.outputs, weights.inputs, settings))) {
  if (settings.precision == ComputePrecision::kFloat32) {
    LinearProduct product;
    product.inputs = inputs_;
    product.outputs = outputs_;
    product.weight = weights.data;
    product.weight_stride = weights.stride;
    pack_weight(product, float_settings(settings, settings.threads), data_.data());
    return;
  }
  const MatrixUnitKernels& unit = matrix_unit_kernels(settings.unit, settings.precision);
  const WordLayout layout = word_layout(inputs_, settings.precision, unit);
  const int64_t padded = rounded_up(outputs_, unit.lanes), lanes = unit.lanes;
  const bool int8 = settings.precision == ComputePrecision::kInt8;
  if (int8) {
    column_scales_.resize(static_cast<std::size_t>(padded));
    column_sums_.resize(static_cast<std::size_t>(padded * parts_of(layout.words, layout.block)));
  }
  auto* packed = reinterpret_cast<uint32_t*>(data_.data());
  const auto stride = static_cast<std::size_t>(layout.words);
#pragma omp parallel num_threads(settings.threads)
  {
    std::vector<uint32_t> panel(static_cast<std::size_t>(lanes) * stride);
#pragma omp for schedule(static)
    for (int64_t first = 0; first < padded; first += lanes) {
      std::fill(panel.begin(), panel.end(), 0U);
      for (int64_t lane = 0; lane < std::min(lanes, outputs_ - first); ++lane) {
        const float* x = weights.data + (first + lane) * weights.stride;
        uint32_t* words = panel.data() + lane * layout.words;
        if (int8) {
          column_scales_[static_cast<std::size_t>(first + lane)] = weight_bytes(x, inputs_, layout, words);
        } else {
          unit.to_bfloat16(x, inputs_, 2 * layout.words, numbers<uint16_t>(words));
        }
      }
      for (int64_t k = 0; k < layout.words; k += layout.block) {
        const int64_t count = std::min(layout.block, layout.words - k);
        uint32_t* to = packed + padded * k + first * count;
        for (int64_t w = 0; w < count; ++w) {
          for (int64_t lane = 0; lane < lanes; ++lane) {
            to[w * lanes + lane] = panel[static_cast<std::size_t>(lane * layout.words + k + w)];
          }
        }
        for (int64_t lane = 0; int8 && lane < lanes; ++lane) {
          const auto* bytes = numbers<const int8_t>(panel.data() + lane * layout.words + k);
          int32_t sum = 0;
          for (int64_t i = 0; i < 4 * count; ++i) sum += bytes[i];
          column_sums_[static_cast<std::size_t>(k / layout.block * padded + first + lane)] = sum;
        }
      }
    }
  }
}

void PackedWeights::unpack(float* weights) const {
  if (settings_.precision != ComputePrecision::kFloat32) {
    fail({"packed weights", "float32, of which nothing was rounded away",
          compute_precision_name(settings_.precision), "keep the weights themselves"});
  }
  LinearProduct product;
  product.inputs = inputs_;
  product.outputs = outputs_;
  product.packed_weight = data_.data();
  unpack_weight(product, float_settings(settings_, settings_.threads), weights);
}

void packed_product(const PackedProduct& product, int threads) {
  check_product(product, threads);
  if (product.rows == 0) return;
  if (product.targets.front().weights->settings().precision == ComputePrecision::kFloat32) {
    float_product(product, threads);
  } else {
    unit_product_of(product, threads);
  }
}

double measure_precision_peak(ComputePrecision precision, int threads) {
  if (precision == ComputePrecision::kFloat32) {
    PeakMeasurement measurement;
    measurement.settings.threads = threads;
    return measure_multiply_add_peak(measurement);
  }
  // They take about 0.5 ms where there is a unit; the first repeats may find all threads on one core.
  constexpr int64_t kRounds = 20000;
  constexpr std::chrono::milliseconds kLeast(200);
  const MatrixUnitKernels& unit = matrix_unit_kernels(best_matrix_unit(precision), precision);
  const auto run = precision == ComputePrecision::kInt8 ? unit.int8_rounds : unit.bfloat16_rounds;
  const int64_t rounds = unit.unit == MatrixUnit::kPlain ? kRounds / 1000 : kRounds;
  double best = 0;
  const auto begun = std::chrono::steady_clock::now();
  while (std::chrono::steady_clock::now() - begun <= kLeast) {
    double operations = 0;
    const auto start = std::chrono::steady_clock::now();
#pragma omp parallel num_threads(threads) reduction(+ : operations)
    operations += run(rounds);
    const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
    best = std::max(best, operations / seconds.count());
  }
  return best;
}

}  // namespace gld
