# cpack: Debian's packages, one of each component. Configured by deploy/package.
set(CPACK_GENERATOR DEB)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_STRIP_FILES ON)
set(CMAKE_INSTALL_DEFAULT_DIRECTORY_PERMISSIONS OWNER_READ OWNER_WRITE OWNER_EXECUTE GROUP_READ GROUP_EXECUTE WORLD_READ
                                                WORLD_EXECUTE)
set(CPACK_INSTALL_DEFAULT_DIRECTORY_PERMISSIONS ${CMAKE_INSTALL_DEFAULT_DIRECTORY_PERMISSIONS})
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_RELEASE 1)
set(CPACK_DEBIAN_PACKAGE_MAINTAINER "${RCB_MAINTAINER}")
set(CPACK_DEBIAN_COMPRESSION_TYPE xz)
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_PACKAGE_GENERATE_SHLIBS ON)
set(CPACK_DEBIAN_PACKAGE_GENERATE_SHLIBS_POLICY ">=")
set(CPACK_COMPONENTS_ALL)
set(same_version "(= ${PROJECT_VERSION}-${CPACK_DEBIAN_PACKAGE_RELEASE})")
set(for_debian "${PROJECT_SOURCE_DIR}/cmake/debian")
string(TIMESTAMP date "%a, %d %b %Y %H:%M:%S +0000" UTC)

# Every package also has its copyright, and Debian's changelog.
# rcb_package(component name section DESCRIPTION text [DEPENDS ...] [RECOMMENDS ...] [SUGGESTS ...] [CONTROL files]
# [ARCHITECTURE all])
function(rcb_package component name section)
  cmake_parse_arguments(ARG "" "DESCRIPTION;ARCHITECTURE;DEPENDS;RECOMMENDS;SUGGESTS" "CONTROL" ${ARGN})
  string(TOUPPER ${component} upper)
  set(changelog "${made}/${name}.changelog")
  file(WRITE "${changelog}" "${name} (${PROJECT_VERSION}-${CPACK_DEBIAN_PACKAGE_RELEASE}) unstable; urgency=medium\n\n"
                            "  * /usr/share/doc/rcbd/CHANGELOG.md has the changes.\n\n -- ${RCB_MAINTAINER}  ${date}\n")
  execute_process(COMMAND gzip -9nf "${changelog}" COMMAND_ERROR_IS_FATAL ANY)
  install(FILES "${changelog}.gz" DESTINATION share/doc/${name} RENAME changelog.Debian.gz COMPONENT ${component})
  install(FILES "${made}/copyright" DESTINATION share/doc/${name} COMPONENT ${component})
  list(APPEND CPACK_COMPONENTS_ALL ${component})
  set(CPACK_COMPONENTS_ALL "${CPACK_COMPONENTS_ALL}" PARENT_SCOPE)
  set(CPACK_DEBIAN_${upper}_PACKAGE_NAME ${name} PARENT_SCOPE)
  set(CPACK_DEBIAN_${upper}_PACKAGE_SECTION ${section} PARENT_SCOPE)
  set(CPACK_DEBIAN_${upper}_DESCRIPTION "${ARG_DESCRIPTION}" PARENT_SCOPE)
  set(CPACK_DEBIAN_${upper}_PACKAGE_CONTROL_EXTRA "${ARG_CONTROL}" PARENT_SCOPE)
  set(CPACK_DEBIAN_${upper}_PACKAGE_CONTROL_STRICT_PERMISSION ON PARENT_SCOPE)
  foreach(field ARCHITECTURE DEPENDS RECOMMENDS SUGGESTS)
    set(CPACK_DEBIAN_${upper}_PACKAGE_${field} "${ARG_${field}}" PARENT_SCOPE)
  endforeach()
endfunction()

# OpenSSL is asked for by name where a library opens it at run time, which dpkg-shlibdeps doesn't see.
rcb_package(runtime rcbd science DEPENDS "libssl3, openmpi-bin" RECOMMENDS "gnuplot-nox | gnuplot"
  SUGGESTS "librcbd-dev, python3-rcbd, slurm-client"
  DESCRIPTION "partitioning service for particle simulations
The service rcbd divides the particles of a simulation into parts of equal load
by recursive coordinate bisection, and keeps them balanced while the particles
move. The command rcbctl starts, asks and stops it, and divides files.")
rcb_package(library librcbd1 libs RECOMMENDS "libssl3" SUGGESTS "rcbd" CONTROL "${for_debian}/triggers"
  DESCRIPTION "client library of the partitioning service rcbd
By this library solvers push their particles to the service rcbd and learn
which part owns which of them.")
rcb_package(dev librcbd-dev libdevel DEPENDS "librcbd1 ${same_version}" SUGGESTS "rcbd, gfortran, pkg-config"
  DESCRIPTION "client library of the partitioning service rcbd, for building
Headers for C and C++, the sources of the Fortran modules, the CMake package
and the pkg-config file of librcbd.")
if(python_files)
  rcb_package(python python3-rcbd python ARCHITECTURE all DEPENDS "python3 (>= 3.9), python3-numpy, librcbd1 (>= ${PROJECT_VERSION})"
    SUGGESTS "rcbd, python3-mpi4py" CONTROL "${for_debian}/postinst" "${for_debian}/prerm"
    DESCRIPTION "Python client of the partitioning service rcbd
The package rcbd, which pushes NumPy arrays to the service and gives its
answers as NumPy arrays.")
endif()
include(CPack)
