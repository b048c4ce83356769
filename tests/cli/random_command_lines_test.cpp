// Whatever is asked for, valid or not, stopped or killed at any moment: the program ends with 0, 1 or 2 (130 where it
// was stopped), says at most one error, in one sentence of the agreed form, and changes nothing but the folder of
// --out.
//
// Each case is drawn from the registry of commands and options, and runs as a process of its own on a small scene with
// the small model. The default run is for CI; any number can be run by hand, each repeat with the next seed:
//
//   build/release/tests/cli_random_torch_tests --gtest_shuffle --gtest_random_seed=1 --gtest_repeat=100
#include "cli/commands.h"
#include "datasets/synthetic/synth.h"
#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/base/dashed_name.h"
#include "tests/cli/runnable_commands.h"
#include "tests/support/data_folders.h"
#include "tests/support/temporary_folder.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <ctime>
#include <filesystem>
#include <map>
#include <random>
#include <set>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

namespace gld {
namespace {

using Words = std::vector<std::string>;
using Clock = std::chrono::steady_clock;

constexpr int kCases = 400;
// A case that is asked to stop must have stopped within so much of its own processor time, and of time: a machine that
// has other things to do gives it little.
constexpr double kStoppingSeconds = 20;
constexpr std::chrono::seconds kStopping(900);
constexpr int64_t kMostBytes = int64_t{1}
                               << 31;  // of LibTorch, the models and a request that was not refused

// What a command needs to have something to do.
std::map<std::string, Words> usual_words(const std::filesystem::path& folder) {
  const std::string model = (folder / "model").string(), scene = (folder / "scene").string();
  const Words view = {"--model",   model, "--scene", scene,     "--sources",     "0,1",
                      "--targets", "2",   "--size",  "112x112", "--evaluations", "2"};
  const Words training = {"--model", model, "--steps", "1", "--validation-scenes", "0"};
  const std::string statistics = (test::test_data() / "stats/da3/normalization_stats_level0.pt").string();
  return {{"sample", view},
          {"plan", view},
          {"eval", {"--model", model, "--synthetic", "1", "--evaluations", "2"}},
          {"stats", {"--model", model, "--data.synthetic.scene-count", "1", "--scene-count", "1"}},
          {"train backbone", training},
          {"train decoder", training},
          {"train depth", training},
          {"train blending", training},
          {"train level", training},
          {"train cascade", training},
          {"synth", {"--scene-count", "1", "--frames", "2"}},
          {"check-data", {scene}},
          {"inspect", {model}},
          {"convert", {"--statistics-level0", statistics}}};
}

class Sandbox {
 public:
  Sandbox() : folder_(temporary_.path()) {
    SynthOptions scene;
    scene.scene.scene_count = 1;
    scene.scene.frames = 4;
    scene.scene.width = scene.scene.height = 112;
    scene.threads = 1;
    scene.out = (temporary_.path() / "drawn").string();
    testing::internal::CaptureStdout();
    testing::internal::CaptureStderr();
    run_synth(scene);
    testing::internal::GetCapturedStdout();
    testing::internal::GetCapturedStderr();
    for (const auto& drawn : std::filesystem::directory_iterator(temporary_.path() / "drawn" / "scenes")) {
      std::filesystem::rename(drawn.path(), folder_ / "scene");
    }
    std::filesystem::remove_all(temporary_.path() / "drawn");
    std::filesystem::copy(test::source_root() / "configs/tiny", folder_ / "model",
                          std::filesystem::copy_options::recursive);
    write_file_atomically(folder_ / "text.txt", "no file of any format\n");
    ::mkfifo((folder_ / "pipe").c_str(), 0600);
  }

  const std::filesystem::path& folder() const { return folder_; }
  std::filesystem::path out() const { return folder_ / "out"; }
  std::filesystem::path said() const { return folder_ / "said.txt"; }
  std::filesystem::path cache() const { return folder_ / "cache"; }

  // Returns names, sizes and times of all that a command must leave as it is.
  std::vector<std::string> state() const {
    std::vector<std::string> lines;
    for (auto item = std::filesystem::recursive_directory_iterator(folder_);
         item != std::filesystem::recursive_directory_iterator(); ++item) {
      if (item->path() == out() || item->path() == cache() || item->path() == said()) {
        item.disable_recursion_pending();
        continue;
      }
      struct stat status {};
      ::lstat(item->path().c_str(), &status);
      // Of a folder the names in it say enough: a refused command may have looked whether it can write there.
      const bool is_folder = S_ISDIR(status.st_mode);
      lines.push_back(item->path().string() + " " +
                      (is_folder
                           ? ""
                           : std::to_string(status.st_size) + " " + std::to_string(status.st_mtim.tv_sec) +
                                 "." + std::to_string(status.st_mtim.tv_nsec)));
    }
    std::sort(lines.begin(), lines.end());
    return lines;
  }

 private:
  test::TemporaryFolder temporary_;
  std::filesystem::path folder_;
};

// This draws one command line, always the same for its seed.
class Draw {
 public:
  Draw(uint64_t seed, const Sandbox& sandbox, const std::vector<Command>& commands)
      : random_(seed), sandbox_(sandbox), usual_(usual_words(sandbox.folder())), commands_(commands) {}

  Words words() {
    const Command& command = commands_[below(commands_.size())];
    Words words;
    for (size_t begin = 0; begin != std::string::npos;) {
      const size_t space = command.name.find(' ', begin);
      words.push_back(command.name.substr(begin, space - begin));
      begin = space == std::string::npos ? space : space + 1;
    }
    const auto usual = usual_.find(command.name);
    if (usual != usual_.end() && !chance(0.1)) {
      words.insert(words.end(), usual->second.begin(), usual->second.end());
    }
    if (!command.options) return words;
    const auto options = describe_options(*command.options);
    if (options.empty()) return words;
    const auto has = [&](const char* key) {
      return std::any_of(options.begin(), options.end(),
                         [&](const auto& option) { return option.key == key; });
    };
    if (has("out") && command.name != "plan" && !chance(0.05)) {
      words.insert(words.end(), {"--out", sandbox_.out().string()});
    }
    if (has("threads")) words.insert(words.end(), {"--threads", "1"});
    for (size_t more = below(4); more > 0; --more) add(options[below(options.size())], words);
    return words;
  }

  // Returns what ends a case that goes on for too long: most are killed, as where memory runs out, which costs no time;
  // the others are asked to stop, and must.
  int ending() { return chance(0.125) ? SIGINT : SIGKILL; }

  // So long a case may go on: some end soon, at any moment, some when small commands have ended by themselves.
  std::chrono::milliseconds patience() {
    return std::chrono::milliseconds(chance(0.15) ? 400 : 10 + below(190));
  }

 private:
  size_t below(size_t count) { return static_cast<size_t>(random_() % count); }
  bool chance(double share) { return static_cast<double>(random_() >> 11) * 0x1p-53 < share; }
  const std::string& one_of(const Words& words) { return words[below(words.size())]; }

  void add(const OptionDescription& option, Words& words) {
    // Where it writes is given; several threads are of no interest, and a table belongs into the model's folder.
    static const std::set<std::string> left_out{"out", "threads", "write_table", "jobs"};
    if (left_out.count(option.key) > 0) return;
    const std::string flag = "--" + dashed_name(option.key);
    if (option.type == "true|false") {
      words.push_back(chance(0.1) ? flag + "=" + one_of({"maybe", "true", "false", "1"}) : flag);
      return;
    }
    words.insert(words.end(), {flag, value(option)});
  }

  std::string value(const OptionDescription& option) {
    static const Words anything{"",
                                "x",
                                "-1",
                                "0",
                                "1",
                                "2",
                                "3.5",
                                "1e-30",
                                "1e300",
                                "nan",
                                "inf",
                                "-inf",
                                "99999999999999999999",
                                "1,2",
                                ",",
                                "[1, 2]",
                                "'",
                                "\"",
                                "{",
                                "\xFF\xFE",
                                "\x1b[2J",
                                std::string(70'000, 'a')};
    if (chance(0.25)) return one_of(anything);
    if (option.type == "integer" || option.type == "list of integer")
      return one_of({"0", "1", "2", "3", "4", "7", "16"});
    if (option.type == "real" || option.type == "list of real") {
      return one_of({"0", "0.1", "0.5", "1", "2", "1e-6", "0.25,0.75"});
    }
    if (option.type == "text" || option.type == "list of text") {
      const auto in = [&](const char* name) { return (sandbox_.folder() / name).string(); };
      return one_of({in("scene"), in("model"), in("text.txt"), in("pipe"), in(""), "/nope/nowhere", "112x112",
                     "56x56", "14x1400", "13x13", "image", "depth,points", "float32", "bfloat16", "cpu",
                     "cuda:7", "name"});
    }
    Words names;
    for (size_t begin = 0; begin != std::string::npos;) {
      const size_t bar = option.type.find('|', begin);
      names.push_back(option.type.substr(begin, bar - begin));
      begin = bar == std::string::npos ? bar : bar + 1;
    }
    return one_of(names);
  }

  std::mt19937_64 random_;
  const Sandbox& sandbox_;
  std::map<std::string, Words> usual_;
  const std::vector<Command>& commands_;
};

struct Ended {
  int status = 0;  // -signal where one ended it
  int asked = 0;   // the signal that was sent after the patience, 0 for none
  int64_t peak_bytes = 0;
  std::string said;
};

double processor_seconds(pid_t process) {
  clockid_t clock{};
  timespec time{};
  if (::clock_getcpuclockid(process, &clock) != 0 || ::clock_gettime(clock, &time) != 0) return 0;
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

Ended run(const Words& words, std::chrono::milliseconds patience, int ending, const Sandbox& sandbox) {
  // Patience begins when the child has: on a busy machine a signal would come before it takes any.
  std::array<int, 2> begun_pipe{};
  if (::pipe2(begun_pipe.data(), O_CLOEXEC) != 0) throw std::runtime_error("no pipe");
  const pid_t child = ::fork();
  if (child == 0) {
    const int said = ::open(sandbox.said().c_str(), O_CREAT | O_TRUNC | O_WRONLY, 0600);
    const int nothing = ::open("/dev/null", O_RDWR);
    ::dup2(nothing, STDIN_FILENO);
    ::dup2(nothing, STDOUT_FILENO);
    ::dup2(said, STDERR_FILENO);
    ::setenv("XDG_CACHE_HOME", sandbox.cache().c_str(), 1);
    // What a shell starts in the background ignores it.
    ::signal(SIGINT, SIG_DFL);
    if (::chdir(sandbox.folder().c_str()) != 0 || ::write(begun_pipe[1], "!", 1) != 1) ::_exit(99);
    ::close(begun_pipe[0]);
    ::close(begun_pipe[1]);
    ::_exit(run_command_line(all_commands(), words));
  }
  ::close(begun_pipe[1]);
  char sign = 0;
  if (::read(begun_pipe[0], &sign, 1) != 1) throw std::runtime_error("a child that did not begin");
  ::close(begun_pipe[0]);
  Ended ended;
  const auto begun = Clock::now();
  int status = 0;
  rusage usage{};
  double used_before = 0;
  while (::wait4(child, &status, WNOHANG, &usage) == 0) {
    const auto now = Clock::now() - begun;
    if (ended.asked == 0 && now > patience) {
      ended.asked = ending;
      used_before = processor_seconds(child);
      ::kill(child, ending);
    }
    if (ended.asked == SIGINT &&
        (processor_seconds(child) - used_before > kStoppingSeconds || now > patience + kStopping)) {
      ::kill(child, SIGKILL);
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  ended.status = WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
  ended.peak_bytes = int64_t{usage.ru_maxrss} * 1024;
  ended.said = read_file(sandbox.said());
  return ended;
}

// Returns what is wrong with how a case ended; empty for nothing.
std::string problem_of(const Ended& ended) {
  const bool usual = ended.status >= 0 && ended.status <= 2;
  // Before the handler is there, a stop ends the process by the signal.
  const bool stopped = ended.asked == SIGINT && (ended.status == 130 || ended.status == -SIGINT);
  const bool killed = ended.asked == SIGKILL && ended.status == -SIGKILL;
  if (!usual && !stopped && !killed) return "status " + std::to_string(ended.status);
  if (ended.peak_bytes > kMostBytes) return std::to_string(ended.peak_bytes) + " bytes";
  std::vector<std::string> errors;
  size_t begin = 0;
  for (size_t end = ended.said.find('\n'); end != std::string::npos;
       begin = end + 1, end = ended.said.find('\n', begin)) {
    const std::string line = ended.said.substr(begin, end - begin);
    if (line.rfind("error: ", 0) == 0) errors.push_back(line);
  }
  if (errors.size() > 1) return "several errors";
  if (usual && ended.status == 2 && errors.empty()) return "no error";
  for (const std::string& error : errors) {
    if (error.back() != '.' && error.back() != '?') return "an error without an end";
    if (error.size() > 1500) return "an error of " + std::to_string(error.size()) + " characters";
    for (const char* raw : {"LibTorch refused", "json.exception", "yaml-cpp", "stoll", "stod",
                            "std::", "basic_string", "memory ran out", "Exception"}) {
      if (error.find(raw) != std::string::npos) return std::string("raw words: ") + raw;
    }
  }
  return "";
}

std::string shown(const Words& words) {
  std::string text;
  for (const auto& word : words) text += " '" + (word.size() > 200 ? word.substr(0, 20) + "..." : word) + "'";
  return text;
}

TEST(RandomCommandLines, EndInOneSentence) {
  const Sandbox sandbox;
  const std::vector<Command> commands = test::runnable_commands();
  const auto before = sandbox.state();
  const auto seed = static_cast<uint64_t>(testing::UnitTest::GetInstance()->random_seed());
  std::map<int, int> by_status;
  for (uint64_t number = 0; number < kCases; ++number) {
    Draw draw(1'000'000 * seed + number, sandbox, commands);
    const Words words = draw.words();
    const auto patience = draw.patience();
    const Ended ended = run(words, patience, draw.ending(), sandbox);
    ++by_status[ended.status];
    EXPECT_EQ(problem_of(ended), "") << "seed " << seed << ", case " << number << ": gld" << shown(words)
                                     << "\n"
                                     << ended.said.substr(0, 2000);
    EXPECT_EQ(sandbox.state(), before) << "seed " << seed << ", case " << number << ": gld" << shown(words);
    if (number % 3 != 0)
      std::filesystem::remove_all(sandbox.out());  // the others find what the one before left
  }
  // Cases that are all refused would show nothing of what runs.
  EXPECT_GT(by_status[0] + by_status[130] + by_status[-SIGINT] + by_status[-SIGKILL], kCases / 10);
  EXPECT_GT(by_status[2], kCases / 10);
}

}  // namespace
}  // namespace gld
