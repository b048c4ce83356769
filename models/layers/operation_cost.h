#pragma once

#include <cstdint>

namespace gld {

// Counts the floating point operations (a multiplication and an addition are two) and memory of one forward pass of a
// part (docs/NUMBERS.md, "Cost of the published model"). Matrix products and attention are counted, element-wise work
// is not.
struct Cost {
  double linear_flop = 0;       // matrix products with weights
  double convolution_flop = 0;  // those that LibTorch runs as such
  double attention_flop = 0;    // q k^T and p v
  int64_t weight_bytes = 0;     // of these products, in float32
  int64_t working_bytes =
      0;  // activations alive at one time while sampling, roughly; of a DiT only as a whole

  double flop() const { return linear_flop + convolution_flop + attention_flop; }
  // Counts the operations of so many passes; weights and activations stay those of one.
  void multiply_operations(double passes) {
    linear_flop *= passes;
    convolution_flop *= passes;
    attention_flop *= passes;
  }
  // Adds the operations of another pass; weights and activations stay this one's.
  void add_operations_of(const Cost& other) {
    linear_flop += other.linear_flop;
    convolution_flop += other.convolution_flop;
    attention_flop += other.attention_flop;
  }
};

constexpr int64_t kFloatBytes = 4;

inline int64_t bytes_of_floats(double count) { return static_cast<int64_t>(count) * kFloatBytes; }

// Returns the operations of (rows, inputs) times (inputs, outputs).
inline double product_flop(double rows, double inputs, double outputs) { return 2 * rows * inputs * outputs; }

// Returns the operations of softmax(q k^T) v: two products of queries x keys x width.
inline double attention_flop(double queries, double keys, double width) { return 4 * queries * keys * width; }

inline void add_linear(Cost& cost, double rows, double inputs, double outputs) {
  cost.linear_flop += product_flop(rows, inputs, outputs);
  cost.weight_bytes += static_cast<int64_t>(inputs * outputs) * kFloatBytes;
}

// Adds a k x k convolution on a map of that many pixels.
inline void add_convolution(Cost& cost, double pixels, double inputs, double outputs, double kernel) {
  cost.convolution_flop += product_flop(pixels, inputs * kernel * kernel, outputs);
  cost.weight_bytes += static_cast<int64_t>(inputs * kernel * kernel * outputs) * kFloatBytes;
}

}  // namespace gld
