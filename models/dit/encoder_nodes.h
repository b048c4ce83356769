#pragma once

#include "gld/flow/guidance.h"
#include "gld/flow/solvers/solver.h"
#include "models/dit/dit_scene.h"

#include <array>
#include <cstdint>
#include <vector>

namespace gld {

// Flow times at which a condition encoder that depends on the flow time alone is evaluated, by branch of guidance, so
// that its output at every other time can be interpolated.
using EncoderNodes = std::array<std::vector<double>, 2>;

// Returns `count` nodes a branch for this solve, decreasing. A solver with one evaluation a step only visits the
// schedule's times, and the nodes are chosen among those: what is evaluated there is exact, and with as many nodes as
// times all of it is. Other solvers get Chebyshev points of the whole interval. The unconditional branch has nodes
// where guidance acts, none where it never does.
EncoderNodes encoder_nodes(const SolverOptions& solver, const GuidanceOptions& guidance, int64_t count);

// Returns the same for the schedule's times, first to last, where they are known already.
EncoderNodes encoder_nodes_on(const std::vector<double>& times, const SolverOptions& solver,
                              const GuidanceOptions& guidance, int64_t count);

// Returns the weight of each node's value in the polynomial through all of them at t; 0 and 1 where t is a node. The
// polynomial is in t itself: the encoder sees the flow time through waves of t (models/layers/time_embedding.h).
std::vector<double> interpolation_weights(const std::vector<double>& nodes, double t);

}  // namespace gld
