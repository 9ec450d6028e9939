// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/store_pages.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cstring>
#include <optional>
#include <utility>
#include <vector>

namespace tind {
namespace {

// mdb.c of LMDB 0.9: MDB_page, MDB_meta, MDB_db and MDB_node, little-endian, 8-byte page numbers.
constexpr std::uint32_t kMagic = 0xBEEFC0DE;
constexpr std::uint32_t kDataVersion = 1;
constexpr std::uint64_t kNoPage = ~std::uint64_t{0};
constexpr std::uint64_t kMetaPages = 2;
constexpr std::size_t kHeaderBytes = StorePages::kHeaderBytes, kMetaBytes = 136, kNodeBytes = 8;
constexpr std::uint16_t kBranch = 1, kLeaf = 2, kOverflow = 4, kMeta = 8;
constexpr std::uint16_t kBigData = 1;      // of a node: the value is on pages of its own
constexpr std::uint16_t kIntegerKeys = 8;  // of a database
constexpr int kMostDepth = 32;             // LMDB's CURSOR_STACK
constexpr std::uint64_t kLeastPageBytes = 512, kMostPageBytes = 65536;

template <class T>
T at(ByteView bytes, std::size_t offset) {
  T value{};
  std::memcpy(&value, bytes.data() + offset, sizeof(T));
  return value;
}

// MDB_db: one B-tree.
struct Tree {
  std::uint16_t flags = 0, depth = 0;
  std::uint64_t n_branch = 0, n_leaf = 0, n_overflow = 0, n_entries = 0, root = kNoPage;
};

struct Meta {
  std::uint64_t page_bytes = 0, last_page = 0, transaction = 0;
  Tree free_pages, records;
};

Tree tree_at(ByteView meta, std::size_t offset) {
  return {at<std::uint16_t>(meta, offset + 4),  at<std::uint16_t>(meta, offset + 6),
          at<std::uint64_t>(meta, offset + 8),  at<std::uint64_t>(meta, offset + 16),
          at<std::uint64_t>(meta, offset + 24), at<std::uint64_t>(meta, offset + 32),
          at<std::uint64_t>(meta, offset + 40)};
}

std::optional<Meta> meta_at(ByteView file, std::uint64_t offset) {
  if (file.size() < kHeaderBytes + kMetaBytes || offset > file.size() - kHeaderBytes - kMetaBytes) return std::nullopt;
  const ByteView page = file.subspan(offset, kHeaderBytes + kMetaBytes);
  const ByteView meta = page.subspan(kHeaderBytes);
  if ((at<std::uint16_t>(page, 10) & kMeta) == 0 || at<std::uint32_t>(meta, 0) != kMagic ||
      at<std::uint32_t>(meta, 4) != kDataVersion) {
    return std::nullopt;
  }
  Meta out;
  out.page_bytes = at<std::uint32_t>(meta, 24);
  out.free_pages = tree_at(meta, 24);
  out.records = tree_at(meta, 72);
  out.last_page = at<std::uint64_t>(meta, 120);
  out.transaction = at<std::uint64_t>(meta, 128);
  if (!std::has_single_bit(out.page_bytes) || out.page_bytes < kLeastPageBytes || out.page_bytes > kMostPageBytes) {
    return std::nullopt;
  }
  return out;
}

// The meta page that LMDB takes: the newer one. nullopt: not an LMDB file.
std::optional<Meta> newest_meta(ByteView file) {
  const auto first = meta_at(file, 0);
  if (!first) return std::nullopt;
  const auto second = meta_at(file, first->page_bytes);
  if (!second || second->page_bytes != first->page_bytes) return std::nullopt;
  return first->transaction < second->transaction ? second : first;
}

std::string flags_fault(const Meta& meta) {
  return fmt::format("the database has flags {:#x} that no builder sets", meta.records.flags);
}

bool less(ByteView a, ByteView b) { return std::lexicographical_compare(a.begin(), a.end(), b.begin(), b.end()); }

// Pages that a value takes which has pages of its own (OVPAGES).
std::uint64_t pages_for(std::uint64_t n_bytes, std::uint64_t page_bytes) {
  return (n_bytes + kHeaderBytes + page_bytes - 1) / page_bytes;
}

struct Node {
  std::size_t offset = 0, end = 0;  // in the page
  ByteView key;
  std::uint64_t number = 0;  // of a leaf: the value's bytes; of a branch: the child's page
  std::uint16_t flags = 0;
};

// nullopt: there is no such node in the page.
std::optional<Node> node_at(ByteView page, std::size_t index, std::size_t upper, bool is_leaf) {
  Node node;
  node.offset = at<std::uint16_t>(page, kHeaderBytes + 2 * index);
  if (node.offset < upper || node.offset % 2 != 0 || node.offset + kNodeBytes > page.size()) return std::nullopt;
  const std::uint64_t low = at<std::uint16_t>(page, node.offset), high = at<std::uint16_t>(page, node.offset + 2);
  node.flags = at<std::uint16_t>(page, node.offset + 4);
  const std::size_t key_bytes = at<std::uint16_t>(page, node.offset + 6);
  node.number = low | high << 16;
  std::size_t data_bytes = 0;
  if (is_leaf) {
    if ((node.flags & ~kBigData) != 0) return std::nullopt;  // no duplicates, no databases within
    data_bytes = (node.flags & kBigData) != 0 ? sizeof(std::uint64_t) : node.number;
  } else {
    node.number |= std::uint64_t{node.flags} << 32;
  }
  if (key_bytes + data_bytes > page.size() - node.offset - kNodeBytes) return std::nullopt;
  node.key = page.subspan(node.offset + kNodeBytes, key_bytes);
  node.end = node.offset + kNodeBytes + key_bytes + data_bytes;
  return node;
}

// All nodes of a page, apart from each other. Empty: the page is damaged.
std::vector<Node> nodes_of(ByteView page, bool is_leaf) {
  const std::size_t lower = at<std::uint16_t>(page, 12), upper = at<std::uint16_t>(page, 14);
  if (lower <= kHeaderBytes || lower % 2 != 0 || lower > upper || upper > page.size()) return {};
  std::vector<Node> nodes;
  std::vector<std::pair<std::size_t, std::size_t>> places;
  for (std::size_t k = 0; k < (lower - kHeaderBytes) / 2; ++k) {
    const auto node = node_at(page, k, upper, is_leaf);
    if (!node) return {};
    nodes.push_back(*node);
    places.emplace_back(node->offset, node->end);
  }
  std::sort(places.begin(), places.end());
  for (std::size_t k = 1; k < places.size(); ++k) {
    if (places[k].first < places[k - 1].second) return {};
  }
  return nodes;
}

// One walk over one tree.
class TreeWalk {
 public:
  TreeWalk(ByteView file, const Meta& meta, const Tree& tree, std::vector<bool>& visited,
           const StorePages::OnRecord& on_record, const StorePages::OnFault& on_fault, bool looks_at_values = true,
           TreeExtent extent = TreeExtent::kWhole)
      : file_(file),
        meta_(meta),
        tree_(tree),
        visited_(visited),
        on_record_(on_record),
        on_fault_(on_fault),
        looks_at_values_(looks_at_values),
        extent_(extent) {}

  void run() {
    if (tree_.root == kNoPage) {
      if (tree_.depth != 0 || tree_.n_entries != 0) fault({}, "the meta page counts records, but has no root page");
      return;
    }
    if (tree_.depth < 1 || tree_.depth > kMostDepth) {
      fault({}, fmt::format("the meta page says that the tree is {} pages deep", tree_.depth));
      return;
    }
    visit(tree_.root, tree_.depth, {}, {});
    if (is_damaged_ || extent_ != TreeExtent::kWhole) return;  // the counts would only repeat it, or are not known
    const auto counted = [&](const char* what, std::uint64_t found, std::uint64_t said) {
      if (found != said) fault({}, fmt::format("{} {} are there, the meta page counts {}", found, what, said));
    };
    counted("records", n_entries_, tree_.n_entries);
    counted("branch pages", n_branch_, tree_.n_branch);
    counted("leaf pages", n_leaf_, tree_.n_leaf);
    counted("overflow pages", n_overflow_, tree_.n_overflow);
  }

 private:
  void fault(ByteView key, const std::string& what) {
    is_damaged_ = true;
    on_fault_(key, what);
  }

  // Takes `n` pages from `page` on. False: not all are in the file, or one was reached before.
  bool claim(std::uint64_t page, std::uint64_t n) {
    if (page < kMetaPages || page > meta_.last_page || n > meta_.last_page - page + 1) return false;
    for (std::uint64_t k = page; k < page + n; ++k) {
      if (visited_[k]) return false;
      visited_[k] = true;
    }
    return true;
  }

  // `first` and `behind`: what the page above says of the keys; empty: nothing.
  void visit(std::uint64_t number, int depth, ByteView first, ByteView behind) {
    if (!claim(number, 1)) {
      return fault(first, fmt::format("page {} is outside the file, or reached twice", number));
    }
    const ByteView page = file_.subspan(number * meta_.page_bytes, meta_.page_bytes);
    const bool is_leaf = depth == 1;
    if (at<std::uint64_t>(page, 0) != number || at<std::uint16_t>(page, 10) != (is_leaf ? kLeaf : kBranch)) {
      return fault(first,
                   fmt::format("page {} is not the {} page that it should be", number, is_leaf ? "leaf" : "branch"));
    }
    const std::vector<Node> nodes = nodes_of(page, is_leaf);
    if (nodes.empty()) return fault(first, fmt::format("page {}: its nodes do not fit the page", number));
    ++(is_leaf ? n_leaf_ : n_branch_);
    for (std::size_t k = 0; k < nodes.size(); ++k) {
      const Node& node = nodes[k];
      const bool has_key = is_leaf || k > 0;  // LMDB leaves out the first key of a branch page
      if (has_key && !is_in_place(node.key, k > (is_leaf ? 0u : 1u) ? nodes[k - 1].key : ByteView(), first, behind)) {
        fault(first, fmt::format("page {}: keys are out of order", number));
        return;
      }
      if (is_leaf) {
        take(node);
      } else if (extent_ == TreeExtent::kWhole || k + 1 == nodes.size()) {
        visit(node.number, depth - 1, has_key ? node.key : first, k + 1 < nodes.size() ? nodes[k + 1].key : behind);
      }
    }
  }

  bool is_in_place(ByteView key, ByteView before, ByteView first, ByteView behind) const {
    if (key.empty()) return false;
    if ((tree_.flags & kIntegerKeys) != 0) return key.size() == sizeof(std::uint64_t);
    return (before.empty() || less(before, key)) && !less(key, first) && (behind.empty() || less(key, behind));
  }

  void take(const Node& node) {
    ++n_entries_;
    if ((node.flags & kBigData) == 0) {
      on_record_(node.key, {node.key.data() + node.key.size(), node.number});
      return;
    }
    std::uint64_t number = 0;
    std::memcpy(&number, node.key.data() + node.key.size(), sizeof(number));
    const std::uint64_t n_pages = pages_for(node.number, meta_.page_bytes);
    if (!claim(number, n_pages)) {
      return fault(node.key,
                   fmt::format("the value's pages, {} from page {} on, are outside the file, or reached twice", n_pages,
                               number));
    }
    const ByteView pages = file_.subspan(number * meta_.page_bytes, n_pages * meta_.page_bytes);
    if (looks_at_values_ && (at<std::uint64_t>(pages, 0) != number || at<std::uint16_t>(pages, 10) != kOverflow ||
                             at<std::uint32_t>(pages, 12) != n_pages)) {
      return fault(node.key, fmt::format("page {} is not the value's page that it should be", number));
    }
    n_overflow_ += n_pages;
    on_record_(node.key, pages.subspan(kHeaderBytes, node.number));
  }

  ByteView file_;
  const Meta& meta_;
  const Tree& tree_;
  std::vector<bool>& visited_;
  const StorePages::OnRecord& on_record_;
  const StorePages::OnFault& on_fault_;
  const bool looks_at_values_;
  const TreeExtent extent_;
  bool is_damaged_ = false;
  std::uint64_t n_entries_ = 0, n_branch_ = 0, n_leaf_ = 0, n_overflow_ = 0;
};

}  // namespace

Result<StorePages> StorePages::open(const std::string& path) {
  const int file = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (file < 0) {
    return fail(errno == ENOENT ? ErrorKind::kNotFound : ErrorKind::kIo, path + ": " + std::strerror(errno));
  }
  auto pages = of_file(file, path);
  ::close(file);
  return pages;
}

Result<StorePages> StorePages::of_file(int file, const std::string& path) {
  struct stat info {};
  if (::fstat(file, &info) != 0 || !S_ISREG(info.st_mode)) {
    return fail(ErrorKind::kInvalidInput, path + ": not a file; give a .tind file");
  }
  const auto n_bytes = static_cast<std::size_t>(info.st_size);
  void* const map = n_bytes == 0 ? MAP_FAILED : ::mmap(nullptr, n_bytes, PROT_READ, MAP_SHARED, file, 0);
  const bool is_mapped = map != MAP_FAILED;
  if (n_bytes > 0 && !is_mapped) return fail(ErrorKind::kIo, path + ": " + std::strerror(errno));
  StorePages pages(is_mapped ? ByteView(static_cast<const std::uint8_t*>(map), n_bytes) : ByteView());
  const auto meta = newest_meta(pages.view_);
  if (!meta) return fail(ErrorKind::kCorrupt, path + ": not a .tind file, or its meta pages are damaged");
  if (meta->last_page < kMetaPages - 1 || meta->last_page >= n_bytes / meta->page_bytes) {
    return fail(ErrorKind::kCorrupt, fmt::format("{}: cut off: {} bytes of at least {} pages of {} bytes", path,
                                                 n_bytes, meta->last_page, meta->page_bytes));
  }
  return pages;
}

StorePages::StorePages(StorePages&& other) noexcept : view_(std::exchange(other.view_, {})) {}
StorePages& StorePages::operator=(StorePages&& other) noexcept {
  std::swap(view_, other.view_);
  return *this;
}
StorePages::~StorePages() {
  if (!view_.empty()) ::munmap(const_cast<std::uint8_t*>(view_.data()), view_.size());
}

void StorePages::walk(const OnRecord& on_record, const OnFault& on_fault) const {
  ::madvise(const_cast<std::uint8_t*>(view_.data()), view_.size(), MADV_SEQUENTIAL);
  const Meta meta = *newest_meta(view_);
  if (meta.records.flags != 0) {
    on_fault({}, flags_fault(meta));
    return;
  }
  std::vector<bool> visited(meta.last_page + 1, false);
  const OnRecord pass_over = [](ByteView, ByteView) {};
  // The list of unused pages: only what holds it is looked at, and that no record is there.
  TreeWalk(view_, meta, meta.free_pages, visited, pass_over, on_fault).run();
  TreeWalk(view_, meta, meta.records, visited, on_record, on_fault).run();
}

std::uint64_t StorePages::page_bytes() const { return newest_meta(view_)->page_bytes; }
std::uint64_t StorePages::n_pages() const { return newest_meta(view_)->last_page + 1; }
std::uint64_t StorePages::n_transactions() const { return newest_meta(view_)->transaction; }

std::uint64_t StorePages::n_pages_of(std::size_t key_bytes, std::size_t value_bytes) const {
  // me_nodemax: at least two nodes a page, each with its place in the page's table.
  constexpr std::size_t kLeastNodes = 2, kPlaceBytes = 2;
  const std::size_t most = ((page_bytes() - kHeaderBytes) / kLeastNodes & ~std::size_t{1}) - kPlaceBytes;
  return kNodeBytes + key_bytes + value_bytes <= most ? 0 : pages_for(value_bytes, page_bytes());
}

bool StorePages::visit_all_leaves(const std::function<void(const LeafNode&)>& visit) const {
  // One page here and there: those around it would fill memory with the whole file.
  ::madvise(const_cast<std::uint8_t*>(view_.data()), view_.size(), MADV_RANDOM);
  const Meta meta = *newest_meta(view_);
  for (std::uint64_t number = kMetaPages; number <= meta.last_page;) {
    const ByteView page = view_.subspan(number * meta.page_bytes, meta.page_bytes);
    const auto kind = at<std::uint16_t>(page, 10);
    if (at<std::uint64_t>(page, 0) != number || (kind != kBranch && kind != kLeaf && kind != kOverflow)) return false;
    if (kind == kOverflow) {
      const auto n = at<std::uint32_t>(page, 12);
      if (n == 0 || n > meta.last_page + 1 - number) return false;
      number += n;
      continue;
    }
    if (kind == kLeaf) {
      const std::vector<Node> nodes = nodes_of(page, true);
      if (nodes.empty()) return false;
      for (const Node& node : nodes) {
        const std::uint64_t at_page = number * meta.page_bytes, behind_key = node.offset + kNodeBytes + node.key.size();
        LeafNode leaf{node.key, at_page + node.offset, at_page + behind_key, node.number, 0};
        if ((node.flags & kBigData) != 0) {
          const auto first = at<std::uint64_t>(page, behind_key);
          leaf.n_pages = pages_for(node.number, meta.page_bytes);
          if (first < kMetaPages || first > meta.last_page || leaf.n_pages > meta.last_page + 1 - first) return false;
          leaf.value_at = first * meta.page_bytes + kHeaderBytes;
        }
        visit(leaf);
      }
    }
    ++number;
  }
  return true;
}

std::optional<std::string> StorePages::find_tree_fault(TreeExtent extent) const {
  const Meta meta = *newest_meta(view_);
  if (meta.records.flags != 0) return flags_fault(meta);
  std::vector<bool> visited(meta.last_page + 1, false);
  std::optional<std::string> first;
  const OnRecord pass_over = [](ByteView, ByteView) {};
  const OnFault note = [&](ByteView, const std::string& what) {
    if (!first) first = what;
  };
  TreeWalk(view_, meta, meta.records, visited, pass_over, note, false, extent).run();
  return first;
}

}  // namespace tind
