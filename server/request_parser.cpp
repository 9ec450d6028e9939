// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/request_parser.hpp"

#include <algorithm>
#include <charconv>

namespace tind {
namespace {

constexpr int kBadRequest = 400, kUriTooLong = 414, kNotImplemented = 501, kVersionNotSupported = 505;
constexpr std::string_view kEndOfLine = "\r\n";

// One bit per class of byte.
constexpr std::uint8_t kToken = 1, kTarget = 2, kValue = 4, kHost = 8;

constexpr std::array<std::uint8_t, 256> make_classes() {
  std::array<std::uint8_t, 256> classes{};
  for (std::size_t c = 0; c < classes.size(); ++c) {
    const bool letter = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z'), digit = c >= '0' && c <= '9';
    std::uint8_t set = 0;
    const auto among = [&](std::string_view text) { return c < 128 && text.find(static_cast<char>(c)) != text.npos; };
    if (letter || digit || among("!#$%&'*+-.^_`|~")) set |= kToken;     // RFC 9110, 5.6.2
    if (c > ' ' && c < 0x7f) set |= kTarget;                            // RFC 3986 narrows it further
    if (c == '\t' || (c >= ' ' && c != 0x7f)) set |= kValue;            // RFC 9110, 5.5
    if (letter || digit || among("-._~!$&'()*+,;=%[]:")) set |= kHost;  // RFC 3986, 3.2.2 and 3.2.3
    classes[c] = set;
  }
  return classes;
}
constexpr auto kClasses = make_classes();

bool all_are(std::string_view text, std::uint8_t wanted) {
  return std::all_of(text.begin(), text.end(),
                     [&](char c) { return (kClasses[static_cast<unsigned char>(c)] & wanted) != 0; });
}

char lower(char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c + ('a' - 'A')) : c; }

bool equals(std::string_view text, std::string_view lower_case) {
  return text.size() == lower_case.size() &&
         std::equal(text.begin(), text.end(), lower_case.begin(), [](char a, char b) { return lower(a) == b; });
}

std::string_view trim(std::string_view text) {
  while (!text.empty() && (text.front() == ' ' || text.front() == '\t')) text.remove_prefix(1);
  while (!text.empty() && (text.back() == ' ' || text.back() == '\t')) text.remove_suffix(1);
  return text;
}

// uri-host [":" port] (RFC 9110, 7.2): the port has digits only, and colons before it are an IPv6 address's.
bool is_host(std::string_view text) {
  if (!all_are(text, kHost)) return false;
  const std::size_t bracket = text.rfind(']');
  const std::string_view after = bracket == text.npos ? text : text.substr(bracket + 1);
  const std::size_t colon = after.find(':');
  if (bracket != text.npos && colon != 0 && !after.empty()) return false;
  return colon == after.npos || after.find_first_not_of("0123456789", colon + 1) == after.npos;
}

template <class Use>
void for_each_element(std::string_view list, Use&& use) {
  while (!list.empty()) {
    const std::size_t comma = std::min(list.find(','), list.size());
    use(trim(list.substr(0, comma)));
    list.remove_prefix(std::min(comma + 1, list.size()));
  }
}

struct NamedField {
  std::string_view name;  // lower case
  RequestField field;
};
constexpr std::array<NamedField, kRequestFields> kNamedFields = {{
    {"host", RequestField::kHost},
    {"accept", RequestField::kAccept},
    {"accept-encoding", RequestField::kAcceptEncoding},
    {"if-match", RequestField::kIfMatch},
    {"if-none-match", RequestField::kIfNoneMatch},
    {"if-modified-since", RequestField::kIfModifiedSince},
    {"if-unmodified-since", RequestField::kIfUnmodifiedSince},
    {"if-range", RequestField::kIfRange},
    {"range", RequestField::kRange},
    {"origin", RequestField::kOrigin},
    {"forwarded", RequestField::kForwarded},
    {"x-forwarded-for", RequestField::kForwardedFor},
    {"x-forwarded-proto", RequestField::kForwardedProto},
    {"x-forwarded-host", RequestField::kForwardedHost},
    {"x-forwarded-prefix", RequestField::kForwardedPrefix},
    {"user-agent", RequestField::kUserAgent},
    {"referer", RequestField::kReferer},
}};

// What the framing of the message depends on.
struct Framing {
  int n_hosts = 0, n_content_lengths = 0, n_transfer_encodings = 0;
  bool host_is_plain = true, content_length_is_number = true;
  bool wants_close = false, wants_keep_alive = false;
  std::string_view transfer_encoding;
};

// Digits only (RFC 9110, 8.6): no sign, no list, nothing that overflows.
bool parse_length(std::string_view text, std::uint64_t& length) {
  const char* const last = text.data() + text.size();
  const bool digits =
      !text.empty() && std::all_of(text.begin(), text.end(), [](char c) { return c >= '0' && c <= '9'; });
  const auto [end, error] = std::from_chars(text.data(), last, length);
  return digits && error == std::errc() && end == last;
}

// "GET /x HTTP/1.1": 0, or the status to refuse with.
int parse_request_line(std::string_view line, ParsedRequest& out) {
  const std::size_t first = line.find(' '), last = line.rfind(' ');
  if (first == line.npos || first == last) return kBadRequest;
  Request& request = out.request;
  request.method = line.substr(0, first);
  request.target = line.substr(first + 1, last - first - 1);
  if (request.method.empty() || !all_are(request.method, kToken)) return kBadRequest;
  if (request.target.empty() || !all_are(request.target, kTarget)) return kBadRequest;
  const std::string_view version = line.substr(last + 1);
  const auto digit = [&](std::size_t k) { return version[k] >= '0' && version[k] <= '9'; };
  if (version.size() != 8 || !version.starts_with("HTTP/") || !digit(5) || version[6] != '.' || !digit(7)) {
    return kBadRequest;
  }
  if (version[5] != '1') return kVersionNotSupported;
  out.minor_version = version[7] == '0' ? 0 : 1;  // a higher minor version is ours (RFC 9110, 2.5)
  return request.target.size() > kMaxTargetBytes ? kUriTooLong : 0;
}

void note_framing(std::string_view name, std::string_view value, ParsedRequest& out, Framing& framing) {
  if (equals(name, "connection")) {
    for_each_element(value, [&](std::string_view option) {
      framing.wants_close |= equals(option, "close");
      framing.wants_keep_alive |= equals(option, "keep-alive");
    });
  } else if (equals(name, "content-length")) {
    ++framing.n_content_lengths;
    framing.content_length_is_number &= parse_length(value, out.content_length);
  } else if (equals(name, "transfer-encoding")) {
    ++framing.n_transfer_encodings;
    framing.transfer_encoding = value;
  } else if (equals(name, "expect")) {
    out.expects_continue = true;
  }
}

// RFC 9112, 6.1 and 6.3. 0, or the status to refuse with.
int check_transfer_encoding(const Framing& framing, ParsedRequest& out) {
  if (framing.n_transfer_encodings > 1 || framing.n_content_lengths > 0 || out.minor_version == 0) return kBadRequest;
  int n_chunked = 0;
  bool chunked_is_last = false, empty = true;
  for_each_element(framing.transfer_encoding, [&](std::string_view coding) {
    chunked_is_last = equals(coding, "chunked");
    n_chunked += chunked_is_last ? 1 : 0;
    empty &= coding.empty();
  });
  if (empty || n_chunked > 1) return kBadRequest;
  if (!equals(framing.transfer_encoding, "chunked")) return kNotImplemented;
  out.chunked = true;
  return 0;
}

}  // namespace

std::size_t leading_empty_lines(std::string_view bytes) {
  std::size_t at = 0;
  while (bytes.substr(at).starts_with(kEndOfLine)) at += kEndOfLine.size();
  return at;
}

std::variant<ParsedRequest, int> parse_request(std::string_view block, FieldScratch& scratch) {
  if (!block.ends_with("\r\n\r\n")) return kBadRequest;
  block.remove_suffix(kEndOfLine.size());
  const auto take_line = [&]() -> std::string_view {
    const std::size_t end = block.find(kEndOfLine);
    const std::string_view line = block.substr(0, end);
    block.remove_prefix(end + kEndOfLine.size());
    return line;
  };
  std::variant<ParsedRequest, int> result;
  ParsedRequest& out = std::get<ParsedRequest>(result);
  if (const int status = parse_request_line(take_line(), out)) return status;
  Framing framing;
  while (!block.empty()) {
    const std::string_view line = take_line();
    // An empty name is a line that begins with a colon; one with a blank in it is obs-fold, or a blank before the
    // colon.
    const std::size_t colon = line.find(':');
    if (colon == line.npos || colon == 0 || !all_are(line.substr(0, colon), kToken)) return kBadRequest;
    const std::string_view name = line.substr(0, colon), value = trim(line.substr(colon + 1));
    if (!all_are(value, kValue)) return kBadRequest;
    const auto known = std::find_if(kNamedFields.begin(), kNamedFields.end(),
                                    [&](const NamedField& f) { return equals(name, f.name); });
    if (known == kNamedFields.end()) {
      note_framing(name, value, out, framing);
      continue;
    }
    if (known->field == RequestField::kHost) {
      ++framing.n_hosts;
      framing.host_is_plain &= is_host(value);
    }
    auto& field = out.request[known->field];
    if (field) {
      // Lines of one name are one list (RFC 9110, 5.3).
      std::string& joined = scratch[static_cast<std::size_t>(known->field)];
      if (field->data() != joined.data()) joined = *field;
      joined.append(", ").append(value);
      field = joined;
    } else {
      field = value;
    }
  }
  if (framing.n_hosts > 1 || (out.minor_version > 0 && framing.n_hosts == 0) || !framing.host_is_plain) {
    return kBadRequest;
  }
  if (framing.n_content_lengths > 1 || !framing.content_length_is_number) return kBadRequest;
  if (framing.n_transfer_encodings > 0) {
    if (const int status = check_transfer_encoding(framing, out)) return status;
  }
  out.keep_alive = !framing.wants_close && (out.minor_version > 0 || framing.wants_keep_alive);
  return result;
}

}  // namespace tind
