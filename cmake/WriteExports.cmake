# Writes the linker version script OUTPUT for HEADERS (see NovaPhyLibrary.cmake). The hash of the headers
# leaves comments out: whole lines, and comments behind code, which begin after two spaces.
cmake_minimum_required(VERSION 3.25)
set(hashes "")
foreach(header ${HEADERS})
  file(READ ${header} text)
  string(REGEX REPLACE "(^|\n)[ \t]*//[^\n]*" "" text "${text}")
  string(REGEX REPLACE "  +//[^\n]*" "" text "${text}")
  string(SHA256 hash "${text}")
  list(APPEND hashes ${header} ${hash})
endforeach()
string(SHA256 stamp "${hashes}")
string(SUBSTRING ${stamp} 0 12 stamp)
configure_file(${TEMPLATE} ${OUTPUT} @ONLY)
