# The libraries, all from Debian 12's packages (deploy/dependencies installs them).

find_package(Threads REQUIRED)
find_package(MPI REQUIRED COMPONENTS CXX)
find_package(Boost 1.81 REQUIRED)
find_package(nlohmann_json REQUIRED)
find_package(CLI11 REQUIRED)
find_package(fmt REQUIRED)
find_package(spdlog REQUIRED)
find_package(HDF5 REQUIRED COMPONENTS C)
find_package(ZLIB REQUIRED)  # comes with HDF5, whose deflated chunks are checked with it

find_path(RCB_XXHASH_INCLUDE xxhash.h REQUIRED)
find_library(RCB_XXHASH_LIBRARY xxhash REQUIRED)
add_library(rcb_xxhash INTERFACE)
target_include_directories(rcb_xxhash SYSTEM INTERFACE "${RCB_XXHASH_INCLUDE}")
target_link_libraries(rcb_xxhash INTERFACE "${RCB_XXHASH_LIBRARY}")

find_path(RCB_FAST_FLOAT_INCLUDE fast_float/fast_float.h REQUIRED)
add_library(rcb_fast_float INTERFACE)
target_include_directories(rcb_fast_float SYSTEM INTERFACE "${RCB_FAST_FLOAT_INCLUDE}")

add_library(rcb_boost INTERFACE)
target_include_directories(rcb_boost SYSTEM INTERFACE ${Boost_INCLUDE_DIRS})
target_compile_definitions(rcb_boost INTERFACE BOOST_ASIO_NO_DEPRECATED)

add_library(rcb_hdf5 INTERFACE)
target_include_directories(rcb_hdf5 SYSTEM INTERFACE ${HDF5_C_INCLUDE_DIRS})
target_link_libraries(rcb_hdf5 INTERFACE ${HDF5_C_LIBRARIES} ZLIB::ZLIB)
