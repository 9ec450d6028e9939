// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/line_dataset.hpp"

#include <algorithm>
#include <utility>
#include <vector>

#include <cpl_conv.h>
#include <cpl_string.h>
#include <cpl_vsi.h>
#include <fmt/format.h>

#include "storage/readers/gdal_errors.hpp"

namespace tind {
namespace {

bool exists(const std::string& path) {
  VSIStatBufL stat;
  return VSIStatExL(path.c_str(), &stat, VSI_STAT_EXISTS_FLAG) == 0;
}

struct Spec {
  std::string path, layer;
};

/// FILE[:LAYER]. The last ':' counts, unless the whole is a file, the rest looks like a path, or a drive's letter is
/// all there is before it.
Spec split(const std::string& spec) {
  const std::size_t colon = spec.rfind(':');
  if (exists(spec) || colon == std::string::npos || colon < 2 || colon + 1 == spec.size() ||
      spec.find_first_of("/\\=", colon) != std::string::npos)
    return {spec, ""};
  return {spec.substr(0, colon), spec.substr(colon + 1)};
}

/// The GDAL name of the one vector file in a zip archive.
Result<std::string> vector_in_zip(const std::string& path) {
  const std::string root = "/vsizip/" + path;
  const CPLStringList entries(VSIReadDirRecursive(root.c_str()));
  std::vector<std::string> found;
  for (int i = 0; i < entries.Count(); ++i) {
    const std::string name = root + "/" + entries[i];
    // A shapefile's companions open it, too.
    const std::string extension = CPLGetExtension(name.c_str());
    if (name.back() == '/' || EQUAL(extension.c_str(), "dbf") || EQUAL(extension.c_str(), "shx")) continue;
    if (GDALIdentifyDriverEx(name.c_str(), GDAL_OF_VECTOR, nullptr, nullptr) != nullptr) found.push_back(name);
  }
  if (found.size() == 1) return found[0];
  if (entries.Count() == 0)
    return fail(ErrorKind::kInvalidInput, fmt::format("{}: not a zip archive, or an empty or truncated one", path));
  if (found.empty())
    return fail(ErrorKind::kInvalidInput, fmt::format("{}: the archive holds no vector file that OGR reads", path));
  return fail(ErrorKind::kInvalidInput, fmt::format("{}: the archive holds {} vector files; name one, for example {}",
                                                    path, found.size(), found[0]));
}

std::string layer_names(const std::vector<OGRLayer*>& layers) {
  std::vector<std::string> names;
  names.reserve(layers.size());
  for (OGRLayer* layer : layers) names.emplace_back(layer->GetName());
  return fmt::format("{}", fmt::join(names, ", "));
}

}  // namespace

Result<LineDataset> open_line_dataset(const std::string& spec) {
  GDALAllRegister();
  const Spec parts = split(spec);
  LineDataset out;
  out.path = parts.path;
  out.name = CPLGetFilename(parts.path.c_str());
  if (!parts.layer.empty()) out.name += ":" + parts.layer;
  const bool is_file = exists(parts.path);
  if (is_file && EQUAL(CPLGetExtension(parts.path.c_str()), "zip") && parts.path.rfind("/vsi", 0) != 0) {
    auto inside = vector_in_zip(parts.path);
    if (!inside) return tl::unexpected(inside.error());
    out.path = *inside;
  }

  const GdalErrors errors;
  out.dataset.reset(GDALDataset::Open(out.path.c_str(), GDAL_OF_VECTOR | GDAL_OF_READONLY | GDAL_OF_VERBOSE_ERROR));
  if (!out.dataset && !is_file) {
    return fail(ErrorKind::kNotFound,
                fmt::format("{}: no such file{}", parts.path,
                            parts.layer.empty() ? "" : fmt::format(" (taken as FILE:LAYER from {})", spec)));
  }
  if (!out.dataset) {
    return fail(ErrorKind::kInvalidInput,
                fmt::format("{}: not a vector file that OGR reads; try ogrinfo on it{}", parts.path, errors.detail()));
  }
  std::vector<OGRLayer*> all, with_geometry;
  for (int i = 0; i < out.dataset->GetLayerCount(); ++i) {
    OGRLayer* layer = out.dataset->GetLayer(i);
    if (layer == nullptr) continue;
    all.push_back(layer);
    if (layer->GetLayerDefn()->GetGeomFieldCount() > 0) with_geometry.push_back(layer);
  }
  if (all.empty()) return fail(ErrorKind::kInvalidInput, fmt::format("{}: holds no layer", parts.path));
  if (!parts.layer.empty()) {
    const auto named = std::find_if(all.begin(), all.end(), [&](OGRLayer* l) { return parts.layer == l->GetName(); });
    if (named == all.end()) {
      return fail(ErrorKind::kInvalidInput,
                  fmt::format("{}: no layer '{}'; it has: {}", parts.path, parts.layer, layer_names(all)));
    }
    out.layer = *named;
    return out;
  }
  const std::vector<OGRLayer*>& candidates = with_geometry.empty() ? all : with_geometry;
  if (candidates.size() > 1) {
    return fail(ErrorKind::kInvalidInput,
                fmt::format("{0}: has {1} layers ({2}); name one, as {0}:{3}", parts.path, candidates.size(),
                            layer_names(candidates), candidates[0]->GetName()));
  }
  out.layer = candidates[0];
  return out;
}

}  // namespace tind
