// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/write_batch.hpp"

#include <algorithm>
#include <charconv>

namespace tind {
namespace {

void append_number(std::string& out, std::uint64_t value) {
  char digits[20];
  const auto end = std::to_chars(digits, digits + sizeof digits, value).ptr;
  out.append(digits, static_cast<std::size_t>(end - digits));
}

// Asks for the lines of a body that is about to be sent: they come while its head is put together and the kernel makes
// ready, and not one after another when it copies them.
void fetch(ByteView bytes) {
  constexpr std::size_t kLineBytes = 64, kMostBytes = 16384;
  const std::size_t n_bytes = std::min(bytes.size(), kMostBytes);
  for (std::size_t at = 0; at < n_bytes; at += kLineBytes) __builtin_prefetch(bytes.data() + at, 0, 2);
}

}  // namespace

void WriteBatch::add(Response& response, std::string_view common, bool keep_alive) {
  for (const ByteView slice : response.slices()) fetch(slice);
  const std::size_t before = copied_.size();
  copied_ += "HTTP/1.1 ";
  append_number(copied_, static_cast<std::uint64_t>(response.status));
  copied_ += ' ';
  copied_ += reason_phrase(response.status);
  copied_ += "\r\n";
  copied_ += common;
  copied_ += response.fields;
  if (response.content_length) {
    copied_ += "Content-Length: ";
    append_number(copied_, *response.content_length);
    copied_ += "\r\n";
  }
  copied_ += keep_alive ? "Connection: keep-alive\r\n\r\n" : "Connection: close\r\n\r\n";
  copied_ += response.lead;
  const std::size_t n_head = copied_.size() - before;
  add_copied(n_head);
  for (const ByteView slice : response.slices()) {
    if (slice.size() <= kCopiedBytes) {
      copied_.append(reinterpret_cast<const char*>(slice.data()), slice.size());
      add_copied(slice.size());
    } else {
      parts_.push_back({slice.data(), slice.size()});
    }
    n_bytes_ += slice.size();
  }
  n_bytes_ += n_head;
  if (auto owner = response.take_owner()) owners_.push_back(std::move(owner));
}

void WriteBatch::add_copied(std::size_t n) {
  if (!parts_.empty() && !parts_.back().body) {
    parts_.back().n += n;
  } else {
    parts_.push_back({nullptr, n});
  }
}

std::span<const iovec> WriteBatch::buffers() {
  buffers_.clear();
  const char* head = copied_.data();
  for (const Part& part : parts_) {
    const void* data = part.body ? static_cast<const void*>(part.body) : head;
    if (!part.body) head += part.n;
    buffers_.push_back({const_cast<void*>(data), part.n});
  }
  return buffers_;
}

void WriteBatch::copy_rest(std::size_t n_sent, std::string& out) const {
  out.reserve(out.size() + n_bytes_ - n_sent);
  const char* head = copied_.data();
  for (const Part& part : parts_) {
    const char* data = part.body ? reinterpret_cast<const char*>(part.body) : head;
    if (!part.body) head += part.n;
    const std::size_t skip = std::min(n_sent, part.n);
    n_sent -= skip;
    out.append(data + skip, part.n - skip);
  }
}

void WriteBatch::clear() {
  copied_.clear();
  parts_.clear();
  owners_.clear();
  n_bytes_ = 0;
}

}  // namespace tind
