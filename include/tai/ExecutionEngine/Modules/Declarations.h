//===- Declarations.h - Trees and fields of a session -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Holds the tree and field declarations of a session, creates the runtime's
// trees and fields from them, and adds to each kernel's module the declarations
// that the kernel uses.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_MODULES_DECLARATIONS_H
#define TAI_EXECUTIONENGINE_MODULES_DECLARATIONS_H

#include "mlir/IR/OwningOpRef.h"
#include "mlir/IR/SymbolTable.h"
#include "tai/Dialect/Tai/IR/TreeLayout.h"
#include "tai/ExecutionEngine/Reports/FailureLog.h"
#include "tai/Runtime/Launch/Runtime.h"

namespace mlir::tai {

/// The declarations of one session, used by one thread at a time. Failures go
/// to the session's log.
class Declarations {
public:
  Declarations(MLIRContext *context, runtime::Runtime &runtime,
               FailureLog &failures);

  /// Declares a tree, from the text of its layout or from its op.
  LogicalResult addTree(StringRef name, StringRef layout);
  LogicalResult addTree(TreeOp tree);
  /// Removes a tree with its fields, and frees their memory.
  LogicalResult destroyTree(StringRef name);

  /// Declares a field, from the text of a `tai.field` op or from the op. The
  /// adjoint field that the op names may be declared later.
  FailureOr<runtime::FieldPtr> addField(StringRef declaration);
  FailureOr<runtime::FieldPtr> addField(FieldOp field);

  /// Adds to `module` the tree and field declarations that it refers to and
  /// does not hold.
  LogicalResult declareUsed(ModuleOp module);

  int64_t size() const;

private:
  MLIRContext *context;
  runtime::Runtime &rt;
  FailureLog &failures;
  OwningOpRef<ModuleOp> declared;
  SymbolTable symbols;
  DataLayout dataLayout;
  /// The layout of each tree, by name.
  llvm::StringMap<std::unique_ptr<TreeLayout>> layouts;
};

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_MODULES_DECLARATIONS_H
