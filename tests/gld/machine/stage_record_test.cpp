#include "gld/machine/stage_record.h"

#include <chrono>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

TEST(StageRecords, AreKeptInOrderAlsoOfWhatThrows) {
  StageRecords stages;
  std::vector<std::string> begun;
  stages.on_start([&](const std::string& name) { begun.push_back(name); });
  stages.run("first", [] { std::this_thread::sleep_for(std::chrono::milliseconds(20)); });
  EXPECT_THROW(stages.run("second", [] { throw std::runtime_error("no"); }), std::runtime_error);
  EXPECT_THAT(begun, testing::ElementsAre("first", "second"));
  ASSERT_EQ(stages.records().size(), 2U);
  EXPECT_GE(stages.records()[0].seconds, 0.02);
  EXPECT_FALSE(stages.to_json()[0].contains("device_bytes")) << "without a device";
}

// Work that was only queued belongs to the stage that queued it.
TEST(StageRecords, WaitForADeviceWithinTheStage) {
  StageRecords stages;
  int64_t queued = 0, most = 7;
  stages.set_device({[&] { most = 0; },
                     [&] {
                       std::this_thread::sleep_for(std::chrono::milliseconds(20 * queued));
                       return most += 1000 * std::exchange(queued, 0);
                     }});
  stages.run("queues", [&] { queued = 1; });
  stages.run("queues nothing", [] {});
  EXPECT_GE(stages.records()[0].seconds, 0.02);
  EXPECT_EQ(stages.to_json()[0].at("device_bytes"), 1000);
  EXPECT_FALSE(stages.to_json()[1].contains("device_bytes"));
}

}  // namespace
}  // namespace gld
