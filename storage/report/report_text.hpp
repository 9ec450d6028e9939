// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>

#include "storage/report/pyramid_report.hpp"

namespace tind {

/// The report as tables with a legend, at most 130 columns wide.
std::string pyramid_report_text(const PyramidReport& report);

/// The report as JSON, documented in docs/man/tind-build-report.1.md.
std::string pyramid_report_json(const PyramidReport& report);

}  // namespace tind
