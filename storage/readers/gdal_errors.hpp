// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>

#include <cpl_error.h>

namespace tind {

/// Collects what GDAL, OGR and PROJ would print while it lives: the first failure and the first warning. GDAL's
/// handlers are per thread, so an object stays in the thread and the block that made it; objects nest.
class GdalErrors {
 public:
  GdalErrors() { CPLPushErrorHandlerEx(&GdalErrors::handle, this); }
  ~GdalErrors() { CPLPopErrorHandler(); }
  GdalErrors(const GdalErrors&) = delete;
  GdalErrors& operator=(const GdalErrors&) = delete;

  bool failed() const { return !failure_.empty(); }
  /// GDAL's own words in brackets with a space before, or nothing.
  std::string detail() const;

 private:
  static void CPL_STDCALL handle(CPLErr kind, CPLErrorNum, const char* text);
  std::string failure_, warning_;
};

}  // namespace tind
