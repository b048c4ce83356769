#pragma once

#include <string>

namespace gld {

// Ctrl-C (SIGINT) and SIGTERM ask a command to stop at its next safe point; a second one stops at once.
void install_interrupt_handler();
bool interrupt_requested();

// Throws Interrupted with what was done so far when a stop was asked for.
void stop_if_interrupted(const std::string& done);

}  // namespace gld
