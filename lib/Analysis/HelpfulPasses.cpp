//===- HelpfulPasses.cpp - Upstream passes in front of ours ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The one table of ops that have no derivative of their own and of the passes
// that lower them. Every refusal asks it.
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/HelpfulPasses.h"
#include "mlir/IR/Operation.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
struct HelpfulPass {
  /// An op, or a dialect without a dot.
  StringLiteral name, pass;
};
} // namespace

// By name: most of these dialects need not be there. Ops come before their
// dialects.
static constexpr HelpfulPass kTable[] = {
    {"func.call", "inline"},
    {"func.return", "buffer-results-to-out-params"},
    {"memref.realloc", "expand-realloc"},
    {"memref.cast", "fold-memref-alias-ops"},
    {"memref.collapse_shape", "fold-memref-alias-ops"},
    {"memref.expand_shape", "fold-memref-alias-ops"},
    {"memref.reinterpret_cast", "fold-memref-alias-ops"},
    {"memref.subview", "fold-memref-alias-ops"},
    {"memref.transpose", "fold-memref-alias-ops"},
    {"memref.generic_atomic_rmw", "tai-prepare-foreign"},
    {"memref.atomic_rmw", "tai-prepare-foreign"},
    {"memref.copy", "tai-prepare-foreign"},
    {"arith.select", "tai-prepare-foreign"},
    {"scf.execute_region", "lift-cf-to-scf"},
    {"scf.forall", "scf-forall-to-parallel"},
    {"scf.index_switch", "tai-prepare-foreign"},
    {"scf.parallel", "tai-prepare-foreign"},
    {"affine", "lower-affine"},
    {"bufferization", "one-shot-bufferize"},
    {"cf", "lift-cf-to-scf"},
    {"complex", "convert-complex-to-standard"},
    {"linalg", "convert-linalg-to-loops"},
    {"shape", "convert-shape-to-std"},
    {"shard", "shard-partition"},
    {"sparse_tensor", "sparsification-and-bufferization"},
    {"tensor", "one-shot-bufferize"},
    {"tosa", "tosa-to-linalg"},
    {"vector", "tai-prepare-foreign"},
};

StringRef mlir::tai::getHelpfulPass(Operation *op) {
  StringRef name = op->getName().getStringRef();
  StringRef dialect = name.split('.').first;
  for (const HelpfulPass &entry : kTable)
    if (entry.name == name || entry.name == dialect)
      return entry.pass;
  return {};
}

bool mlir::tai::attachHelpfulPass(InFlightDiagnostic &diag, Operation *op) {
  StringRef pass = getHelpfulPass(op);
  if (pass.empty())
    return false;
  diag.attachNote() << "run '--" << pass << "' before";
  return true;
}
