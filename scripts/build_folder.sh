# Sourced by scripts that take --libtorch DIR and --quick, from the repository's root: sets build_folder, configuration (for
# cmake), libtorch and version where it was given, and rest, the other arguments.

build_folder=build/release
quick=
libtorch=
configuration=()
rest=()
while [ $# -gt 0 ]; do
  if [ "$1" = --quick ]; then
    # Nothing but the kernels is optimised: two thirds of the time are the optimiser's. And clang reads a precompiled header
    # of LibTorch's in a tenth of a second, g++ in three. In a folder of its own: CMake keeps
    # the compiler that a folder was first configured with, and the program that is used would be clang's from then on.
    quick=-quick
    configuration+=(-DCMAKE_CXX_COMPILER=clang++-14 "-DCMAKE_CXX_FLAGS_RELEASE=-O0 -DNDEBUG")
    shift
    continue
  fi
  if [ "$1" != --libtorch ]; then
    rest+=("$1")
    shift
    continue
  fi
  version_file=${2:-}/share/cmake/Torch/TorchConfigVersion.cmake
  if [ ! -f "$version_file" ]; then
    echo "$0: --libtorch: expected a folder with share/cmake/Torch, found '${2:-}'; scripts/setup.sh --libtorch-version 2.13 makes one." >&2
    exit 2
  fi
  version=$(sed -n 's/^set(PACKAGE_VERSION "\(.*\)").*/\1/p' "$version_file")
  libtorch=$2
  build_folder=build/libtorch-$version
  configuration+=(-DCMAKE_PREFIX_PATH="$(realpath "$2")")
  shift 2
done
build_folder=$build_folder$quick
