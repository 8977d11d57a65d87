//===- Arc4Random.cpp - A function of glibc 2.36 --------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// LLVM's packages call `arc4random` to name temporary files. It is the only
// symbol of glibc 2.36 that they need: with this definition in libtai, the
// library also loads with glibc 2.35, as in Ubuntu 22.04.
//
//===----------------------------------------------------------------------===//

#include <cstdint>
#include <sys/random.h>

extern "C" __attribute__((visibility("hidden"))) uint32_t arc4random() {
  uint32_t value = 0;
  // Once the kernel has collected entropy, getrandom fills a request of up to
  // 256 bytes as a whole; try again until then.
  while (getrandom(&value, sizeof(value), 0) != sizeof(value)) {
  }
  return value;
}
