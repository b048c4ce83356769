# LibTorch, 1.13 to 2.x, Debian's or a package of PyTorch: finds it and settles what depends on which one was found. Each
# fault is a sentence. Sets TORCH_LIBRARIES, CMAKE_CXX_STANDARD, the target OpenMP::OpenMP_CXX (found before) and
# GLD_TORCH_FMT, what sources with LibTorch need beside fmt::fmt, and GLD_HAS_GLOO: whether several processes can train.

# Its own search for an MKL of the system would add one that it was not built with to the link.
set(CMAKE_DISABLE_FIND_PACKAGE_MKL ON)

# A LibTorch with CUDA has CMake look for the toolkit, with a page of errors where it is missing.
find_library(GLD_TORCH_CPU_LIBRARY torch_cpu HINTS ${Torch_DIR}/../../../lib)
get_filename_component(gld_torch_libraries "${GLD_TORCH_CPU_LIBRARY}" DIRECTORY)
if(GLD_TORCH_CPU_LIBRARY AND EXISTS ${gld_torch_libraries}/libtorch_cuda.so)
  # The one that scripts/setup.sh lays beside PyTorch's package; elsewhere the system's. LibTorch's own search has another name for it.
  file(GLOB gld_toolkit_beside ${gld_torch_libraries}/../../nvidia/cu*/bin/nvcc)
  if(gld_toolkit_beside AND NOT CUDAToolkit_ROOT AND NOT CUDA_TOOLKIT_ROOT_DIR)
    list(GET gld_toolkit_beside -1 gld_toolkit_beside)
    get_filename_component(CUDAToolkit_ROOT "${gld_toolkit_beside}/../.." REALPATH)
    set(CUDA_TOOLKIT_ROOT_DIR "${CUDAToolkit_ROOT}")
  endif()
  find_package(CUDAToolkit QUIET)
  set(gld_missing "")
  if(NOT CUDAToolkit_NVCC_EXECUTABLE)
    list(APPEND gld_missing "nvcc")
  endif()
  foreach(gld_library cudart nvrtc cublas)
    if(NOT TARGET CUDA::${gld_library})
      list(APPEND gld_missing ${gld_library})
    endif()
  endforeach()
  if(gld_missing)
    list(JOIN gld_missing ", " gld_missing)
    message(FATAL_ERROR "The LibTorch in ${gld_torch_libraries} was built with CUDA and needs the CUDA toolkit, of which "
                        "was not found: ${gld_missing}. Install the toolkit of its CUDA version, or take a LibTorch "
                        "without CUDA, which needs none.")
  endif()
  # LibTorch's CMake asks for the devices that sources are compiled for; none of ours is, and without it a device is looked for.
  if(NOT TORCH_CUDA_ARCH_LIST AND NOT DEFINED ENV{TORCH_CUDA_ARCH_LIST})
    set(TORCH_CUDA_ARCH_LIST 8.0)
  endif()
endif()

find_package(Torch QUIET)
if(NOT Torch_FOUND)
  message(FATAL_ERROR "LibTorch was not found. Run scripts/setup.sh (Debian's libtorch-dev), or unpack any "
                      "LibTorch 1.13 to 2.x and pass -DCMAKE_PREFIX_PATH=/path/to/libtorch.")
endif()
if(Torch_VERSION AND Torch_VERSION VERSION_LESS 1.13)
  message(FATAL_ERROR "LibTorch ${Torch_VERSION} was found, 1.13 or newer is needed: "
                      "pass -DCMAKE_PREFIX_PATH=/path/to/libtorch of a newer one.")
endif()

# 2.14 and newer refuse C++17. g++ 12 in C++20 warns of overlaps inside std::string that are not there (its bug 105651).
if(Torch_VERSION VERSION_GREATER_EQUAL 2.14)
  set(CMAKE_CXX_STANDARD 20)
  if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU" AND CMAKE_CXX_COMPILER_VERSION VERSION_LESS 13)
    add_compile_options(-Wno-restrict)
  endif()
endif()

# Packages of PyTorch before 2.7 have the C++ ABI of before 2011; then everything else must have it.
if(TORCH_CXX_FLAGS MATCHES "_GLIBCXX_USE_CXX11_ABI=0")
  include(CheckCXXSourceCompiles)
  set(CMAKE_REQUIRED_DEFINITIONS -D_GLIBCXX_USE_CXX11_ABI=0)
  set(CMAKE_REQUIRED_LIBRARIES yaml-cpp)
  check_cxx_source_compiles("#include <yaml-cpp/yaml.h>\nint main() { return YAML::Load(std::string(\"1\")).as<int>(); }"
                            GLD_LIBRARIES_HAVE_THE_OLD_ABI)
  unset(CMAKE_REQUIRED_DEFINITIONS)
  unset(CMAKE_REQUIRED_LIBRARIES)
  if(NOT GLD_LIBRARIES_HAVE_THE_OLD_ABI)
    message(FATAL_ERROR "This LibTorch ${Torch_VERSION} was built with the old C++ ABI (_GLIBCXX_USE_CXX11_ABI=0), which the "
                        "other libraries here, yaml-cpp for one, do not have: take LibTorch's cxx11-abi build of that "
                        "version, or 2.7 or newer.")
  endif()
  add_compile_definitions(_GLIBCXX_USE_CXX11_ABI=0)
endif()

# PyTorch's packages with CUDA show parts of a C++ library of their own to the whole process, std::filesystem::remove_all
# among them, which there calls nothing (2.11: a fault at address 0): the compiler's library is asked first.
if(EXISTS ${gld_torch_libraries}/libtorch_cuda.so)
  foreach(kind EXE SHARED)
    string(PREPEND CMAKE_${kind}_LINKER_FLAGS "-Wl,--push-state,--no-as-needed,-lstdc++,--pop-state ")
  endforeach()
endif()

# One OpenMP runtime in the process, LibTorch's where it brings one: a second would have a pool of threads of its own.
file(GLOB gld_openmp_runtimes ${TORCH_INSTALL_PREFIX}/lib/libgomp*.so* ${TORCH_INSTALL_PREFIX}/lib/libiomp5.so
     ${TORCH_INSTALL_PREFIX}/lib/libomp.so*)
# clang's code calls what no libgomp has; its own runtime answers to libgomp's names too.
if(CMAKE_CXX_COMPILER_ID MATCHES "Clang")
  list(FILTER gld_openmp_runtimes EXCLUDE REGEX "/libgomp[^/]*$")
endif()
if(gld_openmp_runtimes)
  list(GET gld_openmp_runtimes 0 gld_openmp_runtime)
  set_target_properties(OpenMP::OpenMP_CXX PROPERTIES INTERFACE_LINK_LIBRARIES ${gld_openmp_runtime})
endif()

# LibTorch 2.x brings headers of an fmt of its own, which hide the system's and do not go with its library.
set(GLD_TORCH_FMT "")
get_target_property(gld_fmt_headers fmt::fmt INTERFACE_INCLUDE_DIRECTORIES)
file(REAL_PATH "${TORCH_INSTALL_PREFIX}/include" gld_torch_headers_at)
if(EXISTS ${gld_torch_headers_at}/fmt/format.h AND NOT gld_torch_headers_at IN_LIST gld_fmt_headers)
  set(GLD_TORCH_FMT fmt::fmt-header-only)
endif()

# Several processes meet by LibTorch's Gloo, whose class has Gloo's in its header. PyTorch's packages come without these, and
# a system's, of another year, do not go with their library.
find_path(GLD_GLOO_INCLUDE gloo/rendezvous/store.h)
set(GLD_HAS_GLOO OFF)
if(GLD_GLOO_INCLUDE AND Torch_VERSION VERSION_LESS 2 AND TARGET torch_cpu)
  get_target_property(gld_torch_definitions torch_cpu INTERFACE_COMPILE_DEFINITIONS)
  if("USE_C10D_GLOO" IN_LIST gld_torch_definitions)
    set(GLD_HAS_GLOO ON)
  endif()
endif()
