//===- SummarizeKernels.cpp - Access summaries of kernels -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Summarizes the accesses of kernels: the tape skips and fuses launches by
// these summaries.
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/Accesses.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/Passes.h"
#include "llvm/ADT/SetVector.h"

namespace mlir::tai {
#define GEN_PASS_DEF_SUMMARIZEKERNELS
#define GEN_PASS_DEF_MARKEXCLUSIVE
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// The uses that one op makes of its field. Ops on the topology of a field read
/// or write it as a whole; a value that an atomic returns is read if it is
/// used.
static void addUses(FieldAccessOpInterface op,
                    llvm::SetVector<Attribute> &uses) {
  auto add = [&](FieldUse use, FlatSymbolRefAttr field, ValueRange indices,
                 bool isElement) {
    AffineMapAttr map;
    if (isElement)
      if (AffineMap affine = getAffineMap(op, indices))
        map = AffineMapAttr::get(affine);
    uses.insert(AccessAttr::get(op->getContext(), use, field, map));
  };
  FlatSymbolRefAttr field = op.getFieldAttr();
  bool isElement = op.isElementAccess();
  auto atomic = dyn_cast<AtomicOp>(op.getOperation());
  bool isSum = atomic && (atomic.getKind() == AtomicKind::Add ||
                          atomic.getKind() == AtomicKind::Sub);
  bool reads =
      atomic ? !isSum || !atomic.getOld().use_empty()
             : op.readsField() && op.getFieldAccess() != FieldAccess::Append;
  if (reads)
    add(FieldUse::Read, field, op.getIndices(), isElement);
  if (op.writesField())
    add(isSum ? FieldUse::Accumulate : FieldUse::Write, field, op.getIndices(),
        isElement);
}

namespace {
struct SummarizeKernels : tai::impl::SummarizeKernelsBase<SummarizeKernels> {
  void runOnOperation() override {
    getOperation()->walk([](KernelOp kernel) {
      llvm::SetVector<Attribute> uses;
      kernel.walk([&](FieldAccessOpInterface op) { addUses(op, uses); });
      kernel.setSummaryAttr(
          ArrayAttr::get(kernel.getContext(), uses.getArrayRef()));
    });
    markAllAnalysesPreserved();
  }
};

struct MarkExclusive : tai::impl::MarkExclusiveBase<MarkExclusive> {
  void runOnOperation() override {
    getOperation()->walk([](KernelOp kernel) { markExclusiveAtomics(kernel); });
    markAllAnalysesPreserved();
  }
};
} // namespace
