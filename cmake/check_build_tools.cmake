# Says what to install when the compilers or the Python headers are missing; what CMake itself says
# does not help. Given as CMAKE_PROJECT_INCLUDE_BEFORE, so that it runs before CMake looks for them.

set(missing_tools "")

# CC and CXX go before a search, as in CMake itself; they may carry options.
function(check_compiler variable)
  set(names ${ARGN})
  if(NOT "$ENV{${variable}}" STREQUAL "")
    separate_arguments(names UNIX_COMMAND "$ENV{${variable}}")
    list(GET names 0 names)
  endif()
  unset(found)
  find_program(found NAMES ${names} NO_CACHE)
  if(NOT found)
    list(JOIN names ", " names)
    set(missing_tools ${missing_tools} "a compiler (looked for ${names})" PARENT_SCOPE)
  endif()
endfunction()
check_compiler(CC cc gcc clang)
check_compiler(CXX c++ g++ clang++)

set(check_python python3)
if(Python3_EXECUTABLE)
  set(check_python "${Python3_EXECUTABLE}")
endif()
execute_process(
  COMMAND "${check_python}" -c "import sysconfig; print(sysconfig.get_path('include'))"
  OUTPUT_VARIABLE check_include
  OUTPUT_STRIP_TRAILING_WHITESPACE
)
if(NOT EXISTS "${check_include}/Python.h" AND NOT EXISTS "${Python3_INCLUDE_DIR}/Python.h")
  list(APPEND missing_tools "the C headers of Python (looked for ${check_include}/Python.h)")
endif()

if(missing_tools)
  list(JOIN missing_tools "\n    " missing_tools)
  message(FATAL_ERROR
    "The messages of pipeline_tracker cannot be compiled. Missing:\n"
    "    ${missing_tools}\n"
    "Install them and try again. Debian and Ubuntu:\n"
    "    sudo apt-get install g++ python3-dev\n"
    "(for a Python that is not the system's: its own headers, such as python3.12-dev).\n"
    "The offline commands alone need no compiler:\n"
    "    PIPELINE_TRACKER_OFFLINE=1 pip install .\n"
  )
endif()
