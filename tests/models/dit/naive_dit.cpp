#include "tests/models/dit/naive_dit.h"

#include "gld/camera_encoding/camera_conditioning.h"

#include <algorithm>
#include <cmath>
#include <tuple>

#include <Eigen/LU>

namespace gld::test {
namespace {

using torch::Tensor;

class NaiveDit {
 public:
  NaiveDit(const DitOptions& options, const std::map<std::string, Tensor>& weights,
           const NaiveDitInputs& inputs)
      : options_(options), weights_(weights), inputs_(inputs) {
    const Camera& first = inputs.views.cameras.front();
    height_ = first.height / options.camera_patch_size;
    width_ = first.width / options.camera_patch_size;
    special_ = options.num_special_tokens;
    patches_ = height_ * width_;
    fill_matrices();
  }

  Tensor velocity() {
    const auto time = time_embedding();
    Tensor s = embed("s", options_.conditioning == DitConditioning::kDeeperLevel);
    Tensor x = embed("x", false);
    const bool at_encoder = options_.camera_embedding_input == CameraEmbeddingInput::kConditionEncoder;
    (at_encoder ? s : x).narrow(1, special_, patches_) += camera_embedding();
    if (inputs_.warp_agreement.defined() && inputs_.conditional) {
      const int64_t sources = inputs_.views.num_sources, targets = inputs_.views.num_targets();
      s.narrow(0, sources, targets).narrow(1, special_, patches_) += carried("s");
      x.narrow(0, sources, targets).narrow(1, special_, patches_) += carried("x");
    }
    int64_t block = 0;
    for (int64_t i = 0; i < options_.depth[0]; ++i, ++block) {
      s = run_block(block, s, silu(time).expand({s.size(0), s.size(1), s.size(2)}), options_.num_heads[0]);
    }
    s = silu(s + time);
    if (options_.hidden_size[0] != options_.hidden_size[1]) s = linear("s_projector", s);
    for (int64_t i = 0; i < options_.depth[1]; ++i, ++block)
      x = run_block(block, x, s, options_.num_heads[1]);
    const auto vectors = linear("final_layer.adaLN_modulation.1", silu(s)).chunk(2, -1);
    auto out =
        linear("final_layer.linear", norm("final_layer.norm_final", x) * (1 + vectors[1]) + vectors[0]);
    if (special_ == 0) return out;
    return torch::cat(
        {linear("special_output_proj", out.narrow(1, 0, special_)), out.narrow(1, special_, patches_)}, 1);
  }

 private:
  const Tensor& weight(const std::string& name) const { return weights_.at(name); }
  static Tensor silu(const Tensor& x) { return x / (1 + torch::exp(-x)); }
  Tensor linear(const std::string& name, const Tensor& x) const {
    return torch::matmul(x, weight(name + ".weight").flatten(1).t()) + weight(name + ".bias");
  }
  Tensor norm(const std::string& name, const Tensor& x) const {
    return x / torch::sqrt((x * x).mean(-1, true) + 1e-6) * weight(name + ".weight");
  }

  Tensor time_embedding() const {
    const auto angles = 2 * M_PI * inputs_.time * weight("t_embedder.W");
    const auto waves = torch::cat({torch::sin(angles), torch::cos(angles)});
    return linear("t_embedder.mlp.2", silu(linear("t_embedder.mlp.0", waves)));
  }

  Tensor positions(int64_t channels) const {
    auto table = torch::zeros({patches_, channels}, torch::kFloat64);
    const int64_t quarter = channels / 4;
    for (int64_t token = 0; token < patches_; ++token) {
      for (int64_t i = 0; i < quarter; ++i) {
        const double omega = std::pow(10000.0, -static_cast<double>(i) / static_cast<double>(quarter));
        const int64_t line = token / width_;
        const auto column = static_cast<double>(token % width_), row = static_cast<double>(line);
        table[token][i] = std::sin(column * omega);
        table[token][quarter + i] = std::cos(column * omega);
        table[token][2 * quarter + i] = std::sin(row * omega);
        table[token][3 * quarter + i] = std::cos(row * omega);
      }
    }
    return table;
  }

  Tensor embed(const std::string& part, bool deeper) const {
    std::vector<Tensor> views;
    for (int64_t view = 0; view < inputs_.views.size(); ++view) {
      const std::string role = view < inputs_.views.num_sources ? "_ref" : "_tgt";
      const std::string name = part + "_embedder" + (options_.split_embedders ? role : "") + ".proj";
      const auto both = torch::cat({inputs_.source_features[view], inputs_.noisy[view]}, -1);
      auto patch_input = both.narrow(0, special_, patches_);
      if (deeper) {
        patch_input = torch::cat({inputs_.source_features[view], inputs_.deeper_level[view]}, -1)
                          .narrow(0, special_, patches_);
      }
      auto tokens = linear(name, patch_input);
      if (options_.position_embedding == PositionEmbedding::kSinCos)
        tokens = tokens + positions(tokens.size(1));
      if (special_ > 0) {
        tokens = torch::cat({linear("special_" + part + "_embedder", both.narrow(0, 0, special_)) +
                                 weight("special_pos_embed_" + part)[0],
                             tokens});
      }
      views.push_back(tokens);
    }
    return torch::stack(views);
  }

  // Returns what a part of the model gets of the pictures that were carried into target views.
  Tensor carried(const std::string& part) const {
    const std::string split = options_.split_embedders ? "_tgt" : "";
    const auto embedder = weight(part + "_embedder" + split + ".proj.weight").flatten(1);
    auto features = torch::matmul(inputs_.warped_features, embedder.narrow(1, 0, options_.in_channels).t());
    if (part == "x") return features;
    return features + torch::conv2d(inputs_.warp_agreement, weight("warp_embedder.proj.weight"),
                                    weight("warp_embedder.proj.bias"), options_.camera_patch_size)
                          .flatten(2)
                          .transpose(1, 2);
  }

  Tensor camera_embedding() const {
    PixelOffset offset;
    offset.x = options_.pixel_offset[0];
    offset.y = options_.pixel_offset[1];
    auto image = camera_conditioning(relative_cameras(inputs_.views), offset, torch::kFloat64);
    if (!inputs_.conditional) image.narrow(1, 1, 6).zero_();
    return torch::conv2d(image, weight("camera_embedder.proj.weight"), weight("camera_embedder.proj.bias"),
                         options_.camera_patch_size)
        .flatten(2)
        .transpose(1, 2);
  }

  void fill_matrices() {
    const auto relative = relative_cameras(inputs_.views);
    const bool world = options_.prope_frame == PropeFrame::kWorld && special_ > 0;
    const auto& cameras = (world ? relative.world_views : relative.views).cameras;
    for (const Camera& camera : cameras) {
      const bool identity = options_.unconditional_intrinsics == UnconditionalIntrinsics::kIdentity;
      Eigen::Matrix3d intrinsics = camera.intrinsics;
      Eigen::Matrix4d pose = camera.world_from_camera.inverse().matrix();
      if (!inputs_.conditional) {
        pose.setIdentity();
        if (identity) intrinsics.setIdentity();
      }
      const bool own = options_.prope_image_size == "image";
      const double width = own ? static_cast<double>(camera.width) : std::stod(options_.prope_image_size);
      const double height = own ? static_cast<double>(camera.height) : std::stod(options_.prope_image_size);
      Eigen::Matrix4d k = Eigen::Matrix4d::Identity();
      k(0, 0) = intrinsics(0, 0) / width;
      k(1, 1) = intrinsics(1, 1) / height;
      k(0, 2) = intrinsics(0, 2) / width - 0.5;
      k(1, 2) = intrinsics(1, 2) / height - 0.5;
      const Eigen::Matrix4d projection = k * pose;
      const Eigen::Matrix4d inverse = options_.prope_inverse == PropeInverse::kTrue
                                          ? Eigen::Matrix4d(projection.inverse())
                                          : Eigen::Matrix4d(pose.inverse() * k);
      const auto tensor = [](const Eigen::Matrix4d& matrix) {
        const Eigen::Matrix4d transposed = matrix.transpose();  // Eigen is column-major
        return torch::from_blob(const_cast<double*>(transposed.data()), {4, 4}, torch::kFloat64).clone();
      };
      projection_.push_back(tensor(projection));
      inverse_.push_back(tensor(inverse));
    }
  }

  // Encodes one token's head by the encoding of its view and place; direction -1 rotates back.
  Tensor encode(const Tensor& vector, const Tensor& matrix, int64_t patch, double direction) const {
    const int64_t head_dim = vector.size(0), half = head_dim / 8;
    auto out = torch::empty_like(vector);
    out.narrow(0, 0, head_dim / 2) =
        torch::matmul(vector.narrow(0, 0, head_dim / 2).view({-1, 4}), matrix.t()).flatten();
    for (int64_t part = 0; part < 2; ++part) {
      const auto position = static_cast<double>(part == 0 ? patch % width_ : patch / width_);
      const int64_t first = head_dim / 2 + part * head_dim / 4;
      const auto exponent = torch::arange(half, torch::kFloat64) / static_cast<double>(half);
      const auto angle = direction * position * torch::pow(100.0, -exponent);
      const auto a = vector.narrow(0, first, half), b = vector.narrow(0, first + half, half);
      out.narrow(0, first, half) = torch::cos(angle) * a + torch::sin(angle) * b;
      out.narrow(0, first + half, half) = torch::cos(angle) * b - torch::sin(angle) * a;
    }
    return out;
  }

  // x is (views * tokens, head_dim).
  Tensor encode_all(const Tensor& x, const std::string& role) const {
    auto out = x.clone();
    const int64_t per_view = special_ + patches_;
    for (int64_t token = 0; token < x.size(0); ++token) {
      const int64_t patch = token % per_view - special_;
      if (patch < 0) continue;
      const auto view = static_cast<size_t>(token / per_view);
      if (role == "query") out[token] = encode(x[token], projection_[view].t(), patch, 1);
      if (role == "key_value") out[token] = encode(x[token], inverse_[view], patch, 1);
      if (role == "output") out[token] = encode(x[token], projection_[view], patch, -1);
    }
    return out;
  }

  Tensor attention(const std::string& name, const Tensor& x, int64_t heads) const {
    const int64_t channels = x.size(2), head_dim = channels / heads;
    const auto qkv = linear(name + ".qkv", x.flatten(0, 1)).view({-1, 3, heads, head_dim});
    std::vector<Tensor> outputs;
    for (int64_t head = 0; head < heads; ++head) {
      Tensor query = qkv.select(1, 0).select(1, head), key = qkv.select(1, 1).select(1, head);
      if (options_.qk_norm) {
        query = norm(name + ".q_norm", query);
        key = norm(name + ".k_norm", key);
      }
      query = encode_all(query, "query");
      key = encode_all(key, "key_value");
      const auto value = encode_all(qkv.select(1, 2).select(1, head), "key_value");
      const auto logits = torch::matmul(query, key.t()) / std::sqrt(static_cast<double>(head_dim));
      outputs.push_back(encode_all(torch::matmul(torch::softmax(logits, -1), value), "output"));
    }
    return linear(name + ".proj", torch::cat(outputs, -1)).view(x.sizes());
  }

  Tensor run_block(int64_t index, const Tensor& x, const Tensor& condition, int64_t heads) const {
    const std::string name = "blocks." + std::to_string(index);
    const auto v = linear(name + ".adaLN_modulation.1", silu(condition)).chunk(6, -1);
    auto y = x + v[2] * attention(name + ".attn", norm(name + ".norm1", x) * (1 + v[1]) + v[0], heads);
    const auto h = linear(name + ".mlp.w12", norm(name + ".norm2", y) * (1 + v[4]) + v[3]).chunk(2, -1);
    return y + v[5] * linear(name + ".mlp.w3", silu(h[0]) * h[1]);
  }

  const DitOptions& options_;
  const std::map<std::string, Tensor>& weights_;
  const NaiveDitInputs& inputs_;
  int64_t height_ = 0, width_ = 0, special_ = 0, patches_ = 0;
  std::vector<Tensor> projection_, inverse_;
};

// This goes token by token: the network's prediction is mixed with what was carried to the token, or corrects the best
// linear estimate of it.
Tensor with_first_guess(const DitOptions& options, const std::map<std::string, Tensor>& weights,
                        const NaiveDitInputs& inputs, Tensor output) {
  const int64_t side = options.camera_patch_size, special = options.num_special_tokens;
  const double t = inputs.time;
  const double lambda = t * t / (t * t + options.carried_error * (1 - t) * (1 - t));
  const auto gate = weights.at("carried_gate.weight")[0];
  const double offset = weights.at("carried_gate.bias")[0].item<double>();
  for (int64_t target = 0; target < inputs.warp_agreement.size(0); ++target) {
    const int64_t view = inputs.views.num_sources + target;
    const int64_t columns = inputs.warp_agreement.size(3) / side;
    for (int64_t patch = 0; patch < inputs.warped_features.size(1); ++patch) {
      const auto pixels = inputs.warp_agreement[target]
                              .narrow(1, patch / columns * side, side)
                              .narrow(2, patch % columns * side, side);
      double agreed = offset;
      for (int64_t i = 0; i < options.warped_sources; ++i) {
        agreed += gate[i].item<double>() * pixels[i].mean().item<double>();
      }
      const double largest = std::get<0>(pixels.max(0)).mean().item<double>();
      const double trust = largest / (1 + std::exp(-agreed)), m = lambda * trust;
      const auto w = inputs.warped_features[target][patch];
      const auto x_t = inputs.noisy[view][special + patch];
      auto token = output[view][special + patch];
      if (options.carried_guess == CarriedGuess::kCorrected) {
        // Guesses by their precision: the mean of all latents, w, and the data that x_t would be without noise.
        const double of_w = trust / options.carried_error, of_noisy = (1 - t) * (1 - t) / (t * t);
        const double precision = 1 + of_w + of_noisy;
        token.copy_((of_w * w + of_noisy * x_t / (1 - t)) / precision + token / std::sqrt(precision));
        continue;
      }
      const auto carried = options.prediction == FlowPrediction::kData ? w : (x_t - w) / t;
      token.copy_((1 - m) * token + m * carried);
    }
  }
  return output;
}

// The same where nothing is carried.
Tensor without_guess(const NaiveDitInputs& inputs, const Tensor& output, int64_t first_view,
                     int64_t end_view) {
  const double t = inputs.time, of_noisy = (1 - t) * (1 - t) / (t * t);
  const auto views = [&](const Tensor& all) { return all.narrow(0, first_view, end_view - first_view); };
  auto result = output.clone();
  views(result).copy_(of_noisy / (1 + of_noisy) * views(inputs.noisy) / (1 - t) +
                      views(output) / std::sqrt(1 + of_noisy));
  return result;
}

}  // namespace

torch::Tensor naive_dit_velocity(const DitOptions& options,
                                 const std::map<std::string, torch::Tensor>& weights,
                                 const NaiveDitInputs& inputs) {
  const torch::NoGradGuard no_grad;
  auto output = NaiveDit(options, weights, inputs).velocity();
  if (options.carried_guess == CarriedGuess::kCorrected) {
    const int64_t views = output.size(0);
    output = without_guess(inputs, output, 0, inputs.conditional ? inputs.views.num_sources : views);
  }
  if (options.carried_error > 0 && inputs.conditional) {
    output = with_first_guess(options, weights, inputs, output);
  }
  if (options.prediction == FlowPrediction::kVelocity) return output;
  if (options.carried_guess == CarriedGuess::kCorrected) return (inputs.noisy - output) / inputs.time;
  return (inputs.noisy - output) * std::min(1 / inputs.time, options.largest_inverse_time);
}

}  // namespace gld::test
