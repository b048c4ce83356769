#include "gld/attention/fused_attention.h"

#include "gld/base/error.h"
#include "gld/kernels/attention_kernel.h"
#include "gld/tensors/torch_version.h"

#include <optional>
#include <vector>

#include <torch/autograd.h>
#include <torch/types.h>

namespace gld {
namespace {

constexpr int64_t kLargestHeadDim = 256;

// Returns x, (batch, tokens, heads, head_dim), with contiguous channels.
torch::Tensor with_contiguous_channels(const torch::Tensor& x) {
  return x.size(3) > 1 && x.stride(3) != 1 ? x.contiguous() : x;
}

template <class Float>
StridedHeads<Float> pointers(const torch::Tensor& x) {
  return {x.data_ptr<float>(), x.stride(0), x.stride(1), x.stride(2)};
}

// What the kernel reads besides queries, keys and values, kept alive together with the pointers into it.
class Context {
 public:
  explicit Context(const PropeTables* prope) {
    if (prope != nullptr) {
      tables_ = *prope;
      for (auto* table : table_tensors(tables_)) *table = table->to(torch::kFloat32).contiguous();
      PropePointers p;
      p.views = tables_.grid.views;
      p.prefix_tokens = tables_.prefix_tokens;
      p.grid_height = tables_.grid.height;
      p.grid_width = tables_.grid.width;
      p.query_matrix = tables_.query_matrix.data_ptr<float>();
      p.key_value_matrix = tables_.key_value_matrix.data_ptr<float>();
      p.output_matrix = tables_.output_matrix.data_ptr<float>();
      p.column_cos = tables_.column_cos.data_ptr<float>();
      p.column_sin = tables_.column_sin.data_ptr<float>();
      p.row_cos = tables_.row_cos.data_ptr<float>();
      p.row_sin = tables_.row_sin.data_ptr<float>();
      prope_ = p;
    }
  }

  AttentionForward arrays(const torch::Tensor& query, const torch::Tensor& key, const torch::Tensor& value,
                          const torch::Tensor& output, const torch::Tensor& log_sum_exp) const {
    AttentionForward arrays;
    arrays.shape = {query.size(0), query.size(2), query.size(1), key.size(1), query.size(3)};
    arrays.query = pointers<const float>(query);
    arrays.key = pointers<const float>(key);
    arrays.value = pointers<const float>(value);
    arrays.prope = prope_ ? &*prope_ : nullptr;
    arrays.output = pointers<float>(output);
    arrays.log_sum_exp = log_sum_exp.defined() ? log_sum_exp.data_ptr<float>() : nullptr;
    return arrays;
  }

  // For the autograd graph, which keeps tensors and integers: grid and prefix, then the tables.
  std::vector<int64_t> save_sizes() const {
    return {tables_.grid.views, tables_.grid.height, tables_.grid.width, tables_.prefix_tokens};
  }
  std::vector<torch::Tensor> save_tensors() {
    std::vector<torch::Tensor> saved;
    for (auto* table : table_tensors(tables_)) saved.push_back(*table);
    return saved;
  }
  static Context restore(const std::vector<int64_t>& sizes, const torch::Tensor* saved) {
    PropeTables tables;
    tables.grid = {sizes[0], sizes[1], sizes[2]};
    tables.prefix_tokens = sizes[3];
    for (auto* table : table_tensors(tables)) *table = *saved++;
    return Context(tables.query_matrix.defined() ? &tables : nullptr);
  }

 private:
  PropeTables tables_;
  std::optional<PropePointers> prope_;
};

KernelSettings settings(ComputePrecision precision) {
  KernelSettings settings;
  settings.threads = thread_count();
  settings.precision = precision;
  if (precision != ComputePrecision::kFloat32) settings.unit = best_matrix_unit(precision);
  return settings;
}

AttentionGradients gradients_of(const Context& context, const AttentionInputs& inputs,
                                const AttentionResult& result, const torch::Tensor& output_gradient) {
  const auto gradient = with_contiguous_channels(output_gradient);
  AttentionGradients gradients;
  gradients.query = torch::empty_like(inputs.query, torch::MemoryFormat::Contiguous);
  gradients.key = torch::empty_like(inputs.key, torch::MemoryFormat::Contiguous);
  gradients.value = torch::empty_like(inputs.value, torch::MemoryFormat::Contiguous);
  AttentionBackward arrays;
  arrays.forward = context.arrays(inputs.query, inputs.key, inputs.value, result.output, result.log_sum_exp);
  arrays.output_gradient = pointers<const float>(gradient);
  arrays.query_gradient = pointers<float>(gradients.query);
  arrays.key_gradient = pointers<float>(gradients.key);
  arrays.value_gradient = pointers<float>(gradients.value);
  attention_backward(arrays, settings(inputs.precision));
  return gradients;
}

class FusedAttention : public torch::autograd::Function<FusedAttention> {
 public:
  static torch::Tensor forward(torch::autograd::AutogradContext* graph, const torch::Tensor& query,
                               const torch::Tensor& key, const torch::Tensor& value, Context* context,
                               ComputePrecision precision) {
    auto output = torch::empty_like(query, torch::MemoryFormat::Contiguous);
    const auto log_sum_exp = torch::empty({query.size(0), query.size(2), query.size(1)}, query.options());
    attention_forward(context->arrays(query, key, value, output, log_sum_exp), settings(precision));
    auto saved = std::vector<torch::Tensor>{query, key, value, output, log_sum_exp};
    for (const auto& tensor : context->save_tensors()) saved.push_back(tensor);
    graph->save_for_backward(saved);
    graph->saved_data["sizes"] = context->save_sizes();
    graph->saved_data["precision"] = static_cast<int64_t>(precision);
    return output;
  }

  static torch::autograd::variable_list backward(torch::autograd::AutogradContext* graph,
                                                 const torch::autograd::variable_list& gradients) {
    if (torch::GradMode::is_enabled()) {
      fail({"attention", "first derivatives only", "a backward pass that records a graph of its own",
            "compute in double precision, which uses differentiable operations"});
    }
    const auto saved = graph->get_saved_variables();
    const auto context = Context::restore(graph->saved_data["sizes"].toIntVector(), &saved[5]);
    AttentionInputs inputs;
    inputs.query = saved[0];
    inputs.key = saved[1];
    inputs.value = saved[2];
    inputs.precision = static_cast<ComputePrecision>(graph->saved_data["precision"].toInt());
    const auto result = gradients_of(context, inputs, {saved[3], saved[4]}, gradients[0]);
    return {result.query, result.key, result.value, torch::Tensor(), torch::Tensor()};
  }
};

}  // namespace

bool fused_attention_applies(const torch::Tensor& like, int64_t head_dim) {
  return like.is_cpu() && like.scalar_type() == torch::kFloat32 && head_dim >= 1 &&
         head_dim <= kLargestHeadDim;
}

bool fused_attention_applies(const AttentionInputs& inputs) {
  const int64_t head_dim = inputs.query.size(3);
  return fused_attention_applies(inputs.query, head_dim) && fused_attention_applies(inputs.key, head_dim) &&
         fused_attention_applies(inputs.value, head_dim);
}

torch::Tensor fused_attention(const AttentionInputs& inputs) {
  Context context(inputs.prope);
  const auto query = with_contiguous_channels(inputs.query);
  const auto key = with_contiguous_channels(inputs.key);
  const auto value = with_contiguous_channels(inputs.value);
  if (torch::GradMode::is_enabled() &&
      (query.requires_grad() || key.requires_grad() || value.requires_grad())) {
    return FusedAttention::apply(query, key, value, &context, inputs.precision);
  }
  auto output = torch::empty_like(query, torch::MemoryFormat::Contiguous);
  attention_forward(context.arrays(query, key, value, output, {}), settings(inputs.precision));
  return output;
}

AttentionResult fused_attention_result(const AttentionInputs& inputs) {
  const torch::NoGradGuard no_grad;
  const Context context(inputs.prope);
  const auto query = with_contiguous_channels(inputs.query);
  AttentionResult result;
  result.output = torch::empty_like(query, torch::MemoryFormat::Contiguous);
  result.log_sum_exp = torch::empty({query.size(0), query.size(2), query.size(1)}, query.options());
  attention_forward(context.arrays(query, with_contiguous_channels(inputs.key),
                                   with_contiguous_channels(inputs.value), result.output, result.log_sum_exp),
                    settings(inputs.precision));
  return result;
}

AttentionGradients fused_attention_gradients(const AttentionInputs& inputs, const AttentionResult& result,
                                             const torch::Tensor& output_gradient) {
  const torch::NoGradGuard no_grad;
  AttentionInputs contiguous = inputs;
  for (auto* tensor : {&contiguous.query, &contiguous.key, &contiguous.value}) {
    *tensor = with_contiguous_channels(*tensor);
  }
  return gradients_of(Context(inputs.prope), contiguous, result, output_gradient);
}

}  // namespace gld
