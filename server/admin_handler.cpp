// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/admin_handler.hpp"

#include <chrono>
#include <nlohmann/json.hpp>

namespace tind {
namespace {

using nlohmann::ordered_json;

constexpr auto kPatience = std::chrono::seconds(60);
constexpr std::string_view kNever = "Cache-Control: no-store\r\n";
constexpr const char* kJson = "application/json";
constexpr const char* kPrometheus = "text/plain; version=0.0.4; charset=utf-8";

std::string dump(const ordered_json& json) {
  return json.dump(-1, ' ', false, ordered_json::error_handler_t::replace) + "\n";
}

void whole_response(Response& out, int status, const char* content_type, std::string body) {
  out.reset();
  out.status = status;
  out.fields.append("Content-Type: ").append(content_type).append("\r\n").append(kNever);
  out.content_length = body.size();
  out.lead = std::move(body);
}

}  // namespace

std::string describe_datasets(const Site& site) {
  ordered_json list = ordered_json::array();
  for (const auto& slot : site.slots) {
    const DatasetSource& source = slot->source();
    ordered_json entry = {{"name", source.name}, {"path", source.path}};
    const auto error = slot->error();
    const auto served = slot->if_open();
    entry["state"] = error ? "failed" : served ? "open" : "closed";
    if (error) entry["error"] = error->message;
    if (const auto summary = slot->summary()) entry["version"] = served ? served->version : summary->version;
    entry["bytes"] = source.stamp.size_bytes;
    entry["modified_s"] = source.stamp.modified_ns / 1'000'000'000;
    if (!source.base.empty()) entry["base"] = source.base;
    entry["requests"] = slot->n_requests();
    list.push_back(std::move(entry));
  }
  return dump({{"datasets", std::move(list)}});
}

std::string describe_reload(const ReloadReport& report) {
  ordered_json failed = ordered_json::array();
  for (const ScanProblem& problem : report.datasets.failed) {
    failed.push_back({{"subject", problem.subject}, {"message", problem.message}});
  }
  ordered_json json = {{"ok", report.ok()},
                       {"added", report.datasets.added},
                       {"replaced", report.datasets.replaced},
                       {"removed", report.datasets.removed},
                       {"unchanged", report.datasets.n_unchanged},
                       {"failed", std::move(failed)},
                       {"restart_needed", report.restart_needed}};
  if (!report.settings_error.empty()) json["settings_error"] = report.settings_error;
  return dump(json);
}

void AdminHandler::reload(Response& out) {
  const auto report = keeper_.reload(kPatience);
  if (!report) return problem_response(out, 503, "the reload takes long and goes on", "/-/reload", kNever);
  whole_response(out, report->ok() ? 200 : 500, kJson, describe_reload(*report));
}

void AdminHandler::handle(const Request& request, WorkerState& worker, Response& out) {
  const std::string_view path = request.target.substr(0, request.target.find('?'));
  const bool is_get = request.method == "GET" || request.method == "HEAD";
  const bool is_reload = path == "/-/reload";
  const bool known = is_reload || path == "/metrics" || path == "/-/health" || path == "/-/datasets";
  if (!known) {
    problem_response(out, 404, "no such address", request.target, kNever);
  } else if (is_reload ? request.method != "POST" : !is_get) {
    problem_response(out, 405, is_reload ? "only POST" : "only GET and HEAD", request.target,
                     is_reload ? "Allow: POST\r\n" : "Allow: GET, HEAD\r\n");
  } else if (is_reload) {
    reload(out);
  } else if (path == "/metrics") {
    whole_response(out, 200, kPrometheus, format_metrics(sources_));
  } else if (path == "/-/datasets") {
    whole_response(out, 200, kJson, describe_datasets(worker.site()));
  } else {
    text_response(out, 200, "ok", kNever);
  }
  if (request.method == "HEAD") out.drop_body();
}

void AdminHandler::refuse(int status, std::string_view why, Response& out) { problem_response(out, status, why); }

}  // namespace tind
