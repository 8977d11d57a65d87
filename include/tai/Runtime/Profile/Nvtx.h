//===- Nvtx.h - Ranges for NVIDIA's tools -----------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// NVTX ranges, which tools such as Nsight Systems show with the work that was
// queued in them. A tool names its library in the environment variable
// NVTX_INJECTION64_PATH; with older versions of CUDA, libnvToolsExt.so.1 is
// loaded and finds the tool.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_PROFILE_NVTX_H
#define TAI_RUNTIME_PROFILE_NVTX_H

namespace mlir::tai::runtime {

class Nvtx {
public:
  /// Returns the functions of the NVTX library, or null if no profiling tool is
  /// attached. The library stays loaded.
  static const Nvtx *get();

  void push(const char *name) const { (void)pushRange(name); }
  void pop() const { (void)popRange(); }

  /// An NVTX range that lasts as long as the object; does nothing if `nvtx` is
  /// null.
  class Range {
  public:
    Range(const Nvtx *nvtx, const char *name) : nvtx(nvtx) {
      if (nvtx)
        nvtx->push(name);
    }
    ~Range() {
      if (nvtx)
        nvtx->pop();
    }
    Range(const Range &) = delete;
    Range &operator=(const Range &) = delete;

  private:
    const Nvtx *nvtx;
  };

private:
  bool load(const char *injection);

  int (*pushRange)(const char *name) = nullptr;
  int (*popRange)() = nullptr;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_PROFILE_NVTX_H
