#include "gld/base/interrupt.h"

#include "gld/base/error.h"

#include <csignal>

namespace gld {
namespace {

// A signal handler can reach nothing but a static object.
volatile std::sig_atomic_t requested = 0;

void request(int signal) {
  requested = 1;
  std::signal(signal, SIG_DFL);  // the second one stops at once
}

}  // namespace

void install_interrupt_handler() {
  requested = 0;
  std::signal(SIGINT, request);
  std::signal(SIGTERM, request);
}

bool interrupt_requested() { return requested != 0; }

void stop_if_interrupted(const std::string& done) {
  if (interrupt_requested()) throw Interrupted(done);
}

}  // namespace gld
