#!/usr/bin/env bash
# Makes the Debian package (scripts/package.sh), installs it with apt into a bare Debian 12 that is made for it, and
# samples novel views of a drawn room there. With --libtorch DIR: the archive, unpacked in a bare Debian RELEASE (default
# trixie, whose C library is newer), beside that LibTorch.
# Needs root, debootstrap, and the package mirror of /etc/apt; takes minutes and 2 GB, which are given back.
#   scripts/test_package.sh [--libtorch DIR] [RELEASE]
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/build_folder.sh
release=${rest[0]:-}
if [ ${#rest[@]} -gt 1 ]; then
  echo "test_package: expected --libtorch DIR and a release of Debian at most, found '${rest[*]}'." >&2
  exit 2
fi
if [ "$(id -u)" -ne 0 ] || ! command -v debootstrap >/dev/null; then
  echo "test_package: expected root and debootstrap, found $(id -un); run as root after apt install debootstrap." >&2
  exit 2
fi
mirror=$({ cat /etc/apt/sources.list /etc/apt/sources.list.d/*.{list,sources} 2>/dev/null || true; } |
  sed -nE '/^#/d; s/^URIs: *([^ ]+).*/\1/p; s/^deb (\[[^]]*\] )?([^ ]+).*/\2/p' | awk 'NR == 1')

root=$(mktemp -d)
cleanup() {
  umount "$root/proc" 2>/dev/null || true
  umount "$root/dev" 2>/dev/null || true
  rm -rf --one-file-system "$root"
}
trap cleanup EXIT

if [ -z "$libtorch" ]; then release=${release:-bookworm}; else release=${release:-trixie}; fi
# Its last line names the file.
package=$(scripts/package.sh ${libtorch:+--libtorch "$libtorch"} | tee >(cat >&2) | tail -1)
echo "test_package: a bare Debian $release"
debootstrap --variant=minbase "$release" "$root" "$mirror" >"$root.log" 2>&1 || { tail -3 "$root.log" >&2; exit 1; }
rm -f "$root.log"
chmod 755 "$root"  # apt leaves its rights behind when it fetches
mount -t proc proc "$root/proc"
mount --bind /dev "$root/dev"
cp /etc/resolv.conf "$root/etc/"
cp "$package" "$root/tmp/"

if [ -z "$libtorch" ]; then
  gld=gld
  chroot "$root" sh -c "apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends /tmp/$(basename "$package") >/dev/null"
else
  # The archive has all libraries but LibTorch and the C library.
  chroot "$root" sh -c 'apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends xz-utils libstdc++6 >/dev/null'
  name=$(basename "$package" .tar.xz)
  gld=/opt/$name/bin/gld
  chroot "$root" tar -C /opt -xJf "/tmp/$(basename "$package")"
  if said=$(chroot "$root" "$gld" --version 2>&1); then
    echo "test_package: expected an error without LibTorch, found '$said'." >&2
    exit 1
  fi
  echo "test_package: without LibTorch: $said"
  if [ ! -s "$root/opt/$name/docs/SAMPLING.md" ] || [ ! -s "$root/opt/$name/share/gld/notices/fonts-dejavu-core" ] ||
    [ ! -s "$root/opt/$name/share/gld/notices/libtinygltf-dev" ]; then
    echo "test_package: expected pages and notices in $name, found $(ls "$root/opt/$name" "$root/opt/$name/share/gld")." >&2
    exit 1
  fi
  mkdir -p "$root/opt/$name/libtorch"
  cp -r "$libtorch/lib" "$root/opt/$name/libtorch/"
  mkdir -p "$root/opt/$name/libtorch/share"
  cp -r "$libtorch/share/cmake" "$root/opt/$name/libtorch/share/"
fi

chroot "$root" sh -ec "
  cd /root
  $gld --version
  $gld synth --seed 910001 --scene-count 1 --frames 4 --width 112 --height 112 --out drawn --quiet
  scene=\$(dirname \$(find drawn -name cameras.json | head -1))
  $gld sample --scene \$scene --sources 0,3 --targets 1 --evaluations 2 --guidance-scale 1 --out sampled --quiet
  test -s sampled/contact_sheet.png
  test -s sampled/points.ply"
echo "test_package: $(basename "$package") ($(du -h "$package" | cut -f1)) runs in a bare Debian $release"
