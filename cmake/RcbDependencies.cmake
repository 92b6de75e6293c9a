# The libraries, all from Debian 12's packages (deploy/dependencies installs them).

# The client library's.
find_package(Threads REQUIRED)
find_package(Boost 1.81 REQUIRED)
find_package(nlohmann_json REQUIRED)
find_package(fmt REQUIRED)
find_package(OpenSSL 3.0 REQUIRED)

# Of fmt and xxHash the headers alone (rcb_flags has the macros for it): so librcbd.so needs no shared library of either.
add_library(rcb_fmt INTERFACE)
get_target_property(rcb_fmt_include fmt::fmt INTERFACE_INCLUDE_DIRECTORIES)
target_include_directories(rcb_fmt SYSTEM INTERFACE "${rcb_fmt_include}")

# Of OpenSSL too: its libraries are opened when they are needed (common/openssl).
add_library(rcb_openssl INTERFACE)
target_include_directories(rcb_openssl SYSTEM INTERFACE "${OPENSSL_INCLUDE_DIR}")
target_link_libraries(rcb_openssl INTERFACE ${CMAKE_DL_LIBS})

find_path(RCB_XXHASH_INCLUDE xxhash.h REQUIRED)
add_library(rcb_xxhash INTERFACE)
target_include_directories(rcb_xxhash SYSTEM INTERFACE "${RCB_XXHASH_INCLUDE}")

# Highway's headers too (common/base/highway.hpp says how).
find_path(RCB_HIGHWAY_INCLUDE hwy/highway.h REQUIRED)
add_library(rcb_highway INTERFACE)
target_include_directories(rcb_highway SYSTEM INTERFACE "${RCB_HIGHWAY_INCLUDE}")

add_library(rcb_boost INTERFACE)
target_include_directories(rcb_boost SYSTEM INTERFACE ${Boost_INCLUDE_DIRS})

if(NOT RCB_SERVICE)
  return()
endif()

# The service's and its programs'.
find_package(MPI REQUIRED COMPONENTS C CXX)
find_package(spdlog REQUIRED)
find_package(CLI11 REQUIRED)
find_package(HDF5 REQUIRED COMPONENTS C)
find_package(ZLIB REQUIRED)  # comes with HDF5, whose deflated chunks are checked with it; gzip is unpacked with it, too

find_path(RCB_FAST_FLOAT_INCLUDE fast_float/fast_float.h REQUIRED)
add_library(rcb_fast_float INTERFACE)
target_include_directories(rcb_fast_float SYSTEM INTERFACE "${RCB_FAST_FLOAT_INCLUDE}")

add_library(rcb_hdf5 INTERFACE)
target_include_directories(rcb_hdf5 SYSTEM INTERFACE ${HDF5_C_INCLUDE_DIRS})
target_link_libraries(rcb_hdf5 INTERFACE ${HDF5_C_LIBRARIES} ZLIB::ZLIB)

if(RCB_TESTS)
  find_package(GTest QUIET)
  find_package(rapidcheck QUIET)
  if(NOT GTest_FOUND OR NOT rapidcheck_FOUND)
    message(FATAL_ERROR "the tests need GoogleTest and RapidCheck: deploy/dependencies --tests installs them; "
                        "-DRCB_TESTS=OFF builds the programs alone")
  endif()
endif()

# The benchmark's peers, optional. Plain libraries instead of their CMake packages, which want all of Trilinos.
set(RCB_ZOLTAN OFF)
set(RCB_ZOLTAN2 OFF)
if(NOT RCB_PEERS)
  return()
endif()
find_path(RCB_TRILINOS_INCLUDE zoltan.h PATH_SUFFIXES trilinos)
find_library(RCB_ZOLTAN_LIBRARY NAMES trilinos_zoltan)
if(RCB_TRILINOS_INCLUDE AND RCB_ZOLTAN_LIBRARY)
  set(RCB_ZOLTAN ON)
  add_library(rcb_zoltan INTERFACE)
  target_include_directories(rcb_zoltan SYSTEM INTERFACE "${RCB_TRILINOS_INCLUDE}")
  target_link_libraries(rcb_zoltan INTERFACE "${RCB_ZOLTAN_LIBRARY}")
  find_path(RCB_PTSCOTCH_INCLUDE ptscotch.h PATH_SUFFIXES scotch)
  find_file(RCB_ZOLTAN2_HEADER Zoltan2_PartitioningProblem.hpp PATHS "${RCB_TRILINOS_INCLUDE}")
  set(zoltan2_libraries)
  foreach(name zoltan2 tpetra tpetraclassic xpetra epetra kokkoskernels kokkoscontainers kokkoscore
               teuchoskokkoscomm teuchoskokkoscompat teuchosremainder teuchosnumerics teuchoscomm teuchosparser
               teuchosparameterlist teuchoscore)
    find_library(RCB_TRILINOS_${name} NAMES trilinos_${name})
    list(APPEND zoltan2_libraries "${RCB_TRILINOS_${name}}")
  endforeach()
  if(RCB_PTSCOTCH_INCLUDE AND RCB_ZOLTAN2_HEADER AND NOT zoltan2_libraries MATCHES NOTFOUND)
    set(RCB_ZOLTAN2 ON)
    add_library(rcb_zoltan2 INTERFACE)
    target_include_directories(rcb_zoltan2 SYSTEM INTERFACE "${RCB_TRILINOS_INCLUDE}" "${RCB_PTSCOTCH_INCLUDE}")
    target_link_libraries(rcb_zoltan2 INTERFACE rcb_zoltan ${zoltan2_libraries})
  endif()
endif()
message(STATUS "peers of rcb_bench: Zoltan ${RCB_ZOLTAN}, Zoltan2 ${RCB_ZOLTAN2} (deploy/dependencies --peers installs them)")
