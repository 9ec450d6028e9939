// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <functional>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "core/result.hpp"

namespace tind {

/// How a dataset and its base come together.
enum class BaseMode {
  kMerge,      ///< The dataset answers for the base's tiles, too, and its layer.json lists both.
  kParentUrl,  ///< layer.json names the base as `parentUrl`; the client asks both.
};

/// One entry of "datasets": a file or a folder of files.
struct DatasetSpec {
  std::string path;  ///< A .tind file, or a folder whose *.tind are served.
  std::string name;  ///< Served under /NAME/; empty: the file's stem. Not for folders.
  std::string base;  ///< Name of the dataset that has the tiles outside this one; empty: none.
  BaseMode base_mode = BaseMode::kMerge;

  DatasetSpec() = default;
  DatasetSpec(std::string path_) : path(std::move(path_)) {}
  DatasetSpec(const char* path_) : path(path_) {}
  friend bool operator==(const DatasetSpec&, const DatasetSpec&) = default;
};

/// Everything that can be set about the daemon. The initial values are the defaults.
struct Settings {
  std::vector<DatasetSpec> datasets;
  std::string listen = "127.0.0.1:8080";  ///< HOST:PORT or unix:PATH, separated by commas; an IPv6 host in brackets.
  int threads = 0;                        ///< Worker threads; 0: one per core.
  std::string cesium;                     ///< Directory with CesiumJS (npm's cesium/Build/Cesium); empty: none.
  int max_connections = 10000;            ///< Open connections; further ones are answered 503.
  int max_header_bytes = 16384;           ///< Request line and header fields together.
  int request_timeout_s = 10;             ///< From a request's first byte to its last; also for a stalled answer.
  int idle_timeout_s = 60;                ///< An open connection without a request.
  int drain_timeout_s = 10;               ///< After SIGTERM: the most that answers under way may take.
  int max_connections_per_address = 0;    ///< Open connections of one IPv4 address or IPv6 /64 network; 0: no limit.
  int max_requests_per_connection = 0;    ///< The answer to the last one closes the connection; 0: no limit.
  int min_send_rate_bytes_s = 1024;       ///< Of a waiting answer, averaged over request_timeout_s; 0: any progress.
  std::string public_url;                 ///< "https://example.org/terrain"; empty: links are relative.
  std::string trust_proxy = "off";  ///< "on": what Forwarded and X-Forwarded-* say counts where public_url is empty.
  std::string cors_origins = "*";   ///< "*", or origins separated by commas; empty: none.
  int cache_mb = 512;               ///< Memory for finished answers; 0: none.
  std::string admin_listen;         ///< As `listen`: metrics, reload, health, datasets; empty: none.
  std::string watch = "auto";       ///< "auto": inotify and polling; "poll"; "off".
  int poll_interval_s = 10;         ///< Seconds between two looks at the files where nothing tells of a change.
  int max_open_datasets = 256;      ///< Files mapped at a time; the others open when they are asked for.
  std::string log_level = "info";   ///< "debug", "info", "warning" or "error".
  std::string log_format = "text";  ///< "text" or "json", a line each.
  std::string access_log;           ///< A file, or "-" for standard output; empty: none.

  friend bool operator==(const Settings&, const Settings&) = default;
};

/// One setting besides the datasets. The table below is the only place that names settings: command line, environment,
/// configuration file, --help and the tests of schema, example and manual are made from it.
struct OptionSpec {
  const char* name;  ///< As in the configuration file, e.g. "idle_timeout_s"; --idle-timeout-s; TIND_IDLE_TIMEOUT_S.
  const char* value_name;  ///< For --help. With '|' in it: the words allowed.
  const char* help;        ///< One line.
  std::variant<std::string Settings::*, int Settings::*> member;
  int minimum = 0, maximum = 0;  ///< Of integers, both allowed.
};
std::span<const OptionSpec> option_table();

/// "--idle-timeout-s" for "idle_timeout_s".
std::string flag_of(const OptionSpec& option);
/// "TIND_IDLE_TIMEOUT_S" for "idle_timeout_s".
std::string variable_of(const OptionSpec& option);

/// The words allowed, for an option that takes one of a few; empty for others.
std::vector<std::string> choices_of(const OptionSpec& option);
/// Sets one option from text. kInvalidInput, naming `where`, when the text is no value of it.
Result<void> set_option(Settings& settings, const OptionSpec& option, const std::string& text,
                        const std::string& where);

/// The settings as the text of a configuration file that says the same, every member given. With `origins` (by name of
/// the setting, "datasets" too): an object of {"value", "from"} by setting instead, which is no configuration file.
std::string print_settings(const Settings& settings, const std::map<std::string, std::string>* origins = nullptr);
/// The members that a configuration file gives. Empty when it is none.
std::vector<std::string> json_members(std::string_view json);

/// Overlays a configuration file's JSON (config/settings.schema.json). kInvalidInput on anything unknown or out of
/// range.
Result<Settings> overlay_json(Settings base, std::string_view json, const std::string& file_name);

/// Looks up an environment variable; nullopt when it is not set.
using Environment = std::function<std::optional<std::string>(const std::string&)>;
/// Overlays TIND_* variables; TIND_DATASETS is a list of paths separated by colons.
Result<Settings> overlay_environment(Settings base, const Environment& environment);

}  // namespace tind
