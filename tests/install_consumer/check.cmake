# Configures, builds and runs the consumer of one component against the installed package. Four pseudo components test
# other ways: "unknown" the errors of wrong requests, "pkg_config" a build without CMake, "subdirectory" a project that
# adds NovaPhy's sources, "headers" the includes of installed headers.
cmake_minimum_required(VERSION 3.25)
file(REMOVE_RECURSE ${WORK_DIR})

function(try_configure components result_variable output_variable)
  file(REMOVE_RECURSE ${WORK_DIR}/request)  # the cache would remember where the package was
  file(WRITE ${WORK_DIR}/request/CMakeLists.txt
       "cmake_minimum_required(VERSION 3.25)\nproject(request LANGUAGES CXX)\nfind_package(NovaPhy ${components})\n"
       "if(NOT NovaPhy_FOUND)\n  message(FATAL_ERROR \"not found: \${NovaPhy_NOT_FOUND_MESSAGE}\")\nendif()\n")
  execute_process(COMMAND ${CMAKE_COMMAND} -G ${GENERATOR} -S ${WORK_DIR}/request -B ${WORK_DIR}/request/build
                          -DCMAKE_CXX_COMPILER=${COMPILER} -DCMAKE_PREFIX_PATH=${PREFIX}
                  RESULT_VARIABLE result OUTPUT_VARIABLE output ERROR_VARIABLE output)
  # CMake wraps its messages.
  string(REGEX REPLACE "[ \n]+" " " output "${output}")
  set(${result_variable} ${result} PARENT_SCOPE)
  set(${output_variable} "${output}" PARENT_SCOPE)
endfunction()

function(expect_refused components message)
  try_configure("${components}" result output)
  if(result EQUAL 0 OR NOT output MATCHES "${message}")
    message(FATAL_ERROR "find_package(NovaPhy ${components}): expected '${message}', got ${result}: ${output}")
  endif()
endfunction()

if(COMPONENT STREQUAL "unknown")
  expect_refused("REQUIRED COMPONENTS core warp_drive" "unknown component 'warp_drive'")
  expect_refused("COMPONENTS warp_drive" "unknown component 'warp_drive'")
  expect_refused("99.0 REQUIRED COMPONENTS core" "version")
  # The test removes a component's file from a copy of the prefix. Other tests use the prefix at the same time.
  file(COPY ${PREFIX}/ DESTINATION ${WORK_DIR}/prefix)
  file(GLOB installed ${WORK_DIR}/prefix/lib*/cmake/NovaPhy/NovaPhy_core.cmake)
  file(REMOVE ${installed})
  set(whole_prefix ${PREFIX})
  set(PREFIX ${WORK_DIR}/prefix)
  try_configure("REQUIRED COMPONENTS core" result output)
  set(PREFIX ${whole_prefix})
  if(result EQUAL 0 OR NOT output MATCHES "component 'core' is not installed")
    message(FATAL_ERROR "a missing component: got ${result}: ${output}")
  endif()
  foreach(request "REQUIRED" "REQUIRED COMPONENTS core" "0.1 COMPONENTS core OPTIONAL_COMPONENTS warp_drive")
    try_configure("${request}" result output)
    if(NOT result EQUAL 0)
      message(FATAL_ERROR "find_package(NovaPhy ${request}) failed: ${output}")
    endif()
  endforeach()
  return()
endif()

if(COMPONENT STREQUAL "headers")
  # An installed header includes installed ones, of the libraries that are there.
  file(GLOB_RECURSE headers RELATIVE ${PREFIX}/include ${PREFIX}/include/novaphy/*.h)
  foreach(header ${headers})
    file(STRINGS ${PREFIX}/include/${header} includes REGEX "^#include \"novaphy/")
    foreach(include ${includes})
      string(REGEX REPLACE "^#include \"([^\"]+)\".*" "\\1" include "${include}")
      string(REGEX REPLACE "^(novaphy/[^/]+)/.*" "\\1" library "${include}")
      if(NOT include IN_LIST headers AND EXISTS ${PREFIX}/include/${library})
        message(SEND_ERROR "${header} includes ${include}, which is not installed")
      endif()
    endforeach()
  endforeach()
  list(LENGTH headers count)
  if(count LESS 50)
    message(SEND_ERROR "expected the headers of NovaPhy, got ${count}")
  endif()
  return()
endif()

if(COMPONENT STREQUAL "pkg_config")
  foreach(name LICENSE NOTICE)
    if(NOT EXISTS ${PREFIX}/share/licenses/novaphy/${name})
      message(FATAL_ERROR "${name} is not installed")
    endif()
  endforeach()
  file(GLOB pc_files ${PREFIX}/lib*/pkgconfig/novaphy-*.pc ${PREFIX}/lib/*/pkgconfig/novaphy-*.pc)
  list(GET pc_files 0 folder)
  get_filename_component(folder ${folder} DIRECTORY)
  set(ENV{PKG_CONFIG_PATH} ${folder})
  foreach(file ${pc_files})
    get_filename_component(name ${file} NAME_WLE)
    execute_process(COMMAND ${PKG_CONFIG} --exists --print-errors ${name} COMMAND_ERROR_IS_FATAL ANY)
  endforeach()
  execute_process(COMMAND ${PKG_CONFIG} --cflags --libs novaphy-core OUTPUT_VARIABLE flags COMMAND_ERROR_IS_FATAL ANY)
  separate_arguments(flags UNIX_COMMAND "${FLAGS} ${flags}")
  file(MAKE_DIRECTORY ${WORK_DIR})
  execute_process(COMMAND ${COMPILER} ${SOURCE_DIR}/core/main.cpp -o ${WORK_DIR}/consumer ${flags} -Wl,-rpath,${folder}/..
                  COMMAND_ERROR_IS_FATAL ANY)
  execute_process(COMMAND ${WORK_DIR}/consumer COMMAND_ERROR_IS_FATAL ANY)
  return()
endif()

if(COMPONENT STREQUAL "subdirectory")
  file(WRITE ${WORK_DIR}/CMakeLists.txt
       "cmake_minimum_required(VERSION 3.25)\nproject(parent LANGUAGES C CXX)\nadd_subdirectory(${NOVAPHY} novaphy)\n"
       "if(NOT TARGET novaphy::dynamics OR TARGET test_core OR TARGET gtest)\n"
       "  message(FATAL_ERROR \"expected the libraries and no tests\")\nendif()\n")
  execute_process(COMMAND ${CMAKE_COMMAND} -G ${GENERATOR} -S ${WORK_DIR} -B ${WORK_DIR}/build
                          -DCMAKE_CXX_COMPILER=${COMPILER} OUTPUT_QUIET COMMAND_ERROR_IS_FATAL ANY)
  return()
endif()

execute_process(COMMAND ${CMAKE_COMMAND} -G ${GENERATOR} -S ${SOURCE_DIR}/${COMPONENT} -B ${WORK_DIR}
                        -DCMAKE_CXX_COMPILER=${COMPILER} -DCMAKE_PREFIX_PATH=${PREFIX} -DCMAKE_CXX_FLAGS=${FLAGS}
                COMMAND_ERROR_IS_FATAL ANY)
execute_process(COMMAND ${CMAKE_COMMAND} --build ${WORK_DIR} COMMAND_ERROR_IS_FATAL ANY)
execute_process(COMMAND ${CMAKE_CTEST_COMMAND} --test-dir ${WORK_DIR} --output-on-failure --no-tests=error
                COMMAND_ERROR_IS_FATAL ANY)
