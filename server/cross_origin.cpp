// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/cross_origin.hpp"

#include <algorithm>

namespace tind {

CrossOrigin::CrossOrigin(std::string_view origins) : everybody_(origins == "*") {
  while (!everybody_ && !origins.empty()) {
    const std::size_t end = std::min(origins.find(','), origins.size());
    std::string_view origin = origins.substr(0, end);
    while (!origin.empty() && origin.front() == ' ') origin.remove_prefix(1);
    while (!origin.empty() && origin.back() == ' ') origin.remove_suffix(1);
    if (!origin.empty()) origins_.emplace_back(origin);
    origins.remove_prefix(std::min(end + 1, origins.size()));
  }
}

void CrossOrigin::append_fields(std::optional<std::string_view> origin, std::string& fields) const {
  if (everybody_) {
    fields += "Access-Control-Allow-Origin: *\r\n";
    return;
  }
  if (origins_.empty()) return;
  fields += "Vary: Origin\r\n";
  if (origin && std::find(origins_.begin(), origins_.end(), *origin) != origins_.end()) {
    fields.append("Access-Control-Allow-Origin: ").append(*origin).append("\r\n");
  }
}

}  // namespace tind
