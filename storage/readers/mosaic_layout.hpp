// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "storage/readers/gdal_raster.hpp"
#include "storage/readers/raster_file.hpp"

namespace tind {

/// Sorts the files into the mosaic's canonical order: southernmost, then westernmost, then size, hash, name. Drops
/// those that are there twice; returns how many.
std::size_t sort_sources(std::vector<RasterFile>& files);

/// Why the posts of sorted files cannot all be taken as they are; nullopt: they are geographic and lie on one grid.
std::optional<std::string> why_warp(const std::vector<RasterFile>& files);

/// Gives every sorted source its rows and columns in the mosaic's grid, and the grid its place and size: the smallest
/// that holds all, west of which is the widest gap. Precondition: west, south, dx, dy and n_used_* lie on one grid.
void place_sources(RasterMosaic& m, std::vector<RasterFile>& sources);

}  // namespace tind
