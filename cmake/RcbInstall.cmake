# cmake --install: what goes where (docs/install.md has the table). Four components: runtime (the service, its programs,
# man pages, documents), library (librcbd.so.1), dev (what a program is built with) and python. Nothing that is installed
# knows the prefix, so the whole of it can be moved. New headers, examples and documents come by themselves.
include(GNUInstallDirs)
include(CMakePackageConfigHelpers)

set(RCB_PYTHON_DIR lib/python3/dist-packages CACHE STRING "where the Python package is installed, below the prefix")
set(RCB_ZSH_DIR "${CMAKE_INSTALL_DATADIR}/zsh/site-functions" CACHE STRING "where zsh's completion is installed")
set(programs_dir lib/rcbd)  # of programs whose names are too general for PATH, and of what others start
set(made "${PROJECT_BINARY_DIR}/install")
set(from "${PROJECT_SOURCE_DIR}/cmake/install")

foreach(folder BINDIR LIBDIR INCLUDEDIR DATADIR)
  if(IS_ABSOLUTE "${CMAKE_INSTALL_${folder}}")
    message(FATAL_ERROR "CMAKE_INSTALL_${folder} is ${CMAKE_INSTALL_${folder}}. Give a folder below CMAKE_INSTALL_PREFIX, such "
                        "as lib: what is installed may be moved, and finds its parts from one another.")
  endif()
endforeach()

# ---- library, dev ----
install(TARGETS rcbd_library EXPORT rcbd_targets
        LIBRARY DESTINATION "${CMAKE_INSTALL_LIBDIR}" COMPONENT library NAMELINK_COMPONENT dev
        INCLUDES DESTINATION "${CMAKE_INSTALL_INCLUDEDIR}")
install(DIRECTORY client/include/rcbd DESTINATION "${CMAKE_INSTALL_INCLUDEDIR}" COMPONENT dev
        FILES_MATCHING PATTERN *.h PATTERN *.hpp PATTERN *.f90)

set(package_dir "${CMAKE_INSTALL_LIBDIR}/cmake/rcbd")
install(EXPORT rcbd_targets NAMESPACE rcbd:: FILE rcbd-targets.cmake DESTINATION "${package_dir}" COMPONENT dev)
configure_package_config_file("${from}/rcbd-config.cmake.in" "${made}/rcbd-config.cmake" INSTALL_DESTINATION "${package_dir}"
                              PATH_VARS CMAKE_INSTALL_INCLUDEDIR)
write_basic_package_version_file("${made}/rcbd-config-version.cmake" COMPATIBILITY SameMajorVersion)
install(FILES "${made}/rcbd-config.cmake" "${made}/rcbd-config-version.cmake" DESTINATION "${package_dir}" COMPONENT dev)

set(pkgconfig_dir "${CMAKE_INSTALL_LIBDIR}/pkgconfig")
string(REGEX REPLACE "[^/]+" ".." up_from_pkgconfig "${pkgconfig_dir}")
configure_file("${from}/rcbd.pc.in" "${made}/rcbd.pc" @ONLY)
install(FILES "${made}/rcbd.pc" DESTINATION "${pkgconfig_dir}" COMPONENT dev)

# ---- python ----
file(GLOB python_files CONFIGURE_DEPENDS client/python/rcbd/*.py client/python/rcbd/*.pyi client/python/rcbd/py.typed)
if(python_files)
  install(FILES ${python_files} DESTINATION "${RCB_PYTHON_DIR}/rcbd" COMPONENT python)
  configure_file("${from}/METADATA.in" "${made}/METADATA" @ONLY)  # by which pip knows that it is there
  install(FILES "${made}/METADATA" DESTINATION "${RCB_PYTHON_DIR}/rcbd-${PROJECT_VERSION}.dist-info" COMPONENT python)
endif()

# ---- examples ----
install(DIRECTORY client/examples DESTINATION "${CMAKE_INSTALL_DOCDIR}" COMPONENT runtime
        PATTERN __pycache__ EXCLUDE)

# Where what is installed is passed on: where it comes from, and the licences of what is compiled in.
if(RCB_ARCHIVE OR RCB_DEBIAN)
  file(READ "${from}/copyright" copyright)
  set(compiled_in libfmt-dev libhwy-dev libxxhash-dev nlohmann-json3-dev)
  if(RCB_SERVICE)
    list(APPEND compiled_in libcli11-dev libfast-float-dev)
  endif()
  if(RCB_ARCHIVE)
    list(APPEND compiled_in libstdc++6)
  endif()
  foreach(package ${compiled_in})
    if(EXISTS "/usr/share/doc/${package}/copyright")
      file(READ "/usr/share/doc/${package}/copyright" text)
      string(APPEND copyright "\n\n---- ${package} ----\n\n${text}")
    else()
      message(WARNING "no /usr/share/doc/${package}/copyright: its notices are missing in what is installed")
    endif()
  endforeach()
  file(WRITE "${made}/copyright" "${copyright}")
endif()
if(RCB_ARCHIVE)
  install(FILES "${made}/copyright" DESTINATION "${CMAKE_INSTALL_DOCDIR}" COMPONENT library)
endif()

if(NOT RCB_SERVICE)
  return()
endif()

# ---- runtime ----
install(TARGETS rcbd rcbctl RUNTIME DESTINATION "${CMAKE_INSTALL_BINDIR}" COMPONENT runtime)
install(TARGETS rcb_read_hdf5 slope two_spheres slope_mpi RUNTIME DESTINATION "${programs_dir}" COMPONENT runtime)

find_package(Python3 COMPONENTS Interpreter)
if(Python3_FOUND AND NOT RCB_SANITIZE)  # whose findings in a library would end the build
  set(pages "${from}/pages.py")
  add_custom_command(OUTPUT "${made}/pages" DEPENDS rcbd rcbctl "${pages}" COMMENT "Man pages and completions"
    COMMAND "${Python3_EXECUTABLE}" "${pages}" "${made}/pages" $<TARGET_FILE:rcbctl> $<TARGET_FILE:rcbd>)
  add_custom_target(rcb_pages ALL DEPENDS "${made}/pages")
  install(DIRECTORY "${made}/pages/man1" DESTINATION "${CMAKE_INSTALL_MANDIR}" COMPONENT runtime)
  install(FILES "${made}/pages/rcbctl" DESTINATION "${CMAKE_INSTALL_DATADIR}/bash-completion/completions" COMPONENT runtime)
  install(FILES "${made}/pages/_rcbctl" DESTINATION "${RCB_ZSH_DIR}" COMPONENT runtime)
  install(FILES "${made}/pages/rcbctl.fish" DESTINATION "${CMAKE_INSTALL_DATADIR}/fish/vendor_completions.d" COMPONENT runtime)
else()
  message(STATUS "no Python 3, or sanitizers: no man pages and completions are installed")
endif()

if(NOT RCB_DEBIAN)  # whose packages are found without
  set(module_dir "${CMAKE_INSTALL_DATADIR}/modulefiles/rcbd")
  string(REGEX REPLACE "[^/]+" ".." up_from_module "${module_dir}")
  configure_file("${from}/modulefile.in" "${made}/${PROJECT_VERSION}" @ONLY)
  install(FILES "${made}/${PROJECT_VERSION}" DESTINATION "${module_dir}" COMPONENT runtime)
endif()

# The documents stand to one another as in the sources, so that their links hold; what they link to elsewhere, links lead to.
file(RELATIVE_PATH to_include "/${CMAKE_INSTALL_DOCDIR}/client" "/${CMAKE_INSTALL_INCLUDEDIR}")
file(MAKE_DIRECTORY "${made}/client")
file(CREATE_LINK ../examples "${made}/client/examples" SYMBOLIC)
file(CREATE_LINK "${to_include}" "${made}/client/include" SYMBOLIC)
install(FILES README.md CHANGELOG.md CONTRIBUTING.md DESTINATION "${CMAKE_INSTALL_DOCDIR}" COMPONENT runtime)
install(DIRECTORY docs DESTINATION "${CMAKE_INSTALL_DOCDIR}" COMPONENT runtime)
install(FILES "${made}/client/examples" DESTINATION "${CMAKE_INSTALL_DOCDIR}/client" COMPONENT runtime)
install(FILES "${made}/client/include" DESTINATION "${CMAKE_INSTALL_DOCDIR}/client" COMPONENT dev)  # with the headers
install(FILES common/wire/PROTOCOL.md DESTINATION "${CMAKE_INSTALL_DOCDIR}/common/wire" COMPONENT runtime)
install(DIRECTORY deploy/slurm deploy/container DESTINATION "${CMAKE_INSTALL_DOCDIR}/deploy" COMPONENT runtime)

if(RCB_DEBIAN)
  include(RcbDebian)
endif()
