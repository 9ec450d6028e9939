// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/negotiation.hpp"
#include "server/request_parser.hpp"
#include "server/route.hpp"
#include "tests/fuzz/fuzz_target.hpp"

// From bytes off the wire to a route: nothing crashes, and what is accepted keeps its promises.
int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::string_view bytes(reinterpret_cast<const char*>(data), size);
  bytes.remove_prefix(tind::leading_empty_lines(bytes));
  const auto blank = bytes.find("\r\n\r\n");
  const auto parsed = tind::parse_request(blank == bytes.npos ? bytes : bytes.substr(0, blank + 4));
  std::string_view target = bytes;  // not a request: a target then
  if (const auto* request = std::get_if<tind::ParsedRequest>(&parsed)) {
    const tind::Request view = request->view();
    target = view.target;
    require(!target.empty() && target.size() <= tind::kMaxTargetBytes, "a request has a target");
    tind::choose_coding(view.accept_encoding);
    tind::wants_normals(view.accept, std::nullopt);
    if (view.if_none_match) tind::etag_matches(*view.if_none_match, "\"0123-q\"");
  }
  const auto route = tind::parse_target(target);
  const auto* found = std::get_if<tind::Target>(&route);
  if (!found) {
    const int status = std::get<int>(route);
    require(status == 400 || status == 404, "a target that is no route has a status");
    return 0;
  }
  if (const auto* tile = std::get_if<tind::TileRoute>(&found->route)) require(tile->key.valid(), "tiles are valid");
  if (const auto* piece = std::get_if<tind::PieceRoute>(&found->route)) require(piece->key.valid(), "pieces are valid");
  if (const auto* file = std::get_if<tind::CesiumRoute>(&found->route)) {
    require(("/" + file->path + "/").find("/../") == std::string::npos && file->path[0] != '/', "paths stay inside");
  }
  const auto extensions = tind::query_value(found->query, "extensions");
  tind::wants_normals(std::nullopt, extensions);
  return 0;
}
