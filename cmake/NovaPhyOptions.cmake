# The options of the build. An option whose part is not built yet defaults to OFF, and asking for it is an error:
# never a silent no-op.
option(NOVAPHY_WITH_DIFF "Build the tensor runtime (nova), the differentiable solvers (diff) and their bindings" OFF)
option(NOVAPHY_WITH_NOVA "Build the tensor runtime (nova), with which solvers step models on devices; ON with NOVAPHY_WITH_DIFF" OFF)
if(NOVAPHY_WITH_DIFF)
  set(NOVAPHY_WITH_NOVA ON)
endif()
option(NOVAPHY_WITH_IO "Build novaphy::io, meshes from files (needs assimp)" OFF)
set(NOVAPHY_ASSIMP system CACHE STRING "Where assimp is from: system, or source (fetched, built, and linked in)")
set_property(CACHE NOVAPHY_ASSIMP PROPERTY STRINGS system source)
if(NOT NOVAPHY_ASSIMP MATCHES "^(system|source)$")
  message(FATAL_ERROR "NOVAPHY_ASSIMP: expected system or source, got ${NOVAPHY_ASSIMP}.")
endif()
option(NOVAPHY_BUILD_COLLISION "Build novaphy::collision" ON)
option(NOVAPHY_BUILD_DYNAMICS "Build novaphy::dynamics (needs collision)" ON)
option(NOVAPHY_BUILD_PYTHON "Build the Python module" OFF)
option(NOVAPHY_BUILD_TESTS "Build the tests" ON)
option(NOVAPHY_BUILD_BENCH "Build the benchmark programs" OFF)
option(NOVAPHY_BUILD_CPU_PLUGIN "Build the CPU backend also as a plugin" ON)
option(NOVAPHY_WERROR "Treat warnings as errors" OFF)
set(NOVAPHY_SANITIZE "" CACHE STRING "Sanitizers for everything, e.g. address,undefined or thread")
set(NOVAPHY_CUDA_ARCHITECTURES "" CACHE STRING "GPU architectures to build ahead (used by NOVAPHY_WITH_CUDA)")

# The engine's own kernels live in nova and diff, so there are none without them. A sanitizer is for the written code,
# and would make the generated code take minutes to compile.
set(NOVAPHY_NATIVE_DEFAULT OFF)
if(NOVAPHY_WITH_DIFF AND NOVAPHY_BUILD_CPU_PLUGIN AND NOT NOVAPHY_SANITIZE)
  set(NOVAPHY_NATIVE_DEFAULT ON)
endif()
option(NOVAPHY_WITH_NATIVE_KERNELS "Compile the engine's kernels into the CPU plugin" ${NOVAPHY_NATIVE_DEFAULT})
if(NOVAPHY_WITH_NATIVE_KERNELS AND NOT (NOVAPHY_WITH_DIFF AND NOVAPHY_BUILD_CPU_PLUGIN))
  message(FATAL_ERROR "NOVAPHY_WITH_NATIVE_KERNELS=ON needs NOVAPHY_WITH_DIFF=ON and NOVAPHY_BUILD_CPU_PLUGIN=ON.")
endif()

option(NOVAPHY_WITH_CUDA "Build the CUDA backend (a plugin that opens the driver at run time)" OFF)
option(NOVAPHY_WITH_COLLISION_CUDA "Contacts on CUDA devices; without effect while NOVAPHY_WITH_CUDA is OFF" ON)
option(NOVA_ENABLE_NVRTC "Compile kernels with NVRTC at run time; without effect while NOVAPHY_WITH_CUDA is OFF" ON)

# Parts of the design that are not built yet.
foreach(entry
    "NOVAPHY_WITH_DLAN;the Denglin backend"
    "NOVAPHY_BUILD_VBD;the VBD library"
    "NOVAPHY_WITH_VBD_CUDA;CUDA modules of the VBD library"
    "NOVAPHY_WITH_VBD_DLAN;Denglin modules of the VBD library")
  list(GET entry 0 name)
  list(GET entry 1 what)
  option(${name} "Not built yet: ${what}" OFF)
  if(${name})
    message(FATAL_ERROR "${name}=ON asks for ${what}, which this version does not have. Configure with ${name}=OFF.")
  endif()
endforeach()

if(NOVAPHY_BUILD_DYNAMICS AND NOT NOVAPHY_BUILD_COLLISION)
  message(FATAL_ERROR "NOVAPHY_BUILD_DYNAMICS=ON needs NOVAPHY_BUILD_COLLISION=ON.")
endif()
if(NOVAPHY_WITH_DIFF AND NOT NOVAPHY_BUILD_DYNAMICS)
  message(FATAL_ERROR "NOVAPHY_WITH_DIFF=ON needs NOVAPHY_BUILD_DYNAMICS=ON.")
endif()
if(NOVAPHY_BUILD_PYTHON AND NOT NOVAPHY_BUILD_DYNAMICS)
  message(FATAL_ERROR "NOVAPHY_BUILD_PYTHON=ON needs NOVAPHY_BUILD_DYNAMICS=ON.")
endif()

if(NOT CMAKE_BUILD_TYPE AND NOT CMAKE_CONFIGURATION_TYPES)
  set(CMAKE_BUILD_TYPE Release CACHE STRING "Build type" FORCE)
endif()
find_program(NOVAPHY_CCACHE ccache)
if(NOVAPHY_CCACHE AND NOT CMAKE_CXX_COMPILER_LAUNCHER)
  set(CMAKE_C_COMPILER_LAUNCHER "${NOVAPHY_CCACHE}")
  set(CMAKE_CXX_COMPILER_LAUNCHER "${NOVAPHY_CCACHE}")
endif()

set(CMAKE_C_STANDARD 11)
set(CMAKE_C_EXTENSIONS OFF)
set(CMAKE_CXX_STANDARD 20)
set(CMAKE_CXX_STANDARD_REQUIRED ON)
set(CMAKE_CXX_EXTENSIONS OFF)
set(CMAKE_POSITION_INDEPENDENT_CODE ON)
set(CMAKE_CXX_VISIBILITY_PRESET hidden)
set(CMAKE_C_VISIBILITY_PRESET hidden)
set(CMAKE_VISIBILITY_INLINES_HIDDEN ON)
set(CMAKE_EXPORT_COMPILE_COMMANDS ON)
include(GNUInstallDirs)
# All libraries in one folder, so that the build tree looks like the install tree to the plugin search.
set(CMAKE_LIBRARY_OUTPUT_DIRECTORY "${CMAKE_BINARY_DIR}/lib")
set(CMAKE_RUNTIME_OUTPUT_DIRECTORY "${CMAKE_BINARY_DIR}/bin")
set(CMAKE_INSTALL_RPATH "$ORIGIN")

# The arithmetic contract: the same bits on every path. Nothing else of fast-math.
add_compile_options(-ffp-contract=off -fno-math-errno -fno-trapping-math)
if(NOVAPHY_SANITIZE)
  add_compile_options(-fsanitize=${NOVAPHY_SANITIZE} -fno-sanitize-recover=all -fno-omit-frame-pointer)
  add_link_options(-fsanitize=${NOVAPHY_SANITIZE})
endif()
