// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/catalog.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <thread>

#include "server/keeper.hpp"
#include "server/worker_state.hpp"
#include "test_site.hpp"

namespace tind {
namespace {

namespace fs = std::filesystem;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

std::string memory_maps() {
  std::ifstream in("/proc/self/maps");
  return {std::istreambuf_iterator<char>(in), {}};
}

class CatalogTest : public testing::Test {
 protected:
  // Written elsewhere, made old, then moved: as a builder and a careful operator do it.
  void put(const std::string& file, std::uint32_t n_side) {
    const std::string made = path("made.partial");
    fs::remove(made);
    test::write_pyramid(made, n_side);
    fs::last_write_time(made, fs::file_time_type::clock::now() - std::chrono::hours(1) + std::chrono::seconds(n_side));
    fs::rename(made, path(file));
  }
  void put_broken(const std::string& file, int age_s) {
    std::ofstream(path("broken")) << std::string(10000, 'x');
    fs::last_write_time(path("broken"), fs::file_time_type::clock::now() - std::chrono::seconds(age_s));
    fs::rename(path("broken"), path(file));
  }
  // The first leaf page of a file of several (LMDB: flags at byte 10 of a page), which its manifest is not on.
  void hurt_a_page(const std::string& file) {
    constexpr std::size_t kPage = 4096;
    std::ifstream in(path(file), std::ios::binary);
    std::string bytes{std::istreambuf_iterator<char>(in), {}};
    std::size_t at = 2 * kPage;
    while (at < bytes.size() && bytes.compare(at + 10, 2, std::string("\2\0", 2)) != 0) at += kPage;
    ASSERT_LT(at, bytes.size());
    bytes.replace(at + 12, 2, "\xff\x7f");  // where its list of nodes ends
    const auto written = fs::last_write_time(path(file));
    std::ofstream(path(file), std::ios::binary) << bytes;
    fs::last_write_time(path(file), written);
  }
  std::string path(const std::string& file) const { return directory_.path + "/" + file; }
  void open(std::vector<DatasetSpec> specs, int max_open = 256) {
    Settings settings;
    settings.datasets = std::move(specs);
    settings.max_open_datasets = max_open;
    auto catalog = Catalog::open(settings);
    ASSERT_TRUE(catalog.has_value()) << catalog.error().message;
    catalog_ = std::move(*catalog);
  }
  DatasetSlot* slot(const std::string& name) { return catalog_->holder().current()->find(name); }
  std::string version(const std::string& name) {
    const auto served = slot(name)->open();
    EXPECT_TRUE(served.has_value());
    return served ? (*served)->version : "";
  }
  std::vector<std::string> names() {
    std::vector<std::string> names;
    for (const auto& s : catalog_->holder().current()->slots) names.push_back(s->source().name);
    return names;
  }

  test::TemporaryDirectory directory_;
  std::unique_ptr<Catalog> catalog_;
};

TEST_F(CatalogTest, AReplacedFileIsSwappedInAndOthersStayOpen) {
  put("a.tind", 60);
  put("b.tind", 60);
  open({{path("a.tind")}, {path("b.tind")}});
  const auto before = catalog_->holder().current();
  const std::string a = version("a"), b = version("b");
  EXPECT_FALSE(catalog_->refresh(false).changed());
  EXPECT_EQ(catalog_->holder().current(), before) << "nothing happened, nothing is swapped";

  put("a.tind", 61);
  const CatalogChange change = catalog_->refresh(false);
  EXPECT_THAT(change.replaced, ElementsAre("a"));
  EXPECT_EQ(change.n_unchanged, 1u);
  EXPECT_NE(version("a"), a);
  EXPECT_EQ(version("b"), b);
  EXPECT_EQ(slot("b"), before->find("b")) << "the same open file";
}

TEST_F(CatalogTest, ASymbolicLinkThatIsSwappedIsAnotherFile) {
  put("v1.tind", 60);
  put("v2.tind", 61);
  fs::create_symlink("v1.tind", path("a.tind"));
  open({{path("a.tind")}});
  const std::string before = version("a");
  fs::create_symlink("v2.tind", path("a.new"));
  fs::rename(path("a.new"), path("a.tind"));
  EXPECT_THAT(catalog_->refresh(false).replaced, ElementsAre("a"));
  EXPECT_NE(version("a"), before);
}

TEST_F(CatalogTest, OldMapsAreReleasedWhenTheLastReaderLetsGo) {
  put("a.tind", 60);
  open({{path("a.tind")}});
  WorkerState worker(catalog_->holder());
  const auto served = worker.dataset("a");
  ASSERT_TRUE(served.has_value());
  const auto snapshot = worker.snapshot((*served)->dataset);
  ASSERT_TRUE(snapshot.has_value());
  const PieceKey body{PieceKind::kBody, 1, 0, 0};
  const auto value = (*snapshot)->find(body);
  ASSERT_TRUE(value.has_value());
  const Bytes copy(value->begin(), value->end());
  put("a.tind", 61);
  catalog_->refresh(false);
  EXPECT_THAT(memory_maps(), HasSubstr("a.tind (deleted)")) << "the reader still holds it";
  EXPECT_TRUE(std::equal(copy.begin(), copy.end(), value->begin(), value->end()));
  worker.begin_batch();
  EXPECT_THAT(memory_maps(), testing::Not(HasSubstr("a.tind (deleted)")));
  const auto now = worker.dataset("a");
  ASSERT_TRUE(now.has_value());
  EXPECT_NE((*now)->dataset->manifest_json, "");
}

TEST_F(CatalogTest, ABrokenFileIsRefusedOnceAndTheOldOneStays) {
  put("a.tind", 60);
  open({{path("a.tind")}});
  const std::string before = version("a");
  put_broken("a.tind", 100);
  testing::internal::CaptureStderr();
  const CatalogChange change = catalog_->refresh(false);
  EXPECT_FALSE(catalog_->refresh(false).changed());
  const std::string log = testing::internal::GetCapturedStderr();
  ASSERT_EQ(change.failed.size(), 1u);
  EXPECT_THAT(change.failed[0].message, HasSubstr("stays in service"));
  EXPECT_EQ(std::count(log.begin(), log.end(), '\n'), 1) << log;
  EXPECT_EQ(version("a"), before);

  // Another broken file is another line; at once, it is tried again.
  put_broken("a.tind", 50);
  EXPECT_EQ(catalog_->refresh(false).failed.size(), 1u);
  EXPECT_EQ(catalog_->refresh(false).failed.size(), 0u);
  EXPECT_EQ(catalog_->refresh(true).failed.size(), 1u);
  put("a.tind", 61);
  EXPECT_THAT(catalog_->refresh(false).replaced, ElementsAre("a"));
  EXPECT_NE(version("a"), before);
}

TEST_F(CatalogTest, TruncatedFilesAreRefused) {
  put("a.tind", 60);
  open({{path("a.tind")}});
  const std::string before = version("a");
  fs::copy_file(path("a.tind"), path("short"));
  fs::resize_file(path("short"), fs::file_size(path("short")) / 2);
  fs::last_write_time(path("short"), fs::file_time_type::clock::now() - std::chrono::seconds(9));
  fs::rename(path("short"), path("a.tind"));
  const CatalogChange change = catalog_->refresh(false);
  ASSERT_EQ(change.failed.size(), 1u);
  EXPECT_THAT(change.failed[0].message, HasSubstr("truncated"));
  EXPECT_EQ(version("a"), before);
}

TEST_F(CatalogTest, AFileWithADamagedPageIsRefusedAndTheOldOneStays) {
  put("a.tind", 60);
  open({{path("a.tind")}});
  const std::string before = version("a");
  put("b", 61);
  hurt_a_page("b");
  fs::rename(path("b"), path("a.tind"));
  const CatalogChange change = catalog_->refresh(false);
  ASSERT_EQ(change.failed.size(), 1u);
  EXPECT_THAT(change.failed[0].message, testing::AllOf(HasSubstr("damaged: page"), HasSubstr("stays in service")));
  EXPECT_EQ(version("a"), before);
}

TEST_F(CatalogTest, DamagedPagesInFoldersAreFoundWhenAskedForAndBefore) {
  fs::create_directory(path("f"));
  for (const char* file : {"f/asked.tind", "f/unasked.tind"}) {
    put(file, 60);
    hurt_a_page(file);
  }
  put("f/sound.tind", 60);
  open({{path("f")}});
  testing::internal::CaptureStderr();
  EXPECT_FALSE(slot("asked")->open().has_value());
  while (catalog_->read_ahead()) {
  }
  const std::string log = testing::internal::GetCapturedStderr();
  EXPECT_THAT(log, testing::AllOf(HasSubstr("asked.tind: damaged: page"), HasSubstr("unasked.tind: damaged: page")));
  EXPECT_EQ(std::count(log.begin(), log.end(), '\n'), 2) << log;
  EXPECT_TRUE(slot("unasked")->has_failed());
  EXPECT_FALSE(slot("unasked")->open().has_value());
  EXPECT_TRUE(slot("sound")->open().has_value());
}

TEST_F(CatalogTest, FoldersAreReadLazilyAndFollowed) {
  fs::create_directory(path("f"));
  put("f/a.tind", 60);
  put("f/b.tind", 60);
  put("f/c.tind.partial", 60);
  put("f/.hidden.tind", 60);
  put_broken("f/x.tind", 100);
  open({{path("f")}});
  EXPECT_THAT(names(), ElementsAre("a", "b", "x"));
  EXPECT_EQ(catalog_->limit()->n_open, 0) << "nobody asked yet";
  EXPECT_EQ(slot("a")->if_open(), nullptr);
  EXPECT_NE(version("a"), "");
  EXPECT_NE(slot("a")->if_open(), nullptr);
  EXPECT_EQ(catalog_->limit()->n_open, 1);
  testing::internal::CaptureStderr();
  EXPECT_FALSE(slot("x")->open().has_value());
  EXPECT_FALSE(slot("x")->open().has_value());
  const std::string log = testing::internal::GetCapturedStderr();
  EXPECT_EQ(std::count(log.begin(), log.end(), '\n'), 1) << "told of once: " << log;

  put("f/new.tind", 62);
  fs::remove(path("f/b.tind"));
  put("f/x.tind", 63);
  const CatalogChange change = catalog_->refresh(false);
  EXPECT_THAT(change.added, ElementsAre("new"));
  EXPECT_THAT(change.replaced, ElementsAre("x"));
  EXPECT_TRUE(change.unsettled) << "the removed one may be coming back";
  EXPECT_THAT(names(), ElementsAre("a", "b", "new", "x"));
  EXPECT_THAT(catalog_->refresh(false).removed, ElementsAre("b"));
  EXPECT_THAT(names(), ElementsAre("a", "new", "x"));
  EXPECT_NE(version("x"), "");
}

TEST_F(CatalogTest, AFileThatIsStillWrittenToWaits) {
  fs::create_directory(path("f"));
  open({{path("f")}});
  test::write_pyramid(path("f/a.tind"));  // just now
  CatalogChange change = catalog_->refresh(false);
  EXPECT_TRUE(change.unsettled);
  EXPECT_FALSE(change.changed());
  change = catalog_->refresh(false);
  EXPECT_THAT(change.added, ElementsAre("a")) << "it looks the same as before";
  put("f/a.tind", 61);
  EXPECT_THAT(catalog_->refresh(true).replaced, ElementsAre("a"));
}

TEST_F(CatalogTest, NoMoreFilesAreOpenThanAllowed) {
  fs::create_directory(path("f"));
  for (const char* name : {"a", "b", "c", "d"}) put(std::string("f/") + name + ".tind", 60);
  open({{path("f")}}, 2);
  int n_told = 0;
  catalog_->limit()->on_excess = [&] { ++n_told; };
  WorkerState worker(catalog_->holder());
  std::int64_t time_s = 100;
  for (const char* name : {"a", "b", "c"}) {
    worker.set_time(++time_s);
    ASSERT_TRUE(worker.dataset(name).has_value());
  }
  worker.set_time(++time_s);
  ASSERT_TRUE(worker.dataset("a").has_value()) << "the first, but asked for again";
  EXPECT_EQ(catalog_->limit()->n_open, 3);
  EXPECT_EQ(n_told, 1);
  catalog_->close_excess();
  EXPECT_EQ(catalog_->limit()->n_open, 2);
  EXPECT_EQ(slot("b")->if_open(), nullptr);
  EXPECT_NE(slot("a")->if_open(), nullptr);
  EXPECT_THAT(memory_maps(), HasSubstr("/b.tind")) << "the worker has it";
  worker.begin_batch();
  EXPECT_THAT(memory_maps(), testing::Not(HasSubstr("/b.tind")));
  EXPECT_TRUE(worker.dataset("b").has_value()) << "opened again";
}

TEST_F(CatalogTest, ListsKnowAllDatasetsWithoutKeepingThemOpen) {
  fs::create_directory(path("f"));
  put("f/a.tind", 60);
  put("f/b.tind", 60);
  put_broken("f/c.tind", 100);
  open({{path("f")}});
  const auto list = [&] { return nlohmann::json::parse(catalog_->holder().current()->lists.at(0).text)["datasets"]; };
  ASSERT_EQ(list().size(), 3u);
  EXPECT_FALSE(list()[0].contains("bounds_deg"));
  testing::internal::CaptureStderr();
  int n_reads = 0;
  while (catalog_->read_ahead()) ++n_reads;
  EXPECT_THAT(testing::internal::GetCapturedStderr(), HasSubstr("c.tind"));
  EXPECT_EQ(n_reads, 3 + 2) << "three manifests, then the pages of two";
  EXPECT_FALSE(catalog_->read_ahead());
  ASSERT_EQ(list().size(), 2u) << "without the broken one";
  EXPECT_EQ(list()[1]["bottom_level"], 1);
  EXPECT_EQ(catalog_->limit()->n_open, 0);
}

TEST_F(CatalogTest, BasesMustBeThereAndMustNotLeadBack) {
  put("a.tind", 60);
  put("b.tind", 60);
  const auto message = [&](std::vector<DatasetSpec> specs) {
    Settings settings;
    settings.datasets = std::move(specs);
    const auto catalog = Catalog::open(settings);
    return catalog ? std::string() : catalog.error().message;
  };
  const auto spec = [&](const char* name, const char* base) {
    DatasetSpec made(path(std::string(name) + ".tind"));
    made.base = base;
    return made;
  };
  EXPECT_EQ(message({spec("a", "b"), spec("b", "")}), "");
  EXPECT_THAT(message({spec("a", "nobody")}), HasSubstr("nobody"));
  EXPECT_THAT(message({spec("a", "b"), spec("b", "a")}), HasSubstr("lead back"));
  EXPECT_THAT(message({spec("a", "a")}), HasSubstr("lead back"));
  open({spec("a", "b"), spec("b", "")});
  // The base goes: the dataset is served alone, and told of once.
  const std::string with_base = version("a");
  fs::remove(path("b.tind"));
  testing::internal::CaptureStderr();
  catalog_->refresh(false);
  catalog_->refresh(false);
  catalog_->refresh(false);
  const std::string log = testing::internal::GetCapturedStderr();
  EXPECT_EQ(log.find("no dataset 'b'"), log.rfind("no dataset 'b'")) << log;
  EXPECT_THAT(log, HasSubstr("no dataset 'b'"));
  EXPECT_NE(version("a"), with_base);
  put("b.tind", 61);
  EXPECT_THAT(catalog_->refresh(false).added, ElementsAre("b"));
  EXPECT_NE(version("a"), with_base) << "another base, another version";
}

TEST_F(CatalogTest, AReplacedBaseRenewsWhatStandsOnIt) {
  put("a.tind", 60);
  put("b.tind", 60);
  DatasetSpec a(path("a.tind"));
  a.base = "b";
  open({a, {path("b.tind")}});
  const std::string before = version("a");
  const auto file = slot("a")->if_open()->dataset;
  put("b.tind", 61);
  EXPECT_THAT(catalog_->refresh(false).replaced, ElementsAre("a", "b"));
  EXPECT_NE(version("a"), before);
  EXPECT_EQ(slot("a")->if_open()->dataset, file) << "its own file is not opened again";
}

class KeeperTest : public CatalogTest {
 protected:
  void keep(const std::string& watch, Keeper::Reread reread = {}) {
    Settings settings;
    settings.datasets = catalog_->specs();
    settings.watch = watch;
    settings.poll_interval_s = 1;
    keeper_ = std::make_unique<Keeper>(*catalog_, settings, Keeper::Hooks{std::move(reread), {}});
  }
  template <class Condition>
  bool soon(Condition condition, int limit_ms = 5000) {
    for (int k = 0; k < limit_ms / 10 && !condition(); ++k) std::this_thread::sleep_for(std::chrono::milliseconds(10));
    return condition();
  }
  std::unique_ptr<Keeper> keeper_;
};

TEST_F(KeeperTest, WatchingSeesNewReplacedAndRemovedFiles) {
  for (const char* watch : {"auto", "poll"}) {
    SCOPED_TRACE(watch);
    fs::create_directory(path("f"));
    put("a.tind", 60);
    open({{path("a.tind")}, {path("f")}});
    keep(watch);
    const std::string before = version("a");
    put("a.tind", 61);
    EXPECT_TRUE(soon([&] { return version("a") != before; }));
    put("f/n.tind", 60);
    EXPECT_TRUE(soon([&] { return slot("n") != nullptr; }));
    fs::remove(path("f/n.tind"));
    EXPECT_TRUE(soon([&] { return slot("n") == nullptr; }));
    EXPECT_TRUE(soon([&] { return keeper_->n_dataset_changes() == 3; }));
    keeper_.reset();
    fs::remove_all(path("f"));
  }
}

TEST_F(KeeperTest, ASwappedLinkToAFolderIsSeenAtOnce) {
  fs::create_directory(path("v1"));
  fs::create_directory(path("v2"));
  put("v1/a.tind", 60);
  put("v2/a.tind", 61);
  fs::create_directory_symlink("v1", path("current"));
  open({{path("current/a.tind")}});
  Settings settings;
  settings.datasets = catalog_->specs();
  settings.poll_interval_s = 3600;
  keeper_ = std::make_unique<Keeper>(*catalog_, settings, Keeper::Hooks{});
  const std::string before = version("a");
  fs::create_directory_symlink("v2", path("next"));
  fs::rename(path("next"), path("current"));
  EXPECT_TRUE(soon([&] { return version("a") != before; }));
}

TEST_F(KeeperTest, WithoutWatchingOnlyAReloadLooks) {
  put("a.tind", 60);
  open({{path("a.tind")}});
  keep("off");
  const std::string before = version("a");
  put("a.tind", 61);
  EXPECT_FALSE(soon([&] { return version("a") != before; }, 1500));
  const auto report = keeper_->reload(std::chrono::seconds(5));
  ASSERT_TRUE(report.has_value());
  EXPECT_TRUE(report->ok());
  EXPECT_THAT(report->datasets.replaced, ElementsAre("a"));
  EXPECT_NE(version("a"), before);
  EXPECT_EQ(keeper_->n_reloads_ok(), 1u);
}

TEST_F(KeeperTest, AReloadTakesOverWhatCanChangeAndNamesTheRest) {
  put("a.tind", 60);
  put("b.tind", 60);
  open({{path("a.tind")}});
  bool broken = false;
  keep("off", [&]() -> Result<Settings> {
    if (broken) return fail(ErrorKind::kInvalidInput, "f.json: not JSON at line 1, column 1");
    Settings settings;
    settings.watch = "off";
    settings.poll_interval_s = 1;
    settings.datasets = {{path("b.tind")}, {path("none.tind")}};
    settings.threads = 7;
    settings.log_level = "error";
    return settings;
  });
  auto report = keeper_->reload(std::chrono::seconds(5));
  ASSERT_TRUE(report.has_value());
  EXPECT_THAT(report->datasets.added, ElementsAre("b"));
  EXPECT_THAT(report->datasets.removed, ElementsAre("a"));
  EXPECT_THAT(report->restart_needed, ElementsAre("threads"));
  ASSERT_EQ(report->datasets.failed.size(), 1u);
  EXPECT_THAT(report->datasets.failed[0].message, HasSubstr("none.tind"));
  EXPECT_FALSE(report->ok());
  broken = true;
  report = keeper_->reload(std::chrono::seconds(5));
  ASSERT_TRUE(report.has_value());
  EXPECT_THAT(report->settings_error, HasSubstr("line 1"));
  EXPECT_THAT(names(), ElementsAre("b"));
  EXPECT_EQ(keeper_->n_reloads_failed(), 2u);
}

}  // namespace
}  // namespace tind
