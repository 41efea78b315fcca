# Makes the installed package. NovaPhyConfig.cmake lists every component of this version with its
# dependencies. novaphy_add_library makes the target file of each component. A component may be installed
# without the other components.
include(CMakePackageConfigHelpers)

set(NOVAPHY_KNOWN_COMPONENTS core io nova collision dynamics vbd diff)
set(dependencies_core)
set(dependencies_io core)
set(dependencies_nova core)
set(dependencies_collision core)
set(dependencies_dynamics core collision)
if(NOVAPHY_WITH_NOVA)
  list(APPEND dependencies_dynamics nova)  # only the library depends on nova, not its headers
endif()
set(dependencies_vbd core collision)
set(dependencies_diff core nova collision dynamics)
if(NOVAPHY_BUILD_VBD)
  list(APPEND dependencies_diff vbd)
endif()

set(NOVAPHY_COMPONENT_DEPENDENCIES "")
foreach(component ${NOVAPHY_KNOWN_COMPONENTS})
  string(APPEND NOVAPHY_COMPONENT_DEPENDENCIES
         "set(_novaphy_dependencies_${component} ${dependencies_${component}})\n")
endforeach()

set(destination ${CMAKE_INSTALL_LIBDIR}/cmake/NovaPhy)
configure_package_config_file(${CMAKE_CURRENT_LIST_DIR}/NovaPhyConfig.cmake.in
                              ${CMAKE_CURRENT_BINARY_DIR}/NovaPhyConfig.cmake INSTALL_DESTINATION ${destination})
write_basic_package_version_file(${CMAKE_CURRENT_BINARY_DIR}/NovaPhyConfigVersion.cmake
                                 VERSION ${PROJECT_VERSION} COMPATIBILITY SameMinorVersion)
install(FILES ${CMAKE_CURRENT_BINARY_DIR}/NovaPhyConfig.cmake ${CMAKE_CURRENT_BINARY_DIR}/NovaPhyConfigVersion.cmake
        DESTINATION ${destination} COMPONENT core)
install(FILES ${PROJECT_SOURCE_DIR}/LICENSE ${PROJECT_SOURCE_DIR}/NOTICE
        DESTINATION ${CMAKE_INSTALL_DATADIR}/licenses/novaphy COMPONENT core)

# Makes one pkg-config file for each component, for builds without CMake: `pkg-config --cflags --libs
# novaphy-core`.
get_property(components GLOBAL PROPERTY NOVAPHY_COMPONENTS)
file(RELATIVE_PATH up /${CMAKE_INSTALL_LIBDIR}/pkgconfig /)
foreach(component ${components})
  list(TRANSFORM dependencies_${component} PREPEND novaphy- OUTPUT_VARIABLE requires)
  list(JOIN requires " " requires)
  configure_file(${CMAKE_CURRENT_LIST_DIR}/novaphy.pc.in ${CMAKE_CURRENT_BINARY_DIR}/novaphy-${component}.pc @ONLY)
  install(FILES ${CMAKE_CURRENT_BINARY_DIR}/novaphy-${component}.pc
          DESTINATION ${CMAKE_INSTALL_LIBDIR}/pkgconfig COMPONENT ${component})
endforeach()
