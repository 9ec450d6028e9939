// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "storage/builder/elevation_source.hpp"
#include "storage/builder/forecast.hpp"

namespace tind {

/// Adds what is suspicious about the data to `forecast.problems`, from the source's headers, `forecast.signs` and
/// notes.
void add_data_problems(const ElevationSource& source, const BuildOptions& options, Forecast& forecast);

/// Adds what stands in the way of the output: it exists, its folder is missing or not writable, an interrupted build
/// lies beside it, the disk has no room for it and the working copy. Nothing is checked when no output is named.
void add_output_problems(const BuildOptions& options, Forecast& forecast);

}  // namespace tind
