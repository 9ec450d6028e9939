// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/png_image.hpp"

#include <atomic>
#include <cassert>
#include <string>

#include <cpl_vsi.h>
#include <gdal_priv.h>

#include "storage/readers/gdal_errors.hpp"

namespace tind {

Result<Bytes> encode_png(std::span<const std::uint8_t> pixels, int n_rows, int n_cols) {
  assert(pixels.size() == static_cast<std::size_t>(n_rows) * static_cast<std::size_t>(n_cols));
  GDALAllRegister();
  GdalErrors errors;
  GDALDriver* memory = GetGDALDriverManager()->GetDriverByName("MEM");
  GDALDriver* png = GetGDALDriverManager()->GetDriverByName("PNG");
  if (memory == nullptr || png == nullptr) {
    return fail(ErrorKind::kIo, "this GDAL cannot write PNG; install one with the PNG driver");
  }
  const GDALDatasetUniquePtr image(memory->Create("", n_cols, n_rows, 1, GDT_Byte, nullptr));
  if (!image ||
      image->GetRasterBand(1)->RasterIO(GF_Write, 0, 0, n_cols, n_rows, const_cast<std::uint8_t*>(pixels.data()),
                                        n_cols, n_rows, GDT_Byte, 0, 0) != CE_None) {
    return fail(ErrorKind::kIo, "no memory for a picture" + errors.detail());
  }
  static std::atomic<unsigned> count{0};
  const std::string name = "/vsimem/tind-picture-" + std::to_string(count++) + ".png";
  const bool written =
      GDALDatasetUniquePtr(png->CreateCopy(name.c_str(), image.get(), FALSE, nullptr, nullptr, nullptr)) != nullptr;
  Bytes bytes;
  vsi_l_offset n_bytes = 0;
  if (const GByte* data = VSIGetMemFileBuffer(name.c_str(), &n_bytes, FALSE)) bytes.assign(data, data + n_bytes);
  VSIUnlink(name.c_str());
  VSIUnlink((name + ".aux.xml").c_str());
  if (!written || bytes.empty()) return fail(ErrorKind::kIo, "the picture could not be made" + errors.detail());
  return bytes;
}

}  // namespace tind
