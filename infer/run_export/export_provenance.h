#pragma once

#include "gld/report/provenance.h"
#include "infer/run_export/finished_run.h"

namespace gld {

// Returns what every exported file says of where it comes from: this program and its export options, and of the run
// that it was made of the model's hash, the seed, the precision and the options ("gld:run_options"). export_options is
// JSON on one line, of those options alone that can change the file.
TextItems export_provenance(const FinishedRun& run, const std::string& export_options);

// Returns the same as an XMP packet, for formats that keep metadata in XML.
std::string xmp_packet(const TextItems& items);

}  // namespace gld
