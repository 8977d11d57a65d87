//===- Interfaces.h - Conversions that dialects define ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Upstream's `ConvertToLLVMPatternInterface`, through which a dialect says how
// its ops become ops of the LLVM dialect.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CONVERSION_TOLLVM_INTERFACES_H
#define TAI_CONVERSION_TOLLVM_INTERFACES_H

#include "mlir/IR/Operation.h"
#include "llvm/ADT/DenseMap.h"
#include "llvm/ADT/DenseSet.h"

namespace mlir {
class ConversionTarget;
class DialectRegistry;
class LLVMTypeConverter;
class RewritePatternSet;
} // namespace mlir

namespace mlir::tai {

/// Registers the interface for the dialects of tai. `tai.stop_gradient` and
/// `tai.derive_as` are converted; other ops are refused with the name of the
/// pass to run before.
void registerToLLVMInterfaces(DialectRegistry &registry);

/// Tells which ops of dialects that tai does not lower have a conversion by the
/// interface.
class OwnConversions {
public:
  bool covers(Operation *op);

private:
  llvm::DenseMap<Dialect *, llvm::DenseSet<OperationName>> converted;
};

/// Adds the conversions of the dialects in `roots` that tai does not lower
/// itself and that have the interface.
void populateOwnConversions(ArrayRef<Operation *> roots,
                            ConversionTarget &target,
                            LLVMTypeConverter &converter,
                            RewritePatternSet &patterns);

} // namespace mlir::tai

#endif // TAI_CONVERSION_TOLLVM_INTERFACES_H
