#include "train/loop/checkpoint.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/tensors/weight_tensors.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"
#include "tests/train/loop/toy_objective.h"
#include "train/loop/training_loop.h"

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <torch/types.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::expect_same_bytes;
using test::short_run;
using test::tensors_of_newest;

TEST(Checkpoint, KeepsTheNewestCheckpoints) {
  const test::TemporaryFolder folder;
  test::ToyObjective objective;
  auto options = short_run();
  options.keep_last = 2;
  train(test::toy_run(folder.path(), objective), options, TrainingStart::kFresh);
  EXPECT_EQ(CheckpointFolder(folder.path() / "checkpoints", {}).steps(), (std::vector<int64_t>{20, 24}));
}

// A file that was damaged is passed over, and what is written after it is behind it.
TEST(Checkpoint, KeepsWhatItHasJustWrittenBesideALaterDamagedCheckpoint) {
  const test::TemporaryFolder folder;
  test::ToyObjective objective;
  auto options = short_run();
  options.keep_last = 3;
  train(test::toy_run(folder.path(), objective), options, TrainingStart::kFresh);
  const auto checkpoints = folder.path() / "checkpoints";
  write_file_atomically(checkpoints / "step_000000024.safetensors", "damaged");
  Checkpoint later = CheckpointFolder(checkpoints, {}).newest()->checkpoint;
  ASSERT_EQ(later.step, 20);
  later.step = 22;
  CheckpointFolderOptions one;
  one.keep_last = 1;
  const auto file = CheckpointFolder(checkpoints, one).save(later);
  EXPECT_EQ(load_checkpoint(file).step, 22);
  EXPECT_EQ(CheckpointFolder(checkpoints, {}).steps(), (std::vector<int64_t>{22, 24}));
}

TEST(Checkpoint, PassesOverATornCheckpoint) {
  const test::TemporaryFolder folder;
  test::ToyObjective objective;
  train(test::toy_run(folder.path(), objective), short_run(), TrainingStart::kFresh);
  const auto newest = folder.path() / "checkpoints" / "step_000000024.safetensors";
  std::filesystem::resize_file(newest, std::filesystem::file_size(newest) - 100);
  test::ToyObjective second;
  const auto summary = train(test::toy_run(folder.path(), second), short_run(), TrainingStart::kResume);
  EXPECT_EQ(summary.steps_this_call, 4);
  ASSERT_EQ(summary.messages.size(), 1U);
  EXPECT_EQ(summary.messages[0].rfind("passed over " + newest.string(), 0), 0U);
}

TEST(Checkpoint, DetectsBytesThatNeverReachedTheDisk) {
  const test::TemporaryFolder folder;
  Checkpoint checkpoint;
  checkpoint.step = 3;
  checkpoint.tensors["a"] = torch::arange(5000.0F);
  const auto file = folder.path() / "step.safetensors";
  save_checkpoint(file, checkpoint);
  EXPECT_EQ(load_checkpoint(file).step, 3);
  auto bytes = read_file(file);
  std::fill(bytes.end() - 4096, bytes.end(), '\0');
  write_file_atomically(file, bytes);
  EXPECT_EQ(test::error_of([&] { load_checkpoint(file); }),
            file.string() +
                ": expected contents that match the checksum, found changed or missing data; "
                "use an older checkpoint.");
  save_safetensors(file, checkpoint.tensors);
  EXPECT_EQ(test::error_of([&] { load_checkpoint(file); }),
            file.string() +
                ": expected a training checkpoint, found a weight file of another kind; "
                "name the checkpoints folder of a gld train run.");
}

// The checksum of format 1: over the tensors' bytes in the order of their names, in words of 8 bytes.
std::string first_checksum(const std::map<std::string, torch::Tensor>& tensors) {
  uint64_t hash = 0xCBF29CE484222325ULL;
  for (const auto& [name, tensor] : tensors) {
    const auto contiguous = tensor.contiguous();
    const auto* data = static_cast<const uint8_t*>(contiguous.data_ptr());
    size_t left = static_cast<size_t>(contiguous.numel()) * contiguous.element_size();
    while (left > 0) {
      uint64_t word = 0;
      const size_t take = std::min<size_t>(left, sizeof word);
      std::memcpy(&word, data, take);
      hash = (hash ^ word) * 0x9E3779B97F4A7C15ULL;
      hash ^= hash >> 29U;
      data += take;
      left -= take;
    }
  }
  char text[17];
  std::snprintf(text, sizeof text, "%016llx", static_cast<unsigned long long>(hash));
  return text;
}

// Writes the newest checkpoint of a run as the program of before wrote it.
void write_as_first_format(const std::filesystem::path& file, const Checkpoint& checkpoint) {
  save_safetensors(file, checkpoint.tensors,
                   {{"format", "gld training checkpoint 1"},
                    {"step", std::to_string(checkpoint.step)},
                    {"checksum", first_checksum(checkpoint.tensors)},
                    {"state", checkpoint.metadata.dump()}});
}

std::filesystem::path step_file(const std::filesystem::path& folder, int64_t step) {
  char name[40];
  std::snprintf(name, sizeof name, "step_%09lld.safetensors", static_cast<long long>(step));
  return folder / "checkpoints" / name;
}

TEST(Checkpoint, AnyChangedByteIsNoticed) {
  const test::TemporaryFolder folder;
  Checkpoint checkpoint;
  checkpoint.step = 3;
  checkpoint.metadata = {{"kind", "toy"}, {"batch_index", 7}, {"loss", 0.25}};
  checkpoint.tensors["a.weight"] = torch::arange(6.0F).reshape({2, 3});
  checkpoint.tensors["b"] = torch::ones({2}, torch::kInt64);
  const auto file = folder.path() / "step.safetensors";
  save_checkpoint(file, checkpoint);
  EXPECT_TRUE(load_checkpoint(file).header_is_checked);
  const std::string whole = read_file(file);
  for (size_t at = 0; at < whole.size(); ++at) {
    for (const int change : {1, 2, 32}) {
      std::string bytes = whole;
      bytes[at] = static_cast<char>(bytes[at] ^ change);
      // Blanks between header and data mean nothing, and one more or less of them is the same file.
      if (whole[at] == ' ' && (bytes[at] == '\t' || bytes[at] == '\n')) continue;
      write_file_atomically(file, bytes);
      EXPECT_THROW(load_checkpoint(file), Error) << "byte " << at << " " << whole[at];
    }
  }
}

TEST(Checkpoint, ANumberChangedByHandTakesTheCheckpointBefore) {
  for (const auto& [from, to] : {std::pair<std::string, std::string>{"batch_index", "batch_indey"},
                                 {"\\\"batch_index\\\":48", "\\\"batch_index\\\":46"},
                                 {"\"step\":\"24\"", "\"step\":\"23\""},
                                 {"random.cpu", "random.cpv"},
                                 {"\"F32\"", "\"I32\""}}) {
    const test::TemporaryFolder folder;
    test::ToyObjective objective;
    train(test::toy_run(folder.path(), objective), short_run(), TrainingStart::kFresh);
    const auto newest = step_file(folder.path(), 24);
    std::string bytes = read_file(newest);
    const size_t at = bytes.find(from);
    ASSERT_NE(at, std::string::npos) << from;
    write_file_atomically(newest, bytes.replace(at, from.size(), to));
    test::ToyObjective second;
    const auto summary = train(test::toy_run(folder.path(), second), short_run(), TrainingStart::kResume);
    EXPECT_EQ(summary.steps_this_call, 4) << from;
    ASSERT_EQ(summary.messages.size(), 1U) << from;
    EXPECT_EQ(summary.messages[0].rfind("passed over " + newest.string(), 0), 0U);
  }
}

TEST(Checkpoint, CheckpointsOfTheFirstFormatResumeAndTheirDamageIsPassedOver) {
  auto options = short_run();
  options.steps = 20;
  const test::TemporaryFolder folder;
  test::ToyObjective objective;
  train(test::toy_run(folder.path(), objective), options, TrainingStart::kFresh);
  const auto expected = tensors_of_newest(folder.path());
  const auto file = step_file(folder.path(), 15);
  const Checkpoint before = load_checkpoint(file);
  std::filesystem::remove(step_file(folder.path(), 20));
  write_as_first_format(file, before);
  {
    test::ToyObjective second;
    const auto summary = train(test::toy_run(folder.path(), second), options, TrainingStart::kResume);
    EXPECT_EQ(summary.steps_this_call, 5);
    EXPECT_TRUE(summary.messages.empty());
    expect_same_bytes(expected, tensors_of_newest(folder.path()));
  }
  // The header of such a file is under no checksum.
  std::vector<Checkpoint> damaged(5, before);
  damaged[0].metadata.erase("batch_index");
  damaged[1].metadata["skipped_steps"] = "none";
  damaged[2].tensors["random.cpv"] = damaged[2].tensors.at("random.cpu");
  damaged[2].tensors.erase("random.cpu");
  damaged[3].tensors.at("random.cpu") = damaged[3].tensors.at("random.cpu").view(torch::kInt8);
  damaged[4].metadata = nlohmann::json::array();
  for (const Checkpoint& checkpoint : damaged) {
    std::filesystem::remove(step_file(folder.path(), 20));
    write_as_first_format(file, checkpoint);
    test::ToyObjective second;
    const auto summary = train(test::toy_run(folder.path(), second), options, TrainingStart::kResume);
    EXPECT_EQ(summary.steps_this_call, 10);
    ASSERT_EQ(summary.messages.size(), 1U);
    EXPECT_EQ(summary.messages[0].rfind("passed over " + file.string(), 0), 0U);
    expect_same_bytes(expected, tensors_of_newest(folder.path()));
    std::filesystem::remove(step_file(folder.path(), 20));
  }
}

TEST(Checkpoint, OtherOptionsThanTheCheckpointsAreAnErrorNotDamage) {
  const test::TemporaryFolder folder;
  test::ToyObjective objective;
  train(test::toy_run(folder.path(), objective), short_run(), TrainingStart::kFresh);
  const auto newest = step_file(folder.path(), 24);
  Checkpoint other = load_checkpoint(newest);
  const std::string name = "ema." + other.tensors.begin()->first.substr(4);
  ASSERT_EQ(other.tensors.count(name), 1U);
  other.tensors.at(name) = torch::zeros({7, 7});
  save_checkpoint(newest, other);
  test::ToyObjective second;
  const std::string error = test::error_of(
      [&] { train(test::toy_run(folder.path(), second), short_run(), TrainingStart::kResume); });
  EXPECT_EQ(error.rfind(newest.string() + ": expected tensor '" + name + "' of shape ", 0), 0U) << error;
  EXPECT_NE(error.find("found shape [7, 7] in Float; resume with the options that wrote the checkpoint."),
            std::string::npos)
      << error;
}

}  // namespace
}  // namespace gld
