// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/format/bytes.hpp"
#include "server/response_cache.hpp"
#include "server/site.hpp"

namespace tind {

/// What the handler needs of a request. Views into the caller's memory.
struct Request {
  std::string_view method;
  std::string_view target;
  std::optional<std::string_view> accept;
  std::optional<std::string_view> accept_encoding;
  std::optional<std::string_view> if_none_match;
};

/// Bytes of an answer and who keeps them alive. Without an owner they are Response::pin's and live as long as it.
struct Slice {
  ByteView bytes;
  std::shared_ptr<const void> owner;
};

/// An answer without what the connection adds (status line, Date, Connection, Content-Length).
struct Response {
  int status = 200;
  std::string fields;                           ///< Header lines, each ended by CRLF.
  std::vector<Slice> body;                      ///< Empty for HEAD, 204 and 304.
  std::optional<std::uint64_t> content_length;  ///< What GET sends; absent for 204 and 304.
  std::optional<TileStore::Snapshot> pin;       ///< Holds the memory map's pages that ownerless slices are in.
};

/// Answers requests. No sockets. Thread safe; one for all threads.
class Handler {
 public:
  /// `site` must outlive the handler.
  Handler(const Site& site, std::size_t cache_bytes) : site_(site), cache_(cache_bytes) {}

  Response handle(const Request& request);
  /// Makes /ready answer 503: called when the daemon begins to drain.
  void set_draining() { draining_ = true; }

 private:
  struct Context;
  Response answer(Context& context);
  Response document(Context& context, const Document& document);
  Response cesium(Context& context, const std::string& path);
  Response tile(Context& context, const Dataset& dataset, const TileKey& key, bool terrain);
  Response parts(Context& context, const Dataset& dataset, const TileKey& key);
  Response piece(Context& context, const Dataset& dataset, const PieceKey& key);
  Response codes(Context& context, const Dataset& dataset, const TileKey& key);
  template <class Make>
  Response coded(Context& context, const std::string& cache_key, Make&& make);

  const Site& site_;
  ResponseCache cache_;
  std::atomic<bool> draining_ = false;
};

/// An answer in one line of plain text, also for failures that never reach the handler.
Response text_response(int status, const std::string& text, const std::string& more_fields = {});

/// "Not Found" for 404 and so on.
const char* reason_phrase(int status);

}  // namespace tind
