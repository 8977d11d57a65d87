# Finds the interpreter and pybind11. The .venv of the checkout is preferred:
# it pins the pybind11 version. With TAI_PYTHON_HEADERS, the include folders of
# another CPython, and TAI_PYTHON_SUFFIX, the end of its modules' names, that one's
# module is built, and the interpreter only finds pybind11.
if(NOT Python3_EXECUTABLE AND EXISTS "${PROJECT_SOURCE_DIR}/.venv/bin/python")
  set(Python3_EXECUTABLE "${PROJECT_SOURCE_DIR}/.venv/bin/python")
endif()
find_package(Python3 3.11 COMPONENTS Interpreter Development.Module)
if(Python3_Interpreter_FOUND AND NOT pybind11_DIR)
  execute_process(COMMAND "${Python3_EXECUTABLE}" -m pybind11 --cmakedir
    OUTPUT_VARIABLE pybind11_DIR OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET)
endif()
if(TAI_PYTHON_HEADERS)
  set(PYBIND11_NOPYTHON ON)
endif()
# pybind11 shall use the interpreter found above.
set(PYBIND11_FINDPYTHON ON)
set(Python_EXECUTABLE "${Python3_EXECUTABLE}")
find_package(pybind11 CONFIG)
if(NOT pybind11_FOUND)
  message(WARNING "pybind11 not found: the Python module is not built "
                  "(scripts/setup.sh makes a .venv that has it)")
  set(TAI_PYTHON OFF)
endif()
