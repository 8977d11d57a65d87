//===- Declarations.h - Trees and fields of a session -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Holds the declarations, creates the runtime's trees and fields from them, and
// adds to each kernel's module the declarations that it uses.
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

/// Used by one thread at a time. Failures go to the log.
class Declarations {
public:
  Declarations(MLIRContext *context, runtime::Runtime &runtime,
               FailureLog &failures);

  /// Adds a tree, by the text of its layout or by its op.
  LogicalResult addTree(StringRef name, StringRef layout);
  LogicalResult addTree(TreeOp tree);
  /// Removes the tree and its fields, and frees the memory.
  LogicalResult destroyTree(StringRef name);

  /// Adds a field, by the text of a `tai.field` op or by the op. The adjoint
  /// that the op names may be added later.
  FailureOr<runtime::FieldPtr> addField(StringRef declaration);
  FailureOr<runtime::FieldPtr> addField(FieldOp field);

  /// Adds the declarations that `module` refers to and does not hold.
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
