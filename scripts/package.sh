#!/usr/bin/env bash
# Makes a package of the program, below build/packages/.
#   scripts/package.sh                    a Debian package, for Debian 12: apt installs it with LibTorch and all else
#   scripts/package.sh --libtorch DIR     an archive for any x86-64 Linux whose C library is no older than this one's: the program,
#                                         its libraries other than LibTorch with their notices, the small model, README.md and
#                                         the pages that it links. It is named after the LibTorch
#                                         that it was built with, and runs with that version
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/build_folder.sh
if [ ${#rest[@]} -ne 0 ]; then
  echo "package: expected nothing or --libtorch DIR, found '${rest[*]}'." >&2
  exit 2
fi
if [ -n "$quick" ]; then
  echo "package: expected a build for use, found --quick, which optimises nothing; leave it out." >&2
  exit 2
fi
scripts/setup.sh --packaging
cmake --preset release -B "$build_folder" "${configuration[@]}" >/dev/null
cmake --build "$build_folder" --target gld
packages=$PWD/build/packages
mkdir -p "$packages"

if [ ${#configuration[@]} -eq 0 ]; then
  rm -f "$packages"/gld_*.deb
  cpack --config "$build_folder/CPackConfig.cmake" -B "$packages" | grep -v '^CPack:' || true
  ls "$packages"/*.deb
  exit 0
fi

release=$("$build_folder/cli/gld" --version | grep -oE '[0-9]+(\.[0-9]+)+' | head -1)
name=gld-$release-libtorch-$version-x86_64
root=$packages/$name
rm -rf "$root"
cmake --install "$build_folder" --prefix "$root" --strip >/dev/null
mkdir -p "$root/lib/gld"
mv "$root/bin/gld" "$root/lib/gld/gld"
mv "$root"/share/doc/gld/* "$root/"
rm -r "$root/share/doc"
ln -sfn share/gld/configs "$root/configs"

# notice_of FILE: the copyright file of the Debian package that FILE is of, which may list it below /lib instead of /usr/lib.
mkdir -p "$root/share/gld"
mv "$root/notices" "$root/share/gld/notices"
notice_of() {
  local package
  package=$( (dpkg-query -S "$1" 2>/dev/null || dpkg-query -S "${1#/usr}") | head -1 | cut -d: -f1)
  install -m 644 "/usr/share/doc/$package/copyright" "$root/share/gld/notices/$package"
}

# All libraries but LibTorch with what lies beside it, and the C library with what belongs to it.
ldd "$build_folder/cli/gld" | sed -nE 's/^\t([^ ]+) => (\/.*) \(0x[0-9a-f]+\)$/\1\t\2/p' | while IFS=$'\t' read -r soname path; do
  case $path in "$(realpath "${libtorch:?}")"/*) continue ;; esac
  case $soname in
    libc.so.* | libm.so.* | libdl.so.* | libpthread.so.* | librt.so.* | libresolv.so.* | libnsl.so.* | libutil.so.*) continue ;;
    # OpenCV alone asks for them, and for nothing that takes time: the reference ones are a quarter of OpenBLAS.
    libopenblas.so.*) continue ;;
    libblas.so.3) path=/usr/lib/x86_64-linux-gnu/blas/$soname ;;
    liblapack.so.3) path=/usr/lib/x86_64-linux-gnu/lapack/$soname ;;
  esac
  install -m 644 "$(realpath "$path")" "$root/lib/gld/$soname"
  notice_of "$(realpath "$path")"
  strip --strip-unneeded "$root/lib/gld/$soname"
done
# The old kind of run path holds for libraries of libraries too.
patchelf --force-rpath --set-rpath '$ORIGIN:$ORIGIN/../../libtorch/lib' "$root/lib/gld/gld"

# A font, for what is written on pictures where the machine has none.
mkdir -p "$root/share/gld/fonts"
install -m 644 /usr/share/fonts/truetype/dejavu/DejaVuSans.ttf /usr/share/fonts/truetype/dejavu/DejaVuSans-Bold.ttf \
  "$root/share/gld/fonts"
notice_of /usr/share/fonts/truetype/dejavu/DejaVuSans.ttf
cat >"$root/share/gld/fonts.conf" <<'FONTS'
<?xml version="1.0"?>
<!DOCTYPE fontconfig SYSTEM "urn:fontconfig:fonts.dtd">
<fontconfig>
  <dir prefix="relative">fonts</dir>
  <dir>/usr/share/fonts</dir>
  <cachedir prefix="xdg">fontconfig</cachedir>
</fontconfig>
FONTS

cat >"$root/bin/gld" <<'LAUNCHER'
#!/bin/sh
# Starts the program with the LibTorch that the folder or link `libtorch` beside bin/ holds.
here=$(dirname "$(dirname "$(readlink -f "$0")")")
built_with=@VERSION@
if [ ! -e "$here/libtorch/lib/libtorch_cpu.so" ]; then
  echo "error: $here/libtorch: expected LibTorch $built_with, found none; make a link of that name to an unpacked LibTorch $built_with, or to the folder torch of PyTorch's package." >&2
  exit 1
fi
found=$(sed -n 's/^set(PACKAGE_VERSION "\(.*\)").*/\1/p' "$here/libtorch/share/cmake/Torch/TorchConfigVersion.cmake" 2>/dev/null)
if [ "$found" != "$built_with" ]; then
  echo "error: $here/libtorch: expected LibTorch $built_with, with which this program was built, found ${found:-one without a version}; link that version, or take the archive that is named after yours." >&2
  exit 1
fi
[ -e /etc/fonts/fonts.conf ] || export FONTCONFIG_FILE="$here/share/gld/fonts.conf"
exec "$here/lib/gld/gld" "$@"
LAUNCHER
sed -i "s/@VERSION@/$version/" "$root/bin/gld"
chmod 755 "$root/bin/gld"

tar -C "$packages" -cJf "$packages/$name.tar.xz" "$name"
rm -rf "$root"
ls -l "$packages/$name.tar.xz"
echo "$packages/$name.tar.xz"
