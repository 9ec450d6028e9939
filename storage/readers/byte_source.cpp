// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/byte_source.hpp"

#include <algorithm>
#include <vector>

#include <cpl_vsi.h>
#include <fmt/format.h>

#include "storage/readers/gdal_errors.hpp"
#include "storage/readers/sha256.hpp"

namespace tind {
namespace {

class VsiFile : public ByteSource {
 public:
  VsiFile(VSILFILE* file, std::uint64_t n_bytes) : file_(file), n_bytes_(n_bytes) {}
  ~VsiFile() override { VSIFCloseL(file_); }
  VsiFile(const VsiFile&) = delete;
  VsiFile& operator=(const VsiFile&) = delete;

  std::uint64_t size() const override { return n_bytes_; }
  bool read(std::uint64_t offset, std::span<std::uint8_t> to) override {
    if (offset > n_bytes_ || to.size() > n_bytes_ - offset) return false;
    if (to.empty()) return true;
    const GdalErrors quiet;
    return VSIFSeekL(file_, offset, SEEK_SET) == 0 && VSIFReadL(to.data(), 1, to.size(), file_) == to.size();
  }

 private:
  VSILFILE* file_;
  std::uint64_t n_bytes_;
};

}  // namespace

Result<std::unique_ptr<ByteSource>> open_bytes(const std::string& path) {
  const auto refuse = [&](const char* what) {
    return fail(ErrorKind::kInvalidInput, fmt::format("{}: {}", path, what));
  };
  const GdalErrors errors;
  VSIStatBufL stat;
  if (VSIStatL(path.c_str(), &stat) != 0) return refuse("no such file");
  if (VSI_ISDIR(stat.st_mode)) return refuse("is a folder; name the point files in it");
  VSILFILE* file = VSIFOpenL(path.c_str(), "rb");
  if (file == nullptr) return refuse("cannot be opened; check its permissions");
  auto bytes = std::make_unique<VsiFile>(file, static_cast<std::uint64_t>(stat.st_size));
  if (bytes->size() == 0) return refuse("is an empty file");
  return bytes;
}

Result<std::string> sha256_of(ByteSource& bytes, const std::string& path) {
  Sha256 sha;
  std::vector<std::uint8_t> buffer(1 << 20);
  for (std::uint64_t at = 0; at < bytes.size();) {
    const std::size_t n = std::min<std::uint64_t>(buffer.size(), bytes.size() - at);
    if (!bytes.read(at, std::span(buffer).first(n))) {
      return fail(ErrorKind::kIo, fmt::format("{}: reading at byte {} failed", path, at));
    }
    sha.update(buffer.data(), n);
    at += n;
  }
  return sha.finish_hex();
}

}  // namespace tind
