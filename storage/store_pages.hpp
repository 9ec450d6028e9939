// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include "core/format/bytes.hpp"
#include "core/result.hpp"

namespace tind {

/// How much of a file's tree is looked at.
enum class TreeExtent {
  kWhole,     ///< Every branch and leaf page: any record can be read then.
  kLastPath,  ///< The pages on the way to the last record, which is a pyramid's manifest: only that can be read.
};

/// A file of LMDB 0.9 (data format 1, 64-bit) read page by page, without LMDB: LMDB trusts its pages, and a damaged one
/// would take the program down. What walk() finds no fault in, LMDB can read. Not thread safe; nobody may write the
/// file meanwhile.
class StorePages {
 public:
  static constexpr std::size_t kHeaderBytes = 16;  ///< Of a page, and of the first of several that hold one value.

  /// Maps the file and looks at its two meta pages. kNotFound, kIo; kCorrupt: no LMDB file, or cut off.
  static Result<StorePages> open(const std::string& path);
  /// The same of an open file, which stays the caller's; `path` is for messages.
  static Result<StorePages> of_file(int file, const std::string& path);
  StorePages(StorePages&&) noexcept;
  StorePages& operator=(StorePages&&) noexcept;
  ~StorePages();

  /// A record of the unnamed database; the views are valid as long as this object.
  using OnRecord = std::function<void(ByteView key, ByteView value)>;
  /// Something is wrong. `key`: of the record, or the first that the damaged page may hold; empty: the file as a whole.
  using OnFault = std::function<void(ByteView key, const std::string& what)>;

  /// Visits all pages that the newest meta page reaches: each of the right kind, in the file, reached once, its nodes
  /// inside it and apart from each other, keys ascending and between those of the page above; and the meta page's
  /// counts. Records come in key order; those of damaged pages are left out.
  void walk(const OnRecord& on_record, const OnFault& on_fault) const;

  /// What LMDB would stumble over, the first fault only; nullopt: nothing. Pages that hold nothing but one long value
  /// are not looked at, only whether they are in the file, since LMDB reads nothing else of them: some 0.04 to 0.1 ms a
  /// megabyte of a sound file that is in memory.
  std::optional<std::string> find_tree_fault(TreeExtent extent) const;

  std::uint64_t file_bytes() const { return view_.size(); }
  /// Bytes of a page, pages in use at the end or once before, and how many transactions were committed.
  std::uint64_t page_bytes() const;
  std::uint64_t n_pages() const;
  std::uint64_t n_transactions() const;

  /// How many pages of its own LMDB gives to a value; 0: none, it stands in the leaf.
  std::uint64_t n_pages_of(std::size_t key_bytes, std::size_t value_bytes) const;

  /// A leaf's node: where in the file its value's size (two times two bytes, the lower first) and its value stand.
  struct LeafNode {
    ByteView key;
    std::uint64_t size_at = 0, value_at = 0;
    std::uint64_t n_bytes = 0;  ///< Of the value.
    std::uint64_t n_pages = 0;  ///< That hold nothing but the value; 0: it stands in the leaf.
  };
  /// Visits the nodes of all leaf pages in the file, also of those that the tree does not reach any more: what they
  /// held once is still there. Looks at every page's own kind. False: not all pages are of a known kind.
  bool visit_all_leaves(const std::function<void(const LeafNode&)>& visit) const;

 private:
  explicit StorePages(ByteView view) : view_(view) {}
  ByteView view_;  // the map; empty: moved from
};

}  // namespace tind
