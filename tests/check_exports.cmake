# The dynamic symbol table of LIBRARY holds symbols that match ALLOWED and no others, above all none of std::. Whoever
# catches a novaphy::Error needs its type description, which stands in core.
cmake_minimum_required(VERSION 3.25)
execute_process(COMMAND ${NM} --dynamic --defined-only --format=posix ${LIBRARY}
                OUTPUT_VARIABLE output COMMAND_ERROR_IS_FATAL ANY)
string(REGEX MATCHALL "[^\n]+" lines "${output}")
set(exported "")
foreach(line ${lines})
  string(REGEX REPLACE "[ @].*" "" symbol "${line}")
  if(symbol MATCHES "^NOVAPHY_")  # the version of the others
    continue()
  endif()
  if(NOT symbol MATCHES "^${ALLOWED}")
    message(SEND_ERROR "${LIBRARY} exports ${symbol}")
  endif()
  list(APPEND exported ${symbol})
endforeach()
if(NOT exported)
  message(FATAL_ERROR "${LIBRARY} exports nothing")
endif()
if(LIBRARY MATCHES "novaphy_core" AND NOT "_ZTIN7novaphy5ErrorE" IN_LIST exported)
  message(FATAL_ERROR "${LIBRARY} hides the type description of novaphy::Error")
endif()
