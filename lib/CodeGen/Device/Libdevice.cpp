//===- Libdevice.cpp - CUDA's math library --------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// libdevice.10.bc comes with the CUDA toolkit, with Python packages of NVIDIA's
// compiler, and with the portable bundle, where it lies next to libtai.
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Device/Libdevice.h"
#include "llvm/ADT/SmallString.h"
#include "llvm/ADT/SmallVector.h"
#include "llvm/ADT/StringExtras.h"
#include "llvm/Support/FileSystem.h"
#include "llvm/Support/MemoryBuffer.h"
#include "llvm/Support/Path.h"
#include "llvm/Support/Process.h"
#include <dlfcn.h>
#include <mutex>

using namespace llvm;
using namespace mlir::tai;

static constexpr StringLiteral fileName = "libdevice.10.bc";

namespace {
/// The paths at which libdevice is searched, without duplicates.
class Places {
public:
  template <typename... Parts>
  void add(StringRef folder, const Parts &...parts) {
    if (folder.empty())
      return;
    SmallString<128> path(folder);
    (sys::path::append(path, parts), ...);
    sys::path::append(path, fileName);
    if (!is_contained(paths, StringRef(path)))
      paths.push_back(path.str().str());
  }
  void addToolkit(StringRef root) { add(root, "nvvm", "libdevice"); }
  /// Adds the folders of libdevice in packages of NVIDIA's compiler that are
  /// installed in a Python package folder.
  void addPackages(StringRef folder) {
    for (const char *package : {"cuda_nvcc", "cu13"})
      add(folder, "nvidia", package, "nvvm", "libdevice");
  }

  std::vector<std::string> paths;
};
} // namespace

static std::vector<std::string> getPlaces() {
  Places places;
  // If the environment variable TAI_LIBDEVICE names the file, no other place is
  // searched.
  if (std::optional<std::string> path = sys::Process::GetEnv("TAI_LIBDEVICE"))
    return {*path};
  for (const char *name : {"CUDA_HOME", "CUDA_PATH", "CUDA_ROOT"})
    if (std::optional<std::string> root = sys::Process::GetEnv(name))
      places.addToolkit(*root);
  Dl_info info;
  if (dladdr(reinterpret_cast<void *>(&getLibdevice), &info) && info.dli_fname)
    places.add(sys::path::parent_path(info.dli_fname));
  places.addToolkit("/usr/local/cuda");
  places.addToolkit("/opt/cuda");
  places.add("/usr/lib/nvidia-cuda-toolkit/libdevice");
  if (std::optional<std::string> root = sys::Process::GetEnv("VIRTUAL_ENV")) {
    SmallString<128> folder(*root);
    sys::path::append(folder, "lib");
    std::error_code error;
    for (sys::fs::directory_iterator at(folder, error), end;
         at != end && !error; at.increment(error)) {
      SmallString<128> packages(at->path());
      sys::path::append(packages, "site-packages");
      if (sys::path::filename(at->path()).starts_with("python"))
        places.addPackages(packages);
    }
  }
  return std::move(places.paths);
}

std::optional<MemoryBufferRef> mlir::tai::getLibdevice(std::string &searched) {
  static std::mutex mutex;
  static std::unique_ptr<MemoryBuffer> library;
  std::lock_guard<std::mutex> lock(mutex);
  if (!library) {
    std::vector<std::string> places = getPlaces();
    for (const std::string &path : places) {
      auto file = MemoryBuffer::getFile(path, /*IsText=*/false,
                                        /*RequiresNullTerminator=*/false);
      if (!file)
        continue;
      library = std::move(*file);
      break;
    }
    if (!library) {
      searched = join(places, ", ");
      return std::nullopt;
    }
  }
  return library->getMemBufferRef();
}
