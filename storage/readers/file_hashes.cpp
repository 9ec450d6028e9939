// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/file_hashes.hpp"

#include <cstdio>

#include <cpl_vsi.h>
#include <fmt/format.h>

#include "storage/readers/sha256.hpp"

namespace tind {

FileHashes::~FileHashes() { given_up_ = true; }

std::size_t FileHashes::add(const std::string& name) {
  const std::scoped_lock lock(mutex_);
  files_.push_back({name, std::nullopt});
  if (n_working_ < most_threads_) {
    ++n_working_;
    threads_.emplace_back([this] { work(); });
  }
  return files_.size() - 1;
}

Result<std::string> FileHashes::wait_for(std::size_t file) {
  std::unique_lock lock(mutex_);
  done_.wait(lock, [&] { return files_[file].hash.has_value(); });
  return *files_[file].hash;
}

void FileHashes::work() {
  std::unique_lock lock(mutex_);
  while (next_ < files_.size() && !given_up_) {
    File& file = files_[next_++];
    lock.unlock();
    auto hash = hash_of(file.name);
    lock.lock();
    file.hash = std::move(hash);
    done_.notify_all();
  }
  --n_working_;
}

Result<std::string> FileHashes::hash_of(const std::string& name) const {
  VSILFILE* file = VSIFOpenL(name.c_str(), "rb");
  if (file == nullptr) return fail(ErrorKind::kIo, fmt::format("{}: cannot read the file", name));
  Sha256 sha;
  std::vector<char> buffer(std::size_t{1} << 18);
  std::size_t n = 0;
  while (!given_up_ && (n = VSIFReadL(buffer.data(), 1, buffer.size(), file)) > 0) sha.update(buffer.data(), n);
  VSIFCloseL(file);
  return sha.finish_hex();
}

}  // namespace tind
