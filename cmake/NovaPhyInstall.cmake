# The installed package: NovaPhyConfig.cmake knows every component of this version and what it needs; the components'
# own target files come from novaphy_add_library. A component may be installed without the others.
include(CMakePackageConfigHelpers)

set(NOVAPHY_KNOWN_COMPONENTS core nova collision io dynamics vbd diff)
set(dependencies_core)
set(dependencies_nova core)
set(dependencies_collision core)
set(dependencies_io core collision)  # not in its headers
set(dependencies_dynamics core collision)
if(NOVAPHY_WITH_NOVA)
  list(APPEND dependencies_dynamics nova)  # not in its headers, but its library loads that one
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
