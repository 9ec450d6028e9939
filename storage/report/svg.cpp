// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/report/svg.hpp"

#include <cstdint>

#include <fmt/format.h>

namespace tind {
namespace {

/// Length of the UTF-8 character that starts at `i`; 0: none starts there.
std::size_t utf8_length(std::string_view words, std::size_t i) {
  const auto lead = static_cast<unsigned char>(words[i]);
  const std::size_t n = lead < 0x80 ? 1 : lead >> 5 == 6 ? 2 : lead >> 4 == 14 ? 3 : lead >> 3 == 30 ? 4 : 0;
  for (std::size_t k = 1; k < n; ++k) {
    if (i + k >= words.size() || static_cast<unsigned char>(words[i + k]) >> 6 != 2) return 0;
  }
  return n;
}

/// Text for XML: its five special characters escaped, control characters (which XML has no way to write) left out,
/// bytes that are no UTF-8 (file names may hold them) as question marks.
std::string escape(std::string_view words) {
  std::string out;
  for (std::size_t i = 0; i < words.size(); ++i) {
    const std::size_t n = utf8_length(words, i);
    if (n != 1) {
      out += n ? words.substr(i, n) : "?";
      i += n ? n - 1 : 0;
      continue;
    }
    const char c = words[i];
    switch (c) {
      case '&':
        out += "&amp;";
        break;
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      case '"':
        out += "&quot;";
        break;
      case '\'':
        out += "&apos;";
        break;
      default:
        if (c >= 0x20) out += c;
    }
  }
  return out;
}

std::string base64(ByteView bytes) {
  constexpr std::string_view kDigits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  out.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const std::size_t n = bytes.size() - i;
    const auto at = [&](std::size_t k) { return k < n ? std::uint32_t{bytes[i + k]} : 0u; };
    const std::uint32_t group = at(0) << 16 | at(1) << 8 | at(2);
    for (std::size_t k = 0; k < 4; ++k) out += k <= n ? kDigits[group >> (18 - 6 * k) & 63] : '=';
  }
  return out;
}

std::string stroke_text(const SvgStroke& stroke) {
  std::string out = fmt::format("stroke=\"{}\" stroke-width=\"{:.2f}\"", stroke.colour, stroke.width);
  if (!stroke.dashes.empty()) out += fmt::format(" stroke-dasharray=\"{}\"", stroke.dashes);
  return out;
}

}  // namespace

void Svg::rectangle(SvgPoint corner, double width, double height, std::string_view fill, const SvgStroke& stroke) {
  body_ += fmt::format("<rect x=\"{:.2f}\" y=\"{:.2f}\" width=\"{:.2f}\" height=\"{:.2f}\" fill=\"{}\" {}/>\n",
                       corner.x, corner.y, width, height, fill, stroke_text(stroke));
}

void Svg::line(SvgPoint from, SvgPoint to, const SvgStroke& stroke) {
  body_ += fmt::format("<line x1=\"{:.2f}\" y1=\"{:.2f}\" x2=\"{:.2f}\" y2=\"{:.2f}\" {}/>\n", from.x, from.y, to.x,
                       to.y, stroke_text(stroke));
}

void Svg::polyline(const std::vector<SvgPoint>& points, const SvgStroke& stroke) {
  std::string list;
  for (const SvgPoint& p : points) list += fmt::format("{:.2f},{:.2f} ", p.x, p.y);
  body_ +=
      fmt::format("<polyline points=\"{}\" fill=\"none\" stroke-linejoin=\"round\" {}/>\n", list, stroke_text(stroke));
}

void Svg::circle(SvgPoint centre, double radius, std::string_view fill, const SvgStroke& stroke) {
  body_ += fmt::format("<circle cx=\"{:.2f}\" cy=\"{:.2f}\" r=\"{:.2f}\" fill=\"{}\" {}/>\n", centre.x, centre.y,
                       radius, fill, stroke_text(stroke));
}

void Svg::text(SvgPoint at, std::string_view words, const SvgFont& font) {
  const std::string_view anchor = font.anchor == SvgAnchor::kStart    ? "start"
                                  : font.anchor == SvgAnchor::kMiddle ? "middle"
                                                                      : "end";
  std::string turn;
  if (font.rotate_deg != 0)
    turn = fmt::format(" transform=\"rotate({:.0f} {:.2f} {:.2f})\"", font.rotate_deg, at.x, at.y);
  body_ += fmt::format(
      "<text x=\"{:.2f}\" y=\"{:.2f}\" font-size=\"{:.1f}\" fill=\"{}\" text-anchor=\"{}\"{}{}>{}</text>\n", at.x, at.y,
      font.size, font.colour, anchor, font.bold ? " font-weight=\"600\"" : "", turn, escape(words));
}

void Svg::image(SvgPoint corner, double width, double height, ByteView png) {
  body_ += fmt::format(
      "<image x=\"{:.2f}\" y=\"{:.2f}\" width=\"{:.2f}\" height=\"{:.2f}\" preserveAspectRatio=\"none\" "
      "href=\"data:image/png;base64,{}\"/>\n",
      corner.x, corner.y, width, height, base64(png));
}

std::string Svg::str() const {
  return fmt::format(
             "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{0:.0f}\" "
             "height=\"{1:.0f}\" viewBox=\"0 0 {0:.0f} {1:.0f}\" font-family=\"Helvetica, Arial, sans-serif\">\n",
             width_, height_) +
         body_ + "</svg>\n";
}

}  // namespace tind
