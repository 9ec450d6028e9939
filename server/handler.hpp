// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "server/response.hpp"
#include "server/response_cache.hpp"
#include "server/site.hpp"
#include "server/worker_state.hpp"

namespace tind {

/// What the handler needs of a request. Views into the caller's memory.
struct Request {
  std::string_view method;
  std::string_view target;
  std::optional<std::string_view> accept;
  std::optional<std::string_view> accept_encoding;
  std::optional<std::string_view> if_none_match;
};

/// Answers requests. No sockets. Thread safe; one for all threads.
class Handler {
 public:
  explicit Handler(std::size_t cache_bytes) : cache_(cache_bytes) {}

  /// Makes `out`, whatever it was before, the answer to `request` by the site of `worker`, which the calling thread
  /// owns. The body is valid until that state's next batch.
  void handle(const Request& request, WorkerState& worker, Response& out);
  /// Makes /ready answer 503: called when the daemon begins to drain.
  void set_draining() { draining_ = true; }

 private:
  struct Context;
  void answer(Context& context);
  void document(Context& context, const Document& document);
  void cesium(Context& context, const std::string& path);
  void tile(Context& context, const ServedDataset& served, const TileKey& key, bool terrain);
  void parts(Context& context, const ServedDataset& served, const TileKey& key);
  void piece(Context& context, const ServedDataset& served, const PieceKey& key);
  void codes(Context& context, const ServedDataset& served, const TileKey& key);
  template <class Make>
  void coded(Context& context, const std::string& cache_key, Make&& make);

  ResponseCache cache_;
  std::atomic<bool> draining_ = false;
};

}  // namespace tind
