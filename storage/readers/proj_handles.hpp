// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <memory>
#include <string>

#include <ogr_spatialref.h>
#include <proj.h>

namespace tind {

struct ProjDestroy {
  void operator()(PJ_CONTEXT* context) const { proj_context_destroy(context); }
  void operator()(PJ* object) const { proj_destroy(object); }
  void operator()(PJ_OBJ_LIST* list) const { proj_list_destroy(list); }
  void operator()(PJ_OPERATION_FACTORY_CONTEXT* context) const { proj_operation_factory_context_destroy(context); }
};
using ProjContext = std::unique_ptr<PJ_CONTEXT, ProjDestroy>;
using ProjObject = std::unique_ptr<PJ, ProjDestroy>;

/// A context of one's own (PROJ's contexts are for one thread at a time) that prints nothing. Outlives its objects.
ProjContext make_proj_context();
/// PROJ's object for a CRS of OGR; null when PROJ refuses it.
ProjObject to_proj(PJ_CONTEXT* context, const OGRSpatialReference& crs);
/// PROJ's words for the context's last error, in brackets with a space before, or nothing.
std::string proj_detail(PJ_CONTEXT* context);
/// An operation as a PROJ pipeline, or as much as PROJ says.
std::string proj_text(PJ_CONTEXT* context, PJ* operation);

}  // namespace tind
