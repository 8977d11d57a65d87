//===- FakeNvtx.c - A tool that listens to ranges, for tests --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Writes "+name" and "-" for the ranges that begin and end. It can be injected
// as tools are, and has the functions of libnvToolsExt.so.1 under its name.
// Text goes to the file that the environment variable TAI_FAKE_NVTX_LOG names,
// and to where `tai_fake_nvtx_log` points.
//
//===----------------------------------------------------------------------===//

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

char tai_fake_nvtx_log[1 << 16];

static void note(const char *sign, const char *name) {
  size_t used = strlen(tai_fake_nvtx_log);
  snprintf(tai_fake_nvtx_log + used, sizeof(tai_fake_nvtx_log) - used, "%s%s\n",
           sign, name);
  const char *path = getenv("TAI_FAKE_NVTX_LOG");
  FILE *file = path ? fopen(path, "a") : NULL;
  if (!file)
    return;
  fprintf(file, "%s%s\n", sign, name);
  fclose(file);
}

int nvtxRangePushA(const char *name) {
  note("+", name);
  return 0;
}
int nvtxRangePop(void) {
  note("-", "");
  return 0;
}

typedef void (*Function)(void);
typedef struct {
  size_t bytes;
  int (*find)(int module, Function ***table, unsigned *size);
} Callbacks;

int InitializeInjectionNvtx2(const void *(*find_table)(uint32_t)) {
  const Callbacks *callbacks = find_table(1);
  if (!callbacks || callbacks->bytes < sizeof(Callbacks))
    return 0;
  // As tools do, which want all modules to be there.
  static const unsigned sizes[] = {0, 16, 9, 15, 7, 16, 7};
  for (int module = 1; module <= 6; ++module) {
    Function **table = NULL;
    unsigned size = 0;
    if (!callbacks->find(module, &table, &size) || size < sizes[module])
      return 0;
    for (unsigned i = 1; i < size; ++i)
      if (!table[i])
        return 0;
    if (module == 1) {
      *table[9] = (Function)nvtxRangePushA;
      *table[11] = (Function)nvtxRangePop;
    }
  }
  return 1;
}
