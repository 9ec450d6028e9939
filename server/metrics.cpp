// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/metrics.hpp"

#include <dirent.h>
#include <fmt/format.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <fstream>
#include <iterator>
#include <sstream>

#include "server/keeper.hpp"
#include "server/log.hpp"

namespace tind {
namespace {

constexpr std::array<std::string_view, kRouteKinds> kRouteNames = {
    "none", "index", "datasets", "health",  "ready", "asset", "cesium", "globe",
    "meta", "layer", "redirect", "terrain", "vn",    "parts", "piece",  "codes"};
constexpr std::array<std::string_view, WorkerCounters::kCodings> kCodingNames = {"identity", "gzip", "zstd"};

std::size_t status_index(int status) {
  const auto& all = WorkerCounters::kStatuses;
  const auto found = std::find(all.begin(), all.end() - 1, status);
  return static_cast<std::size_t>(found - all.begin());
}

std::size_t coding_index(Coding coding) { return coding == Coding::kZstd ? 2 : coding == Coding::kGzip ? 1 : 0; }

// A label's value: backslash, quote and newline are escaped.
std::string escaped(std::string_view text) {
  std::string out;
  for (const char c : text) {
    if (c == '\n') {
      out += "\\n";
      continue;
    }
    if (c == '\\' || c == '"') out += '\\';
    out += c;
  }
  return out;
}

class Writer {
 public:
  void family(const char* name, const char* type, const char* help) {
    out_ += fmt::format("# HELP {0} {1}\n# TYPE {0} {2}\n", name, help, type);
    name_ = name;
  }
  template <class Value>
  void sample(const std::string& labels, Value value, const char* suffix = "") {
    out_ += labels.empty() ? fmt::format("{}{} {}\n", name_, suffix, value)
                           : fmt::format("{}{}{{{}}} {}\n", name_, suffix, labels, value);
  }
  template <class Value>
  void single(const char* name, const char* type, const char* help, Value value) {
    family(name, type, help);
    sample("", value);
  }
  std::string take() { return std::move(out_); }

 private:
  std::string out_, name_;
};

template <class Get>
std::uint64_t sum(const std::vector<const WorkerCounters*>& workers, Get&& get) {
  std::uint64_t total = 0;
  for (const WorkerCounters* worker : workers) total += get(*worker);
  return total;
}

void write_requests(Writer& out, const std::vector<const WorkerCounters*>& workers) {
  out.family("tind_http_requests_total", "counter", "Answers by route, status and content coding.");
  for (std::size_t route = 0; route < kRouteKinds; ++route) {
    for (std::size_t status = 0; status < WorkerCounters::kStatuses.size(); ++status) {
      for (std::size_t coding = 0; coding < WorkerCounters::kCodings; ++coding) {
        const auto n = sum(workers, [&](const auto& w) { return w.requests[route][status][coding].value(); });
        if (n == 0) continue;
        const int number = WorkerCounters::kStatuses[status];
        out.sample(fmt::format(R"(route="{}",status="{}",encoding="{}")", kRouteNames[route],
                               number == 0 ? "other" : std::to_string(number), kCodingNames[coding]),
                   n);
      }
    }
  }
  out.family("tind_http_response_bytes_total", "counter", "Bytes of answers, heads and bodies, by route.");
  for (std::size_t route = 0; route < kRouteKinds; ++route) {
    const auto n = sum(workers, [&](const auto& w) { return w.bytes[route].value(); });
    if (n > 0) out.sample(fmt::format(R"(route="{}")", kRouteNames[route]), n);
  }
  out.family("tind_http_request_duration_seconds", "histogram",
             "From an event loop's turn to the answer in the socket.");
  std::uint64_t total = 0;
  for (std::size_t k = 0; k <= WorkerCounters::kBounds_s.size(); ++k) {
    total += sum(workers, [&](const auto& w) { return w.durations[k].value(); });
    const bool last = k == WorkerCounters::kBounds_s.size();
    out.sample(last ? R"(le="+Inf")" : fmt::format(R"(le="{}")", WorkerCounters::kBounds_s[k]), total, "_bucket");
  }
  const auto duration_ns = sum(workers, [](const auto& w) { return w.duration_ns.value(); });
  out.sample("", static_cast<double>(duration_ns) * 1e-9, "_sum");
  out.sample("", total, "_count");
  out.single("tind_open_transactions", "gauge", "Read transactions that event loops keep on open files.",
             sum(workers, [](const auto& w) { return w.n_open_transactions.load(std::memory_order_relaxed); }));
}

void write_connections(Writer& out, const ConnectionTable& connections) {
  out.single("tind_connections", "gauge", "Open connections.", connections.n_open());
  out.single("tind_connections_accepted_total", "counter", "Connections taken.",
             connections.count_of(ConnectionEvent::kAccepted));
  out.family("tind_connections_refused_total", "counter", "Connections answered 503 at once, by the limit.");
  out.sample(R"(reason="connections")", connections.count_of(ConnectionEvent::kRefusedFull));
  out.sample(R"(reason="address")", connections.count_of(ConnectionEvent::kRefusedAddress));
  out.family("tind_connections_cut_total", "counter", "Connections ended by the daemon, by the deadline missed.");
  out.sample(R"(reason="idle")", connections.count_of(ConnectionEvent::kIdleTimeout));
  out.sample(R"(reason="request")", connections.count_of(ConnectionEvent::kRequestTimeout));
  out.sample(R"(reason="slow_reader")", connections.count_of(ConnectionEvent::kSlowReader));
}

void write_cache(Writer& out, const ResponseCache& cache) {
  const auto counts = cache.counts();
  out.single("tind_cache_hits_total", "counter", "Answers found in the cache.", counts.n_hits);
  out.single("tind_cache_misses_total", "counter", "Answers made for the cache.", counts.n_puts);
  out.single("tind_cache_bytes", "gauge", "Memory of cached answers.", cache.n_bytes());
  out.single("tind_cache_capacity_bytes", "gauge", "Memory that cached answers may take.", cache.capacity_bytes());
}

void write_datasets(Writer& out, const Site& site) {
  out.single("tind_datasets", "gauge", "Datasets known.", site.slots.size());
  std::size_t n_open = 0;
  std::string infos;
  out.family("tind_dataset_requests_total", "counter", "Requests that named the dataset.");
  for (const auto& slot : site.slots) {
    if (const auto n = slot->n_requests(); n > 0) {
      out.sample(fmt::format(R"(dataset="{}")", escaped(slot->source().name)), n);
    }
  }
  out.family("tind_dataset_info", "gauge", "1 for each open dataset, with the version that is served.");
  for (const auto& slot : site.slots) {
    const auto served = slot->if_open();
    if (!served) continue;
    ++n_open;
    out.sample(fmt::format(R"(dataset="{}",version="{}")", escaped(slot->source().name), served->version), 1);
  }
  out.single("tind_datasets_open", "gauge", "Datasets whose file is open.", n_open);
}

void write_keeper(Writer& out, const Keeper& keeper) {
  out.single("tind_dataset_changes_total", "counter", "Datasets added, replaced or removed.",
             keeper.n_dataset_changes());
  out.single("tind_dataset_failures_total", "counter", "Files and bases that were refused.",
             keeper.n_dataset_failures());
  out.family("tind_reloads_total", "counter", "Reloads asked for, by result.");
  out.sample(R"(result="ok")", keeper.n_reloads_ok());
  out.sample(R"(result="failed")", keeper.n_reloads_failed());
}

double ticks_to_seconds(std::uint64_t ticks) {
  return static_cast<double>(ticks) / static_cast<double>(::sysconf(_SC_CLK_TCK));
}

std::size_t n_open_fds() {
  DIR* directory = ::opendir("/proc/self/fd");
  if (!directory) return 0;
  std::size_t n = 0;
  while (::readdir(directory)) ++n;
  ::closedir(directory);
  return n < 3 ? 0 : n - 3;  // itself, "." and ".."
}

void write_process(Writer& out, std::int64_t started_s) {
  std::ifstream in("/proc/self/stat");
  const std::string stat{std::istreambuf_iterator<char>(in), {}};
  // The second field is the program's name in brackets and may hold anything; the third follows its last bracket.
  std::istringstream fields(stat.substr(std::min(stat.size(), stat.rfind(')') + 1)));
  std::vector<std::string> values{std::istream_iterator<std::string>(fields), {}};
  values.resize(24);  // proc(5): the third field is values[0]
  const auto number = [&](std::size_t field) { return std::strtoull(values[field - 3].c_str(), nullptr, 10); };
  rlimit limit{};
  ::getrlimit(RLIMIT_NOFILE, &limit);
  out.single("process_cpu_seconds_total", "counter", "Processor time, user and system.",
             ticks_to_seconds(number(14) + number(15)));
  out.single("process_virtual_memory_bytes", "gauge", "Address space; files are mapped into it.", number(23));
  out.single("process_resident_memory_bytes", "gauge", "Memory in use, pages of mapped files included.",
             number(24) * static_cast<std::uint64_t>(::sysconf(_SC_PAGESIZE)));
  out.single("process_start_time_seconds", "gauge", "When the daemon started, since 1970.", started_s);
  out.single("process_open_fds", "gauge", "Open file descriptors.", n_open_fds());
  out.single("process_max_fds", "gauge", "File descriptors allowed.", limit.rlim_cur);
}

}  // namespace

std::string_view route_name(RouteKind kind) { return kRouteNames[static_cast<std::size_t>(kind)]; }

void WorkerCounters::count(const Response& response, std::size_t n_bytes) {
  const auto route = static_cast<std::size_t>(response.route);
  requests[route][status_index(response.status)][coding_index(response.coding)].add(1);
  bytes[route].add(n_bytes);
}

void WorkerCounters::observe(std::chrono::nanoseconds duration, std::uint64_t n) {
  const double seconds = static_cast<double>(duration.count()) * 1e-9;
  std::size_t bucket = 0;
  while (bucket < kBounds_s.size() && seconds > kBounds_s[bucket]) ++bucket;
  durations[bucket].add(n);
  duration_ns.add(static_cast<std::uint64_t>(duration.count()) * n);
}

std::string format_metrics(const MetricsSources& sources) {
  Writer out;
  out.family("tind_build_info", "gauge", "1, with the daemon's version.");
  out.sample(R"(version=")" TIND_VERSION R"(")", 1);
  write_requests(out, sources.workers);
  if (sources.connections) write_connections(out, *sources.connections);
  if (sources.cache) write_cache(out, *sources.cache);
  if (sources.site) write_datasets(out, *sources.site->current());
  if (sources.keeper) write_keeper(out, *sources.keeper);
  out.family("tind_log_lines_dropped_total", "counter", "Lines that a full disk or a slow reader cost.");
  out.sample(R"(log="error")", n_log_lines_dropped());
  out.sample(R"(log="access")", sources.access_lines_dropped ? sources.access_lines_dropped() : 0);
  write_process(out, sources.started_s);
  return out.take();
}

}  // namespace tind
