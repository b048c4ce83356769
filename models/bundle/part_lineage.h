#pragma once

#include "models/bundle/bundle.h"

#include <map>
#include <string>
#include <vector>

namespace gld {

// A part belongs to the parts that it was trained on: M1 of another backbone samples noise. So each carries, in the
// metadata of its file, the SHA-256 of their files ("gld:trained_on", JSON by part name). And a flow model belongs to
// its options, many of which no tensor's shape shows (what it predicts, what its prediction begins with, how cameras
// enter): it carries them as YAML ("gld:trained_as").

// Returns what that part is trained on: the backbone; for generators the statistics that their latents are normalised
// with; for what is shown carried photographs the geometry head too.
std::vector<BundlePart> trained_on(const BundlePart& part, const BundleOptions& options);

// Returns the SHA-256 of the files of what those parts are trained on, by name, as far as the bundle has them and they
// are not among the parts themselves.
std::map<std::string, std::string> hashes_of_trained_on(const ModelBundle& bundle,
                                                        const std::vector<BundlePart>& parts);

// Writes texts, by key, into the metadata of the part's file.
void note_in_metadata(const ModelBundle& bundle, const BundlePart& part,
                      const std::map<std::string, std::string>& notes);

// Writes into the part's file what its bundle has of those parts, and of its options, now. It is called for each part
// right after it was made, and for parts that were made together in the order of bundle_parts().
void note_trained_on(const ModelBundle& bundle, const BundlePart& part);

// Throws Error naming the part that must be trained again where one of `parts` was trained on another file than the
// bundle has, or as something else than model.yaml says; with allow_mixed that is a warning. Returns warnings, a
// sentence each: also for parts that do not say what they were trained on, because a program of before wrote them. In a
// bundle of gld convert (it has a conversion.json) those are taken to belong together.
std::vector<std::string> mixed_parts(const ModelBundle& bundle, const std::vector<BundlePart>& parts,
                                     bool allow_mixed);

}  // namespace gld
