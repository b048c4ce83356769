#include "train/splats/splat_checkpoint.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "gld/base/sha256.h"
#include "gld/files/safetensors.h"

#include <algorithm>
#include <cstring>
#include <stdexcept>
#include <type_traits>
#include <utility>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

// Its state and the digest of all it holds stand under these among the file's metadata.
constexpr const char* kState = "gld:state";
constexpr const char* kDigest = "gld:sha256";

// Returns doubles as their bits: a number in JSON need not come back as it was.
uint64_t bits_of(double value) {
  uint64_t bits = 0;
  std::memcpy(&bits, &value, sizeof bits);
  return bits;
}
double double_of(uint64_t bits) {
  double value = 0;
  std::memcpy(&value, &bits, sizeof value);
  return value;
}

nlohmann::json json_of(const TableCell& cell) {
  if (const auto* text = std::get_if<std::string>(&cell)) return *text;
  if (const auto* number = std::get_if<int64_t>(&cell)) return *number;
  return {{"bits", bits_of(std::get<double>(cell))}};
}
TableCell cell_of(const nlohmann::json& json) {
  if (json.is_string()) return json.get<std::string>();
  if (json.is_object()) return double_of(json.at("bits").get<uint64_t>());
  return json.get<int64_t>();
}

// Calls visit(name, values) for every array of a fit, in one order.
template <class Fit, class Visit>
void visit_arrays(Fit& fit, const Visit& visit) {
  const auto visit_set = [&](const char* of, auto& set) {
    for (const GaussianArray& array : gaussian_arrays(set))
      visit(fmt::format("{}.{}", of, array.name), set.*array.values);
  };
  visit_set("set", fit.set);
  visit_set("first_moments", fit.moments.first);
  visit_set("second_moments", fit.moments.second);
  visit("statistics.gradient_sums", fit.statistics.gradient_sums);
  visit("statistics.seen", fit.statistics.seen);
}

template <class Number>
constexpr DType dtype_of() {
  return std::is_same_v<Number, float> ? DType::kFloat32 : DType::kInt32;
}

// Of the state and of the arrays' names, lengths and bytes.
class Digest {
 public:
  explicit Digest(const std::string& state) { hash_.update(state); }
  template <class Values>
  void add(const std::string& name, const Values& values) {
    hash_.update(fmt::format("\n{} {}\n", name, values.size()));
    hash_.update(
        ByteView{reinterpret_cast<const uint8_t*>(values.data()), values.size() * sizeof(values[0])});
  }
  std::string hex() { return hash_.hex_digest(); }

 private:
  Sha256 hash_;
};

[[noreturn]] void refuse(const std::filesystem::path& file) {
  fail({file.string(), "a checkpoint as gld splat fit wrote it", "other bytes",
        "remove it: the fit then begins anew"});
}

}  // namespace

std::string fit_views_hash(const std::vector<const FittedView*>& views) {
  Sha256 hash;
  const auto add = [&](const void* data, size_t bytes) {
    hash.update(ByteView{static_cast<const uint8_t*>(data), bytes});
  };
  for (const FittedView* view : views) {
    hash.update(view->name);
    const int64_t size[2] = {view->camera.width, view->camera.height};
    add(size, sizeof size);
    add(view->camera.intrinsics.data(), 9 * sizeof(double));
    add(view->camera.world_from_camera.matrix().data(), 16 * sizeof(double));
    add(view->target.image.values.data(), view->target.image.values.size() * sizeof(float));
    add(view->target.valid.data(), view->target.valid.size());
    add(view->latent.picture.values.data(), view->latent.picture.values.size() * sizeof(float));
  }
  return hash.hex_digest();
}

void write_splat_checkpoint(const std::filesystem::path& file, const SplatCheckpoint& checkpoint) {
  const SplatFit& fit = checkpoint.fit;
  nlohmann::json state;
  state["step"] = fit.step;
  state["extent"] = bits_of(fit.extent);
  state["start"] = splat_start_names().at(static_cast<size_t>(fit.start));
  for (int k = 0; k < 3; ++k) state["origin"].push_back(bits_of(fit.set.origin[k]));
  state["degree"] = fit.set.degree;
  state["channels"] = fit.set.channels;
  state["moment_steps"] = fit.moments.steps;
  state["started_with"] = checkpoint.started_with;
  state["seconds"] = bits_of(checkpoint.seconds);
  state["processor_seconds"] = bits_of(checkpoint.processor_seconds);
  state["views"] = checkpoint.views;
  state["rows"] = nlohmann::json::array();
  for (const auto& row : checkpoint.rows) {
    nlohmann::json cells = nlohmann::json::array();
    for (const TableCell& cell : row) cells.push_back(json_of(cell));
    state["rows"].push_back(cells);
  }
  const std::string text = json_text(state);
  Digest digest(text);
  std::vector<TensorEntry> entries;
  std::string bytes;
  visit_arrays(fit, [&](const std::string& name, const auto& values) {
    using Number = typename std::decay_t<decltype(values)>::value_type;
    TensorEntry entry;
    entry.name = name;
    entry.dtype = dtype_of<Number>();
    entry.shape = {static_cast<int64_t>(values.size())};
    entries.push_back(std::move(entry));
    digest.add(name, values);
    bytes.append(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(Number));
  });
  write_file_atomically(file, safetensors_header(entries, {{kState, text}, {kDigest, digest.hex()}}) + bytes);
}

SplatCheckpoint read_splat_checkpoint(const std::filesystem::path& file) {
  const std::string bytes = read_file(file);
  SplatCheckpoint checkpoint;
  SplatFit& fit = checkpoint.fit;
  try {
    const ParsedWeights parsed =
        parse_safetensors({reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()}, file.string());
    const std::string& text = parsed.metadata.at(kState);
    Digest digest(text);
    size_t arrays = 0;
    visit_arrays(fit, [&](const std::string& name, auto& values) {
      using Number = typename std::decay_t<decltype(values)>::value_type;
      const auto entry = std::find_if(parsed.entries.begin(), parsed.entries.end(),
                                      [&](const TensorEntry& one) { return one.name == name; });
      if (entry == parsed.entries.end() || entry->dtype != dtype_of<Number>() || entry->shape.size() != 1)
        refuse(file);
      values.resize(static_cast<size_t>(entry->shape[0]));
      if (!values.empty()) std::memcpy(values.data(), entry->data, values.size() * sizeof(Number));
      digest.add(name, values);
      ++arrays;
    });
    if (arrays != parsed.entries.size() || digest.hex() != parsed.metadata.at(kDigest)) refuse(file);
    // Its bytes are those that were written, but by a program of another version perhaps.
    const nlohmann::json state = parse_json(text, file.string());
    fit.step = state.at("step").get<int64_t>();
    fit.extent = double_of(state.at("extent").get<uint64_t>());
    const auto& starts = splat_start_names();
    const auto start = std::find(starts.begin(), starts.end(), state.at("start").get<std::string>());
    if (start == starts.end()) refuse(file);
    fit.start = static_cast<SplatStartFrom>(start - starts.begin());
    for (int k = 0; k < 3; ++k)
      fit.set.origin[k] = double_of(state.at("origin").at(static_cast<size_t>(k)).get<uint64_t>());
    for (GaussianSet* set : {&fit.set, &fit.moments.first, &fit.moments.second}) {
      set->degree = state.at("degree").get<int64_t>();
      set->channels = state.at("channels").get<int64_t>();
    }
    fit.moments.steps = state.at("moment_steps").get<int64_t>();
    checkpoint.started_with = state.at("started_with").get<int64_t>();
    checkpoint.seconds = double_of(state.at("seconds").get<uint64_t>());
    checkpoint.processor_seconds = double_of(state.at("processor_seconds").get<uint64_t>());
    checkpoint.views = state.at("views").get<std::string>();
    for (const auto& row : state.at("rows")) {
      checkpoint.rows.emplace_back();
      for (const auto& cell : row) checkpoint.rows.back().push_back(cell_of(cell));
    }
  } catch (const Error&) {
    refuse(file);
  } catch (const std::out_of_range&) {
    refuse(file);
  } catch (const nlohmann::json::exception&) {
    refuse(file);
  }
  for (const GaussianSet* set : {&fit.set, &fit.moments.first, &fit.moments.second}) {
    for (const GaussianArray& array : gaussian_arrays(*set)) {
      if (static_cast<int64_t>((set->*array.values).size()) != fit.set.size() * array.each) refuse(file);
    }
  }
  for (const size_t length : {fit.statistics.gradient_sums.size(), fit.statistics.seen.size()}) {
    if (length != 0 && static_cast<int64_t>(length) != fit.set.size()) refuse(file);
  }
  check_gaussians(fit.set, file.string());
  return checkpoint;
}

}  // namespace gld
