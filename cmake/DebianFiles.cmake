# Script of CPack: puts files where Debian has them. Each component has a tree of its
# own in CPACK_TEMPORARY_INSTALL_DIRECTORY.
foreach(component ${CPACK_COMPONENTS_ALL})
  set(root "${CPACK_TEMPORARY_INSTALL_DIRECTORY}/${component}")
  string(TOUPPER "${component}" upper)
  set(package "${CPACK_DEBIAN_${upper}_PACKAGE_NAME}")
  file(COPY_FILE "${CPACK_RESOURCE_FILE_LICENSE}" "${CPACK_TEMPORARY_INSTALL_DIRECTORY}/copyright")
  file(MAKE_DIRECTORY "${root}/usr/share/doc/${package}")
  file(RENAME "${CPACK_TEMPORARY_INSTALL_DIRECTORY}/copyright"
    "${root}/usr/share/doc/${package}/copyright")
endforeach()
set(root "${CPACK_TEMPORARY_INSTALL_DIRECTORY}/python/usr")
if(EXISTS "${root}/python")
  file(MAKE_DIRECTORY "${root}/lib/python3/dist-packages")
  file(RENAME "${root}/python/tai" "${root}/lib/python3/dist-packages/tai")
  file(REMOVE_RECURSE "${root}/python")
endif()
