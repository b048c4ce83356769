#include "gld/base/configuration.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/base/flag_values.h"
#include "gld/base/option_differences.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <atomic>
#include <cmath>
#include <cstdint>
#include <string>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

enum class Shape { kRound, kSquare };

struct InnerOptions : OptionsGroup {
  double weight = 0.5;
  std::vector<int64_t> sizes{1, 2};
  void visit(FieldVisitor& visitor) override {
    visitor.real({"weight", "how much it weighs"}, weight, {0, 1});
    visitor.integers({"sizes", "list of sizes"}, sizes, {1, 100});
  }
  void check() const override {
    if (weight == 0.25) fail({"inner", "no quarter", "0.25", "use another weight"});
  }
};

struct OuterOptions : OptionsGroup {
  int64_t count = 3;
  bool loud = false;
  std::string title = "a \"title\": yes";
  Shape shape = Shape::kRound;
  std::vector<std::string> names;
  InnerOptions inner;
  void visit(FieldVisitor& visitor) override {
    visitor.integer({"count", "how many"}, count, {1, 10});
    visitor.boolean({"loud", "whether it is loud"}, loud);
    visitor.text({"title", "what it is called"}, title);
    visit_choice(visitor, {"shape", "its shape"}, shape, {"round", "square"});
    visitor.texts({"names", "who"}, names);
    visitor.group({"inner", "what is inside"}, inner);
  }
};

TEST(Configuration, ReadsYamlOverDefaults) {
  OuterOptions options;
  load_yaml_text(options, "count: 7\nshape: square\ninner:\n  sizes: [4, 5, 6]\nnames: [a, 'b c']\n",
                 "test.yaml");
  EXPECT_EQ(options.count, 7);
  EXPECT_EQ(options.shape, Shape::kSquare);
  EXPECT_THAT(options.inner.sizes, testing::ElementsAre(4, 5, 6));
  EXPECT_EQ(options.inner.weight, 0.5);
  EXPECT_THAT(options.names, testing::ElementsAre("a", "b c"));
}

TEST(Configuration, WhatIsWrittenReadsBackEqual) {
  OuterOptions options;
  options.inner.weight = 1.0 / 3.0;
  options.names = {"x: y", "line\nbreak", "'"};
  options.loud = true;
  OuterOptions copy;
  load_yaml_text(copy, to_yaml(options), "copy.yaml");
  EXPECT_EQ(to_json(copy), to_json(options));
  EXPECT_EQ(copy.inner.weight, options.inner.weight);
  OuterOptions from_json;
  load_json(from_json, to_json(options), "json");
  EXPECT_EQ(to_yaml(from_json), to_yaml(options));
}

TEST(Configuration, NumbersBelowTheNormalOnesReadBackEqual) {
  OuterOptions options, copy;
  options.inner.weight = 1e-310;
  load_yaml_text(copy, to_yaml(options), "copy.yaml");
  EXPECT_EQ(copy.inner.weight, 1e-310);
}

TEST(Configuration, SettingsTakeDottedKeysAndCommaLists) {
  OuterOptions options;
  apply_setting(options, "inner.weight=0.75");
  apply_setting(options, "inner.sizes=3,9");
  apply_setting(options, "loud=true");
  EXPECT_EQ(options.inner.weight, 0.75);
  EXPECT_THAT(options.inner.sizes, testing::ElementsAre(3, 9));
  EXPECT_TRUE(options.loud);
}

// Seen: --out "runs/trip #2" wrote over runs/trip.
TEST(Configuration, AFlagsValueIsItsText) {
  OuterOptions options;
  for (const std::string text :
       {"runs/trip #2", "a: b", "[a]", "*x", "@x", "&x", " 'quoted' ", "~", "null", ""}) {
    apply_flag(options, "title", text, "--title");
    EXPECT_EQ(options.title, text);
  }
  apply_flag(options, "names", "a: b,[c", "--names");
  EXPECT_THAT(options.names, testing::ElementsAre("a: b", "[c"));
  apply_flag(options, "inner.sizes", "3, 9", "--sizes");
  EXPECT_THAT(options.inner.sizes, testing::ElementsAre(3, 9));
  apply_flag(options, "inner.sizes", "", "--sizes");
  EXPECT_TRUE(options.inner.sizes.empty());
  EXPECT_EQ(test::error_of([&] { apply_flag(options, "inner.sizes", "1,x", "--sizes"); }),
            "--sizes: expected an integer, found 'x'; correct the value.");
}

TEST(Configuration, SaysWhatDiffersFromAnEarlierText) {
  OuterOptions options;
  const auto before = to_yaml(options) + "of_an_older_program: 3\n";
  EXPECT_TRUE(differences_from(before, "config.yaml", options).empty());
  options.inner.weight = 0.125;
  options.inner.sizes = {1, 2, 3};
  options.title = "b";
  const auto differences = differences_from(before, "config.yaml", options);
  ASSERT_EQ(differences.size(), 3U);
  EXPECT_EQ(differences[0].key, "inner.sizes");
  EXPECT_EQ(differences[0].before, "[1, 2]");
  EXPECT_EQ(differences[0].now, "[1, 2, 3]");
  EXPECT_EQ(differences[1].key, "inner.weight");
  EXPECT_EQ(differences[1].before, "0.5");
  EXPECT_EQ(differences[2].key, "title");
}

TEST(Configuration, ARunGoesOnWithItsOwnOptionsOnly) {
  const test::TemporaryFolder folder;
  OuterOptions options;
  refuse_other_options(folder.path(), options, OuterOptions());  // killed before its file was written
  write_file_atomically(folder.path() / "config.yaml", to_yaml(options));
  refuse_other_options(folder.path(), options, OuterOptions());
  options.inner.weight = 0.125;
  refuse_other_options(folder.path(), options, OuterOptions(), {"inner.weight"});
  EXPECT_EQ(test::error_of([&] { refuse_other_options(folder.path(), options, OuterOptions(), {"title"}); }),
            "--resume: expected the options of the run, which has inner.weight 0.5, found 0.125; "
            "leave it as it was, or begin again with --overwrite.");
}

TEST(Configuration, WhatAnEarlierTextDoesNotHaveIsItsDefault) {
  OuterOptions options;
  options.inner.weight = 0.125;
  EXPECT_TRUE(differences_from("{}", "config.yaml", options).empty());
  const OuterOptions defaults;
  const auto differences = differences_from("{}", "config.yaml", options, &defaults);
  ASSERT_EQ(differences.size(), 1U);
  EXPECT_EQ(difference_text(differences[0]), "inner.weight 0.125 (it was 0.5)");
  const test::TemporaryFolder folder;
  write_file_atomically(folder.path() / "config.yaml", "inner: {sizes: [1, 2]}\n");
  refuse_other_options(folder.path(), defaults, defaults);
  EXPECT_EQ(test::error_of([&] { refuse_other_options(folder.path(), options, defaults); }),
            "--resume: expected the options of the run, which has inner.weight 0.5, found 0.125; "
            "leave it as it was, or begin again with --overwrite.");
}

TEST(Configuration, SuggestsOnlyWhatIsNear) {
  EXPECT_EQ(nearest_name("ddim", {"euler", "dp54", "unipc3"}), "");
  EXPECT_EQ(nearest_name("--schedule", {"--help", "--size"}), "");
  EXPECT_EQ(nearest_name("eluer", {"euler", "heun"}), "euler");
}

struct Refusal {
  std::string yaml;
  std::string message;
};

class ConfigurationRefusals : public testing::TestWithParam<Refusal> {};

TEST_P(ConfigurationRefusals, SayWhereWhatAndWhatToDo) {
  OuterOptions options;
  EXPECT_EQ(test::error_of([&] { load_yaml_text(options, GetParam().yaml, "f.yaml"); }), GetParam().message);
}

INSTANTIATE_TEST_SUITE_P(
    All, ConfigurationRefusals,
    testing::Values(
        Refusal{
            "count: 1\ncuont: 4\n",
            "f.yaml:2, key 'cuont': expected a known option, found an unknown one; did you mean 'count'?"},
        Refusal{"inner:\n  wieght: 1\n",
                "f.yaml:2, key 'inner.wieght': expected a known option, found an unknown one; "
                "did you mean 'inner.weight'?"},
        Refusal{
            "weight: 1\n",
            "f.yaml:1, key 'weight': expected a known option, found an unknown one; did you mean 'inner.weight'?"},
        Refusal{"count: 11\n",
                "f.yaml:1, key 'count': expected an integer in the range [1, 10], found 11; "
                "choose a value inside the range."},
        Refusal{"count: 2.5\n",
                "f.yaml:1, key 'count': expected an integer, found '2.5'; correct the value."},
        Refusal{
            "count: 99999999999999999999\n",
            "f.yaml:1, key 'count': expected an integer of 64 bits, found '99999999999999999999'; choose one nearer to 0."},
        Refusal{"inner:\n  weight: .nan\n",
                "f.yaml:2, key 'inner.weight': expected a number in the range [0, 1], found .nan; "
                "choose a value inside the range."},
        Refusal{
            "shape: sqare\n",
            "f.yaml:1, key 'shape': expected one of round, square, found 'sqare'; did you mean 'square'?"},
        Refusal{"inner: 3\n",
                "f.yaml:1, key 'inner': expected a map of options, found '3'; "
                "write its options indented below it."},
        Refusal{"count: 2\ncount: 3\n",
                "f.yaml:2: expected every key once, found 'count' a second time; remove one of the two."},
        Refusal{"- a\n", "f.yaml: expected a map of options, found a list; write one 'key: value' a line."},
        Refusal{"loud: maybe\n",
                "f.yaml:1, key 'loud': expected true or false, found 'maybe'; correct the value."}));

TEST(Configuration, BrokenYamlNamesTheLine) {
  OuterOptions options;
  const auto message = test::error_of([&] { load_yaml_text(options, "count: 1\n  bad: [1\n", "f.yaml"); });
  EXPECT_THAT(message, testing::StartsWith("f.yaml:2: expected valid YAML, found "));
}

TEST(Configuration, YamlThatIsNoListOfOptionsIsOneSentence) {
  OuterOptions options;
  EXPECT_EQ(test::error_of([&] { load_yaml_text(options, "[1, 2]: 3\n", "a.yaml"); }),
            "a.yaml:1, key '': expected the name of an option, found a list; correct the text.");
  EXPECT_EQ(test::error_of([&] { load_yaml_text(options, "? {a: 1}\n: 3\n", "a.yaml"); }),
            "a.yaml:1, key '': expected the name of an option, found a map; correct the text.");
  EXPECT_EQ(test::error_of([&] { load_yaml_text(options, "count: 3\n---\ncount: 4\n", "a.yaml"); }),
            "a.yaml: expected one YAML document, found 2; keep one of them.");
  EXPECT_EQ(test::error_of([&] { load_yaml_text(options, "count: 3\n...\n# more\ncount: 4\n", "a.yaml"); }),
            "a.yaml: expected one YAML document, found 2; keep one of them.");
  EXPECT_NO_THROW(load_yaml_text(options, "\xef\xbb\xbf# marked\n---\ncount: 3\n...\n# the end\n", "a.yaml"));
  EXPECT_EQ(test::error_of([&] { load_yaml_text(options, "shape: \"\\e[2J\"\n", "a.yaml"); }),
            "a.yaml:1, key 'shape': expected one of round, square, found '\\x1b[2J'; choose one of them.");
  EXPECT_FALSE(test::error_of([&] { load_yaml_text(options, std::string(100'000, '['), "a.yaml"); }).empty());
  EXPECT_NO_THROW(load_yaml_text(options, "", "a.yaml"));
}

TEST(Configuration, ChecksRangesAndRelations) {
  OuterOptions options;
  options.inner.weight = 0.25;
  EXPECT_EQ(test::error_of([&] { check_options(options, "here"); }),
            "inner: expected no quarter, found 0.25; use another weight.");
  options.inner.weight = std::nan("");
  EXPECT_THAT(
      test::error_of([&] { check_options(options, "here"); }),
      testing::StartsWith("here, key 'inner.weight': expected a value in the range [0, 1], found .nan"));
}

TEST(Configuration, DescribesEveryField) {
  const auto described = describe_options(OuterOptions());
  ASSERT_EQ(described.size(), 7u);
  EXPECT_EQ(described[0].key, "count");
  EXPECT_EQ(described[0].range, "[1, 10]");
  EXPECT_EQ(described[3].type, "round|square");
  EXPECT_EQ(described[5].key, "inner.weight");
  EXPECT_EQ(described[5].default_value, "0.5");
}

TEST(AtomicFile, AppearsWholeOrNotAtAll) {
  test::TemporaryFolder folder;
  const auto target = folder.path() / "result.txt";
  write_file_atomically(target, "one");
  EXPECT_EQ(read_file(target), "one");
  {
    AtomicFile abandoned(target);
    write_file_atomically(abandoned.temporary(), "half");
  }
  EXPECT_EQ(read_file(target), "one");
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder.path()), {}), 1);
  EXPECT_EQ(test::error_of([&] { write_file_atomically(folder.path() / "no" / "x", ""); }),
            (folder.path() / "no" / "x").string() +
                ": expected an existing folder to write into, found no folder " +
                (folder.path() / "no").string() + "; create it or choose another output.");
  EXPECT_EQ(test::error_of([&] { read_file(target, 2); }),
            target.string() + ": expected at most 2 bytes, found 3 bytes; check that it is the right file.");
}

// A reader sees the one or the other, not the length of one and the bytes of the other.
TEST(AtomicFile, IsReadWholeWhileItIsReplaced) {
  test::TemporaryFolder folder;
  const auto target = folder.path() / "result.txt";
  const std::string longer(100, 'a'), shorter(30, 'b');
  write_file_atomically(target, longer);
  std::atomic<bool> ended{false};
  std::thread writer([&] {
    for (int i = 0; !ended; ++i) write_file_atomically(target, i % 2 == 0 ? shorter : longer);
  });
  int64_t mixed = 0;
  for (int i = 0; i < 2000; ++i) {
    try {
      const std::string read = read_file(target);
      mixed += read == longer || read == shorter ? 0 : 1;
    } catch (const Error&) {
      ++mixed;
    }
  }
  ended = true;
  writer.join();
  EXPECT_EQ(mixed, 0);
}

}  // namespace
}  // namespace gld
