// SPDX-License-Identifier: GPL-3.0-or-later
// usage: make_world NAME.tind [INNER_VERTICES]
// Writes the pyramid of the server's tests (ten tiles) for the scripts that need one: INNER_VERTICES a side (default
// 60) say how large its tiles are, and which bytes they have.
#include <gtest/gtest.h>

#include <cstdio>
#include <cstdlib>

#include "tests/server/test_site.hpp"

int main(int argc, char** argv) {
  if (argc < 2 || argc > 3) {
    std::fprintf(stderr, "usage: make_world NAME.tind [INNER_VERTICES]\n");
    return 2;
  }
  const long n_side = argc == 3 ? std::strtol(argv[2], nullptr, 10) : 60;
  if (n_side < 1 || n_side > 20000) {
    std::fprintf(stderr, "make_world: not from 1 to 20000: %s\n", argv[2]);
    return 2;
  }
  tind::test::write_pyramid(argv[1], static_cast<std::uint32_t>(n_side));
  return testing::Test::HasFailure() ? 1 : 0;
}
