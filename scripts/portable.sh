#!/usr/bin/env bash
# Makes dist/tai-portable-<version>-linux-x86_64.tar.xz: one libtai with LLVM and
# MLIR inside, the tools, the C headers and the Python package. It runs where no
# LLVM is installed. Usage: portable.sh [jobs]
set -euo pipefail
cd "$(dirname "$0")/.."
jobs=${1:-$(nproc)}
limit=$((40 * 1024 * 1024))

test -f build-portable/build.ninja || cmake --preset portable
ninja -C build-portable -j"$jobs"

version=$(sed -n 's/^__version__ = "\(.*\)"/\1/p' python/tai/_version.py)
name=tai-portable-$version-linux-$(uname -m)
root=dist/$name
rm -rf "$root" "$root.tar.xz"
cmake --install build-portable --prefix "$root" --strip >/dev/null
cp LICENSE "$root/"
cp docs/start/portable.md "$root/README.md"

# Nothing else may be asked of the machine.
base='^(linux-vdso|lib(c|m|dl|rt|pthread|stdc\+\+|gcc_s)|/lib64/ld-linux.*)\.so'
for file in "$root"/lib/*.so* "$root"/bin/* "$root"/python/tai/_core*.so; do
  [ -e "$file" ] || continue
  foreign=$(ldd "$file" | awk '{ print $1, $3 }' | grep -vE "$base" |
    awk -v root="$(pwd)/$root" 'index($2, root) != 1' || true)
  if [ -n "$foreign" ]; then
    printf 'portable: %s needs more than the bundle and the base system:\n%s\n' "$file" "$foreign" >&2
    exit 1
  fi
done
"$root/bin/tai-opt" --version >/dev/null
# Projects in C build and run with it; projects in C++ are told what they need.
python3 scripts/check_package.py "$root"

# The same bytes again, whoever packs it: times are those of the commit.
epoch=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct 2>/dev/null || echo 0)}
tar -C dist --sort=name --format=gnu --owner=0 --group=0 --numeric-owner --mode=u+w,go-w \
  --mtime="@$epoch" -c "$name" | xz -9 -T1 >"$root.tar.xz"
(cd dist && sha256sum "$name.tar.xz" >"$name.tar.xz.sha256")
size=$(stat -c %s "$root.tar.xz")
printf 'portable: %s, %d.%d MB\n' "$root.tar.xz" $((size / 1000000)) $((size / 100000 % 10))
if [ "$size" -gt "$limit" ]; then
  echo "portable: error: larger than $((limit / 1024 / 1024)) MB" >&2
  exit 1
fi
