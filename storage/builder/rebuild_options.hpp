// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "core/drainage/drainage.hpp"
#include "core/result.hpp"
#include "storage/builder/build.hpp"
#include "storage/manifest.hpp"

namespace tind {

/// What the user says about reading the source again; what is absent comes from the manifest.
struct SourceHints {
  std::vector<std::string> inputs;
  std::optional<double> nodata, metres_per_unit, spacing_m;
  std::string vertical_datum, geoid, source_crs;
  std::optional<ClassFilter> classes;
};

/// The options that a pyramid was built with, as its manifest tells them; output, threads and cancel are the caller's.
/// kCorrupt on options that no builder writes; kInvalidInput when the manifest names a file whose path must be given
/// (a geoid grid).
Result<BuildOptions> rebuild_options(const Manifest& manifest, const SourceHints& hints);

/// How the pyramid's streams were derived; where it has none, how they would be by default. Precondition:
/// rebuild_options() took the manifest.
DrainageOptions drainage_options(const Manifest& manifest);

}  // namespace tind
