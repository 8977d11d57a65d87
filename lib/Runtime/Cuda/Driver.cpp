//===- Driver.cpp - The functions of the CUDA driver ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Driver.h"
#include <cstdlib>
#include <dlfcn.h>
#include <map>
#include <memory>
#include <mutex>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::cuda;

/// The oldest driver that accepts the generated PTX: the driver of CUDA 12.0.
static constexpr int oldestVersion = 12000;

std::string Driver::describe(Result result) const {
  const char *name = nullptr, *text = nullptr;
  if (getErrorName(result, &name) != kSuccess || !name)
    return "error " + std::to_string(result);
  if (getErrorString(result, &text) != kSuccess || !text)
    return name;
  return std::string(name) + ": " + text;
}

static std::string versionText(int version) {
  return std::to_string(version / 1000) + "." +
         std::to_string(version % 1000 / 10);
}

static Status load(const std::string &file, Driver &driver) {
  void *library = dlopen(file.c_str(), RTLD_NOW | RTLD_LOCAL);
  if (!library) {
    const char *why = dlerror();
    return Status::failure(StatusCode::Usage,
                           "no CUDA driver: the library '" + file +
                               "' cannot be loaded (" +
                               (why ? why : "unknown error") +
                               "); install the NVIDIA driver, or use the CPU");
  }
  // The version is checked before the functions are looked up, because an old
  // driver lacks some of them.
  auto version =
      reinterpret_cast<Result (*)(int *)>(dlsym(library, "cuDriverGetVersion"));
  int found = 0;
  if (!version || version(&found) != kSuccess)
    return Status::failure(StatusCode::Usage,
                           "the library '" + file + "' is not a CUDA driver");
  if (found < oldestVersion)
    return Status::failure(StatusCode::Usage,
                           "the CUDA driver is too old: it supports CUDA " +
                               versionText(found) + ", and CUDA " +
                               versionText(oldestVersion) +
                               " or newer is needed; install a newer NVIDIA "
                               "driver");
#define TAI_CUDA_LOAD(name, symbol, parameters)                                \
  driver.name =                                                                \
      reinterpret_cast<Result(*) parameters>(dlsym(library, symbol));          \
  if (!driver.name)                                                            \
    return Status::failure(StatusCode::Usage, "the CUDA driver '" + file +     \
                                                  "' has no function '" symbol \
                                                  "'");
  TAI_CUDA_FUNCTIONS(TAI_CUDA_LOAD)
#undef TAI_CUDA_LOAD
  return Status::success();
}

Status Driver::get(const Driver *&driver) {
  // The driver's library stays loaded until the process ends, since it cannot
  // be initialised twice.
  static std::mutex mutex;
  static auto &drivers = *new std::map<std::string, std::unique_ptr<Driver>>;
  std::lock_guard<std::mutex> lock(mutex);
  const char *given = std::getenv("TAI_CUDA_DRIVER");
  std::string file = given && *given ? given : "libcuda.so.1";
  std::unique_ptr<Driver> &known = drivers[file];
  if (!known) {
    auto loaded = std::make_unique<Driver>();
    Status status = load(file, *loaded);
    if (!status)
      return status;
    known = std::move(loaded);
  }
  driver = known.get();
  return Status::success();
}
