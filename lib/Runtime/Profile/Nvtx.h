//===- Nvtx.h - Names for tools of NVIDIA -----------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Ranges of NVTX, which tools such as Nsight Systems show with the work that
// was queued in them. A tool gives itself away by the environment variable
// NVTX_INJECTION64_PATH, the name of a library that takes what is said here; or
// the library libnvToolsExt.so.1 of an older CUDA is there and finds it.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_PROFILE_NVTX_H
#define TAI_LIB_RUNTIME_PROFILE_NVTX_H

namespace mlir::tai::runtime {

class Nvtx {
public:
  /// Null where nobody listens. What has been loaded stays loaded.
  static const Nvtx *get();

  void push(const char *name) const { (void)pushRange(name); }
  void pop() const { (void)popRange(); }

  /// A range while it lives; without NVTX, nothing.
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

#endif // TAI_LIB_RUNTIME_PROFILE_NVTX_H
