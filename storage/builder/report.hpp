// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>

#include "storage/builder/build.hpp"

namespace tind {

/// The report of a build as JSON (docs: tind-build manual): the manifest's figures, a table per level with the
/// vertices' breakdown, times and counts. Not deterministic: it holds times.
std::string report_json(const BuildReport& report);

/// The same as a table for a person, at most 110 columns wide.
std::string report_text(const BuildReport& report);

}  // namespace tind
