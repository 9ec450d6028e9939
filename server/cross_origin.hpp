// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace tind {

/// Who may read answers from another origin (the Fetch standard's CORS protocol).
class CrossOrigin {
 public:
  /// `origins`: the setting `cors_origins`: "*", or origins separated by commas, or nothing.
  explicit CrossOrigin(std::string_view origins);

  /// Appends the header lines for a request with this Origin field. nullopt: it has none, or is not known.
  void append_fields(std::optional<std::string_view> origin, std::string& fields) const;

 private:
  bool everybody_ = false;
  std::vector<std::string> origins_;
};

}  // namespace tind
