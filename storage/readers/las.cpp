// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/las.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

#include <fmt/format.h>

namespace tind {
namespace {

static_assert(std::endian::native == std::endian::little, "LAS is little-endian and read by copying");

/// Shortest point record of formats 0 to 10, bytes.
constexpr std::array<std::size_t, 11> kMinRecordBytes = {20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67};
/// Header sizes of LAS 1.0 to 1.4, bytes.
constexpr std::array<std::size_t, 5> kMinHeaderBytes = {227, 227, 227, 235, 375};
constexpr std::size_t kVlrBytes = 54, kEvlrBytes = 60;
/// A CRS is a few kilobytes.
constexpr std::uint64_t kMaxCrsBytes = std::uint64_t{1} << 20;
/// Extended records of one file: waveforms, CRS, a few of the maker's own.
constexpr std::uint32_t kMaxEvlrs = 4096;
constexpr std::uint8_t kLazBits = 0xc0;
constexpr int kNewFlagsFormat = 6;  // from here on flags and class have a byte each

template <class T>
T load(const std::uint8_t* at) {
  T value;
  std::memcpy(&value, at, sizeof(T));
  return value;
}

/// As many as fit.
template <class T>
std::vector<T> numbers(const std::vector<std::uint8_t>& bytes) {
  std::vector<T> values(bytes.size() / sizeof(T));
  if (!values.empty()) std::memcpy(values.data(), bytes.data(), values.size() * sizeof(T));
  return values;
}

std::string text_field(const std::uint8_t* at, std::size_t n) {
  const std::uint8_t* end = std::find(at, at + n, std::uint8_t{0});
  return {at, end};
}

class LasHeaderReader {
 public:
  LasHeaderReader(ByteSource& bytes, const std::string& path) : bytes_(bytes), path_(path) {}

  Result<LasHeader> read() {
    if (auto ok = read_fixed_part(); !ok) return tl::unexpected(ok.error());
    if (auto ok = read_vlrs(); !ok) return tl::unexpected(ok.error());
    if (auto ok = read_evlrs(); !ok) return tl::unexpected(ok.error());
    if (compressed_) {
      return fail(
          ErrorKind::kUnsupported,
          fmt::format("{0}: is compressed (LAZ), which this build does not read; convert it first: pdal translate "
                      "{0} points.las (or laszip -i {0} -o points.las)",
                      path_));
    }
    return std::move(h_);
  }

 private:
  tl::unexpected<Error> bad(const std::string& what) const {
    return fail(ErrorKind::kInvalidInput, fmt::format("{}: {}", path_, what));
  }

  Result<void> read_fixed_part() {
    std::array<std::uint8_t, 375> raw{};
    const std::size_t n_there = std::min<std::uint64_t>(raw.size(), bytes_.size());
    if (!bytes_.read(0, std::span(raw).first(n_there))) return bad("cannot be read");
    if (n_there < 4 || std::memcmp(raw.data(), "LASF", 4) != 0)
      return bad("is not a LAS file (it does not start with LASF)");
    if (n_there < kMinHeaderBytes[0]) return bad("is truncated within the LAS header");
    const int major = raw[24], minor = raw[25];
    if (major != 1 || minor > 4) {
      return fail(ErrorKind::kUnsupported,
                  fmt::format("{}: LAS version {}.{} is not known (1.0 to 1.4 are); convert it first: pdal translate "
                              "--writers.las.minor_version=4 IN OUT",
                              path_, major, minor));
    }
    h_.version_minor = minor;
    const std::size_t min_header = kMinHeaderBytes[static_cast<std::size_t>(minor)];
    header_bytes_ = load<std::uint16_t>(&raw[94]);
    if (header_bytes_ < min_header) {
      return bad(fmt::format("LAS 1.{} needs a header of {} bytes, its own says {}", minor, min_header, header_bytes_));
    }
    if (bytes_.size() < header_bytes_) return bad("is truncated within the LAS header");
    h_.points_offset = load<std::uint32_t>(&raw[96]);
    n_vlrs_ = load<std::uint32_t>(&raw[100]);
    compressed_ = (raw[104] & kLazBits) != 0;
    h_.point_format = raw[104] & ~kLazBits;
    h_.record_bytes = load<std::uint16_t>(&raw[105]);
    if (static_cast<std::size_t>(h_.point_format) >= kMinRecordBytes.size()) {
      return fail(ErrorKind::kUnsupported,
                  fmt::format("{}: point format {} is not known (0 to 10 are)", path_, h_.point_format));
    }
    const std::size_t min_record = kMinRecordBytes[static_cast<std::size_t>(h_.point_format)];
    if (!compressed_ && h_.record_bytes < min_record) {
      return bad(fmt::format("point format {} needs records of {} bytes, the header says {}", h_.point_format,
                             min_record, h_.record_bytes));
    }
    if (h_.points_offset < header_bytes_ || h_.points_offset > bytes_.size()) {
      return bad(
          fmt::format("the points should start at byte {}, which is outside the file's {} bytes or inside its header",
                      h_.points_offset, bytes_.size()));
    }
    h_.n_points = load<std::uint32_t>(&raw[107]);
    if (minor >= 4) {
      evlrs_offset_ = load<std::uint64_t>(&raw[235]);
      n_evlrs_ = load<std::uint32_t>(&raw[243]);
      // Files with more than 2^32 points, or of the new formats, have 0 in the old field.
      if (const auto n = load<std::uint64_t>(&raw[247]); n != 0) h_.n_points = n;
    }
    for (std::size_t i = 0; i < 3; ++i) {
      h_.scale[i] = load<double>(&raw[131 + 8 * i]);
      h_.offset[i] = load<double>(&raw[155 + 8 * i]);
      if (!std::isfinite(h_.scale[i]) || !std::isfinite(h_.offset[i]) || h_.scale[i] == 0) {
        return bad(fmt::format("scale {} and offset {} of coordinate {} make no coordinates; its header is damaged",
                               h_.scale[i], h_.offset[i], "xyz"[i]));
      }
    }
    if (compressed_) return {};
    // Extended records follow the points.
    const bool ends_early = n_evlrs_ > 0 && evlrs_offset_ >= h_.points_offset && evlrs_offset_ < bytes_.size();
    const std::uint64_t end = ends_early ? evlrs_offset_ : bytes_.size();
    const std::uint64_t n_held = (end - h_.points_offset) / h_.record_bytes;
    if (h_.n_points > n_held) {
      return bad(fmt::format("is truncated: its header announces {} points, it holds {}", h_.n_points, n_held));
    }
    return {};
  }

  Result<void> read_vlrs() {
    std::uint64_t at = header_bytes_;
    for (std::uint32_t i = 0; i < n_vlrs_; ++i) {
      std::array<std::uint8_t, kVlrBytes> raw{};
      if (h_.points_offset - at < kVlrBytes || !bytes_.read(at, raw)) {
        return bad(
            fmt::format("variable length record {} of {} runs into the points; its header is damaged", i, n_vlrs_));
      }
      at += kVlrBytes;
      const std::uint64_t n = load<std::uint16_t>(&raw[20]);
      if (h_.points_offset - at < n) {
        return bad(
            fmt::format("variable length record {} of {} runs into the points; its header is damaged", i, n_vlrs_));
      }
      if (auto ok = take_record(raw.data(), at, n); !ok) return ok;
      at += n;
    }
    return {};
  }

  Result<void> read_evlrs() {
    if (n_evlrs_ > kMaxEvlrs)
      return bad(fmt::format("{} extended records are not plausible; its header is damaged", n_evlrs_));
    std::uint64_t at = evlrs_offset_;
    for (std::uint32_t i = 0; i < n_evlrs_; ++i) {
      std::array<std::uint8_t, kEvlrBytes> raw{};
      if (at > bytes_.size() || bytes_.size() - at < kEvlrBytes || !bytes_.read(at, raw)) {
        return bad(
            fmt::format("extended record {} of {} lies beyond the file's end: truncated or damaged", i, n_evlrs_));
      }
      at += kEvlrBytes;
      const auto n = load<std::uint64_t>(&raw[20]);
      if (bytes_.size() - at < n) {
        return bad(
            fmt::format("extended record {} of {} lies beyond the file's end: truncated or damaged", i, n_evlrs_));
      }
      if (auto ok = take_record(raw.data(), at, n); !ok) return ok;
      at += n;
    }
    return {};
  }

  /// Keeps the record if it says something about the CRS. `n` bytes from `at` on lie within the file.
  Result<void> take_record(const std::uint8_t* raw, std::uint64_t at, std::uint64_t n) {
    const std::string user = text_field(raw + 2, 16);
    const int id = load<std::uint16_t>(raw + 18);
    if (user == "laszip encoded") compressed_ = true;
    if (user != "LASF_Projection" || (id != 2112 && (id < 34735 || id > 34737))) return {};
    if (n > kMaxCrsBytes) return bad(fmt::format("a CRS of {} bytes is not plausible; its header is damaged", n));
    std::vector<std::uint8_t> body(n);
    if (!bytes_.read(at, body)) return bad("cannot be read");
    if (id == 2112) {
      h_.crs.wkt = text_field(body.data(), n);
    } else if (id == 34735) {
      h_.crs.geo_keys = numbers<std::uint16_t>(body);
    } else if (id == 34736) {
      h_.crs.geo_doubles = numbers<double>(body);
    } else {
      h_.crs.geo_ascii = text_field(body.data(), n);
    }
    return {};
  }

  ByteSource& bytes_;
  const std::string& path_;
  LasHeader h_;
  std::uint64_t header_bytes_ = 0, evlrs_offset_ = 0;
  std::uint32_t n_vlrs_ = 0, n_evlrs_ = 0;
  bool compressed_ = false;
};

}  // namespace

Result<LasHeader> read_las_header(ByteSource& bytes, const std::string& path) {
  return LasHeaderReader(bytes, path).read();
}

void decode_las_points(const LasHeader& header, std::span<const std::uint8_t> records, std::vector<LasPoint>& points) {
  const std::size_t n = records.size() / header.record_bytes;
  points.reserve(points.size() + n);
  for (std::size_t i = 0; i < n; ++i) {
    const std::uint8_t* at = records.data() + i * header.record_bytes;
    LasPoint p;
    p.x = load<std::int32_t>(at) * header.scale[0] + header.offset[0];
    p.y = load<std::int32_t>(at + 4) * header.scale[1] + header.offset[1];
    p.z = load<std::int32_t>(at + 8) * header.scale[2] + header.offset[2];
    if (header.point_format >= kNewFlagsFormat) {
      p.withheld = (at[15] & 0x04) != 0;
      p.classification = at[16];
    } else {
      p.withheld = (at[15] & 0x80) != 0;
      p.classification = at[15] & 0x1f;
    }
    points.push_back(p);
  }
}

}  // namespace tind
