#!/usr/bin/env bash
# Prepares a bare Debian 12 machine: system packages from apt, then .venv.
# Does nothing, in a fraction of a second, when everything is in place.
set -euo pipefail
cd "$(dirname "$0")/.."

packages=(
  # LLVM and MLIR, and the libraries that find_package(MLIR) asks for
  llvm-22-dev libmlir-22-dev mlir-22-tools llvm-22-tools clang-22 lld-22
  zlib1g-dev libzstd-dev libcurl4-openssl-dev libedit-dev libxml2-dev
  # the build, the tests; oneTBB for the benchmarks' hand-written programs; SLEEF, the vector
  # functions of loops
  libtbb-dev libsleef3 ninja-build cmake ccache libgtest-dev clang-format-22 pkgconf
  # the run time of sanitizers, for PRESET=asan and ti.init(sanitize="address")
  libclang-rt-22-dev
  # a display in memory, and OpenGL on the CPU, for the tests of windows
  xvfb libgl1 libegl1 libgl1-mesa-dri
  python3 python3-venv python3-dev xz-utils ca-certificates
)

say() { printf 'setup: %s\n' "$*" >&2; }
die() { say "error: $*"; exit 1; }

as_root() {
  if [ "$(id -u)" = 0 ]; then "$@"
  elif command -v sudo >/dev/null; then sudo "$@"
  else die "'$*' needs root, and sudo is not installed"
  fi
}

install_packages() {
  local name missing=()
  if ! command -v dpkg-query >/dev/null; then
    command -v clang++-22 >/dev/null && return   # not Debian: trust what is there
    die "this machine has no apt: install LLVM/MLIR 22, oneTBB, SLEEF, CMake 3.25, Ninja and GoogleTest"
  fi
  local installed
  installed=$(dpkg-query -W -f='${db:Status-Abbrev} ${Package}\n' "${packages[@]}" 2>/dev/null || true)
  for name in "${packages[@]}"; do
    grep -qx "ii  $name" <<<"$installed" || missing+=("$name")
  done
  [ ${#missing[@]} -gt 0 ] || return 0
  say "installing ${missing[*]}"
  as_root apt-get update -q || say "apt-get update failed, trying with the lists that are here"
  as_root env DEBIAN_FRONTEND=noninteractive \
    apt-get install -y -q --no-install-recommends "${missing[@]}"
}

# The first Python 3.11 or newer that can make a virtual environment.
find_python() {
  local candidate
  for candidate in "${PYTHON:-python3}" python3.13 python3.12 python3.11 /usr/bin/python3; do
    if "$candidate" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' \
        2>/dev/null; then
      echo "$candidate"
      return
    fi
  done
  die "Python 3.11 or newer with the venv module is needed"
}

# A change of the pins, of this script or of the checkout's path makes a new one.
make_venv() {
  local stamp
  stamp="$(pwd) $(cat scripts/requirements.txt scripts/setup.sh | sha256sum)"
  [ "$(cat .venv/stamp 2>/dev/null)" = "$stamp" ] && [ -x .venv/bin/python ] && return
  say "making .venv"
  local python
  python=$(find_python)
  rm -rf .venv
  "$python" -m venv .venv
  .venv/bin/python -m pip install -q --disable-pip-version-check --no-deps \
    -r scripts/requirements.txt
  # The package is used from the checkout, as an editable install would do.
  pwd | sed 's|$|/python|' >"$(.venv/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/tai.pth"
  printf '%s' "$stamp" >.venv/stamp
}

install_packages
make_venv
