# novaphy_add_native_kernels(<target> NAME <name> PARTS <n> [PROGRAMS <file>] [OPTIMIZATION <option>])
# Compiles kernels ahead of time into the plugin <target>. The function runs the kernel generator during the
# build, and compiles the generated C files once for each instruction set. It also writes the C++ file that
# lists the tables of the kernels. Without kernels the list is empty.
#
# The generator is linked with the engine and runs on the host. In a cross build,
# -DNOVAPHY_KERNEL_GENERATOR=<path> names a generator that a host build of the same sources made.
set(NOVAPHY_KERNEL_GENERATOR "" CACHE FILEPATH
    "A kernel generator that runs here (cross builds; empty: the one of this build)")

# Each level has a name, a number of SIMD lanes and compiler options. On every processor the scalar level runs
# the rows that do not fill a group of lanes. On x86-64 without AVX2 it runs all rows. These processors are
# rare, and a separate level would add a third to the size of the kernels.
set(NOVAPHY_NATIVE_LEVELS scalar baseline)
set(NOVAPHY_NATIVE_LANES_scalar 1)
set(NOVAPHY_NATIVE_LANES_baseline 4)
set(NOVAPHY_NATIVE_OPTIONS_scalar "")
set(NOVAPHY_NATIVE_OPTIONS_baseline "")
if(CMAKE_SYSTEM_PROCESSOR MATCHES "^(x86_64|AMD64)$")
  set(NOVAPHY_NATIVE_LEVELS scalar avx2 avx512)
  set(NOVAPHY_NATIVE_LANES_avx2 8)
  set(NOVAPHY_NATIVE_LANES_avx512 16)
  set(NOVAPHY_NATIVE_OPTIONS_avx2 -mavx2 -mfma)
  set(NOVAPHY_NATIVE_OPTIONS_avx512 -mavx2 -mfma -mavx512f -mavx512dq -mavx512bw -mavx512vl
                                    -mprefer-vector-width=512)
endif()
# A build for the host processor only needs two levels, and compiles the kernels in half the time.
set(NOVAPHY_CPU_LEVELS "" CACHE STRING
    "Instruction sets of the compiled kernels: ${NOVAPHY_NATIVE_LEVELS}; host: the best of this machine; empty: all")
if(NOVAPHY_CPU_LEVELS)
  set(levels scalar ${NOVAPHY_CPU_LEVELS})
  if("host" IN_LIST levels)
    execute_process(COMMAND ${CMAKE_C_COMPILER} -march=native -dM -E -x c /dev/null OUTPUT_VARIABLE macros ERROR_QUIET)
    if("avx512" IN_LIST NOVAPHY_NATIVE_LEVELS AND macros MATCHES "__AVX512DQ__" AND macros MATCHES "__AVX512BW__"
       AND macros MATCHES "__AVX512VL__")
      set(host avx512)
    elseif("avx2" IN_LIST NOVAPHY_NATIVE_LEVELS AND macros MATCHES "__AVX2__" AND macros MATCHES "__FMA__")
      set(host avx2)
    elseif("baseline" IN_LIST NOVAPHY_NATIVE_LEVELS)
      set(host baseline)
    else()
      set(host scalar)
    endif()
    list(TRANSFORM levels REPLACE "^host$" ${host})
  endif()
  list(REMOVE_DUPLICATES levels)
  foreach(level ${levels})
    if(NOT level IN_LIST NOVAPHY_NATIVE_LEVELS)
      message(FATAL_ERROR "NOVAPHY_CPU_LEVELS: expected some of ${NOVAPHY_NATIVE_LEVELS}, host, got ${level}.")
    endif()
  endforeach()
  set(NOVAPHY_NATIVE_LEVELS ${levels})
endif()

# Options for the arithmetic contract, for wrapping integers, and for words that are read as float or int. The
# text is generated, so warnings are off. The search for common subexpressions is off, because the generator
# has already done it. The search would take a sixth of the compile time.
set(NOVAPHY_KERNEL_OPTIMIZATION -O2 CACHE STRING "Optimization of the compiled kernels")
# No exception passes through the code, so the code needs no unwind tables.
set(NOVAPHY_NATIVE_COMMON_OPTIONS "$<$<C_COMPILER_ID:GNU>:-fno-gcse;-fno-tree-pre>" -g0 -ffp-contract=off -fno-math-errno
    -fno-trapping-math -fwrapv -fno-strict-aliasing -fno-asynchronous-unwind-tables -w -Wno-psabi)

function(novaphy_add_native_kernels target)
  cmake_parse_arguments(ARG "" "NAME;PARTS;PROGRAMS;OPTIMIZATION" "" ${ARGN})
  if(NOT ARG_OPTIMIZATION)
    set(ARG_OPTIMIZATION ${NOVAPHY_KERNEL_OPTIMIZATION})
  endif()
  set(folder ${CMAKE_CURRENT_BINARY_DIR}/${ARG_NAME})
  file(MAKE_DIRECTORY ${folder})
  set(prelude ${PROJECT_SOURCE_DIR}/backends/cpu/src ${PROJECT_SOURCE_DIR}/backends/program/include)
  set(declarations "")
  set(lists "")
  set(levels "")
  if(ARG_PARTS GREATER 0)
    set(files "")
    math(EXPR last "${ARG_PARTS} - 1")
    foreach(part RANGE ${last})
      list(APPEND files ${folder}/kernels_${part}.c)
    endforeach()
    set(generator ${NOVAPHY_KERNEL_GENERATOR})
    if(NOT generator)
      set(generator novaphy_kernel_generator)
    endif()
    set(arguments ${folder} ${ARG_PARTS})
    if(ARG_PROGRAMS)
      list(APPEND arguments --programs ${ARG_PROGRAMS})
    endif()
    add_custom_command(OUTPUT ${files} COMMAND ${generator} ${arguments} DEPENDS ${generator} ${ARG_PROGRAMS}
                       COMMENT "Generating kernels: ${ARG_NAME}" VERBATIM)
    add_custom_target(${target}_${ARG_NAME} DEPENDS ${files})
    foreach(level ${NOVAPHY_NATIVE_LEVELS})
      set(objects ${target}_${ARG_NAME}_${level})
      add_library(${objects} OBJECT ${files})
      add_dependencies(${objects} ${target}_${ARG_NAME})
      set_target_properties(${objects} PROPERTIES C_EXTENSIONS ON)
      target_include_directories(${objects} PRIVATE ${prelude})
      target_compile_definitions(${objects} PRIVATE LANES=${NOVAPHY_NATIVE_LANES_${level}}
                                 NOVAPHY_NATIVE_LEVEL=${level})
      target_compile_options(${objects} PRIVATE ${ARG_OPTIMIZATION} ${NOVAPHY_NATIVE_COMMON_OPTIONS}
                             ${NOVAPHY_NATIVE_OPTIONS_${level}})
      target_sources(${target} PRIVATE $<TARGET_OBJECTS:${objects}>)
      string(APPEND lists "constexpr const novaphy_native_table* k_${level}[] = {")
      foreach(part RANGE ${last})
        string(APPEND declarations "extern \"C\" const novaphy_native_table novaphy_native_${level}_${part};\n")
        string(APPEND lists "&novaphy_native_${level}_${part}, ")
      endforeach()
      string(APPEND lists "};\n")
      string(APPEND levels "    {\"${level}\", k_${level}},\n")
    endforeach()
    set(result "kLevels")
    set(levels "const NativeLevel kLevels[] = {\n${levels}};\n")
  else()
    set(result "{}")
  endif()
  file(CONFIGURE OUTPUT ${folder}/compiled_levels.cpp @ONLY CONTENT
"// Written by cmake/NovaPhyNative.cmake.
#include \"native_tables.h\"

@declarations@
namespace novaphy::cpu {
namespace {
@lists@@levels@}  // namespace
std::span<const NativeLevel> compiled_levels();
std::span<const NativeLevel> compiled_levels() { return @result@; }
}  // namespace novaphy::cpu
")
  target_sources(${target} PRIVATE ${folder}/compiled_levels.cpp)
  target_include_directories(${target} PRIVATE ${prelude})
endfunction()
