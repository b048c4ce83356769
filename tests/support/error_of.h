#pragma once

#include <functional>
#include <string>

namespace gld::test {

// Returns what() of the gld::Error that action throws; fails the test when it throws nothing.
std::string error_of(const std::function<void()>& action);

}  // namespace gld::test
