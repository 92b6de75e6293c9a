# How a folder becomes a target: warnings, floating-point rules, output folders, and the helper functions.

option(RCB_SERVICE "build the service, its programs and the solvers; off: the client library alone" ${PROJECT_IS_TOP_LEVEL})
option(RCB_TESTS "build the tests and benchmarks" ${PROJECT_IS_TOP_LEVEL})
option(RCB_PCH "precompile the large headers of other libraries" ON)
set(RCB_TOGETHER 8 CACHE STRING "how many sources of a large folder are compiled at a time: 8 halve the time of a whole build")
option(RCB_WERROR "let a compiler's warning end the build" ${PROJECT_IS_TOP_LEVEL})
set(RCB_SANITIZE "" CACHE STRING "sanitizers, as -fsanitize takes them (address,undefined or thread)")

# In another project's build (add_subdirectory) the kind of build is that project's to choose; and it may link the client
# library into a shared library of its own.
if(NOT PROJECT_IS_TOP_LEVEL)
  set(CMAKE_POSITION_INDEPENDENT_CODE ON)
elseif(NOT CMAKE_BUILD_TYPE AND NOT CMAKE_CONFIGURATION_TYPES)
  set(CMAKE_BUILD_TYPE Release CACHE STRING "build type" FORCE)
endif()
set(CMAKE_CXX_STANDARD 20)
set(CMAKE_CXX_STANDARD_REQUIRED ON)
set(CMAKE_CXX_EXTENSIONS OFF)
set(CMAKE_EXPORT_COMPILE_COMMANDS ON)
set(CMAKE_RUNTIME_OUTPUT_DIRECTORY "${PROJECT_BINARY_DIR}/bin")
# Asserts of our own (CHECK) stay on in release. The folders with loops over particles ask for -O3 (HOT); elsewhere it
# costs compile time and gains nothing.
set(CMAKE_CXX_FLAGS_RELEASE "-O2")
find_program(RCB_CCACHE ccache)
if(RCB_CCACHE AND NOT CMAKE_CXX_COMPILER_LAUNCHER)
  # Without this it would not cache what uses a precompiled header.
  set(CMAKE_CXX_COMPILER_LAUNCHER "${CMAKE_COMMAND}" -E env CCACHE_SLOPPINESS=pch_defines,time_macros "${RCB_CCACHE}")
endif()

# What whoever links a folder needs, and (rcb_flags) what our own sources are compiled with besides.
add_library(rcb_usage INTERFACE)
target_include_directories(rcb_usage INTERFACE "${PROJECT_SOURCE_DIR}")
target_compile_features(rcb_usage INTERFACE cxx_std_20)
add_library(rcb_flags INTERFACE)
target_link_libraries(rcb_flags INTERFACE rcb_usage)
target_compile_options(rcb_flags INTERFACE
  -Wall -Wextra -Wpedantic -Wshadow -Wconversion -Wsign-conversion -Wold-style-cast -Wnon-virtual-dtor
  -Woverloaded-virtual -Wno-missing-field-initializers -ffp-contract=off -fno-fast-math)
target_compile_definitions(rcb_flags INTERFACE BOOST_ASIO_NO_DEPRECATED)
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

# What is parsed once for all targets of a kind and a level of optimisation: other libraries' large headers, and the
# standard library's. With each kind, the libraries whose macros decide what those headers say.
set(rcb_pch_base <algorithm> <array> <functional> <map> <memory> <optional> <span> <string> <vector>)
set(rcb_pch_fmt ${rcb_pch_base} <fmt/format.h>)
set(rcb_pch_fmt_links fmt::fmt)
set(rcb_pch_json ${rcb_pch_fmt} <nlohmann/json.hpp>)
set(rcb_pch_json_links ${rcb_pch_fmt_links} nlohmann_json::nlohmann_json)
set(rcb_pch_asio ${rcb_pch_json} <spdlog/spdlog.h> <boost/asio/as_tuple.hpp> <boost/asio/awaitable.hpp>
    <boost/asio/co_spawn.hpp> <boost/asio/detached.hpp> <boost/asio/io_context.hpp> <boost/asio/ip/tcp.hpp>
    <boost/asio/local/stream_protocol.hpp> <boost/asio/post.hpp> <boost/asio/steady_timer.hpp>
    <boost/asio/use_awaitable.hpp>)
set(rcb_pch_asio_links ${rcb_pch_json_links} spdlog::spdlog rcb_boost)
set(rcb_pch_cli ${rcb_pch_json} <CLI/CLI.hpp>)
set(rcb_pch_cli_links ${rcb_pch_json_links} CLI11::CLI11)
set(rcb_pch_test ${rcb_pch_json} <gtest/gtest.h>)
set(rcb_pch_test_links ${rcb_pch_json_links} GTest::gtest)
file(CONFIGURE OUTPUT "${PROJECT_BINARY_DIR}/pch.cpp" CONTENT "")  # a target must have a source

# rcb_precompiled(variable kind level option): the target that holds the precompiled headers of this kind for sources
# compiled with this option, made at first use.
function(rcb_precompiled variable kind level option)
  set(name rcb_pch_${kind}${level})
  if(NOT TARGET ${name})
    add_library(${name} OBJECT "${PROJECT_BINARY_DIR}/pch.cpp")
    target_link_libraries(${name} PRIVATE rcb_flags ${rcb_pch_${kind}_links})
    target_compile_options(${name} PRIVATE ${option})
    target_precompile_headers(${name} PRIVATE ${rcb_pch_${kind}})
    if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU" AND RCB_CCACHE)
      target_compile_options(${name} PRIVATE -fpch-preprocess)  # for ccache
    endif()
  endif()
  set(${variable} ${name} PARENT_SCOPE)
endfunction()

# rcb_words(variable words...): those of the words for which the caller's ARG_word is set, to hand them on.
macro(rcb_words variable)
  set(${variable})
  foreach(word ${ARGN})
    if(ARG_${word})
      list(APPEND ${variable} ${word})
    endif()
  endforeach()
endmacro()

# rcb_prepare(target [PCH kind] [HOT | QUICK] [TOGETHER]): precompiled headers of this kind; -O3 in release for HOT ones,
# -O1 for those that are to be compiled quickly; several sources at a time for those TOGETHER, whose names in unnamed
# namespaces must then differ from file to file.
function(rcb_prepare target)
  cmake_parse_arguments(ARG "HOT;QUICK;TOGETHER" "PCH" "" ${ARGN})
  if(ARG_TOGETHER AND RCB_TOGETHER GREATER 1)
    set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE ${RCB_TOGETHER})
    if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")  # a source that is included looks to it like a header
      target_compile_options(${target} PRIVATE -Wno-subobject-linkage)
    endif()
  endif()
  set(level)
  if(ARG_HOT)
    set(level -O3)
  elseif(ARG_QUICK)
    set(level -O1)
  endif()
  set(option $<$<CONFIG:Release>:${level}>)
  if(RCB_SANITIZE AND NOT ARG_HOT)  # compiled in half of the time; what they do while tests run is little
    set(level -O0)
    set(option ${level})
  endif()
  target_compile_options(${target} PRIVATE ${option})
  if(RCB_PCH AND ARG_PCH)
    rcb_precompiled(precompiled ${ARG_PCH} "${level}" ${option})
    target_precompile_headers(${target} REUSE_FROM ${precompiled})
    if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU" AND RCB_CCACHE)
      target_compile_options(${target} PRIVATE -fpch-preprocess)
    endif()
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

# rcb_folder(common/base LINKS ... [ROOMS folders in it] [EXCEPT files] [HOT] [TOGETHER] [PCH kind]): the library
# rcb::common_base.
function(rcb_folder folder)
  cmake_parse_arguments(ARG "HOT;TOGETHER" "PCH" "LINKS;ROOMS;EXCEPT" ${ARGN})
  string(REPLACE "/" "_" name "${folder}")
  rcb_sources(sources ${folder} ROOMS ${ARG_ROOMS})
  foreach(file IN LISTS ARG_EXCEPT)
    list(REMOVE_ITEM sources "${PROJECT_SOURCE_DIR}/${folder}/${file}")
  endforeach()
  if(sources)
    add_library(rcb_${name} STATIC ${sources})
    target_link_libraries(rcb_${name} PUBLIC rcb_usage ${ARG_LINKS} PRIVATE rcb_flags)
    rcb_words(how HOT TOGETHER)
    rcb_prepare(rcb_${name} ${how} PCH ${ARG_PCH})
  else()
    add_library(rcb_${name} INTERFACE)
    target_link_libraries(rcb_${name} INTERFACE rcb_usage ${ARG_LINKS})
  endif()
  add_library(rcb::${name} ALIAS rcb_${name})
endfunction()

# rcb_program(rcbd server LINKS ... [ROOMS ...] [TOGETHER] [PCH kind]): a program from a file or from all sources of a
# folder, in DIR/bin.
function(rcb_program name place)
  cmake_parse_arguments(ARG "TOGETHER" "PCH" "LINKS;ROOMS" ${ARGN})
  rcb_sources(sources ${place} ROOMS ${ARG_ROOMS})
  if(NOT sources)
    message(STATUS "${name}: no sources in ${place}, left out")
    return()
  endif()
  add_executable(${name} ${sources})
  target_link_libraries(${name} PRIVATE rcb_flags ${ARG_LINKS})
  rcb_words(how TOGETHER)
  rcb_prepare(${name} ${how} PCH ${ARG_PCH})
  target_compile_definitions(${name} PRIVATE RCB_VERSION="${PROJECT_VERSION}")
endfunction()
