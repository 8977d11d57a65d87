//===- UsedDialects.h - Dialects named by passes ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Forward declarations for the generated declarations of passes.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_USEDDIALECTS_H
#define TAI_TRANSFORMS_USEDDIALECTS_H

namespace mlir {
class ModuleOp;
namespace arith {
class ArithDialect;
} // namespace arith
namespace bufferization {
class BufferizationDialect;
} // namespace bufferization
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
namespace tai {
class TaiRTDialect;
} // namespace tai
namespace tensor {
class TensorDialect;
} // namespace tensor
namespace vector {
class VectorDialect;
} // namespace vector
} // namespace mlir

#endif // TAI_TRANSFORMS_USEDDIALECTS_H
