// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/static_files.hpp"

#include <fmt/format.h>

#include <array>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string_view>

namespace tind {
namespace {

struct FileType {
  std::string_view suffix;
  const char* content_type;
  bool compressible;
};

constexpr std::array<FileType, 16> kTypes = {{
    {".js", "text/javascript; charset=utf-8", true},
    {".mjs", "text/javascript; charset=utf-8", true},
    {".css", "text/css; charset=utf-8", true},
    {".json", "application/json", true},
    {".html", "text/html; charset=utf-8", true},
    {".xml", "application/xml", true},
    {".txt", "text/plain; charset=utf-8", true},
    {".svg", "image/svg+xml", true},
    {".wasm", "application/wasm", true},
    {".glb", "model/gltf-binary", true},
    {".png", "image/png", false},
    {".jpg", "image/jpeg", false},
    {".jpeg", "image/jpeg", false},
    {".gif", "image/gif", false},
    {".ktx2", "image/ktx2", false},
    {".woff2", "font/woff2", false},
}};

}  // namespace

std::optional<StaticFile> find_static_file(const std::string& root, const std::string& relative) {
  namespace fs = std::filesystem;
  std::error_code error;
  const fs::path path = fs::canonical(fs::path(root) / relative, error);
  if (error || !path.string().starts_with(root + "/") || !fs::is_regular_file(path, error)) return std::nullopt;
  const auto size = fs::file_size(path, error);
  if (error) return std::nullopt;
  const auto time = fs::last_write_time(path, error);
  if (error) return std::nullopt;
  StaticFile file{path.string(), fmt::format("{:x}-{:x}", size, time.time_since_epoch().count()),
                  "application/octet-stream", false};
  const std::string suffix = path.extension().string();
  for (const FileType& type : kTypes) {
    if (suffix != type.suffix) continue;
    file.content_type = type.content_type;
    file.compressible = type.compressible;
  }
  return file;
}

Result<Bytes> read_static_file(const StaticFile& file) {
  std::ifstream in(file.path, std::ios::binary);
  Bytes bytes(std::istreambuf_iterator<char>(in), {});
  if (!in.is_open() || in.bad()) return fail(ErrorKind::kIo, file.path + ": cannot be read");
  return bytes;
}

}  // namespace tind
