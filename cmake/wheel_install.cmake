# What the wheel installs beside the messages: the ROS share directory of pipeline_tracker.
include("${CMAKE_CURRENT_LIST_DIR}/ros_wheels.cmake")

get_filename_component(wheel_root "${CMAKE_CURRENT_LIST_DIR}/.." ABSOLUTE)
install(FILES "${wheel_root}/pipeline_tracker/package.xml" DESTINATION share/pipeline_tracker)
foreach(directory IN ITEMS config launch)
  if(IS_DIRECTORY "${wheel_root}/${directory}")
    install(DIRECTORY "${wheel_root}/${directory}" DESTINATION share/pipeline_tracker
      PATTERN "__pycache__" EXCLUDE)
  endif()
endforeach()

file(WRITE "${CMAKE_BINARY_DIR}/ament_index_marker/pipeline_tracker" "")
install(FILES "${CMAKE_BINARY_DIR}/ament_index_marker/pipeline_tracker"
  DESTINATION share/ament_index/resource_index/packages)
