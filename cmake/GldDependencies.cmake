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
if(NOT OpenMP_CXX_FOUND AND GLD_FUZZ)
  add_library(OpenMP::OpenMP_CXX INTERFACE IMPORTED)  # no fuzzer links the kernels, and clang has OpenMP only with libomp-dev
elseif(NOT OpenMP_CXX_FOUND)
  message(FATAL_ERROR "OpenMP for C++ was not found; it comes with g++ (libgomp) and as libomp-dev for clang.")
endif()
gld_require(PkgConfig pkg-config)
gld_require(ZLIB zlib1g-dev)
gld_require(OpenSSL libssl-dev 1.1.1 COMPONENTS Crypto)
gld_require(PNG libpng-dev 1.6)
gld_require(JPEG libjpeg-dev)
gld_require(TIFF libtiff-dev 4.5)

# The same for libraries that only pkg-config knows; the target is PkgConfig::NAME.
macro(gld_require_module name title debian_package)
  pkg_check_modules(${name} QUIET IMPORTED_TARGET ${ARGN})
  if(NOT ${name}_FOUND)
    message(FATAL_ERROR "${title} was not found. Run scripts/setup.sh, or install the Debian package "
                        "${debian_package}.")
  endif()
endmacro()

gld_require_module(CAIRO cairo libcairo2-dev cairo cairo-svg cairo-png)
gld_require_module(PANGO Pango libpango1.0-dev pangocairo>=1.44)
gld_require_module(EXIF libexif libexif-dev libexif)
gld_require_module(HEIF libheif libheif-dev libheif>=1.15)
gld_require_module(WEBP libwebp libwebp-dev libwebp libwebpdemux libwebpmux)
gld_require(OpenCV libopencv-dev 4 COMPONENTS core imgproc imgcodecs features2d calib3d)
# Debian's Ceres names ATLAS, and CMake would find it. It would come before the libblas.so.3 of Debian's alternatives in every
# program that registers photographs, and LibTorch would multiply by it, five times slower than by OpenBLAS.
set(BLA_VENDOR Generic)
gld_require(Ceres libceres-dev 2.1)
unset(BLA_VENDOR)
get_target_property(gld_ceres_libraries Ceres::ceres INTERFACE_LINK_LIBRARIES)
list(FILTER gld_ceres_libraries EXCLUDE REGEX "/lib(f77blas|atlas)\\.so$")
set_target_properties(Ceres::ceres PROPERTIES INTERFACE_LINK_LIBRARIES "${gld_ceres_libraries}")

# A header alone, compiled in one place without what it has for images: no library of Debian's is linked.
find_path(GLD_TINYGLTF_FOLDER tiny_gltf.h)
if(NOT GLD_TINYGLTF_FOLDER)
  message(FATAL_ERROR "tinygltf was not found. Run scripts/setup.sh, or install the Debian package libtinygltf-dev.")
endif()
add_library(gld_tinygltf INTERFACE)
target_include_directories(gld_tinygltf SYSTEM INTERFACE ${GLD_TINYGLTF_FOLDER})
target_compile_definitions(gld_tinygltf INTERFACE TINYGLTF_NO_STB_IMAGE TINYGLTF_NO_STB_IMAGE_WRITE)

if(GLD_BUILD_TESTS)
  gld_require_module(HDF5 HDF5 libhdf5-dev hdf5)  # writes what our reader of it is tested with
endif()

if(NOT GLD_SANITIZE)
  include(GldLibTorch)
  gld_require(CLI11 libcli11-dev)
endif()
