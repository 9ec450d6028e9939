// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/line_writer.hpp"

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <set>

#include <cpl_conv.h>
#include <cpl_string.h>
#include <fmt/format.h>
#include <gdal_priv.h>
#include <ogrsf_frmts.h>

#include "storage/readers/gdal_errors.hpp"

namespace tind {
namespace {

/// What the GeoPackage names as the time of its last change: a fixed one, for the same bytes in every run.
constexpr char kTimeOfChange[] = "2000-01-01T00:00:00.000Z";

/// Sets a GDAL option for this thread and block.
class ThreadOption {
 public:
  ThreadOption(const char* key, const char* value) : key_(key) {
    const char* before = CPLGetThreadLocalConfigOption(key, nullptr);
    had_ = before != nullptr;
    if (had_) before_ = before;
    CPLSetThreadLocalConfigOption(key, value);
  }
  ~ThreadOption() { CPLSetThreadLocalConfigOption(key_, had_ ? before_.c_str() : nullptr); }
  ThreadOption(const ThreadOption&) = delete;
  ThreadOption& operator=(const ThreadOption&) = delete;

 private:
  const char* key_;
  bool had_ = false;
  std::string before_;
};

/// Removes the unfinished file, and what SQLite keeps beside it, unless it was kept.
class PartialFile {
 public:
  explicit PartialFile(std::string path) : path_(std::move(path)) { remove(); }
  ~PartialFile() { remove(); }
  PartialFile(const PartialFile&) = delete;
  PartialFile& operator=(const PartialFile&) = delete;
  const std::string& path() const { return path_; }

 private:
  void remove() const {
    for (const char* suffix : {"", "-journal", "-wal", "-shm"}) {
      std::error_code ignored;
      std::filesystem::remove(path_ + suffix, ignored);
    }
  }
  std::string path_;
};

bool add_fields(OGRLayer& layer) {
  OGRFieldDefn kind("kind", OFTString), strahler("strahler", OFTInteger), area("area_km2", OFTReal),
      first_level("first_level", OFTInteger);
  for (OGRFieldDefn* field : {&kind, &strahler, &area, &first_level}) {
    if (layer.CreateField(field) != OGRERR_NONE) return false;
  }
  return true;
}

bool add_line(OGRLayer& layer, const OutputLine& line) {
  OGRFeature feature(layer.GetLayerDefn());
  feature.SetField("kind", line.kind.c_str());
  if (line.strahler) feature.SetField("strahler", *line.strahler);
  if (line.area_km2) feature.SetField("area_km2", *line.area_km2);
  feature.SetField("first_level", line.first_level);
  OGRLineString geometry;
  for (const auto& [lon, lat, height_m] : line.vertices) geometry.addPoint(lon, lat, height_m);
  return feature.SetGeometry(&geometry) == OGRERR_NONE && layer.CreateFeature(&feature) == OGRERR_NONE;
}

bool add_layer(GDALDataset& file, const OutputLayer& layer, OGRSpatialReference& crs) {
  OGRLayer* out = file.CreateLayer(layer.name.c_str(), &crs, wkbLineString25D, nullptr);
  if (out == nullptr || !add_fields(*out)) return false;
  return std::all_of(layer.lines.begin(), layer.lines.end(),
                     [&](const OutputLine& line) { return add_line(*out, line); });
}

}  // namespace

Result<void> write_lines(const std::string& path, std::span<const OutputLayer> layers, bool force) {
  GDALAllRegister();
  const auto bad = [&](const std::string& what) {
    return fail(ErrorKind::kInvalidInput, fmt::format("{}: {}", path, what));
  };
  if (!EQUAL(CPLGetExtension(path.c_str()), "gpkg")) return bad("lines are written as a GeoPackage: name it .gpkg");
  std::error_code error;
  if (std::filesystem::exists(path, error) && !force) return bad("exists; remove it, or use --force");
  std::set<std::string> names;
  for (const OutputLayer& layer : layers) {
    if (layer.name.empty() || !names.insert(layer.name).second)
      return bad(fmt::format("cannot have two layers, or one without a name: '{}'", layer.name));
  }

  const PartialFile partial(path.substr(0, path.size() - std::strlen(".gpkg")) + ".partial.gpkg");
  const ThreadOption time("OGR_CURRENT_DATE", kTimeOfChange);
  const GdalErrors errors;
  const auto cannot_write = [&] {
    return fail(ErrorKind::kIo, fmt::format("{}: cannot write it: is the folder there, and the disk not full?{}", path,
                                            errors.detail()));
  };
  GDALDriver* driver = GetGDALDriverManager()->GetDriverByName("GPKG");
  if (driver == nullptr) {
    return fail(ErrorKind::kUnsupported,
                fmt::format("{}: this GDAL has no GeoPackage driver; use one with SQLite", path));
  }
  GDALDatasetUniquePtr file(driver->Create(partial.path().c_str(), 0, 0, 0, GDT_Unknown, nullptr));
  if (!file) return cannot_write();
  OGRSpatialReference crs;
  crs.importFromEPSG(4326);
  crs.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  // One transaction: a commit per line is slow.
  bool done = file->StartTransaction() == OGRERR_NONE;
  for (const OutputLayer& layer : layers) done = done && add_layer(*file, layer, crs);
  done = done && file->CommitTransaction() == OGRERR_NONE;
  file.reset();
  if (!done || errors.failed()) return cannot_write();
  if (std::rename(partial.path().c_str(), path.c_str()) != 0) {
    return fail(ErrorKind::kIo,
                fmt::format("{}: cannot rename {} to it: {}", path, partial.path(), std::strerror(errno)));
  }
  return {};
}

}  // namespace tind
