#include "infer/export/output_inspection.h"

#include "datasets/images/png_file.h"
#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "gld/base/mapped_file.h"
#include "gld/base/printable_text.h"
#include "gld/base/run_journal.h"
#include "gld/files/ply_vertices.h"
#include "gld/files/weight_file.h"
#include "gld/report/run_folder.h"
#include "gld/report/shell_word.h"

#include <algorithm>
#include <charconv>
#include <fstream>
#include <map>
#include <sstream>
#include <string_view>
#include <vector>

#include <fmt/format.h>

namespace gld {
namespace {

using nlohmann::ordered_json;

// Texts of files may be any bytes, but JSON is UTF-8: what is not is replaced.
std::string valid_text(const std::string& text) { return ordered_json::parse(json_text(ordered_json(text))); }

std::string state_of_run(const std::filesystem::path& folder) {
  try {
    RunJournal::refuse_running(folder);
  } catch (const Error&) {
    return "running";
  }
  std::error_code none;
  // A fit that was stopped has a report of the steps so far.
  const bool stopped = std::filesystem::exists(folder / "fit.checkpoint", none);
  return !stopped && std::filesystem::exists(folder / "report.json", none) ? "finished" : "not finished";
}

ordered_json number_or_null(const nlohmann::json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && found->is_number() ? ordered_json(found->get<double>()) : ordered_json();
}

// The summary is of the header alone: the tensors and their checksum are looked at by --resume.
ordered_json checkpoint_summary(const std::filesystem::path& file, const std::filesystem::path& folder) {
  ordered_json summary = {{"file", file.lexically_relative(folder).string()}};
  try {
    const auto weights = WeightFile::open(file);
    const auto& metadata = weights->metadata();
    const auto step = metadata.find("step"), state = metadata.find("state");
    if (step == metadata.end() || state == metadata.end())
      fail({file.string(), "a training checkpoint", "a weight file of another kind", ""});
    int64_t number = 0;
    const char* end = step->second.data() + step->second.size();
    const auto parsed = std::from_chars(step->second.data(), end, number);
    summary["step"] = parsed.ec == std::errc() && parsed.ptr == end ? ordered_json(number) : ordered_json();
    const auto values = parse_json(state->second, file.string() + ", state");
    summary["loss"] = values.is_object() ? number_or_null(values, "loss") : ordered_json();
    summary["best_validation_loss"] = values.is_object() ? number_or_null(values, "best") : ordered_json();
  } catch (const Error& error) {
    summary["problem"] = valid_text(error.what());
  }
  return summary;
}

ordered_json checkpoints_of(const std::filesystem::path& folder) {
  std::vector<std::filesystem::path> files;
  std::error_code none;
  for (const auto& item : std::filesystem::directory_iterator(folder / "checkpoints", none)) {
    const std::string name = item.path().filename().string();
    if (name == "best.safetensors" || name.rfind("step_", 0) == 0) files.push_back(item.path());
  }
  // This puts best before step_...
  std::sort(files.begin(), files.end());
  ordered_json summaries = ordered_json::array();
  for (const auto& file : files) summaries.push_back(checkpoint_summary(file, folder));
  return summaries;
}

// What usually follows a run of a kind that is finished; RUN stands for its folder.
const std::map<std::string, std::string>& following_commands() {
  static const std::map<std::string, std::string> commands{
      {"sample", "gld splat fit --run RUN --out runs/splats"},
      {"synth", "gld check-data RUN"},
      {"splat fit", "gld splat render --splats RUN --path orbit --out runs/orbit"},
      {"splat pairs", "gld train refiner --pairs RUN/pairs --model configs/splat --out runs/refiner"},
      {"train refiner", "gld splat eval --model RUN/model --synthetic 16 --out runs/splat_eval"},
      {"train sample-refiner", "gld eval --model RUN/model --synthetic 16 --refine --out runs/eval"},
      {"train backbone", "gld train decoder --model RUN/model --out runs/decoder"},
      {"train depth", "gld train blending --model RUN/model --out runs/blending"},
      {"train blending", "gld stats --model RUN/model --out runs/stats"},
      {"train decoder", "gld stats --model RUN/model --out runs/stats"},
      {"stats", "gld train level --model RUN/model --out runs/level"},
      {"train level", "gld train cascade --model RUN/model --out runs/cascade"},
      {"train cascade", "gld eval --model RUN/model --synthetic 16 --out runs/eval"}};
  return commands;
}

// An ablation goes on with the description that it keeps and the options that stood beside it, a line each in its
// configuration: how it began and what it printed is not asked again.
ordered_json ablation_command(const std::filesystem::path& folder) {
  std::error_code none;
  const auto description = folder / "ablation.yaml", configuration = folder / kRunConfiguration;
  if (!std::filesystem::is_regular_file(description, none) ||
      !std::filesystem::is_regular_file(configuration, none))
    return {};
  std::string command = "gld ablate --config " + shell_word(description.string());
  std::istringstream lines(read_file(configuration));
  for (std::string line; std::getline(lines, line);) {
    const size_t colon = line.find(": ");
    if (colon == std::string::npos || line[0] == '#') continue;
    const std::string key = line.substr(0, colon);
    if (key == "out" || key == "overwrite" || key == "plan" || key == "json") continue;
    if (line.compare(colon + 2, std::string::npos, "\"\"") == 0) continue;  // --set takes none
    command += " --set " + shell_word(line.replace(colon, 2, "="));
  }
  return command + " --out " + shell_word(folder.string());
}

ordered_json next_command(const std::string& kind, const std::string& state,
                          const std::filesystem::path& folder) {
  if (state == "running") return {};
  const std::string run = folder.string();
  if (state == "finished") {
    const auto found = following_commands().find(kind);
    if (found == following_commands().end()) return {};
    std::string command = found->second;
    // A head that was trained on a backbone with its decoder, whose depth can be mended next.
    std::error_code none;
    if (kind == "train backbone" &&
        std::filesystem::exists(folder / "model" / "rgb_decoder.safetensors", none))
      command = "gld train depth --model RUN/model --out runs/depth";
    // The word that RUN is a part of.
    const size_t at = command.find("RUN"), end = std::min(command.find(' ', at), command.size());
    return command.replace(at, end - at, shell_word(run + command.substr(at + 3, end - at - 3)));
  }
  if (kind == "ablate") return ablation_command(folder);
  return resume_command(folder);
}

// What a finished run says of its own pictures, in its report; null where it says nothing, or what cannot be read.
ordered_json verdict_of_run(const std::filesystem::path& folder) {
  const auto file = folder / "report.json";
  std::error_code none;
  if (!std::filesystem::is_regular_file(file, none)) return {};
  try {
    const auto report = parse_json(read_file(file), file.string());
    const auto verdict = report.find("verdict");
    if (verdict == report.end() || !verdict->is_object()) return {};
    const auto sentence = verdict->find("sentence");
    if (sentence == verdict->end() || !sentence->is_string()) return {};
    return valid_text(sentence->get<std::string>());
  } catch (const Error&) {
    return {};
  }
}

ordered_json inspect_run(const std::filesystem::path& folder, const std::string& kind) {
  const std::string state = state_of_run(folder);
  return {{"run", valid_text(folder.string())},
          {"kind", valid_text(kind)},
          {"state", state},
          {"verdict", state == "finished" ? verdict_of_run(folder) : ordered_json()},
          {"checkpoints", checkpoints_of(folder)},
          {"next", next_command(kind, state, folder)}};
}

// Names that come again, as those of other programs may, are one with all texts.
ordered_json texts_json(const TextItems& items) {
  ordered_json texts = ordered_json::object();
  for (const auto& [name, text] : items) {
    auto& value = texts[valid_text(name)];
    value = value.is_null() ? valid_text(text) : value.get<std::string>() + "\n" + valid_text(text);
  }
  return texts;
}

// The comments are "NAME TEXT", and "NAME+ TEXT" where a text goes on.
TextItems texts_of_comments(const std::vector<std::string>& comments) {
  TextItems items;
  for (const auto& comment : comments) {
    const size_t blank = std::min(comment.find(' '), comment.size());
    const std::string name = comment.substr(0, blank);
    const std::string text = blank < comment.size() ? comment.substr(blank + 1) : "";
    if (!name.empty() && name.back() == '+' && !items.empty()) {
      items.back().second += text;
    } else {
      items.emplace_back(name, text);
    }
  }
  return items;
}

ordered_json inspect_picture(ByteView bytes, const std::string& where) {
  const auto header =
      read_png_header(std::string_view(reinterpret_cast<const char*>(bytes.data), bytes.size), where);
  return {{"picture", valid_text(where)},
          {"width", header.width},
          {"height", header.height},
          {"texts", texts_json(header.texts)}};
}

ordered_json inspect_cloud(ByteView bytes, const std::string& where) {
  const auto vertices = parse_ply_vertices(bytes, where);
  ordered_json properties = ordered_json::array();
  for (const auto& name : vertices.properties) properties.push_back(valid_text(name));
  return {{"cloud", valid_text(where)},
          {"vertices", vertices.count},
          {"properties", std::move(properties)},
          {"texts", texts_json(texts_of_comments(vertices.comments))}};
}

uint32_t little_endian(const uint8_t* bytes) {
  return bytes[0] | uint32_t{bytes[1]} << 8 | uint32_t{bytes[2]} << 16 | uint32_t{bytes[3]} << 24;
}

size_t size_of_list(const nlohmann::json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && found->is_array() ? found->size() : 0;
}

// Inspects glTF 2.0, binary: it has 12 bytes of header, then chunks of length, type and bytes, the first of which is
// JSON.
ordered_json inspect_scene(ByteView bytes, const std::string& where) {
  constexpr size_t kBeforeJson = 20;
  constexpr uint32_t kJsonChunk = 0x4E4F534A;
  if (bytes.size < kBeforeJson || little_endian(bytes.data + 16) != kJsonChunk ||
      little_endian(bytes.data + 12) > bytes.size - kBeforeJson) {
    fail({where, "a GLB file whose first chunk is JSON", "one that ends early or has none",
          "export it again"});
  }
  const std::string text(reinterpret_cast<const char*>(bytes.data) + kBeforeJson,
                         little_endian(bytes.data + 12));
  const nlohmann::json scene = parse_json(text, where);
  TextItems items;
  const auto asset = scene.find("asset");
  if (asset != scene.end() && asset->is_object()) {
    if (const auto extras = asset->find("extras"); extras != asset->end() && extras->is_object()) {
      for (const auto& [name, value] : extras->items()) {
        items.emplace_back(name, value.is_string() ? value.get<std::string>() : json_text(value));
      }
    }
  }
  return {{"scene", valid_text(where)},
          {"meshes", size_of_list(scene, "meshes")},
          {"cameras", size_of_list(scene, "cameras")},
          {"pictures", size_of_list(scene, "images")},
          {"texts", texts_json(items)}};
}

bool begins_with(ByteView bytes, std::string_view beginning) {
  return std::string_view(reinterpret_cast<const char*>(bytes.data),
                          std::min(bytes.size, beginning.size())) == beginning;
}

std::string number_text(const ordered_json& value) {
  return value.is_number() ? fmt::format("{:.6g}", value.get<double>()) : "unknown";
}

std::string run_text(const ordered_json& inspection) {
  std::string text = fmt::format(
      "{}: a run of gld {}, {}\n", printable_text(inspection["run"].get<std::string>()),
      printable_text(inspection["kind"].get<std::string>()), inspection["state"].get<std::string>());
  if (inspection["verdict"].is_string())
    text += printable_text(inspection["verdict"].get<std::string>(), 400) + "\n";
  for (const auto& checkpoint : inspection["checkpoints"]) {
    text += "  " + printable_text(checkpoint["file"].get<std::string>()) + ": ";
    if (checkpoint.contains("problem")) {
      text += printable_text(checkpoint["problem"].get<std::string>()) + "\n";
      continue;
    }
    text += "step " + (checkpoint["step"].is_null() ? "unknown" : checkpoint["step"].dump());
    // Before the first step there is none.
    if (checkpoint["step"] != 0) text += ", loss " + number_text(checkpoint["loss"]);
    if (checkpoint["best_validation_loss"].is_number())
      text += ", least validation loss " + number_text(checkpoint["best_validation_loss"]);
    if (checkpoint["step"] == 0 && checkpoint["file"] == "checkpoints/best.safetensors" &&
        inspection["state"] == "finished")
      text += ": on held-out scenes no step was better than what it began with";
    text += "\n";
  }
  if (inspection["next"].is_string())
    text += "next: " + printable_text(inspection["next"].get<std::string>()) + "\n";
  return text;
}

std::string texts_text(const ordered_json& texts) {
  if (texts.empty()) return "  no provenance: another program wrote it, or changed it since\n";
  std::string text;
  for (const auto& [name, value] : texts.items())
    text += "  " + printable_text(name) + ": " + printable_text(value.get<std::string>()) + "\n";
  return text;
}

}  // namespace

std::optional<ordered_json> inspect_output(const std::filesystem::path& file_or_folder) {
  std::error_code none;
  if (std::filesystem::is_directory(file_or_folder, none)) {
    const std::string kind = command_of_run(file_or_folder);
    if (kind.empty() || std::filesystem::exists(file_or_folder / "model.yaml", none)) return std::nullopt;
    return inspect_run(file_or_folder, kind);
  }
  // What is neither is refused by whoever reads weights.
  if (!std::filesystem::is_regular_file(file_or_folder, none)) return std::nullopt;
  const auto file = MappedFile::open(file_or_folder);
  const ByteView bytes = file->bytes();
  if (begins_with(bytes, "\x89PNG\r\n\x1a\n")) return inspect_picture(bytes, file_or_folder.string());
  if (begins_with(bytes, "ply\n")) return inspect_cloud(bytes, file_or_folder.string());
  if (begins_with(bytes, "glTF")) return inspect_scene(bytes, file_or_folder.string());
  return std::nullopt;
}

std::string output_inspection_text(const ordered_json& inspection) {
  if (inspection.contains("run")) return run_text(inspection);
  if (inspection.contains("picture")) {
    return fmt::format("{}: a PNG picture of {}x{} pixels\n",
                       printable_text(inspection["picture"].get<std::string>()),
                       inspection["width"].get<int64_t>(), inspection["height"].get<int64_t>()) +
           texts_text(inspection["texts"]);
  }
  if (inspection.contains("scene")) {
    return fmt::format("{}: a GLB scene of {} meshes, {} cameras and {} pictures\n",
                       printable_text(inspection["scene"].get<std::string>()),
                       inspection["meshes"].get<size_t>(), inspection["cameras"].get<size_t>(),
                       inspection["pictures"].get<size_t>()) +
           texts_text(inspection["texts"]);
  }
  std::string properties;
  for (const auto& name : inspection["properties"])
    properties += (properties.empty() ? "" : " ") + printable_text(name.get<std::string>());
  return fmt::format("{}: a PLY file of {} vertices ({})\n",
                     printable_text(inspection["cloud"].get<std::string>()),
                     inspection["vertices"].get<int64_t>(), properties) +
         texts_text(inspection["texts"]);
}

}  // namespace gld
