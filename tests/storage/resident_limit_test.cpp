// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/resident_limit.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstring>
#include <filesystem>
#include <thread>
#include <vector>

#include "storage/readers/scratch_map.hpp"

namespace tind {
namespace {

constexpr std::uint64_t kMb = std::uint64_t{1} << 20;
constexpr std::size_t kPage = 4096;
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
constexpr bool kSanitized = true;
#else
constexpr bool kSanitized = false;
#endif

ScratchMap make_map(std::uint64_t n_bytes) {
  auto map = ScratchMap::create(std::filesystem::temp_directory_path().string(), n_bytes);
  EXPECT_TRUE(map) << map.error().message;
  return std::move(*map);
}

TEST(ResidentLimit, ResidentMemoryIsMeasured) {
  const auto before = resident_bytes();
  ASSERT_TRUE(before);
  const std::vector<char> memory(64 * kMb, 1);
  EXPECT_GE(*resident_bytes(), *before + 60 * kMb) << memory[0];
}

TEST(ResidentLimit, AReleasedMapKeepsWhatWasWritten) {
  const ScratchMap map = make_map(64 * kMb);
  auto* const bytes = static_cast<unsigned char*>(map.data());
  for (std::size_t i = 0; i < 64 * kMb; i += kPage) bytes[i] = static_cast<unsigned char>(i / kPage * 7 + 1);
  const std::uint64_t full = *resident_bytes();
  release_resident_maps();
  EXPECT_LE(*resident_bytes(), full - 60 * kMb);
  for (std::size_t i = 0; i < 64 * kMb; i += kPage) {
    ASSERT_EQ(bytes[i], static_cast<unsigned char>(i / kPage * 7 + 1)) << i;
  }
}

TEST(ResidentLimit, AMapThatIsGoneIsLeftAlone) {
  const std::uint64_t before = *resident_bytes();
  { const ScratchMap map = make_map(16 * kMb); }
  // Its address may be other memory by now.
  const std::vector<char> memory(16 * kMb, 5);
  release_resident_maps();
  EXPECT_EQ(std::count(memory.begin(), memory.end(), 5), static_cast<std::ptrdiff_t>(16 * kMb));
  EXPECT_GE(*resident_bytes(), before + 15 * kMb);
}

TEST(ResidentLimit, KeepsThreadsThatWriteLargeMapsNearTheLimit) {
  constexpr std::uint64_t kMapBytes = 160 * kMb;
  const ScratchMap first = make_map(kMapBytes), second = make_map(kMapBytes);
  const std::uint64_t limit = *resident_bytes() + 64 * kMb;
  ResidentLimit resident_limit(limit);
  std::atomic<int> n_running{2};
  const auto fill = [&](const ScratchMap& map, unsigned seed) {
    auto* const words = static_cast<std::uint64_t*>(map.data());
    const std::size_t n = kMapBytes / sizeof(std::uint64_t);
    for (std::size_t i = 0; i < n; ++i) words[i] = i * 2654435761u + seed;
    --n_running;
  };
  std::jthread a([&] { fill(first, 1); }), b([&] { fill(second, 2); });
  std::uint64_t highest = 0;
  while (n_running > 0) {
    highest = std::max(highest, *resident_bytes());
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  EXPECT_GE(resident_limit.n_releases(), 2u);
  // Sanitizers keep several bytes of their own for each of a map.
  if (!kSanitized) {
    EXPECT_LT(highest, limit + 96 * kMb);
  }
  for (const auto& [map, seed] : {std::pair{&first, 1u}, {&second, 2u}}) {
    const auto* const words = static_cast<const std::uint64_t*>(map->data());
    for (std::size_t i = 0; i < kMapBytes / sizeof(std::uint64_t); i += 61) {
      ASSERT_EQ(words[i], i * 2654435761u + seed) << i;
    }
  }
}

TEST(ResidentLimit, MemoryThatIsNoMapLeavesMapsSomeRoom) {
  const ScratchMap map = make_map(8 * kMb);
  ResidentLimit resident_limit(1);
  auto* const bytes = static_cast<unsigned char*>(map.data());
  for (int round = 0; round < 20; ++round) {
    for (std::size_t i = 0; i < 8 * kMb; i += kPage) ++bytes[i];
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  EXPECT_LE(resident_limit.n_releases(), 2u) << "8 MB fit into the room";
  EXPECT_EQ(bytes[0], 20);
}

}  // namespace
}  // namespace tind
