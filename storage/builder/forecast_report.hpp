// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>

#include "storage/builder/forecast.hpp"

namespace tind {

/// The forecast for people.
std::string forecast_text(const Forecast& forecast);

/// The forecast for programs; tind-build-plan(1) describes the members.
std::string forecast_json(const Forecast& forecast);

}  // namespace tind
