// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>

#include <gdal_priv.h>
#include <ogrsf_frmts.h>

#include "core/result.hpp"

namespace tind {

/// One opened layer of a vector file.
struct LineDataset {
  std::string name;  ///< File name without folders, with :LAYER where one was named.
  std::string path;  ///< As opened.
  GDALDatasetUniquePtr dataset;
  OGRLayer* layer = nullptr;  ///< Owned by the dataset.
};

/// Opens FILE or FILE:LAYER. Errors as read_line_file's.
Result<LineDataset> open_line_dataset(const std::string& spec);

}  // namespace tind
