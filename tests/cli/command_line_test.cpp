#include "cli/command.h"
#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "tests/support/temporary_folder.h"

#include <filesystem>
#include <iostream>
#include <stdexcept>
#include <streambuf>
#include <system_error>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

struct GuidanceLikeOptions : OptionsGroup {
  double scale = 1.5;
  void visit(FieldVisitor& visitor) override { visitor.real({"scale", "guidance scale"}, scale, {0, 100}); }
};

struct PaintOptions : OptionsGroup {
  int64_t frame_count = 4;
  bool json = false;
  std::vector<int64_t> sources;
  double offset = 0;
  GuidanceLikeOptions guidance;
  void visit(FieldVisitor& visitor) override {
    visitor.integer({"frame_count", "how many frames"}, frame_count, {1, 100});
    visitor.boolean({"json", "write JSON"}, json);
    visitor.integers({"sources", "source views"}, sources, {0, 1000});
    visitor.real({"offset", "an offset"}, offset);
    visitor.group({"guidance", "guidance"}, guidance);
  }
};

class CommandLine : public testing::Test {
 protected:
  CommandLine() : options_(std::make_shared<PaintOptions>()) {
    command_.name = "paint";
    command_.summary = "Paint something";
    command_.arguments = {"FILE", 1, 2};
    command_.options = options_;
    command_.run = [this](const std::vector<std::string>& arguments) {
      arguments_ = arguments;
      if (failure_) failure_();
      return 0;
    };
  }

  int run(const std::vector<std::string>& arguments) {
    testing::internal::CaptureStderr();
    testing::internal::CaptureStdout();
    const int status = run_command_line({command_}, arguments);
    error_text_ = testing::internal::GetCapturedStderr();
    output_text_ = testing::internal::GetCapturedStdout();
    return status;
  }

  std::shared_ptr<PaintOptions> options_;
  Command command_;
  std::vector<std::string> arguments_;
  std::function<void()> failure_;
  std::string error_text_;
  std::string output_text_;
};

// As of a shell's variable that is not set: the default may be something else altogether, drawn rooms for scenes.
TEST_F(CommandLine, RefusesAnEmptyValue) {
  for (const char* flag : {"--sources", "--frame-count"}) {
    EXPECT_EQ(run({"paint", "a.png", flag, ""}), 2);
    EXPECT_EQ(error_text_,
              std::string("error: ") + flag +
                  ": expected a value, found an empty text; leave it out for the default, or write --set "
                  "KEY=\"\" or KEY=[].\n");
  }
  EXPECT_EQ(run({"paint", "a.png", "--sources="}), 2);
  EXPECT_EQ(run({"paint", "a.png", "--set", "sources="}), 2);
  EXPECT_EQ(run({"paint", "a.png", "--set", "sources=[]"}), 0);
}

TEST_F(CommandLine, FlagsSettingsAndArguments) {
  EXPECT_EQ(run({"paint", "a.png", "--frame-count", "7", "--sources", "0,3", "--json", "--offset", "-0.5",
                 "--scale=2", "b.png"}),
            0);
  EXPECT_EQ(error_text_, "");
  EXPECT_THAT(arguments_, testing::ElementsAre("a.png", "b.png"));
  EXPECT_EQ(options_->frame_count, 7);
  EXPECT_THAT(options_->sources, testing::ElementsAre(0, 3));
  EXPECT_TRUE(options_->json);
  EXPECT_EQ(options_->offset, -0.5);
  EXPECT_EQ(options_->guidance.scale, 2);
}

TEST_F(CommandLine, LaterSourcesWin) {
  test::TemporaryFolder folder;
  const auto file = folder.path() / "c.yaml";
  write_file_atomically(file, "frame_count: 5\noffset: 3\nguidance:\n  scale: 4\njson: true\n");
  EXPECT_EQ(run({"paint", "x", "--set", "offset=2", "--set", "guidance.scale=3", "--config", file.string(),
                 "--guidance.scale", "1", "--no-json"}),
            0);
  EXPECT_EQ(options_->frame_count, 5);
  EXPECT_EQ(options_->offset, 2);
  EXPECT_EQ(options_->guidance.scale, 1);
  EXPECT_FALSE(options_->json);
}

TEST_F(CommandLine, WrongUsageGetsOneSentence) {
  EXPECT_EQ(run({"paint", "x", "--frame-cuont", "7"}), 2);
  EXPECT_EQ(error_text_,
            "error: gld paint: expected a known flag, found '--frame-cuont'; did you mean --frame-count?\n");
  EXPECT_EQ(run({"pait"}), 2);
  EXPECT_EQ(error_text_, "error: gld: expected a command, found 'pait'; did you mean 'paint'?\n");
  EXPECT_EQ(run({"paint"}), 2);
  EXPECT_EQ(error_text_,
            "error: gld paint: expected at least 1 argument(s): FILE, found 0; see gld paint --help.\n");
  EXPECT_EQ(run({"paint", "x", "--frame-count", "0"}), 2);
  EXPECT_EQ(error_text_,
            "error: --frame-count: expected an integer in the range [1, 100], found 0; "
            "choose a value inside the range.\n");
  EXPECT_EQ(run({"paint", "x", "--set", "frame_count"}), 2);
  EXPECT_EQ(error_text_,
            "error: --set: expected key=value, found 'frame_count'; "
            "write for example --set solver.evaluations=16.\n");
}

// What lacks more letters than it has is near to nothing, but begins a name.
TEST_F(CommandLine, ABeginningSuggestsTheNameThatItBegins) {
  for (const auto& [typed, meant] : {std::pair{"--fra", "--frame-count"},
                                     {"--frame", "--frame-count"},
                                     {"--js=1", "--json"},
                                     {"--guid", "--guidance.scale"},
                                     {"--no-j", "--no-json"}}) {
    EXPECT_EQ(run({"paint", "x", typed}), 2);
    EXPECT_THAT(error_text_, testing::HasSubstr(std::string("; did you mean ") + meant + "?\n")) << typed;
  }
  EXPECT_EQ(run({"paint", "x", "--f"}), 2);
  EXPECT_THAT(error_text_, testing::HasSubstr("; see gld paint --help.\n"));
  EXPECT_EQ(run({"pa"}), 2);
  EXPECT_EQ(error_text_, "error: gld: expected a command, found 'pa'; did you mean 'paint'?\n");
}

TEST_F(CommandLine, AFlagIsNamedAsItIsTypedAndItsValueIsText) {
  EXPECT_EQ(run({"paint", "x", "--scale", "#2"}), 2);
  EXPECT_EQ(error_text_, "error: --scale: expected a number, found '#2'; correct the value.\n");
  EXPECT_EQ(run({"paint", "x", "--set", "guidance.scale=#2"}), 2);  // a comment: YAML
  EXPECT_EQ(error_text_,
            "error: --set, key 'guidance.scale': expected a number, found nothing; correct the value.\n");
}

// An option that only the work can judge is wrong usage all the same.
TEST_F(CommandLine, AnErrorAboutAFlagIsWrongUsageWheneverItIsFound) {
  failure_ = [] { fail({"--size", "whole patches", "3x3", "take 14x14"}); };
  EXPECT_EQ(run({"paint", "x"}), 2);
}

TEST_F(CommandLine, QuietShowsNothingButErrors) {
  failure_ = [] { std::cout << "painted\n"; };
  EXPECT_EQ(run({"paint", "x"}), 0);
  EXPECT_EQ(output_text_, "painted\n");
  EXPECT_EQ(run({"paint", "x", "--quiet"}), 0);
  EXPECT_EQ(output_text_, "");
  EXPECT_EQ(run({"paint", "x"}), 0);
  EXPECT_EQ(output_text_, "painted\n");
}

TEST_F(CommandLine, HelpAndVersionAreFoundWhereTheyAreLookedFor) {
  EXPECT_EQ(run({"paint", "--help"}), 0);
  const auto help = output_text_;
  EXPECT_EQ(run({"help", "paint"}), 0);
  EXPECT_EQ(output_text_, help);
  EXPECT_EQ(run({"--version"}), 0);
  EXPECT_THAT(output_text_, testing::MatchesRegex(
                                "gld [0-9.]+, commit ([0-9a-f]{8}[+]?|unknown), LibTorch [0-9.]+[^ ]*\n"));
}

TEST_F(CommandLine, FailuresKeepTheirSentenceAndStatus) {
  failure_ = [] { fail({"scene.json", "a camera", "none", "add one"}); };
  EXPECT_EQ(run({"paint", "x"}), 1);
  EXPECT_EQ(error_text_, "error: scene.json: expected a camera, found none; add one.\n");
  failure_ = [] { throw Interrupted("3 of 4 views are finished"); };
  EXPECT_EQ(run({"paint", "x"}), 130);
  EXPECT_EQ(error_text_, "interrupted: 3 of 4 views are finished\n");
  failure_ = [] { throw std::runtime_error("first line\nsecond line"); };
  EXPECT_EQ(run({"paint", "x"}), 1);
  EXPECT_EQ(error_text_, "error: first line\n");
}

// This does what /dev/full and a closed pipe do.
struct RefusingBuffer : std::streambuf {
  int overflow(int) override { return traits_type::eof(); }
  int sync() override { return -1; }
};

TEST_F(CommandLine, OutputThatNobodyTookIsAFailure) {
  command_.run = [](const std::vector<std::string>&) {
    std::cout << "the result\n";
    return 0;
  };
  RefusingBuffer refusing;
  auto* const before = std::cout.rdbuf(&refusing);
  testing::internal::CaptureStderr();
  const int status = run_command_line({command_}, {"paint", "a.png"});
  std::cout.rdbuf(before);
  std::cout.clear();
  EXPECT_EQ(status, 1);
  EXPECT_EQ(testing::internal::GetCapturedStderr(),
            "error: standard output: expected to take the result, found a write that failed; "
            "check the disk or the program behind the pipe.\n");
}

TEST_F(CommandLine, HelpThatNobodyTookIsAFailureToo) {
  for (const char* asked : {"--help", "--version"}) {
    RefusingBuffer refusing;
    auto* const before = std::cout.rdbuf(&refusing);
    testing::internal::CaptureStderr();
    const int status = run_command_line({command_}, {asked});
    std::cout.rdbuf(before);
    std::cout.clear();
    EXPECT_EQ(status, 1) << asked;
    EXPECT_THAT(testing::internal::GetCapturedStderr(), testing::HasSubstr("found a write that failed"))
        << asked;
  }
}

// Which of two was meant cannot be known.
TEST_F(CommandLine, AnOptionIsGivenOnce) {
  EXPECT_EQ(run({"paint", "a.png", "--frame-count", "2", "--frame-count", "3"}), 2);
  EXPECT_THAT(error_text_,
              testing::HasSubstr("expected --frame-count once, found 2 times; leave out all but one."));
  EXPECT_EQ(run({"paint", "a.png", "--set", "frame_count=2", "--set", "frame_count=3"}), 2);
  EXPECT_THAT(error_text_, testing::HasSubstr("expected --set frame_count once, found 2 times"));
  EXPECT_EQ(run({"paint", "a.png", "--frame-count"}), 2);
  EXPECT_THAT(error_text_, testing::HasSubstr("expected a value behind --frame-count, found none"));
}

TEST_F(CommandLine, HelpShowsTypeRangeAndDefault) {
  EXPECT_EQ(run({"--help"}), 0);
  EXPECT_THAT(output_text_, testing::HasSubstr("paint  Paint something"));
  EXPECT_EQ(run({"paint", "--help-all"}), 0);
  EXPECT_EQ(
      output_text_,
      "Paint something\n"
      "\n"
      "Usage: gld paint FILE [options]\n"
      "\n"
      "Options:\n"
      "  --help                                    the usual options; --help-all: every one\n"
      "  --config FILE                             YAML file of options, applied before --set and flags\n"
      "  --set KEY=VALUE                           set one option, applied after --config; may be repeated\n"
      "  --quiet                                   print warnings and errors only\n"
      "  --frame-count integer [1, 100]=4          how many frames\n"
      "  --json                                    write JSON\n"
      "  --sources list of integer [0, 1000]       source views\n"
      "  --offset real=0                           an offset\n"
      "\n"
      "--guidance.*: guidance\n"
      "  --scale real [0, 100]=1.5                 guidance scale\n");
}

TEST_F(CommandLine, HelpIsGroupedAndShort) {
  command_.usual = {{"Pictures", {"sources", "guidance.scale"}}};
  command_.description = "Example: gld paint a.png\nIt paints.";
  EXPECT_EQ(run({"paint", "--help"}), 0);
  EXPECT_EQ(output_text_,
            "Paint something\n"
            "Example: gld paint a.png\n"
            "Usage: gld paint FILE [options]\n"
            "Pictures:\n"
            "  --sources N,...  source views\n"
            "  --scale X        guidance scale [1.5]\n"
            "Run:\n"
            "  --json           write JSON\n"
            "5 more options, with type, range and default: gld paint --help-all\n");
}

// A shell makes several arguments of *.jpg.
TEST_F(CommandLine, AListTakesSeveralArguments) {
  command_.arguments = {};
  EXPECT_EQ(run({"paint", "--sources", "3", "4,5", "6", "--offset", "-1"}), 0);
  EXPECT_EQ(options_->sources, (std::vector<int64_t>{3, 4, 5, 6}));
  EXPECT_EQ(options_->offset, -1);
  EXPECT_EQ(run({"paint", "--sources=7", "8", "--json"}), 0);
  EXPECT_EQ(options_->sources, (std::vector<int64_t>{7, 8}));
  EXPECT_EQ(run({"paint", "--offset", "1", "2"}), 2);  // no list
  // Where a command takes arguments of its own, they are not the list's.
  command_.arguments = {"FILE", 1, 2};
  EXPECT_EQ(run({"paint", "--sources", "3", "file"}), 0);
  EXPECT_EQ(options_->sources, (std::vector<int64_t>{3}));
  EXPECT_EQ(arguments_, (std::vector<std::string>{"file"}));
}

// A folder that may not be looked into.
TEST_F(CommandLine, FileSystemErrorsAreOneSentenceToo) {
  failure_ = [] {
    throw std::filesystem::filesystem_error("status", "scene/cameras.json",
                                            std::make_error_code(std::errc::permission_denied));
  };
  EXPECT_EQ(run({"paint", "file"}), 1);
  EXPECT_EQ(error_text_,
            "error: scene/cameras.json: expected a file or folder that can be used, found Permission denied; "
            "check the path and its permissions.\n");
}

}  // namespace
}  // namespace gld
