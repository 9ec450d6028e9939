// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/conditions.hpp"
#include "server/negotiation.hpp"
#include "server/request_parser.hpp"
#include "server/route.hpp"
#include "tests/fuzz/fuzz_target.hpp"

// From bytes off the wire to a route: nothing crashes, and what is accepted keeps its promises.
int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::string_view bytes(reinterpret_cast<const char*>(data), size);
  bytes.remove_prefix(tind::leading_empty_lines(bytes));
  const auto blank = bytes.find("\r\n\r\n");
  static tind::FieldScratch fields;
  static std::string scratch;
  const auto parsed = tind::parse_request(blank == bytes.npos ? bytes : bytes.substr(0, blank + 4), fields);
  std::string_view target = bytes;  // not a request: a target then
  if (const auto* request = std::get_if<tind::ParsedRequest>(&parsed)) {
    const tind::Request& view = request->request;
    target = view.target;
    require(!target.empty() && target.size() <= tind::kMaxTargetBytes, "a request has a target");
    tind::choose_coding(view[tind::RequestField::kAcceptEncoding]);
    tind::wants_normals(view[tind::RequestField::kAccept], std::nullopt);
    const tind::Validators validators{"\"0123-q\"", 784111777};
    tind::evaluate_conditions(view, validators);
    if (const auto range = tind::choose_range(view, validators, 1000)) {
      require(range->first + range->length <= 1000, "a range is inside");
    }
  }
  const auto route = tind::parse_target(target, scratch);
  const auto* found = std::get_if<tind::Target>(&route);
  if (!found) {
    const int status = std::get<int>(route);
    require(status == 400 || status == 404, "a target that is no route has a status");
    return 0;
  }
  if (const auto* tile = std::get_if<tind::TileRoute>(&found->route)) require(tile->key.valid(), "tiles are valid");
  if (const auto* piece = std::get_if<tind::PieceRoute>(&found->route)) require(piece->key.valid(), "pieces are valid");
  if (const auto* file = std::get_if<tind::CesiumRoute>(&found->route)) {
    const std::string_view path = file->path;
    require(path.find("/../") == path.npos && !path.starts_with("../") && !path.ends_with("/..") && path != ".." &&
                path[0] != '/',
            "paths stay inside");
  }
  const auto extensions = tind::query_value(found->query, "extensions");
  tind::wants_normals(std::nullopt, extensions);
  return 0;
}
