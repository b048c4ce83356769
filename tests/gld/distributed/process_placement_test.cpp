#include "gld/distributed/process_placement.h"

#include "tests/support/error_of.h"

#include <map>

#include <gtest/gtest.h>

namespace gld {
namespace {

Environment environment(const std::map<std::string, std::string>& variables) {
  return [variables](const std::string& name) {
    const auto found = variables.find(name);
    return found == variables.end() ? std::nullopt : std::optional<std::string>(found->second);
  };
}

TEST(ProcessPlacement, IsOneProcessWithoutOptionsAndEnvironment) {
  const auto placement = process_placement({}, environment({}));
  EXPECT_EQ(placement.count, 1);
  EXPECT_EQ(placement.rank, 0);
}

TEST(ProcessPlacement, ReadsWhatTorchrunSets) {
  const auto placement = process_placement({}, environment({{"RANK", "5"},
                                                            {"WORLD_SIZE", "8"},
                                                            {"LOCAL_RANK", "1"},
                                                            {"MASTER_ADDR", "10.1.2.3"},
                                                            {"MASTER_PORT", "29500"},
                                                            {"TORCHELASTIC_USE_AGENT_STORE", "True"},
                                                            {"TORCHELASTIC_RESTART_COUNT", "2"}}));
  EXPECT_EQ(placement.count, 8);
  EXPECT_EQ(placement.rank, 5);
  EXPECT_EQ(placement.local_rank, 1);
  EXPECT_EQ(placement.master_address, "10.1.2.3");
  EXPECT_EQ(placement.master_port, 29500);
  EXPECT_TRUE(placement.store_is_hosted);
  EXPECT_EQ(placement.attempt, "2");
}

TEST(ProcessPlacement, TakesOptionsBeforeTheEnvironment) {
  ProcessesOptions options;
  options.count = 2;
  options.rank = 0;
  options.master_address = "here";
  options.master_port = 7;
  const auto placement = process_placement(
      options,
      environment({{"RANK", "5"}, {"WORLD_SIZE", "8"}, {"MASTER_ADDR", "there"}, {"MASTER_PORT", "8"}}));
  EXPECT_EQ(placement.count, 2);
  EXPECT_EQ(placement.rank, 0);
  EXPECT_EQ(placement.master_address, "here");
  EXPECT_EQ(placement.master_port, 7);
  EXPECT_FALSE(placement.store_is_hosted);
}

TEST(ProcessPlacement, SaysWhatIsMissingOrContradicts) {
  const auto error = [](const std::map<std::string, std::string>& variables) {
    return test::error_of([&] { process_placement({}, environment(variables)); });
  };
  EXPECT_EQ(
      error({{"WORLD_SIZE", "two"}}),
      "the environment's WORLD_SIZE: expected a number from 1 to 100000, found 'two'; correct or unset it; without "
      "these variables one process works alone.");
  EXPECT_EQ(
      error({{"WORLD_SIZE", "2"}, {"RANK", "2"}}),
      "--processes.rank: expected a rank from 0 to 1, for 2 processes, found 2; give every process the same count "
      "(WORLD_SIZE) and a rank of its own (RANK).");
  EXPECT_EQ(
      error({{"WORLD_SIZE", "2"}}),
      "--processes.rank: expected the rank of this process (or RANK in the environment), found neither; start the "
      "processes with torchrun --no_python, or give each all of --processes.rank, --processes.count, "
      "--processes.master-address and --processes.master-port.");
  EXPECT_EQ(
      error({{"WORLD_SIZE", "2"}, {"RANK", "1"}, {"MASTER_ADDR", "a"}, {"MASTER_PORT", "70000"}}),
      "the environment's MASTER_PORT: expected a number from 1 to 65535, found '70000'; correct or unset it; without "
      "these variables one process works alone.");
}

}  // namespace
}  // namespace gld
