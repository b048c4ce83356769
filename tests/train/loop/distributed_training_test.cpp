#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/distributed/shared_work.h"
#include "gld/tensors/torch_version.h"
#include "tests/support/forked_processes.h"
#include "tests/support/temporary_folder.h"
#include "tests/train/loop/toy_objective.h"
#include "train/loop/checkpoint.h"
#include "train/loop/training_loop.h"

#include <cerrno>
#include <chrono>
#include <csignal>
#include <filesystem>
#include <functional>
#include <thread>

#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

// Real processes, forked before this one has started a thread.
namespace gld {
namespace {

using test::Child;
using test::free_port;
using test::placement;
using test::start;
using test::status_of;
using testing::HasSubstr;
using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point before) {
  return std::chrono::duration<double>(Clock::now() - before).count();
}

TrainingLoopOptions short_run() {
  TrainingLoopOptions options;
  options.steps = 12;
  options.micro_batches = 5;
  options.seed = 5;
  options.log_every = 4;
  options.checkpoint_every = 4;
  options.validate_every = 6;
  options.learning_rate.peak = 0.05;
  options.learning_rate.warmup_steps = 3;
  options.optimiser.ema_decay = 0.8;
  return options;
}

void train_toy(const std::filesystem::path& folder, const TrainingLoopOptions& options, TrainingStart start,
               ProcessTeam* team) {
  test::ToyObjective objective;
  TrainingRun run = test::toy_run(folder, objective);
  run.team = team;
  train(run, options, start);
}

// A run in that many processes, all of which must succeed.
void train_in(int64_t count, const std::filesystem::path& folder, TrainingStart begin = TrainingStart::kFresh,
              const TrainingLoopOptions& training = short_run()) {
  test::in_processes(count, folder, [&](const ProcessesOptions& options) {
    const ProcessShare share = join_others(options);
    train_toy(folder, training, begin, share.team.get());
  });
}

TrainingLoopOptions with_optimiser_in_pieces() {
  auto options = short_run();
  options.shard_optimiser = true;
  return options;
}

void expect_same_checkpoint(const std::filesystem::path& a, const std::filesystem::path& b) {
  const auto first = CheckpointFolder(a / "checkpoints", {}).newest();
  const auto second = CheckpointFolder(b / "checkpoints", {}).newest();
  ASSERT_TRUE(first && second);
  EXPECT_EQ(first->checkpoint.step, second->checkpoint.step);
  ASSERT_EQ(first->checkpoint.tensors.size(), second->checkpoint.tensors.size());
  for (const auto& [name, tensor] : first->checkpoint.tensors) {
    EXPECT_TRUE(torch::equal(tensor, second->checkpoint.tensors.at(name))) << name;
  }
  for (const char* name : {"batch_index", "loss", "best"}) {
    EXPECT_EQ(first->checkpoint.metadata.at(name), second->checkpoint.metadata.at(name)) << name;
  }
}

TEST(DistributedTraining, OneTwoAndFourProcessesGiveTheSameBits) {
  const test::TemporaryFolder one, two, four;
  train_in(1, one.path());
  train_in(2, two.path());
  train_in(4, four.path());
  expect_same_checkpoint(one.path(), two.path());
  expect_same_checkpoint(one.path(), four.path());
}

TEST(DistributedTraining, ARunGoesOnInAnotherNumberOfProcesses) {
  const test::TemporaryFolder one, others;
  train_in(1, one.path());
  train_in(4, others.path());
  const auto remove = [&](const char* name) {
    EXPECT_TRUE(std::filesystem::remove(others.path() / "checkpoints" / name));
  };
  remove("step_000000012.safetensors");
  remove("step_000000008.safetensors");
  train_in(2, others.path(), TrainingStart::kResume);
  expect_same_checkpoint(one.path(), others.path());
  remove("step_000000012.safetensors");
  train_in(1, others.path(), TrainingStart::kResume);
  expect_same_checkpoint(one.path(), others.path());
}

TEST(DistributedTraining, AnOptimiserInPiecesGivesTheSameBits) {
  const test::TemporaryFolder one, two, four;
  train_in(1, one.path());
  train_in(2, two.path(), TrainingStart::kFresh, with_optimiser_in_pieces());
  train_in(4, four.path(), TrainingStart::kFresh, with_optimiser_in_pieces());
  expect_same_checkpoint(one.path(), two.path());
  expect_same_checkpoint(one.path(), four.path());
  EXPECT_EQ(read_file(one.path() / "model" / "weight.txt"), read_file(four.path() / "model" / "weight.txt"));
  // Its checkpoints are whole: another number of processes goes on from them, with a whole optimiser or in pieces.
  const auto back_to_step_4 = [&] {
    for (const char* name : {"step_000000012.safetensors", "step_000000008.safetensors"}) {
      EXPECT_TRUE(std::filesystem::remove(four.path() / "checkpoints" / name));
    }
  };
  back_to_step_4();
  train_in(2, four.path(), TrainingStart::kResume);
  expect_same_checkpoint(one.path(), four.path());
  back_to_step_4();
  train_in(3, four.path(), TrainingStart::kResume, with_optimiser_in_pieces());
  expect_same_checkpoint(one.path(), four.path());
}

// Starts two processes that work together, each in the folder with a team.
std::vector<Child> start_two(const std::filesystem::path& folder,
                             const std::function<void(ProcessTeam&)>& work) {
  const int64_t port = free_port();
  std::vector<Child> children;
  for (int64_t rank = 0; rank < 2; ++rank) {
    children.push_back(start(folder, "rank" + std::to_string(rank), [&] {
      const auto team = join_processes(placement(rank, 2, port));
      work(*team);
    }));
  }
  return children;
}

// Returns what two processes say together that cannot train with these options; whoever says it first ends the other.
std::string said_by_two_that_refuse(const TrainingLoopOptions& options) {
  const test::TemporaryFolder folder;
  const auto children = start_two(folder.path(), [&](ProcessTeam& team) {
    train_toy(folder.path(), options, TrainingStart::kFresh, &team);
  });
  std::string said;
  for (const Child& child : children) {
    EXPECT_EQ(status_of(child), 1);
    said += read_file(child.said);
  }
  return said;
}

// A process of a team that writes to one that is gone is told so, and is not ended by the signal of it.
TEST(DistributedTraining, AWriteToAProcessThatIsGoneSaysSo) {
  const test::TemporaryFolder folder;
  const auto children = start_two(folder.path(), [](ProcessTeam&) {
    int ends[2];
    if (::socketpair(AF_UNIX, SOCK_STREAM, 0, ends) != 0) fail({"a test", "two sockets", "none", "look"});
    ::close(ends[0]);
    const ssize_t written = ::write(ends[1], "x", 1);
    if (written != -1 || errno != EPIPE)
      fail({"a write to nobody", "EPIPE", std::to_string(written), "look"});
  });
  for (const Child& child : children) EXPECT_EQ(status_of(child), 0) << read_file(child.said);
}

TEST(DistributedTraining, MuonsMatricesAreNotCutIntoPieces) {
  auto options = with_optimiser_in_pieces();
  options.optimiser.algorithm = OptimiserAlgorithm::kMuon;
  const std::string said = said_by_two_that_refuse(options);
  EXPECT_THAT(
      said, HasSubstr("loop.shard_optimiser: expected adamw or adam, which move each number by itself, found "
                      "muon, which moves whole matrices; choose one of them, or leave the optimiser whole."));
}

// This starts a run without end of three processes, one of which is killed after the first checkpoint, and returns what
// the others then say.
std::vector<std::string> said_after_killing(int64_t victim, const std::filesystem::path& folder) {
  const int64_t port = free_port();
  auto options = short_run();
  options.steps = 1000000;
  std::vector<Child> children;
  for (int64_t rank = 0; rank < 3; ++rank) {
    children.push_back(start(folder, "rank" + std::to_string(rank), [&] {
      const auto team = join_processes(placement(rank, 3, port));
      train_toy(folder, options, TrainingStart::kFresh, team.get());
    }));
  }
  const auto begun = Clock::now();
  while (!std::filesystem::exists(folder / "checkpoints" / "step_000000004.safetensors") &&
         seconds_since(begun) < 60) {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  EXPECT_EQ(::kill(children[static_cast<size_t>(victim)].process, SIGKILL), 0);
  const auto killed = Clock::now();
  std::vector<std::string> said;
  for (const Child& child : children) {
    const int status = status_of(child, 30);
    if (&child == &children[static_cast<size_t>(victim)]) continue;
    EXPECT_EQ(status, 1);
    // Progress of rank 0 stands before it.
    const std::string text = read_file(child.said);
    said.push_back(text.substr(text.find("error: ")));
  }
  EXPECT_LT(seconds_since(killed), 10);
  return said;
}

TEST(DistributedTraining, AKilledProcessEndsTheOthersInOneSentence) {
  const test::TemporaryFolder folder;
  const auto said = said_after_killing(1, folder.path());
  EXPECT_EQ(
      said.at(0),
      "error: rank 0: expected all 3 processes to go on, found no sign of life of rank 1; see what it said at last, and "
      "continue with --resume.\n");
  EXPECT_EQ(
      said.at(1),
      "error: rank 2: expected all 3 processes to go on, found no sign of life of rank 1; see what it said at last, and "
      "continue with --resume.\n");
}

TEST(DistributedTraining, TheLossOfRankZeroIsSaidToo) {
  const test::TemporaryFolder folder;
  for (const std::string& line : said_after_killing(0, folder.path())) {
    EXPECT_THAT(line,
                HasSubstr(", of rank 0, any more; see what it said at last, and continue with --resume.\n"));
  }
}

// Returns what processes of these placements say, and checks that they end with status 1 within 10 s.
std::vector<std::string> said_when_joining(const std::vector<ProcessPlacement>& placements) {
  const test::TemporaryFolder folder;
  std::vector<Child> children;
  children.reserve(placements.size());
  for (const ProcessPlacement& each : placements) {
    children.push_back(
        start(folder.path(), "process" + std::to_string(children.size()), [&] { join_processes(each); }));
  }
  const auto begun = Clock::now();
  std::vector<std::string> said;
  for (const Child& child : children) {
    EXPECT_EQ(status_of(child, 30), 1);
    said.push_back(read_file(child.said));
  }
  EXPECT_LT(seconds_since(begun), 10);
  return said;
}

TEST(DistributedTraining, ProcessesThatDisagreeAboutTheirNumberSaySo) {
  const int64_t port = free_port();
  const auto said = said_when_joining({placement(0, 2, port), placement(1, 3, port)});
  EXPECT_THAT(said.at(0) + said.at(1), HasSubstr("expected the same number of processes everywhere, found "));
  EXPECT_THAT(said.at(0) + said.at(1), HasSubstr("; give every process the same count (WORLD_SIZE)."));
}

TEST(DistributedTraining, AProcessThatDoesNotComeIsNamed) {
  auto alone = placement(0, 3, free_port());
  alone.join_seconds = 2;
  EXPECT_THAT(
      said_when_joining({alone}).at(0),
      HasSubstr("found none of rank 1, 2; start those too, or correct --processes.count (WORLD_SIZE)."));
}

TEST(DistributedTraining, ARankThatIsThereTwiceIsNamed) {
  const int64_t port = free_port();
  const auto said = said_when_joining({placement(0, 3, port), placement(1, 3, port), placement(1, 3, port)});
  EXPECT_THAT(said.at(1) + said.at(2),
              HasSubstr("expected a rank of its own for every process, found rank 1 twice"));
}

TEST(DistributedTraining, APortThatIsTakenIsSaid) {
  const int number = ::socket(AF_INET6, SOCK_STREAM, 0);
  sockaddr_in6 address = {};
  address.sin6_family = AF_INET6;
  socklen_t size = sizeof(address);
  ASSERT_EQ(::bind(number, reinterpret_cast<sockaddr*>(&address), size), 0);
  ASSERT_EQ(::listen(number, 1), 0);
  ASSERT_EQ(::getsockname(number, reinterpret_cast<sockaddr*>(&address), &size), 0);
  const auto said = said_when_joining({placement(0, 2, ntohs(address.sin6_port))});
  ::close(number);
  EXPECT_THAT(said.at(0), HasSubstr("expected a free port for the store of rank 0, found "));
  EXPECT_THAT(
      said.at(0),
      HasSubstr("; choose another with --processes.master-port (MASTER_PORT), the same for every process."));
}

TEST(DistributedTraining, AMasterThatIsNotThereIsSaid) {
  auto lonely = placement(1, 2, free_port());
  lonely.join_seconds = 2;
  EXPECT_THAT(
      said_when_joining({lonely}).at(0),
      HasSubstr("expected the store of rank 0 within 2 s, of LibTorch " + torch_version() + ", found "));
}

// At the address is something that is no store: it takes a connection and says nothing, or bytes of another protocol,
// which LibTorch takes for a size that no memory holds.
TEST(DistributedTraining, AnotherProgramAtTheAddressIsSaid) {
  for (const size_t bytes : {size_t{0}, size_t{4096}}) {
    const test::TemporaryFolder folder;
    const int number = ::socket(AF_INET6, SOCK_STREAM, 0);
    sockaddr_in6 address = {};
    address.sin6_family = AF_INET6;
    socklen_t size = sizeof(address);
    ASSERT_EQ(::bind(number, reinterpret_cast<sockaddr*>(&address), size), 0);
    ASSERT_EQ(::listen(number, 8), 0);
    ASSERT_EQ(::getsockname(number, reinterpret_cast<sockaddr*>(&address), &size), 0);
    const Child server = start(folder.path(), "server", [&] {
      for (;;) {
        const int peer = ::accept(number, nullptr, nullptr);
        const std::string text(bytes, '\xFF');
        if (peer >= 0 && !text.empty() && ::send(peer, text.data(), text.size(), MSG_NOSIGNAL) < 0)
          ::close(peer);
      }
    });
    auto joining = placement(1, 2, ntohs(address.sin6_port));
    joining.join_seconds = 2;
    EXPECT_THAT(said_when_joining({joining}).at(0),
                HasSubstr("of LibTorch " + torch_version() +
                          ", found something else that listens there; correct "
                          "--processes.master-address and --processes.master-port."))
        << bytes;
    ::kill(server.process, SIGKILL);
    status_of(server);
    ::close(number);
  }
}

TEST(DistributedTraining, EachProcessNeedsAMicroBatch) {
  auto options = short_run();
  options.micro_batches = 1;
  const std::string said = said_by_two_that_refuse(options);
  EXPECT_THAT(said, HasSubstr("loop.micro_batches: expected at least one for each of 2 processes, found 1; "
                              "raise it, or start fewer processes."));
}

}  // namespace
}  // namespace gld
