# The stamp of WriteExports.cmake: the same for other comments, another one for other code.
function(write_stamp text result)
  file(WRITE ${WORK_DIR}/header.h "${text}")
  execute_process(COMMAND ${CMAKE_COMMAND} -DVERSION=1 -DHEADERS=header.h -DTEMPLATE=${SOURCE_DIR}/cmake/exports.map.in
                          -DOUTPUT=${WORK_DIR}/exports.map -P ${SOURCE_DIR}/cmake/WriteExports.cmake
                  WORKING_DIRECTORY ${WORK_DIR} COMMAND_ERROR_IS_FATAL ANY)
  file(STRINGS ${WORK_DIR}/exports.map found REGEX "^NOVAPHY_1_[0-9a-f]+ {")
  set(${result} "${found}" PARENT_SCOPE)
endfunction()

write_stamp("// A head comment.\nint f(int a);  // of one\n" first)
write_stamp("// Another one;\n// of two [lines].\nint f(int a);  // of a\n" commented)
write_stamp("// A head comment.\nint f(long a);  // of one\n" changed)
if(NOT first OR NOT first STREQUAL commented)
  message(FATAL_ERROR "other comments: expected ${first}, got ${commented}")
endif()
if(first STREQUAL changed)
  message(FATAL_ERROR "other code: expected another stamp than ${first}")
endif()
