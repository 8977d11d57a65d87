#!/usr/bin/env bash
# Compiles the CUDA floors with nvcc into a folder: build.sh [folder] [architecture]
# HOST_CHECK=1 compiles those that have a check on the CPU with a C++ compiler
# instead, which needs no CUDA.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
out=${1:-build/bench/floor-cuda}
arch=${2:-sm_90}
mkdir -p "$out"
failed=0
pids=()
if [ -n "${HOST_CHECK:-}" ]; then
  for name in Mpm Smoke Robot; do
    "${CXX:-c++}" -x c++ -std=c++17 -O2 -Wall -Wextra -Werror -DHOST_CHECK \
      "$here/$name.cu" -o "$out/${name,,}-check" &
    pids+=($!)
  done
else
  for name in Mpm Smoke Robot Bandwidth Sparse; do
    nvcc -arch="$arch" -O3 -std=c++17 -Xcompiler -Wall,-Wextra \
      "$here/$name.cu" -o "$out/${name,,}" &
    pids+=($!)
  done
fi
for pid in "${pids[@]}"; do
  wait "$pid" || failed=1
done
exit $failed
