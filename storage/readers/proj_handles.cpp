// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/proj_handles.hpp"

#include <cpl_conv.h>
#include <fmt/format.h>

namespace tind {

ProjContext make_proj_context() {
  ProjContext context(proj_context_create());
  proj_log_level(context.get(), PJ_LOG_NONE);
  return context;
}

ProjObject to_proj(PJ_CONTEXT* context, const OGRSpatialReference& crs) {
  char* text = nullptr;
  const char* const options[] = {"FORMAT=WKT2_2019", nullptr};
  const bool exported = crs.exportToWkt(&text, options) == OGRERR_NONE;
  ProjObject object(exported ? proj_create(context, text) : nullptr);
  CPLFree(text);
  return object;
}

std::string proj_detail(PJ_CONTEXT* context) {
  const int error = proj_context_errno(context);
  const char* text = error != 0 ? proj_context_errno_string(context, error) : nullptr;
  return text != nullptr ? fmt::format(" (PROJ: {})", text) : "";
}

std::string proj_text(PJ_CONTEXT* context, PJ* operation) {
  if (const char* text = proj_as_proj_string(context, operation, PJ_PROJ_5, nullptr)) return text;
  const char* definition = proj_pj_info(operation).definition;
  return definition != nullptr ? definition : "";
}

}  // namespace tind
