//===- Explain.h - Explanations of gradients --------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_REPORTS_EXPLAIN_H
#define TAI_EXECUTIONENGINE_REPORTS_EXPLAIN_H

#include "mlir/IR/BuiltinOps.h"
#include "mlir/IR/Remarks.h"

namespace mlir::tai {

/// A copy of a compiler remark, which outlives the pass that emitted the
/// remark.
struct KeptRemark {
  std::string category, name;
  Location location;
  SmallVector<std::pair<std::string, std::string>> args;

  StringRef get(StringRef key) const;
};

/// Keeps the remarks that passes emit on the current thread during the lifetime
/// of the scope. `prepare` must have been called for the context.
class RemarkScope {
public:
  RemarkScope();
  ~RemarkScope();

  /// Makes remarks of the context reach the scopes. Must be called once, before
  /// several threads use the context.
  static void prepare(MLIRContext *context);

  ArrayRef<KeptRemark> getRemarks() const { return remarks; }

private:
  friend class RemarkKeeper;
  SmallVector<KeptRemark> remarks;
  RemarkScope *outer;
};

/// Returns a text on how kernel `name` runs its loops and does its updates, and
/// on how its gradient handles loops and branches and which memory it accesses.
/// `module` holds the adjoint; the remarks are those of differentiation, of the
/// kernel's lowering, and of the lowering of its gradient.
std::string explainKernel(ModuleOp module, StringRef name, bool onDevice,
                          ArrayRef<KeptRemark> remarks,
                          ArrayRef<KeptRemark> lowering,
                          ArrayRef<KeptRemark> gradient);

/// A line for each field whose additions are gathered, or are not, and why.
/// `where` is the function, such as "kernel".
std::string explainGathers(StringRef where, ArrayRef<KeptRemark> remarks);

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_REPORTS_EXPLAIN_H
