# SPDX-License-Identifier: GPL-3.0-or-later
# What is installed, and the Debian packages of it: `cpack` in the build folder makes tind (the daemon) and tind-tools
# (the builder and the verifier).

include(GNUInstallDirs)
find_program(PANDOC pandoc)

# tind_man_pages(COMPONENT NAME...): docs/man/NAME.1.md as man pages, where there is pandoc to make them.
function(tind_man_pages component)
  if(NOT PANDOC)
    message(STATUS "No pandoc: ${component} will have no man pages")
    return()
  endif()
  foreach(name ${ARGN})
    set(source ${PROJECT_SOURCE_DIR}/docs/man/${name}.1.md)
    set(page ${PROJECT_BINARY_DIR}/man/${name}.1.gz)
    # --check must stay two hyphens, and [options] is no link. No name and no time in the gzip header.
    add_custom_command(OUTPUT ${page} DEPENDS ${source} VERBATIM
      COMMAND ${CMAKE_COMMAND} -E make_directory ${PROJECT_BINARY_DIR}/man
      COMMAND sh -c "'${PANDOC}' -s -f markdown-smart-implicit_header_references -t man --shift-heading-level-by=-1 \
        '${source}' | gzip -9n >'${page}'")
    list(APPEND pages ${page})
  endforeach()
  add_custom_target(man_${component} ALL DEPENDS ${pages})
  install(FILES ${pages} DESTINATION ${CMAKE_INSTALL_MANDIR}/man1 COMPONENT ${component})
endfunction()

# tind_documents(COMPONENT PACKAGE): copyright and changelog where Debian looks for them.
function(tind_documents component package)
  set(folder ${PROJECT_BINARY_DIR}/documents/${package})
  file(MAKE_DIRECTORY ${folder})
  configure_file(${PROJECT_SOURCE_DIR}/docker/debian/copyright ${folder}/copyright COPYONLY)
  configure_file(${PROJECT_SOURCE_DIR}/docker/debian/changelog.in ${folder}/changelog @ONLY)
  add_custom_command(OUTPUT ${folder}/changelog.gz DEPENDS ${folder}/changelog VERBATIM
    COMMAND sh -c "gzip -9nc '${folder}/changelog' >'${folder}/changelog.gz'")
  add_custom_target(documents_${component} ALL DEPENDS ${folder}/changelog.gz)
  install(FILES ${folder}/copyright ${folder}/changelog.gz DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/${package}
    COMPONENT ${component})
endfunction()

install(TARGETS tind RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT daemon)
install(FILES ${PROJECT_SOURCE_DIR}/docker/tind.service ${PROJECT_SOURCE_DIR}/docker/tind.socket
  DESTINATION /lib/systemd/system COMPONENT daemon)
install(FILES ${PROJECT_SOURCE_DIR}/docker/debian/tind.json DESTINATION /etc/tind COMPONENT daemon)
install(DIRECTORY DESTINATION /var/lib/tind COMPONENT daemon)
install(FILES ${PROJECT_SOURCE_DIR}/docs/operations.md ${PROJECT_SOURCE_DIR}/docs/http.md
  ${PROJECT_SOURCE_DIR}/docs/grafana/tind.json ${PROJECT_SOURCE_DIR}/docker/nginx.conf
  ${PROJECT_SOURCE_DIR}/config/settings.schema.json
  DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/tind COMPONENT daemon)
tind_man_pages(daemon tind)
tind_documents(daemon tind)
if(TIND_TOOLS)
  install(TARGETS tind-build tind-verify RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT tools)
  tind_man_pages(tools tind-build tind-build-merge tind-build-plan tind-build-report tind-build-update tind-verify)
  tind_documents(tools tind-tools)
endif()

set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_CONTACT "The tind project <tind@tind.invalid>")
set(CPACK_PACKAGE_VERSION ${PROJECT_VERSION})
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_STRIP_FILES ON)
set(CPACK_INSTALL_DEFAULT_DIRECTORY_PERMISSIONS
  OWNER_READ OWNER_WRITE OWNER_EXECUTE GROUP_READ GROUP_EXECUTE WORLD_READ WORLD_EXECUTE)
set(CPACK_COMPONENTS_ALL daemon)
if(TIND_TOOLS)
  list(APPEND CPACK_COMPONENTS_ALL tools)
endif()
set(CPACK_COMPONENTS_GROUPING IGNORE)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_PACKAGE_CONTROL_STRICT_PERMISSION ON)
set(CPACK_DEBIAN_COMPRESSION_TYPE xz)
set(CPACK_DEBIAN_PACKAGE_PRIORITY optional)

set(CPACK_DEBIAN_DAEMON_PACKAGE_NAME tind)
set(CPACK_DEBIAN_DAEMON_PACKAGE_SECTION net)
set(CPACK_COMPONENT_DAEMON_DESCRIPTION "daemon that streams multi-resolution TIN terrain over HTTP
Serves pyramids of triangulated terrain tiles, made by tind-build, to globes:
quantized-mesh for CesiumJS, cesium-native and QGIS, and raw pieces and codes
with which tiles of any two levels join without a crack. Files are served out
of a memory map and may be replaced while they are served.")
set(CPACK_DEBIAN_DAEMON_PACKAGE_SUGGESTS "tind-tools, nginx, prometheus")
set(CPACK_DEBIAN_DAEMON_PACKAGE_CONTROL_EXTRA
  ${PROJECT_SOURCE_DIR}/docker/debian/conffiles ${PROJECT_SOURCE_DIR}/docker/debian/postinst
  ${PROJECT_SOURCE_DIR}/docker/debian/prerm ${PROJECT_SOURCE_DIR}/docker/debian/postrm)

set(CPACK_DEBIAN_TOOLS_PACKAGE_NAME tind-tools)
set(CPACK_DEBIAN_TOOLS_PACKAGE_SECTION science)
set(CPACK_COMPONENT_TOOLS_DESCRIPTION "builder and verifier of multi-resolution TIN terrain
tind-build turns elevation rasters and points into a pyramid of triangulated
tiles under a vertical tolerance per level, in one file that tind serves.
tind-verify proves over HTTP that what is served is seamless and within its
tolerances.")
set(CPACK_DEBIAN_TOOLS_PACKAGE_SUGGESTS "tind")

include(CPack)
