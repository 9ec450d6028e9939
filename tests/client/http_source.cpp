// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client/http_source.hpp"

#include <curl/curl.h>

#include <mutex>
#include <vector>

namespace tind::client {
namespace {

/// More than any tile: a body that does not end is an error, not a full memory.
constexpr std::size_t kMaxBodyBytes = std::size_t{1} << 30;
constexpr long kConnectTimeoutMs = 10'000;
constexpr long kStallSeconds = 60;

std::size_t append_body(char* data, std::size_t size, std::size_t n, void* user) {
  auto& body = *static_cast<Blob*>(user);
  if (body.size() + size * n > kMaxBodyBytes) return 0;
  body.insert(body.end(), data, data + size * n);
  return size * n;
}

}  // namespace

struct HttpSource::Pool {
  std::mutex mutex;
  std::vector<CURL*> idle;

  ~Pool() {
    for (CURL* handle : idle) curl_easy_cleanup(handle);
  }
  CURL* borrow() {
    const std::lock_guard lock(mutex);
    if (idle.empty()) return curl_easy_init();
    CURL* handle = idle.back();
    idle.pop_back();
    return handle;
  }
  void give_back(CURL* handle) {
    const std::lock_guard lock(mutex);
    idle.push_back(handle);
  }
};

HttpSource::HttpSource(std::string base) : base_(std::move(base)), pool_(std::make_unique<Pool>()) {
  static std::once_flag once;
  std::call_once(once, [] { curl_global_init(CURL_GLOBAL_DEFAULT); });
}

HttpSource::~HttpSource() = default;

Outcome<Answer> HttpSource::get(const std::string& path) {
  CURL* handle = pool_->borrow();
  if (handle == nullptr) return refuse("libcurl gives no handle");
  Answer answer;
  const std::string url = base_ + path;
  char detail[CURL_ERROR_SIZE] = "";
  curl_easy_setopt(handle, CURLOPT_URL, url.c_str());
  curl_easy_setopt(handle, CURLOPT_PROTOCOLS_STR, "http,https");
  curl_easy_setopt(handle, CURLOPT_NOPROXY, "127.0.0.1,localhost,::1");
  curl_easy_setopt(handle, CURLOPT_NOSIGNAL, 1L);
  curl_easy_setopt(handle, CURLOPT_CONNECTTIMEOUT_MS, kConnectTimeoutMs);
  curl_easy_setopt(handle, CURLOPT_LOW_SPEED_LIMIT, 1L);
  curl_easy_setopt(handle, CURLOPT_LOW_SPEED_TIME, kStallSeconds);
  curl_easy_setopt(handle, CURLOPT_USERAGENT, "tind-verify");
  curl_easy_setopt(handle, CURLOPT_ERRORBUFFER, detail);
  curl_easy_setopt(handle, CURLOPT_WRITEFUNCTION, append_body);
  curl_easy_setopt(handle, CURLOPT_WRITEDATA, &answer.body);
  const CURLcode code = curl_easy_perform(handle);
  long status = 0;
  curl_easy_getinfo(handle, CURLINFO_RESPONSE_CODE, &status);
  const char* type = nullptr;
  curl_easy_getinfo(handle, CURLINFO_CONTENT_TYPE, &type);
  if (type != nullptr) answer.content_type = std::string(type).substr(0, std::string(type).find(';'));
  curl_easy_setopt(handle, CURLOPT_ERRORBUFFER, nullptr);
  pool_->give_back(handle);
  if (code != CURLE_OK) {
    return refuse(url + ": " + (detail[0] != '\0' ? std::string(detail) : std::string(curl_easy_strerror(code))));
  }
  answer.status = static_cast<int>(status);
  return answer;
}

Outcome<DatasetUrl> parse_dataset_url(const std::string& url) {
  const std::string hint = "'" + url + "' is no dataset URL: write http://HOST:PORT/NAME";
  const auto scheme = url.find("://");
  if (scheme == std::string::npos) return refuse(hint);
  const std::string protocol = url.substr(0, scheme);
  if (protocol != "http" && protocol != "https") return refuse(hint);
  if (url.find_first_of("?# ") != std::string::npos) return refuse(hint);
  const auto slash = url.find('/', scheme + 3);
  DatasetUrl parts;
  parts.base = url.substr(0, slash);
  if (parts.base.size() == scheme + 3) return refuse(hint);
  if (slash != std::string::npos) parts.name = url.substr(slash + 1);
  while (!parts.name.empty() && parts.name.back() == '/') parts.name.pop_back();
  if (parts.name.find('/') != std::string::npos) return refuse(hint);
  return parts;
}

}  // namespace tind::client
