//===- Module.cpp - The extension module tai._core ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Core.h"
#include "Mesh.h"

PYBIND11_MODULE(_core, module) {
  module.doc() = "binding of tai's C API; use the package `tai` instead";
  module.def("version", &taiVersion);
  module.def("llvm_version", &taiLLVMVersion);
  taipy::bindSafepoints();
  taipy::bindRuntime(module);
  taipy::bindBuilder(module);
  taipy::bindWithBlock(module);
  taipy::bindLauncher(module);
  taipy::bindOperatorCalls(module);
  taipy::bindInterop(module);
  taipy::bindXlaCalls(module);
  taipy::bindMesh(module);
}
