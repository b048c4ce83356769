#include "train/splats/splat_checkpoint.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "gld/base/sha256.h"

#include <cstring>

#include <nlohmann/json.hpp>

namespace gld {
namespace {

constexpr size_t kDigits = 64;  // of SHA-256

std::string digest_of(const std::string& text) {
  Sha256 hash;
  hash.update(text);
  return hash.hex_digest();
}

// Doubles as their bits: a number in JSON need not come back as it was.
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

// Calls visit(values) for every array of a fit, in one order.
template <class Fit, class Visit>
void visit_arrays(Fit& fit, const Visit& visit) {
  for (auto* set : {&fit.set, &fit.moments.first, &fit.moments.second}) {
    for (const GaussianArray& array : gaussian_arrays(*set)) visit(set->*array.values);
  }
  visit(fit.statistics.gradient_sums);
  visit(fit.statistics.seen);
}

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
  }
  return hash.hex_digest();
}

void write_splat_checkpoint(const std::filesystem::path& file, const SplatCheckpoint& checkpoint) {
  const SplatFit& fit = checkpoint.fit;
  nlohmann::json state;
  state["step"] = fit.step;
  state["extent"] = bits_of(fit.extent);
  for (int k = 0; k < 3; ++k) state["origin"].push_back(bits_of(fit.set.origin[k]));
  state["degree"] = fit.set.degree;
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
  std::string arrays;
  visit_arrays(fit, [&](const auto& values) {
    state["lengths"].push_back(values.size());
    arrays.append(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(values[0]));
  });
  const std::string rest = json_text(state) + "\n" + arrays;
  write_file_atomically(file, digest_of(rest) + "\n" + rest);
}

SplatCheckpoint read_splat_checkpoint(const std::filesystem::path& file) {
  const std::string bytes = read_file(file);
  if (bytes.size() < kDigits + 1 || bytes[kDigits] != '\n') refuse(file);
  const std::string rest = bytes.substr(kDigits + 1);
  if (digest_of(rest) != bytes.substr(0, kDigits)) refuse(file);
  const size_t line = rest.find('\n');
  if (line == std::string::npos) refuse(file);
  const nlohmann::json state = parse_json(rest.substr(0, line), file.string());
  SplatCheckpoint checkpoint;
  SplatFit& fit = checkpoint.fit;
  // Its bytes are those that were written, but by a program of another version perhaps.
  try {
    fit.step = state.at("step").get<int64_t>();
    fit.extent = double_of(state.at("extent").get<uint64_t>());
    for (int k = 0; k < 3; ++k)
      fit.set.origin[k] = double_of(state.at("origin").at(static_cast<size_t>(k)).get<uint64_t>());
    for (GaussianSet* set : {&fit.set, &fit.moments.first, &fit.moments.second})
      set->degree = state.at("degree").get<int64_t>();
    fit.moments.steps = state.at("moment_steps").get<int64_t>();
    checkpoint.started_with = state.at("started_with").get<int64_t>();
    checkpoint.seconds = double_of(state.at("seconds").get<uint64_t>());
    checkpoint.processor_seconds = double_of(state.at("processor_seconds").get<uint64_t>());
    checkpoint.views = state.at("views").get<std::string>();
    for (const auto& row : state.at("rows")) {
      checkpoint.rows.emplace_back();
      for (const auto& cell : row) checkpoint.rows.back().push_back(cell_of(cell));
    }
    size_t at = line + 1, number = 0;
    visit_arrays(fit, [&](auto& values) {
      const auto length = state.at("lengths").at(number++).get<size_t>();
      const size_t each = sizeof(values[0]);
      if (length > (rest.size() - at) / each) refuse(file);
      values.resize(length);
      if (length > 0) std::memcpy(values.data(), rest.data() + at, length * each);
      at += length * each;
    });
    if (at != rest.size()) refuse(file);
  } catch (const nlohmann::json::exception&) {
    refuse(file);
  }
  check_gaussians(fit.set, file.string());
  return checkpoint;
}

}  // namespace gld
