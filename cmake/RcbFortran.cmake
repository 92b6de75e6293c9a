# Fortran programs, where there is a compiler. Modules rcbd and rcbd_mpi are installed as source, since what a Fortran
# compiler makes of a module is for that compiler alone.

include(CheckLanguage)
check_language(Fortran)
if(CMAKE_Fortran_COMPILER)
  enable_language(Fortran)
  set(CMAKE_Fortran_FLAGS_RELEASE "-O2")
else()
  message(STATUS "no Fortran compiler: serial_fortran, dem_fortran and the tests of rcbd.f90 are left out")
endif()

# rcb_fortran_target(target): Fortran 2008 with warnings. GCC 12 warns of allocatable arrays where there is nothing.
function(rcb_fortran_target target)
  target_compile_options(${target} PRIVATE -std=f2008 -Wall -Wextra -pedantic -Wno-maybe-uninitialized -ffp-contract=off)
  if(RCB_WERROR)
    target_compile_options(${target} PRIVATE -Werror)
  endif()
  if(RCB_SANITIZE)
    target_compile_options(${target} PRIVATE -fsanitize=${RCB_SANITIZE})
    target_link_options(${target} PRIVATE -fsanitize=${RCB_SANITIZE})
  endif()
endfunction()

# rcb_fortran_module(rcbd_mpi LINKS ...): the module of client/include/rcbd/rcbd_mpi.f90, as target rcbd_mpi_fortran.
function(rcb_fortran_module name)
  cmake_parse_arguments(ARG "" "" "LINKS" ${ARGN})
  add_library(${name}_fortran STATIC "${PROJECT_SOURCE_DIR}/client/include/rcbd/${name}.f90")
  set_target_properties(${name}_fortran PROPERTIES Fortran_MODULE_DIRECTORY "${PROJECT_BINARY_DIR}/fortran/${name}")
  target_include_directories(${name}_fortran INTERFACE "${PROJECT_BINARY_DIR}/fortran/${name}")
  target_link_libraries(${name}_fortran PUBLIC ${ARG_LINKS})
  rcb_fortran_target(${name}_fortran)
endfunction()

# rcb_fortran_program(serial_fortran client/examples/fortran/serial.f90 LINKS ...): left out where there is no compiler, or
# where what it links isn't there.
function(rcb_fortran_program name source)
  cmake_parse_arguments(ARG "" "" "LINKS" ${ARGN})
  foreach(target rcbd_fortran ${ARG_LINKS})
    if(NOT TARGET ${target})
      return()
    endif()
  endforeach()
  add_executable(${name} "${PROJECT_SOURCE_DIR}/${source}")
  set_target_properties(${name} PROPERTIES Fortran_MODULE_DIRECTORY "${PROJECT_BINARY_DIR}/fortran/${name}")
  target_link_libraries(${name} PRIVATE rcbd_fortran ${ARG_LINKS})
  rcb_fortran_target(${name})
endfunction()

if(CMAKE_Fortran_COMPILER)
  rcb_fortran_module(rcbd LINKS rcbd::rcbd)
  find_package(MPI COMPONENTS Fortran)
  if(MPI_Fortran_HAVE_F08_MODULE)
    rcb_fortran_module(rcbd_mpi LINKS rcbd_fortran MPI::MPI_Fortran)
  else()
    message(STATUS "no module mpi_f08: dem_fortran and the tests of rcbd_mpi.f90 are left out")
  endif()
endif()
