# How a folder becomes a target: warnings, floating-point rules, output folders, and the helper functions.

option(RCB_TESTS "build the tests" ${PROJECT_IS_TOP_LEVEL})
set(RCB_SANITIZE "" CACHE STRING "sanitizers, as -fsanitize takes them (address,undefined or thread)")

if(NOT CMAKE_BUILD_TYPE AND NOT CMAKE_CONFIGURATION_TYPES)
  set(CMAKE_BUILD_TYPE Release CACHE STRING "build type" FORCE)
endif()
set(CMAKE_CXX_STANDARD 20)
set(CMAKE_CXX_STANDARD_REQUIRED ON)
set(CMAKE_CXX_EXTENSIONS OFF)
set(CMAKE_EXPORT_COMPILE_COMMANDS ON)
set(CMAKE_RUNTIME_OUTPUT_DIRECTORY "${PROJECT_BINARY_DIR}/bin")
# Asserts of our own (CHECK) stay on in release; fused multiply-adds would change which extent is longest.
set(CMAKE_CXX_FLAGS_RELEASE "-O3")
find_program(RCB_CCACHE ccache)
if(RCB_CCACHE)
  set(CMAKE_CXX_COMPILER_LAUNCHER "${RCB_CCACHE}")
endif()

# What whoever links a folder needs, and (rcb_flags) what our own sources are compiled with besides.
add_library(rcb_usage INTERFACE)
target_include_directories(rcb_usage INTERFACE "${PROJECT_SOURCE_DIR}")
target_compile_features(rcb_usage INTERFACE cxx_std_20)
add_library(rcb_flags INTERFACE)
target_link_libraries(rcb_flags INTERFACE rcb_usage)
target_compile_options(rcb_flags INTERFACE
  -Wall -Wextra -Wpedantic -Wshadow -Wconversion -Wsign-conversion -Wold-style-cast -Wnon-virtual-dtor
  -Woverloaded-virtual -Werror -Wno-missing-field-initializers -ffp-contract=off -fno-fast-math)
# GCC 12 at -O3 sees these three in the standard library, fmt and nlohmann-json where there is nothing;
# Clang does not know the names.
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  target_compile_options(rcb_flags INTERFACE -Wno-restrict -Wno-maybe-uninitialized -Wno-stringop-overflow)
endif()
if(RCB_SANITIZE)
  target_compile_options(rcb_usage INTERFACE -fsanitize=${RCB_SANITIZE} -fno-omit-frame-pointer)
  target_link_options(rcb_usage INTERFACE -fsanitize=${RCB_SANITIZE})
  if(RCB_SANITIZE MATCHES thread)  # Asio's fences aren't seen by it, but nothing of ours rests on them
    target_compile_options(rcb_flags INTERFACE -Wno-tsan)
  endif()
  if(RCB_SANITIZE MATCHES address)  # lets a program go on after a finding where its run-time options say halt_on_error=0
    target_compile_options(rcb_usage INTERFACE -fsanitize-recover=address)
  endif()
endif()

# rcb_folder(common/base LINKS ... [EXCEPT files]): the library rcb::common_base from the folder's own sources.
function(rcb_folder folder)
  cmake_parse_arguments(ARG "" "" "LINKS;EXCEPT" ${ARGN})
  string(REPLACE "/" "_" name "${folder}")
  file(GLOB sources CONFIGURE_DEPENDS "${PROJECT_SOURCE_DIR}/${folder}/*.cpp")
  foreach(file IN LISTS ARG_EXCEPT)
    list(REMOVE_ITEM sources "${PROJECT_SOURCE_DIR}/${folder}/${file}")
  endforeach()
  if(sources)
    add_library(rcb_${name} STATIC ${sources})
    target_link_libraries(rcb_${name} PUBLIC rcb_usage ${ARG_LINKS} PRIVATE rcb_flags)
  else()
    add_library(rcb_${name} INTERFACE)
    target_link_libraries(rcb_${name} INTERFACE rcb_usage ${ARG_LINKS})
  endif()
  add_library(rcb::${name} ALIAS rcb_${name})
endfunction()

# rcb_program(rcbd server LINKS ...): a program from a file or from all sources of a folder, in DIR/bin.
function(rcb_program name place)
  cmake_parse_arguments(ARG "" "" "LINKS" ${ARGN})
  if(IS_DIRECTORY "${PROJECT_SOURCE_DIR}/${place}")
    file(GLOB sources CONFIGURE_DEPENDS "${PROJECT_SOURCE_DIR}/${place}/*.cpp")
  else()
    file(GLOB sources CONFIGURE_DEPENDS "${PROJECT_SOURCE_DIR}/${place}")
  endif()
  if(NOT sources)
    message(STATUS "${name}: no sources in ${place}, left out")
    return()
  endif()
  add_executable(${name} ${sources})
  target_link_libraries(${name} PRIVATE rcb_flags ${ARG_LINKS})
  target_compile_definitions(${name} PRIVATE RCB_VERSION="${PROJECT_VERSION}")
endfunction()
