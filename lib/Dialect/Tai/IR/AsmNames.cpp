//===- AsmNames.cpp - Names of values in printed IR -----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Names of SSA values in assembly: a loaded value is named after its field, a
// loop variable as an index, and each result of a decomposition by its role.
//
//===----------------------------------------------------------------------===//

#include "OpModels.h"
#include "mlir/IR/OpImplementation.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

static void nameResults(AllocaOp op, OpAsmSetValueNameFn setName) {
  setName(op.getLocal(), "local");
}

static void nameResults(StackCreateOp op, OpAsmSetValueNameFn setName) {
  setName(op.getStack(), "stack");
}

static void nameResults(LoadOp op, OpAsmSetValueNameFn setName) {
  // A longer name would hide the program.
  constexpr size_t longest = 16;
  if (op.getField().size() <= longest)
    setName(op.getValue(), op.getField());
}

static void nameResults(AtomicOp op, OpAsmSetValueNameFn setName) {
  if (!op.getOld().use_empty())
    setName(op.getOld(), "old");
}

static void nameResults(PolarOp op, OpAsmSetValueNameFn setName) {
  setName(op.getRotation(), "rotation");
  setName(op.getStretch(), "stretch");
}

static void nameResults(SvdOp op, OpAsmSetValueNameFn setName) {
  setName(op.getU(), "u");
  setName(op.getSigma(), "sigma");
  setName(op.getV(), "v");
}

static void nameResults(SymEigOp op, OpAsmSetValueNameFn setName) {
  setName(op.getValues(), "values");
  setName(op.getVectors(), "vectors");
}

namespace {
template <typename Op>
struct ResultNames : OpAsmOpInterface::ExternalModel<ResultNames<Op>, Op> {
  void getAsmResultNames(Operation *op, OpAsmSetValueNameFn setName) const {
    nameResults(cast<Op>(op), setName);
  }
};

struct IndexNames : OpAsmOpInterface::ExternalModel<IndexNames, ParallelForOp> {
  void getAsmBlockArgumentNames(Operation *op, Region &,
                                OpAsmSetValueNameFn setName) const {
    constexpr StringRef names[] = {"i", "j", "k", "l"};
    for (auto [dimension, iv] :
         llvm::enumerate(cast<ParallelForOp>(op).getInductionVars()))
      setName(iv, dimension < std::size(names) ? names[dimension] : "index");
  }
};
} // namespace

template <typename... Ops> static void attachResultNames(MLIRContext &context) {
  (Ops::template attachInterface<ResultNames<Ops>>(context), ...);
}

void tai::attachAsmNames(MLIRContext &context) {
  attachResultNames<AllocaOp, StackCreateOp, LoadOp, AtomicOp, PolarOp, SvdOp,
                    SymEigOp>(context);
  ParallelForOp::attachInterface<IndexNames>(context);
}
