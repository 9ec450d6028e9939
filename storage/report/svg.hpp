// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "core/format/bytes.hpp"

namespace tind {

/// A point of a drawing, in pixels from its upper left corner.
struct SvgPoint {
  double x = 0, y = 0;
};

/// How a line is drawn.
struct SvgStroke {
  std::string_view colour = "#000000";
  double width = 1;
  std::string_view dashes = {};  ///< As stroke-dasharray; empty: a full line.
};

enum class SvgAnchor { kStart, kMiddle, kEnd };

/// How a text is set.
struct SvgFont {
  double size = 12;
  std::string_view colour = "#333333";
  SvgAnchor anchor = SvgAnchor::kStart;
  bool bold = false;
  double rotate_deg = 0;  ///< About the text's own place.
};

/// A drawing that grows by its elements, later ones on top. Texts may hold any characters.
class Svg {
 public:
  Svg(double width, double height) : width_(width), height_(height) {}

  void rectangle(SvgPoint corner, double width, double height, std::string_view fill,
                 const SvgStroke& stroke = {"none", 0});
  void line(SvgPoint from, SvgPoint to, const SvgStroke& stroke);
  void polyline(const std::vector<SvgPoint>& points, const SvgStroke& stroke);
  void circle(SvgPoint centre, double radius, std::string_view fill, const SvgStroke& stroke);
  void text(SvgPoint at, std::string_view words, const SvgFont& font);
  /// A PNG file's bytes, stretched over a rectangle.
  void image(SvgPoint corner, double width, double height, ByteView png);

  /// The whole file.
  std::string str() const;

 private:
  double width_, height_;
  std::string body_;
};

}  // namespace tind
