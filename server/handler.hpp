// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <string_view>

#include "config/settings.hpp"
#include "server/cross_origin.hpp"
#include "server/public_address.hpp"
#include "server/request.hpp"
#include "server/response.hpp"
#include "server/response_cache.hpp"
#include "server/route.hpp"
#include "server/tile_encoder.hpp"
#include "server/worker_state.hpp"

namespace tind {

/// Answers requests; no sockets. Thread safe: one for all threads, each with its own state.
class RequestHandler {
 public:
  virtual ~RequestHandler() = default;

  /// Makes `out`, whatever it was before, the answer to `request` by the site of `worker`, which the calling thread
  /// owns. The body is valid until that state's next batch. `out.is_later`: there is no answer yet.
  virtual void handle(const Request& request, WorkerState& worker, Response& out) = 0;
  /// Makes `out` the answer to what is no request: `status` and why.
  virtual void refuse(int status, std::string_view why, Response& out) = 0;
};

/// The public interface, docs/http.md.
class Handler final : public RequestHandler {
 public:
  explicit Handler(const Settings& settings);

  void handle(const Request& request, WorkerState& worker, Response& out) override;
  void refuse(int status, std::string_view why, Response& out) override;
  /// Makes /ready answer 503: called when the daemon begins to drain.
  void set_draining() { draining_ = true; }
  const ResponseCache& cache() const { return cache_; }

 private:
  struct Context;
  struct Representation;
  void answer(Context& context);
  void document(Context& context, const Document& document);
  template <class MakeAbsolute>
  void linked_document(Context& context, const Document& document, MakeAbsolute&& make_absolute);
  void cesium(Context& context, std::string_view path);
  void encoded(Context& context, const ServedDataset& served, const TileKey& key, EncodedFormat format);
  void terrain(Context& context, const ServedDataset& served, const TileKey& key);
  void parts(Context& context, const ServedDataset& served, const TileKey& key);
  void piece(Context& context, const ServedDataset& served, const PieceKey& key);
  template <class Make>
  void coded(Context& context, const CacheKey& key, const Representation& representation, Make&& make);

  ResponseCache cache_;
  CrossOrigin cross_origin_;
  PublicAddress public_address_;
  std::atomic<bool> draining_ = false;
};

}  // namespace tind
