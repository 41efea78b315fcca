# novaphy_add_library(<name> SOURCES ... [PUBLIC lib ...] [PRIVATE lib ...] [UNITY [APART ...]])
# Declares the shared library novaphy_<name> (alias novaphy::<name>) of one layer. The function sets the
# headers under include/, hidden visibility, warnings, the install component <name>, and the entry in the
# exported package. In a quick build, a library with UNITY compiles several sources at a time, which takes a
# third less time. Sources in APART are compiled alone, because they use the same name in unnamed namespaces.
set(NOVAPHY_WARNINGS -Wall -Wextra -Wpedantic -Wshadow -Wconversion -Wno-sign-conversion)
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU" AND CMAKE_CXX_COMPILER_VERSION VERSION_LESS 13)
  # False positives of GCC 12's optimizer in inlined std::string and std::shared_ptr code.
  list(APPEND NOVAPHY_WARNINGS -Wno-restrict -Wno-stringop-overflow)
endif()
if(NOVAPHY_WERROR)
  list(APPEND NOVAPHY_WARNINGS -Werror)
endif()

set(NOVAPHY_COLD_OPTIMIZATION -O0 CACHE STRING "Optimization of code that runs once: tests, and bindings that no loop runs")
set(NOVAPHY_COLD_OPTIONS $<$<NOT:$<CONFIG:Debug>>:${NOVAPHY_COLD_OPTIMIZATION}>)

# A quick build is for users, who build once and change nothing. It has no warnings, which cost a twentieth of
# the time, and parses headers once for several files. The option is off by default, because a compiler cache
# cannot reuse results of other trees in a quick build.
option(NOVAPHY_QUICK_BUILD "No warnings, and headers parsed once for several files: for a build without a compiler cache" OFF)
if(NOVAPHY_QUICK_BUILD)
  set(NOVAPHY_WARNINGS "")
  set(source ${PROJECT_BINARY_DIR}/standard_headers.cpp)
  file(CONFIGURE OUTPUT ${source} CONTENT "")
  add_library(novaphy_standard_headers OBJECT ${source})
  target_compile_features(novaphy_standard_headers PRIVATE cxx_std_20)
  target_precompile_headers(novaphy_standard_headers PRIVATE
    <algorithm> <array> <cmath> <cstdint> <cstring> <functional> <map> <memory> <optional> <span> <string> <utility>
    <vector>)
endif()
# novaphy_precompile(<target>): precompiles these headers for the C++ files of the target, in a quick build.
function(novaphy_precompile target)
  if(NOVAPHY_QUICK_BUILD)
    target_precompile_headers(${target} REUSE_FROM novaphy_standard_headers)
  endif()
endfunction()

# novaphy_compile_small(<source>...): optimizes sources that rarely run, such as the building of a model, for
# size. In a quick build the function does nothing, because several sources are compiled together.
function(novaphy_compile_small)
  if(NOT NOVAPHY_QUICK_BUILD)
    set_source_files_properties(${ARGN} PROPERTIES COMPILE_OPTIONS $<$<CONFIG:Release>:-Os>)
  endif()
endfunction()

# novaphy_limit_exports(<target> <version script>): limits the dynamic symbol table to the symbols of the
# script.
function(novaphy_limit_exports target script)
  target_link_options(${target} PRIVATE -Wl,--version-script=${script})
  set_property(TARGET ${target} APPEND PROPERTY LINK_DEPENDS ${script})
endfunction()

# Lists the public headers, by their paths from the root. Public headers are installed, and their code
# determines the version of the exported symbols. Internal headers under include/ are for other libraries of
# NovaPhy: formulas, hand-written kernels, contact geometry, trees. An internal header that a public header
# includes is public, too.
set(header_globs "")
foreach(layer backends/abi core io nova collision dynamics vbd diff)
  list(APPEND header_globs ${PROJECT_SOURCE_DIR}/${layer}/include/*.h)
endforeach()
file(GLOB_RECURSE NOVAPHY_PUBLIC_HEADERS CONFIGURE_DEPENDS RELATIVE ${PROJECT_SOURCE_DIR} ${header_globs})
list(FILTER NOVAPHY_PUBLIC_HEADERS EXCLUDE REGEX "^core/.*/(lanes|sim/(for_chunks|index_rows|on_host|shape_pair_rule))\\.h$")
list(FILTER NOVAPHY_PUBLIC_HEADERS EXCLUDE REGEX
     "^(collision|dynamics|vbd)/.*(/(geometry|articulation|elements)/|_(trace|law|kernels)\\.h$)")
foreach(header manifold mesh_view shape)
  list(APPEND NOVAPHY_PUBLIC_HEADERS collision/include/novaphy/collision/geometry/${header}.h)
endforeach()
foreach(header articulation/contact_branches articulation/gradient_counts articulation/scalar articulation/tree
               semi_implicit/rigid_contact_trace)
  list(APPEND NOVAPHY_PUBLIC_HEADERS dynamics/include/novaphy/dynamics/${header}.h)
endforeach()
list(APPEND NOVAPHY_PUBLIC_HEADERS backends/program/include/novaphy/program/ir.h)

# Exported symbols have the version NOVAPHY_<version>_<hash of the public headers>. A program requires the
# version with which it was linked. The dynamic linker refuses libraries with another version, and names the
# library and the version.
set(NOVAPHY_EXPORTS ${PROJECT_BINARY_DIR}/exports.map)
add_custom_command(
  OUTPUT ${NOVAPHY_EXPORTS}
  COMMAND ${CMAKE_COMMAND} -DVERSION=${PROJECT_VERSION} "-DHEADERS=${NOVAPHY_PUBLIC_HEADERS}"
          -DTEMPLATE=cmake/exports.map.in -DOUTPUT=${NOVAPHY_EXPORTS} -P cmake/WriteExports.cmake
  DEPENDS ${NOVAPHY_PUBLIC_HEADERS} cmake/exports.map.in cmake/WriteExports.cmake
  WORKING_DIRECTORY ${PROJECT_SOURCE_DIR} VERBATIM)
add_custom_target(novaphy_exports DEPENDS ${NOVAPHY_EXPORTS})

function(novaphy_add_library name)
  cmake_parse_arguments(ARG "UNITY" "" "SOURCES;PUBLIC;PRIVATE;APART" ${ARGN})
  set(target novaphy_${name})
  add_library(${target} SHARED ${ARG_SOURCES})
  add_library(novaphy::${name} ALIAS ${target})
  set_target_properties(${target} PROPERTIES EXPORT_NAME ${name} VERSION ${PROJECT_VERSION}
                                             SOVERSION ${PROJECT_VERSION_MAJOR})
  target_compile_features(${target} PUBLIC cxx_std_20)
  target_compile_options(${target} PRIVATE ${NOVAPHY_WARNINGS})
  target_compile_options(${target} INTERFACE -ffp-contract=off)
  target_include_directories(${target} PUBLIC $<BUILD_INTERFACE:${CMAKE_CURRENT_SOURCE_DIR}/include>
                                              $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}>)
  target_link_libraries(${target} PUBLIC ${ARG_PUBLIC} PRIVATE ${ARG_PRIVATE})
  novaphy_precompile(${target})
  if(ARG_UNITY AND NOVAPHY_QUICK_BUILD)
    set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 6)
    set_source_files_properties(${ARG_APART} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
  endif()
  novaphy_limit_exports(${target} ${NOVAPHY_EXPORTS})
  add_dependencies(${target} novaphy_exports)
  # Reports missing symbols when linking. Otherwise the loader would report them to the user.
  if(NOT NOVAPHY_SANITIZE)
    target_link_options(${target} PRIVATE -Wl,--no-undefined)
  endif()
  install(TARGETS ${target} EXPORT NovaPhy_${name} LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT ${name})
  foreach(header ${NOVAPHY_PUBLIC_HEADERS})
    if(header MATCHES "^${name}/include/(.*)/[^/]+$")
      install(FILES ${PROJECT_SOURCE_DIR}/${header} DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/${CMAKE_MATCH_1}
              COMPONENT ${name})
    endif()
  endforeach()
  install(EXPORT NovaPhy_${name} NAMESPACE novaphy:: FILE NovaPhy_${name}.cmake
          DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/NovaPhy COMPONENT ${name})
  set_property(GLOBAL APPEND PROPERTY NOVAPHY_COMPONENTS ${name})
endfunction()

# novaphy_add_lane_levels(<library> CHOOSER file SOURCES file ... [INCLUDES folder ...] [DEPENDS target ...])
# Compiles sources that use core/lanes.h into a library, once for each level. A level is an instruction set
# with a number of SIMD lanes. Each level has its own namespace, so that the linker cannot use code of one
# level in another. The source CHOOSER selects the level at run time (cpu_level.h). With sanitizers only the
# level "baseline" is built, because levels differ only in the number of lanes.
function(novaphy_add_lane_levels library)
  cmake_parse_arguments(ARG "" "CHOOSER" "SOURCES;INCLUDES;DEPENDS" ${ARGN})
  set(levels "baseline 4")
  if(CMAKE_SYSTEM_PROCESSOR MATCHES "^(x86_64|AMD64)$" AND NOT NOVAPHY_SANITIZE)
    list(APPEND levels "avx2 8 -mavx2 -mfma")
    # GCC 12 reports its own intrinsics as uninitialized.
    list(APPEND levels "avx512 16 -mavx2 -mfma -mavx512f -mprefer-vector-width=512 -Wno-uninitialized")
    set_property(SOURCE ${ARG_CHOOSER} APPEND PROPERTY COMPILE_DEFINITIONS NOVAPHY_X86_LEVELS)
  endif()
  foreach(level ${levels})
    separate_arguments(options UNIX_COMMAND ${level})
    list(POP_FRONT options name lanes)
    set(target novaphy_${library}_${name})
    add_library(${target} OBJECT ${ARG_SOURCES})
    target_compile_features(${target} PRIVATE cxx_std_20)
    target_compile_definitions(${target} PRIVATE LANES=${lanes} NOVAPHY_LEVEL=${name} NOVAPHY_LEVEL_NAME="${name}")
    target_compile_options(${target} PRIVATE ${NOVAPHY_WARNINGS} -Wno-psabi -Wno-conversion ${options})
    target_include_directories(${target} PRIVATE include ${PROJECT_SOURCE_DIR}/core/include ${ARG_INCLUDES})
    if(ARG_DEPENDS)
      add_dependencies(${target} ${ARG_DEPENDS})
    endif()
    target_sources(novaphy_${library} PRIVATE $<TARGET_OBJECTS:${target}>)
  endforeach()
endfunction()
