// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/gdal_errors.hpp"

#include <algorithm>

#include <fmt/format.h>

namespace tind {

std::string GdalErrors::detail() const {
  const std::string& text = failure_.empty() ? warning_ : failure_;
  return text.empty() ? "" : fmt::format(" (GDAL: {})", text);
}

void CPL_STDCALL GdalErrors::handle(CPLErr kind, CPLErrorNum, const char* text) {
  auto* self = static_cast<GdalErrors*>(CPLGetErrorHandlerUserData());
  std::string* slot = kind >= CE_Failure ? &self->failure_ : kind == CE_Warning ? &self->warning_ : nullptr;
  if (slot == nullptr || !slot->empty()) return;
  *slot = text == nullptr || *text == '\0' ? "no message" : text;
  std::replace(slot->begin(), slot->end(), '\n', ' ');
}

}  // namespace tind
