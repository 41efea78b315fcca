# novaphy_add_device_module(<target> <path>/<name>_kernels.h [WHEN <condition>])
# The hand-written kernels of a header (NOVAPHY_ROW_KERNEL) for devices: makes the text that their compilers get, and
# compiles it into the target as
#   const char* novaphy::detail::<name>_kernels_text();
# which gives null without a backend for devices or where the condition is false. Headers take the place of their includes,
# each once. core/device/ holds the twins of those that devices read otherwise; system headers are left out. The lines
# "// kernel NAME WORDS NOVAPHY_ROW" (or _BLOCK) that backends look for are made from the declarations; WORDS 0: as many
# as the launch gives. The text is
# C++17, which compilers of all vendors know. #include "<code>.inc" stays, for code that the build makes: the .cuh includes
# it, and the text <code>_text.inc, the same as string literals.
set(NOVAPHY_DEVICE_INCLUDES core/device core/include collision/include dynamics/include vbd/include)

# Appends a file to the global property NOVAPHY_DEVICE_TEXT, behind the headers that it includes.
function(novaphy_append_device_text path)
  get_property(seen GLOBAL PROPERTY NOVAPHY_DEVICE_TEXT_FILES)
  if(path IN_LIST seen)
    return()
  endif()
  set_property(GLOBAL APPEND PROPERTY NOVAPHY_DEVICE_TEXT_FILES ${path})
  set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${path})
  file(STRINGS ${path} includes REGEX "^#include \"novaphy/")
  foreach(include IN LISTS includes)
    string(REGEX REPLACE "^#include \"([^\"]+)\".*" "\\1" include "${include}")
    unset(included)  # find_file keeps what is set, also by the caller
    find_file(included NAMES ${include} HINTS ${NOVAPHY_DEVICE_INCLUDES} NO_CACHE NO_DEFAULT_PATH REQUIRED)
    novaphy_append_device_text(${included})
  endforeach()
  file(READ ${path} text)
  string(REGEX REPLACE "#include \"([a-z_]+).inc\"" "NOVAPHY_MADE_BY_THE_BUILD \\1" text "${text}")
  string(REGEX REPLACE "#(include|pragma once)[^\n]*\n" "" text "${text}")
  # Comparisons that C++20 writes by itself: devices compare vectors only.
  string(REPLACE "bool operator==(const Vec3&) const = default;"
                 "bool operator==(const Vec3& o) const { return x == o.x && y == o.y && z == o.z; }" text "${text}")
  string(REGEX REPLACE "\n *bool operator==[^\n]* = default;" "" text "${text}")
  # Concepts: devices call formulas with floats only.
  string(REGEX REPLACE "\ntemplate <class T>\nconcept FormulaScalar = [^}]*};" "" text "${text}")
  string(REPLACE "template <FormulaScalar T>" "template <class T>" text "${text}")
  set_property(GLOBAL APPEND_STRING PROPERTY NOVAPHY_DEVICE_TEXT "${text}")
endfunction()

function(novaphy_add_device_module target header)
  cmake_parse_arguments(PARSE_ARGV 2 arg "" "" "WHEN")
  cmake_path(GET header STEM name)
  set(result nullptr)
  if((NOVAPHY_WITH_CUDA OR NOVAPHY_WITH_DLAN) AND (NOT DEFINED arg_WHEN OR (${arg_WHEN})))
    list(TRANSFORM NOVAPHY_DEVICE_INCLUDES PREPEND ${PROJECT_SOURCE_DIR}/)
    set_property(GLOBAL PROPERTY NOVAPHY_DEVICE_TEXT_FILES "")
    set_property(GLOBAL PROPERTY NOVAPHY_DEVICE_TEXT "")
    cmake_path(ABSOLUTE_PATH header)
    novaphy_append_device_text(${header})
    get_property(text GLOBAL PROPERTY NOVAPHY_DEVICE_TEXT)
    string(REGEX MATCHALL "\nNOVAPHY_(ROW|BLOCK)_KERNEL\\([a-z0-9_]+, ([0-9]+, )?[A-Z]" kernels "${text}")
    if(NOT kernels)
      message(FATAL_ERROR "novaphy_add_device_module: no NOVAPHY_ROW_KERNEL(name, ...) in ${header}.")
    endif()
    list(TRANSFORM kernels REPLACE "\n(NOVAPHY_[A-Z]+)_KERNEL.([a-z0-9_]+), [A-Z]" "\n\\1_KERNEL(\\2, 0, A")
    list(TRANSFORM kernels REPLACE "\n(NOVAPHY_[A-Z]+)_KERNEL.([a-z0-9_]+), ([0-9]+), [A-Z]" "// kernel \\2 \\3 \\1\n")
    string(JOIN "" kernels ${kernels})
    string(REGEX REPLACE "NOVAPHY_MADE_BY_THE_BUILD ([a-z_]+)" "#include \"\\1.inc\"" code "${text}")
    file(CONFIGURE OUTPUT ${CMAKE_CURRENT_BINARY_DIR}/${name}.cuh CONTENT "${kernels}${code}" @ONLY)
    # A string literal has a length that every compiler takes; the pieces are joined by the compiler.
    string(REPLACE "\n\n" "\n)==\"\n    R\"==(\n" text "${kernels}${text}")
    string(REGEX REPLACE "NOVAPHY_MADE_BY_THE_BUILD ([a-z_]+)" ")==\"\n#include \"\\1_text.inc\"\nR\"==(" text "${text}")
    set(result "R\"==(${text})==\"")
  endif()
  file(CONFIGURE OUTPUT ${CMAKE_CURRENT_BINARY_DIR}/${name}_text.cpp @ONLY CONTENT
"// Written by cmake/NovaPhyDeviceModule.cmake.
namespace novaphy::detail {
const char* ${name}_text();
const char* ${name}_text() {
  return ${result};
}
}  // namespace novaphy::detail
")
  target_sources(${target} PRIVATE ${CMAKE_CURRENT_BINARY_DIR}/${name}_text.cpp)
  set_source_files_properties(${CMAKE_CURRENT_BINARY_DIR}/${name}_text.cpp PROPERTIES
                              COMPILE_OPTIONS -Wno-overlength-strings)
endfunction()
