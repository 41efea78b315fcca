# Configures, builds and runs the consumer of one component against the installed package. The pseudo component
# "unknown" checks what a wrong request is told.
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
  # A copy without one component's file: other consumers use the prefix at the same time.
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

execute_process(COMMAND ${CMAKE_COMMAND} -G ${GENERATOR} -S ${SOURCE_DIR}/${COMPONENT} -B ${WORK_DIR}
                        -DCMAKE_CXX_COMPILER=${COMPILER} -DCMAKE_PREFIX_PATH=${PREFIX} -DCMAKE_CXX_FLAGS=${FLAGS}
                COMMAND_ERROR_IS_FATAL ANY)
execute_process(COMMAND ${CMAKE_COMMAND} --build ${WORK_DIR} COMMAND_ERROR_IS_FATAL ANY)
execute_process(COMMAND ${CMAKE_CTEST_COMMAND} --test-dir ${WORK_DIR} --output-on-failure --no-tests=error
                COMMAND_ERROR_IS_FATAL ANY)
