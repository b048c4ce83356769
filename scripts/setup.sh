#!/usr/bin/env bash
# Installs what building and running needs, with apt, on Debian 12. Does nothing when nothing is missing.
#   --testing                 also what tests need: clang for its sanitizers, and programs that read what we write, a
#                             browser among them, and build/venv-testing with those that Debian lacks
#   --development             also all of --testing and what checks the sources
#   --packaging               also what scripts/package.sh needs
#   --libtorch-version 2.13   also PyTorch's package of that LibTorch, with pip, into a virtual environment of its own below
#                             build/; what it is and how large is said first, and where it lies at the end
set -euo pipefail
cd "$(dirname "$0")/.."

testing=
development=
packaging=
libtorch_version=
while [ $# -gt 0 ]; do
  case $1 in
    --testing) testing=yes ;;
    --development) development=yes testing=yes ;;
    --packaging) packaging=yes ;;
    --libtorch-version)
      libtorch_version=${2:-}
      if ! [[ $libtorch_version =~ ^[0-9]+\.[0-9]+(\.[0-9]+)?$ ]]; then
        echo "setup: --libtorch-version: expected a version, found '$libtorch_version'; write for example 2.13." >&2
        exit 2
      fi
      shift
      ;;
    *)
      echo "setup: expected --testing, --development, --packaging or --libtorch-version VERSION, found '$1'." >&2
      exit 2
      ;;
  esac
  shift
done

packages=(
  g++ cmake ninja-build pkg-config
  libtorch-dev libgloo-dev libopenblas0-pthread libopencv-dev libceres-dev libeigen3-dev nlohmann-json3-dev libyaml-cpp-dev
  libgtest-dev libgmock-dev libbenchmark-dev libcli11-dev zlib1g-dev libfmt-dev libhdf5-dev libcairo2-dev
  libpango1.0-dev fonts-dejavu-core libpng-dev libjpeg-dev libtiff-dev libwebp-dev libexif-dev libheif-dev
  libssl-dev libtinygltf-dev libjs-three
)
if [ -n "$testing" ]; then
  packages+=(
    python3 python3-jsonschema python3-numpy python3-venv colmap ffmpeg assimp-utils chromium chromium-driver python3-selenium
    clang-14 libclang-rt-14-dev libomp-dev
  )
fi
if [ -n "$development" ]; then
  packages+=(git clang-format clang-tidy)
fi
if [ -n "$libtorch_version" ]; then
  packages+=(python3-venv)
fi
if [ -n "$packaging" ]; then
  packages+=(dpkg-dev file patchelf xz-utils libblas3 liblapack3)
fi

missing=()
for package in "${packages[@]}"; do
  status=$(dpkg-query -W -f '${Status}' "$package" 2>/dev/null || true)
  [ "$status" = "install ok installed" ] || missing+=("$package")
done

if [ ${#missing[@]} -eq 0 ]; then
  echo "setup: everything is installed already."
else
  run_as_root=()
  if [ "$(id -u)" -ne 0 ]; then
    if ! command -v sudo >/dev/null; then
      echo "setup: these packages are missing and neither root nor sudo is at hand: ${missing[*]}" >&2
      exit 1
    fi
    run_as_root=(sudo)
  fi
  echo "setup: installing ${missing[*]}"
  "${run_as_root[@]}" apt-get update -qq
  "${run_as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}"
  echo "setup: done."
fi

if [ -n "$testing" ]; then
  # Of plyfile the newest that takes Debian's numpy: later ones want numpy 2. trimesh brings Khronos' schema of glTF.
  readers=(plyfile==1.1.3 trimesh==5.2.0)
  environment=$PWD/build/venv-testing
  has_readers() {
    "$environment/bin/python" -c 'import importlib.metadata, sys, numpy
for reader in sys.argv[1:]:
    name, version = reader.split("==")
    if importlib.metadata.version(name) != version:
        sys.exit(1)' "${readers[@]}" 2>/dev/null
  }
  if ! has_readers; then
    echo "setup: installing ${readers[*]} with pip into $environment"
    # Debian's own Python, since another one on the path does not see Debian's numpy.
    /usr/bin/python3 -m venv --clear --system-site-packages "$environment"
    "$environment/bin/python" -m pip install --quiet --disable-pip-version-check "${readers[@]}"
    if ! has_readers; then
      echo "setup: expected ${readers[*]} in $environment after their installation, found others; look at what pip said above." >&2
      exit 1
    fi
  fi
fi

[ -n "$libtorch_version" ] || exit 0

environment=$PWD/build/venv-libtorch-$libtorch_version
[ -x "$environment/bin/pip" ] || python3 -m venv "$environment"
wanted="torch==$libtorch_version"
[[ $libtorch_version == *.*.* ]] || wanted+=".*"
if ! "$environment/bin/python" -c 'import importlib.util, sys; sys.exit(importlib.util.find_spec("torch") is None)'; then
  report=$(mktemp)
  trap 'rm -f "$report"' EXIT
  "$environment/bin/pip" install --quiet --dry-run --report "$report" "$wanted"
  kind=$("$environment/bin/python" - "$report" <<'PYTHON'
import json, sys
packages = [item["metadata"] for item in json.load(open(sys.argv[1]))["install"]]
torch = next(item for item in packages if item["name"] == "torch")
device = sum(item["name"].lower().startswith(("nvidia", "cuda", "triton")) for item in packages)
print(f"cuda torch {torch['version']} with CUDA and {device} packages for it, about 3 GB to fetch and 6 GB on the disk"
      if device else f"cpu torch {torch['version']} for the processor alone, about 0.2 GB to fetch and 0.8 GB on the disk")
PYTHON
)
  echo "setup: pip gives ${kind#* }, into $environment"
  # What torch needs in Python is of no use here; what it needs of CUDA is.
  only=()
  [ "${kind%% *}" = cuda ] || only=(--no-deps)
  "$environment/bin/pip" install --quiet "${only[@]}" "$wanted"
fi
# To link with a LibTorch with CUDA, CMake wants the toolkit: nvcc, which torch does not ask for, and libraries by the names
# that linkers look for. Packages before CUDA 13 have no toolkit that pip lays together; then the system's is needed.
toolkit=$("$environment/bin/python" -c 'import importlib.metadata, importlib.util, pathlib
try:
    release = importlib.metadata.version("cuda-toolkit")
except importlib.metadata.PackageNotFoundError:
    raise SystemExit
packages = importlib.util.find_spec("nvidia")
root = pathlib.Path(packages.submodule_search_locations[0] if packages else "") / ("cu" + release.split(".")[0])
if (root / "lib").is_dir():
    print(release, root)')
if [ -n "$toolkit" ]; then
  if [ ! -x "${toolkit#* }/bin/nvcc" ] || [ ! -e "${toolkit#* }/include/cccl" ]; then
    echo "setup: installing with pip what linking with CUDA ${toolkit%% *} needs"
    "$environment/bin/pip" install --quiet "cuda-toolkit[nvcc,crt,nvvm,cccl]==${toolkit%% *}"
  fi
  [ -e "${toolkit#* }/lib64" ] || ln -s lib "${toolkit#* }/lib64"
  find "${toolkit#* }/lib" -name 'lib*.so.*' | while read -r library; do
    plain=${library%%.so.*}.so
    [ -e "$plain" ] || ln -s "${library##*/}" "$plain"
  done
fi
libtorch=$("$environment/bin/python" -c 'import importlib.util; print(importlib.util.find_spec("torch").submodule_search_locations[0])')
echo "setup: LibTorch lies in $libtorch; build with scripts/build.sh --libtorch DIR, test with scripts/test.sh --libtorch DIR:"
echo "$libtorch"
