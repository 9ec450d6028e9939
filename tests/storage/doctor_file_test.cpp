// SPDX-License-Identifier: GPL-3.0-or-later
// Damage beyond single records: which records there are, their frames, the manifest, LMDB's pages.
#include <zstd.h>

#include <cstring>
#include <fstream>
#include <iterator>
#include <random>
#include <set>

#include "storage/doctor/check_command.hpp"
#include "storage/store_pages.hpp"
#include "storage/inputs_blob.hpp"
#include "storage/piece_blob.hpp"
#include "storage/zstd_codec.hpp"
#include "tests/storage/doctor_fixture.hpp"

namespace tind::test {
namespace {

using nlohmann::json;

std::string bytes_of(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

void write_bytes(const std::string& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary | std::ios::trunc) << bytes;
}

/// One frame of `record` as zstd's own parameters say.
Bytes frame_of(const Bytes& record, const std::function<void(ZSTD_CCtx*)>& set) {
  ZSTD_CCtx* const context = ZSTD_createCCtx();
  set(context);
  Bytes frame(ZSTD_compressBound(record.size()));
  const std::size_t n = ZSTD_compress2(context, frame.data(), frame.size(), record.data(), record.size());
  EXPECT_FALSE(ZSTD_isError(n));
  frame.resize(n);
  ZSTD_freeCCtx(context);
  return frame;
}

TEST_F(DoctorTest, FindsMissingPieces) {
  for (const PieceKey& key : pieces_of(tile_)) {
    if (key.kind == PieceKind::kBody) continue;
    expect_found(
        "missing " + name_of(key), [&](DamagedStore& s) { s.erase(key); }, name_of(tile_),
        name_of(key) + " is missing");
  }
  expect_found(
      "missing body", [&](DamagedStore& s) { s.erase(body_); }, "tile 9/", name_of(tile_) + ", is not stored");
  expect_found(
      "missing root",
      [&](DamagedStore& s) {
        s.erase({PieceKind::kBody, 0, 1, 0});
      },
      "manifest", "level 0: n_tiles");
  expect_found(
      "missing parent",
      [&](DamagedStore& s) {
        const TileKey parent = tile_.parent();
        s.erase({PieceKind::kBody, parent.level, parent.x, parent.y});
      },
      name_of(tile_), "parent is not stored");
}

TEST_F(DoctorTest, FindsPiecesTooMany) {
  const auto corner_elsewhere = PieceKey{PieceKind::kCorner, 9, 5, 5};
  expect_found(
      "corner of nobody",
      [&](DamagedStore& s) { s.records()[DamagedStore::key_of(corner_elsewhere)] = encode_corner({}); },
      name_of(corner_elsewhere), "belongs to no stored tile");
  expect_found(
      "body of no family",
      [&](DamagedStore& s) {
        s.records()[DamagedStore::key_of({PieceKind::kBody, 9, 5, 5})] = s.value(body_);
      },
      "tile 9/5/5", "parent is not stored");
  expect_found(
      "below the bottom",
      [&](DamagedStore& s) {
        s.records()[DamagedStore::key_of({PieceKind::kCorner, 11, 0, 0})] = encode_corner({});
      },
      "corner 11/0/0", "below the bottom level");
  const auto add_key = [&](const Bytes& key) {
    return [key](DamagedStore& s) { s.records()[key] = encode_corner({}); };
  };
  expect_found("short key", add_key({9, 0, 0}), "key 090000", "no piece's");
  expect_found("empty of level", add_key({29, 0, 0, 0, 0, 0, 0, 0, 0, 0}), "key 1d", "no piece's");
  expect_found("not canonical: a pole's second column", add_key({2, 0, 0, 0, 0, 0, 0, 0, 1, 0}), "key 02",
               "no piece's");
  expect_found("out of range", add_key({0, 0, 0, 0, 0, 0, 0, 0, 16, 3}), "key 00", "no piece's");
  // Kinds of later versions are passed over (docs/format.md 2).
  DamagedStore store(path("sound.tind"));
  add_key({9, 0, 0, 0, 0, 0, 0, 0, 0, 77})(store);
  EXPECT_TRUE(check(store).is_sound()) << text_of(check(store));
  EXPECT_EQ(DamagedStore(path("damaged.tind")).records(), DamagedStore(path("sound.tind")).records());
  // A pole's corner on the deepest possible level belongs to 2^29 tiles; nobody lists them.
  expect_found(
      "pole far below",
      [&](DamagedStore& s) {
        s.records()[DamagedStore::key_of({PieceKind::kCorner, 28, 0, 0})] = encode_corner({});
      },
      "corner 28/0/0 of all tiles at the south pole", "below the bottom level");
  expect_found(
      "pole of nobody",
      [&](DamagedStore& s) {
        s.records()[DamagedStore::key_of({PieceKind::kCorner, 9, 0, 0})] = encode_corner({});
      },
      "corner 9/0/0 of all tiles at the south pole", "belongs to no stored tile");
}

TEST_F(DoctorTest, FindsFramesThatClientsCannotRead) {
  const auto with = [&](const char* field, const char* what, const std::function<Bytes(const Bytes&)>& make) {
    expect_found(
        field, [&](DamagedStore& s) { s.value(body_) = make(unpack_value(s.value(body_)).value()); }, name_of(tile_),
        what);
  };
  with("no content size", "content size", [](const Bytes& record) {
    return frame_of(record, [](ZSTD_CCtx* c) { ZSTD_CCtx_setParameter(c, ZSTD_c_contentSizeFlag, 0); });
  });
  with("another frame behind", "behind the zstd frame", [](const Bytes& record) {
    Bytes frame = zstd_compress(record, 3);
    const Bytes empty = zstd_compress({}, 3);
    frame.insert(frame.end(), empty.begin(), empty.end());
    return frame;
  });
  with("bytes behind", "behind the zstd frame", [](const Bytes& record) {
    Bytes frame = zstd_compress(record, 3);
    frame.push_back(0);
    return frame;
  });
  with("cut off", "broken zstd frame", [](const Bytes& record) {
    Bytes frame = zstd_compress(record, 3);
    frame.resize(frame.size() / 2);
    return frame;
  });
  with("needs a dictionary", "dictionary", [](const Bytes& record) {
    Bytes frame = zstd_compress(record, 3);
    frame[4] |= 1;  // a dictionary's number of one byte
    frame.insert(frame.begin() + ((frame[4] & 0x20) != 0 ? 5 : 6), 7);
    return frame;
  });
  with("wide window", "more than browsers take", [](const Bytes& record) {
    // A frame with a window of 16 MiB around one block of raw bytes.
    Bytes frame = {0x28, 0xb5, 0x2f, 0xfd, 0x80, (24 - 10) << 3};
    const auto n = static_cast<std::uint32_t>(record.size());
    for (int shift = 0; shift < 32; shift += 8) frame.push_back(static_cast<std::uint8_t>(n >> shift));
    const std::uint32_t block = n << 3 | 1;
    for (int shift = 0; shift < 24; shift += 8) frame.push_back(static_cast<std::uint8_t>(block >> shift));
    frame.insert(frame.end(), record.begin(), record.end());
    return frame;
  });
  with("announces more", "frame", [](const Bytes& record) {
    Bytes frame = zstd_compress(record, 3);
    ++frame[(frame[4] & 0x20) != 0 ? 5 : 6];
    return frame;
  });
}

TEST_F(DoctorTest, FindsDamagedInputs) {
  const auto change = [&](const char* field, const std::function<void(TileInputs&)>& edit) {
    expect_found(
        field,
        [&](DamagedStore& s) {
          TileInputs inputs = decode_inputs(s.value(inputs_)).value();
          edit(inputs);
          s.value(inputs_) = encode_inputs(inputs);
        },
        name_of(tile_), "inputs: ");
  };
  change("inserted", [](TileInputs& i) { i.n_inserted = 1u << 30; });
  change("of_lines", [](TileInputs& i) { i.n_of_lines = 1u << 30; });
  change("outside", [](TileInputs& i) { i.n_outside = 1u << 30; });
  change("left_out", [](TileInputs& i) { i.n_left_out = i.n_line_pieces + 1; });
  change("interior", [](TileInputs& i) { ++i.body->n_interior; });
  change("triangles", [](TileInputs& i) { --i.body->n_triangles; });
  change("posts", [](TileInputs& i) { ++i.body->stats.n_posts; });
  change("error", [](TileInputs& i) { i.body->stats.max_error_m += 1; });
  change("height", [](TileInputs& i) { ++i.body->stats.max_z; });
  change("cells' posts", [](TileInputs& i) { i.cells.assign(16, {}), i.n_cell_levels = 2; });
  change("cells' depth", [](TileInputs& i) { i.cells.assign(1024, {}), i.n_cell_levels = 5; });
  const auto raw = [&](const char* field, const std::function<void(Bytes&)>& edit) {
    expect_found(
        field, [&](DamagedStore& s) { edit(s.value(inputs_)); }, name_of(inputs_), "broken inputs");
  };
  raw("tag", [](Bytes& r) { r[0] = 'i'; });
  raw("a digest", [](Bytes& r) { r[20] ^= 1; });
  raw("cut off", [](Bytes& r) { r.pop_back(); });
  raw("trailing byte", [](Bytes& r) { r.push_back(0); });
  raw("compressed", [](Bytes& r) { r = zstd_compress(r, 3); });
  expect_found(
      "missing", [&](DamagedStore& s) { s.erase(inputs_); }, name_of(tile_), "inputs record is missing");
  expect_found(
      "of no tile",
      [&](DamagedStore& s) {
        s.records()[DamagedStore::key_of({PieceKind::kInputs, 9, 5, 5})] = s.value(inputs_);
      },
      "tile 9/5/5", "belongs to no stored tile");
}

TEST_F(DoctorTest, FindsEachWrongMemberOfTheManifest) {
  const auto found = [&](const std::string& member, const std::function<void(json&)>& edit) {
    SCOPED_TRACE(member);
    DamagedStore store(path("sound.tind"));
    store.change_manifest(edit);
    const CheckReport report = check(store);
    EXPECT_TRUE(has_fault(report, "manifest", "") || (member == "lattice_level" && has_fault(report, "tile ", "")))
        << member << "\n"
        << text_of(report);
  };
  // All members: absent ones are refused (but for those that files of the first builders lack), and each that says
  // something of the pieces is held against them.
  DamagedStore sound(path("sound.tind"));
  const json manifest = sound.manifest();
  const std::set<std::string> later = {"heights", "vertical_operation", "source_kind", "resampling", "lines"};
  for (const auto& [member, value] : manifest.items()) {
    if (!later.contains(member)) {
      found("no " + member, [name = member](json& j) { j.erase(name); });
    }
    found(member + " of another type",
          [name = member](json& j) { j[name] = j[name].is_string() ? json(17) : json("?"); });
  }
  for (const auto& [member, wrong] : std::vector<std::pair<std::string, json>>{{"format", "dint"},
                                                                               {"format_version", 2},
                                                                               {"generator", ""},
                                                                               {"vertical_datum", ""},
                                                                               {"heights", "high"},
                                                                               {"source_kind", "photo"},
                                                                               {"resampling", "nearest"},
                                                                               {"horizontal_crs", "EPSG:3857"},
                                                                               {"root_count_x", 1},
                                                                               {"mode", "fast"},
                                                                               {"lattice_level", 28},
                                                                               {"lattice_level", 9},
                                                                               {"height_exponent", 3},
                                                                               {"height_exponent", 17},
                                                                               {"bottom_level", 9},
                                                                               {"bottom_level", 11},
                                                                               {"falloff_posts", -1},
                                                                               {"disagreement_m", -1},
                                                                               {"bounds_deg", {0, 0, 1, 1}},
                                                                               {"bounds_deg", {-1000, 0, 1, 1}},
                                                                               {"spacing_deg", {0, 1}},
                                                                               {"content_hash", "0000000000000000"},
                                                                               {"sources", json::array()},
                                                                               {"options", json::array()},
                                                                               {"levels", json::array()}}) {
    found(member, [&, name = member, value = wrong](json& j) { j[name] = value; });
  }
  found("bounds_deg", [](json& j) { j["bounds_deg"][0] = j["bounds_deg"][0].get<double>() - 1; });
  found("bounds_deg", [](json& j) { j["bounds_deg"][3] = j["bounds_deg"][3].get<double>() + 1; });
  found("ellipsoid", [](json& j) { j["ellipsoid"]["inverse_flattening"] = 0; });
  found("ellipsoid", [](json& j) { j["ellipsoid"]["semi_major_m"] = -1; });
  found("posts", [](json& j) { j["posts"]["source"] = j["posts"]["source"].get<int>() + 1; });
  found("sources", [](json& j) { j["sources"][0]["sha256"] = "00"; });
  found("sources", [](json& j) { j["sources"][0]["n_cols"] = 0; });
  found("sources", [](json& j) { j["sources"][0]["n_points"] = 5; });
  found("shard", [](json& j) { j["shard"] = {{"index", 3}, {"count", 2}, {"cut_level", 4}}; });
  for (const auto& [member, value] : manifest["levels"][kLevel].items()) {
    found("level: no " + member, [name = member](json& j) { j["levels"][kLevel].erase(name); });
    if (!value.is_number()) continue;
    found("level: " + member, [name = member](json& j) {
      json& number = j["levels"][kLevel][name];
      number = number.is_number_float() ? json(number.get<double>() * 2.5) : json(number.get<std::int64_t>() + 1);
    });
  }
  found("rows: coverage",
        [](json& j) { j["levels"][kLevel]["rows"][1][3] = 2 - j["levels"][kLevel]["rows"][1][3].get<int>() / 2 * 2; });
  found("rows: one tile more",
        [](json& j) { j["levels"][kLevel]["rows"].back()[2] = j["levels"][kLevel]["rows"].back()[2].get<int>() + 1; });
  found("rows: one less", [](json& j) { j["levels"][kLevel]["rows"].erase(0); });
  found("rows: order", [](json& j) { std::swap(j["levels"][kLevel]["rows"][0], j["levels"][kLevel]["rows"][1]); });

  DamagedStore none(path("sound.tind"));
  none.records().erase({0xff, 'm'});
  EXPECT_TRUE(has_fault(check(none), "manifest", "missing"));
  DamagedStore broken(path("sound.tind"));
  broken.records()[{0xff, 'm'}] = {'{'};
  EXPECT_TRUE(has_fault(check(broken), "manifest", "json"));
}

TEST_F(DoctorTest, FindsFilesThatAreCutOffOrNoneAtAll) {
  const std::string sound = bytes_of(path("sound.tind"));
  for (const std::size_t n : {std::size_t{0}, std::size_t{1}, std::size_t{100}, std::size_t{4096}, std::size_t{8191},
                              sound.size() / 2, sound.size() - 4096, sound.size() - 1}) {
    SCOPED_TRACE(n);
    write_bytes(path("cut.tind"), sound.substr(0, n));
    EXPECT_TRUE(has_fault(check(path("cut.tind")), "file", "")) << text_of(check(path("cut.tind")));
  }
  write_bytes(path("text.tind"), std::string(20000, 'x'));
  EXPECT_TRUE(has_fault(check(path("text.tind")), "file", "not a .tind file"));
  const auto missing = check_file(path("missing.tind"), {});
  ASSERT_FALSE(missing);
  EXPECT_EQ(missing.error().kind, ErrorKind::kNotFound);
  EXPECT_EQ(check_file(folder().string(), {}).error().kind, ErrorKind::kInvalidInput);
}

// Every record as the pages have it.
Records records_of(const std::string& path) {
  Records records;
  const auto pages = StorePages::open(path);
  if (!pages) return records;
  pages->walk(
      [&](ByteView key, ByteView value) {
        records[{key.begin(), key.end()}] = {value.begin(), value.end()};
      },
      [](ByteView, const std::string&) {});
  return records;
}

TEST_F(DoctorTest, SurvivesFlippedBitsAndMissesNoneThatMatters) {
  const std::string sound = bytes_of(path("sound.tind"));
  const auto records = records_of(path("sound.tind"));
  ASSERT_EQ(records, DamagedStore(path("sound.tind")).records());
  std::mt19937_64 random(20261122);
  int n_found = 0;
  constexpr int kFlips = 300;
  for (int k = 0; k < kFlips; ++k) {
    std::string bytes = sound;
    // Half of them where pages keep their books.
    std::size_t at = random() % bytes.size();
    if (k % 2 == 0) at = at / 4096 * 4096 + random() % 64;
    bytes[at] = static_cast<char>(bytes[at] ^ (1 << random() % 8));
    write_bytes(path("flipped.tind"), bytes);
    const CheckReport report = check(path("flipped.tind"));
    if (!report.is_sound()) {
      ++n_found;
      continue;
    }
    // Only where nothing is kept, or in what no structure and no hash can tell.
    auto after = records_of(path("flipped.tind"));
    for (const auto& [key, value] : records) {
      if (key.size() == 10 && key[9] == static_cast<std::uint8_t>(PieceKind::kInputs)) after[key] = value;
    }
    const auto texts_apart = [](Records& all) { all.erase({0xff, 'm'}); };
    auto before = records;
    texts_apart(before);
    texts_apart(after);
    EXPECT_EQ(after, before) << "byte " << at;
  }
  EXPECT_GT(n_found, kFlips / 3);
}

TEST_F(DoctorTest, NamesTheTileNearADamagedPage) {
  // The last leaf page, found by its flags; its nodes' offsets are overwritten.
  std::string bytes = bytes_of(path("sound.tind"));
  std::size_t page = 0;
  for (std::size_t at = 2 * 4096; at + 4096 <= bytes.size(); at += 4096) {
    std::uint64_t number = 0;
    std::uint16_t flags = 0;
    std::memcpy(&number, bytes.data() + at, sizeof(number));
    std::memcpy(&flags, bytes.data() + at + 10, sizeof(flags));
    if (flags == 2 && number == at / 4096 && page == 0 && at > bytes.size() / 2) page = at;
  }
  ASSERT_NE(page, 0u);
  std::memset(bytes.data() + page + 16, 0xee, 8);
  write_bytes(path("page.tind"), bytes);
  const CheckReport report = check(path("page.tind"));
  EXPECT_TRUE(has_fault(report, "tile ", "damaged pages")) << text_of(report);
  // Two keys the other way round.
  bytes = bytes_of(path("sound.tind"));
  std::swap_ranges(bytes.data() + page + 16, bytes.data() + page + 18, bytes.data() + page + 18);
  write_bytes(path("page.tind"), bytes);
  EXPECT_TRUE(has_fault(check(path("page.tind")), "tile ", "out of order")) << text_of(check(path("page.tind")));
}

TEST_F(DoctorTest, CommandSaysSoundOrDamagedByStatusTextAndJson) {
  DamagedStore store(path("sound.tind"));
  store.change_body(tile_, [](TileBody& b) { ++b.stats.max_z; });
  store.write(path("damaged.tind"));
  const auto run = [&](const CheckCommand& command) {
    std::FILE* out = std::tmpfile();
    const int status = run_check(command, out, nullptr);
    std::string text(static_cast<std::size_t>(std::ftell(out)), '\0');
    std::rewind(out);
    EXPECT_EQ(std::fread(text.data(), 1, text.size(), out), text.size());
    std::fclose(out);
    return std::pair(status, text);
  };
  const auto [good, good_text] = run({{path("sound.tind")}, false, 1});
  EXPECT_EQ(good, 0);
  EXPECT_THAT(good_text, testing::HasSubstr(": sound: "));
  const auto [bad, bad_text] = run({{path("sound.tind"), path("damaged.tind")}, false, 1});
  EXPECT_EQ(bad, 1);
  EXPECT_THAT(bad_text, testing::HasSubstr(": damaged: "));
  EXPECT_THAT(bad_text, testing::HasSubstr("  " + name_of(tile_) + ": min_z, max_z"));
  const auto [absent, absent_text] = run({{path("absent.tind")}, false, 1});
  EXPECT_EQ(absent, 1);
  EXPECT_THAT(absent_text, testing::HasSubstr("absent.tind"));
  const auto [as_json, json_text] = run({{path("sound.tind"), path("damaged.tind")}, true, 1});
  EXPECT_EQ(as_json, 1);
  const json parsed = json::parse(json_text);
  EXPECT_EQ(parsed[0]["sound"], true);
  EXPECT_EQ(parsed[1]["sound"], false);
  EXPECT_EQ(parsed[1]["faults"].size(), parsed[1]["n_faults"].get<std::size_t>());
}

TEST_F(DoctorTest, KnowsThatShardsLackWhatOthersHave) {
  for (int k = 0; k < 3; ++k) {
    BuildOptions options;
    options.source.inputs = {TIND_TEST_DATA "/sangre_de_cristo.tif"};
    options.output = path("shard.tind");
    options.lines.drainage = false;
    options.shard = {k, 3};
    options.force = true;
    Progress silent(nullptr);
    ASSERT_TRUE(build_pyramid(options, silent));
    EXPECT_TRUE(check(options.output).is_sound()) << k << '\n' << text_of(check(options.output));
    // Said to be whole, it is not.
    DamagedStore store(options.output);
    store.change_manifest([](json& j) { j.erase("shard"); });
    EXPECT_TRUE(has_fault(check(store), "tile ", "sibling")) << k << '\n' << text_of(check(store));
  }
}

TEST_F(DoctorTest, FindsTheSameWithAnyNumberOfThreads) {
  DamagedStore store(path("sound.tind"));
  for (std::uint32_t k = 0; k < 4; ++k) {
    store.change_body(tile_.parent().child(static_cast<int>(k)), [](TileBody& b) { ++b.stats.max_z; });
  }
  store.write(path("damaged.tind"));
  CheckOptions one, four;
  one.threads = 1;
  four.threads = 4;
  EXPECT_EQ(text_of(check_file(path("damaged.tind"), one).value()),
            text_of(check_file(path("damaged.tind"), four).value()));
  one.most_faults = 2;
  const auto few = check_file(path("damaged.tind"), one).value();
  EXPECT_EQ(few.faults.size(), 2u);
  EXPECT_GE(few.n_faults, 4u);
}

}  // namespace
}  // namespace tind::test
