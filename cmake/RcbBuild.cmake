# How a folder becomes a target: warnings, floating-point rules, output folders, and the helper functions.

option(RCB_SERVICE "build the service, its programs and the solvers; off: the client library alone" ${PROJECT_IS_TOP_LEVEL})
option(RCB_TESTS "build the tests and benchmarks" ${PROJECT_IS_TOP_LEVEL})
option(RCB_INSTALL "let cmake --install install it" ${PROJECT_IS_TOP_LEVEL})
option(RCB_PEERS "let rcb_bench call Zoltan and Zoltan2 too, where they are found" OFF)
option(RCB_TOGETHER "compile all sources of a folder at once, in a third of the time; off: each by itself" ON)
option(RCB_WERROR "let a compiler's warning end the build" ${PROJECT_IS_TOP_LEVEL})
option(RCB_ARCHIVE "librcbd.so with libstdc++ and libgcc inside, for older glibc, as deploy/archive makes it" OFF)
set(RCB_SANITIZE "" CACHE STRING "sanitizers, as -fsanitize takes them (address,undefined or thread)")

# In another project's build (add_subdirectory) the kind of build is that project's to choose.
if(PROJECT_IS_TOP_LEVEL AND NOT CMAKE_BUILD_TYPE AND NOT CMAKE_CONFIGURATION_TYPES)
  set(CMAKE_BUILD_TYPE Release CACHE STRING "build type" FORCE)
endif()
set(CMAKE_CXX_STANDARD 20)
set(CMAKE_CXX_STANDARD_REQUIRED ON)
set(CMAKE_CXX_EXTENSIONS OFF)
set(CMAKE_EXPORT_COMPILE_COMMANDS ON)
set(CMAKE_RUNTIME_OUTPUT_DIRECTORY "${PROJECT_BINARY_DIR}/bin")
set(CMAKE_INSTALL_RPATH_USE_LINK_PATH ON)  # libraries in folders of one's own are found there; ours need no path
# Asserts of our own (RCB_CHECK) stay on in release. The folders with loops over particles ask for -O3 (HOT); elsewhere it
# costs compile time and gains nothing.
set(CMAKE_CXX_FLAGS_RELEASE "-O2")
find_program(RCB_CCACHE ccache)
if(RCB_CCACHE AND NOT CMAKE_CXX_COMPILER_LAUNCHER)
  # What was compiled in one checkout serves another one, in another folder.
  set(CMAKE_CXX_COMPILER_LAUNCHER "${CMAKE_COMMAND}" -E env "CCACHE_BASEDIR=${PROJECT_SOURCE_DIR}" CCACHE_NOHASHDIR=1
      "${RCB_CCACHE}")
endif()

# What whoever links a folder needs, and (rcb_flags) what our own sources are compiled with besides.
add_library(rcb_usage INTERFACE)
target_include_directories(rcb_usage INTERFACE "${PROJECT_SOURCE_DIR}")
target_compile_features(rcb_usage INTERFACE cxx_std_20)
add_library(rcb_flags INTERFACE)
target_link_libraries(rcb_flags INTERFACE rcb_usage)
target_compile_options(rcb_flags INTERFACE
  -Wall -Wextra -Wpedantic -Wshadow -Wconversion -Wsign-conversion -Wold-style-cast -Wnon-virtual-dtor
  -Woverloaded-virtual -Wno-missing-field-initializers -ffp-contract=off -fno-fast-math
  -fno-semantic-interposition)
target_compile_definitions(rcb_flags INTERFACE BOOST_ASIO_NO_DEPRECATED FMT_HEADER_ONLY XXH_INLINE_ALL)
target_compile_options(rcb_flags INTERFACE "-ffile-prefix-map=${PROJECT_SOURCE_DIR}/=")  # messages name files from here on
if(RCB_WERROR)
  target_compile_options(rcb_flags INTERFACE -Werror)
endif()
# GCC 12 sees these in the standard library, fmt and nlohmann-json where there is nothing;
# Clang does not know the names.
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  target_compile_options(rcb_flags INTERFACE -Wno-restrict -Wno-maybe-uninitialized -Wno-stringop-overflow
    -Wno-array-bounds -Wno-stringop-overread)
endif()
if(RCB_SANITIZE)
  target_compile_options(rcb_usage INTERFACE -fsanitize=${RCB_SANITIZE} -fno-omit-frame-pointer)
  target_link_options(rcb_usage INTERFACE -fsanitize=${RCB_SANITIZE})
  if(RCB_SANITIZE MATCHES thread)  # Asio's fences aren't seen by it, but nothing of ours rests on them
    target_compile_options(rcb_flags INTERFACE -Wno-tsan)
  endif()
  if(RCB_SANITIZE MATCHES address)  # lets a program go on after a finding where its run-time options say halt_on_error=0
    target_compile_options(rcb_usage INTERFACE -fsanitize-recover=address -fno-sanitize-recover=undefined)
  endif()
endif()

# rcb_prepare(target [HOT | QUICK]): -O3 in release for HOT ones, -O1 for those that are to be compiled quickly. All sources
# of a target are compiled at once (a header is then read once, and a template of another library made once), so names in
# unnamed namespaces differ from file to file.
function(rcb_prepare target)
  cmake_parse_arguments(ARG "HOT;QUICK" "" "" ${ARGN})
  if(RCB_TOGETHER)
    set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 0)
    if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")  # a source that is included looks to it like a header
      target_compile_options(${target} PRIVATE -Wno-subobject-linkage)
    endif()
  endif()
  if(RCB_SANITIZE AND NOT ARG_HOT)  # compiled in half of the time; what they do while tests run is little
    target_compile_options(${target} PRIVATE -O0)
  elseif(ARG_HOT)
    target_compile_options(${target} PRIVATE $<$<CONFIG:Release>:-O3>)
  elseif(ARG_QUICK)
    target_compile_options(${target} PRIVATE $<$<CONFIG:Release>:-O1>)
  endif()
endfunction()

# rcb_sources(variable place ROOMS ...): the sources of a folder and of these rooms in it, or one file.
function(rcb_sources variable place)
  cmake_parse_arguments(ARG "" "" "ROOMS" ${ARGN})
  set(patterns "${PROJECT_SOURCE_DIR}/${place}")
  if(IS_DIRECTORY "${PROJECT_SOURCE_DIR}/${place}")
    set(patterns "${PROJECT_SOURCE_DIR}/${place}/*.cpp")
    foreach(room IN LISTS ARG_ROOMS)
      list(APPEND patterns "${PROJECT_SOURCE_DIR}/${place}/${room}/*.cpp")
    endforeach()
  endif()
  file(GLOB sources CONFIGURE_DEPENDS ${patterns})
  set(${variable} "${sources}" PARENT_SCOPE)
endfunction()

# rcb_folder(common/base LINKS ... [ROOMS folders in it] [EXCEPT files] [HOT]): the library rcb::common_base.
function(rcb_folder folder)
  cmake_parse_arguments(ARG "HOT" "" "LINKS;ROOMS;EXCEPT" ${ARGN})
  string(REPLACE "/" "_" name "${folder}")
  rcb_sources(sources ${folder} ROOMS ${ARG_ROOMS})
  foreach(file IN LISTS ARG_EXCEPT)
    list(REMOVE_ITEM sources "${PROJECT_SOURCE_DIR}/${folder}/${file}")
  endforeach()
  if(sources)
    set(kernels ${sources})  # these include themselves, once for each instruction set
    list(FILTER kernels INCLUDE REGEX "/kernels\\.cpp$")
    set_source_files_properties(${kernels} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
    add_library(rcb_${name} STATIC ${sources})
    target_link_libraries(rcb_${name} PUBLIC rcb_usage ${ARG_LINKS} PRIVATE rcb_flags)
    if(ARG_HOT)
      rcb_prepare(rcb_${name} HOT)
    else()
      rcb_prepare(rcb_${name})
    endif()
  else()
    add_library(rcb_${name} INTERFACE)
    target_link_libraries(rcb_${name} INTERFACE rcb_usage ${ARG_LINKS})
  endif()
  add_library(rcb::${name} ALIAS rcb_${name})
endfunction()

# rcb_program(rcbd server LINKS ... [ROOMS ...]): a program from a file or from all sources of a
# folder, in DIR/bin.
function(rcb_program name place)
  cmake_parse_arguments(ARG "" "" "LINKS;ROOMS" ${ARGN})
  rcb_sources(sources ${place} ROOMS ${ARG_ROOMS})
  if(NOT sources)
    message(STATUS "${name}: no sources in ${place}, left out")
    return()
  endif()
  add_executable(${name} ${sources})
  target_link_libraries(${name} PRIVATE rcb_flags ${ARG_LINKS})
  rcb_prepare(${name})
  target_compile_definitions(${name} PRIVATE RCB_VERSION="${PROJECT_VERSION}")
endfunction()

# rcb_c_library(): the shared library of client/c, DIR/lib/librcbd.so.1. It exports what client/include/rcbd/rcbd.h
# declares and nothing else, and stays loaded, since a look-up of a host name may outlast a call.
function(rcb_c_library)
  set(map "${PROJECT_SOURCE_DIR}/client/c/librcbd.map")
  rcb_sources(sources client/c)
  add_library(rcbd_library SHARED ${sources})
  set_target_properties(rcbd_library PROPERTIES OUTPUT_NAME rcbd SOVERSION 1 VERSION 1 EXPORT_NAME rcbd LINK_DEPENDS "${map}"
                                                LIBRARY_OUTPUT_DIRECTORY "${PROJECT_BINARY_DIR}/lib")
  target_include_directories(rcbd_library INTERFACE "$<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}/client/include>")
  target_link_libraries(rcbd_library PRIVATE rcb_flags rcb::client_lib)
  target_link_options(rcbd_library PRIVATE "-Wl,--version-script=${map}" -Wl,-z,nodelete -Wl,-z,defs -Wl,--as-needed)
  if(RCB_ARCHIVE)
    add_library(rcb_old_glibc OBJECT client/c/archive/old_glibc.c)
    target_sources(rcbd_library PRIVATE $<TARGET_OBJECTS:rcb_old_glibc>)
    # Both are parts of libc.so.6 since 2.34, and empty there.
    target_link_options(rcbd_library PRIVATE -static-libstdc++ -static-libgcc -Wl,--no-as-needed -l:libpthread.so.0 -l:libdl.so.2)
  endif()
  math(EXPR number "10000 * ${PROJECT_VERSION_MAJOR} + 100 * ${PROJECT_VERSION_MINOR} + ${PROJECT_VERSION_PATCH}")
  target_compile_definitions(rcbd_library PRIVATE RCB_VERSION_NUMBER=${number})
  rcb_prepare(rcbd_library)
  if(NOT PROJECT_IS_TOP_LEVEL)
    set_target_properties(rcbd_library PROPERTIES EXCLUDE_FROM_ALL ON)  # it is built where it is linked
  endif()
  add_library(rcbd::rcbd ALIAS rcbd_library)
endfunction()

# What programs of users, which know rcbd by librcbd.so alone, are compiled with. Further arguments: what they link.
function(rcb_user_program name source)
  add_executable(${name} "${PROJECT_SOURCE_DIR}/${source}")
  target_compile_options(${name} PRIVATE -Wall -Wextra -pedantic -ffp-contract=off)
  if(RCB_WERROR)
    target_compile_options(${name} PRIVATE -Werror)
  endif()
  if(RCB_SANITIZE)  # whose library must be the first that a program loads
    target_compile_options(${name} PRIVATE -fsanitize=${RCB_SANITIZE})
    target_link_options(${name} PRIVATE -fsanitize=${RCB_SANITIZE})
  endif()
  target_link_libraries(${name} PRIVATE rcbd::rcbd ${ARGN} Threads::Threads m)
endfunction()

# rcb_c_program(serial_c client/examples/c/serial.c): one in C99.
function(rcb_c_program name source)
  rcb_user_program(${name} ${source} ${ARGN})
  set_target_properties(${name} PROPERTIES C_STANDARD 99 C_STANDARD_REQUIRED ON C_EXTENSIONS OFF)
endfunction()

# rcb_cpp14_program(serial_cpp client/examples/cpp/serial.cpp): one in C++14.
function(rcb_cpp14_program name source)
  rcb_user_program(${name} ${source} ${ARGN})
  set_target_properties(${name} PROPERTIES CXX_STANDARD 14)
endfunction()
