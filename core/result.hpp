// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>
#include <tl/expected.hpp>
#include <utility>

namespace tind {

/// The few kinds of failure that callers tell apart. Everything else is in the message.
enum class ErrorKind {
  kInvalidInput,  ///< What the user gave is wrong: options, rasters, requests.
  kNotFound,      ///< Nothing under that name or key.
  kCorrupt,       ///< Bytes that do not follow docs/format.md.
  kIo,            ///< The operating system refused: permission, full disk, broken file.
  kUnsupported,   ///< Right in itself, but this version cannot do it.
  kInterrupted,   ///< The user asked to stop.
};

/// A failure: `message` says what failed, where, and what to try, in one line without a final full stop.
struct Error {
  ErrorKind kind;
  std::string message;
};

/// A value or an Error. Functions that can fail on user data return one; misuse by the programmer is an assert.
template <class T>
using Result = tl::expected<T, Error>;

/// Shorthand for returning a failure: `return fail(ErrorKind::kIo, "...")`.
inline tl::unexpected<Error> fail(ErrorKind kind, std::string message) {
  return tl::unexpected<Error>(Error{kind, std::move(message)});
}

}  // namespace tind
