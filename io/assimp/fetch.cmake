# Sets `root` to the sources of assimp 5.4.3. They come in a source package of a Python binding, which holds all of
# assimp as it is, and what assimp itself bundles. The binding is not used.
set(package assimp_py-1.1.0)
set(sha256 ad982d33ba9ff836749a6475e145e8dcdfc106e174876ac035662301707c967c)
set(NOVAPHY_ASSIMP_URL
    https://files.pythonhosted.org/packages/0b/6c/bfab1e914dc0b93a482f8093d4f04c85e8c58f0c9de341291e3d6f00744d/${package}.tar.gz
    CACHE STRING "Where NOVAPHY_ASSIMP=source takes ${package}.tar.gz from; file://<path> for one that is here")

set(root ${CMAKE_CURRENT_BINARY_DIR}/${package}/src/assimp)
set(archive ${CMAKE_CURRENT_BINARY_DIR}/${package}.tar.gz)
set(stamp ${CMAKE_CURRENT_BINARY_DIR}/${package}.stamp)
if(NOT EXISTS ${stamp})
  message(STATUS "Fetching assimp from ${NOVAPHY_ASSIMP_URL}")
  foreach(attempt RANGE 2)
    file(DOWNLOAD ${NOVAPHY_ASSIMP_URL} ${archive} STATUS status INACTIVITY_TIMEOUT 30)
    list(POP_FRONT status code reason)
    if(code EQUAL 0)
      break()
    endif()
  endforeach()
  if(code EQUAL 0)
    file(SHA256 ${archive} got)
    set(reason "expected SHA-256 ${sha256}, got ${got}")
  endif()
  if(NOT code EQUAL 0 OR NOT got STREQUAL sha256)
    message(FATAL_ERROR "NOVAPHY_ASSIMP=source could not fetch ${NOVAPHY_ASSIMP_URL}: ${reason}. Without a network "
                        "configure with NOVAPHY_ASSIMP_URL=file://<path of that file>, with NOVAPHY_ASSIMP=system, "
                        "which takes the assimp of this machine, or with NOVAPHY_WITH_IO=OFF, which leaves out load_mesh.")
  endif()
  file(ARCHIVE_EXTRACT INPUT ${archive} DESTINATION ${CMAKE_CURRENT_BINARY_DIR} PATTERNS ${package}/src/assimp/*)
  file(TOUCH ${stamp})
endif()
