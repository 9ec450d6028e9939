// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <sys/uio.h>

#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "server/response.hpp"

namespace tind {

/// The answers that go out in one gathered write: their heads, and views of their bodies. Used again and again; takes
/// no memory once it has grown to its size.
class WriteBatch {
 public:
  /// Most buffers that one write takes (well below the system's IOV_MAX).
  static constexpr std::size_t kMaxBuffers = 64;

  bool empty() const { return parts_.empty(); }
  std::size_t n_bytes() const { return n_bytes_; }
  /// Whether any answer may still be added, and the batch is not so large that others should wait for it.
  bool has_room() const { return parts_.size() + 1 + Response::kMaxSlices <= kMaxBuffers && n_bytes_ < kEnoughBytes; }

  /// Adds an answer: status line, `common` fields (whole lines), its own, Content-Length and Connection, then its body.
  /// Precondition: has_room().
  void add(Response& response, std::string_view common, bool keep_alive);
  /// What to write. Valid until the next add() or clear().
  std::span<const iovec> buffers();
  /// Appends all but the first `n_sent` bytes to `out`.
  void copy_rest(std::size_t n_sent, std::string& out) const;
  /// Lets go of all bodies.
  void clear();

 private:
  static constexpr std::size_t kEnoughBytes = std::size_t{1} << 20;
  static constexpr std::size_t kCopiedBytes = 256;  // below, a buffer of its own costs more than the copy
  struct Part {
    const std::uint8_t* body;  // nullptr: the next n bytes of copied_
    std::size_t n;
  };

  void add_copied(std::size_t n);

  std::string copied_;  // heads and small pieces
  std::vector<Part> parts_;
  std::vector<iovec> buffers_;
  std::vector<std::shared_ptr<const void>> owners_;
  std::size_t n_bytes_ = 0;
};

}  // namespace tind
