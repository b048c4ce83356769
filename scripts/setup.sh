#!/usr/bin/env bash
# Installs what building and running needs, with apt, on Debian 12; with --development also what checks the sources. Does
# nothing when nothing is missing.
set -euo pipefail

packages=(
  g++ cmake ninja-build pkg-config
  libtorch-dev libopenblas0-pthread libopencv-dev libeigen3-dev nlohmann-json3-dev libyaml-cpp-dev
  libgtest-dev libgmock-dev libbenchmark-dev libcli11-dev zlib1g-dev libfmt-dev libhdf5-dev libcairo2-dev
  libpango1.0-dev fonts-dejavu-core libpng-dev libjpeg-dev libtiff-dev libwebp-dev libexif-dev
  libssl-dev
)
if [ "${1:-}" = --development ]; then
  packages+=(git clang-format clang-tidy clang-14 libclang-rt-14-dev libomp-dev)
fi

missing=()
for package in "${packages[@]}"; do
  status=$(dpkg-query -W -f '${Status}' "$package" 2>/dev/null || true)
  [ "$status" = "install ok installed" ] || missing+=("$package")
done

if [ ${#missing[@]} -eq 0 ]; then
  echo "setup: everything is installed already."
  exit 0
fi

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
