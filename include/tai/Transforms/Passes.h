//===- Passes.h - Passes on kernels -----------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_PASSES_H
#define TAI_TRANSFORMS_PASSES_H

#include "mlir/Pass/Pass.h"
#include "tai/Support/BoundsMode.h"
#include "tai/Support/SkipOption.h"
#include <memory>

namespace mlir {
class ModuleOp;
namespace arith {
class ArithDialect;
} // namespace arith
namespace cf {
class ControlFlowDialect;
} // namespace cf
namespace func {
class FuncDialect;
} // namespace func
namespace gpu {
class GPUDialect;
} // namespace gpu
namespace NVVM {
class NVVMDialect;
} // namespace NVVM
namespace LLVM {
class LLVMDialect;
} // namespace LLVM
namespace math {
class MathDialect;
} // namespace math
namespace memref {
class MemRefDialect;
} // namespace memref
namespace scf {
class SCFDialect;
} // namespace scf
namespace vector {
class VectorDialect;
} // namespace vector
} // namespace mlir

namespace mlir::tai {

#define GEN_PASS_DECL
#define GEN_PASS_REGISTRATION
#include "tai/Transforms/Passes.h.inc"

} // namespace mlir::tai

#endif // TAI_TRANSFORMS_PASSES_H
