# novaphy_add_device_module(<target> <path>/<name>_kernels.h [WHEN <condition>])
# Makes the device source of the hand-written kernels (NOVAPHY_ROW_KERNEL) of a header, and compiles the
# source into the target as
#   const char* novaphy::detail::<name>_kernels_source();
# The function returns null if the build has no backend for devices, or if the condition is false.
#
# The tool tools/device_source makes the source during the build. It replaces the first include of each header
# by the header's text. core/device/ has variants of the headers that devices need in another form. From the
# declarations of kernels the tool makes the lines "// kernel NAME WORDS NOVAPHY_ROW" (or _BLOCK), which
# backends read. The source is C++17 for the compilers of all vendors.
#
# Includes "<code>.inc" of code that the build makes stay in the text. The .cuh file includes the code. The
# source includes <code>_source.inc, which has the code as string literals.
#
# A target that compiles these files elsewhere must depend on novaphy_device_sources.
set(NOVAPHY_DEVICE_INCLUDES core/device core/include collision/include dynamics/include vbd/include)
list(TRANSFORM NOVAPHY_DEVICE_INCLUDES PREPEND ${PROJECT_SOURCE_DIR}/)
if(NOVAPHY_WITH_CUDA OR NOVAPHY_WITH_DLAN)
  add_custom_target(novaphy_device_sources)
  # In a cross build, -DNOVAPHY_DEVICE_SOURCE=<path> names the tool, which a host build of the same sources
  # made.
  if(NOT NOVAPHY_DEVICE_SOURCE)
    add_subdirectory(${PROJECT_SOURCE_DIR}/tools/device_source ${PROJECT_BINARY_DIR}/tools/device_source)
    set(NOVAPHY_DEVICE_SOURCE novaphy_device_source)
  endif()
endif()

function(novaphy_add_device_module target header)
  cmake_parse_arguments(PARSE_ARGV 2 arg "" "" "WHEN")
  cmake_path(GET header STEM name)
  cmake_path(ABSOLUTE_PATH header)
  set(text ${CMAKE_CURRENT_BINARY_DIR}/${name}_source.cpp)
  if((NOVAPHY_WITH_CUDA OR NOVAPHY_WITH_DLAN) AND (NOT DEFINED arg_WHEN OR (${arg_WHEN})))
    add_custom_command(OUTPUT ${CMAKE_CURRENT_BINARY_DIR}/${name}.cuh ${text}  # as in the .d
                       COMMAND ${NOVAPHY_DEVICE_SOURCE} ${CMAKE_CURRENT_BINARY_DIR} ${header} ${NOVAPHY_DEVICE_INCLUDES}
                       DEPENDS ${NOVAPHY_DEVICE_SOURCE} ${header} DEPFILE ${CMAKE_CURRENT_BINARY_DIR}/${name}.d
                       VERBATIM COMMENT "Writing the device text of ${name}.h")
    add_custom_target(${name}_device_source DEPENDS ${text} ${CMAKE_CURRENT_BINARY_DIR}/${name}.cuh)
    add_dependencies(novaphy_device_sources ${name}_device_source)
    add_dependencies(${target} ${name}_device_source)
  else()
    file(CONFIGURE OUTPUT ${text} @ONLY CONTENT
"// Written by cmake/NovaPhyDeviceModule.cmake.
namespace novaphy::detail {
const char* ${name}_source();
const char* ${name}_source() {
  return nullptr;
}
}  // namespace novaphy::detail
")
  endif()
  target_sources(${target} PRIVATE ${text})
  set_source_files_properties(${text} PROPERTIES COMPILE_OPTIONS -Wno-overlength-strings)
endfunction()
