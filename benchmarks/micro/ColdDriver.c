//===- ColdDriver.c - A CUDA driver that costs nothing but the caches -----===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The driver for tests (test/unit/FakeCuda), which also measures the time that
// launches spend in it, so that the rest is the caller's cost of a launch. A
// real driver reads memory and code of its own, which evicts the caller's data
// from the caches: tai_cold_bytes is the amount of both that a launch reads.
// See launch.py.
//
//===----------------------------------------------------------------------===//

#define cuLaunchKernel cuLaunchKernelOfTests
#include "../../test/unit/FakeCuda/FakeCuda.c"
#undef cuLaunchKernel

#include <sys/mman.h>
#include <time.h>

/// Bytes of code, and as many of data, that each launch goes through.
long long tai_cold_bytes;
/// Time in launches, and how many there were.
long long tai_cold_ns, tai_cold_launches;

enum { Most = 1 << 20, Line = 64 };
static char data[Most];

/// Runs the last `bytes` of code that is nothing but a jump from each line to
/// the next.
NOT_COUNTED static void runCode(long long bytes) {
#ifdef __x86_64__
  static char *code;
  if (!code) {
    code = mmap(NULL, Most, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS,
                -1, 0);
    if (code == MAP_FAILED)
      abort();
    for (int at = 0; at < Most; at += Line) {
      code[at] = (char)0xeb; // jmp
      code[at + 1] = Line - 2;
    }
    code[Most - Line] = (char)0xc3; // ret
    if (mprotect(code, Most, PROT_READ | PROT_EXEC))
      abort();
  }
  union {
    char *address;
    void (*call)(void);
  } start = {code + Most - bytes};
  start.call();
#else
  (void)bytes;
#endif
}

NOT_COUNTED static long long clockNs(void) {
  struct timespec time;
  clock_gettime(CLOCK_MONOTONIC, &time);
  return (long long)time.tv_sec * 1000000000 + time.tv_nsec;
}

Result cuLaunchKernel(void *function, unsigned blocks, unsigned by, unsigned bz,
                      unsigned threads, unsigned ty, unsigned tz,
                      unsigned shared, void *on, void **parameters,
                      void **extra) {
  long long start = clockNs();
  (void)function, (void)blocks, (void)by, (void)bz, (void)threads, (void)ty;
  (void)tz, (void)shared, (void)on, (void)parameters, (void)extra;
  if (tai_cold_bytes) {
    long long bytes = tai_cold_bytes < Most ? tai_cold_bytes : Most;
    for (long long at = 0; at < bytes; at += Line)
      ++data[at];
    runCode(bytes);
  }
  ++tai_cold_launches;
  tai_cold_ns += clockNs() - start;
  return 0;
}
