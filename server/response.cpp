// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/response.hpp"

#include <algorithm>
#include <charconv>

namespace tind {
namespace {

struct Phrase {
  int status;
  std::string_view text;
};
constexpr std::array<Phrase, 17> kPhrases = {{
    {200, "OK"},
    {204, "No Content"},
    {206, "Partial Content"},
    {304, "Not Modified"},
    {308, "Permanent Redirect"},
    {400, "Bad Request"},
    {404, "Not Found"},
    {405, "Method Not Allowed"},
    {408, "Request Timeout"},
    {412, "Precondition Failed"},
    {414, "URI Too Long"},
    {416, "Range Not Satisfiable"},
    {431, "Request Header Fields Too Large"},
    {500, "Internal Server Error"},
    {501, "Not Implemented"},
    {503, "Service Unavailable"},
    {505, "HTTP Version Not Supported"},
}};

// Appends `text` with what a JSON string cannot hold escaped. Bytes above 127 become "?": addresses have none.
void append_json(std::string& out, std::string_view text) {
  for (const char c : text) {
    if (c == '"' || c == '\\') out += '\\';
    out += c >= ' ' && c < 0x7f ? c : '?';
  }
}

}  // namespace

void Response::cut(std::uint64_t first, std::uint64_t length) {
  const auto from_lead = std::min<std::uint64_t>(first, lead.size());
  lead.erase(0, static_cast<std::size_t>(from_lead));
  first -= from_lead;
  if (lead.size() > length) lead.resize(static_cast<std::size_t>(length));
  length -= lead.size();
  std::size_t n_left = 0;
  for (const ByteView slice : slices()) {
    const auto skip = std::min<std::uint64_t>(first, slice.size());
    const auto take = std::min<std::uint64_t>(length, slice.size() - skip);
    first -= skip;
    length -= take;
    if (take > 0) slices_[n_left++] = slice.subspan(static_cast<std::size_t>(skip), static_cast<std::size_t>(take));
  }
  n_slices_ = n_left;
}

std::string_view reason_phrase(int status) {
  const auto found =
      std::find_if(kPhrases.begin(), kPhrases.end(), [&](const Phrase& phrase) { return phrase.status == status; });
  return found == kPhrases.end() ? std::string_view() : found->text;
}

void text_response(Response& out, int status, std::string_view text, std::string_view more_fields) {
  out.reset();
  out.status = status;
  out.fields.append("Content-Type: text/plain; charset=utf-8\r\nX-Content-Type-Options: nosniff\r\n")
      .append(more_fields);
  out.lead.append(text).append("\n");
  out.content_length = out.lead.size();
}

void problem_response(Response& out, int status, std::string_view detail, std::string_view instance,
                      std::string_view more_fields) {
  std::array<char, 8> digits;
  const auto end = std::to_chars(digits.data(), digits.data() + digits.size(), status).ptr;
  out.reset();
  out.status = status;
  out.fields.append("Content-Type: application/problem+json\r\nX-Content-Type-Options: nosniff\r\n")
      .append(more_fields);
  out.lead.append("{\"type\":\"about:blank\",\"title\":\"").append(reason_phrase(status));
  out.lead.append("\",\"status\":").append(digits.data(), end).append(",\"detail\":\"");
  append_json(out.lead, detail);
  if (!instance.empty()) {
    out.lead.append("\",\"instance\":\"");
    append_json(out.lead, instance);
  }
  out.lead.append("\"}\n");
  out.content_length = out.lead.size();
}

}  // namespace tind
