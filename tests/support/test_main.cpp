// The main function of every test program: googletest's own, and a test that asserts nothing fails.
#include <gtest/gtest.h>

namespace {

class AssertionCounter : public testing::EmptyTestEventListener {
 public:
  void OnTestStart(const testing::TestInfo&) override { before_ = gld::test::assertions_made; }

  void OnTestEnd(const testing::TestInfo& info) override {
    if (gld::test::assertions_made != before_ || !info.result()->Passed()) return;
    ADD_FAILURE()
        << info.test_suite_name() << '.' << info.name()
        << ": expected a test that asserts something, found none that it reached; what cannot run on a "
           "machine is a test of its own that hardware has to be there for (CONTRIBUTING.md).";
  }

 private:
  long before_ = 0;
};

}  // namespace

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  testing::UnitTest::GetInstance()->listeners().Append(new AssertionCounter());  // which owns it
  return RUN_ALL_TESTS();
}
