// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "tests/client/manifest_view.hpp"
#include "tests/client/report.hpp"
#include "tests/client/source_posts.hpp"
#include "tests/client/tile_source.hpp"

namespace tind::client {

struct VerifyOptions {
  std::string dataset;  ///< Name in the routes.
  int cuts = 50;
  std::uint64_t seed = 1;
  double sample = 1;  ///< Share of the tiles to look at, in (0, 1].
  unsigned threads = 2;
  /// Told what is being done; may be called from this thread only.
  std::function<void(const std::string&)> progress = [](const std::string&) {};
};

/// The dataset that a daemon serves when it serves exactly one (route /datasets).
Outcome<std::string> find_only_dataset(TileSource& source);

/// The manifest of a dataset, as it is served.
Outcome<ManifestView> fetch_manifest(TileSource& source, const std::string& dataset);

/// The grid of posts that a manifest claims: what reading the sources needs.
GridClaim claim_of(const ManifestView& manifest);

/// Runs every check of docs/verify.md. `posts` may be null: then the checks against the source are skipped. A refusal
/// means that nothing could be checked at all: no connection, or a manifest that cannot be read.
Outcome<std::unique_ptr<Report>> verify(TileSource& source, const SourcePosts* posts, const VerifyOptions& options);

}  // namespace tind::client
