// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cassert>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "core/format/bytes.hpp"
#include "server/content_coding.hpp"

namespace tind {

/// What kind of address was asked for; for counting.
enum class RouteKind : std::uint8_t {
  kNone,  ///< No request, or no address of ours.
  kIndex,
  kDatasets,
  kHealth,
  kReady,
  kAsset,
  kCesium,
  kGlobe,
  kMeta,
  kLayer,
  kRedirect,
  kTerrain,
  kVn,
  kParts,
  kPiece,
  kCodes,
};
inline constexpr std::size_t kRouteKinds = 16;

/// An answer without what the connection adds (status line, Date, Connection, Content-Length). Made to be used again
/// and again: reset() keeps the memory of its texts, so that answering takes none. The body is what `lead` holds, then
/// views: into a dataset's memory map, which the WorkerState holds until its next batch, or into what keep() was given.
class Response {
 public:
  static constexpr std::size_t kMaxSlices = 16;

  int status = 200;
  std::string fields;                           ///< Header lines, each ended by CRLF.
  std::optional<std::uint64_t> content_length;  ///< What GET sends; absent for 204 and 304.
  bool is_later = false;               ///< No answer yet: the request is to be asked again (WorkerState::is_awaited).
  RouteKind route = RouteKind::kNone;  ///< For counting; so is the coding.
  Coding coding = Coding::kIdentity;
  std::string lead;  ///< The first bytes of the body: for what exists nowhere else.

  /// As new.
  void reset() {
    status = 200;
    is_later = false;
    route = RouteKind::kNone;
    coding = Coding::kIdentity;
    fields.clear();
    content_length.reset();
    drop_body();
  }
  /// For HEAD and 304: the fields stay.
  void drop_body() {
    lead.clear();
    n_slices_ = 0;
    owner_.reset();
  }
  /// Appends to the body, at most kMaxSlices times; empty views are left out.
  void add(ByteView bytes) {
    if (bytes.empty()) return;
    assert(n_slices_ < kMaxSlices);
    slices_[n_slices_++] = bytes;
  }
  /// Holds the memory of the body's views until the answer is sent or copied. One owner an answer.
  void keep(std::shared_ptr<const void> owner) { owner_ = std::move(owner); }
  /// For the sender: the owner, handed over.
  std::shared_ptr<const void> take_owner() { return std::move(owner_); }
  /// What follows `lead`.
  std::span<const ByteView> slices() const { return {slices_.data(), n_slices_}; }
  /// Leaves `length` bytes of the body from `first` on. Precondition: they are there.
  void cut(std::uint64_t first, std::uint64_t length);

 private:
  std::array<ByteView, kMaxSlices> slices_;
  std::size_t n_slices_ = 0;
  std::shared_ptr<const void> owner_;
};

/// "Not Found" for 404 and so on.
std::string_view reason_phrase(int status);

/// Makes `out` an answer in one line of plain text. `more_fields`: whole header lines.
void text_response(Response& out, int status, std::string_view text, std::string_view more_fields = {});

/// Makes `out` a failure: problem details (RFC 9457) of type about:blank. `instance`: the address asked for, empty when
/// nobody knows. `more_fields`: whole header lines.
void problem_response(Response& out, int status, std::string_view detail, std::string_view instance = {},
                      std::string_view more_fields = {});

}  // namespace tind
