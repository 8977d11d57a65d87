//===- HelpfulPasses.cpp - Upstream passes in front of ours ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The table of ops that have no derivative rule and of the passes that lower
// these ops. All errors about such ops take their hints from it.
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/HelpfulPasses.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
struct HelpfulPass {
  /// `name`: the name of an op, or of a dialect if it has no dot. `pass`: the
  /// pass that turns the op, or the dialect's ops, into ops with derivatives.
  StringLiteral name, pass;
};
} // namespace

/// The name of the pass that applies all lowerings listed in `kPrepared`.
static constexpr StringLiteral kPrepare = "tai-prepare-foreign";

// Ops and dialects are given by name, because most of the dialects need not be
// loaded. An op comes before its dialect; an op that no pass lowers has an
// empty pass.
static constexpr HelpfulPass kPrepared[] = {
    {"llvm.bitcast", ""},
    {"tensor.bitcast", ""},
    {"vector.bitcast", ""},
    {"func.call", "inline"},
    {"memref.cast", "fold-memref-alias-ops"},
    {"memref.collapse_shape", "fold-memref-alias-ops"},
    {"memref.expand_shape", "fold-memref-alias-ops"},
    {"memref.reinterpret_cast", "fold-memref-alias-ops"},
    {"memref.subview", "fold-memref-alias-ops"},
    {"memref.transpose", "fold-memref-alias-ops"},
    {"memref.assume_alignment", kPrepare},
    {"memref.atomic_rmw", kPrepare},
    {"memref.copy", kPrepare},
    {"memref.generic_atomic_rmw", kPrepare},
    {"arith.select", kPrepare},
    {"gpu.launch", kPrepare},
    {"linalg.softmax", kPrepare},
    {"scf.execute_region", kPrepare},
    {"scf.for", kPrepare},
    {"scf.forall", "scf-forall-to-parallel"},
    {"scf.if", kPrepare},
    {"scf.index_switch", kPrepare},
    {"scf.parallel", kPrepare},
    {"scf.while", kPrepare},
    {"affine", "lower-affine"},
    {"bufferization", "one-shot-bufferize"},
    {"cf", "lift-cf-to-scf"},
    {"complex", kPrepare},
    {"linalg", "convert-linalg-to-loops"},
    {"llvm", kPrepare},
    {"tensor", "one-shot-bufferize"},
    {"vector", kPrepare},
};
static constexpr HelpfulPass kOthers[] = {
    {"func.return", "buffer-results-to-out-params=modify-public-functions"},
    {"memref.realloc", "expand-realloc"},
    {"vector.mask", "lower-vector-mask"},
    {"quant", "lower-quant-ops"},
    {"shape", "convert-shape-to-std"},
    {"shard", "shard-partition"},
    {"sparse_tensor", "sparsification-and-bufferization"},
    {"tosa", "tosa-to-linalg"},
};

static StringRef findPass(ArrayRef<HelpfulPass> table, Operation *op) {
  StringRef name = op->getName().getStringRef();
  StringRef dialect = op->getName().getDialectNamespace();
  for (const HelpfulPass &entry : table)
    if (entry.name == name || entry.name == dialect)
      return entry.pass;
  return {};
}

StringRef mlir::tai::getHelpfulPass(Operation *op) {
  if (StringRef pass = findPass(kOthers, op); !pass.empty())
    return pass;
  auto function = op->getParentOfType<FunctionOpInterface>();
  if (function && function->hasAttr(kPreparedFor))
    return {};
  StringRef pass = findPass(kPrepared, op);
  bool isInKernel = function && isa<KernelOp>(function.getOperation());
  return isInKernel && pass == kPrepare ? StringRef() : pass;
}

bool mlir::tai::attachHelpfulPass(InFlightDiagnostic &diag, Operation *op) {
  StringRef pass = getHelpfulPass(op);
  if (pass.empty())
    return false;
  diag.attachNote() << "run '--" << pass << "' before";
  return true;
}
