# SPDX-License-Identifier: GPL-3.0-or-later
# One imported target per third-party library. Everything is a Debian 12 package (see ./dev setup).

find_package(Threads REQUIRED)
find_package(PkgConfig REQUIRED)
find_package(nlohmann_json 3.11 REQUIRED)
find_package(fmt 9 REQUIRED)
find_package(CLI11 2 REQUIRED)
find_package(ZLIB REQUIRED)
pkg_check_modules(LMDB REQUIRED IMPORTED_TARGET lmdb)
pkg_check_modules(ZSTD REQUIRED IMPORTED_TARGET libzstd)
pkg_check_modules(XXHASH REQUIRED IMPORTED_TARGET libxxhash)
if(NOT TIND_TOOLS)
  return()
endif()
find_package(OpenSSL REQUIRED COMPONENTS Crypto)  # SHA-256 of the sources
pkg_check_modules(GDAL REQUIRED IMPORTED_TARGET gdal)
pkg_check_modules(PROJ REQUIRED IMPORTED_TARGET proj)
find_package(GEOS 3.9 CONFIG REQUIRED)  # GDAL brings it in
pkg_check_modules(CURL REQUIRED IMPORTED_TARGET libcurl)

# CGAL is header-only; its exact arithmetic needs GMP and MPFR.
find_package(CGAL 5.5 QUIET)
if(NOT TARGET CGAL::CGAL)
  message(FATAL_ERROR "CGAL 5.5 not found: install libcgal-dev, or run ./dev setup")
endif()
