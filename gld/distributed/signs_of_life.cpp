#include "gld/distributed/signs_of_life.h"

#include "gld/base/error.h"

#include <cstdlib>
#include <vector>

#include <unistd.h>

namespace gld {
namespace {

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point before) {
  return std::chrono::duration<double>(Clock::now() - before).count();
}

void rest(double seconds) { std::this_thread::sleep_for(std::chrono::duration<double>(seconds)); }

std::string life_key(int64_t rank) { return "alive/" + std::to_string(rank); }

}  // namespace

std::string say_ended(c10d::Store& store, const std::string& why) {
  const auto there = store.compareSet(kEndedKey, {}, std::vector<uint8_t>(why.begin(), why.end()));
  return {there.begin(), there.end()};
}

SignsOfLife::SignsOfLife(c10::intrusive_ptr<c10d::Store> store, const LifePlan& plan)
    : store_(std::move(store)), plan_(plan), answered_(Clock::now()) {
  beating_ = std::thread([this] { beat(); });
  watching_ = std::thread([this] { watch(); });
}

SignsOfLife::~SignsOfLife() { stop(""); }

void SignsOfLife::stop(const std::string& reason) {
  if (stopping_.exchange(true)) return;
  beating_.join();
  watching_.join();
  try {
    if (!reason.empty()) say_ended(*store_, reason);
  } catch (const std::exception&) {
    // The store is gone, and whoever could have read it.
  }
}

void SignsOfLife::wait_for_verdict() const {
  const auto begun = Clock::now();
  while (seconds_since(begun) < plan_.silent_seconds + 3 * plan_.beat_seconds && !stopping_) rest(0.05);
}

void SignsOfLife::beat() {
  const int64_t next = (plan_.rank + 1) % plan_.count;
  int64_t last_count = -1;
  auto last_seen = Clock::now();
  while (!stopping_) {
    try {
      store_->add(life_key(plan_.rank), 1);
      const int64_t count = store_->add(life_key(next), 0);
      if (count != last_count) {
        last_count = count;
        last_seen = Clock::now();
      } else if (seconds_since(last_seen) > plan_.silent_seconds) {
        say_ended(*store_, "no sign of life of rank " + std::to_string(next));
      }
      if (store_->check({kEndedKey})) {
        const auto why = store_->get(kEndedKey);
        if (!stopping_) end_process({why.begin(), why.end()});
      }
      answered_ = Clock::now();
    } catch (const std::exception&) {
      if (!stopping_) end_process("no store at " + plan_.store + ", any more");
    }
    for (int part = 0; part < 10 && !stopping_; ++part) rest(plan_.beat_seconds / 10);
  }
}

void SignsOfLife::watch() const {
  while (!stopping_) {
    if (seconds_since(answered_) > plan_.silent_seconds)
      end_process("no answer of the store at " + plan_.store);
    rest(plan_.beat_seconds / 10);
  }
}

void SignsOfLife::end_process(const std::string& found) const {
  const Error error({"rank " + std::to_string(plan_.rank),
                     "all " + std::to_string(plan_.count) + " processes to go on", found,
                     "see what it said at last, and continue with --resume"});
  const std::string line = std::string("error: ") + error.what() + "\n";
  // One write, so that sentences of several processes on one terminal do not mix.
  if (::write(STDERR_FILENO, line.data(), line.size()) < 0) std::_Exit(2);
  if (plan_.holds_the_store) rest(3 * plan_.beat_seconds);
  std::_Exit(1);
}

}  // namespace gld
