//===- Explain.h - What the compiler did, in words --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_EXPLAIN_H
#define TAI_EXECUTIONENGINE_EXPLAIN_H

#include "mlir/IR/BuiltinOps.h"
#include "mlir/IR/Remarks.h"

namespace mlir::tai {

/// A remark of ours that outlives the pass.
struct KeptRemark {
  std::string category, name;
  Location location;
  SmallVector<std::pair<std::string, std::string>> args;

  StringRef get(StringRef key) const;
};

/// While it lives, keeps the remarks that passes make on this thread. Works in
/// contexts that were prepared only.
class RemarkScope {
public:
  RemarkScope();
  ~RemarkScope();

  /// To be called once, before several threads use the context.
  static void prepare(MLIRContext *context);

  ArrayRef<KeptRemark> getRemarks() const { return remarks; }

private:
  friend class RemarkKeeper;
  SmallVector<KeptRemark> remarks;
  RemarkScope *outer;
};

/// What the gradient of kernel `name` does about its loops and branches, and
/// what memory it touches: lines of text. `module` holds the adjoint.
std::string explainAdjoint(ModuleOp module, StringRef name,
                           ArrayRef<KeptRemark> remarks);

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_EXPLAIN_H
