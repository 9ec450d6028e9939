// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/noding.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <random>
#include <set>
#include <utility>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace tind {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using Xy = std::pair<std::int64_t, std::int64_t>;
__extension__ using Int128 = __int128;

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

LatticeLine line(std::initializer_list<Xy> points, double height_m = kNone) {
  LatticeLine out;
  for (const auto& [x, y] : points) out.push_back({x, y, height_m});
  return out;
}

std::vector<Xy> points(const LatticeLine& l) {
  std::vector<Xy> out;
  for (const BreakVertex& v : l) out.emplace_back(v.x, v.y);
  return out;
}

std::string text(const std::vector<Xy>& l) {
  std::string out;
  for (const auto& [x, y] : l) out += fmt::format("{}{},{}", out.empty() ? "" : " ", x, y);
  return out;
}

std::vector<std::string> texts(const NodedLines& noded) {
  std::vector<std::string> out;
  for (const NodedPiece& p : noded.pieces) out.push_back(text(points(p.vertices)));
  return out;
}

int side(Xy a, Xy b, Xy c) {
  const Int128 v = static_cast<Int128>(b.first - a.first) * (c.second - a.second) -
                   static_cast<Int128>(b.second - a.second) * (c.first - a.first);
  return v > 0 ? 1 : v < 0 ? -1 : 0;
}

bool within(Xy a, Xy b, Xy p) {
  return side(a, b, p) == 0 && p != a && p != b && std::min(a.first, b.first) <= p.first &&
         p.first <= std::max(a.first, b.first) && std::min(a.second, b.second) <= p.second &&
         p.second <= std::max(a.second, b.second);
}

/// Whether two segments share more than end points.
bool conflict(Xy a, Xy b, Xy c, Xy d) {
  if ((a == c && b == d) || (a == d && b == c)) return true;
  if (within(a, b, c) || within(a, b, d) || within(c, d, a) || within(c, d, b)) return true;
  return side(a, b, c) * side(a, b, d) < 0 && side(c, d, a) * side(c, d, b) < 0;
}

/// Says what is wrong with noded lines; nothing: all is well. Quadratic.
std::string fault(const std::vector<NodedPiece>& pieces) {
  std::vector<std::pair<Xy, Xy>> segments;
  std::map<Xy, int> inner;
  std::set<Xy> ends;
  for (const NodedPiece& piece : pieces) {
    const std::vector<Xy> p = points(piece.vertices);
    if (p.size() < 2) return "a piece of one vertex";
    if (piece.lines.empty()) return "a piece without a line: " + text(p);
    ends.insert(p.front());
    ends.insert(p.back());
    for (std::size_t i = 1; i < p.size(); ++i) {
      if (p[i - 1] == p[i]) return "a segment of no length: " + text(p);
      segments.emplace_back(p[i - 1], p[i]);
      if (i + 1 < p.size()) ++inner[p[i]];
    }
  }
  for (const auto& [p, n] : inner) {
    if (n > 1 || ends.contains(p)) return fmt::format("pieces meet within, at {},{}", p.first, p.second);
  }
  for (std::size_t i = 0; i < segments.size(); ++i) {
    for (std::size_t j = 0; j < i; ++j) {
      const auto& [a, b] = segments[i];
      const auto& [c, d] = segments[j];
      if (conflict(a, b, c, d)) return "segments meet within: " + text({a, b}) + " and " + text({c, d});
    }
  }
  return "";
}

double distance(Xy p, Xy a, Xy b) {
  const double dx = static_cast<double>(b.first - a.first), dy = static_cast<double>(b.second - a.second);
  const double px = static_cast<double>(p.first - a.first), py = static_cast<double>(p.second - a.second);
  const double t = std::clamp((px * dx + py * dy) / (dx * dx + dy * dy), 0.0, 1.0);
  return std::hypot(px - t * dx, py - t * dy);
}

std::vector<LatticeLine> random_lines(std::mt19937_64& random, std::int64_t size, int n) {
  std::vector<LatticeLine> out;
  const auto coordinate = [&] { return static_cast<std::int64_t>(random() % static_cast<std::uint64_t>(size)); };
  while (static_cast<int>(out.size()) < n) {
    LatticeLine l;
    const auto n_vertices = 2 + random() % 4;
    while (l.size() < n_vertices) {
      const BreakVertex v{coordinate(), coordinate(), kNone};
      if (l.empty() || v.x != l.back().x || v.y != l.back().y) l.push_back(v);
    }
    out.push_back(l);
  }
  return out;
}

TEST(Noding, CrossingLinesAreCutAtANode) {
  const std::vector<LatticeLine> lines{line({{0, 0}, {10, 10}}), line({{0, 10}, {10, 0}})};
  const auto noded = node_lines(lines);
  ASSERT_TRUE(noded);
  EXPECT_THAT(texts(*noded), ElementsAre("0,0 5,5", "0,10 5,5", "5,5 10,0", "5,5 10,10"));
  ASSERT_EQ(noded->meetings.size(), 1U);
  const LineMeeting& m = noded->meetings[0];
  EXPECT_EQ(std::make_tuple(m.x, m.y, m.a, m.b, m.shared_piece), std::make_tuple(5, 5, 0U, 1U, false));
}

TEST(Noding, TouchingLineCutsTheTouchedOne) {
  const std::vector<LatticeLine> lines{line({{0, 0}, {10, 0}}), line({{4, 9}, {4, 0}})};
  const auto noded = node_lines(lines);
  ASSERT_TRUE(noded);
  EXPECT_THAT(texts(*noded), ElementsAre("0,0 4,0", "4,9 4,0", "4,0 10,0"));
  EXPECT_EQ(noded->meetings.size(), 1U);
}

TEST(Noding, JoinedEndsAreNoMeeting) {
  const std::vector<LatticeLine> lines{line({{0, 0}, {5, 1}, {10, 0}}), line({{10, 0}, {20, 3}}),
                                       line({{10, 0}, {11, 30}})};
  const auto noded = node_lines(lines);
  ASSERT_TRUE(noded);
  EXPECT_THAT(texts(*noded), ElementsAre("0,0 5,1 10,0", "10,0 11,30", "10,0 20,3"));
  EXPECT_TRUE(noded->meetings.empty());
}

TEST(Noding, OverlappingStretchIsKeptOnce) {
  const std::vector<LatticeLine> lines{line({{0, 0}, {10, 0}}), line({{14, 0}, {4, 0}})};
  const auto noded = node_lines(lines);
  ASSERT_TRUE(noded);
  EXPECT_THAT(texts(*noded), ElementsAre("0,0 4,0", "4,0 10,0", "14,0 10,0"));
  EXPECT_THAT(noded->pieces[1].lines, ElementsAre(0U, 1U));
  EXPECT_THAT(noded->pieces[2].lines, ElementsAre(1U));
  ASSERT_EQ(noded->meetings.size(), 3U);  // both ends of the stretch, and the stretch
  EXPECT_TRUE(noded->meetings[2].shared_piece);
}

TEST(Noding, DuplicateLineIsKeptOnceInEitherDirection) {
  const std::vector<LatticeLine> lines{line({{0, 0}, {7, 3}, {10, 0}}), line({{10, 0}, {7, 3}, {0, 0}})};
  const auto noded = node_lines(lines);
  ASSERT_TRUE(noded);
  EXPECT_THAT(texts(*noded), ElementsAre("0,0 7,3 10,0"));
  EXPECT_THAT(noded->pieces[0].lines, ElementsAre(0U, 1U));
}

TEST(Noding, FigureEightMeetsItself) {
  const std::vector<LatticeLine> lines{line({{0, 0}, {10, 10}, {10, 0}, {0, 10}, {0, 0}})};
  const auto noded = node_lines(lines);
  ASSERT_TRUE(noded);
  EXPECT_EQ(fault(noded->pieces), "");
  ASSERT_EQ(noded->meetings.size(), 1U);
  EXPECT_EQ(noded->meetings[0].a, noded->meetings[0].b);
}

TEST(Noding, SpikeIsKeptOnce) {
  const std::vector<LatticeLine> lines{line({{0, 0}, {10, 0}, {4, 0}, {4, 8}})};
  const auto noded = node_lines(lines);
  ASSERT_TRUE(noded);
  EXPECT_EQ(fault(noded->pieces), "");
  EXPECT_THAT(texts(*noded), ElementsAre("0,0 4,0", "4,0 4,8", "4,0 10,0"));
  EXPECT_FALSE(noded->meetings.empty());
}

TEST(Noding, FreeRingStaysARingWhateverItsStart) {
  const std::vector<LatticeLine> a{line({{5, 0}, {9, 4}, {2, 7}, {5, 0}})};
  const std::vector<LatticeLine> b{line({{2, 7}, {9, 4}, {5, 0}, {2, 7}})};
  const auto first = node_lines(a), second = node_lines(b);
  ASSERT_TRUE(first && second);
  EXPECT_THAT(texts(*first), ElementsAre("2,7 5,0 9,4 2,7"));
  EXPECT_TRUE(first->meetings.empty());
  // The piece runs as its line does.
  EXPECT_THAT(texts(*second), ElementsAre("2,7 9,4 5,0 2,7"));
}

TEST(Noding, PieceRunsInTheDirectionOfItsFirstLine) {
  const std::vector<LatticeLine> lines{line({{10, 0}, {5, 1}, {0, 0}}), line({{5, -5}, {5, 5}})};
  const auto noded = node_lines(lines);
  ASSERT_TRUE(noded);
  EXPECT_THAT(texts(*noded), ElementsAre("5,1 0,0", "5,-5 5,1", "5,1 5,5", "10,0 5,1"));
}

TEST(Noding, NodeTakesTheLowestHeightThatPasses) {
  const std::vector<LatticeLine> lines{line({{0, 0}, {10, 0}}, 50), {{5, -5, 10}, {5, 5, 30}}, line({{5, 0}, {9, 9}})};
  const auto noded = node_lines(lines);
  ASSERT_TRUE(noded);
  for (const NodedPiece& piece : noded->pieces) {
    for (const BreakVertex& v : piece.vertices) {
      const double expected = v.x == 5 && v.y == 0    ? 20
                              : v.x == 5 && v.y == -5 ? 10
                              : v.x == 5 && v.y == 5  ? 30
                              : v.y == 0              ? 50
                                                      : kNone;
      EXPECT_TRUE(v.height_m == expected || (std::isnan(v.height_m) && std::isnan(expected))) << v.x << ' ' << v.y;
    }
  }
}

TEST(Noding, RandomLinesAreNodedAndStayWithinAStep) {
  std::mt19937_64 random(20);
  for (const std::int64_t size : {6, 40, 1000, 100'000'000}) {
    for (int run = 0; run < 60; ++run) {
      const std::vector<LatticeLine> lines = random_lines(random, size, 3 + run / 4);
      const auto noded = node_lines(lines);
      ASSERT_TRUE(noded);
      ASSERT_EQ(fault(noded->pieces), "") << "size " << size << ", run " << run;
      std::set<Xy> vertices;
      for (const NodedPiece& piece : noded->pieces) {
        for (const Xy& p : points(piece.vertices)) {
          vertices.insert(p);
          for (const std::uint32_t l : piece.lines) {
            double nearest = std::numeric_limits<double>::infinity();
            for (std::size_t i = 1; i < lines[l].size(); ++i)
              nearest = std::min(nearest, distance(p, points(lines[l])[i - 1], points(lines[l])[i]));
            ASSERT_LE(nearest, 0.7072) << "a piece leaves line " << l;
          }
        }
      }
      for (const LatticeLine& l : lines) {
        for (const Xy& p : points(l)) ASSERT_TRUE(vertices.contains(p)) << "an input vertex is lost";
      }
    }
  }
}

TEST(Noding, LinesThatNothingTouchesStayAmongOthersThatAreCut) {
  std::mt19937_64 random(23);
  for (int run = 0; run < 300; ++run) {
    // Short lines in a narrow field: some alone, some joined, some in each other's way by a step or two.
    std::vector<LatticeLine> lines;
    for (int i = 0; i < 14; ++i) {
      LatticeLine l{{static_cast<std::int64_t>(random() % 60), static_cast<std::int64_t>(random() % 60), kNone}};
      if (i > 0 && random() % 3 == 0) l[0] = random() % 2 == 0 ? lines.back().front() : lines.back().back();
      const auto n_vertices = 2 + random() % 3;
      while (l.size() < n_vertices) {
        BreakVertex v = l.back();
        v.x += static_cast<std::int64_t>(random() % 21) - 10;
        v.y += static_cast<std::int64_t>(random() % 21) - 10;
        if (v.x != l.back().x || v.y != l.back().y) l.push_back(v);
      }
      lines.push_back(l);
    }
    const auto together = node_lines(lines);
    ASSERT_TRUE(together);
    ASSERT_EQ(fault(together->pieces), "") << "run " << run;
    std::set<Xy> vertices;
    for (const NodedPiece& piece : together->pieces) {
      for (const Xy& p : points(piece.vertices)) vertices.insert(p);
    }
    for (const LatticeLine& l : lines) {
      for (const Xy& p : points(l)) ASSERT_TRUE(vertices.contains(p));
    }
  }
}

TEST(Noding, LinesApartNeedNoCutting) {
  // More lines than GEOS could node in the time of a test, joined in their ends.
  std::vector<LatticeLine> lines;
  for (std::int64_t r = 0; r < 300; ++r) {
    for (std::int64_t c = 0; c < 300; ++c) {
      lines.push_back(line({{c * 50, r * 50}, {c * 50 + 20, r * 50 + 5}, {c * 50 + 50, r * 50}}, 1));
      lines.push_back(line({{c * 50, r * 50}, {c * 50, r * 50 + 50}}, 2));
    }
  }
  const auto noded = node_lines(lines);
  ASSERT_TRUE(noded);
  EXPECT_EQ(noded->pieces.size(), lines.size());
  EXPECT_TRUE(noded->meetings.empty());
  for (const NodedPiece& piece : noded->pieces) ASSERT_EQ(piece.vertices.front().height_m, 1);
}

TEST(Noding, DoesNotDependOnOrderOrDirection) {
  std::mt19937_64 random(21);
  for (int run = 0; run < 40; ++run) {
    std::vector<LatticeLine> lines = random_lines(random, run % 2 == 0 ? 50 : 1'000'000, 15);
    const auto shapes = [](const NodedLines& noded) {
      std::set<std::vector<Xy>> out;
      for (const NodedPiece& piece : noded.pieces) {
        std::vector<Xy> p = points(piece.vertices);
        if (std::lexicographical_compare(p.rbegin(), p.rend(), p.begin(), p.end())) std::reverse(p.begin(), p.end());
        out.insert(std::move(p));
      }
      return out;
    };
    const auto before = node_lines(lines);
    std::shuffle(lines.begin(), lines.end(), random);
    for (LatticeLine& l : lines) {
      if (random() % 2 == 0) std::reverse(l.begin(), l.end());
    }
    const auto after = node_lines(lines);
    ASSERT_TRUE(before && after);
    EXPECT_EQ(shapes(*before), shapes(*after));
    EXPECT_EQ(before->meetings.size(), after->meetings.size());
  }
}

TEST(Noding, FindsWhatIsWrongWithUnnodedLines) {  // the check itself
  const auto pieces = [](const std::vector<LatticeLine>& lines) {
    std::vector<NodedPiece> out;
    for (const LatticeLine& l : lines) out.push_back({l, {0}});
    return out;
  };
  EXPECT_THAT(fault(pieces({line({{0, 0}, {4, 4}}), line({{0, 4}, {4, 0}})})), HasSubstr("segments meet"));
  EXPECT_THAT(fault(pieces({line({{0, 0}, {4, 0}}), line({{2, 0}, {2, 5}})})), HasSubstr("segments meet"));
  EXPECT_THAT(fault(pieces({line({{0, 0}, {4, 0}, {8, 1}}), line({{4, 0}, {2, 5}})})), HasSubstr("pieces meet"));
}

TEST(Noding, TooManyCrossingsAreRefusedBeforeMemoryIsTaken) {
  std::vector<LatticeLine> lines;
  for (std::int64_t i = 0; i < 2100; ++i) {
    lines.push_back(line({{i * 1000, -1}, {i * 1000 + 3, 3'000'000}}));
    lines.push_back(line({{-1, i * 1000 + 7}, {3'000'000, i * 1000}}));
  }
  const auto noded = node_lines(lines);
  ASSERT_FALSE(noded);
  EXPECT_EQ(noded.error().kind, ErrorKind::kInvalidInput);
  EXPECT_THAT(noded.error().message, HasSubstr("cross each other more than 4000000 times"));
}

TEST(Noding, NoLinesNoPieces) {
  const auto noded = node_lines({});
  ASSERT_TRUE(noded);
  EXPECT_TRUE(noded->pieces.empty());
}

}  // namespace
}  // namespace tind
