# Gives cmake/GldLibTorch.cmake folders that look like LibTorch of several kinds: what depends on the version is chosen, and
# what cannot be built with is refused in a sentence.
cmake_minimum_required(VERSION 3.25)

file(REMOVE_RECURSE ${SCRATCH})
file(WRITE ${SCRATCH}/CMakeLists.txt "
cmake_minimum_required(VERSION 3.25)
project(found LANGUAGES CXX)
set(CMAKE_CXX_STANDARD 17)
list(APPEND CMAKE_MODULE_PATH ${ROOT}/cmake)
find_package(OpenMP REQUIRED COMPONENTS CXX)
find_package(yaml-cpp REQUIRED)
find_package(fmt REQUIRED)
include(GldLibTorch)
get_target_property(openmp OpenMP::OpenMP_CXX INTERFACE_LINK_LIBRARIES)
get_directory_property(definitions COMPILE_DEFINITIONS)
message(STATUS \"C++\${CMAKE_CXX_STANDARD} fmt=\${GLD_TORCH_FMT} openmp=\${openmp} definitions=\${definitions}.\")
")

# libtorch(VERSION [FILE ...]): a folder with that version, and empty files. TORCH_CXX_FLAGS as LibTorch's configuration has it.
function(libtorch version)
  file(REMOVE_RECURSE ${SCRATCH}/torch ${SCRATCH}/build)
  file(WRITE ${SCRATCH}/torch/share/cmake/Torch/TorchConfigVersion.cmake
       "set(PACKAGE_VERSION ${version})\nset(PACKAGE_VERSION_COMPATIBLE TRUE)\n")
  file(WRITE ${SCRATCH}/torch/share/cmake/Torch/TorchConfig.cmake
       "set(TORCH_INSTALL_PREFIX ${prefix})\nset(TORCH_LIBRARIES torch)\nset(TORCH_CXX_FLAGS \"${flags}\")\n")
  foreach(name lib/libtorch_cpu.so ${ARGN})
    file(WRITE ${SCRATCH}/torch/${name} "")
  endforeach()
endfunction()

# expect(TEXT): configuring prints that text, and succeeds exactly where it is the line of what was chosen.
function(expect text)
  execute_process(COMMAND ${CMAKE_COMMAND} -S ${SCRATCH} -B ${SCRATCH}/build -DCMAKE_PREFIX_PATH=${SCRATCH}/torch
                          -DCMAKE_DISABLE_FIND_PACKAGE_CUDAToolkit=ON
                  RESULT_VARIABLE code OUTPUT_VARIABLE printed ERROR_VARIABLE printed)
  string(REGEX REPLACE "[ \n]+" " " printed "${printed}")
  string(FIND "${printed}" "${text}" at)
  if(at EQUAL -1)
    message(FATAL_ERROR "expected '${text}', found: ${printed}")
  endif()
  if(text MATCHES "^C\\+\\+" AND NOT code EQUAL 0)
    message(FATAL_ERROR "expected success with '${text}', found status ${code}")
  elseif(NOT text MATCHES "^C\\+\\+" AND code EQUAL 0)
    message(FATAL_ERROR "expected a failure with '${text}', found status 0")
  endif()
endfunction()

# Debian's, among the system's headers.
set(prefix /usr)
libtorch(1.13.0)
expect("C++17 fmt= openmp=")

set(prefix ${SCRATCH}/torch)
libtorch(2.13.0 include/fmt/format.h lib/libgomp.so.1)
expect("C++17 fmt=fmt::fmt-header-only openmp=${SCRATCH}/torch/lib/libgomp.so.1 definitions=.")
libtorch(2.14.1 include/fmt/format.h lib/libgomp-0f2b9c1a.so.1)
expect("C++20 fmt=fmt::fmt-header-only openmp=${SCRATCH}/torch/lib/libgomp-0f2b9c1a.so.1")

libtorch(1.12.1)
expect("LibTorch 1.12.1 was found, 1.13 or newer is needed: pass -DCMAKE_PREFIX_PATH=/path/to/libtorch of a newer one.")
libtorch(2.14.1 lib/libtorch_cuda.so)
expect("was built with CUDA and needs the CUDA toolkit, of which was not found: nvcc, cudart, nvrtc, cublas. Install the toolkit of its CUDA version, or take a LibTorch without CUDA, which needs none.")
set(flags -D_GLIBCXX_USE_CXX11_ABI=0)
libtorch(2.6.0)
expect("This LibTorch 2.6.0 was built with the old C++ ABI (_GLIBCXX_USE_CXX11_ABI=0), which the other libraries here, yaml-cpp for one, do not have: take LibTorch's cxx11-abi build of that version, or 2.7 or newer.")
