#pragma once

// nlohmann::json's own members are compiled once, in json_instances.cpp, and not in each source that has a value of it:
// a third of the time of a build went there. This is part of the precompiled headers; no source includes it.
#include <nlohmann/json.hpp>

extern template class nlohmann::basic_json<>;
extern template class nlohmann::basic_json<nlohmann::ordered_map>;
