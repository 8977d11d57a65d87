//===- Nvtx.cpp - Ranges for NVIDIA's tools -------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The program's side of the binary interface between programs and tools in NVTX
// 3: the tool's library gets a function that finds tables, and stores the
// addresses of its own functions in these tables, by number.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Profile/Nvtx.h"
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <dlfcn.h>
#include <map>
#include <memory>
#include <mutex>
#include <string>

using namespace mlir::tai::runtime;

namespace {
using AnyFunction = void (*)();

constexpr uint32_t callbackTable = 1, versionTable = 3;
constexpr int coreModule = 1, numModules = 7;
constexpr size_t pushNumber = 9, popNumber = 11;
/// Sizes of the tables of the modules. Entry 0 of a table has no function.
constexpr unsigned moduleSizes[numModules] = {0, 16, 9, 15, 7, 16, 7};
constexpr unsigned mostFunctions = 16;

/// The addresses of functions that profiling tools store in the tables. Tools
/// expect a place for every function of version 3.
AnyFunction functions[numModules][mostFunctions];
AnyFunction *places[numModules][mostFunctions + 1];

int findModule(int module, AnyFunction ***table, unsigned *size) {
  if (module <= 0 || module >= numModules)
    return 0;
  for (unsigned i = 1; i < moduleSizes[module]; ++i)
    places[module][i] = &functions[module][i];
  if (table)
    *table = places[module];
  if (size)
    *size = moduleSizes[module];
  return 1;
}

struct Callbacks {
  size_t bytes = sizeof(Callbacks);
  int (*findModule)(int, AnyFunction ***, unsigned *) = ::findModule;
};
struct Version {
  size_t bytes = sizeof(Version);
  uint32_t version = 3;
  uint32_t reserved = 0;
  void (*setInjection)(uint32_t) = [](uint32_t) {};
};

const void *findTable(uint32_t number) {
  static const Callbacks callbacks;
  static const Version version;
  return number == callbackTable  ? static_cast<const void *>(&callbacks)
         : number == versionTable ? &version
                                  : nullptr;
}
} // namespace

bool Nvtx::load(const char *injection) {
  if (*injection) {
    void *library = dlopen(injection, RTLD_LAZY);
    auto start = reinterpret_cast<int (*)(const void *(*)(uint32_t))>(
        library ? dlsym(library, "InitializeInjectionNvtx2") : nullptr);
    if (!start || !start(findTable))
      return false;
    pushRange = reinterpret_cast<int (*)(const char *)>(
        functions[coreModule][pushNumber]);
    popRange = reinterpret_cast<int (*)()>(functions[coreModule][popNumber]);
  } else if (void *library = dlopen("libnvToolsExt.so.1", RTLD_LAZY)) {
    pushRange = reinterpret_cast<int (*)(const char *)>(
        dlsym(library, "nvtxRangePushA"));
    popRange = reinterpret_cast<int (*)()>(dlsym(library, "nvtxRangePop"));
  }
  return pushRange && popRange;
}

const Nvtx *Nvtx::get() {
  static std::mutex mutex;
  static auto &tools = *new std::map<std::string, std::unique_ptr<Nvtx>>;
  std::lock_guard<std::mutex> lock(mutex);
  const char *given = std::getenv("NVTX_INJECTION64_PATH");
  std::string injection = given ? given : "";
  std::unique_ptr<Nvtx> &known = tools[injection];
  // A tool that could not be loaded is tried again at the next call.
  if (!known) {
    auto tool = std::make_unique<Nvtx>();
    if (tool->load(injection.c_str()))
      known = std::move(tool);
  }
  return known.get();
}
