// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/inputs_blob.hpp"

#include <algorithm>
#include <cmath>

#include "storage/value_hash.hpp"

namespace tind {
namespace {

constexpr std::uint8_t kFirstTag = 'I';   // of builders before 0.5.0: one digest of all
constexpr std::uint8_t kSecondTag = 'J';  // of 0.5.0: each empty cell by itself
constexpr std::uint8_t kInputsTag = 'K';
// Of the check at the end.
constexpr std::size_t kSealBytes = sizeof(std::uint64_t);

TileInputs::Digest digest_from(ByteReader& in) {
  TileInputs::Digest digest{};
  const ByteView bytes = in.raw(digest.size());
  std::copy(bytes.begin(), bytes.end(), digest.begin());
  return digest;
}

// The hash of all before it ends a record: what the manifest's content hash covers does not include it.
Bytes sealed(Bytes record) {
  ByteWriter seal;
  seal.fixed(value_hash(record));
  const Bytes end = seal.take();
  record.insert(record.end(), end.begin(), end.end());
  return record;
}
bool is_sealed(ByteView record, ByteReader& end) {
  const auto hash = end.fixed<std::uint64_t>();
  return record.size() > kSealBytes && hash == value_hash(record.first(record.size() - kSealBytes));
}

// False where there is no such body.
bool read_body(ByteReader& in, TileInputs& inputs) {
  const auto has_body = in.fixed<std::uint8_t>();
  if (has_body == 0) return true;
  BodySummary body;
  const auto coverage = in.fixed<std::uint8_t>();
  body.stats.coverage = static_cast<TileCoverage>(coverage);
  body.stats.min_z = in.fixed<std::int32_t>();
  body.stats.max_z = in.fixed<std::int32_t>();
  body.stats.n_posts = in.uvarint();
  body.stats.max_error_m = in.fixed<float>();
  body.stats.rmse_m = in.fixed<float>();
  body.n_interior = in.uvarint();
  body.n_triangles = in.uvarint();
  const auto is_error = [](float error_m) { return std::isfinite(error_m) && error_m >= 0; };
  inputs.body = body;
  return has_body == 1 && coverage <= static_cast<std::uint8_t>(TileCoverage::kReal) &&
         is_error(body.stats.max_error_m) && is_error(body.stats.rmse_m);
}

// All up to the cells. False: broken.
bool read_head(ByteReader& in, std::uint8_t& tag, TileInputs& inputs) {
  tag = in.fixed<std::uint8_t>();
  if (tag == kFirstTag) {
    digest_from(in);
  } else {
    inputs.frame = digest_from(in);
    inputs.posts = digest_from(in);
  }
  for (std::uint64_t* n :
       {&inputs.n_inserted, &inputs.n_of_lines, &inputs.n_outside, &inputs.n_line_pieces, &inputs.n_left_out}) {
    *n = in.uvarint();
  }
  return tag == kFirstTag || tag == kSecondTag || (tag == kInputsTag && read_body(in, inputs));
}

// False where no builder can have measured that.
bool read_cells(ByteReader& in, bool has_runs, TileInputs& inputs) {
  inputs.n_cell_levels = in.fixed<std::uint8_t>();
  if (inputs.n_cell_levels == 0) return true;
  if (inputs.n_cell_levels > kMostCellLevels) return false;
  inputs.vertex_posts = in.fixed<std::uint64_t>();
  inputs.cells.resize(std::size_t{1} << (2 * inputs.n_cell_levels));
  for (std::size_t k = 0; k < inputs.cells.size(); ++k) {
    CellErrors& cell = inputs.cells[k];
    cell.n_posts = in.uvarint();
    if (cell.n_posts == 0) {
      const std::uint64_t n_more = has_runs ? in.uvarint() : 0;
      if (n_more >= inputs.cells.size() - k) return false;
      k += n_more;
      continue;
    }
    cell.sum_m2 = in.fixed<double>();
    cell.largest_m = in.fixed<float>();
    if (!std::isfinite(cell.sum_m2) || !std::isfinite(cell.largest_m) || cell.sum_m2 < 0 || cell.largest_m < 0) {
      return false;
    }
  }
  return true;
}

}  // namespace

Bytes encode_inputs(const TileInputs& inputs) {
  ByteWriter out;
  out.fixed(kInputsTag);
  out.raw(inputs.frame);
  out.raw(inputs.posts);
  for (const std::uint64_t n :
       {inputs.n_inserted, inputs.n_of_lines, inputs.n_outside, inputs.n_line_pieces, inputs.n_left_out}) {
    out.uvarint(n);
  }
  out.fixed(static_cast<std::uint8_t>(inputs.body ? 1 : 0));
  if (inputs.body) {
    const TileStats& stats = inputs.body->stats;
    out.fixed(static_cast<std::uint8_t>(stats.coverage));
    out.fixed(stats.min_z);
    out.fixed(stats.max_z);
    out.uvarint(stats.n_posts);
    out.fixed(stats.max_error_m);
    out.fixed(stats.rmse_m);
    out.uvarint(inputs.body->n_interior);
    out.uvarint(inputs.body->n_triangles);
  }
  out.fixed(inputs.n_cell_levels);
  if (inputs.n_cell_levels == 0) return sealed(out.take());
  out.fixed(inputs.vertex_posts);
  for (auto at = inputs.cells.begin(); at != inputs.cells.end();) {
    const CellErrors& cell = *at++;
    out.uvarint(cell.n_posts);
    if (cell.n_posts == 0) {
      const auto next = std::find_if(at, inputs.cells.end(), [](const CellErrors& c) { return c.n_posts != 0; });
      out.uvarint(static_cast<std::uint64_t>(next - at));
      at = next;
      continue;
    }
    out.fixed(cell.sum_m2);
    out.fixed(cell.largest_m);
  }
  return sealed(out.take());
}

Result<TileInputs> decode_inputs(ByteView record) {
  ByteReader in(record);
  TileInputs inputs;
  std::uint8_t tag = 0;
  const bool sound = read_head(in, tag, inputs) &&
                     (tag == kFirstTag || (read_cells(in, tag == kInputsTag, inputs) && is_sealed(record, in)));
  if (!sound || !in.finished()) return fail(ErrorKind::kCorrupt, "broken inputs record");
  return inputs;
}

Result<TileInputs> decode_inputs_head(ByteView record) {
  ByteReader in(record);
  TileInputs inputs;
  std::uint8_t tag = 0;
  bool sound = read_head(in, tag, inputs);
  if (tag == kFirstTag) {
    sound = sound && in.finished();
  } else {
    sound = sound && in.ok() && record.size() >= kSealBytes;
    ByteReader end(sound ? record.last(kSealBytes) : ByteView());
    sound = sound && is_sealed(record, end);
  }
  if (!sound) return fail(ErrorKind::kCorrupt, "broken inputs record");
  return inputs;
}

}  // namespace tind
