#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <string>
#include <thread>

#include <torch/csrc/distributed/c10d/Store.hpp>

namespace gld {

struct LifePlan {
  int64_t rank = 0;
  int64_t count = 1;
  std::string store;             // "10.0.0.1:29500, of rank 0", for sentences
  bool holds_the_store = false;  // and lets the others read there why before it ends
  double beat_seconds = 0.5;
  double silent_seconds = 6;  // without a sign: a process is gone
};

// Tells the others that this process lives, and ends it when another does not: a thread counts a number of the store up
// twice a second and watches that of the next rank; what it finds it leaves in the store, where all look. A second
// thread watches the first, which waits forever where the network is cut. Whatever this process does meanwhile, it ends
// within 10 s of the other, with one sentence on standard error.
class SignsOfLife {
 public:
  // store is used by its thread alone.
  SignsOfLife(c10::intrusive_ptr<c10d::Store> store, const LifePlan& plan);
  ~SignsOfLife();
  SignsOfLife(const SignsOfLife&) = delete;
  SignsOfLife& operator=(const SignsOfLife&) = delete;

  // Before this process ends of its own accord; reason as in "rank 2 ended with an error of its own", empty where all
  // have finished.
  void stop(const std::string& reason);
  // What broke a connection is known within seconds: then this does not return.
  void wait_for_verdict() const;

 private:
  void beat();
  void watch() const;
  [[noreturn]] void end_process(const std::string& found) const;

  c10::intrusive_ptr<c10d::Store> store_;
  LifePlan plan_;
  std::atomic<bool> stopping_{false};
  std::atomic<std::chrono::steady_clock::time_point> answered_;  // when the store last did
  std::thread beating_;
  std::thread watching_;
};

// The key at which the first who finds that the run cannot go on says why.
constexpr const char* kEndedKey = "ended";
// Says so unless another has; returns what stands there.
std::string say_ended(c10d::Store& store, const std::string& why);

}  // namespace gld
