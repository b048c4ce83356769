# Everything the project links against, each with a sentence that says what to do when it is missing.

macro(gld_require package debian_package)
  find_package(${package} QUIET ${ARGN})
  if(NOT ${package}_FOUND)
    message(FATAL_ERROR "${package} was not found. Run scripts/setup.sh, or install the Debian package "
                        "${debian_package}; another copy is found through -DCMAKE_PREFIX_PATH=DIR.")
  endif()
endmacro()

gld_require(Eigen3 libeigen3-dev 3.4)
gld_require(nlohmann_json nlohmann-json3-dev)
gld_require(yaml-cpp libyaml-cpp-dev)
gld_require(fmt libfmt-dev)
gld_require(Threads libc6-dev)
find_package(OpenMP QUIET COMPONENTS CXX)
if(NOT OpenMP_CXX_FOUND)
  message(FATAL_ERROR "OpenMP for C++ was not found; it comes with g++ (libgomp) and as libomp-dev for clang.")
endif()
gld_require(PkgConfig pkg-config)
gld_require(ZLIB zlib1g-dev)
pkg_check_modules(CAIRO IMPORTED_TARGET cairo cairo-svg cairo-png)
if(NOT CAIRO_FOUND)
  message(FATAL_ERROR "cairo was not found. Run scripts/setup.sh, or install the Debian package libcairo2-dev.")
endif()
gld_require(OpenCV libopencv-dev 4 COMPONENTS core imgproc imgcodecs calib3d)

if(NOT GLD_SANITIZE)
  find_package(Torch QUIET)
  if(NOT Torch_FOUND)
    message(FATAL_ERROR "LibTorch was not found. Run scripts/setup.sh (Debian's libtorch-dev), or unpack any "
                        "LibTorch 1.13 to 2.x and pass -DCMAKE_PREFIX_PATH=/path/to/libtorch.")
  endif()
  if(Torch_VERSION AND Torch_VERSION VERSION_LESS 1.13)
    message(FATAL_ERROR "LibTorch ${Torch_VERSION} was found, 1.13 or newer is needed: "
                        "pass -DCMAKE_PREFIX_PATH=/path/to/libtorch of a newer one.")
  endif()
  gld_require(CLI11 libcli11-dev)
endif()
