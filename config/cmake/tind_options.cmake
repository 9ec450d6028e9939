# SPDX-License-Identifier: GPL-3.0-or-later
# Interface targets that our libraries link; never global flags.

add_library(tind_language INTERFACE)
target_compile_features(tind_language INTERFACE cxx_std_20)
target_include_directories(tind_language INTERFACE ${PROJECT_SOURCE_DIR})
# The same bytes everywhere: no contraction of a*b+c into one rounding.
target_compile_options(tind_language INTERFACE -ffp-contract=off)

add_library(tind_warnings INTERFACE)
target_compile_options(tind_warnings INTERFACE -Wall -Wextra -Wpedantic -Wshadow -Wnon-virtual-dtor -Wold-style-cast)

add_library(tind_sanitizers INTERFACE)
if(TIND_SANITIZE)
  target_compile_options(tind_sanitizers INTERFACE -fsanitize=${TIND_SANITIZE} -fno-omit-frame-pointer -fno-sanitize-recover=all)
  target_link_options(tind_sanitizers INTERFACE -fsanitize=${TIND_SANITIZE})
endif()

# Addresses of library functions are found before main() and are constant from then on.
add_library(tind_hardening INTERFACE)
target_link_options(tind_hardening INTERFACE LINKER:-z,relro,-z,now)

# tind_library(NAME SOURCES... ): a static library with the project's language, warnings and sanitizers.
function(tind_library name)
  add_library(${name} STATIC ${ARGN})
  target_link_libraries(${name} PUBLIC tind_language tind_sanitizers PRIVATE tind_warnings)
endfunction()

# tind_program(NAME SOURCES...): the same for an executable.
function(tind_program name)
  add_executable(${name} ${ARGN})
  target_link_libraries(${name} PRIVATE tind_language tind_sanitizers tind_warnings tind_hardening)
endfunction()
