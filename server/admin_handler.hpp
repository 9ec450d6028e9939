// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>
#include <string_view>

#include "server/handler.hpp"
#include "server/keeper.hpp"
#include "server/metrics.hpp"

namespace tind {

/// The operator's interface, docs/http.md: /metrics, /-/health, /-/datasets and POST /-/reload, on a listener of its
/// own. For one thread, which waits while it reloads.
class AdminHandler final : public RequestHandler {
 public:
  AdminHandler(MetricsSources sources, Keeper& keeper) : sources_(std::move(sources)), keeper_(keeper) {}

  void handle(const Request& request, WorkerState& worker, Response& out) override;
  void refuse(int status, std::string_view why, Response& out) override;

 private:
  void reload(Response& out);

  const MetricsSources sources_;
  Keeper& keeper_;
};

/// `/-/datasets`: what is served and what is not, and why.
std::string describe_datasets(const Site& site);
/// The answer to `/-/reload`.
std::string describe_reload(const ReloadReport& report);

}  // namespace tind
